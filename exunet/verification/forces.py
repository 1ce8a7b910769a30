"""Rung 2: accelerations of both codes at the same random states; no integrator takes part."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

import reference_impl as reference
from exunet.studies.both_codes import Pair
from exunet.verification.check import Check, worst_first, worst_of
from exunet.verification.states import KINDS, random_states
from exunet.verification.tolerances import FORCES

SEED = 20210614
STATES_OF_A_KIND = 200  # six kinds: 1200 states a case


def forces(pair: Pair, states_of_a_kind: int = STATES_OF_A_KIND) -> Iterator[Check]:
    """The kind of state that differs most: largest difference over the largest acceleration of that kind."""
    name = f"accelerations, {states_of_a_kind * len(KINDS)} random states"
    yield worst_of(name, _kinds(pair, states_of_a_kind))


def _kinds(pair: Pair, states_of_a_kind: int) -> Iterator[Check]:
    probe, net = pair.probe(), pair.start.net
    random = np.random.default_rng(SEED)
    for kind in KINDS:
        largest, gap, worst = 0.0, -1.0, "nothing"
        for number, (position, velocity) in enumerate(random_states(net, kind, states_of_a_kind, random)):
            position[net.fixed_nodes], velocity[net.fixed_nodes] = pair.start.position[net.fixed_nodes], 0.0
            ours = probe.accelerations(position, velocity)
            theirs = pair.take(
                reference.acceleration(pair.system, 0.0, pair.give(position), pair.give(velocity))
            )
            largest = max(largest, float(np.abs(theirs).max()), float(np.abs(ours).max()))
            difference = np.abs(ours - theirs)
            if worst_first(float(difference.max())) > worst_first(gap):
                gap = float(difference.max())
                node, axis = np.unravel_index(int(np.argmax(difference)), difference.shape)
                worst = (
                    f"state {number}, node {node}, {'xyz'[axis]}: {ours[node, axis]:.16g} and "
                    f"{theirs[node, axis]:.16g} m/s2"
                )
        measured = gap / largest if largest else gap
        yield Check(2, pair.name, kind, measured, FORCES, worst)
