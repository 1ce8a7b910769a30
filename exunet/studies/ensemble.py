"""Many runs of one net from perturbed starts, by the compiled loop on all cores, and their measures."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from numbers import Integral, Real
from threading import Event, local
from typing import Any

import numpy as np
from numpy.typing import NDArray

from exunet.base.arguments import takes
from exunet.base.errors import InputError, RunStopped
from exunet.base.short_repr import ShortRepr
from exunet.bodies.distance import Mover, Path
from exunet.bodies.rigid import RigidStates
from exunet.bodies.shapes import Shape
from exunet.bodies.wireframe import from_centre
from exunet.forces.from_outside import effects_of
from exunet.integrators.compiled.loop import loop_kernel
from exunet.integrators.compiled.vectorised_runs import RunsSideBySide, side_by_side_kernel
from exunet.kernels.compile import WIDTH
from exunet.kernels.kernel import Kernel
from exunet.methods.method import COMPILED_METHODS, METHODS
from exunet.model.ejection import Ejection
from exunet.results.capture import Measures
from exunet.results.clearance import Pair
from exunet.results.course import CONTACT, LINE, SELF, Course, winches_of
from exunet.results.margins import Groups, Peak
from exunet.results.over_time import OVER_TIME
from exunet.results.pulls import PulledPlace
from exunet.results.taken import taken_of
from exunet.scene.capture import CaptureCriterion
from exunet.simulation.extremes import series_of
from exunet.simulation.preparation import Start
from exunet.simulation.rollback import finer
from exunet.studies.measured import MEASURED, Measured, PulledPlaces, shown_bodies, shown_pairs
from exunet.studies.measured_runs import MeasuredRun, one_run, runs_side_by_side, times_until
from exunet.studies.perturbation import perturbed, perturbed_bodies

Floats = NDArray[np.float64]


@dataclass(frozen=True, repr=False)
class Ensemble(ShortRepr, Measured):
    """Measures of all runs at the stored times; those of `Measured` and `OverTime` too, as (runs, t, ...).

    Of a run that its script ended before the last of the times, these have its last state from then on.
    time          : (t,) [s]
    contact       : (runs, t, n_series) what is stored of contacts and of a closing line
    ends          : (runs, 2, n_bodies + n_outside + 1) records `exunet.results.ends.END` at the start and
                     at the end
    ejection      : (runs,) work of the ejection of the net [J]; zeros unless the scene `ejects` it
    peaks         : (runs, n_groups, 3) largest tension of all steps of each group of elements [N], when [s],
                    and in which element
    largest_tension, time_of_largest_tension : (runs,) of all steps, stored or not [N], [s]
    element_of_largest_tension : (runs,) in which element; -1: none was ever taut
    right_hand_sides : (runs,) evaluations of the forces
    ended, stopped : (runs,) when each ended [s], and with which verdict of a script, "" at its time
    breaks        : of each run when elements broke [s]; None: nothing can break
    awaited       : of each run when entries of its script happened, whose times the case does not give [s]
    peak_names    : of these groups (`Net.spans`)
    body_names, tether_names, reel_names : of those bodies and tethers
    pulled        : the places of `pull`
    taken_names   : of what has taken the energies `taken`
    turning, guided : the bodies that have an attitude; those whose motion is given
    outside       : effects whose impulse is kept
    pairs, shapes : of bodies with shapes, their names; their shapes, from their centres of mass
    groups        : of elements whose strength is known; None: of none
    rule          : of the capture; None: the case has none
    contact_names : of these series
    """

    time: Floats
    ends: NDArray[np.void]
    ejection: Floats
    peaks: Floats
    largest_tension: Floats
    time_of_largest_tension: Floats
    element_of_largest_tension: NDArray[np.int64]
    right_hand_sides: NDArray[np.int64]
    contact: Floats
    ended: Floats
    stopped: NDArray[np.str_]
    breaks: tuple[tuple[float, ...] | None, ...]
    awaited: tuple[Mapping[str, tuple[float, ...]], ...]
    peak_names: tuple[str, ...] = ()
    body_names: tuple[str, ...] = ()
    ejects: bool = False
    turning: tuple[str, ...] = ()
    guided: tuple[str, ...] = ()
    outside: tuple[str, ...] = ()
    tether_names: tuple[str, ...] = ()
    reel_names: tuple[str, ...] = ()
    pulled: tuple[PulledPlace, ...] = ()
    taken_names: tuple[str, ...] = ()
    pairs: tuple[Pair, ...] = ()
    shapes: Mapping[str, Shape] = field(default_factory=dict)
    groups: Groups | None = None
    rule: CaptureCriterion | None = None
    contact_names: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.area)

    def course(self, run: int, achievable_area: float) -> Course:
        """One of the runs, for its headlines; achievable_area: of its net [m2]."""
        time = times_until(self.time, float(self.ended[run]))
        rows = slice(len(time))
        return Course(
            time=time,
            achievable_area=achievable_area,
            peaks={
                name: Peak(float(tension), float(time), int(element))
                for name, (tension, time, element) in zip(self.peak_names, self.peaks[run], strict=True)
            },
            body_names=self.body_names,
            turning=self.turning,
            guided=self.guided,
            outside=self.outside,
            ends=self.ends[run],
            ejection=float(self.ejection[run]) if self.ejects else None,
            tether_names=self.tether_names,
            reel_names=self.reel_names,
            pulled=self.pulled,
            taken_names=self.taken_names,
            pairs=self.pairs,
            movers=self._movers(run, time),
            groups=self.groups,
            rule=self.rule,
            capture=None if self.rule is None else Measures(*self.capture[run, rows].T),
            line=self._series(run, rows, LINE),
            contact=self._series(run, rows, CONTACT),
            together=self._series(run, rows, SELF),
            stopped=str(self.stopped[run]),
            breaks=self.breaks[run],
            awaited=self.awaited[run],
            **{name: getattr(self, name)[run, rows] for name in OVER_TIME},
        )

    def _series(self, run: int, rows: slice, prefix: str) -> dict[str, Floats]:
        """What is stored under names that begin so, of one of the runs."""
        every = enumerate(self.contact_names)
        return {name: self.contact[run, rows][:, k] for k, name in every if name.startswith(prefix)}

    def _movers(self, run: int, time: Floats) -> dict[str, Mover]:
        """The bodies of `pairs` in one of the runs."""
        found = {}
        for k, (name, shape) in enumerate(self.shapes.items()):
            parts = np.split(self.motion[run, : len(time), k], (3, 6, 10), axis=1)
            found[name] = Mover(Path(time, *parts), shape)
        return found


@takes(start=Start)
def perturbed_positions(start: Start, runs: int, amplitude: float, seed: int, *, first: int = 0) -> Floats:
    """(runs, n_nodes, 3) initial positions, each coordinate of free nodes moved by up to +-amplitude [m].

    first : number of the first of the runs
    Run k gets the same perturbation however many runs there are. Raises InputError for a number of runs, a
    seed or an amplitude that is out of range.
    """
    require_whole_number("runs", runs, at_least=0)
    require_whole_number("seed", seed, at_least=0)
    require_whole_number("first", first, at_least=0)
    if not (isinstance(amplitude, Real) and 0.0 <= float(amplitude) < float("inf")):
        raise InputError(f"amplitude: must be a finite number of metres, 0 or more, got {amplitude!r}")
    found = [
        perturbed(start.net, start.position, amplitude, (seed, run)) for run in range(first, first + runs)
    ]
    return np.array(found).reshape(-1, *start.position.shape)


def perturbed_bodies_of(
    start: Start, runs: int, amplitude: float, seed: int, *, first: int = 0
) -> RigidStates | None:
    """The bodies beside `perturbed_positions`, with a leading axis of runs; None of a scene without bodies.

    amplitude : [m], and of their attitudes and angular velocities [rad], [rad/s]
    """
    if not start.system.bodies or not runs:
        return None
    found = [perturbed_bodies(start, amplitude, (seed, run, 1)) for run in range(first, first + runs)]
    return RigidStates(*(np.stack(parts) for parts in zip(*(item.parts() for item in found), strict=True)))


@takes(start=Start, progress=Callable, bodies=RigidStates, together=bool)
def run_ensemble(
    start: Start,
    position: Floats,
    velocity: Floats | None = None,
    workers: int | None = None,
    *,
    retries: int = 0,
    progress: Callable[[int], None] | None = None,
    first: int = 0,
    together: bool | None = None,
    bodies: RigidStates | None = None,
) -> Ensemble:
    """Run `start` once from each initial state; the bits of a run depend on nothing but its start.

    position, velocity : (runs, n_nodes, 3) [m], [m/s]; velocity None: that of `start` for all
    workers            : threads (compiled code runs beside each other); None: one a core
    retries            : how often a run that fails because of its steps begins anew with finer ones
    progress           : called with the number of runs that are done, after each of them
    first              : number of the first run in the words of errors
    together           : runs go side by side through compiled code where they can; None: where it pays
    bodies             : states of the rigid bodies, with a leading axis of runs; None: those of `start`
    Raises RunStopped, naming the run, if one diverges or its steps collapse; MissingExtra without Numba;
    InputError for a method that the compiled loop does not have, states of another shape or that are not
    finite numbers, or a number of workers below 1; KeyboardInterrupt on Ctrl-C.
    """
    if start.plan.method not in COMPILED_METHODS:
        words = f"an ensemble runs by {', '.join(COMPILED_METHODS)}, not by {start.plan.method}"
        if start.scene.solver.method == "auto":
            words += ', which auto chose for Exudyn: set engine.backend = "auto", or "compiled"'
        raise InputError(words)
    require_whole_number("retries", retries, at_least=0)
    require_whole_number("first", first, at_least=0)
    if workers is not None:
        require_whole_number("workers", workers, at_least=1)
    position = _states("position", position, start.system.blocks.n_points, None)
    if velocity is None:
        speeds = np.broadcast_to(start.velocity, position.shape)
    else:
        speeds = _states("velocity", velocity, start.system.blocks.n_points, len(position))
    times = start.scene.time.stored_times
    kernel, stop, own = loop_kernel(start.system), Event(), local()
    shared = kernel_of_many(start, len(position), together)

    def one(run: int) -> MeasuredRun:
        moved = start.moved(position[run], speeds[run], None if bodies is None else bodies[run])
        for left in range(retries, -1, -1):
            try:
                return one_run(moved, kernel, times, stop)
            except RunStopped as found:
                plan = finer(moved.plan) if found.step_cause and left else None
                if plan is None:
                    raise RunStopped(f"run {first + run} of the ensemble {found}") from found
                moved = replace(moved, plan=plan)
        raise AssertionError("the last attempt returns or raises")

    def begin() -> None:
        """In each thread."""
        if shared is not None:
            own.loop = RunsSideBySide(start.system, start.plan, shared)

    def several(runs: range) -> list[MeasuredRun]:
        moved = [start.moved(position[run], speeds[run]) for run in runs]
        found = runs_side_by_side(moved, own.loop, times, stop) if shared else [None] * len(runs)
        # A run that stops among others does so alone, where it may begin anew with finer steps.
        return [one(run) if done is None else done for run, done in zip(runs, found, strict=True)]

    width = WIDTH if shared else 1
    groups = [range(k, min(k + width, len(position))) for k in range(0, len(position), width)]
    with ThreadPoolExecutor(workers or os.cpu_count() or 1, initializer=begin) as pool:
        try:
            found = []
            for group in pool.map(several, groups):
                for done in group:
                    found.append(done)
                    if progress is not None:
                        progress(len(found))
        except BaseException:
            stop.set()
            pool.shutdown(wait=True, cancel_futures=True)
            raise
    return _stacked(start, times, found)


def require_whole_number(name: str, given: object, at_least: int) -> None:
    """Raise InputError for an argument that is no whole number, or too small a one."""
    if isinstance(given, bool) or not isinstance(given, Integral) or given < at_least:
        raise InputError(f"{name}: must be a whole number, {at_least} or more, got {given!r}")


def metres(name: str, given: object) -> None:
    """Raise InputError for an argument that is no length, or a negative one."""
    if isinstance(given, bool) or not (isinstance(given, Real) and 0.0 <= float(given) < float("inf")):
        raise InputError(f"{name}: must be a finite number of metres, 0 or more, got {given!r}")


def _states(name: str, given: object, n_points: int, runs: int | None) -> Floats:
    """(runs, n_points, 3) finite floats, at least one run."""
    wanted = f"({runs if runs is not None else 'runs'}, {n_points}, 3)"
    try:
        states = np.asarray(given)
    except ValueError:
        raise InputError(f"{name}: initial states must be {wanted}, got rows of different lengths") from None
    if states.ndim != 3 or states.shape[1:] != (n_points, 3) or len(states) != (runs or len(states)):
        raise InputError(f"{name}: initial states must be {wanted}, got {states.shape}")
    if not len(states):
        raise InputError(f"{name}: there is no run in it")
    if states.dtype.kind not in "iuf" or not np.isfinite(states).all():
        raise InputError(f"{name}: initial states must be finite numbers, got an array of {states.dtype}")
    return states.astype(np.float64)


def _held(values: Floats, number: int) -> Floats:
    """Values (k, ...) with the last of them as often as is missing of a number."""
    left = number - len(values)
    return np.concatenate([values, np.repeat(values[-1:], left, axis=0)]) if left else values


def _stacked(start: Start, times: Floats, found: Sequence[MeasuredRun]) -> Ensemble:
    columns: dict[str, Any] = {
        name: np.array([_held(getattr(run.states, name), len(times)) for run in found]) for name in MEASURED
    }
    for name in set(MeasuredRun._fields[1:]) - {"contact", "breaks", "awaited"}:  # of the whole run
        columns[name] = np.array([getattr(run, name) for run in found])
    columns["breaks"] = tuple(run.breaks for run in found)
    columns["awaited"] = tuple(run.awaited for run in found)
    columns["contact"] = np.array([_held(run.contact, len(times)) for run in found])
    blocks, free = start.system.blocks, start.system.moves_freely
    return Ensemble(
        time=times,
        **columns,
        peak_names=tuple(start.net.spans),
        body_names=(*blocks.body, *blocks.rigid),
        ejects=start.system.ejection is not None
        or any(switch.heading == Ejection.heading for _, switch in start.system.forces.switches),
        turning=blocks.rigid,
        guided=tuple(name for name, moves in zip(blocks.rigid, free, strict=True) if not moves),
        outside=effects_of(state.name for state in blocks.states),
        tether_names=tuple(start.net.tether_elements),
        reel_names=winches_of(item.name for item in blocks.states),
        pulled=PulledPlaces.of(start).places,
        taken_names=taken_of(entry.name for entry in blocks.states),
        pairs=tuple(shown_pairs(start.system)),
        shapes={
            body.name: from_centre(body.shape, np.array(body.centre))
            for body in shown_bodies(start.system)
            if body.shape is not None
        },
        groups=Groups.of(start.net),
        rule=start.scene.capture,
        contact_names=tuple(one.name for _, one in series_of(start.system)),
    )


# Element forces over all runs, below which side by side is not worth its compilation: some 10 s one by one.
_PAYS = 2e9


def kernel_of_many(start: Start, runs: int, together: bool | None = None) -> Kernel | None:
    """Return the kernel that takes several runs side by side; None where that cannot be, or does not pay.

    together : True, False: wanted or not; None: if it is compiled already, or the runs take long
    """
    kernel = None if together is False else side_by_side_kernel(start.system, start.plan)
    if kernel is None or together or kernel.compiled_before:
        return kernel
    assert start.plan.step is not None  # side by side only fixed steps
    steps = runs * start.scene.time.end / start.plan.step
    return kernel if steps * METHODS[start.plan.method].stages * start.net.n_elements > _PAYS else None
