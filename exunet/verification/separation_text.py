"""The question of the paper's section 3.4, answered in words; every sentence follows from the runs."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from exunet.verification.separation_runs import END, MATLAB, MIRRORED, NUDGE, TOLERANCES, Curve, Study
from exunet.verification.separation_times import (
    SIGNIFICANT,
    drawn_orders,
    drawn_table,
    instants,
    median,
    order,
    shown,
    span,
)

Floats = NDArray[np.float64]

VISIBLE = 0.01  # part of the launch speed: two curves in the paper's Fig. 5 that far apart are seen as two
TWICE = 0.02  # the same, a reader who needs more
PAPER = 1.75  # [s], where the paper sees its curves separate
NEAR = 0.05  # [s]: times so close to the paper's are the same in its figure


def answer(found: Study, speed: float) -> str:
    """Markdown: tables of the times at which the bullets separate, and what follows from them.

    speed : launch speed [m/s]
    """
    level = VISIBLE * speed
    points = (
        _cause(found, level),
        _trend(found, level),
        _how_soon(found, level),
        _over_many(found, level),
        _paper(found, speed),
        _integrator(found),
        _conclusion(found, level),
    )
    return f"""**Is the separation of the bullet curves after {PAPER} s an error of the paper's integrator, a
property of the problem, or which part of each?**

Times at which the four bullet speeds first differ by more than {VISIBLE:.0%} of the launch speed, by
tolerance of the integrator (-: not before {found.time[-1]:g} s; blank: not run; packing 0.1 where none is
named):

{_table(found, level)}

{drawn_table(found.drawn, found.time, level)}

As the paper calculates:
ode45's pair at its default tolerances ({MATLAB:g}, absolute {1e-3 * MATLAB:g}), S(x) x
and D v with assembled matrices as in eq. (16):

{_paper_table(found, speed)}

""" + "\n".join(f"- {point}" for point in points)


def _table(found: Study, level: float) -> str:
    head = " | ".join(f"{tolerance:.0e}" for tolerance in TOLERANCES)
    rows = [f"| start | run | {head} |", "|---" * (len(TOLERANCES) + 2) + "|"]
    for start, group in (("as in the case", found.plain), (f"moved by {NUDGE:.0e} m", found.nudged)):
        for label, runs in group.items():
            cells = {run.tolerance: shown(run.separates(found.time, level)) for run in runs}
            rows.append(f"| {start} | {label} | " + " | ".join(cells.get(t, "") for t in TOLERANCES) + " |")
    return "\n".join(rows)


def _paper_table(found: Study, speed: float) -> str:
    rows = [f"| net | run | {VISIBLE:.0%} apart | {TWICE:.0%} apart |", "|---|---|---|---|"]
    for name, hows in found.paper.items():
        for how, run in hows.items():
            cells = (shown(run.separates(_times(run), part * speed)) for part in (VISIBLE, TWICE))
            rows.append(f"| {name} | {how} | " + " | ".join(cells) + " |")
    return "\n".join(rows)


def _of(group: dict[str, list[Curve]], name: str) -> list[Curve]:
    return [run for label, runs in group.items() if label.split(", ", 1)[1] == name for run in runs]


def _largest(runs: Iterable[Curve]) -> float:
    """Largest spread [m/s] of the runs; infinite where one stopped."""
    return max((math.inf if run.stopped else float(run.spread.max()) for run in runs), default=math.inf)


def _seeded_by_round_off(found: Study, level: float) -> bool:
    """Nothing separates in mirrored arithmetic, and something does in ordinary one."""
    mirrored = [run for runs in found.mirrored.values() for run in runs]
    ordinary = [run for runs in found.plain.values() for run in runs]
    return _largest(mirrored) == 0.0 and any(map(math.isfinite, instants(ordinary, found.time, level)))


def _cause(found: Study, level: float) -> str:
    longer = float(found.longer[-1])
    spans = "; ".join(f"{name}: {span(_of(found.plain, name), found.time, level)}" for name in found.mirrored)
    mirrored = _largest(run for runs in found.mirrored.values() for run in runs)
    tolerances = " and ".join(f"{tolerance:.0e}" for tolerance in MIRRORED)
    if _seeded_by_round_off(found, level):
        return (
            "*What separates the curves is round-off, not the error of the integrator.* The equations and "
            "the start are symmetric, so a truncation error is the same for mirrored nodes. In mirrored "
            "arithmetic, which differs in the order of additions only, the spread is exactly zero until "
            f"{longer:g} s (tolerances {tolerances}). In ordinary arithmetic they separate: {spans}."
        )
    if mirrored == 0.0:
        return (
            f"*Nothing separates here.* In mirrored arithmetic the spread is exactly zero until {longer:g} "
            f"s; in ordinary arithmetic too the speeds stay together: {spans}."
        )
    if not math.isfinite(mirrored):
        return (
            "*Whether round-off explains it is not known,* as a run in mirrored arithmetic stopped "
            f"(tolerances {tolerances}). In ordinary arithmetic: {spans}."
        )
    return (
        "*Round-off alone does not explain it.* Even in mirrored arithmetic the spread reaches "
        f"{mirrored:.2g} m/s until {longer:g} s (tolerances {tolerances}), so something else breaks the "
        f"symmetry. In ordinary arithmetic: {spans}."
    )


def _trend(found: Study, level: float) -> str:
    """Kendall's rank correlation of tolerance and time; a run that does not separate is later than all."""
    words, trends = [], 0
    for label, runs in found.plain.items():
        if sum(map(math.isfinite, instants(runs, found.time, level))) < 4:
            words.append(f"{label}: too few runs separate to tell")
            continue
        ranks = order(runs, found.time, level)
        if ranks is None:
            words.append(f"{label}: none, all separate at the same time")
            continue
        tau, p = ranks
        if p < SIGNIFICANT:
            trends += 1
            what = "later" if tau > 0 else "earlier"
            words.append(f"{label}: {what} with a tighter tolerance (tau = {tau:+.2f}, p = {p:.2g})")
        else:
            words.append(f"{label}: none shown (tau = {tau:+.2f}, p = {p:.2g})")
    head = (
        "*When they separate depends on the tolerance.*"
        if trends
        else "*No trend with the tolerance is shown.*"
    )
    return (
        f"{head} By Kendall's tau over the tolerances (a run that does not separate counts as later than "
        f"all): {'; '.join(words)}. With so few runs only a strong trend would show."
    )


