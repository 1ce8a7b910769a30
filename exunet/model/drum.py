"""Events of a reel: commands take effect, nodes of the tether go onto the drum and come off it."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from exunet.bodies.kinematics import Kinematics
from exunet.forces.reel import (
    COMMANDED,
    ON_DRUM,
    Outlet,
    Winding,
    holds_still,
    memory_name,
    step_to_node,
)
from exunet.forces.terms import Change, Memories, Switch
from exunet.model.ejection import exchanged
from exunet.model.system import Layout, Moving

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

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

    heading = "reels"
    sees_inputs = True  # commands of a script

    def __init__(self, winding: Winding, kinematics: Kinematics) -> None:
        self._winding, self._reel, self._blocks = winding, winding.reel, winding.blocks
        self._kinematics = kinematics
        self._body = self._blocks.rigid.index(self._reel.body)
        self.times = self._reel.times
        self._made: tuple[bytes, Outlet] | None = None
        self._wound = self._blocks.state(f"{self._reel.name}/wound_up")

    def in_steps(self, memory: Floats) -> bool:
        """Return True while the drum may turn, so that nodes may go on or come off."""
        return not holds_still(self._reel, memory)

    def crossed(self, time: float, x: Floats, v: Floats, memory: Floats) -> Ints:
        """Return which are due: the next command, a node onto the drum, a node off it."""
        done = int(memory[COMMANDED])
        commanded = done < len(self.times) and self.times[done] <= time
        length, limits = self._outlet(x, memory), self._outlet_at(memory)
        on = length <= limits.goes_on + limits.close
        off = length >= limits.comes_off - limits.close
        return np.flatnonzero([commanded, on, off]) if commanded or on or off else _NOTHING

    def _outlet_at(self, memory: Floats) -> Outlet:
        """Return the data of the compiled loops; cached by the discrete state."""
        key = memory.tobytes()
        if self._made is None or self._made[0] != key:
            self._made = key, self._winding.outlet(memory)
        return self._made[1]

    def _outlet(self, x: Floats, memory: Floats) -> float:
        return self._reel.outlet(int(memory[ON_DRUM]), float(x[self._wound]))

    def step_within(self, step: float, least: float, x: Floats, v: Floats, memory: Floats) -> float:
        return float(step_to_node(step, least, x, v, self._outlet_at(memory)))

    def change(
        self, time: float, x: Floats, v: Floats, memory: Floats, items: Ints, every: Memories
    ) -> Change:
        """Return the discrete state and the state after an event; the change of energy counts as lost."""
        event: dict[str, Any] = {"tether": self._reel.name, "time_s": time}
        if _COMMAND in items:
            number = float(np.searchsorted(self._reel.times, time, side="right"))
            events = ({**event, "event": f"command {int(number)}"},)
            return Change(np.array([memory[ON_DRUM], number]), events=events, more=True)
        moving = Layout(self._blocks).unpack(x.copy(), v.copy()).completed(self._kinematics, time, every)
        on = _ON in items
        number = memory[ON_DRUM] + 1.0 if on else memory[ON_DRUM]
        node = self._reel.nodes[int(number)]
        after = np.array([number if on else number - 1.0, memory[COMMANDED]])
        leaving = None if on else self._coming_off(moving, memory)
        both = every, {**every, memory_name(self._reel): after}
        moved = self._conserving_momenta(time, moving, both, node, leaving)
        x, v = Layout(self._blocks).pack(moved)
        words = "goes onto the drum" if on else "comes off the drum"
        event |= {"event": f"node {node} {words}", "node": node}
        return Change(after, None, (event,), x=x, v=v, more=True)

    def _coming_off(self, moving: Moving, memory: Floats) -> _Node:
        """Return the last node on the drum, moved onto the line from there to the next node.

        Along the line it has the velocity of the next node, since the element between them keeps its length;
        across it, the velocity interpolated along the line.
        """
        on_drum = int(memory[ON_DRUM])
        drum, node, far = (self._reel.nodes[k] for k in (0, on_drum, on_drum + 1))
        outlet = self._outlet(self._flat(moving)[0], memory)
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
        memories: tuple[Memories, Memories],
        node: int,
        leaving: _Node | None,
    ) -> Moving:
        """Return the state after a node has gone onto the drum, or, `leaving`, come off it.

        memories : discrete states before and after
        """
        sign, own = 1.0, _Node(node, moving.position[node].copy(), moving.velocity[node].copy())
        if leaving is not None:
            sign, own = -1.0, leaving
        momentum = sign * float(self._blocks.mass[node]) * own.velocity
        points = own.place[None], momentum[None]
        after = exchanged(moving, self._blocks, self._kinematics, self._body, memories, points)
        after.position[node], after.velocity[node] = own.place, own.velocity
        return after.completed(self._kinematics, time, memories[1])
