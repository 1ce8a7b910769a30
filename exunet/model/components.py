"""Components of a scene beside net, bodies and effects: the first-order states and forces that each adds."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple, Protocol

import numpy as np

from exunet.base.arrays import Floats, Ints
from exunet.base.errors import LARGEST, Fault
from exunet.base.run_events import ReelEvent
from exunet.bodies.config import BodyThrust
from exunet.bodies.kinematics import Kinematics
from exunet.bodies.rigid import RigidBody
from exunet.forces import body_thrust, closing, corner_units, perimeter, reel
from exunet.forces.blocks import Blocks, FirstOrder
from exunet.forces.body_thrust import Thruster
from exunet.forces.closing import Drawstring, way_of
from exunet.forces.corner_units import Control
from exunet.forces.effects import Choice, thrust
from exunet.forces.effects.material_damping import MaterialDamping
from exunet.forces.law import STRETCH_BOUND
from exunet.forces.perimeter import Shortening
from exunet.forces.reel import (
    ASKED,
    COMMANDED,
    NOTHING_ASKED,
    ON_DRUM,
    Outlet,
    Winding,
    discrete_name,
    reel_term,
    step_to_node,
)
from exunet.forces.terms import Change, DiscreteStates, KernelTerm, Switch, largest_number
from exunet.forces.total import Forces
from exunet.model.ejection import exchanged
from exunet.model.script import with_inputs
from exunet.model.system import Layout, Moving
from exunet.net.closing import LineThroughRings, ShortenedEdge
from exunet.net.drive import Drive
from exunet.net.tether import ReeledTether
from exunet.scene.script import ScriptEntry, begins_a_thrust, begins_control

_COMMAND, _ON, _OFF = range(3)
_NOTHING = np.zeros(0, dtype=np.int64)


class _Node(NamedTuple):
    """Node with its number, position [m] and velocity [m/s]."""

    number: int
    place: Floats
    velocity: Floats


class Drum(Switch):
    """Event function of a reel: at one instant first commands, then nodes until none is due.

    When a node goes onto the drum or comes off it, body, held points and node conserve momentum and angular
    momentum, unless the body is prescribed; the change of energy counts as dissipated.
    """

    sees_inputs = True  # commands of a script

    def __init__(self, winding: Winding, kinematics: Kinematics) -> None:
        self._winding, self._reel, self._blocks = winding, winding.reel, winding.blocks
        self._kinematics = kinematics
        self._body = self._blocks.rigid.index(self._reel.body)
        self.times = self._reel.times
        self._made: tuple[bytes, Outlet] | None = None
        self._wound = self._blocks.state(f"{self._reel.name}/wound_up")

    def in_steps(self, discrete: Floats) -> bool:
        """Return True while the drum may turn, so that nodes may go on or come off."""
        asked = discrete[ASKED:] if len(discrete) > ASKED else NOTHING_ASKED
        drive = Drive(*asked[1:].tolist()) if asked[0] > 0.0 else self._reel.drives[int(discrete[COMMANDED])]
        return not drive.is_locked

    def crossed(self, time: float, x: Floats, v: Floats, discrete: Floats) -> Ints:
        """Return which are due: the next command, a node onto the drum, a node off it."""
        done = int(discrete[COMMANDED])
        commanded = done < len(self.times) and self.times[done] <= time
        length, limits = self._outlet(x, discrete), self._outlet_at(discrete)
        on = length <= limits.goes_on + limits.close
        off = length >= limits.comes_off - limits.close
        return np.flatnonzero([commanded, on, off]) if commanded or on or off else _NOTHING

    def _outlet_at(self, discrete: Floats) -> Outlet:
        """Return the data of the compiled loops; cached by the discrete state."""
        key = discrete.tobytes()
        if self._made is None or self._made[0] != key:
            self._made = key, self._winding.outlet(discrete)
        return self._made[1]

    def _outlet(self, x: Floats, discrete: Floats) -> float:
        return self._reel.outlet(int(discrete[ON_DRUM]), float(x[self._wound]))

    def step_within(self, step: float, least: float, x: Floats, v: Floats, discrete: Floats) -> float:
        return float(step_to_node(step, least, x, v, self._outlet_at(discrete)))

    def change(
        self, time: float, x: Floats, v: Floats, discrete: Floats, items: Ints, every: DiscreteStates
    ) -> Change:
        """Return the discrete state and the state after an event; the change of energy counts as lost."""
        if _COMMAND in items:
            number = float(np.searchsorted(self._reel.times, time, side="right"))
            event = ReelEvent(time_s=time, tether=self._reel.name, event=f"command {int(number)}")
            return Change(np.array([discrete[ON_DRUM], number]), events=(event,), more=True)
        moving = Layout(self._blocks).unpack(x.copy(), v.copy()).completed(self._kinematics, time, every)
        on = _ON in items
        number = discrete[ON_DRUM] + 1.0 if on else discrete[ON_DRUM]
        node = self._reel.nodes[int(number)]
        after = np.array([number if on else number - 1.0, discrete[COMMANDED]])
        leaving = None if on else self._coming_off(moving, discrete)
        both = every, {**every, discrete_name(self._reel): after}
        moved = self._conserving_momenta(time, moving, both, node, leaving)
        x, v = Layout(self._blocks).pack(moved)
        words = "goes onto the drum" if on else "comes off the drum"
        event = ReelEvent(time_s=time, tether=self._reel.name, event=f"node {node} {words}", node=node)
        return Change(after, None, (event,), x=x, v=v, more=True)

    def _coming_off(self, moving: Moving, discrete: Floats) -> _Node:
        """Return the last node on the drum, moved onto the line from there to the next node.

        Along the line it has the velocity of the next node, since the element between them keeps its length;
        across it, the velocity interpolated along the line.
        """
        on_drum = int(discrete[ON_DRUM])
        drum, node, far = (self._reel.nodes[k] for k in (0, on_drum, on_drum + 1))
        outlet = self._outlet(self._flat(moving)[0], discrete)
        part = (outlet - self._reel.element_length) / outlet
        line = moving.position[far] - moving.position[drum]
        relative = moving.velocity[far] - moving.velocity[drum]
        size = float(np.linalg.norm(line))
        direction = line / size if size > 0.0 else np.zeros(3)
        place = moving.position[drum] + part * line
        velocity = moving.velocity[drum] + part * relative
        velocity = velocity + (1.0 - part) * (relative @ direction) * direction
        return _Node(node, place, velocity)

    def _flat(self, moving: Moving) -> tuple[Floats, Floats]:
        return Layout(self._blocks).pack(moving)

    def _conserving_momenta(
        self,
        time: float,
        moving: Moving,
        discrete_states: tuple[DiscreteStates, DiscreteStates],
        node: int,
        leaving: _Node | None,
    ) -> Moving:
        """Return the state after a node has gone onto the drum, or, `leaving`, come off it.

        discrete_states : discrete states before and after
        """
        sign, own = 1.0, _Node(node, moving.position[node].copy(), moving.velocity[node].copy())
        if leaving is not None:
            sign, own = -1.0, leaving
        momentum = sign * float(self._blocks.mass[node]) * own.velocity
        points = own.place[None], momentum[None]
        after = exchanged(moving, self._blocks, self._kinematics, self._body, discrete_states, points)
        after.position[node], after.velocity[node] = own.place, own.velocity
        return after.completed(self._kinematics, time, discrete_states[1])


class Component(Protocol):
    """Part of a scene.

    states : first-order states
    """

    @property
    def states(self) -> tuple[FirstOrder, ...]: ...

    def add(self, forces: Forces, blocks: Blocks, faults: list[Fault]) -> Forces:
        """Return the forces with those of the component; `faults` receives faults of its numbers."""


def _with_kernels(forces: Forces, *kernels: KernelTerm) -> Forces:
    return replace(forces, kernels=(*forces.kernels, *kernels))


@dataclass(frozen=True, eq=False)
class Reels:
    """Reels of tethers, which replace the cable law of their outlets."""

    reels: tuple[ReeledTether, ...]
    kinematics: Kinematics

    @property
    def states(self) -> tuple[FirstOrder, ...]:
        return tuple(state for item in self.reels for state in reel.states_of(item))

    def add(self, forces: Forces, blocks: Blocks, faults: list[Fault]) -> Forces:
        windings = tuple(Winding(item, blocks, forces.cable.law) for item in self.reels)
        terms = (reel_term(winding, Drum(winding, self.kinematics)) for winding in windings)
        return _with_kernels(replace(forces, cable=replace(forces.cable, reels=windings)), *terms)


@dataclass(frozen=True, eq=False)
class ShorterEdge:
    """Edge of the net that becomes shorter."""

    edge: ShortenedEdge

    @property
    def states(self) -> tuple[FirstOrder, ...]:
        return perimeter.states_of(self.edge)

    def add(self, forces: Forces, blocks: Blocks, faults: list[Fault]) -> Forces:
        shortening = Shortening(self.edge, blocks, forces.cable.law)
        cable = replace(forces.cable, shortening=shortening)
        return _with_kernels(replace(forces, cable=cable), shortening.term())


@dataclass(frozen=True, eq=False)
class DrawnLine:
    """Closing line through rings, with free strain and viscous stress as of all cables.

    states : of the line at its path at time 0
    ratio, time : as `Drawstring`
    """

    line: LineThroughRings
    states: tuple[FirstOrder, ...]
    ratio: float
    time: float

    @classmethod
    def of(cls, line: LineThroughRings, effects: Choice, position: Floats) -> DrawnLine:
        """Return the line of a net with nodes at position (n_nodes, 3) [m]."""
        damping, ratio = effects.get(MaterialDamping), float(np.sqrt(1.0 + 2.0 * effects.free_strain))
        time = 0.0 if damping is None or line.friction > 0.0 else damping.relaxation_time
        return cls(line, closing.states_of(line, position, ratio, time), ratio, time)

    def add(self, forces: Forces, blocks: Blocks, faults: list[Fault]) -> Forces:
        """Return the forces; unchanged for numbers outside the range of floating point, with a fault."""
        path = float(way_of(self.line, blocks.position).sum())
        if not path <= STRETCH_BOUND * self.ratio * self.line.length_at_start:
            faults.append(Fault("closing.length", self._too_short(path)))
        drawstring = Drawstring(self.line, blocks, self.ratio, self.time)
        if not max(drawstring.rates) <= LARGEST:
            words = "leads to numbers outside the range of floating-point: use realistic values"
            faults.append(Fault("closing", words, beyond_floats=True))
            return forces
        return _with_kernels(forces, drawstring.term())

    def _too_short(self, path: float) -> str:
        """Describe a line that is too short for its path through the rings [m]."""
        stretch, wound = path / (self.ratio * self.line.length_at_start), self.line.wound
        words = f"its path through the rings of {path:.6g} m at the start requires a stretch of {stretch:.4g}"
        words += f" ({wound:.6g} m are wound up)" if wound > 0.0 else ""
        return f"{words}, above {STRETCH_BOUND:g}, the limit of the cable law: use a longer line"


def _completed(
    layout: Layout, kinematics: Kinematics, time: float, x: Floats, v: Floats, discrete: DiscreteStates
) -> tuple[Floats, Floats]:
    """Return x and v with what has no equations of motion put in."""
    return layout.pack(layout.unpack(x, v).completed(kinematics, time, discrete)) if kinematics else (x, v)


@dataclass(frozen=True, eq=False)
class CornerUnits:
    """Corner units with thrusters.

    counted : integrate their impulses
    """

    control: Control
    kinematics: Kinematics
    script: tuple[ScriptEntry, ...]
    counted: bool

    @property
    def states(self) -> tuple[FirstOrder, ...]:
        return corner_units.states_of(self.control)

    def add(self, forces: Forces, blocks: Blocks, faults: list[Fault]) -> Forces:
        completed = partial(_completed, Layout(blocks), self.kinematics)
        waits = begins_control(self.script)
        term = corner_units.term_of(self.control, blocks, completed, waits=waits, counted=self.counted)
        return _with_kernels(forces, term)


@dataclass(frozen=True, eq=False)
class BodyThrusts:
    """Thrust on bodies by their tables, and by entries of the script.

    bodies   : those with thrust
    keys     : of the body's table; None: without one
    scripted : names of bodies on which entries thrust
    """

    bodies: tuple[RigidBody, ...]
    keys: Mapping[str, BodyThrust | None]
    scripted: frozenset[str]

    @property
    def states(self) -> tuple[FirstOrder, ...]:
        return tuple(state for body in self.bodies for state in body_thrust.states_of(body.name))

    def add(self, forces: Forces, blocks: Blocks, faults: list[Fault]) -> Forces:
        for body in self.bodies:
            keys = self.keys[body.name] or BodyThrust.model_validate({})
            arm, in_body = body.in_principal_axes(keys.point), keys.axes == "body"
            thruster = Thruster(body.name, arm, body.rotation.T if in_body else np.eye(3), in_body)
            if keys.times is not None:
                none = ((0.0, 0.0, 0.0),) * len(keys.times)
                loads = np.hstack([keys.force or none, keys.torque or none])
                term = thruster.term(blocks, np.array(keys.times), loads)
                if not largest_number(term.numbers()) <= LARGEST:
                    words = "leads to numbers outside the range of floating-point: use realistic values"
                    faults.append(Fault(f"bodies.{body.name}.thrust", words, beyond_floats=True))
                forces = _with_kernels(forces, term)
            if body.name in self.scripted:
                forces = _with_kernels(forces, thruster.scripted(blocks))
        return forces


@dataclass(frozen=True, eq=False)
class ScriptedForces:
    """Changes of forces by the script: thrusts wait, threads may be cut, coefficients are inputs."""

    script: tuple[ScriptEntry, ...]
    states: tuple[FirstOrder, ...] = ()

    def add(self, forces: Forces, blocks: Blocks, faults: list[Fault]) -> Forces:
        if begins_a_thrust(self.script):
            kernels = (
                thrust.waiting(term)
                if (term.discrete is not None and term.discrete.name == thrust.STATE_NAME)
                else term
                for term in forces.kernels
            )
            forces = replace(forces, kernels=tuple(kernels))
        if any(entry.do == "cut" for entry in self.script):
            forces = replace(forces, cable=replace(forces.cable, may_be_cut=True))
        return with_inputs(forces, self.script)
