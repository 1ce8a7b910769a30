"""Hard cases: what each file of cases/hard must show, on both backends and in the reference.

The bounds stand in `tolerances`: a case defines what is simulated, and both codes read it.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

import reference_impl as reference
from exunet.base.cases import CASES
from exunet.base.errors import CaseError, Interrupted, RunStopped
from exunet.forces.contact.status import THREADS, ContactKey
from exunet.methods.method import METHODS, Backend, Kind
from exunet.model.limits import largest_frequency, stable_step
from exunet.results.measures import balance_error, momentum_books
from exunet.results.result import Result
from exunet.results.run_record import RunRecord
from exunet.scene.casefile import load
from exunet.simulation.preparation import Start, prepare, prepare_case
from exunet.simulation.run import simulate
from exunet.studies.both_codes import both_of
from exunet.verification import tolerances as tol
from exunet.verification.check import Check, skipped
from exunet.verification.suite import Item
from exunet.verification.tolerances import Tolerance
from reference_impl import energy as theirs
from reference_impl.forces import strain

IMPLICIT = tuple(method for method, facts in METHODS.items() if facts.kind == Kind.IMPLICIT)
IMPLICIT_STEPS = (0.2e-3, 1e-3, 5e-3, 20e-3)  # [s]

Findings = Callable[[Any, Any], Iterator[Check]]

SECTIONS = (
    "Coincident nodes",
    "Packed tightly, slack, overstretched",
    "Masses and stiffnesses far apart",
    "Long runs",
    "Implicit methods at steps too long for them",
    "Around the stable step",
    "Strong damping",
    "Sizes and topologies",
    "Fast, taut and long",
    "Stored times",
    "Contact",
)


@dataclass(frozen=True)
class Hard:
    """A hard case.

    Parameters
    ----------
    item : int
        Number of its section, from 1.
    case : str
        Name of the file.
    energy, momentum, angular : Tolerance
        Of the balances; None: external forces or torques act.
    short : dict
        End [s] on backends where the whole run takes some minutes.
    reference : dict or str
        How the reference runs it; a text is the reason why it does not.
    of_both : callable
        Further checks of a result, or of states of the reference, and the start (or None).
    more : callable
        Further checks of a result and the start.
    quick : bool
        True if it takes less than a second in the compiled loop.
    """

    item: int
    case: str
    energy: Tolerance = tol.HARD_ADAPTIVE
    momentum: Tolerance | None = tol.HARD_MOMENTUM
    angular: Tolerance | None = tol.HARD_ANGULAR
    short: dict[str, float] = field(default_factory=dict)
    reference: dict[str, Any] | str = field(default_factory=dict)
    of_both: Findings | None = None
    more: Findings | None = None
    quick: bool = False


def _trend(result: Any, _start: Any) -> Iterator[Check]:
    energy, full = result.kinetic + result.elastic, np.arange(0.0, result.time[-1] + 0.5)
    seconds = np.diff(np.interp(full, result.time, energy / energy[0]))
    error = float(seconds.std(ddof=1)) / math.sqrt(len(seconds))
    yield Check("trend of the energy", abs(float(seconds.mean())) / error, tol.HARD_TREND)


def _turns(result: Any, _start: Any) -> Iterator[Check]:
    node = int(np.argmax(np.linalg.norm(result.net.reference_position, axis=1)))
    angle = np.unwrap(np.arctan2(result.position[:, node, 1], result.position[:, node, 0]))
    turns = float(angle[-1] - angle[0]) / (2.0 * math.pi)
    yield Check("100 revolutions, turned", abs(turns - 100.0), tol.HARD_REVOLUTIONS)
    yield Check("slack elements", float((result.strain <= 0.0).sum()), tol.HARD_TAUT)


def _growth(result: Result, _start: Any) -> Iterator[Check]:
    energy = result.kinetic + result.elastic
    swing = float((energy - result.elastic[0]).max())
    yield Check("growth in 1e6 steps", swing / float(result.kinetic[0]), tol.HARD_GROWTH)


def _damping_sets(result: Result, start: Any) -> Iterator[Check]:
    alone = stable_step(start.plan.method, largest_frequency(start.system))
    yield Check("step that damping allows", float(start.plan.step / alone), tol.HARD_DAMPING_SETS)


def _stands(result: Result, _start: Any) -> Iterator[Check]:
    speed = np.linalg.norm(result.velocity, axis=-1).max(axis=1)
    yield Check("speed left", float(speed[-1] / speed[0]), tol.HARD_STOPPED)


def _every_step(result: Result, _start: Any) -> Iterator[Check]:
    yield Check(
        "states missing", float(abs(result.run.cost.steps + 1 - len(result.time))), tol.HARD_NO_STATE_LOST
    )


def _times(result: Result, start: Any) -> Iterator[Check]:
    asked = start.scene.time.stored_times
    yield Check("stored times", float(np.abs(result.time - asked).max()), tol.HARD_EXACT_TIMES)


def _rebound(result: Result, start: Any) -> Iterator[Check]:
    speed = result.velocity[:, result.net.bullet_nodes, 2]
    wished = start.scene.effects.contact.restitution
    off = float(np.abs(speed[-1] / speed[0] + wished).max())
    yield Check("restitution at 100 m/s", off, tol.HARD_REBOUND)
    coarse = ("solver.step=2.5e-4", "solver.force=true", "solver.retry=0")
    outcome = _outcome(prepare(load(case_path("fast_bullet"), ("engine.backend=compiled", *coarse)).scene))
    words = str(outcome) if isinstance(outcome, RunStopped) else "ran through"
    told = "may pass through unseen" in words and _finite(getattr(outcome, "result", None))
    yield Check("2.5 cm a step, forced: stopped", 0.0 if told else math.inf, tol.HARD_UNSEEN, words)


def _rests_on_an_edge(result: Result, start: Any) -> Iterator[Check]:
    """The tensions beside the element on the edge against the law's force on it, integrated by trapezia."""
    contact, body = start.scene.effects.contact, start.scene.bodies["box"]
    edge = body.edge_radius
    reach = edge + math.sqrt(float(result.net.area[0]) / math.pi)
    corner = body.position[2] + math.sqrt(2.0) * (0.5 * body.size[0] - edge)
    x, middle = result.position[-1], result.net.n_elements // 2
    across = np.linspace(x[middle, 0], x[middle + 1, 0], 200_001)
    height = np.interp(across, x[middle : middle + 2, 0], x[middle : middle + 2, 2]) - corner
    apart = np.hypot(across, height)
    stretch = float(result.net.reference_length[middle]) / (x[middle + 1, 0] - x[middle, 0])
    pressed = contact.stiffness * np.maximum(reach - apart, 0.0) * height / apart
    force = stretch * float(np.trapezoid(pressed, across))
    ways = np.diff(x, axis=0) / np.linalg.norm(np.diff(x, axis=0), axis=1)[:, None]
    pulled = result.tension[-1][middle - 1] * ways[middle - 1, 2]
    pulled -= result.tension[-1][middle + 1] * ways[middle + 1, 2]
    yield Check("force of the edge, from the tensions'", abs(force / pulled - 1.0), tol.HARD_EDGE)


