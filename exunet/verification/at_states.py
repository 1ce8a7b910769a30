"""Rung 2: both codes at the same random states: accelerations, energies, momenta, strains, power."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from exunet.studies.both_codes import BothCodes, Floats
from exunet.system import energy
from exunet.system.states import States
from exunet.system.system import State
from exunet.verification.check import Check, difference, worst_of
from exunet.verification.random_states import KINDS, random_instants
from exunet.verification.tolerances import FORCES, MEASURES
from reference_impl import energy as their_energy
from reference_impl import forces as formulas

SEED, SEED_OF_MEASURES = 20210614, 20210620
STATES, MEASURED = 200, 20  # of each of six kinds: 1200 and 120 states a case
RARE = ("potential energy", "power taken")  # rows only where one of the codes has any


def forces(case: BothCodes, states_of_a_kind: int = STATES) -> Iterator[Check]:
    """The kind of state that differs most: largest difference over the largest acceleration of that kind."""
    checks = []
    probe, system, random = case.probe(), case.start.system, np.random.default_rng(SEED)
    for kind in KINDS:
        ours, others = [], []
        for state in random_instants(case.start, kind, states_of_a_kind, random):
            if state.memory:
                probe.remember(system, state.memory)
            ours.append(probe.accelerations(state.position, state.velocity, state.time))
            others.append(case.reference_motion(state)[0][: system.blocks.n_points])
        a, b, axes = np.array(ours), np.array(others), ("state", "node", "xyz")
        checks.append(difference(kind, a, b, FORCES, axes, "m/s2"))
    yield worst_of(f"accelerations, {states_of_a_kind * len(KINDS)} random states", checks)


def measures(case: BothCodes, states_of_a_kind: int = MEASURED) -> Iterator[Check]:
    """Energies, momenta, strains, tensions, power: a row for each, of the kind of state that differs most.

    The states are those of `random_instants`, moved as a whole, the first of each kind at rest. Differences
    are parts of the largest value among the states of a kind, those of a potential and a power of any kind.
    """
    fixed, random = case.start.net.fixed_nodes, np.random.default_rng(SEED_OF_MEASURES)
    found: dict[str, list[tuple[str, str, Floats, Floats]]] = {}
    for kind in KINDS:
        values: dict[tuple[str, str], list[tuple[Floats, Floats]]] = {}
        for number, state in enumerate(random_instants(case.start, kind, states_of_a_kind, random)):
            # Off the origin the nodes' shares of a potential or of an angular momentum do not cancel.
            moved = state.position + case.size * random.normal(size=3)
            moved[fixed] = case.start.position[fixed]
            there = state.at(moved, state.velocity * (number > 0))
            for name, unit, a, b in _quantities(case, there):
                values.setdefault((name, unit), []).append((a, b))
        for (name, unit), pairs in values.items():
            a, b = (np.array(side) for side in zip(*pairs, strict=True))
            found.setdefault(name, []).append((kind, unit, a, b))
    for name, kinds in found.items():
        # A potential of matrices is small where their terms cancel: a part of its largest value in any kind.
        every = [np.abs(side).max(initial=0.0) for *_, a, b in kinds for side in (a, b)]
        scale = float(max(every)) if name in RARE else None
        if scale != 0.0:
            checks = [
                difference(kind, a, b, MEASURES, ("state", "number")[: a.ndim], unit, scale=scale)
                for kind, unit, a, b in kinds
            ]
            yield worst_of(f"{name}, {states_of_a_kind * len(KINDS)} random states", checks)


def _quantities(case: BothCodes, state: State) -> Iterator[tuple[str, str, Floats, Floats]]:
    """Name, unit, and the values (...) of exunet and of the reference."""
    system, elements = case.theirs.system, case.reference_elements
    kinematics = case.start.system.kinematics
    if kinematics.held:  # elements on a drum have no length
        moving = state.moving.completed(kinematics, state.time, state.memory)
        state = State.of(state.time, moving, state.memory)
    ours, theirs = States.of(case.start.system, state), case.theirs_at(state.moving)
    x, v, bodies = theirs.x, theirs.v, theirs.bodies
    intact, wound = case.intact_in_reference(state), case.wound_in_reference(state)
    drawn = case.drawn_in_reference(state.first_order)
    lengths = their_energy.lengths(system, wound, drawn)
    stored = their_energy.at_outlets(system, x, wound)[1] + their_energy.of_closing(system, x, drawn)[1]
    yield "kinetic energy", "J", ours.kinetic[0], their_energy.kinetic(system, v, bodies)
    yield "elastic energy", "J", ours.elastic[0], their_energy.elastic(system, x, intact)
    yield "potential energy", "J", ours.potential[0], their_energy.potential(system, x, bodies) + stored
    yield "momentum", "kg m/s", ours.momentum[0], their_energy.momentum(system, v, bodies)
    angular = their_energy.angular_momentum(system, x, v, bodies)
    yield "angular momentum", "kg m2/s", ours.angular_momentum[0], angular
    yield "strain", "", ours.strain[0], formulas.strain(system, x, lengths)[elements]
    viscous = "material_damping" in case.effects
    # The reference tells the elastic tension; with a viscous one beside it the two are the same at rest.
    if not viscous or not state.velocity.any():
        pulling = None if lengths is not None else intact  # outlets pull, though no element of the net does
        yield "tension", "N", ours.tension[0], formulas.tension(system, x, pulling, lengths)[elements]
    # exunet integrates the work of the viscous stress over steps, and has no power at an instant: rung 5.
    if not viscous:
        taken = energy.power_taken(case.start.system.forces, ours.time, *ours.flat, state.memory)
        yield "power taken", "W", taken[0], np.asarray(case.reference_motion(state)[1])
