"""Rung 2: both codes at the same random states: accelerations, energies, momenta, strains, tensions."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

import reference_impl as reference
from exunet.studies.both_codes import BothCodes, Floats
from exunet.system.states import States
from exunet.verification.check import Check, difference, worst_of
from exunet.verification.random_states import KINDS, random_states
from exunet.verification.tolerances import FORCES, MEASURES
from reference_impl import energy as their_energy
from reference_impl import forces as formulas

SEED, SEED_OF_MEASURES = 20210614, 20210620
STATES, MEASURED = 200, 20  # of each of six kinds: 1200 and 120 states a case


def forces(case: BothCodes, states_of_a_kind: int = STATES) -> Iterator[Check]:
    """The kind of state that differs most: largest difference over the largest acceleration of that kind."""
    checks = []
    probe, net, random = case.probe(), case.start.net, np.random.default_rng(SEED)
    for kind in KINDS:
        ours, others = [], []
        for position, velocity in random_states(net, kind, states_of_a_kind, random):
            position[net.fixed_nodes], velocity[net.fixed_nodes] = case.start.position[net.fixed_nodes], 0.0
            ours.append(probe.accelerations(position, velocity))
            state = case.to_reference(position), case.to_reference(velocity)
            others.append(case.from_reference(reference.acceleration(case.theirs.system, 0.0, *state)))
        a, b, axes = np.array(ours), np.array(others), ("state", "node", "xyz")
        checks.append(difference(kind, a, b, FORCES, axes, "m/s2"))
    yield worst_of(f"accelerations, {states_of_a_kind * len(KINDS)} random states", checks)


def measures(case: BothCodes, states_of_a_kind: int = MEASURED) -> Iterator[Check]:
    """Energies, momenta, strains and tensions: a row for each, of the kind of state that differs most.

    The states are those of `random_states`, moved as a whole, the first of each kind at rest. Differences are
    parts of the largest value among the states of a kind.
    """
    net, random = case.start.net, np.random.default_rng(SEED_OF_MEASURES)
    found: dict[str, list[Check]] = {}
    for kind in KINDS:
        states = random_states(net, kind, states_of_a_kind, random)
        position, velocity = (np.array(part) for part in zip(*states, strict=True))
        # Off the origin the nodes' shares of a potential or of an angular momentum do not cancel.
        position += case.size * random.normal(size=(len(position), 1, 3))
        position[:, net.fixed_nodes], velocity[:, net.fixed_nodes] = case.start.position[net.fixed_nodes], 0.0
        velocity[0] = 0.0
        time = np.arange(float(len(position)))
        ours = States.of_points(case.start.system, time, position, velocity)
        for name, unit, a, b in _quantities(case, ours):
            axes = ("state", "number")[: a.ndim]
            found.setdefault(name, []).append(difference(kind, a, b, MEASURES, axes, unit))
    for name, checks in found.items():
        yield worst_of(f"{name}, {states_of_a_kind * len(KINDS)} random states", checks)


def _quantities(case: BothCodes, ours: States) -> Iterator[tuple[str, str, Floats, Floats]]:
    """Name, unit, and the values (states, ...) of exunet and of the reference."""
    system, elements = case.theirs.system, case.reference_elements
    x, v = case.to_reference(ours.position), case.to_reference(ours.velocity)
    yield "kinetic energy", "J", ours.kinetic, their_energy.kinetic(system, v)
    yield "elastic energy", "J", ours.elastic, their_energy.elastic(system, x)
    potential = their_energy.potential(system, x)
    if ours.potential.any() or potential.any():  # few cases have one
        yield "potential energy", "J", ours.potential, potential
    yield "momentum", "kg m/s", ours.momentum, their_energy.momentum(system, v)
    yield "angular momentum", "kg m2/s", ours.angular_momentum, their_energy.angular_momentum(system, x, v)
    yield "strain", "", ours.strain, formulas.strain(system, x)[:, elements]
    # The reference tells the elastic tension; with a viscous one beside it the two are the same at rest.
    resting = ~ours.velocity.any(axis=(1, 2)) | ("material_damping" not in case.effects)
    yield "tension", "N", ours.tension[resting], formulas.tension(system, x[resting])[:, elements]
