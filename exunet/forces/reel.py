"""Reels as force terms: the law of the outlet under the command and with the nodes on the drum of now."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from exunet.forces import cable
from exunet.forces.blocks import Blocks, FirstOrder
from exunet.forces.cable import Law
from exunet.forces.loops import Index
from exunet.forces.reel_loops import (
    Outlet,
    add_outlet,
    energy_of_outlet,
    power_in_outlet,
    pulls,
    stretched,
    winding_rate,
)
from exunet.forces.terms import Input, KernelTerm, Memories, Memory, Switch
from exunet.net.drive import Drive
from exunet.net.reel import LEAST_OUTLET, Reel

Floats = NDArray[np.float64]


NOTHING_ASKED = np.zeros(4)


def memory_name(reel: Reel) -> str:
    """Of the memory: number of nodes on the drum, number of commands that have come."""
    return f"{reel.name}/reel"


def command_name(tether: str) -> str:
    """Of the input by which a script commands the reel of a tether."""
    return f"reel/{tether}"


def states_of(reel: Reel) -> tuple[FirstOrder, FirstOrder]:
    """Length wound up [m], and work that the drum has done on the tether [J]."""
    wound = FirstOrder(f"{reel.name}/wound_up", (reel.wound,), "m")
    return wound, FirstOrder(f"{reel.name}/work", (0.0,), "J", gives=1.0)


# In the memory of a reel: how many of its nodes are on the drum, which command is in force, and where what a
# script asks begins, if it does.
ON_DRUM, COMMANDED, ASKED = 0, 1, 2


def at_start(reel: Reel) -> Floats:
    """The memory at time 0."""
    return np.array([float(reel.on_drum), float(np.searchsorted(reel.times, 0.0, side="right"))])


def holds_still(reel: Reel, memory: Floats) -> bool:
    """True if the drum does not turn, whatever pulls; memory: as of `Winding.outlet`."""
    asked = memory[ASKED:] if len(memory) > ASKED else NOTHING_ASKED
    drive = Drive(*asked[1:].tolist()) if asked[0] > 0.0 else reel.drives[int(memory[COMMANDED])]
    return drive.is_locked


@dataclass(frozen=True, eq=False)
class Winding:
    """A reel in a scene: the data of its outlet at a memory, and which elements the cable term leaves to it.

    law : of all elements
    """

    reel: Reel
    blocks: Blocks
    law: Law

    def outlet(self, memory: Floats) -> Outlet:
        """What the loops take; memory: of the reel, followed by what a script asks, if anything."""
        reel, blocks, on_drum = self.reel, self.blocks, int(memory[ON_DRUM])
        element, drive = reel.elements[on_drum], reel.drives[int(memory[COMMANDED])]
        part, natural = reel.element_length, float(self.law.natural_length[element])
        time = self.law.relaxation_time
        drum, far = reel.nodes[0], reel.nodes[on_drum + 1]
        return Outlet(
            drum=np.array([3 * drum], dtype=Index),
            far=np.array([3 * far], dtype=Index),
            state=np.array([blocks.state(f"{reel.name}/wound_up")], dtype=Index),
            rate=np.array([blocks.rate(f"{reel.name}/wound_up")], dtype=Index),
            base=(on_drum + 1) * part,
            least=0.5 * LEAST_OUTLET * part,
            ratio=natural / part,
            stiffness=float(self.law.stiffness[element]),
            time=0.0 if time is None else float(time[element]),
            rate_at_most=drive.rate,
            force=drive.force,
            gives=drive.gives,
            asked=memory[ASKED:] if len(memory) > ASKED else NOTHING_ASKED,
            largest_rate=reel.largest_rate,
            longest_wound=reel.length - reel.shortest,
            slows=LEAST_OUTLET * part,
        )

    def outlet_now(self, memory: Memories) -> tuple[int, Outlet]:
        """The element that is the outlet at these memories, and what the loops take of it."""
        held = memory.get(memory_name(self.reel), at_start(self.reel))
        asked = memory.get(command_name(self.reel.name), NOTHING_ASKED)
        return self.reel.elements[int(held[0])], self.outlet(np.concatenate([held, asked]))

    def is_locked(self, memory: Memories) -> bool:
        """True if the drum does not turn at these memories, whatever pulls."""
        held = memory.get(memory_name(self.reel), at_start(self.reel))
        asked = memory.get(command_name(self.reel.name), NOTHING_ASKED)
        return holds_still(self.reel, np.concatenate([held, asked]))

    def drawn(self, memory: Memories, x: Floats) -> float:
        """Kinetic energy [J] of the tether at the rate at which the drum turns where nothing pulls.

        x (n_x,), with these memories.
        """
        _, outlet = self.outlet_now(memory)
        rate = winding_rate(float(x[outlet.state[0]]), 0.0, outlet)
        return 0.5 * float(self.blocks.mass[list(self.reel.nodes)].sum()) * rate**2

    @property
    def name(self) -> str:
        """Of the tether."""
        return self.reel.name

    def on_drum(self, memory: Memories) -> int:
        """How many nodes are on the drum at these memories; at the start without any."""
        name = memory_name(self.reel)
        return int(memory[name][0]) if name in memory else self.reel.on_drum

    def left_out(self, memory: Memories) -> tuple[int, ...]:
        """The elements on the drum, and the outlet."""
        return self.reel.elements[: self.on_drum(memory) + 1]

    def outlets(self, memory: Memories, x: Floats, v: Floats) -> tuple[int, Floats, Floats]:
        """The outlet's element, and its Green-Lagrange strain and tension [N], (k,) each, in k states.

        x (k, n_x), v (k, n_v) with one memory. The same as `reel_loops.pulls`, for arrays.
        """
        element, outlet = self.outlet_now(memory)
        drum, far = int(outlet.drum[0]), int(outlet.far[0])
        span, parting = (part[:, far : far + 3] - part[:, drum : drum + 3] for part in (x, v))
        length = np.sqrt(np.einsum("ka,ka->k", span, span))
        wound = x[:, int(outlet.state[0])]
        reference = np.maximum(outlet.base - wound, outlet.least)
        natural = outlet.ratio * reference
        tension = cable.tension(length, natural, outlet.stiffness)
        if outlet.time > 0.0:
            along = np.einsum("ka,ka->k", span, parting)
            rate = np.divide(along, length, out=np.zeros_like(along), where=length > 0.0)
            # An element of constant length parts so too that has this rate of the stretch.
            rate += length / natural * outlet.ratio * self._rates(wound, tension, outlet)
            tension = cable.viscous_tension(length, rate, natural, outlet.stiffness, outlet.time)
        strain = cable.green_lagrange_strain(length, reference)
        return element, np.asarray(strain), np.asarray(tension)

    def _rates(self, wound: Floats, pull: Floats, outlet: Outlet) -> Floats:
        rows = zip(wound.tolist(), pull.tolist(), strict=True)
        return np.array([winding_rate(s, n, outlet) for s, n in rows])


def reel_term(winding: Winding, switch: Switch) -> KernelTerm:
    """The term of a reel; switch : of its events."""
    reel, blocks = winding.reel, winding.blocks
    memory = Memory(memory_name(reel), at_start(reel), winding.outlet)
    data = winding.outlet(memory.initial)
    natural = data.ratio * LEAST_OUTLET * reel.element_length
    mass = blocks.mass[list(reel.nodes)].min()
    slope = data.stiffness / natural  # of the tension over the length
    drives = max(one.gives for one in (*reel.drives, reel.softest))
    asked = Input(command_name(reel.name), "asked", NOTHING_ASKED, "1, m/s, N, m/(N s)")
    return KernelTerm(
        "tethers",
        add_outlet,
        data,
        potential=energy_of_outlet,
        power=power_in_outlet if data.time > 0.0 else None,
        helpers=(winding_rate, stretched, pulls),
        stiffness_rate=2.0 * slope / mass,
        damping_rate=slope * (drives + 2.0 * data.time / mass),
        memory=memory,
        switch=switch,
        inputs=(asked,) if reel.is_commanded else (),
    )