def _parted(result: Result, _start: Any) -> Iterator[Check]:
    upper, lower = (result.bodies[name].velocity[:, 2] for name in ("upper", "lower"))
    apart = upper - lower
    yield Check("bodies, closing still", max(0.0, -float(apart[-1])), tol.HARD_PARTED)
    yield Check("speed gained by the bounce", max(0.0, float(apart[-1] / -apart[0]) - 1.0), tol.HARD_PARTED)


def _wound_up(result: Result, _start: Any) -> Iterator[Check]:
    spins = result.bodies["box"].angular_velocity
    assert spins is not None
    first, last = (float(np.linalg.norm(spins[k])) for k in (0, -1))
    yield Check("spin left to the box", last / first, tol.HARD_WOUND)


def _from_the_start(result: Result, start: Any) -> Iterator[Check]:
    first = float(result.contacts[ContactKey("ball", THREADS, "first")].values[-1][0])
    yield Check("first contact", first / float(start.plan.step), tol.HARD_AT_ONCE)
    settings = ("engine.backend=compiled", "bodies.ball.position=[0.0, 0.0, 0.1]")
    try:
        prepare_case(load(case_path("starts_in_contact"), settings))
        yield Check("start inside: refused", math.inf, tol.HARD_INSIDE)
    except CaseError as refused:
        words = r"starts_in_contact\.toml:\d+: effects\.contact: .* deeper than"
        told = 0.0 if re.search(words, str(refused)) else math.inf
        yield Check("start inside: refused", told, tol.HARD_INSIDE, str(refused))


COARSE = {"method": "EM", "step": 0.01}
FINE = {"method": "EM", "step": 1e-3}

Touching = partial(
    Hard, 11, energy=tol.HARD_FIXED, angular=tol.HARD_ANGULAR_FIXED,
    reference="its energy-momentum method has no contact; exunet verify compares both codes there",
)  # fmt: skip

