"""The events of a reel: commands come in force, nodes of the tether go onto the drum and come off it."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from exunet.bodies.kinematics import Kinematics
from exunet.forces.reel import COMMANDED, ON_DRUM, Outlet, Winding, holds_still, memory_name, pulls
from exunet.forces.terms import Change, Memories
from exunet.net.reel import CLOSE, LARGEST_OUTLET, LEAST_OUTLET
from exunet.system.ejection import exchanged
from exunet.system.system import Layout, Moving

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

_COMMAND, _ON, _OFF = range(3)
_NOTHING = np.zeros(0, dtype=np.int64)
_WITHIN = 0.999  # of CLOSE, at which a step is to end: round-off decides nothing


class _Node(NamedTuple):
    """A node in motion: its number, place [m] and velocity [m/s]."""

    number: int
    place: Floats
    velocity: Floats


class Drum:
    """The switch of a reel's term: at one instant first commands, then nodes until none is due.

    When a node goes onto the drum or comes off it, the body, what it holds already, and the node keep their
    momentum and angular momentum together, unless a guide moves the body; the energy that this takes is
    booked as lost.
    """

    heading = "reels"
    sees_inputs = True  # what a script commands

    def __init__(self, winding: Winding, kinematics: Kinematics) -> None:
        self._winding, self._reel, self._blocks = winding, winding.reel, winding.blocks
        self._kinematics = kinematics
        self._body = self._blocks.rigid.index(self._reel.body)
        self.times = self._reel.times
        part = self._reel.element_length
        self._least, self._largest = LEAST_OUTLET * part, LARGEST_OUTLET * part
        self._close = CLOSE * part
        self._made: tuple[bytes, Outlet] | None = None
        self._wound = self._blocks.state(f"{self._reel.name}/wound_up")

    def in_steps(self, memory: Floats) -> bool:
        """Nodes go on and come off while the drum may turn."""
        return not holds_still(self._reel, memory)

    def crossed(self, time: float, x: Floats, v: Floats, memory: Floats) -> Ints:
        """The next command, a node that goes onto the drum, one that comes off."""
        done = int(memory[COMMANDED])
        commanded = done < len(self.times) and self.times[done] <= time
        outlet = self._outlet(x, memory)
        on = outlet <= self._least + self._close and self._may_go_on(memory)
        off = outlet >= self._largest - self._close and memory[ON_DRUM] > 0.0
        return np.flatnonzero([commanded, on, off]) if commanded or on or off else _NOTHING

    def _outlet_at(self, memory: Floats) -> Outlet:
        """What the loops take; made anew for another memory only."""
        key = memory.tobytes()
        if self._made is None or self._made[0] != key:
            self._made = key, self._winding.outlet(memory)
        return self._made[1]

    def _outlet(self, x: Floats, memory: Floats) -> float:
        return self._reel.outlet(int(memory[ON_DRUM]), float(x[self._wound]))

    def _may_go_on(self, memory: Floats) -> bool:
        return int(memory[ON_DRUM]) + 1 < len(self._reel.elements)

    def step_within(self, step: float, least: float, x: Floats, v: Floats, memory: Floats) -> float:
        """A step [s] at whose end, at the rate of now, the outlet is just within reach of a limit.

        Not at the limit itself: a drive that slows down before its own limit may only come close to it. The
        same step if it goes no farther beyond the limit than what is within reach.
        """
        if not self.in_steps(memory):
            return step
        rate = float(pulls(x, v, self._outlet_at(memory))[0])
        if rate > 0.0 and self._may_go_on(memory):
            way = self._outlet(x, memory) - self._least
        elif rate < 0.0 and memory[ON_DRUM] > 0.0:
            way = self._largest - self._outlet(x, memory)
        else:
            return step
        if abs(rate) * step <= way + self._close:
            return step
        return min(step, max(least, (way - _WITHIN * self._close) / abs(rate)))

    def change(
        self, time: float, x: Floats, v: Floats, memory: Floats, items: Ints, every: Memories
    ) -> Change:
        """The memory and the state after one of them; the energy that is lost is the change of all energy."""
        told = {"tether": self._reel.name, "time_s": time}
        if _COMMAND in items:
            number = float(np.searchsorted(self._reel.times, time, side="right"))
            events = ({**told, "event": f"command {int(number)}"},)
            return Change(np.array([memory[ON_DRUM], number]), events=events, more=True)
        moving = Layout(self._blocks).unpack(x.copy(), v.copy()).completed(self._kinematics, time, every)
        on = _ON in items
        number = memory[ON_DRUM] + 1.0 if on else memory[ON_DRUM]
        node = self._reel.nodes[int(number)]
        after = np.array([number if on else number - 1.0, memory[COMMANDED]])
        loose = None if on else self._coming_off(moving, memory)
        both = every, {**every, memory_name(self._reel): after}
        moved = self._with_same_momenta(time, moving, both, node, loose)
        x, v = Layout(self._blocks).pack(moved)
        words = "goes onto the drum" if on else "comes off the drum"
        event: dict[str, Any] = {**told, "event": f"node {node} {words}", "node": node}
        return Change(after, None, (event,), x=x, v=v, more=True)

    def _coming_off(self, moving: Moving, memory: Floats) -> _Node:
        """The last node that went onto the drum, on the line from there to the next one.

        Along that line it has the velocity of the next node, since the element between them keeps its length;
        across it that of its place on the line.
        """
        on_drum = int(memory[ON_DRUM])
        drum, node, far = (self._reel.nodes[k] for k in (0, on_drum, on_drum + 1))
        outlet = self._outlet(self._flat(moving)[0], memory)
        part = (outlet - self._reel.element_length) / outlet
        line = moving.position[far] - moving.position[drum]
        apart = moving.velocity[far] - moving.velocity[drum]
        size = float(np.linalg.norm(line))
        way = line / size if size > 0.0 else np.zeros(3)
        place = moving.position[drum] + part * line
        velocity = moving.velocity[drum] + part * apart + (1.0 - part) * (apart @ way) * way
        return _Node(node, place, velocity)

    def _flat(self, moving: Moving) -> tuple[Floats, Floats]:
        return Layout(self._blocks).pack(moving)

    def _with_same_momenta(
        self, time: float, moving: Moving, memories: tuple[Memories, Memories], node: int, loose: _Node | None
    ) -> Moving:
        """The state after a node has gone onto the drum, or, `loose`, come off it.

        memories : all, before and after
        """
        sign, one = 1.0, _Node(node, moving.position[node].copy(), moving.velocity[node].copy())
        if loose is not None:
            sign, one = -1.0, loose
        momentum = sign * float(self._blocks.mass[node]) * one.velocity
        points = one.place[None], momentum[None]
        after = exchanged(moving, self._blocks, self._kinematics, self._body, memories, points)
        after.position[node], after.velocity[node] = one.place, one.velocity
        return after.completed(self._kinematics, time, memories[1])
