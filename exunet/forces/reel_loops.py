"""The outlet of a reel as scalar loops, in the subset of Python that Numba compiles.

The reference length of the outlet, the element between the drum and the first node outside, is L0 = base - s,
s the length wound up, a first-order state with s' = w of `winding_rate`. With the law of all elements, a free
strain taken in (`exunet.forces.cable.Law`: natural length L1 = r L0, stiffness E1A), stretch
lambda = L / L1, strain e = (lambda^2 - 1) / 2, the energy is U = E1A e^2 L1 / 2, and at fixed ends

    dU/ds = -r dU/dL1 = r (N lambda - U / L1),    N = E1A e lambda,

which is the force that the drum feels: its power is that times w. The other end of the power is the tension N
on drum and node. Viscous stress adds tau de/dt to the strain, and takes out N_v L1 dlambda/dt.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from exunet.forces.loops import Index

Floats = NDArray[np.float64]


class Outlet(NamedTuple):
    """The outlet of a reel, and what its drive is asked for.

    drum, far : (1,) where the entries of the node at the drum and of the node outside begin
    state, rate : (1,) where the length wound up stands in x; where its rate stands in force, before that of
              the work done
    base      : reference length of the outlet were nothing wound up [m]; least: below which it is not taken
    ratio, stiffness, time : L1 / L0, E1A [N], relaxation time [s]
    rate_at_most, force, gives : of the drive, see `exunet.net.drive.Drive`
    asked     : (4,) 1.0 if a script commands the drive, else 0.0; then these three, in its words
    largest_rate : [m/s]
    longest_wound : s at which winding stops [m]; slows : distance from there, and from 0, within which the
              drum slows down [m]
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
    rate_at_most: float
    force: float
    gives: float
    asked: Floats
    largest_rate: float
    longest_wound: float
    slows: float


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
    return natural, math.sqrt(square), max(0.0, 0.5 * (square / (natural * natural) - 1.0))


def pulls(x: Any, v: Any, outlet: Any) -> Any:
    """Rate of winding w [m/s], tension [N], viscous part of it, dlambda/dt [1/s], dU/ds with it [N]."""
    natural, length, strain = stretched(x, outlet)
    stretch = length / natural
    elastic = outlet.stiffness * strain * stretch
    w = winding_rate(x[outlet.state[0]], elastic, outlet)
    tension = elastic
    parting = 0.0
    if strain > 0.0:
        i, j = outlet.drum[0], outlet.far[0]
        along = 0.0
        for c in range(3):
            along += (x[j + c] - x[i + c]) * (v[j + c] - v[i + c])
        parting = (along / length + stretch * outlet.ratio * w) / natural
        whole = strain + outlet.time * stretch * parting
        tension = outlet.stiffness * max(whole, 0.0) * stretch
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
    """What the viscous stress takes out [W]."""
    _, _, viscous, parting, _ = pulls(x, v, outlet)
    natural, _, _ = stretched(x, outlet)
    return viscous * natural * parting
