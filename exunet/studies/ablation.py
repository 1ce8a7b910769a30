"""Ablation of effects and of the closing of the mouth: the scene run with each of them toggled.

After some time any difference of two runs grows to the size of the net. Therefore the scene is also run eight
times with nothing changed but its errors: the start perturbed as in the perturbed runs of a run, and another
accuracy. An effect's displacement is measured as long as it is at least three times the largest one of those
runs; the estimate beside it is for the same time.

A change of a measure of deployment or capture is significant if three conditions hold. The value with the
effect toggled lies outside the interval that holds another of those runs with a probability of 99 %. It is
further from them than the scene's own run is, since a run with other steps, as an effect without force causes
too, has an error of that size. And it shows in the printed digits.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from exunet.base.arrays import Floats
from exunet.base.errors import CaseError, Interrupted, RunStopped, collected
from exunet.forces.effects import EFFECTS, cross_checks
from exunet.model.effect_survey import Finding, chosen, finding, survey
from exunet.results.metrics import DEPLOYMENT, STORED, Metric, metrics_of
from exunet.results.observables import Observables
from exunet.results.outcome import outcome
from exunet.results.result import Result
from exunet.scene.scene import Scene
from exunet.scene.script import ScriptEntry
from exunet.simulation.preparation import Start, prepare
from exunet.simulation.run import simulate
from exunet.studies.ensemble import MOVE, SEED, nearby_start, of_other_accuracy
from exunet.studies.samples import around_one_more

ProgressOfRuns = Callable[[str, float], None]

CLEAR = 3.0  # times the noise, from which on a displacement counts as the effect's
BRIEF = 1e-4  # of the duration, run before each run that is timed
# Metrics whose changes are reported.
COMPARED = (
    *DEPLOYMENT, "capture_enclosed", "capture_mcqi", "capture_mouth_m", "capture_relative_speed_m_s",
)  # fmt: skip
CLOSING = "closing"  # in place of an effect's name: the line, or the edge that becomes shorter

STARTS = 8  # runs with nothing changed but their errors


@dataclass(frozen=True)
class MeasureChange:
    """Change of a measure by an effect.

    metric     : one of `COMPARED`
    value      : with the effect, less without it (the mean of the perturbed runs)
    half_width : of the interval in which another run with nothing changed would lie, and how far the scene's
                 own run is off those of the other accuracy
    digit      : the last one that is printed of the measure; of a stored time the time between two
    """

    metric: Metric
    value: float
    half_width: float
    digit: float = 0.0

    @property
    def significant(self) -> bool:
        """False if errors, or digits that are not printed, may make the change."""
        return abs(self.value) > max(self.half_width, self.digit)


@dataclass(frozen=True)
class _Noise:
    """Changes by errors alone.

    moved    : (n_times,) largest displacement [m]; infinite from when on a run had ended
    measures : of each run, that of the scene itself first, by name
    outcomes : number of runs of each capture outcome; empty without [capture]
    """

    moved: Floats
    measures: tuple[Mapping[str, Metric], ...]
    outcomes: Mapping[str, int]


@dataclass(frozen=True)
class Toggled:
    """One effect toggled.

    found    : its finding over the whole scene
    until    : time [s] up to which it could be measured; 0: not at all
    estimate : displacement over the size of the net up to then, estimated
    measured : the same, measured: the largest root mean square over the mass at a stored time
    measures : changes of measures by the effect's presence: of deployment where the net has a mouth, of a
               capture where the case has [capture]
    outcomes : number of runs of each capture outcome with nothing changed; became : outcome of that toggled
    wall     : integration time with the effect over that without
    failure  : why the run with the effect toggled was not made, or stopped; "" if it ended well
    """

    found: Finding
    until: float = 0.0
    estimate: float = 0.0
    measured: float = 0.0
    measures: tuple[MeasureChange, ...] = ()
    wall: float = 1.0
    outcomes: Mapping[str, int] = field(default_factory=dict)
    became: str = ""
    failure: str = ""

    @property
    def ratio(self) -> float | None:
        """Estimate over measurement; None if nothing could be measured."""
        return self.estimate / self.measured if self.measured > 0.0 else None


def ablate(
    scene: Scene, names: tuple[str, ...] | None = None, progress: ProgressOfRuns | None = None
) -> Iterator[Toggled]:
    """Toggle effects one after the other, and first what closes the mouth; raises as `run` does if the scene
    itself does not run.

    names    : which effects, or "closing"; None: all
    progress : called with what is running and the simulated time [s]
    """
    findings = [*of_closing(scene), *survey(scene)]
    scene = _settled(scene)
    base = _run(scene, "as it is", progress)
    noise = _noise(scene, base, progress)
    for found in findings:
        if names is None or found.name in names:
            yield _toggle(scene, found, base, noise, progress)


def of_closing(scene: Scene) -> list[Finding]:
    """Finding of the closing of the mouth, without an estimate; empty without closing."""
    return [] if scene.closing is None else [Finding(CLOSING, True, scene.closing, "", None, 0.0)]


def _toggle(
    scene: Scene, found: Finding, base: Result, noise: _Noise, progress: ProgressOfRuns | None
) -> Toggled:
    if found.keys is None:
        return Toggled(found, failure="not estimated: there is nothing to assume for this scene")
    other = toggled(scene, found)
    if wrongs := [f"{fault.path[0]} {fault.reason}" for fault in cross_checks(other)]:
        return Toggled(found, failure=f"cannot be toggled alone: {wrongs[0]}")
    try:
        result = _run(other, f"{found.name} {'off' if found.on else 'on'}", progress)
    except RunStopped as stop:
        if isinstance(stop, Interrupted):
            raise
        return Toggled(found, failure=str(stop))
    except CaseError as error:
        return Toggled(found, failure=f"cannot be toggled here: {'; '.join(map(str, error.faults))}")
    with_it, without = (base, result) if found.on else (result, base)
    apart = _distance(base, result)
    moved = noise.moved[: len(apart)]
    until, measured, estimate = 0.0, 0.0, 0.0
    clear = np.flatnonzero(apart > CLEAR * moved)
    if len(clear):
        lost = np.flatnonzero(apart[clear[0] :] <= CLEAR * moved[clear[0] :])
        last = clear[0] + lost[0] - 1 if len(lost) else len(apart) - 1
        until = float(base.time[last])
        measured = float(apart[: last + 1].max()) / base.net.size
        estimate = 0.0 if found.estimate is None else finding(scene, found.name, until).relative
    slow, fast = (run.run.cost.integration_seconds for run in (with_it, without))
    wall = slow / fast if fast else 1.0
    between = float(np.diff(base.time).max())
    changes = measure_changes(noise.measures, _measures(result), -1.0 if found.on else 1.0, between)
    return Toggled(found, until, estimate, measured, changes, wall, noise.outcomes, _outcome(result))


def _settled(scene: Scene) -> Scene:
    """The scene with what effects.choose = "auto" has chosen, which then does not choose again."""
    with collected() as faults:
        scene, _ = chosen(scene, faults)
    effects = scene.effects.model_copy(update={"choose": None, "threshold": None})
    return scene.model_copy(update={"effects": effects})


def toggled(scene: Scene, found: Finding) -> Scene:
    """The scene with the effect of a finding switched off, or on with its keys."""
    if found.name == CLOSING:
        script = tuple(
            _noted(item) if CLOSING in (item.drive, _owner(item)) else item for item in scene.script
        )
        return scene.model_copy(update={"closing": None, "script": script})
    switched = scene.effects.model_copy(update={found.name: None if found.on else found.keys})
    update: dict[str, Any] = {"effects": switched}
    if EFFECTS[found.name].REPLACES_LAUNCH and not found.on:
        update["launch"] = None
    return scene.model_copy(update=update)


def _owner(entry: ScriptEntry) -> str:
    return (entry.on or "").partition(".")[0] if entry.do == "set" else ""


def _noted(entry: ScriptEntry) -> ScriptEntry:
    acts = ("do", "on", "rate", "force", "torque", "duration", "value")
    kept = {name: getattr(entry, name) for name in entry.model_fields_set if name not in acts}
    return ScriptEntry.model_validate({**kept, "do": "note"})


def _noise(scene: Scene, base: Result, progress: ProgressOfRuns | None) -> _Noise:
    """Differences of perturbed runs with another accuracy from the scene's own run."""
    moved, every = np.zeros(len(base.time)), [base]
    for number in range(STARTS):

        def perturbed(start: Start, seed: int = SEED + number) -> Start:
            moved = nearby_start(start, MOVE / start.net.size, seed)
            return replace(moved, plan=of_other_accuracy(start.plan))

        again = _run(scene, f"perturbed run {number + 1}", progress, perturbed)
        apart = _distance(base, again)
        moved[: len(apart)] = np.maximum(moved[: len(apart)], apart)
        moved[len(apart) :] = np.inf
        every.append(again)
    outcomes = Counter(one for result in every if (one := _outcome(result)))
    return _Noise(moved, tuple(_measures(item) for item in every), dict(outcomes.most_common()))


