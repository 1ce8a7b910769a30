"""Rung 1: the two nets, woven by different algorithms, are the same net and start in the same state."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from exunet.base.errors import InputError
from exunet.studies.both_codes import BothCodes, both_of_text
from exunet.verification.check import Check, difference, worst_of
from exunet.verification.states import random_case
from exunet.verification.tolerances import CONNECTIVITY, TOPOLOGY

SEED = 20210613


def topology(case: BothCodes) -> Iterator[Check]:
    """Connectivity, geometry, masses and initial state of one case, bodies included."""
    fault = _mismatch(case)
    yield Check("nodes, elements, bullets, fixed nodes, bodies", bool(fault), CONNECTIVITY, fault)
    if not fault:
        yield worst_of("geometry, masses, start", _differences(case))


def random_topologies(count: int) -> Iterator[Check]:
    """The same over `count` random valid nets of all topologies; one check for all of them."""
    random = np.random.default_rng(SEED)
    found: list[Check] = []
    for k in range(count):
        kind, text = random_case(random)
        name = f"random-{k}-{kind}"
        found += [replace(check, name=name) for check in topology(both_of_text(name, text))]
    differing = [check for check in found if not check.holds]
    measured = [check for check in found if check.allowed is TOPOLOGY]
    faults = f"{differing[0].name}: {differing[0].worst}" if differing else ""
    yield Check("nets that differ", len(differing), CONNECTIVITY, faults)
    if measured:
        yield worst_of("geometry, masses, start", measured)


def _mismatch(case: BothCodes) -> str:
    """What makes the two nets differ in kind; empty if nothing does."""
    try:
        match, _ = case.reference_nodes, case.reference_bodies
    except InputError as error:
        return str(error)
    if set(match[case.start.net.fixed_nodes]) != set(case.theirs.net.fixed_nodes.tolist()):
        return "different nodes are fixed"
    return ""


def _differences(case: BothCodes) -> Iterator[Check]:
    """The largest difference of each quantity."""
    for axis, match, names in (
        ("node", case.reference_nodes, ("reference_position", "mass")),
        ("element", case.reference_elements, ("reference_length", "area", "youngs_modulus", "density")),
    ):
        for name in names:
            a, b = getattr(case.start.net, name), getattr(case.theirs.net, name)[match]
            if name == "reference_position":  # nodes of tethers have none of their own
                a, b = a[: case.start.net.n_net_nodes], b[: case.start.net.n_net_nodes]
            yield difference(name.replace("_", " "), a, b, TOPOLOGY, (axis, "xyz")[: a.ndim])
    system, theirs = case.start.system, case.theirs
    order, beside = case.reference_bodies, theirs.system.bodies
    masses = np.append(system.mass[system.net.n_nodes :], system.body_mass)
    rigid = order[len(system.blocks.body) :]
    yield difference("mass of bodies", masses, beside.mass[order], TOPOLOGY, ("body",))
    inertia = np.array([body.inertia_in_frame for body in system.bodies]).reshape(-1, 3, 3)
    yield difference("inertia", inertia, beside.inertia[rigid], TOPOLOGY, ("body", "xyz", "axis"))
    yield from _throw(case)
    ours = case.theirs_at(case.start.state.moving)
    for name, a, b in (("position", ours.x, theirs.x0), ("velocity", ours.v, theirs.v0)):
        a, b = a[case.reference_nodes], b[case.reference_nodes]
        yield difference(f"initial {name}", a, b, TOPOLOGY, ("node", "xyz"))
    for name in ("position", "velocity", "attitude", "angular_velocity"):
        a, b = getattr(ours.bodies, name)[order], getattr(theirs.bodies0, name)[order]
        axes = ("body", "xyz", "axis")[: a.ndim]
        yield difference(f"initial {name.replace('_', ' ')} of bodies", a, b, TOPOLOGY, axes)


def _throw(case: BothCodes) -> Iterator[Check]:
    """What books hold at time 0, if a body throws the net then: impulse, angular impulse, work, energy."""
    throw, begun = case.start.system.ejection, case.theirs.system.begun
    if throw is None and begun is None:
        return
    ours, theirs = np.zeros(8), np.zeros(8)
    if throw is not None:
        ours[:] = [*throw.impulse, *throw.angular_impulse, throw.work, case.start.system.lost_at_start]
    if begun is not None:
        theirs[:] = [*begun.given, begun.left]
    yield difference("books of the throw", ours, theirs, TOPOLOGY, ("number",))
