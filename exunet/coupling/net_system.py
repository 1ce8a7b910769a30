"""Net that a host steps: motion of its ports in, impulses on them out."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from itertools import repeat
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from exunet.base.arguments import finite_number
from exunet.base.errors import CaseError, InputError, RunStopped
from exunet.base.files import path_of
from exunet.bodies.kinematics import first_given
from exunet.bodies.port import PER_FRAME, FrameOf, FrameState, Piece, PrincipalState, frames_of, rows_of
from exunet.coupling.ports import (
    PREDICTED,
    Earlier,
    PortArrays,
    port_loops,
    validate_no_jump,
    validate_ports,
    validate_rotation,
)
from exunet.model.states import States
from exunet.model.system import Moving, State, System
from exunet.scene.casefile import Case, load, located_faults
from exunet.simulation.preparation import prepare_case, stops_of_script
from exunet.simulation.simulation import Simulation
from exunet.simulation.snapshot import Snapshot

Floats = NDArray[np.float64]


class PortLoad(NamedTuple):
    """Load of the net on the body of a port in a step from `begin` to `end` [s]; in the scene's axes.

    impulse         : (3,) [N s]
    angular_impulse : (3,) about the scene's origin [N m s]
    work            : [J], along the prescribed motion of the port
    force, torque   : (3,) means: [N], and [N m] about the origin of the port's frame
    """

    begin: float
    end: float
    impulse: Floats
    angular_impulse: Floats
    work: float
    force: Floats
    torque: Floats


class PortLoads(NamedTuple):
    """Loads of a step from `begin` to `end` [s] on the bodies of all ports, in their order.

    impulses : (n, 7) impulse, angular impulse and work, as in `PortLoad`
    wrenches : (n, 6) mean forces [N] and torques [N m]
    """

    begin: float
    end: float
    impulses: Floats
    wrenches: Floats

    def of(self, ports: Iterable[str]) -> dict[str, PortLoad]:
        """Return the loads by the names of the ports."""
        rows = zip(ports, self.impulses, self.wrenches, strict=True)
        return {
            name: PortLoad(self.begin, self.end, seven[:3], seven[3:6], float(seven[6]), six[:3], six[3:])
            for name, seven, six in rows
        }


class Delivered(NamedTuple):
    """Impulse and work of the net on the body of a port since the start; as in `PortLoad`."""

    impulse: Floats
    angular_impulse: Floats
    work: float


class _Ports:
    """Ports of a system, and the arrays of the compiled loops.

    names    : of the ports (n)
    bodies   : (n,) numbers of their bodies
    entries  : (n,) first entry of each port's impulse and work in the first-order states
    ejects   : True if a port ejects the net at the start
    ejection : (n, 7) impulse and work of that on the net, by port
    """

    def __init__(self, system: System) -> None:
        rigid, numbers = system.blocks.rigid, system.kinematics.ports
        self.names = tuple(rigid[k] for k in numbers)
        first = system.blocks.n_x - system.blocks.n_states
        entries = [system.blocks.state(first_given(name)) - first for name in self.names]
        self.frame_of = [FrameOf.body(system.bodies[k]) for k in numbers]
        self.bodies, self.entries = np.array(numbers, dtype=np.int64), np.array(entries, dtype=np.int64)
        n, throw = len(numbers), system.ejection
        self.ejection = np.zeros((n, 7))
        self.ejects = throw is not None and throw.body in numbers
        if throw is not None and self.ejects:
            self.ejection[numbers.index(throw.body)] = [*throw.impulse, *throw.angular_impulse, throw.work]
        self._of: Moving | None = None

    def follow(self, moving: Moving) -> None:
        """Make `arrays`, and `held` for the compiled loops, refer to a state, whose arrays are permanent."""
        if moving is self._of:
            return
        n = len(self.names)
        self.arrays = PortArrays(
            *moving.bodies.parts(),
            moving.first_order,
            self.bodies,
            self.entries,
            np.array([item.centre for item in self.frame_of], dtype=float),
            np.array([entry.axes for entry in self.frame_of], dtype=float),
            *(np.empty((n, width)) for width in (PER_FRAME, 7, PER_FRAME, PER_FRAME)),
        )
        self.held = port_loops().hold(self.arrays)
        self._of = moving


class NetSystem:
    """Case whose bodies of motion = "port" are moved by a host.

        net = NetSystem("net.toml")
        loads = net.step(0.01, {"chaser": FrameState(position, velocity, attitude, angular_velocity)})

    The host gives the states of its bodies at the end of a step. The net takes its own small steps until
    there, while the ports move smoothly from their present states (see `exunet.bodies.port`). Nodes that are
    fixed to a port do not have mass in the net: the host's body includes it (`carried_mass`). The recoil of
    an ejection at the start is in the loads of the first step.

    Parameters
    ----------
    case : str, Path or Case
        Name of a case file, or the result of `exunet.load`.
    overrides : sequence of str, optional
        "key.path=value", as after --set.
    wrenches : sequence of str, optional
        Free bodies of the net's case with an input "wrench/BODY", as of `Simulation`.

    Raises
    ------
    CaseError
        For a case that cannot be simulated.
    RunStopped
        In a step that a guard stops. The net is then at its last good state, at its `time`. It does not retry
        with finer steps (solver.retry), since the steps of the host cannot be repeated.
    """

    def __init__(
        self, case: str | Path | Case, overrides: Sequence[str] = (), *, wrenches: Sequence[str] = ()
    ) -> None:
        found = case if isinstance(case, Case) else load(path_of(case, "NetSystem"), overrides)
        start = prepare_case(found, hosted=True)
        with located_faults(found):
            if stops := stops_of_script(start.scene):
                raise CaseError(stops)
        solver = start.scene.solver.model_copy(update={"retry": 0})
        scene = start.scene.model_copy(update={"solver": solver})
        self._sim = Simulation(replace(start, scene=scene), wrenches=wrenches)
        self._size = self._sim.start.net.size  # as expensive as the rest of a step here
        self._ports = _Ports(self._sim.start.system)  # with the states that wrenches add
        self._ejections = _ejections(start.system)

    @property
    def size(self) -> float:
        """Size of the net at rest [m], the scale of positions."""
        return self._size

    @property
    def ports(self) -> tuple[str, ...]:
        """Names of the ports."""
        return self._ports.names

    @property
    def time(self) -> float:
        """Time reached [s]."""
        return self._sim.time

    @property
    def simulation(self) -> Simulation:
        """Simulation of the net, to read; `step` advances it."""
        return self._sim

    def frame(self, port: str) -> FrameState:
        """Return the present state of the frame of a port in the net."""
        number = self._number(port)
        body = self._ports.bodies[number]
        parts = (tuple(part[body].tolist()) for part in self._sim.moving.bodies.parts())
        return self._ports.frame_of[number].frame(PrincipalState(*parts))

    def delivered(self, port: str) -> Delivered:
        """Return what the net has done to the body of a port since the start, with an ejection there."""
        entry = int(self._ports.entries[self._number(port)])
        total = 0.0 - self._sim.moving.first_order[entry : entry + 7]
        return Delivered(total[:3], total[3:6], float(total[6]))

    def carried_mass(self, port: str) -> float:
        """Return the mass [kg] of the nodes that are fixed to a port; the host's body must include it."""
        kinematics = self._sim.start.system.kinematics
        nodes = kinematics.point[kinematics.body == self._ports.bodies[self._number(port)]]
        return float(self._sim.start.net.mass[nodes].sum())

    @property
    def momentum(self) -> Floats:
        """(3,) present momentum of the net and its free bodies [N s]; nodes on ports belong to the host."""
        return np.asarray(self._states().momentum[0])

    def energy_seen_from(self, port: str) -> float:
        """Return the elastic energy and the kinetic energy relative to a port of net and free bodies [J]."""
        system, now, velocity = self._sim.start.system, self._states(), np.array(self.frame(port).velocity)
        mass = float(system.mass.sum() + (system.body_mass * system.moves_freely).sum())
        beside = velocity @ (0.5 * mass * velocity - now.momentum[0])
        return float(now.kinetic[0] + beside + now.elastic[0])

    def _states(self) -> States:
        """Return the present state with the nodes that ports carry."""
        system, seen = self._sim.start.system, self._sim.view
        moving = seen.moving.completed(system.kinematics, seen.time, seen.memory)
        return States.of(system, State.of(seen.time, moving, seen.memory))

    def step(self, until: float, frames: Mapping[str, FrameState]) -> dict[str, PortLoad]:
        """Advance to a time [s] while each port moves to its state of `frames` at that time.

        Raises InputError for a time that is not later, for missing or unknown ports, for a state with NaN or
        infinity, for a pose that does not follow from the velocities (see `exunet.coupling.ports`), and for a
        rotation of more than 1 rad.
        """
        time, end = self.time, finite_number(until)
        if end is None or not end > time:
            raise InputError(
                f"step: must end later than the time reached, {time:g} s, got {until!r}: a host that goes "
                "back restores a snapshot first"
            )
        validate_ports("step", frames, self.ports, "the state")
        target = self.rows("step", frames)
        if not self.ports:
            self._advance_to(end)
            return {}
        pieces = self._pieces(time, end, target)
        states = self._ports.arrays.begin, self._ports.arrays.end
        earlier = self._earlier(time)
        validate_no_jump("step: port", self.ports, (time, end), states, earlier, PREDICTED, self.size)
        return self._go((time, end), target, pieces).of(self.ports)

    def follow(self, until: float, states: Floats) -> PortLoads:
        """Advance as `step`, to states (n, 13) of the ports that a coupling has predicted, without checks.

        A row has the numbers of a `FrameState`, one part after the other.
        """
        time, shape = self.time, (len(self.ports), PER_FRAME)
        if not (isinstance(states, np.ndarray) and states.shape == shape and until > time):
            raise InputError(
                f"follow: requires an array {shape} and a time later than {time:g} s; use `step`"
            )
        return self._go((time, until), states, self._pieces(time, until, states))

    def _pieces(self, time: float, end: float, target: Floats) -> list[Piece]:
        """Return the paths of the ports between two times [s] to states (n, 13) of their frames."""
        ports, n = self._ports, len(target)
        ports.follow(self._sim.moving)
        path = np.empty((n, 4, 3)), np.empty((n, 4)), np.empty((n, 4, 3))
        largest = port_loops().plan_motion(end - time, target, *path, ports.held)
        validate_rotation("step: port", ports.names, (time, end), largest)
        return list(map(Piece, repeat(time), *path))

    def _go(self, times: tuple[float, float], target: Floats, pieces: Sequence[Piece]) -> PortLoads:
        """Advance between two times [s] while the ports move along pieces to states (n, 13) of frames."""
        (time, end), ports, sim = times, self._ports, self._sim
        if time == sim.start.state.time:
            ports.arrays.given[:] -= ports.ejection  # part of the first step's load
        for name, piece in zip(ports.names, pieces, strict=True):
            sim.steer(name, piece)
        self._advance_to(end)
        impulses, wrenches = np.empty((len(target), 7)), np.empty((len(target), 6))
        port_loops().collect_loads(end - time, target, impulses, wrenches, ports.held)
        return PortLoads(time, end, impulses, wrenches)

    def _advance_to(self, end: float) -> None:
        """Advance to a time [s]; raise RunStopped with the time of the state at which the net is then."""
        try:
            self._sim.advance_to(end)
        except RunStopped as stop:
            stop.args = (f"{stop}; the net is at its last good state, t = {self.time:.6g} s",)
            raise

    def state_vector(self) -> Floats:
        """Return first-order states and states of all bodies in one array (m + 13 n,), attitudes last."""
        moving = self._sim.moving
        position, velocity, attitude, spin = moving.bodies.parts()
        return np.concatenate(
            [moving.first_order, position.ravel(), velocity.ravel(), spin.ravel(), attitude.ravel()]
        )

    def snapshot(self) -> Snapshot:
        """Return a snapshot of the net; in memory, or in a file by its `save`."""
        return self._sim.snapshot()

    def restore(self, snapshot: Snapshot) -> None:
        """Restore a snapshot of the same case; the net continues bitwise."""
        self._sim.restore(snapshot)

    def reset(self) -> None:
        """Go back to the start, without a new build."""
        self._sim.reset()

    def finish(self) -> None:
        """Check all states by the guards; raises RunStopped as `step` does.

        Guards check many states at once, so that a step may raise for an earlier one.
        """
        self._sim.settle()

    def _number(self, port: str) -> int:
        if port not in self.ports:
            raise InputError(f"there is no port {port!r}: {', '.join(self.ports)}")
        return self.ports.index(port)

    def rows(self, who: str, frames: Mapping[str, FrameState]) -> Floats:
        """Return states (n, 13) of all ports; raises InputError for an invalid state, see `FrameState.of`."""
        return rows_of(FrameState.of(frames[name], f"{who}: port {name}") for name in self.ports)

    def recoils(self, begin: float, end: float) -> bool:
        """Return True if the loads of a step between two times [s] contain the jump of an ejection."""
        at_start = self._ports.ejects and begin == self._sim.start.state.time
        return at_start or any(begin < time <= end for time in self._ejections)

    @property
    def ejections(self) -> tuple[float, ...]:
        """Times after the start at which ports eject the net that they hold [s]."""
        return self._ejections

    def validate_motion(self, times: tuple[float, float], states: tuple[Floats, Floats]) -> None:
        """Raise InputError if states (n, 13) of the ports at two times [s] are a jump."""
        frames = self._ports.frame_of
        pairs = (zip(frames, frames_of(self.ports, rows).values(), strict=True) for rows in states)
        begin, end = (rows_of(of.principal(state) for of, state in pair) for pair in pairs)
        earlier = self._earlier(times[0])
        validate_no_jump("step: port", self.ports, times, (begin, end), earlier, PREDICTED, self.size)

    def _earlier(self, time: float) -> Earlier:
        """Return the previous step of the ports, which has ended at a time [s]."""
        pieces = [self._sim.steered(name) for name in self.ports]
        states = np.zeros((len(pieces), PER_FRAME))
        states[:, 3:6] = [piece.position[2] for piece in pieces]
        states[:, 10:] = [piece.turning[2] for piece in pieces]
        return Earlier(states, max(0.0, time - pieces[0].time))


def _ejections(system: System) -> tuple[float, ...]:
    constraint, ports = system.forces.constraint, system.kinematics.ports
    if constraint is None or constraint.switch is None or constraint.memory is None:
        return ()
    name = constraint.memory.name
    held = [item for item in system.kinematics.held if item.memory == name and item.body in ports]
    return constraint.switch.times if held else ()
