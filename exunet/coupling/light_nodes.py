"""How long a macro step may be for what is light beside a port: the net's own modes, with a port that stands.

A mode of the frequency w answers a motion of the port at its own frequency, and the port gets the mean force
of a step H in the next one: half a period or more late if H w is large, which feeds the mode. Let s be the
square of the force on the port by the mode of unit mass, over the port's mass, [1/s4]; a light mass n on
elements k between a port of mass m and a fixed end is a mode with s = k^2 / (m n). Amplitudes grow by

    H^4 s g(H w)

in a step, to first order in s, with a g that is below zero up to some H w, and below `gain` and
`most` / (H w)^4 beyond. Relaxation by the time tau takes w^2 tau H / 2 in a step. So a mode allows a step if

    slow    H^2 (w^2 / slow + k / (m spring)) <= 1: it is not fed. A line between where modes of light masses
            begin to gain, and the bound of a port on springs alone, for masses that are not light
    faint   H^4 s min(gain, most / (H w)^4) <= GROWTH
    damped  the same <= w^2 tau H / 8, a quarter of what relaxation takes

each of which holds for all shorter steps too. `tests/test_light_nodes.py` has the linear map from step to
step, by whose spectral radius the numbers are. Contact is not among what is linear here.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from exunet.coupling.net_system import NetSystem
from exunet.coupling.port_ratios import least_lengths, mobility_of
from exunet.system.stability import taut_stiffness
from exunet.system.system import System

Floats = NDArray[np.float64]

GROWTH = 2e-3  # of amplitudes in a macro step, that is not looked at: by e in five hundred
_QUARTER = 0.25  # of what relaxation takes, that may be fed: the least that no map of heavier masses exceeds
_MOST_MODES = 240
_ROUND_OFF, _NOISE = 1e-10, 1e-26


class Feeding(NamedTuple):
    """slow: (H w)^2 up to which modes of light masses gain nothing; gain, most: of g beyond."""

    slow: float
    gain: float
    most: float


class PortModes(NamedTuple):
    """Of a net beside a port that stands, just taut.

    square     : (n,) of the frequencies [1/s2]
    strength   : (n,) s of each [1/s4], by the mobility of the port's nodes
    relaxation : the least time of the net's elements [s]
    """

    square: Floats
    strength: Floats
    relaxation: float

    @classmethod
    def of(cls, net: NetSystem, port: str, together: int = 1) -> PortModes:
        """All nodes of the port are moved alike. The outlets of reels count with their least lengths.

        together : ports that are one body of the host's
        """
        system = net.simulation.start.system
        cable, number = system.forces.cable, system.blocks.rigid.index(port)
        square, strength = _beside(system, number)
        shorter = float(np.max(cable.law.natural_length / least_lengths(cable), initial=1.0))
        times = cable.law.relaxation_time
        scale = together * mobility_of(system, number)
        return cls(
            shorter * square,
            shorter**2 * scale * strength,
            0.0 if times is None else float(np.min(times, initial=math.inf)),
        )

    def longest(self, feeding: Feeding, spring: float, slope: float) -> float:
        """The longest step [s] that all modes allow, with elements of a slope, see `Ratios.at`.

        spring : k / m of the port at that slope, in parts of the bound of a port on springs alone [1/s2]
        """
        square, strength = slope * self.square, slope**2 * self.strength
        slow = 1.0 / np.sqrt(square / feeding.slow + spring)
        fed = feeding.gain * strength
        faint = np.where(feeding.most * strength <= GROWTH * square**2, math.inf, (GROWTH / fed) ** 0.25)
        damped = np.cbrt(0.5 * _QUARTER * self.relaxation * square / fed)
        # from there on the gain falls with the fourth power, and what the relaxation takes grows
        damped[damped**4 * square**2 >= feeding.most / feeding.gain] = math.inf
        return float(np.min(np.maximum(slow, np.maximum(faint, damped)), initial=math.inf))


@lru_cache(maxsize=8)
def _beside(system: System, number: int) -> tuple[Floats, Floats]:
    """Squares of frequencies and of forces on the nodes of a body, for modes of unit mass.

    Of large nets, by the space in which forces from the port come to act one after the other: its values have
    the same moments as those of all modes (block Lanczos), so it has what the port feels of them.
    """
    mass = np.repeat(system.inert_mass, 3)
    free = np.flatnonzero(np.isfinite(mass))
    scale, stiffness = 1.0 / np.sqrt(mass[free]), taut_stiffness(system)[free]
    nodes = system.kinematics.point[system.kinematics.body == number]
    force = np.zeros((len(free), 3))
    for node in nodes.tolist():
        force += scale[:, None] * stiffness[:, [3 * node, 3 * node + 1, 3 * node + 2]].toarray()
    own, basis, last = stiffness[:, free], np.zeros((len(free), 0)), force
    while basis.shape[1] < _MOST_MODES:
        for _ in range(2):  # once leaves round-off that grows
            last = last - basis @ (basis.T @ last)
        left, values, _ = np.linalg.svd(last, full_matrices=False)
        last = left[:, values > _ROUND_OFF * max(1.0, float(values.max(initial=0.0)))]
        if not last.size:
            break
        basis = np.hstack([basis, last])
        last = scale[:, None] * (own @ (scale[:, None] * last))
    small = basis.T @ (scale[:, None] * (own @ (scale[:, None] * basis)))
    square, vectors = np.linalg.eigh(0.5 * (small + small.T))
    strength = ((vectors.T @ (basis.T @ force)) ** 2).sum(axis=1)
    felt = square > _ROUND_OFF * float(square.max(initial=0.0))
    # small forces count: those of slow modes, whose masses are large
    felt &= strength > _NOISE * float(strength.max(initial=0.0))
    return square[felt], strength[felt]
