"""`bending`: rotational springs where a thread runs straight on.

Two neighbouring elements of one thread store k |w|^2/2 with w = d2/L2 - d1/L1, d1 into the node between them,
d2 out of it, and k = 2 E_b I/(L1 + L2), I = A^2/(4 pi) of a solid circle.  For small angles |w| is the angle
between them and k the stiffness E_b I over the mean length: the discrete rod of Bergou et al., ACM Trans.
Graph. 27 (2008), doi:10.1145/1360612.1360662, without torsion.
"""

from __future__ import annotations

import math
from collections import defaultdict
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array

from reference_impl.arrays import Floats, Ints
from reference_impl.net import Net

STRAIGHT = 1e-6  # [rad]


@dataclass(frozen=True)
class Bending:
    """Modulus E_b [Pa]."""

    modulus: float


@dataclass(frozen=True, eq=False)
class Hinges:
    """p pairs of neighbouring elements; w = d2/L2 - d1/L1 is the sum of their vectors over signed lengths."""

    pairs: Ints  # (p, 2) elements
    share: Floats  # (p, 2) [1/m]: over the reference length, + where the element leaves the node between them
    stiffness: Floats  # (p,) [J]
    collecting: csr_array  # (m, 2p) ones: which elements the pairs' first, then their second ones are

    def kinks(self, d: Floats) -> Floats:
        """w (..., p, 3) [-] of element vectors d (..., m, 3) [m].  Two terms: no order of additions."""
        one, two = (self.share[:, k, None] * d.take(self.pairs[:, k], axis=-2) for k in (0, 1))
        return np.asarray(one + two)

    def pull(self, d: Floats) -> Floats:
        """Derivative (m, 3) [N] of the energy with respect to d: acts with - on end j, + on end i."""
        moment = self.stiffness[:, None] * self.kinks(d)
        terms = [self.share[:, k, None] * moment for k in (0, 1)]
        return np.asarray(self.collecting @ np.concatenate(terms))

    def energy(self, d: Floats) -> Floats:
        """Energy (...) [J] of element vectors (..., m, 3)."""
        return np.asarray(0.5 * np.sum(self.kinks(d) ** 2, axis=-1) @ self.stiffness)


def hinges(bending: Bending, net: Net) -> Hinges:
    """The pairs of a net: of one kind (cables, strings, a tether) and area, straight within STRAIGHT."""
    size = np.linalg.norm(net.direction, axis=1, keepdims=True)
    away = net.direction / np.where(size > 0.0, size, 1.0)  # a tether whose ends coincide has no direction
    leaving: dict[int, list[tuple[int, float]]] = defaultdict(list)  # node: element, sign of d away from it
    for e, (i, j) in enumerate(net.element_nodes.tolist()):
        leaving[i].append((e, 1.0))
        leaving[j].append((e, -1.0))
    first, second, senses = [], [], []
    for ends in leaving.values():
        for count, (e, out) in enumerate(ends):
            for f, other in ends[:count]:
                if (net.of_string[e], net.tether[e]) != (net.of_string[f], net.tether[f]):
                    continue
                if net.area[e] != net.area[f]:
                    continue
                gap = np.linalg.norm(out * away[e] + other * away[f])  # 0 where opposite: 2 sin(angle/2)
                if gap <= 2.0 * math.sin(0.5 * STRAIGHT):
                    first.append(e)
                    second.append(f)
                    senses.append((out, other))
    one, two = np.array(first, dtype=np.intp), np.array(second, dtype=np.intp)
    length = net.reference_length
    # d2 = out d_e and d1 = -other d_f: with each element directed away from the node, w is a sum
    share = np.array(senses).reshape(-1, 2) / np.column_stack((length[one], length[two]))
    place = (np.concatenate((one, two)), np.arange(2 * len(one)))
    collecting = csr_array((np.ones(2 * len(one)), place), shape=(len(length), 2 * len(one)))
    inertia = net.area[one] ** 2 / (4.0 * math.pi)
    stiffness = 2.0 * bending.modulus * inertia / (length[one] + length[two])
    return Hinges(np.column_stack((one, two)), share, stiffness, collecting)
