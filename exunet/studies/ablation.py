"""What each effect changes, measured: the scene run with that effect toggled, beside its estimate.

A net's motion is sensitive: after some time any difference grows to the size of the net. So the scene is also
run eight times with nothing changed but its errors (the start moved by a little, another accuracy). An
effect's displacement is measured while it is at least three times as large as the largest of those runs'; the
estimate beside it is for the same time. A measure of deployment is told apart if its value with the effect
toggled lies outside the interval in which another of those runs' would lie with a probability of 99 %, and
further from them than the scene's own run is: a run with other steps, which an effect without any force takes
too, has an error of that size, and those of the other accuracy have not. Nor is a change told apart that no
digit shows which is printed of the measure.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from exunet.base.errors import Interrupted, RunStopped
from exunet.base.faults import collected
from exunet.case.scene import Scene
from exunet.forces.effects import cross_checks
from exunet.results.convergence import around_one_more
from exunet.results.headlines import DEPLOYMENT, headline
from exunet.results.measures import deployment
from exunet.results.result import Result
from exunet.simulation.preparation import Start, prepare
from exunet.simulation.run import simulate
from exunet.studies.neighbours import SEED, nearby_start, of_other_accuracy
from exunet.system.effect_survey import Finding, chosen, finding, survey

Floats = NDArray[np.float64]
ProgressOfRuns = Callable[[str, float], None]

CLEAR = 3.0  # times the noise, from which on a displacement counts as the effect's
BRIEF = 1e-4  # of the duration, run before each run that is timed
FOUR = ("largest_area", "time_of_largest", "distance", "time_open")
# What is told of a change in a measure of deployment: the headline of its name.
HEADLINES = {name: headline(key) for name, key in zip(FOUR, DEPLOYMENT, strict=True)}

STARTS = 8  # runs with nothing changed but their errors


@dataclass(frozen=True)
class Change:
    """What an effect's presence changes in a measure of deployment.

    value  : with the effect, less without it (the mean of the runs from moved starts)
    spread : half the width of the interval in which another run with nothing changed would lie, and how far
             the scene's own run is off those of the other accuracy
    digit  : the last one that is printed of the measure; of a stored time the time between two
    """

    name: str
    value: float
    spread: float
    digit: float = 0.0

    @property
    def told_apart(self) -> bool:
        """False if errors, or the digits that are not printed, may be all that there is."""
        return abs(self.value) > max(self.spread, self.digit)


@dataclass(frozen=True)
class _Noise:
    """What errors alone change.

    moved    : (n_times,) largest displacement [m]
    measures : (runs, 4) measures of deployment, that of the scene itself first; None without a mouth
    """

    moved: Floats
    measures: Floats | None


@dataclass(frozen=True)
class Toggled:
    """One effect toggled.

    found    : its finding over the whole scene
    until    : time [s] up to which it could be measured; 0: not at all
    estimate : displacement over the size of the net up to then, estimated
    measured : the same, measured: the largest root mean square over the mass at a stored time
    measures : changes of the measures of deployment by the effect's presence; empty for a net without a mouth
    wall     : integration time with the effect over that without
    failure  : why the run with the effect toggled was not made, or stopped; "" if it ended well
    """

    found: Finding
    until: float = 0.0
    estimate: float = 0.0
    measured: float = 0.0
    measures: tuple[Change, ...] = ()
    wall: float = 1.0
    failure: str = ""

    @property
    def ratio(self) -> float | None:
        """Estimate over measurement; None if nothing could be measured."""
        return self.estimate / self.measured if self.measured > 0.0 else None


def ablate(
    scene: Scene, names: tuple[str, ...] | None = None, progress: ProgressOfRuns | None = None
) -> Iterator[Toggled]:
    """Toggle effects one after the other; raises as `run` does if the scene itself does not run.

    names    : which effects; None: all
    progress : called with what is running and the simulated time [s]
    """
    findings = survey(scene)
    scene = _settled(scene)
    base = _run(scene, "as it is", progress)
    noise = _noise(scene, base, progress)
    for found in findings:
        if names is None or found.name in names:
            yield _toggle(scene, found, base, noise, progress)


def _toggle(
    scene: Scene, found: Finding, base: Result, noise: _Noise, progress: ProgressOfRuns | None
) -> Toggled:
    if found.keys is None:
        return Toggled(found, failure="not estimated: there is nothing to assume for this scene")
    other = toggled(scene, found)
    if wrongs := _contradictions(other):
        return Toggled(found, failure=f"cannot be toggled alone: {wrongs[0]}")
    try:
        result = _run(other, f"{found.name} {'off' if found.on else 'on'}", progress)
    except RunStopped as stop:
        if isinstance(stop, Interrupted):
            raise
        return Toggled(found, failure=str(stop))
    with_it, without = (base, result) if found.on else (result, base)
    apart = _distance(base, result)
    until, measured, estimate = 0.0, 0.0, 0.0
    clear = np.flatnonzero(apart > CLEAR * noise.moved)
    if len(clear):
        lost = np.flatnonzero(apart[clear[0] :] <= CLEAR * noise.moved[clear[0] :])
        last = clear[0] + lost[0] - 1 if len(lost) else len(apart) - 1
        until = float(base.time[last])
        measured = float(apart[: last + 1].max()) / base.net.size
        estimate = finding(scene, found.name, until).relative
    seconds = [float(run.provenance["integration_seconds"]) for run in (with_it, without)]
    wall = seconds[0] / seconds[1] if seconds[1] else 1.0
    between = float(np.diff(base.time).max())
    changes = _changes(noise.measures, _four(result), -1.0 if found.on else 1.0, between)
    return Toggled(found, until, estimate, measured, changes, wall)


def _settled(scene: Scene) -> Scene:
    """The scene with what effects.choose = "auto" has chosen, which then does not choose again."""
    with collected() as faults:
        scene, _ = chosen(scene, faults)
    effects: Any = scene.effects
    return scene.model_copy(
        update={"effects": effects.model_copy(update={"choose": None, "threshold": None})}
    )


def toggled(scene: Scene, found: Finding) -> Scene:
    """The scene with the effect of a finding switched off, or on with its keys."""
    effects: Any = scene.effects
    switched = effects.model_copy(update={found.name: None if found.on else found.keys})
    update: dict[str, Any] = {"effects": switched}
    if found.name == "launch_force" and not found.on:
        update["launch"] = None  # in place of which it comes
    return scene.model_copy(update=update)


def _contradictions(scene: Scene) -> list[str]:
    return [f"{fault.path[0]} {fault.reason}" for fault in cross_checks(scene)]


def _noise(scene: Scene, base: Result, progress: ProgressOfRuns | None) -> _Noise:
    """What runs from moved starts, integrated at another accuracy, differ from the scene's own."""
    moved, measures = np.zeros(len(base.time)), [_four(base)]
    for number in range(STARTS):

        def perturbed(start: Start, seed: int = SEED + number) -> Start:
            return replace(nearby_start(start, seed=seed), plan=of_other_accuracy(start.plan))

        again = _run(scene, f"moved start {number + 1}", progress, perturbed)
        moved = np.maximum(moved, _distance(base, again))
        measures.append(_four(again))
    known = [one for one in measures if one is not None]
    return _Noise(moved, np.array(known) if known else None)


