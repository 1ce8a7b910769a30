"""What each effect changes, measured: the scene run with that effect toggled, beside its estimate.

A net's motion is sensitive: after some time any difference grows to the size of the net. So the scene is also
run once with nothing changed but its errors (the start moved by a little, another accuracy), and an effect's
displacement is measured while it is at least three times as large as that run's; the estimate beside it is
for the same time. An effect that never stands out of that noise is not measured.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from exunet.base.errors import Interrupted, RunStopped
from exunet.case.scene import Scene
from exunet.forces.effects import cross_checks
from exunet.results.measures import Deployment, deployment
from exunet.results.result import Result
from exunet.simulation.preparation import Start, prepare
from exunet.simulation.run import simulate
from exunet.studies.neighbours import nearby_start, of_other_accuracy
from exunet.system.effect_survey import Finding, chosen, finding, survey

Floats = NDArray[np.float64]
Progress = Callable[[str, float], None]

CLEAR = 3.0  # times the noise, from which on a displacement counts as the effect's
BRIEF = 1e-4  # of the duration, run before each run that is timed


Changes = tuple[tuple[str, float], ...]


@dataclass(frozen=True)
class _Noise:
    """What errors alone change: displacement (n_times,) [m], and the measures of deployment."""

    moved: Floats
    measures: Changes


@dataclass(frozen=True)
class Toggled:
    """One effect toggled.

    found    : its finding over the whole scene
    until    : time [s] up to which it could be measured; 0: not at all
    estimate : displacement over the size of the net up to then, estimated
    measured : the same, measured: the largest root mean square over the mass at a stored time
    measures : change of each measure of deployment by the effect's presence; empty for a net without a mouth
    noise    : change of each measure by nothing but errors, below which the change by the effect says nothing
    wall     : integration time with the effect over that without
    failure  : why the run with the effect toggled was not made, or stopped; "" if it ended well
    """

    found: Finding
    until: float = 0.0
    estimate: float = 0.0
    measured: float = 0.0
    measures: Changes = ()
    noise: Changes = ()
    wall: float = 1.0
    failure: str = ""

    @property
    def ratio(self) -> float | None:
        """Estimate over measurement; None if nothing could be measured."""
        return self.estimate / self.measured if self.measured > 0.0 else None


def ablate(
    scene: Scene, names: tuple[str, ...] | None = None, progress: Progress | None = None
) -> Iterator[Toggled]:
    """Toggle effects one after the other; raises as `run` does if the scene itself does not run.

    names    : which effects; None: all
    progress : called with what is running and the simulated time [s]
    """
    findings = survey(scene)
    scene = _settled(scene)
    base = _run(scene, "as it is", progress)
    again = _run(scene, "noise", progress, _perturbed)
    noise = _Noise(_distance(base, again), _changes(deployment(again), deployment(base)))
    for found in findings:
        if names is None or found.name in names:
            yield _toggle(scene, found, base, noise, progress)


def _toggle(scene: Scene, found: Finding, base: Result, noise: _Noise, progress: Progress | None) -> Toggled:
    if found.keys is None:
        return Toggled(found, failure="nothing to assume for this scene")
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
    return Toggled(
        found, until, estimate, measured, _changes(deployment(with_it), deployment(without)), noise.measures,
        seconds[0] / seconds[1] if seconds[1] else 1.0,
    )  # fmt: skip


def _settled(scene: Scene) -> Scene:
    """The scene with what effects.choose = "auto" has chosen, which then does not choose again."""
    scene, _ = chosen(scene)
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


def _perturbed(start: Start) -> Start:
    """The same start but for errors: a little moved, and integrated at another accuracy."""
    return replace(nearby_start(start), plan=of_other_accuracy(start.plan))


def _run(
    scene: Scene, what: str, progress: Progress | None, change: Callable[[Start], Start] | None = None
) -> Result:
    brief = scene.time.model_copy(update={"end": BRIEF * scene.time.end, "output_times": ()})
    simulate(prepare(scene.model_copy(update={"time": brief})))  # so that no first use is timed
    start = prepare(scene)
    tell = (lambda time, _number: progress(what, time)) if progress else None
    if progress:
        progress(what, 0.0)
    return simulate(change(start) if change else start, progress=tell)


def _distance(a: Result, b: Result) -> Floats:
    """(n_times,) root mean square over the mass of how far the nodes are apart [m]."""
    mass = np.array(a.net.mass)
    mass[a.net.fixed_nodes] = 0.0
    apart = a.position[:] - b.position[:]
    return np.sqrt(np.einsum("n,tna,tna->t", mass, apart, apart) / mass.sum())


def _changes(with_it: Deployment | None, without: Deployment | None) -> Changes:
    if with_it is None or without is None:
        return ()
    four = ("largest_area", "time_of_largest", "distance", "time_open")
    return tuple(
        (field.name, getattr(with_it, field.name) - getattr(without, field.name))
        for field in fields(Deployment)
        if field.name in four
    )