GALLERY = (
    Hard(1, "all_in_one_point", quick=True),
    Hard(1, "folded", reference=FINE, quick=True),
    Hard(2, "packed_001", quick=True),
    Hard(2, "slack", quick=True),
    Hard(2, "overstretched", quick=True),
    Hard(3, "heavy_bullets", reference=FINE),
    Hard(3, "stiff_strings", quick=True),
    Hard(3, "soft_threads", quick=True),
    Hard(
        4, "long_undamped", tol.HARD_LONG, angular=tol.HARD_ANGULAR_FIXED, short={Backend.EXUDYN: 6.0},
        reference=COARSE, more=_trend,
    ),
    Hard(4, "spinning", tol.HARD_SMOOTH, angular=tol.HARD_ANGULAR_FIXED, reference=COARSE, of_both=_turns),
    Hard(
        6, "near_limit", tol.HARD_NEAR_LIMIT, momentum=None, angular=None, more=_growth,
        reference="10^6 steps of NumPy take a quarter of an hour",
    ),
    Hard(7, "strong_damping", tol.HARD_FIXED, angular=None, reference=COARSE, more=_damping_sets),
    Hard(7, "stopped_by_alpha", momentum=None, angular=None, more=_stands, quick=True),
    Hard(8, "mesh_1x1", quick=True),
    Hard(8, "mesh_1x20", quick=True),
    Hard(8, "mesh_50x50", reference=FINE),
    Hard(8, "divided_by_10", quick=True),
    Hard(8, "one_element", quick=True),
    Hard(8, "two_nets", quick=True),
    Hard(9, "launch_250", quick=True),
    Hard(9, "taut_string"),
    Hard(9, "tether", quick=True),
    Hard(10, "every_step", tol.HARD_FIXED, angular=tol.HARD_ANGULAR_FIXED, more=_every_step),
    Hard(10, "odd_times", tol.HARD_FIXED, angular=tol.HARD_ANGULAR_FIXED, more=_times),
    Touching("fast_bullet", more=_rebound),
    Touching("over_an_edge", momentum=None, angular=None, more=_rests_on_an_edge),
    *(Touching(name, more=_parted) for name in ("closing_bodies", "colliding_bodies")),
    Touching("light_target"),
    Touching("heavy_target"),
    Touching("stiff_contact"),
    Touching("soft_contact"),
    Touching("winding_up", more=_wound_up),
    Touching("starts_in_contact", more=_from_the_start),
)  # fmt: skip


def case_path(name: str) -> Path:
    """Return the file of a hard case."""
    return CASES / "hard" / f"{name}.toml"


def items(compiled: bool = False) -> list[Item]:
    """Return all checks of the hard cases; compiled: in the compiled loop only, without implicit methods."""
    backends = (Backend.COMPILED,) if compiled else tuple(Backend)
    found = [
        Item(
            SECTIONS[hard.item - 1],
            f"{hard.case}, {backend}",
            partial(on_backend, hard, backend),
            quick=hard.quick and backend == Backend.COMPILED,
        )
        for hard in GALLERY
        for backend in backends
    ]
    found += [
        Item(SECTIONS[5], f"near_limit, {backend}, above", partial(above, backend)) for backend in backends
    ]
    if compiled:
        return found
    found += [
        Item(SECTIONS[hard.item - 1], f"{hard.case}, reference", partial(of_reference, hard))
        for hard in GALLERY
    ]
    found.append(Item(SECTIONS[4], f"implicit, {Backend.EXUDYN}", implicit))
    return found


def on_backend(hard: Hard, backend: Backend) -> Iterator[Check]:
    """Check a case on one backend."""
    setting = f"engine.backend={backend}"
    whole = load(case_path(hard.case), [setting])
    end = hard.short.get(backend)
    case = whole if end is None else load(case_path(hard.case), [setting, f"time.end={end!r}"])
    name = "ran to its end" if end is None else f"ran {end:g} s of {whole.scene.time.end:g} s"
    start = prepare(case.scene)
    result = _outcome(start)
    if isinstance(result, RunStopped):
        yield Check(name, math.inf, tol.RAN, str(result))
        return
    yield Check(name, 0.0 if _finite(result) else math.inf, tol.RAN)
    yield from _balances(hard, result)
    if end is not None:
        why = "the whole run takes a quarter of an hour in this form; it is done in the others"
        yield skipped("what the whole run shows", why)
        return
    for findings in filter(None, (hard.of_both, hard.more)):
        yield from findings(result, start)
    if hard.case == "odd_times":
        other = both_of(case).run_reference(result.time)
        apart = float(np.abs(other.position - result.position).max())
        yield Check("positions, from the reference's", apart, tol.HARD_POSITIONS)


def _outcome(start: Start) -> Result | RunStopped:
    """Return the result of a run, or how it stopped."""
    try:
        return simulate(start)
    except Interrupted:  # a RunStopped too, but not a finding
        raise
    except RunStopped as stop:
        return stop