def _run(
    scene: Scene, what: str, progress: ProgressOfRuns | None, change: Callable[[Start], Start] | None = None
) -> Result:
    brief = scene.time.model_copy(update={"end": BRIEF * scene.time.end, "output_times": ()})
    simulate(prepare(scene.model_copy(update={"time": brief})))  # so that no first use is timed
    start = prepare(scene)
    report = (lambda time, *_: progress(what, time)) if progress else None
    if progress:
        progress(what, 0.0)
    return simulate(change(start) if change else start, progress=report)


def _distance(a: Result, b: Result) -> Floats:
    """(k,) root mean square over the mass of how far the nodes are apart [m], at the times of both.

    A script may end runs, each at its own time.
    """
    mass = np.array(a.net.mass)
    mass[a.net.fixed_nodes] = 0.0
    shorter = min(len(a.time), len(b.time))
    same = int(np.argmin(np.append(a.time[:shorter] == b.time[:shorter], False)))
    apart = a.position[:same] - b.position[:same]
    return np.sqrt(np.einsum("n,tna,tna->t", mass, apart, apart) / mass.sum())


def _measures(result: Result) -> dict[str, Metric]:
    """Metrics of deployment and of a capture, by key, as far as the run has them."""
    found = metrics_of(Observables(result))
    return {key: found[key] for key in COMPARED if key in found}


