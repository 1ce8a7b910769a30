"""Record of a run: the rows of its stored states, and what its result has beside them."""

from __future__ import annotations

import platform
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from exunet.base.arrays import Floats
from exunet.base.errors import InputError
from exunet.base.machine import MEMORY_VARIABLE, disk_left, memory_left
from exunet.base.version import VERSION
from exunet.bodies.rigid import in_frames
from exunet.bodies.shapes import packed
from exunet.forces.effects.gravity import Gravity
from exunet.forces.effects.orbit import Orbit
from exunet.forces.terms import DiscreteStates, Series
from exunet.integrators.exudyn.engine import exudyn_version
from exunet.integrators.protocol import Arrays, StepCounts
from exunet.methods.method import Plan
from exunet.model.ejection import HELD
from exunet.model.states import States
from exunet.model.system import System
from exunet.net.closing import NAME as CLOSING
from exunet.net.tether import reels_of
from exunet.results.io import result_of_rows
from exunet.results.result import (
    OPTIONAL,
    PATHS,
    STATES,
    BodyConstants,
    Column,
    Result,
    body_path,
    declare,
    state_column,
)
from exunet.results.run_record import (
    Carried,
    CaseText,
    Cost,
    EntryRecord,
    Release,
    Retry,
    RunRecord,
    UnitSettings,
    WinchLimits,
)
from exunet.results.store import MemoryStore, RowStore
from exunet.scene.script import awaited_entries, drive_of, ejects
from exunet.simulation.block import Observed
from exunet.simulation.observers import (
    STATES_A_LOOK,
    EnergyBalance,
    Event,
    EventLog,
    Observer,
    RunningExtremes,
)
from exunet.simulation.preparation import Start

DISK_COPIES = 2  # of the stored states, while they are written into the result at the end of a run
_BATCH, _BATCH_BYTES = 256, 8 << 20  # most stored states, and their size, that wait to be appended


def constants_of_bodies(system: System) -> dict[str, BodyConstants]:
    """Return the constants of the bodies, by name."""
    return {
        body.name: BodyConstants(
            body.mass,
            body.inertia_in_frame,
            _fixed_to(system, k),
            **packed(body.shape, np.array(body.centre)),
        )
        for k, body in enumerate(system.bodies)
    }


def _fixed_to(system: System, number: int) -> NDArray[np.int64] | None:
    nodes = system.kinematics.point[system.kinematics.body == number]
    return nodes if len(nodes) else None


def columns_of(system: System, *, stores_energies: bool = True) -> tuple[Column, ...]:
    """Return the columns that are stored of each state; stores_energies: as of `Recorder`."""
    declared = declare(system.net.n_nodes, system.net.n_elements, constants_of_bodies(system))
    optional = {PATHS[name] for name in OPTIONAL}
    states = (state_column(state.name, len(state.initial), state.units) for state in system.blocks.states)
    series = (state_column(one.key, one.size, one.units) for _, one in series_of(system))
    return (
        *(column for column in declared if stores_energies or column.path not in optional),
        *states,
        *series,
    )


def stored_bytes(start: Start) -> int:
    """Return the bytes of all states that a run stores."""
    row = sum(column.row_bytes for column in columns_of(start.system))
    return len(start.scene.time.stored_times) * row


def validate_disk(start: Start, folder: Path) -> None:
    """Raise InputError if the states of a run do not fit on the disk of its folder."""
    needed, free = DISK_COPIES * stored_bytes(start), disk_left(folder)
    if free is not None and needed > free:
        states = len(start.scene.time.stored_times)
        raise InputError(
            f"{folder}: {states} stored states need {needed / 1e9:.3g} GB of disk, {free / 1e9:.3g} GB are "
            "free: use a larger time.output_step, or another folder (--out)"
        )


def validate_memory(what: str, needed: int) -> None:
    """Raise InputError if some bytes exceed the free memory; what : begins the message."""
    free = memory_left()
    if free is not None and needed > free:
        needs = f"{what} need {needed / 1e9:.3g} GB of memory, {free / 1e9:.3g} GB are free"
        raise InputError(f"{needs}: use fewer, or set {MEMORY_VARIABLE}")


