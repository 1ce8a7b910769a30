"""Reels as force terms: the law of the outlet as scalar loops, commands, nodes on the drum.

The reference length of the outlet, the element between the drum and the first node outside, is L0 = base - s,
s the length wound up, a first-order state with s' = w of `winding_rate`. With the law of all elements, a free
strain taken in (`exunet.forces.cable.Law`: natural length L1 = r L0, stiffness E1A), stretch
lambda = L / L1, strain e, the energy is U = E1A e^2 L1 / 2, and at fixed ends

    dU/ds = -r dU/dL1 = r (N lambda - U / L1),    N = E1A e de/dlambda,

which is the force that the drum feels: its power is that times w. The other end of the power is the tension N
on drum and node. Viscous stress adds tau de/dt to the strain, and takes out N_v L1 dlambda/dt.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from exunet.base.arrays import Floats
from exunet.forces import cable
from exunet.forces.blocks import Blocks, FirstOrder
from exunet.forces.cable import AxialLaw
from exunet.forces.law import green_lagrange_strain, growth_at, hooke_tension, strain_between
from exunet.forces.law import tension as tension_of
from exunet.forces.loops import Index
from exunet.forces.terms import DiscreteState, DiscreteStates, Input, KernelTerm, Switch
from exunet.net.tether import CLOSE, LARGEST_OUTLET, LEAST_OUTLET, ReeledTether


class Outlet(NamedTuple):
    """Outlet of a reel and the command of its drive.

    drum, far : (1,) where the entries of the node at the drum and of the node outside begin
    state, rate : (1,) where the length wound up stands in x; where its rate stands in force, before that of
              the work done
    base      : reference length of the outlet were nothing wound up [m]; least: below which it is not taken
    ratio, stiffness, time : L1 / L0, E1A [N], relaxation time [s]
    law       : number of its law, 0 or 1
    rate_at_most, force, gives : of the drive, see `exunet.net.drive.Drive`
    asked     : (4,) 1.0 if a script commands the drive, else 0.0; then these three, in its words
    largest_rate : [m/s]
    longest_wound : s at which winding stops [m]; slows : distance from there, and from 0, within which the
              drum slows down [m]
    goes_on, comes_off : reference lengths at which the next node goes onto the drum and the last comes off it
              [m]; -inf, inf without one; close: distance from there that counts as none [m]
    """

    drum: NDArray[Index]
    far: NDArray[Index]
    state: NDArray[Index]
    rate: NDArray[Index]
    base: float
    least: float
    ratio: float
    stiffness: float
    time: float
    law: int
    rate_at_most: float
    force: float
    gives: float
    asked: Floats
    largest_rate: float
    longest_wound: float
    slows: float
    goes_on: float
    comes_off: float
    close: float


def winding_rate(wound: float, pull: float, outlet: Any) -> float:
    """Rate [m/s] at which a drive winds up against an elastic tension [N].

    The rate of the command, or, if that is less, what the pull leaves of its force over the damping of the
    drive: what winds up pulls by that force at most. Within the limit of rate; in proportion to the way left
    near the limits of length.
    """
    rate, force, gives = outlet.rate_at_most, outlet.force, outlet.gives
    if outlet.asked[0] > 0.0:
        rate, force, gives = outlet.asked[1:]
    if gives > 0.0:
        rate = min(rate, gives * (force - pull))
    rate = max(-outlet.largest_rate, min(outlet.largest_rate, rate))
    way = outlet.longest_wound - wound if rate > 0.0 else wound
    return rate * max(0.0, min(1.0, way / outlet.slows))


def stretched(x: Any, outlet: Any) -> Any:
    """Natural length [m], length [m] and strain of the outlet, which is zero where it is slack."""
    i, j = outlet.drum[0], outlet.far[0]
    dx = x[j] - x[i]
    dy = x[j + 1] - x[i + 1]
    dz = x[j + 2] - x[i + 2]
    natural = outlet.ratio * max(outlet.base - x[outlet.state[0]], outlet.least)
    square = dx * dx + dy * dy + dz * dz
    return natural, math.sqrt(square), strain_between(outlet.law, square, natural)


def pulls(x: Any, v: Any, outlet: Any) -> Any:
    """Rate of winding w [m/s], tension [N], viscous part of it, dlambda/dt [1/s], dU/ds with it [N]."""
    natural, length, strain = stretched(x, outlet)
    stretch = length / natural
    growth = growth_at(outlet.law, stretch)
    elastic = outlet.stiffness * strain * growth
    w = winding_rate(x[outlet.state[0]], elastic, outlet)
    tension = elastic
    parting = 0.0
    if strain > 0.0:
        i, j = outlet.drum[0], outlet.far[0]
        along = 0.0
        for c in range(3):
            along += (x[j + c] - x[i + c]) * (v[j + c] - v[i + c])
        parting = (along / length + stretch * outlet.ratio * w) / natural
        whole = strain + outlet.time * growth * parting
        tension = outlet.stiffness * max(whole, 0.0) * growth
    felt = outlet.ratio * (tension * stretch - 0.5 * outlet.stiffness * strain * strain)
    return w, tension, tension - elastic, parting, felt


def add_outlet(t: float, x: Any, v: Any, outlet: Any, force: Any) -> None:
    """The tension on drum and node, the rate of winding, and the power of the drum."""
    w, tension, _, _, felt = pulls(x, v, outlet)
    k = outlet.rate[0]
    force[k] += w
    force[k + 1] += felt * w
    if tension > 0.0:
        i, j = outlet.drum[0], outlet.far[0]
        _, length, _ = stretched(x, outlet)
        for c in range(3):
            pull = tension * (x[j + c] - x[i + c]) / length
            force[i + c] += pull
            force[j + c] -= pull


def energy_of_outlet(x: Any, outlet: Any) -> float:
    """U [J]."""
    natural, _, strain = stretched(x, outlet)
    return 0.5 * outlet.stiffness * strain * strain * natural


def power_in_outlet(t: float, x: Any, v: Any, outlet: Any) -> float:
    """Compute the power that the viscous stress dissipates [W]."""
    _, _, viscous, parting, _ = pulls(x, v, outlet)
    natural, _, _ = stretched(x, outlet)
    return viscous * natural * parting


def node_is_due(t: float, x: Any, v: Any, outlet: Any) -> float:
    """Length [m] beyond which a node goes onto the drum or comes off it."""
    length = outlet.base - x[outlet.state[0]]
    return max(outlet.goes_on + outlet.close - length, length - (outlet.comes_off - outlet.close))


def step_to_node(step: float, least: float, x: Any, v: Any, outlet: Any) -> float:
    """A step [s] at whose end, at the present rate, the outlet is within `close` of a node's length.

    Not at that length itself: a drive that slows down before its own limit may only come close to it. A part
    of `close` makes the end independent of round-off.
    """
    rate, _, _, _, _ = pulls(x, v, outlet)
    length = outlet.base - x[outlet.state[0]]
    left = np.inf
    if rate > 0.0:
        left = length - outlet.goes_on
    elif rate < 0.0:
        left = outlet.comes_off - length
    if abs(rate) * step <= left + outlet.close:
        return step
    return min(step, max(least, (left - 0.999 * outlet.close) / abs(rate)))


NOTHING_ASKED = np.zeros(4)


def discrete_name(reel: ReeledTether) -> str:
    """Return the name of its discrete state: number of nodes on the drum, number of commands so far."""
    return f"{reel.name}/reel"


def command_name(tether: str) -> str:
    """Return the name of the input by which a script commands the reel of a tether."""
    return f"reel/{tether}"


def states_of(reel: ReeledTether) -> tuple[FirstOrder, FirstOrder]:
    """Length wound up [m], and work that the drum has done on the tether [J]."""
    wound = FirstOrder(f"{reel.name}/wound_up", (reel.wound,), "m")
    return wound, FirstOrder(f"{reel.name}/work", (0.0,), "J", gives=1.0)


# In the discrete state of a reel: how many of its nodes are on the drum, which command is in force, and where
# what a script asks begins, if it does.
ON_DRUM, COMMANDED, ASKED = 0, 1, 2


def at_start(reel: ReeledTether) -> Floats:
    """The discrete state at time 0."""
    return np.array([float(reel.on_drum), float(np.searchsorted(reel.times, 0.0, side="right"))])


@dataclass(frozen=True, eq=False)
class Winding:
    """A reel in a scene: data of its outlet at a discrete state, and elements that the cable term leaves out.

    law : of all elements
    """

    reel: ReeledTether
    blocks: Blocks
    law: AxialLaw

    def outlet(self, discrete: Floats) -> Outlet:
        """Build the data for the loops; discrete: of the reel, then the commands of a script, if any."""
        reel, blocks, on_drum = self.reel, self.blocks, int(discrete[ON_DRUM])
        element, drive = reel.elements[on_drum], reel.drives[int(discrete[COMMANDED])]
        part, natural = reel.element_length, float(self.law.natural_length[element])
        time = self.law.relaxation_time
        may_go_on = on_drum + 1 < len(reel.elements)
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
            law=0 if self.law.number is None else int(self.law.number[element]),
            rate_at_most=drive.rate,
            force=drive.force,
            gives=drive.gives,
            asked=discrete[ASKED:] if len(discrete) > ASKED else NOTHING_ASKED,
            largest_rate=reel.largest_rate,
            longest_wound=reel.length - reel.shortest,
            slows=LEAST_OUTLET * part,
            goes_on=LEAST_OUTLET * part if may_go_on else -np.inf,
            comes_off=LARGEST_OUTLET * part if on_drum else np.inf,
            close=CLOSE * part,
        )

    def outlet_now(self, discrete: DiscreteStates) -> tuple[int, Outlet]:
        """The element that is the outlet at these discrete states, and what the loops take of it."""
        held = discrete.get(discrete_name(self.reel), at_start(self.reel))
        asked = discrete.get(command_name(self.reel.name), NOTHING_ASKED)
        return self.reel.elements[int(held[0])], self.outlet(np.concatenate([held, asked]))

    def drawn(self, discrete: DiscreteStates, x: Floats) -> float:
        """Kinetic energy [J] of the tether at the rate at which the drum turns where nothing pulls.

        x (n_x,), with these discrete states.
        """
        _, outlet = self.outlet_now(discrete)
        rate = winding_rate(float(x[outlet.state[0]]), 0.0, outlet)
        return 0.5 * float(self.blocks.mass[list(self.reel.nodes)].sum()) * rate**2

    @property
    def name(self) -> str:
        """Return the name of the tether."""
        return self.reel.name

    def on_drum(self, discrete: DiscreteStates) -> int:
        """How many nodes are on the drum at these discrete states; at the start without any."""
        name = discrete_name(self.reel)
        return int(discrete[name][0]) if name in discrete else self.reel.on_drum

    def left_out(self, discrete: DiscreteStates) -> tuple[int, ...]:
        """The elements on the drum, and the outlet."""
        return self.reel.elements[: self.on_drum(discrete) + 1]

    def outlets(self, discrete: DiscreteStates, x: Floats, v: Floats) -> tuple[int, Floats, Floats]:
        """The outlet's element, and its Green-Lagrange strain and tension [N], (k,) each, in k states.

        x (k, n_x), v (k, n_v) with equal discrete states. The same as `pulls`, for arrays.
        """
        element, outlet = self.outlet_now(discrete)
        drum, far = int(outlet.drum[0]), int(outlet.far[0])
        span, parting = (part[:, far : far + 3] - part[:, drum : drum + 3] for part in (x, v))
        length = np.sqrt(np.einsum("ka,ka->k", span, span))
        wound = x[:, int(outlet.state[0])]
        reference = np.maximum(outlet.base - wound, outlet.least)
        natural = outlet.ratio * reference
        law = outlet.law == 1
        tension = (hooke_tension if law else tension_of)(length, natural, outlet.stiffness)
        if outlet.time > 0.0:
            along = np.einsum("ka,ka->k", span, parting)
            rate = np.divide(along, length, out=np.zeros_like(along), where=length > 0.0)
            # An element of constant length parts so too that has this rate of the stretch.
            rate += length / natural * outlet.ratio * self._rates(wound, tension, outlet)
            viscous = cable.hooke_viscous_tension if law else cable.viscous_tension
            tension = viscous(length, rate, natural, outlet.stiffness, outlet.time)
        strain = green_lagrange_strain(length, reference)
        return element, np.asarray(strain), np.asarray(tension)

    def _rates(self, wound: Floats, pull: Floats, outlet: Outlet) -> Floats:
        rows = zip(wound.tolist(), pull.tolist(), strict=True)
        return np.array([winding_rate(s, n, outlet) for s, n in rows])


def reel_term(winding: Winding, switch: Switch) -> KernelTerm:
    """The term of a reel; switch : of its events."""
    reel, blocks = winding.reel, winding.blocks
    discrete = DiscreteState(discrete_name(reel), at_start(reel), winding.outlet)
    data = winding.outlet(discrete.initial)
    natural = data.ratio * LEAST_OUTLET * reel.element_length
    mass = blocks.mass[list(reel.nodes)].min()
    slope = data.stiffness / natural  # of the tension over the length
    drives = max(drive.gives for drive in (*reel.drives, reel.softest))
    asked = Input(command_name(reel.name), "asked", NOTHING_ASKED, "1, m/s, N, m/(N s)")
    return KernelTerm(
        "tethers",
        add_outlet,
        data,
        potential=energy_of_outlet,
        power=power_in_outlet if data.time > 0.0 else None,
        helpers=(strain_between, growth_at, winding_rate, stretched, pulls),
        stiffness_rate=2.0 * slope / mass,
        damping_rate=slope * (drives + 2.0 * data.time / mass),
        discrete=discrete,
        switch=switch,
        event=node_is_due,
        shorten=step_to_node,
        inputs=(asked,) if reel.is_commanded else (),
    )
