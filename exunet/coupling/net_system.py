"""A net that a host steps from outside: motion of its ports in, impulses on them out."""

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
from exunet.coupling.port_loops import PortRoom, port_loops
from exunet.coupling.ports import TOLD, Earlier, refuse_jump, refuse_turn
from exunet.model.states import States
from exunet.model.system import Moving, State, System
from exunet.scene.casefile import Case, load, located_faults
from exunet.simulation.preparation import prepare_case, stops_of_script
from exunet.simulation.simulation import Simulation
from exunet.simulation.snapshot import Snapshot

Floats = NDArray[np.float64]


class PortLoad(NamedTuple):
    """What the net has done to the body of a port in a step from `begin` to `end` [s]; in the scene's axes.

    impulse         : (3,) [N s]
    angular_impulse : (3,) about the scene's origin [N m s]
    work            : [J], along the given motion of the port
    force, torque   : (3,) of the same mean: [N], and [N m] about the origin of the port's frame
    """

    begin: float
    end: float
    impulse: Floats
    angular_impulse: Floats
    work: float
    force: Floats
    torque: Floats


class PortLoads(NamedTuple):
    """What a step from `begin` to `end` [s] has done to the bodies of all ports, in their order.

    taken    : (n, 7) impulse, angular impulse and work, as in `PortLoad`
    wrenches : (n, 6) mean forces [N] and torques [N m]
    stands   : where the net is at the end, as `NetSystem.stands`
    """

    begin: float
    end: float
    taken: Floats
    wrenches: Floats
    stands: Floats

    def of(self, ports: Iterable[str]) -> dict[str, PortLoad]:
        """By the names of the ports."""
        rows = zip(ports, self.taken, self.wrenches, strict=True)
        return {
            name: PortLoad(self.begin, self.end, seven[:3], seven[3:6], float(seven[6]), six[:3], six[3:])
            for name, seven, six in rows
        }


class Given(NamedTuple):
    """What the net has done to the body of a port since the start; as in `PortLoad`."""

    impulse: Floats
    angular_impulse: Floats
    work: float


class _Ports:
    """The ports of a system.

    names   : of them (n)
    bodies  : (n,) numbers of their bodies
    given   : (n,) where in the first-order states begins what each has given
    throws  : one of them throws the net at the start
    thrown  : (n, 7) what that has given to the net, by each
    standing : how many numbers tell where bodies and first-order states are
    """

    def __init__(self, system: System) -> None:
        rigid, numbers = system.blocks.rigid, system.kinematics.ports
        self.names = tuple(rigid[k] for k in numbers)
        first = system.blocks.n_x - system.blocks.n_states
        entries = [system.blocks.state(first_given(name)) - first for name in self.names]
        self.frame_of = [FrameOf.body(system.bodies[k]) for k in numbers]
        self.bodies, self.given = np.array(numbers, dtype=np.int64), np.array(entries, dtype=np.int64)
        n, throw = len(numbers), system.ejection
        self.thrown = np.zeros((n, 7))
        self.throws = throw is not None and throw.body in numbers
        if throw is not None and self.throws:
            self.thrown[numbers.index(throw.body)] = [*throw.impulse, *throw.angular_impulse, throw.work]
        self._of: Moving | None = None

    def look_at(self, moving: Moving) -> None:
        """Let `room`, and `held` for the compiled loops, be of what moves there, whose arrays stay."""
        if moving is self._of:
            return
        n = len(self.names)
        self.standing = len(moving.first_order) + PER_FRAME * len(moving.bodies.attitude)
        self.room = PortRoom(
            *moving.bodies.parts(),
            moving.first_order,
            self.bodies,
            self.given,
            np.array([item.centre for item in self.frame_of], dtype=float),
            np.array([entry.axes for entry in self.frame_of], dtype=float),
            *(np.empty((n, width)) for width in (PER_FRAME, 7, PER_FRAME, PER_FRAME)),
        )
        self.held = port_loops().hold(self.room)
        self._of = moving


