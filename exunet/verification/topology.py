"""Both nets, woven by different algorithms, are the same net and start in the same state."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from exunet.base.errors import InputError
from exunet.studies.both_codes import BothCodes, both_of_text
from exunet.verification.check import Check, difference, worst_of
from exunet.verification.random_states import random_case
from exunet.verification.tolerances import CONNECTIVITY, TOPOLOGY

SEED = 20210613


def topology(case: BothCodes) -> Iterator[Check]:
    """Compare connectivity, geometry, masses and initial state of a case, bodies included."""
    error = _mismatch(case)
    yield Check("nodes, elements, bullets, fixed nodes, bodies", bool(error), CONNECTIVITY, error)
    if not error:
        yield worst_of("geometry, masses, start", _differences(case))


def random_topologies(count: int) -> Iterator[Check]:
    """Compare `count` random valid nets of all topologies."""
    random = np.random.default_rng(SEED)
    found: list[Check] = []
    for k in range(count):
        kind, text = random_case(random)
        name = f"random-{k}-{kind}"
        found += [replace(check, name=name) for check in topology(both_of_text(name, text))]
    differing = [check for check in found if not check.holds]
    measured = [check for check in found if check.tolerance is TOPOLOGY]
    where = f"{differing[0].name}: {differing[0].where}" if differing else ""
    yield Check(f"random nets that differ, of {count}", len(differing), CONNECTIVITY, where)
    if measured:
        yield worst_of(f"geometry, masses, start of {count} random nets", measured)


def _mismatch(case: BothCodes) -> str:
    """Return what makes both nets differ in kind; empty if nothing does."""
    try:
        match, _ = case.reference_nodes, case.reference_bodies
    except InputError as error:
        return str(error)
    if set(match[case.start.net.fixed_nodes]) != set(case.theirs.net.fixed_nodes.tolist()):
        return "different nodes are fixed"
    return ""


def _differences(case: BothCodes) -> Iterator[Check]:
    """Yield the largest difference of each quantity."""
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
    yield from _ejection(case)
    ours = case.theirs_at(case.start.state.moving)
    for name, a, b in (("position", ours.x, theirs.x0), ("velocity", ours.v, theirs.v0)):
        a, b = a[case.reference_nodes], b[case.reference_nodes]
        yield difference(f"initial {name}", a, b, TOPOLOGY, ("node", "xyz"))
    for name in ("position", "velocity", "attitude", "angular_velocity"):
        a, b = getattr(ours.bodies, name)[order], getattr(theirs.bodies0, name)[order]
        axes = ("body", "xyz", "axis")[: a.ndim]
        yield difference(f"initial {name.replace('_', ' ')} of bodies", a, b, TOPOLOGY, axes)


def _ejection(case: BothCodes) -> Iterator[Check]:
    """Compare impulse, angular impulse, work and lost energy at time 0 of a net that a body ejects then."""
    ours, theirs = np.zeros(8), np.zeros(8)
    ejection, started = case.start.system.ejection, case.theirs.system.begun
    if ejection is None and started is None:
        return
    if ejection is not None:
        lost = case.start.system.lost_at_start
        ours[:] = [*ejection.impulse, *ejection.angular_impulse, ejection.work, lost]
    if started is not None:
        theirs[:] = [*started.given, started.left]
    yield difference("balances of the ejection", ours, theirs, TOPOLOGY, ("number",))
