"""Bending stiffness of threads: a rotational spring at each node where a thread runs straight on.

The spring between elements with the vectors d1, d2 and the reference lengths L1, L2 has the energy k |d2 / L2
- d1 / L1|^2 / 2, k = E_b I / ((L1 + L2) / 2), which for taut elements is k (1 - cos angle), the discrete
elastica (Bergou et al., ACM Trans. Graph. 27 (2008) 63, doi 10.1145/1360612.1360662, at small strain). It is
written with reference lengths so that it is quadratic: a constant stiffness, the same in every form of the
engine, without the infinite forces that angles have where nodes meet. A slack element, whose thread is curved
within, is softer.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import ClassVar

import numpy as np
import scipy
from pydantic import Field

from exunet.base.record import NonNegative
from exunet.forces.blocks import Blocks
from exunet.forces.effect import Effect
from exunet.forces.estimate import Estimate, EstimateBasis
from exunet.forces.linear_term import LinearTerm
from exunet.net.arrays import Net

STRAIGHT = 1e-6  # sine of the largest angle in the reference configuration over which a thread runs on


class Bending(Effect):
    """Rotational springs along the threads of the net."""

    EXCLUDES: ClassVar = {"breaking": "the springs would remain across a broken element"}
    INTERNAL: ClassVar = True
    NOT_WITH: ClassVar = {
        "reels": "threads on a drum have no bending stiffness",
        "perimeter": "its stiffness is of threads that keep their length",
    }

    modulus: NonNegative = Field(
        description="E_b [Pa] with I of a solid circular section; a loose yarn has far less than E",
        examples=[1e8],
    )

    def springs(self, net: Net) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return nodes (k, 3), weights (k, 3) [1/m] in d2 / L2 - d1 / L1, and spring constants (k,) [N m]."""
        nodes, length, elements = joints(net)
        weight = np.stack([1.0 / length[:, 0], -(1.0 / length).sum(axis=1), 1.0 / length[:, 1]], axis=1)
        inertia = net.area[elements[:, 0]] ** 2 / (4.0 * math.pi)  # of a solid circle
        return nodes, weight, self.modulus * inertia / length.mean(axis=1)

    def terms(self, blocks: Blocks) -> tuple[LinearTerm, ...]:
        """Return the constant stiffness of all springs; nothing without springs."""
        nodes, weight, constant = self.springs(blocks.net)
        if not len(nodes) or not constant.any():
            return ()
        rows = np.repeat(np.arange(len(nodes)), 3)
        turn = scipy.sparse.csr_array(
            (weight.ravel(), (rows, nodes.ravel())), shape=(len(nodes), blocks.n_points)
        )
        along = scipy.sparse.csr_array(turn.T @ (turn * constant[:, None]))
        return (LinearTerm(stiffness=scipy.sparse.csr_array(scipy.sparse.kron(along, np.eye(3)))),)

    @classmethod
    def nominal(cls, basis: EstimateBasis) -> tuple[Bending, str]:
        """Assume a solid thread, the most there can be."""
        modulus = float(basis.net.youngs_modulus.max(initial=0.0))
        return Bending(modulus=modulus), f"a solid thread, E_b = E = {modulus:.3g} Pa (an upper bound)"

    def magnitude(self, basis: EstimateBasis) -> Estimate:
        """Estimate forces of threads bent by one radian at each node, and their way until straight."""
        net = basis.net
        nodes, weight, constant = self.springs(net)
        force = np.zeros((net.n_nodes, 3))
        square = np.zeros(net.n_nodes)
        for column in range(3):
            np.add.at(square, nodes[:, column], (constant * weight[:, column]) ** 2)
        force[:, 0] = np.sqrt(square)
        bent = np.zeros((net.n_nodes, 3))
        bent[np.unique(nodes), 0] = 0.5 * float(net.reference_length.mean()) if len(nodes) else 0.0
        acceleration = basis.of_force(force)
        way = min(basis.ballistic(acceleration), basis.rms(bent))
        torque = float(constant.max(initial=0.0))
        return Estimate(acceleration, way, f"springs of E_b I / L = {torque:.2g} N m bent by 1 rad")


def joints(net: Net) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Where threads run on: (nodes (k, 3) before, at and after; lengths (k, 2) [m]; elements (k, 2)).

    A thread is a chain of elements of one kind (cables of the net, or strings) and section that run on within
    `STRAIGHT` in the reference configuration; at a crossing each thread runs on by itself. A tether is a
    separate thread, from its start to its end.
    """
    table = np.array([*_in_the_net(net.alone), *_in_tethers(net)], dtype=np.int64).reshape(-1, 5)
    return table[:, :3], net.reference_length[table[:, 3:]], table[:, 3:]


def _in_tethers(net: Net) -> Iterator[tuple[int, int, int, int, int]]:
    for tether in net.tethers:
        elements = net.tether_elements[tether.name]
        yield from zip(tether.nodes, tether.nodes[1:], tether.nodes[2:], elements, elements[1:], strict=False)


def _in_the_net(net: Net) -> Iterator[tuple[int, int, int, int, int]]:
    ends: dict[int, list[tuple[int, int]]] = {}  # node -> (element, other node)
    for element, (i, j) in enumerate(net.element_nodes.tolist()):
        ends.setdefault(i, []).append((element, j))
        ends.setdefault(j, []).append((element, i))
    place = net.reference_position
    for node, arms in ends.items():
        away = np.array([place[other] - place[node] for _, other in arms])
        away /= np.linalg.norm(away, axis=1, keepdims=True)
        # |a + b| is the sine of the turn for nearly opposite unit vectors, with all digits.
        turn = np.linalg.norm(away[:, None] + away, axis=2)
        for item in range(len(arms)):
            for two in range(item):
                (e, before), (f, after) = arms[item], arms[two]
                alike = net.is_string[e] == net.is_string[f] and net.area[e] == net.area[f]
                if alike and turn[item, two] <= STRAIGHT:
                    yield before, node, after, e, f
