"""Rung 2: accelerations of both codes at the same random states; no integrator takes part."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

import reference_impl as reference
from exunet.studies.both_codes import BothCodes
from exunet.verification.check import Check, difference, worst_of
from exunet.verification.states import KINDS, random_states
from exunet.verification.tolerances import FORCES

SEED = 20210614
STATES_OF_A_KIND = 200  # six kinds: 1200 states a case


def forces(case: BothCodes, states_of_a_kind: int = STATES_OF_A_KIND) -> Iterator[Check]:
    """The kind of state that differs most: largest difference over the largest acceleration of that kind."""
    name = f"accelerations, {states_of_a_kind * len(KINDS)} random states"
    yield worst_of(name, _kinds(case, states_of_a_kind))


def _kinds(case: BothCodes, states_of_a_kind: int) -> Iterator[Check]:
    probe, net, random = case.probe(), case.start.net, np.random.default_rng(SEED)
    for kind in KINDS:
        ours, theirs = [], []
        for position, velocity in random_states(net, kind, states_of_a_kind, random):
            position[net.fixed_nodes], velocity[net.fixed_nodes] = case.start.position[net.fixed_nodes], 0.0
            ours.append(probe.accelerations(position, velocity))
            state = case.to_reference(position), case.to_reference(velocity)
            theirs.append(case.from_reference(reference.acceleration(case.theirs.system, 0.0, *state)))
        yield difference(kind, np.array(ours), np.array(theirs), FORCES, ("state", "node", "xyz"), "m/s2")
