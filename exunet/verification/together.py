"""Rung 9: threads that touch each other in both codes, at random states.

The reference looks at every pair, and integrates by halving pieces along one thread and by a rule in an angle
along the other (`reference_impl.self_contact`).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import cast

import numpy as np

from exunet.forces.contact.self_contact import LEAST, NAME
from exunet.forces.contact.status import status_of
from exunet.forces.effects import switched_on
from exunet.forces.effects.self_contact import SelfContactConfig, radii
from exunet.forces.terms import copied
from exunet.model.system import State
from exunet.studies.both_codes import BothCodes, Floats
from exunet.verification.check import Check, difference, left_out
from exunet.verification.tolerances import CONTACT, CONTACT_COUNT
from reference_impl.self_contact import met

TOGETHER_CASES = "verification/self_contact"  # below cases/
SEED = 20261123
SPEED = 1.0  # m/s, of nodes
OF_OTHER_NETS = "threads that touch each other are compared at states of the net together.toml"
QUANTITIES = {"forces on nodes": "N", "power taken": "W", "energy stored": "J"}


def at_states(case: BothCodes, count: int) -> Iterator[Check]:
    """What threads do to each other, take and store, as the law is written and in the reference."""
    random = np.random.default_rng(SEED)
    ours, theirs, touching = [], [], 0.0
    for state in pressed_states(case, count, random):
        found, number = _of_exunet(case, state)
        ours.append(found)
        theirs.append(_of_reference(case, state))
        touching += number
    for k, (name, unit) in enumerate(QUANTITIES.items()):
        a, b = (np.array([item[k] for item in side]) for side in (ours, theirs))
        axes = ("state", "node", "xyz") if a.ndim == 3 else ("state", "number")
        yield difference(f"{name}, {count} random states", a, b, CONTACT, axes, unit)
    told = f"{touching / count:.1f} pairs touch"
    yield Check("states in which nothing touches", float(touching < count), CONTACT_COUNT, told)


def pressed_states(case: BothCodes, count: int, random: np.random.Generator) -> Iterator[State]:
    """Random states of elements that share no node, in which every other one lies at the one before.

    A third of the pairs is all but parallel; some touch over an end only.
    """
    start = case.start
    law = cast(SelfContactConfig, switched_on(start.scene.effects)[NAME])
    reach = 2.0 * float(radii(law, start.net).max())
    ends, size = start.net.element_nodes, float(start.net.reference_length.mean())
    for number in range(count):
        position = np.array(start.position)
        for pair, (one, other) in enumerate(zip(ends[::2], ends[1::2], strict=True)):
            d, e = random.normal(size=(2, 3)) * size * random.uniform(0.05, 1.0, size=(2, 1))
            if (number + pair) % 3 == 0:
                e = random.uniform(0.3, 1.5) * d + 1e-3 * size * random.normal(size=3)
            side = np.cross(d, random.normal(size=3))
            side *= random.uniform(1.05 * LEAST, 1.0) * reach / np.linalg.norm(side)
            begin = 10.0 * size * np.array([pair, 0.0, 0.0]) - random.uniform() * d
            place = 10.0 * size * np.array([pair, 0.0, 0.0]) + side - random.uniform() * e
            position[one], position[other] = (begin, begin + d), (place, place + e)
        velocity = SPEED * random.normal(size=position.shape)
        yield replace(start.state, position=position, velocity=velocity)


def _of_exunet(case: BothCodes, state: State) -> tuple[list[Floats], float]:
    """`QUANTITIES`, and how many pairs touch."""
    system = case.start.system
    blocks, n = system.blocks, case.start.net.n_nodes
    x, v = system.layout.pack(state.moving)
    force = np.zeros(blocks.n_force)
    (term,) = (kernel for kernel in system.forces.kernels if kernel.remember is not None)
    data = copied(term.data)  # which has work space
    term.add(state.time, x, v, data, force)
    assert term.potential is not None
    assert term.remember is not None
    stored = float(term.potential(x, data))
    term.remember(state.time, x, v, data)
    taken = blocks.rate(f"{NAME}/damping")
    found = [force[: 3 * n].reshape(n, 3), force[taken : taken + 1], np.array([stored])]
    return found, status_of(data.kept).touching


def _of_reference(case: BothCodes, state: State) -> list[Floats]:
    """`QUANTITIES`."""
    system, theirs = case.theirs.system, case.theirs_at(state.moving)
    assert system.meeting is not None
    found = met(system.meeting, theirs.x, theirs.v)
    return [case.from_reference(found.on_nodes), np.array([found.taken]), np.array([found.stored])]


def over_a_run(case: BothCodes) -> Iterator[Check]:
    """Left out."""
    yield left_out("whole runs", "the reference takes many minutes where threads touch each other")