def _outcome(result: Result) -> str:
    """Capture outcome; "" without [capture]."""
    found = outcome(Observables(result))
    return "" if found is None else found.outcome.value


def measure_changes(
    same: Sequence[Mapping[str, Metric]], changed: Mapping[str, Metric], sign: float, between: float
) -> tuple[MeasureChange, ...]:
    """Compute the change of each metric that all runs have, and the half width of runs with nothing changed.

    Parameters
    ----------
    same : sequence of dict
        Metrics by key of the runs with nothing changed; the first is the scene's own run.
    changed : dict
        Metrics by key of the run with the effect toggled.
    sign : float
        1.0 if the effect is on in the changed run, -1.0 if it is off there.
    between : float
        Interval between stored times [s], the resolution of times of stored states.

    Returns
    -------
    tuple of MeasureChange
        In the order of `changed`.
    """
    found = []
    for key, metric in changed.items():
        if all(key in each for each in same):
            values = np.array([each[key].value for each in same])
            change = sign * (metric.value - float(values.mean()))
            half_width = float(around_one_more(values)) + abs(float(values[0] - values[1:].mean()))
            size = max(float(np.abs(values).max()), abs(metric.value))
            digit = between if metric.instant == STORED else metric.last_digit(size)
            found.append(MeasureChange(metric, change, half_width, digit))
    return tuple(found)
