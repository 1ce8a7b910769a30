"""A cable at rest: dynamic relaxation against the exact shape of a chain of elastic elements."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq, root

from exunet.net.arrays import Net
from exunet.studies.both_codes import BothCodes
from exunet.verification.answers.both import in_steps
from exunet.verification.check import Check
from exunet.verification.tolerances import HANGING

Floats = NDArray[np.float64]


def hanging_chain(net: Net, weight: Floats, span: float) -> Floats:
    """(n, 2) places [m] (along, upwards) of a chain of elements between supports `span` apart at one height.

    weight : (n,) of each node [N]. Statics alone: the horizontal force H and the vertical one V at the first
    support determine the force in each element, eqs. (3), (8) its length; H and V are those that end the
    chain at the second support.
    """
    stiffness, lengths = net.axial_stiffness, net.reference_length

    def shape(forces: Floats) -> Floats:
        horizontal, vertical = forces
        places = [np.zeros(2)]
        for k, length in enumerate(lengths):
            pull = float(np.hypot(horizontal, vertical))
            direction = np.array([horizontal, -vertical]) / pull
            places.append(places[-1] + direction * length * _stretch(pull / float(stiffness[k])))
            vertical -= weight[k + 1]
        return np.array(places)

    half = float(weight[1:-1].sum()) / 2
    target = np.array([span, 0.0])
    found = root(lambda forces: shape(forces)[-1] - target, [half, half], tol=1e-14)
    return shape(found.x)


def _stretch(force: float) -> float:
    """Stretch at which an element of unit EA pulls with `force`: (s^2 - 1) s / 2 = force."""
    return float(brentq(lambda s: 0.5 * (s * s - 1.0) * s - force, 1.0, 2.0 + 2.0 * force, xtol=1e-15))


def hanging(case: BothCodes) -> Iterator[Check]:
    """Places of the nodes after the cable has come to rest."""
    net = case.start.net
    ends = case.start.position[net.fixed_nodes]
    span = float(np.linalg.norm(ends[1] - ends[0]))
    gravity = float(np.linalg.norm(case.start.scene.effects.model_dump()["gravity"]["acceleration"]))
    known = hanging_chain(net, gravity * net.mass, span) + ends[0][[0, 2]]
    size = float(net.reference_length.sum())
    for code, motion in in_steps(case, np.array([0.0, case.start.scene.time.end]), 1 / 2):
        gap = np.linalg.norm(motion.position[1][:, [0, 2]] - known, axis=1)
        node = int(np.argmax(gap))
        x, z = motion.position[1, node, [0, 2]]
        words = (
            f"node {node}: ({x:.10g}, {z:.10g}) m, known: ({known[node, 0]:.10g}, {known[node, 1]:.10g}) m"
        )
        yield Check(f"shape at rest, {code}: off by part of length", float(gap[node]) / size, HANGING, words)
