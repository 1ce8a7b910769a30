"""Rung 1: the two nets, woven by different algorithms, are the same net and start in the same state."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from exunet.base.errors import InputError
from exunet.studies.both_codes import Pair, pair_of_text
from exunet.verification.check import Check, worst_first
from exunet.verification.random_nets import random_case
from exunet.verification.tolerances import CONNECTIVITY, TOPOLOGY

Floats = NDArray[np.float64]

SEED = 20210613


def topology(pair: Pair) -> Iterator[Check]:
    """Connectivity, geometry, masses and initial state of one case."""
    fault = _mismatch(pair)
    yield Check(1, pair.name, "nodes, elements, bullets, fixed nodes", bool(fault), CONNECTIVITY, fault)
    if fault:
        return
    name, (measured, worst) = max(_differences(pair), key=lambda item: worst_first(item[1][0]))
    yield Check(1, pair.name, "geometry, masses, start", measured, TOPOLOGY, f"{name}: {worst}")


def random_topologies(count: int) -> Iterator[Check]:
    """The same over `count` random valid nets of all topologies; one check for all of them."""
    random = np.random.default_rng(SEED)
    broken: list[Check] = []
    widest: Check | None = None
    for k in range(count):
        kind, text = random_case(random)
        for check in topology(pair_of_text(f"random-{k}-{kind}", text)):
            if not check.holds:
                broken.append(check)
            if check.allowed is TOPOLOGY:
                widest = max(widest or check, check, key=lambda c: worst_first(c.measured))
    faults = f"{broken[0].subject}: {broken[0].worst}" if broken else ""
    yield Check(1, f"{count} random nets", "nets that differ", len(broken), CONNECTIVITY, faults)
    if widest:
        where = f"{widest.subject}: {widest.worst}"
        yield Check(1, f"{count} random nets", widest.name, widest.measured, TOPOLOGY, where)


def _mismatch(pair: Pair) -> str:
    """What makes the two nets differ in kind; empty if nothing does."""
    try:
        match = pair.to_theirs
    except InputError as error:
        return str(error)
    if set(match[pair.start.net.fixed_nodes]) != set(pair.net.fixed_nodes.tolist()):
        return "different nodes are fixed"
    return ""


def _differences(pair: Pair) -> Iterator[tuple[str, tuple[float, str]]]:
    """(quantity, (largest difference relative to the quantity's size, where))."""
    ours, theirs, nodes, elements = pair.start.net, pair.net, pair.to_theirs, pair.elements_to_theirs
    place, speed = pair.theirs_at_start.position[0], pair.theirs_at_start.velocity[0]
    of_nodes = {
        "reference position": (ours.reference_position, theirs.reference_position[nodes]),
        "mass": (ours.mass, theirs.mass[nodes]),
        "initial position": (pair.start.position, place[nodes]),
        "initial velocity": (pair.start.velocity, speed[nodes]),
    }
    of_elements = {
        "reference length": (ours.reference_length, theirs.reference_length[elements]),
        "area": (ours.area, theirs.area[elements]),
        "Young's modulus": (ours.youngs_modulus, theirs.youngs_modulus[elements]),
        "density": (ours.density, theirs.density[elements]),
    }
    for name, (a, b) in of_nodes.items():
        yield name, _worst("node", a, b)
    for name, (a, b) in of_elements.items():
        yield name, _worst("element", a, b)


def _worst(item: str, a: Floats, b: Floats) -> tuple[float, str]:
    """Largest |a - b| over the largest |a|, and where it is."""
    if a.size == 0:
        return 0.0, "nothing"
    a, b = a.reshape(len(a), -1), b.reshape(len(b), -1)
    gap = np.abs(a - b)
    at, axis = (int(k) for k in np.unravel_index(int(np.argmax(gap)), gap.shape))
    scale = float(np.abs(a).max()) or 1.0
    return float(gap[at, axis]) / scale, f"{item} {at}: {a[at, axis]:.16g} and {b[at, axis]:.16g}"
