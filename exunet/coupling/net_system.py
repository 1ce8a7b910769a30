"""A net that a host steps from outside: motion of its ports in, impulses on them out."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from exunet.base.errors import InputError, RunStopped
from exunet.base.files import path_of
from exunet.bodies.kinematics import GIVEN
from exunet.bodies.port import (
    FrameOf,
    FrameState,
    PrincipalState,
    mean_place,
    piece_between,
    rotation_vector,
    times,
)
from exunet.case.casefile import Case, load
from exunet.simulation.arguments import finite_number
from exunet.simulation.preparation import prepare_case
from exunet.simulation.simulation import Simulation
from exunet.simulation.snapshot import Snapshot

Floats = NDArray[np.float64]

# How far a port may get in a step, at the larger speed of both ends, in parts of this step and the one
# before, whose prediction it may have to make good: a body at constant acceleration from rest goes half of
# it. What is beyond that, and beyond round-off of the net's size or of a turn, is a jump.
_FARTHEST = 2.0
_ROUND_OFF = 1e-9


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


@dataclass(frozen=True)
class _Port:
    """number : of the body; entry: where in the first-order states that begin what it has given."""

    number: int
    entry: int
    frame: FrameOf


class NetSystem:
    """A case whose bodies of motion = "port" are moved by a host.

        net = NetSystem("net.toml")
        loads = net.step(0.01, {"chaser": FrameState(position, velocity, attitude, angular_velocity)})

    The host says where its bodies are at the end of a step and how they move then; the net takes its own
    small steps until there, while the ports go smoothly from where they were (see `exunet.bodies.port`). The
    nodes that are fixed to a port have no mass in the net: the host's body has it (`carried_mass`).

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
        system, rigid = start.system, start.system.blocks.rigid
        solver = start.scene.solver.model_copy(update={"retry": 0})
        scene = start.scene.model_copy(update={"solver": solver})
        self._sim = Simulation(replace(start, scene=scene), wrenches=wrenches)
        first = self._sim.start.system.blocks.n_x - self._sim.start.system.blocks.n_states
        self._ports = {
            rigid[k]: _Port(
                k, system.blocks.state(f"{rigid[k]}/{GIVEN[0][0]}") - first, FrameOf.body(system.bodies[k])
            )
            for k in system.kinematics.ports
        }
        self._nearest = _ROUND_OFF * max(1e-3, system.net.size)

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
        return own.frame.frame(self._state_of(own))

    def carried_mass(self, port: str) -> float:
        """Mass [kg] of the nodes that are fixed to a port: that of the host's body must count it."""
        kinematics = self._sim.start.system.kinematics
        nodes = kinematics.point[kinematics.body == self._own(port).number]
        return float(self._sim.start.net.mass[nodes].sum())

    def step(self, until: float, frames: Mapping[str, FrameState]) -> dict[str, PortLoad]:
        """Go on to a time [s] while each port goes to the state that `frames` tells for that time.

        Raises InputError for a time that is not later, for ports that are missing or unknown, for a state
        with NaN or infinity, and for one that is farther away than its velocity allows.
        """
        time, end = self.time, finite_number(until)
        if end is None or not end > time:
            raise InputError(
                f"step: must end later than the time reached, {time:g} s, got {until!r}: "
                "a host that goes back restores a snapshot first"
            )
        told = self._told(frames)
        before, begins = {}, {}
        for name, port in self._ports.items():
            begin = self._state_of(port)
            begins[name] = port.frame.frame(begin)
            self._refuse_jump(name, end - time, begins[name], told[name])
            before[name] = self._given(port)
            piece = piece_between(time, end - time, begin, port.frame.principal(told[name]))
            self._sim.steer(name, piece)
        try:
            self._sim.advance_to(end)
        except RunStopped as stop:
            stop.args = (f"{stop}; the net is at its last good state, t = {self.time:.6g} s",)
            raise
        return {
            name: _load(time, end, self._given(port) - before[name], begins[name], told[name])
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
        if missing := [name for name in self._ports if name not in frames]:
            raise InputError(f"step: no state is given for port {', '.join(missing)}")
        for name in frames:
            self._own(name)
        return {name: FrameState.of(state, f"step: port {name}") for name, state in frames.items()}

    def _state_of(self, port: _Port) -> PrincipalState:
        parts = self._sim.view.bodies.parts()
        return PrincipalState(*(tuple(part[port.number].tolist()) for part in parts))

    def _given(self, port: _Port) -> Floats:
        """(7,) impulse, angular impulse and work that the port has given to the net so far; a copy."""
        return self._sim.view.first_order[port.entry : port.entry + 7].copy()

    def _refuse_jump(self, name: str, duration: float, begin: FrameState, end: FrameState) -> None:
        before = self.time - self._sim.steered(name).time
        for what, way, speeds, least, unit in (
            (
                "position",
                math.dist(begin.position, end.position),
                (begin.velocity, end.velocity),
                self._nearest,
                "m",
            ),
            (
                "attitude",
                math.hypot(*rotation_vector(_between(begin, end))),
                (begin.angular_velocity, end.angular_velocity),
                _ROUND_OFF,
                "rad",
            ),
        ):
            fastest = max(math.hypot(*speed) for speed in speeds)
            if way > _FARTHEST * fastest * (duration + before) + least:
                raise InputError(
                    f"step: port {name} jumps: in the step from {self.time:.6g} s to "
                    f"{self.time + duration:.6g} s its {what} changes by {way:.3g} {unit}, at speeds of "
                    f"{fastest:.3g} {unit}/s. Tell the state at the end of the step, or restore a snapshot"
                )


def _between(begin: FrameState, end: FrameState) -> tuple[float, float, float, float]:
    w, x, y, z = begin.attitude
    return times((w, -x, -y, -z), end.attitude)


def _load(begin: float, end: float, given: Floats, before: FrameState, after: FrameState) -> PortLoad:
    """What is given to the net is taken from the host."""
    impulse, angular, over = -given[:3], -given[3:6], 1.0 / (end - begin)
    middle = mean_place(end - begin, before, after)
    torque = over * (angular - np.cross(middle, impulse))
    return PortLoad(begin, end, impulse, angular, -float(given[6]), over * impulse, torque)
