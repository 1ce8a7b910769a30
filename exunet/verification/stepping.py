"""Rung 4: the same scheme with the same step in both codes: one step, then a whole run."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from exunet.studies.both_codes import Pair
from exunet.verification.check import Check, Finding, Plate, left_out, worst_first
from exunet.verification.figures import curves
from exunet.verification.growth import LONE, VISIBLE, Growth, distance, fixed_plan
from exunet.verification.states import HALF_SLACK, NO_HALF_SLACK, smooth_states
from exunet.verification.tolerances import ONE_STEP, SAME_SCHEME

SEED = 20210617
SHOWN_PAST = 1.15  # of the horizon


def one_step(pair: Pair) -> Iterator[Check]:
    """Exudyn's RK44 and the reference's RK4, one step from a taut and from a half-slack state."""
    net, random = pair.start.net, np.random.default_rng(SEED)
    plan = fixed_plan(pair, pair.start.scene.time.end)
    times = np.array([0.0, plan.step])
    states = smooth_states(net, random)
    if HALF_SLACK not in states:
        yield left_out(4, pair.name, f"one step, {HALF_SLACK}", NO_HALF_SLACK)
    for kind, position in states.items():
        velocity = pair.speed * random.normal(size=position.shape)
        moved = pair.from_state(position, velocity)
        ours, theirs = moved.engine(times, plan), moved.march(times, method="RK4", step=plan.step)
        gaps = []
        for name, a, b in (
            ("position", ours.position[1], theirs.position[1]),
            ("velocity", ours.velocity[1], theirs.velocity[1]),
        ):
            gap = np.abs(a - b)
            node, axis = np.unravel_index(int(np.argmax(gap)), gap.shape)
            values = f"{name} of node {node}, {'xyz'[axis]}: {a[node, axis]:.16g} and {b[node, axis]:.16g}"
            gaps.append((float(gap.max() / (np.abs(b).max() or 1.0)), values))
        measured, worst = max(gaps, key=lambda found: worst_first(found[0]))
        yield Check(4, pair.name, f"one step of {plan.step:.3g} s, {kind}", measured, ONE_STEP, worst)


def same_scheme(pair: Pair, grown: Growth) -> Iterator[Finding]:
    """The growth of the difference over the run, against the growth of a perturbation of the start.

    grown : of this case, over the time to compare

    Compared until the round-off of all steps may have become `VISIBLE`: a bound above that says nothing.
    """
    shown = grown.time <= max(SHOWN_PAST * grown.horizon, grown.time[1])
    times, lone = grown.time[shown], grown.of(LONE)[shown]
    plan = fixed_plan(pair, float(times[1]))
    ours, theirs = pair.engine(times, plan), pair.march(times, method="RK4", step=plan.step)
    apart = distance(ours, theirs)
    round_off = ours.steps * np.finfo(float).eps * max(pair.size, float(np.abs(theirs.position).max()))
    bound = np.maximum.accumulate(lone) * round_off / LONE
    kept = max(1, int(np.count_nonzero(~(bound >= VISIBLE))))  # the bound never falls; no number is no end
    share = (apart / np.where(apart > 0.0, bound, 1.0))[:kept]
    at = int(np.argmax(share))
    node = int(np.argmax(np.linalg.norm(ours.position[at] - theirs.position[at], axis=1)))
    a, b = (", ".join(f"{c:.12g}" for c in run.position[at, node]) for run in (ours, theirs))
    yield Check(
        4,
        pair.name,
        f"equal steps to t = {times[kept - 1]:.3g} s, part of the bound",
        float(share[at]),
        SAME_SCHEME,
        f"t = {times[at]:.4g} s, node {node}: ({a}) and ({b}) m; bound {bound[at]:.2g} m",
    )
    ended = (
        {f"bound {VISIBLE:.0e} m, compared until here": float(times[kept - 1])} if kept < len(times) else {}
    )
    yield Plate(
        4,
        f"same_scheme_{pair.name}",
        curves(
            f"{pair.name}: Exudyn RK44 and reference RK4, step {plan.step:.3g} s",
            "largest difference of a position [m]",
            times,
            {"Exudyn and reference": apart, f"one code, start moved by {LONE:.0e} m": lone},
            ended,
        ),
        f"{pair.name}: the same scheme with the same step in both codes. The difference begins as round-off "
        "and grows as fast as any small change of the start does.",
    )