class NetSystem:
    """A case whose bodies of motion = "port" are moved by a host.

        net = NetSystem("net.toml")
        loads = net.step(0.01, {"chaser": FrameState(position, velocity, attitude, angular_velocity)})

    The host says where its bodies are at the end of a step and how they move then; the net takes its own
    small steps until there, while the ports go smoothly from where they were (see `exunet.bodies.port`). The
    nodes that are fixed to a port have no mass in the net: the host's body has it (`carried_mass`). What a
    throw at the start gives to the body that carries the net is in the loads of the first step.

    case      : a case file's name, or what `exunet.load` gave
    overrides : "key.path=value", as after --set
    wrenches  : free bodies of the net's own on which the host lets a wrench act, as of `Simulation`
    Raises CaseError for a case that cannot be simulated. A step that a guard stops raises RunStopped; the net
    is then at its last good state, at its `time`. It is not tried again with finer steps (solver.retry),
    since what the host did in the meantime cannot be taken back.
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
        self._size = self._sim.start.net.size  # which takes as long as all else that a step does here
        self._ports = _Ports(self._sim.start.system)  # which has what its wrenches need
        self._ejections = _ejections(start.system)

    @property
    def size(self) -> float:
        """Of the net at rest, by which places are compared [m]."""
        return self._size

    @property
    def ports(self) -> tuple[str, ...]:
        """The names of the ports."""
        return self._ports.names

    @property
    def time(self) -> float:
        """Time reached [s]."""
        return self._sim.time

    @property
    def simulation(self) -> Simulation:
        """The simulation of the net, to look at; `step` is what advances it."""
        return self._sim

    def frame(self, port: str) -> FrameState:
        """Where the frame of a port is in the net, and how it moves."""
        number = self._own(port)
        return self._ports.frame_of[number].frame(self._state(number))

    def given(self, port: str) -> Given:
        """What the net has done to the body of a port since the start, by a throw there too."""
        entry = int(self._ports.given[self._own(port)])
        total = 0.0 - self._sim.moving.first_order[entry : entry + 7]
        return Given(total[:3], total[3:6], float(total[6]))

    def carried_mass(self, port: str) -> float:
        """Mass [kg] of the nodes that are fixed to a port: that of the host's body must count it."""
        kinematics = self._sim.start.system.kinematics
        nodes = kinematics.point[kinematics.body == self._ports.bodies[self._own(port)]]
        return float(self._sim.start.net.mass[nodes].sum())

    @property
    def momentum(self) -> Floats:
        """(3,) of the net and its free bodies now [N s]; what the ports carry is the host's."""
        return np.asarray(self._states().momentum[0])

    def energy_seen_from(self, port: str) -> float:
        """Of the net and its free bodies now [J]: elastic, and kinetic of how they move beside a port."""
        system, now, velocity = self._sim.start.system, self._states(), np.array(self.frame(port).velocity)
        mass = float(system.mass.sum() + (system.body_mass * system.moves_freely).sum())
        beside = velocity @ (0.5 * mass * velocity - now.momentum[0])
        return float(now.kinetic[0] + beside + now.elastic[0])

    def _states(self) -> States:
        """As it is now, with what the ports carry."""
        system, seen = self._sim.start.system, self._sim.view
        moving = seen.moving.completed(system.kinematics, seen.time, seen.memory)
        return States.of(system, State.of(seen.time, moving, seen.memory))

    def step(self, until: float, frames: Mapping[str, FrameState]) -> dict[str, PortLoad]:
        """Advance to a time [s] while each port moves to its state of `frames` at that time.

        Raises InputError for a time that is not later, for ports that are missing or unknown, for a state
        with NaN or infinity, for one that is not where its velocities lead (`exunet.coupling.ports` says how
        far off it may be), and for one that has turned by more than 1 rad.
        """
        time, end = self.time, finite_number(until)
        if end is None or not end > time:
            raise InputError(
                f"step: must end later than the time reached, {time:g} s, got {until!r}: "
                "a host that goes back restores a snapshot first"
            )
        told = self._told(frames)
        if not self.ports:
            self._advance_to(end)
            return {}
        pieces, times = self._pieces(time, end, told), (time, end)
        states = self._ports.room.begin, self._ports.room.end
        refuse_jump("step: port", self.ports, times, states, self._earlier(time), TOLD, self.size)
        return self._go(times, told, pieces).of(self.ports)

    def follow(self, until: float, states: Floats) -> PortLoads:
        """As `step`, for states (n, 13) that a coupling has predicted of a host whose own do not jump.

        The numbers of a row are those of a `FrameState`, one part after the other. They are not looked at.
        """
        time, shape = self.time, (len(self.ports), PER_FRAME)
        if not (isinstance(states, np.ndarray) and states.shape == shape and until > time):
            raise InputError(f"follow: an array {shape} and a time later than {time:g} s; use `step`")
        return self._go((time, until), states, self._pieces(time, until, states))

    def go_on(self, until: float, now: Floats, earlier: Earlier) -> tuple[Floats, PortLoads]:
        """As `follow`, to where ports at states (n, 13) lead that go on as in an earlier step; and these."""
        time, told = self.time, np.empty_like(now)
        return told, self._go((time, until), told, self._pieces(time, until, told, (now, *earlier)))

    def _pieces(
        self, time: float, end: float, told: Floats, going: tuple[Floats, Floats, float] | None = None
    ) -> list[Piece]:
        """Of the ways of the ports between two times [s], to states (n, 13) of their frames.

        going : see `exunet.coupling.port_loops.go_on`, which tells where to then
        """
        ports, n = self._ports, len(told)
        ports.look_at(self._sim.moving)
        way = np.empty((n, 4, 3)), np.empty((n, 4)), np.empty((n, 4, 3))
        if going is None:
            most = port_loops().set_out(end - time, told, *way, ports.held)
        else:
            most = port_loops().go_out(*going, end - time, told, *way, ports.held)
        refuse_turn("step: port", ports.names, (time, end), most)
        return list(map(Piece, repeat(time), *way))

    def _go(self, times: tuple[float, float], told: Floats, pieces: Sequence[Piece]) -> PortLoads:
        """Go on from a time to another [s] while the ports go along pieces, to states (n, 13) of frames."""
        (time, end), ports, sim = times, self._ports, self._sim
        if time == sim.start.state.time:
            ports.room.given[:] -= ports.thrown  # the first step's load has it too
        for name, piece in zip(ports.names, pieces, strict=True):
            sim.steer(name, piece)
        self._advance_to(end)
        n = len(told)
        taken, wrenches, stands = np.empty((n, 7)), np.empty((n, 6)), np.empty(ports.standing)
        port_loops().share(end - time, told, taken, wrenches, stands, ports.held)
        return PortLoads(time, end, taken, wrenches, stands)

    def _advance_to(self, end: float) -> None:
        """To a time [s]; raises RunStopped with the time of the state at which the net is then."""
        try:
            self._sim.advance_to(end)
        except RunStopped as stop:
            stop.args = (f"{stop}; the net is at its last good state, t = {self.time:.6g} s",)
            raise

    def stands(self) -> Floats:
        """Where its bodies are, with attitudes last, and what they have been given: (m + 13 n,) numbers."""
        ports = self._ports
        ports.look_at(self._sim.moving)
        numbers = np.empty(ports.standing)
        port_loops().stand(ports.held, numbers)
        return numbers

    def snapshot(self) -> Snapshot:
        """All that the net depends on from now on; in memory, or in a file by its `save`."""
        return self._sim.snapshot()

    def restore(self, snapshot: Snapshot) -> None:
        """Go back, or on, to a snapshot of the same case: what follows is the same to the last bit."""
        self._sim.restore(snapshot)

    def reset(self) -> None:
        """Go back to the start; nothing is built or compiled again."""
        self._sim.reset()

    def finish(self) -> None:
        """Let the guards look at the states that they have not seen yet; raises RunStopped as `step` does.

        They look at many at once, so that a step may raise for one before it.
        """
        self._sim.settle()

    def _state(self, port: int) -> PrincipalState:
        """Of the body of a port, by its number."""
        parts = (part[self._ports.bodies[port]].tolist() for part in self._sim.moving.bodies.parts())
        return PrincipalState(*map(tuple, parts))

    def _own(self, port: str) -> int:
        """The number of a port."""
        if port not in self.ports:
            raise InputError(f"there is no port {port!r}: {', '.join(self.ports)}")
        return self.ports.index(port)

    def _told(self, frames: Mapping[str, FrameState]) -> Floats:
        if not isinstance(frames, Mapping):
            raise InputError(f"step: the states of the ports by name, got {frames!r}")
        if missing := [name for name in self.ports if name not in frames]:
            raise InputError(f"step: no state is given for port {', '.join(missing)}")
        for name in frames:
            self._own(name)
        return self.checked("step", frames)

    def checked(self, who: str, frames: Mapping[str, FrameState]) -> Floats:
        """(n, 13) states of all ports; raises InputError for an invalid state, see `FrameState.of`."""
        return rows_of(FrameState.of(frames[name], f"{who}: port {name}") for name in self.ports)

    def recoils(self, begin: float, end: float) -> bool:
        """True if the loads of a step from one time [s] to another have the jump of a throw from a port."""
        thrown = self._ports.throws and begin == self._sim.start.state.time
        later = self._ejections
        return thrown or (bool(later) and any(begin < time <= end for time in later))

    @property
    def ejections(self) -> tuple[float, ...]:
        """Times after the start at which ports eject the net that they hold [s]."""
        return self._ejections

    def refuse_jump(self, who: str, times: tuple[float, float], states: tuple[Floats, Floats]) -> None:
        """Raise InputError if given states (n, 13) of the ports are not where these move to.

        who           : for the words of the error
        times, states : where the step begins and ends [s]
        """
        frames = self._ports.frame_of
        told = (zip(frames, frames_of(self.ports, rows).values(), strict=True) for rows in states)
        begin, end = (rows_of(of.principal(state) for of, state in item) for item in told)
        refuse_jump(who, self.ports, times, (begin, end), self._earlier(times[0]), TOLD, self.size)

    def _earlier(self, time: float) -> Earlier:
        """The step of the ports before, which has ended at a time [s]."""
        pieces, states = (
            [self._sim.steered(name) for name in self.ports],
            np.zeros((len(self.ports), PER_FRAME)),
        )
        states[:, 3:6] = [piece.position[2] for piece in pieces]
        states[:, 10:] = [piece.turning[2] for piece in pieces]
        return Earlier(states, max(0.0, time - pieces[0].time))


def _ejections(system: System) -> tuple[float, ...]:
    """Times after the start at which ports eject the net that they hold [s]."""
    constraint, ports = system.forces.constraint, system.kinematics.ports
    if constraint is None or constraint.switch is None or constraint.memory is None:
        return ()
    name = constraint.memory.name
    held = [item for item in system.kinematics.held if item.memory == name and item.body in ports]
    return constraint.switch.times if held else ()