def _how_soon(found: Study, level: float) -> str:
    moved = {name: _of(found.nudged, name) for name in found.mirrored}
    spans = "; ".join(f"{name}: {span(runs, found.time, level)}" for name, runs in moved.items())
    every = all(math.isfinite(run.separates(found.time, level)) for runs in moved.values() for run in runs)
    head = (
        "*A moved start separates at every tolerance tried.*"
        if every
        else "*A moved start does not separate in every run.*"
    )
    equal = [name for name in found.mirrored if _largest(_of(found.plain, name)) == 0.0]
    quiet = (
        f" Unmoved, no run shows any spread ({'; '.join(equal)}): their additions happen to keep the "
        "symmetry, so there is nothing to grow."
        if equal
        else ""
    )
    return (
        f"{head} From a start moved by {NUDGE:.0e} m, {spans}.{quiet} Each snap multiplies a difference; the "
        "rates of growth above say by how much. No real net is symmetric to 1e-15."
    )


def _over_many(found: Study, level: float) -> str:
    """What many moved starts show of the tolerance's part in how soon."""
    if not found.drawn:
        return "*Whether the tolerance changes how soon* is not measured here: that takes the compiled loop."
    orders = drawn_orders(found.drawn, found.time, level)
    told = "; ".join(
        f"{'no order shown' if kind == 'no order' else f'{kind} with a looser tolerance'}: {', '.join(names)}"
        for kind, names in orders.items()
        if names
    )
    head = {
        (True, False): "*A loose tolerance may let it grow sooner.*",
        (False, True): "*A loose tolerance may let it grow later.*",
        (True, True): "*The tolerance has a part in how soon.*",
        (False, False): "*No part of the tolerance in how soon is shown.*",
    }[bool(orders["sooner"]), bool(orders["later"])]
    return f"{head} Over many moved starts, by Kendall's tau over all of them: {told}."


def _paper(found: Study, speed: float) -> str:
    words = []
    for name, hows in found.paper.items():
        for part in (VISIBLE, TWICE):
            read = [run.separates(_times(run), part * speed) for run in hows.values()]
            known = [instant for instant in read if not math.isnan(instant)]
            near = sum(abs(instant - PAPER) <= NEAR + 1e-9 for instant in known)
            never = sum(map(math.isinf, known))
            middle = median(known)
            when = f"median {middle:.3f} s" if math.isfinite(middle) else "no median before the end"
            words.append(
                f"{name}, {part:.0%} apart: {when}, {near} of {len(read)} within {NEAR:g} s of {PAPER} s, "
                f"{never} not apart before {found.time[-1]:g} s, {len(read) - len(known)} stopped"
            )
    return (
        "*The paper's own setting,* over runs that differ in the storing (which bounds ode45's first step) "
        f"and in the last bits of the start, separates at these times: {'; '.join(words)}."
    )


def _times(run: Curve) -> Floats:
    return np.linspace(0.0, END, len(run.speeds))


def _integrator(found: Study) -> str:
    runs = [run for run in found.plain["reference, damped"] if run.tolerance in TOLERANCES[:4:3]]
    if any(run.stopped for run in runs) or any(
        run.stopped for runs in found.mirrored.values() for run in runs
    ):
        return "*The integrator's own part is not known,* as a run that would show it stopped."
    at, there = np.searchsorted(found.time, PAPER), np.searchsorted(found.longer, PAPER)
    true = found.mirrored["damped"][-1].mean[there]
    errors = [abs(float(run.mean[at] - true)) for run in runs]
    spreads = [float(run.spread[at]) for run in runs]
    told = " and ".join(
        f"{error:.2g} m/s at tolerance {run.tolerance:.0e}, where the four differ by {spread:.1g} m/s"
        for run, error, spread in zip(runs, errors, spreads, strict=True)
    )
    together = all(spread < 0.1 * error for spread, error in zip(spreads, errors, strict=True))
    drift = ", ".join(
        f"{float(np.abs(a.mean - b.mean)[there]):.1e} m/s ({name})" for name, (a, b) in found.mirrored.items()
    )
    head = (
        "*The integrator's own part moves the four curves together.*"
        if together
        else "*The integrator's own part is not told apart from the spread.*"
    )
    return (
        f"{head} The mean bullet speed of the damped net at {PAPER} s is off by {told}, with the pair behind "
        f"ode45. The symmetric solution itself changes there by {drift} between the tolerances "
        f"{MIRRORED[0]:.0e} and {MIRRORED[1]:.0e}."
    )


def _conclusion(found: Study, level: float) -> str:
    if not _seeded_by_round_off(found, level):
        return "*These runs do not say* that round-off is what separates the curves."
    orders = drawn_orders(found.drawn, found.time, level)
    sooner = "; a loose tolerance may let it grow sooner" if orders["sooner"] else ""
    return (
        "*So* the loss of symmetry that the paper ascribes to its integrator is the sensitivity of the "
        f"deployment: round-off seeds it{sooner}. Beyond the horizon only statements about many runs make "
        "sense: see the ensembles."
    )
