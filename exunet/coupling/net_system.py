"""A net that a host steps from outside: motion of its ports in, impulses on them out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from exunet.base.errors import CaseError, InputError, RunStopped
from exunet.base.files import path_of
from exunet.bodies.kinematics import GIVEN
from exunet.bodies.port import (
    FrameOf,
    FrameState,
    PrincipalState,
    mean_place,
    piece_between,
)
from exunet.case.casefile import Case, load
from exunet.case.fault_location import located_faults
from exunet.coupling.jumps import TOLD, Accelerations, refuse_jump, refuse_turn
from exunet.simulation.arguments import finite_number
from exunet.simulation.preparation import prepare_case, stops_of_script
from exunet.simulation.simulation import Simulation
from exunet.simulation.snapshot import Snapshot
from exunet.system.states import States
from exunet.system.system import State

Floats = NDArray[np.float64]


class PortLoad(NamedTuple):
    """What the net has done to the body of a port in a step from `begin` to `end` [s]; in the scene's axes.

    impulse         : (3,) [N s]
    angular_impulse : (3,) about the scene's origin [N m s]
    work            : [J], along the motion that the port was told
    force, torque   : (3,) of the same mean: [N], and [N m] about the origin of the port's frame
    """

    begin: float
    end: float
    impulse: Floats
    angular_impulse: Floats
    work: float
    force: Floats
    torque: Floats


class Given(NamedTuple):
    """What the net has done to the body of a port since the start; as in `PortLoad`."""

    impulse: Floats
    angular_impulse: Floats
    work: float


@dataclass(frozen=True)
class _Port:
    """number : of the body; entry: where in the first-order states that begin what it has given."""

    number: int
    entry: int
    frame: FrameOf

    def state(self, view: State) -> PrincipalState:
        """Of the body."""
        parts = (part[self.number].tolist() for part in view.bodies.parts())
        return PrincipalState(*map(tuple, parts))

    def given(self, view: State) -> Floats:
        """(7,) impulse, angular impulse and work that it has given to the net so far; a copy."""
        return view.first_order[self.entry : self.entry + 7].copy()


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
        system, rigid = start.system, start.system.blocks.rigid
        solver = start.scene.solver.model_copy(update={"retry": 0})
        scene = start.scene.model_copy(update={"solver": solver})
        self._sim = Simulation(replace(start, scene=scene), wrenches=wrenches)
        self._size = self._sim.start.net.size  # which takes as long as all else that a step does here
        first = self._sim.start.system.blocks.n_x - self._sim.start.system.blocks.n_states
        self._ports = {
            rigid[k]: _Port(
                k, system.blocks.state(f"{rigid[k]}/{GIVEN[0][0]}") - first, FrameOf.body(system.bodies[k])
            )
            for k in system.kinematics.ports
        }

    @property
    def size(self) -> float:
        """Of the net at rest, by which places are compared [m]."""
        return self._size

    @property
    def ports(self) -> tuple[str, ...]:
        """The names of the ports."""
        return tuple(self._ports)

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
        own = self._own(port)
        return own.frame.frame(own.state(self._sim.view))

    def given(self, port: str) -> Given:
        """What the net has done to the body of a port since the start, by a throw there too."""
        total = 0.0 - self._own(port).given(self._sim.view)
        return Given(total[:3], total[3:6], float(total[6]))

    def carried_mass(self, port: str) -> float:
        """Mass [kg] of the nodes that are fixed to a port: that of the host's body must count it."""
        kinematics = self._sim.start.system.kinematics
        nodes = kinematics.point[kinematics.body == self._own(port).number]
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
        """Go on to a time [s] while each port goes to the state that `frames` tells for that time.

        Raises InputError for a time that is not later, for ports that are missing or unknown, for a state
        with NaN or infinity, for one that is not where its velocities lead (`exunet.coupling.jumps` says how
        far off it may be), and for one that has turned by more than 1 rad.
        """
        return self._step(until, frames, may_jump=False)

    def follow(self, until: float, frames: Mapping[str, FrameState]) -> dict[str, PortLoad]:
        """As `step`, for states that a coupling has predicted from such of a host that do not jump."""
        return self._step(until, frames, may_jump=True)

    def _step(self, until: float, frames: Mapping[str, FrameState], *, may_jump: bool) -> dict[str, PortLoad]:
        time, end = self.time, finite_number(until)
        if end is None or not end > time:
            raise InputError(
                f"step: must end later than the time reached, {time:g} s, got {until!r}: "
                "a host that goes back restores a snapshot first"
            )
        told = self._told(frames)
        before, begins, pieces, view = {}, {}, {}, self._sim.view
        for name, port in self._ports.items():
            begin = port.state(view)
            begins[name], before[name] = port.frame.frame(begin), port.given(view) - self._thrown(port)
            last, who = port.frame.principal(told[name]), f"step: port {name}"
            refuse_turn(who, (time, end), (begin, last))
            if not may_jump:
                of_last = self._last(name, begin, time)
                refuse_jump(who, (time, end), (begin, last), of_last, TOLD, self.size)
            pieces[name] = piece_between(time, end - time, begin, last)
        for name, piece in pieces.items():
            self._sim.steer(name, piece)
        try:
            self._sim.advance_to(end)
        except RunStopped as stop:
            stop.args = (f"{stop}; the net is at its last good state, t = {self.time:.6g} s",)
            raise
        view = self._sim.view
        return {
            name: _load(time, end, port.given(view) - before[name], begins[name], told[name])
            for name, port in self._ports.items()
        }

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

    def _own(self, port: str) -> _Port:
        if port not in self._ports:
            raise InputError(f"there is no port {port!r}: {', '.join(self._ports)}")
        return self._ports[port]

    def _told(self, frames: Mapping[str, FrameState]) -> dict[str, FrameState]:
        if not isinstance(frames, Mapping):
            raise InputError(f"step: the states of the ports by name, got {frames!r}")
        if missing := [name for name in self._ports if name not in frames]:
            raise InputError(f"step: no state is given for port {', '.join(missing)}")
        for name in frames:
            self._own(name)
        return {name: FrameState.of(state, f"step: port {name}") for name, state in frames.items()}

    def recoils(self, begin: float, end: float) -> bool:
        """True if the loads of a step from one time [s] to another have the jump of a throw from a port."""
        start = self._sim.start
        throw = start.system.throw
        thrown = throw is not None and throw.body in start.system.kinematics.ports
        thrown = thrown and begin == start.state.time
        return thrown or any(begin < time <= end for time in self.ejections)

    @property
    def ejections(self) -> tuple[float, ...]:
        """Times after the start at which ports eject the net that they hold [s]."""
        system = self._sim.start.system
        constraint, ports = system.forces.constraint, system.kinematics.ports
        if constraint is None or constraint.switch is None or constraint.memory is None:
            return ()
        name = constraint.memory.name
        held = [one for one in system.kinematics.held if one.memory == name and one.body in ports]
        return constraint.switch.times if held else ()

    def _thrown(self, port: _Port) -> Floats:
        """(7,) of what a throw at the start has given, which the first step's load has too."""
        throw = self._sim.start.system.throw
        if throw is None or throw.body != port.number or self.time != self._sim.start.state.time:
            return np.zeros(7)
        return np.array([*throw.impulse, *throw.angular_impulse, throw.work])

    def refuse_jump(
        self, who: str, name: str, times: tuple[float, float], states: tuple[FrameState, FrameState]
    ) -> None:
        """Raise InputError if a state that the net is told for a port, of a name, is not where it moves to.

        who           : for the words of the error
        times, states : where the step begins and ends [s]
        """
        port = self._ports[name]
        begin, end = (port.frame.principal(state) for state in states)
        refuse_jump(who, times, (begin, end), self._last(name, begin, times[0]), TOLD, self.size)

    def _last(self, name: str, begin: PrincipalState, time: float) -> Accelerations:
        """Of a port in the step before, which has ended at a time [s]."""
        last = self._sim.steered(name)
        if not last.time < time:
            return Accelerations()
        speed, spin = last.position[2].tolist(), last.turning[2].tolist()
        before = PrincipalState(begin.position, tuple(speed), begin.attitude, tuple(spin))
        return Accelerations.between(time - last.time, before, begin)


def _load(begin: float, end: float, given: Floats, before: FrameState, after: FrameState) -> PortLoad:
    """What is given to the net is taken from the host."""
    taken, over = -given, 1.0 / (end - begin)
    x, y, z = mean_place(end - begin, before, after)
    a, b, c, i, j, k, work = taken.tolist()
    force = np.array((over * a, over * b, over * c))
    torque = np.array((over * (i - y * c + z * b), over * (j - z * a + x * c), over * (k - x * b + y * a)))
    return PortLoad(begin, end, taken[:3], taken[3:6], work, force, torque)
