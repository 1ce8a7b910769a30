"""The guards of a run: what each state must keep to, and the words for one that does not."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from exunet.forces import cable
from exunet.forces.terms import Terms
from exunet.net.arrays import Net
from exunet.system import energy
from exunet.system.energy_scale import InPlay

Floats = NDArray[np.float64]

# The balance kinetic + elastic + potential + dissipated energy may leave its start by this part of the energy
# in play before a run is stopped, up or down: a method that swallows energy lies as much as one that makes it
# (RK44 at half its stable step loses a quarter of the energy of the paper's net, and looks calm). A converged
# run stays below 1e-5.
ENERGY_BOUND = 0.05
OF_STEPS = 0.1  # of that bound: a state whose energy is off by more is the steps' doing, whatever is wrong
# Largest stretch of an element. There the law's force N = EA E11 lambda is three times that of Hooke's law,
# EA (lambda - 1) (lambda + 1) lambda / 2: beyond, the choice of the law is all that one sees.
STRETCH_BOUND = 2.0
# Largest speed, in terms of what the scene has: the fastest start, the wave speed sqrt(E / rho), the speed
# that the potential and the forces have given. An element stretched to the bound rebounds at 5 wave speeds.
SPEED_BOUND = 10.0
_LEAST_ENERGY = 1e-12  # [J], of a net that rests


@dataclass(frozen=True)
class Look:
    """What the guards see in states (k, ...); sums that are not finite tell of states that are not.

    balance, allowed : (k,) energy balance less that of the start, and what it may be off by [J]
    stretch          : (k,) largest of an element
    speed, allowed_speed : (k,) largest of a node, and what it may be [m/s]
    gained           : (2, k) energy that potentials and forces have brought so far, see `InPlay.gained` [J]
    """

    finite: NDArray[np.bool_]
    balance: Floats
    allowed: Floats
    stretch: Floats
    speed: Floats
    allowed_speed: Floats
    gained: Floats

    @property
    def wrong(self) -> NDArray[np.bool_]:
        """(k,) True for a state that breaks a bound."""
        inside = self.finite & (np.abs(self.balance) <= self.allowed)
        inside &= (self.stretch <= STRETCH_BOUND) & (self.speed <= self.allowed_speed)
        return ~inside

    def of_steps(self, k: int) -> bool:
        """True if the steps are likely to blame for state k: its energy balance does not hold either."""
        return not (self.finite[k] and abs(self.balance[k]) <= OF_STEPS * self.allowed[k])

    def words(self, k: int) -> str:
        """What is wrong with state k."""
        if not self.finite[k]:
            return "the state is not finite"
        if self.stretch[k] > STRETCH_BOUND:
            return f"an element is longer than {STRETCH_BOUND:g} times its length, beyond the law's sense"
        if not abs(self.balance[k]) <= self.allowed[k]:
            change = "grew" if self.balance[k] > 0 else "fell, beside what was dissipated,"
            return f"the energy {change} by {abs(self.balance[k]):.3g} J (allowed {self.allowed[k]:.3g} J)"
        return f"a node runs away at {self.speed[k]:.3g} m/s (allowed {self.allowed_speed[k]:.3g} m/s)"


class Guards:
    """The bounds that follow from a start: position, velocity (n_nodes, 3)."""

    def __init__(self, net: Net, terms: Terms, position: Floats, velocity: Floats) -> None:
        self._net = net
        self._in_play = InPlay(net, terms, position, velocity)
        motion = energy.kinetic(net, velocity) + energy.elastic(net, terms, position)
        self._start = float(motion + energy.potential(terms, position[None])[0])
        self._gained = np.zeros(2)
        wave = np.sqrt((net.youngs_modulus / net.density).max(initial=0.0))  # of a just taut element
        self._speeds = float(np.linalg.norm(velocity, axis=1).max(initial=0.0) + wave)

    def look(self, terms: Terms, position: Floats, velocity: Floats, dissipated: Floats) -> Look:
        """See how states (k, n_nodes, 3) with their dissipated energy (k,) [J] keep to the bounds."""
        law = terms.law(self._net)
        squares = np.einsum("kna,kna->kn", velocity, velocity)
        length = cable.lengths(self._net, position)
        potential = energy.potential(terms, position)
        mechanical = 0.5 * (squares @ self._net.mass) + cable.elastic_energy(law, length) + potential
        balance = mechanical + dissipated - self._start
        gained = self._in_play.gained(position, velocity, potential, dissipated)
        gained = np.fmax.accumulate(np.fmax(gained, self._gained[:, None]), axis=1)  # passes over no numbers
        held = length if terms.intact is None else length * terms.intact  # what broke has any length
        given = np.sqrt(2.0 * gained[1] / float(self._net.mass.sum()))
        return Look(
            finite=np.isfinite(balance) & np.isfinite(position.sum(axis=(1, 2))),
            balance=balance,
            allowed=allowed(self._in_play.start + gained[0]),
            stretch=(held / law.natural_length).max(axis=1, initial=0.0),
            speed=np.sqrt(squares.max(axis=1, initial=0.0)),
            allowed_speed=SPEED_BOUND * (self._speeds + given),
            gained=gained,
        )

    def may_be_wrong(self, terms: Terms, strain: Floats, velocity: Floats) -> bool:
        """True if a state is too long or too fast, by E11 (k, n_elements) and velocity (k, n_nodes, 3)."""
        law = terms.law(self._net)
        longest = cable.green_lagrange_strain(STRETCH_BOUND * law.natural_length, self._net.reference_length)
        if terms.intact is not None:
            longest = np.where(terms.intact, longest, np.inf)
        fastest = float(np.abs(velocity).max(initial=0.0)) * np.sqrt(3.0)
        return bool((strain > longest).any() or fastest > SPEED_BOUND * self._speeds)

    def accept(self, look: Look, k: int) -> None:
        """Take the state k of a look as good."""
        self._gained = look.gained[:, k]


def allowed(in_play: Floats) -> Floats:
    """What the energy balance may be off by [J], by the energy in play [J]."""
    return ENERGY_BOUND * in_play + _LEAST_ENERGY


def off_by(total: Floats, in_play: float) -> Floats:
    """(k,) how far the energy balance (k,) [J] of states is off from that of the first, over the bound."""
    return np.asarray(np.abs(total - total[0]) / allowed(np.asarray(in_play)))