def _run(
    scene: Scene, what: str, progress: ProgressOfRuns | None, change: Callable[[Start], Start] | None = None
) -> Result:
    brief = scene.time.model_copy(update={"end": BRIEF * scene.time.end, "output_times": ()})
    simulate(prepare(scene.model_copy(update={"time": brief})))  # so that no first use is timed
    start = prepare(scene)
    tell = (lambda time, *_: progress(what, time)) if progress else None
    if progress:
        progress(what, 0.0)
    return simulate(change(start) if change else start, progress=tell)


def _distance(a: Result, b: Result) -> Floats:
    """(n_times,) root mean square over the mass of how far the nodes are apart [m]."""
    mass = np.array(a.net.mass)
    mass[a.net.fixed_nodes] = 0.0
    apart = a.position[:] - b.position[:]
    return np.sqrt(np.einsum("n,tna,tna->t", mass, apart, apart) / mass.sum())


def _four(result: Result) -> tuple[float, ...] | None:
    found = deployment(result)
    return None if found is None else tuple(float(getattr(found, name)) for name in FOUR)


def _changes(
    same: Floats | None, toggled: tuple[float, ...] | None, sign: float, between: float
) -> tuple[Change, ...]:
    """Of each measure.

    same    : (runs, 4) with nothing changed, the first that of the scene as it is
    toggled : (4,) of the run with the effect so
    between : stored times [s]
    """
    if same is None or toggled is None:
        return ()
    spread = around_one_more(same) + np.abs(same[0] - same[1:].mean(axis=0))
    values = sign * (np.array(toggled) - same.mean(axis=0))
    sizes = np.maximum(np.abs(same).max(axis=0), np.abs(toggled))
    return tuple(
        Change(name, float(value), float(around), between if one.at_a_time else one.last_digit(float(size)))
        for (name, one), value, around, size in zip(HEADLINES.items(), values, spread, sizes, strict=True)
    )