def series_of(system: System) -> tuple[tuple[str, Series], ...]:
    """Return the recorded entries of discrete states of a system, each with the name of its state."""
    discrete_states = (term.discrete for term in system.forces.discrete_states)
    return tuple(
        (discrete.name, series)
        for discrete in discrete_states
        if discrete is not None
        for series in discrete.series
    )


class _Waiting(NamedTuple):
    """Marked states that are not appended yet; intervals, discrete_states : those of `Observed`, of each."""

    states: States
    dissipated: Floats
    intervals: Floats
    discrete_states: list[DiscreteStates]


class Recorder(Observer):
    """Record of a run over all its attempts: marked states as rows, and what the result has beside them.

    times    : (n,) of the states to be stored [s]
    stores_energies : False without extremes of all steps: of energies, and of the tension of each element
    every    : see `EnergyBalance`
    extremes : observer of largest tensions and, by stores_energies, of energies of all steps
    balance, log : observers of the energy and of events
    record   : what the result records of the run so far
    """

    def __init__(
        self,
        start: Start,
        case: CaseText | None = None,
        store: RowStore | None = None,
        *,
        stores_energies: bool = True,
        every: int = STATES_A_LOOK,
    ) -> None:
        self._start = start
        self.times = start.scene.time.stored_times
        self.stores_energies = stores_energies
        self.extremes = RunningExtremes(start.system, stores=stores_energies)
        self.balance, self.log = EnergyBalance(start.system, start.state, every=every), EventLog(start.system)
        self._series = series_of(start.system)
        columns = columns_of(start.system, stores_energies=stores_energies)
        self.rows: RowStore = MemoryStore(columns, len(self.times)) if store is None else store
        row_bytes = sum(column.row_bytes for column in self.rows.columns)
        self._batch = max(1, min(_BATCH, _BATCH_BYTES // max(1, row_bytes)))
        self.record = replace(initial_record(start), case=case or CaseText())
        self._waiting: list[_Waiting] = []
        self._last = np.zeros((0, 2))  # elastic and kinetic energy of the last row [J]
        self._read_last()

    def __len__(self) -> int:
        return len(self.rows) + self._n_waiting

    @property
    def _n_waiting(self) -> int:
        return sum(len(part.states) for part in self._waiting)

    @property
    def until(self) -> float:
        """The last stored time [s]."""
        if self._waiting:
            return float(self._waiting[-1].states.time[-1])
        return float(self.rows.read("time", len(self.rows) - 1, len(self.rows))[0])

    def observe(self, steps: Observed) -> None:
        """Store the marked states."""
        if steps.marks:
            if self._n_waiting >= self._batch:
                self.flush()
            rows = np.array(steps.marks)
            states, dissipated = steps.states[rows], steps.dissipated[rows]
            self._waiting.append(_Waiting(states, dissipated, self.extremes.intervals, steps.discrete_states))

    def changed(self, event: Event) -> None:
        """Store the state after an event in place of the last, if it is of the same time."""
        if (event.change.x is None and event.change.v is None) or self.until != event.time:
            return
        dissipated = np.array([self.balance.dissipated])
        assert event.after is not None
        if not self._waiting:
            self._replace_last(event.after, dissipated)
            return
        last = self._waiting.pop()
        if len(last.states) > 1:
            before = _Waiting(
                last.states[:-1], last.dissipated[:-1], last.intervals[:-1], last.discrete_states[:-1]
            )
            self._waiting.append(before)
        self._waiting.append(
            _Waiting(event.after, dissipated, last.intervals[-1:], last.discrete_states[-1:])
        )

    def _replace_last(self, state: States, dissipated: Floats) -> None:
        """Store a state in place of the last row, of which extremes and series are kept."""
        number = len(self.rows)
        last = {column.path: self.rows.read(column.path, number - 1, number) for column in self.rows.columns}
        self.rows.drop_after(number - 1)
        self._read_last()
        intervals = np.zeros((1, 2))  # not used without energies
        if self.stores_energies:
            intervals = np.stack([last["energy/largest_elastic"], last["energy/least_kinetic"]], axis=-1)
        series = (f"{STATES}{one.key}" for _, one in self._series)
        kept = {path: last[path] for path in series}
        self.rows.append(self._rows(_Waiting(state, dissipated, intervals, [])) | kept)

    def save(self) -> dict[str, NDArray[Any]]:
        return {"rows": np.array([len(self)])}

    def load(self, arrays: Arrays) -> None:
        self.flush()
        number = int(arrays["rows"][0])
        if number < len(self):
            self.rows.drop_after(number)
            self._read_last()

    def _read_last(self) -> None:
        """Read the energies of the last row."""
        number = len(self.rows)
        stored = (self.rows.read(f"energy/{name}", number - 1, number) for name in _LAST)
        self._last = np.stack(list(stored), axis=-1) if number else np.zeros((0, 2))

    def flush(self) -> None:
        """Append the states that wait as one batch."""
        parts = [self._rows(waiting) for waiting in self._waiting]
        if len(parts) > 1:
            parts = [{path: np.concatenate([part[path] for part in parts]) for path in parts[0]}]
        for rows in parts:
            self.rows.append(rows)
        self._waiting.clear()

    def _rows(self, waiting: _Waiting) -> dict[str, Floats]:
        """Rows of states."""
        states, dissipated, intervals, discrete_states = waiting
        net, blocks = self._start.net, self._start.system.blocks
        rows = {
            "time": states.time,
            "net/position": states.position[:, : net.n_nodes],
            "net/velocity": states.velocity[:, : net.n_nodes],
            "net/strain": states.strain,
            "net/tension": states.tension,
            "energy/kinetic": states.kinetic,
            "energy/elastic": states.elastic,
            "energy/potential": states.potential,
            "energy/dissipated": dissipated,
            "momentum/linear": states.momentum,
            "momentum/angular": states.angular_momentum,
        }
        if self.stores_energies:
            energies = np.stack([states.elastic, states.kinetic], axis=-1)
            before = np.concatenate([self._last if len(self._last) else energies[:1], energies[:-1]])
            largest = np.maximum(intervals[:, 0], np.maximum(energies[:, 0], before[:, 0]))
            least = np.minimum(intervals[:, 1], np.minimum(energies[:, 1], before[:, 1]))
            rows |= {"energy/largest_elastic": largest, "energy/least_kinetic": least}
            self._last = energies[-1:]
        bodies = self._start.system.bodies
        for k, body in enumerate(bodies):
            for quantity, values in vars(in_frames(bodies, states.bodies)).items():
                rows[body_path(body.name, quantity)] = values[:, k]
        at = 0
        for state in blocks.states:
            rows[STATES + state.name] = states.first_order[:, at : at + len(state.initial)]
            at += len(state.initial)
        for name, series in self._series:
            own = np.arange(series.place, series.place + series.size)  # from the end if negative
            rows[f"{STATES}{series.key}"] = np.array([discrete[name][own] for discrete in discrete_states])
        return rows

    def built(self, plan: Plan, items: dict[str, int], seconds: float) -> None:
        cost = replace(self.record.cost, build_seconds=self.record.cost.build_seconds + seconds)
        self.record = replace(self.record, items=items, cost=cost)

    def integrated(self, counts: StepCounts, seconds: float) -> None:
        """Record the cost of the integration, all attempts together."""
        cost = Cost(
            counts.steps,
            counts.rejected,
            counts.right_hand_sides,
            counts.newton_iterations,
            self.record.cost.build_seconds,
            seconds,
        )
        self.record = replace(self.record, cost=cost)

    def retried(self, stopped: str, time: float, plan: Plan) -> None:
        setting = f"tolerance {plan.tolerance:.3g}" if plan.step is None else f"step {plan.step:.3g}"
        note = f"retried from t = {time:.6g} s with {setting}: {stopped.split(';')[0]}"
        before = self._start.plan if self.record.plan is None else self.record.plan
        retry = Retry(stopped, time, plan.tolerance, plan.step)
        plan = replace(plan, notes=(*before.notes, note))
        self.record = replace(self.record, plan=plan, retries=(*self.record.retries, retry))

    def restore(self, record: RunRecord) -> None:
        """Restore plan and retries of a record."""
        self.record = replace(self.record, plan=record.plan, retries=record.retries)

    def finish(self, verdict: str) -> RunRecord:
        """Append the states that wait and return the record for the result; verdict: "ok", or the error."""
        self.flush()
        self.record = replace(
            self.record,
            verdict=verdict,
            largest_tensions=self.extremes.of_groups(),
            peak_tensions_N=self.extremes.elements.tolist() if self.stores_energies else None,
            energy_scale_J=self.balance.energy_scale,
            events=tuple(self.log.events),
        )
        return self.record

    def result(self, verdict: str) -> Result:
        """Return the result so far; complete if the verdict is "ok"."""
        bodies, record = constants_of_bodies(self._start.system), self.finish(verdict)
        return result_of_rows(self.rows, self._start.net, bodies, record, "the run")


_LAST = ("elastic", "kinetic")


def initial_record(start: Start) -> RunRecord:
    """Return what is known of a run before the first step."""
    scene, system, control = start.scene, start.system, start.scene.control
    awaited = awaited_entries(scene.script)
    shapes = {body.name: body.shape for body in system.bodies if body.shape is not None}
    units = None
    if control is not None:
        units = UnitSettings(control.kind, control.bullets, control.period, control.specific_impulse)
    return RunRecord(
        title=scene.title,
        versions=_versions(),
        platform=platform.platform(),
        plan=start.plan,
        end=scene.time.end,
        effects=tuple(sorted(scene.effects.on)),
        capture=scene.capture,
        units=units,
        can_break=system.forces.cable.switch is not None,
        carried=_carried(start),
        releases=[
            Release(name, int(tie.points[0]), system.bodies[tie.body].name, tie.start > 0)
            for name, tie in system.kinematics.ties.items()
        ],
        script_entries=[
            EntryRecord(item.name, item.trigger_words, item.action_words, item.name in awaited)
            for item in scene.script
        ],
        restart=start.restart,
        winch=_winch(start),
        edge_radii={name: shape.edge_radius for name, shape in shapes.items() if shape.edge_radius > 0.0},
        grid_spacings={
            name: shape.grid_spacing for name, shape in shapes.items() if shape.grid_spacing is not None
        },
        closing_path=[] if system.line is None else list(system.line.path),
        drums={reel.name: int(reel.nodes[0]) for reel in reels_of(start.net, scene.tethers)},
        up=_up(start),
    )


def _up(start: Start) -> list[float]:
    """Return the unit vector against gravity, or along the radial of an orbit; empty without both."""
    gravity, orbit = start.scene.effects.get(Gravity), start.scene.effects.get(Orbit)
    up = np.zeros(3) if orbit is None else np.array(orbit.radial)
    up = up if gravity is None else -np.array(gravity.acceleration)
    return (up / np.linalg.norm(up)).tolist() if up.any() else []


def _winch(start: Start) -> WinchLimits | None:
    """Return the limits of the winch of a closing line, if there is one."""
    line = start.system.line
    if line is None or not line.has_winch:
        return None
    forces = [drive.force for drive in line.drives if drive.force > 0.0]
    forces += [
        entry.drive_force for entry in start.scene.script if entry.drive == CLOSING and entry.drive_force
    ]
    commands: list[tuple[str, float | str]] = [
        (drive.action, time) for drive, time in zip(line.drives[1:], line.times, strict=True)
    ]
    commands += [
        (drive_of(entry, line.damping).action, entry.name)
        for entry in start.scene.script
        if entry.drive == CLOSING and entry.do != "set"
    ]
    return WinchLimits(line.length - line.shortest, max(forces, default=None), commands)


def _carried(start: Start) -> Carried | None:
    """Return the body that holds the packed net, if any."""
    frame, system = start.scene.initial.frame, start.system
    held = [item for item in system.kinematics.held if item.discrete == HELD]
    if frame is None or not held:
        return None
    (body,) = (entry for entry in system.bodies if entry.name == frame.body)
    origin = np.array(frame.position) - body.centre
    until = None if ejects(start.scene.script) else frame.eject_at  # which the record of events contains
    return Carried(frame.body, until, origin.tolist(), held[0].points.tolist())


def _versions() -> dict[str, str]:
    return {
        "exunet": VERSION,
        "exudyn": exudyn_version(),
        "numpy": np.__version__,
        "python": platform.python_version(),
    }