def of_reference(hard: Hard) -> Iterator[Check]:
    """A case in the reference: energy balance, momenta and what concerns both codes, in the same bounds."""
    if isinstance(hard.reference, str):
        yield skipped("the whole case", hard.reference)
        return
    how = hard.reference
    overrides = {"time.output_step": how["step"], "time.output_times": None} if "step" in how else {}
    scene = reference.load(case_path(hard.case), overrides)
    states = states_of(scene, scene.integrate(**how))
    yield from _balances(hard, states)
    if hard.of_both:
        yield from hard.of_both(states, None)


def _balances(hard: Hard, states: Any) -> Iterator[Check]:
    """Energy and momenta of a result, or of the reference's states with its names."""
    yield Check("energy balance", balance_error(states), hard.energy)
    if getattr(states, "bodies", None):
        books, bounds = momentum_books(states), {"linear": hard.momentum, "angular": hard.angular}
        for name, bound in bounds.items():
            if bound:
                unaccounted = books[name].residual / books[name].size
                yield Check(f"{name} momentum, unaccounted", unaccounted, replace(bound, unit="of its size"))
        return
    shares = states.net.mass * np.linalg.norm(states.velocity, axis=-1)
    if hard.momentum:
        change = _change(states.momentum) / float(shares.sum(axis=1).max())
        yield Check("linear momentum", change, hard.momentum)
    if hard.angular:
        arms = (shares * np.linalg.norm(states.position, axis=-1)).sum(axis=1).max()
        yield Check("angular momentum", _change(states.angular_momentum) / float(arms), hard.angular)


def states_of(scene: Any, run: Any) -> Any:
    """States of the reference with the names of a result."""
    system, x, v = scene.system, run.x, run.v
    states = SimpleNamespace(net=scene.net, time=run.t, position=x, velocity=v, strain=strain(system, x))
    states.kinetic, states.elastic = theirs.kinetic(system, v), theirs.elastic(system, x)
    states.potential, states.dissipated = theirs.potential(system, x), run.dissipated
    states.momentum = theirs.momentum(system, v)
    states.angular_momentum = theirs.angular_momentum(system, x, v)
    states.run = RunRecord()
    return states


def implicit() -> Iterator[Check]:
    """The implicit methods at four steps on the paper's net: within the bound, or stopped by a guard."""
    for method in IMPLICIT:
        for step in IMPLICIT_STEPS:
            settings = (f"solver.method={method}", f"solver.step={step!r}", "engine.backend=exudyn")
            name = f"{method} at {1e3 * step:g} ms"
            result = _outcome(prepare(load(case_path("implicit"), settings).scene))
            if isinstance(result, RunStopped):
                yield stopped(name, result)
            else:
                measured = balance_error(result) if _finite(result) else math.inf
                yield Check(f"{name}: ran to the end", measured, tol.HARD_BOUND)


def stopped(name: str, stop: RunStopped) -> Check:
    """A run that did not end: a guard must have stopped it, for its energy, and what is kept is finite."""
    words = str(stop)
    found = re.match(r"diverged at t = (\S+) s: the energy balance (increased|decreased) by (\S+) J", words)
    if not found or not _finite(stop.result):
        return Check(f"{name}: stopped by something else", math.inf, tol.HARD_BY_GUARD, words)
    time, change, energy = found.groups()
    sign = "+" if change == "increased" else "-"
    return Check(f"{name}: stopped at {time} s, energy {sign}{energy} J", 0.0, tol.HARD_BY_GUARD, words)


def above(backend: Backend) -> Iterator[Check]:
    """1.02 of the stable step: refused; forced, stopped by a guard."""
    path, on = case_path("near_limit"), f"engine.backend={backend}"
    start = prepare(load(path, [on]).scene)
    step = 1.02 * stable_step(start.plan.method, largest_frequency(start.system))
    name, setting = "1.02 of the stable step", (f"solver.step={step!r}", on)
    try:
        prepare(load(path, setting).scene)
        yield Check(f"{name}: refused", math.inf, tol.HARD_REFUSED)
    except CaseError:
        yield Check(f"{name}: refused", 0.0, tol.HARD_REFUSED)
    result = _outcome(prepare(load(path, ("solver.force=true", "solver.retry=0", *setting)).scene))
    caught = isinstance(result, RunStopped) and _finite(result.result)
    words = str(result) if isinstance(result, RunStopped) else ""
    yield Check(f"{name}, forced: stopped", 0.0 if caught else math.inf, tol.HARD_CAUGHT, words)


def _finite(result: Result | None) -> bool:
    names = ("position", "velocity", "tension", "kinetic", "elastic", "dissipated")
    return result is not None and all(bool(np.isfinite(getattr(result, name)).all()) for name in names)


def _change(vectors: Any) -> float:
    return float(np.linalg.norm(vectors - vectors[0], axis=-1).max())
