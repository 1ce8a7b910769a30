"""Matrices of a net: Exudyn's own linearisation against the formulas of the reference."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from exunet.model.system import State
from exunet.studies.both_codes import BothCodes, Floats, coordinates
from exunet.verification import tolerances as tol
from exunet.verification.check import Check, difference, skipped, worst_of
from exunet.verification.random_states import HALF_SLACK, NO_HALF_SLACK, smooth_states
from reference_impl import forces as formulas

SEED = 20210615
# Effects of which the reference has the matrices too (at rest), as formulas. With others its accelerations
# are differentiated numerically.
WITH_FORMULAS = {"gravity", "rayleigh_damping", "mass_damping", "material_damping"}
# Effects with which the engine differentiates numerically by the velocities too: a tension that depends on
# them, or a constant load beside a constant damping matrix.
DIFFERENTIATED = {"material_damping", "gravity"}
# Speed of the points in still air, and by how much it is differenced: its drag is quadratic [m/s].
PACE_IN_AIR = (10.0, 3e-3)
ENTRY = ("row", "column")  # coordinates: three a node
MOST_NODES = 500  # the engine's matrices are dense here


def matrices(case: BothCodes) -> Iterator[Check]:
    """Compare mass, damping (eq. 13) and tangent stiffness (eqs. 5, 14) of a case."""
    net = case.start.net
    if net.n_nodes > MOST_NODES:
        yield skipped("matrices", f"dense, for up to {MOST_NODES} nodes, not {net.n_nodes}")
        return
    probe = case.probe()
    masses = _ours(case, np.diag(_masses(case)))
    yield difference("mass matrix", probe.mass(), masses, tol.MASS, ENTRY)
    found: dict[str, list[Check]] = {}
    others = sorted(case.effects - WITH_FORMULAS)
    how = f" by differences ({', '.join(others)})" if others else ""
    viscous = not case.effects.isdisjoint(DIFFERENTIATED)
    of_damping = tol.STIFFNESS if viscous else tol.DIFFERENCED if others else tol.DAMPING
    resolved = tol.RESOLVED.value if viscous else tol.RESOLVED_BY_STEPS.value if others else 0.0
    floor = resolved * float((net.youngs_modulus * net.area).max())
    states = smooth_states(net, np.random.default_rng(SEED))
    if HALF_SLACK not in states:
        yield skipped(f"matrices, {HALF_SLACK}", NO_HALF_SLACK)
    # The drag of still air has no slope at rest.
    speed = PACE_IN_AIR[0] if "air_drag" in case.effects else 0.0
    velocity = speed * np.random.default_rng(SEED).normal(size=case.start.position.shape)
    velocity[net.fixed_nodes] = 0.0
    for kind, position in states.items():
        position[net.fixed_nodes] = case.start.position[net.fixed_nodes]
        there = case.to_reference(position)
        state = case.from_state(position, velocity).start.state
        position = state.position
        tangent, damping = _differences(case, state) if others else _formulas(case, there)
        compared = [
            (f"tangent stiffness{how}", probe.stiffness(position, velocity), tangent, tol.STIFFNESS, 0.0),
            (f"damping matrix{how}", probe.damping(position, velocity), damping, of_damping, floor),
        ]
        for name, a, b, tolerance, smallest in compared:
            found.setdefault(name, []).append(difference(kind, a, b, tolerance, ENTRY, floor=smallest))
    for name, checks in found.items():
        yield worst_of(f"{name}, {' and '.join(check.name for check in checks)}", checks)


def _formulas(case: BothCodes, there: Floats) -> tuple[Floats, Floats]:
    """Return tangent stiffness and damping matrix (3n, 3n) of the reference in exunet's order."""
    tangent, damping = (of(case.theirs.system, there) for of in (formulas.tangent, formulas.damping))
    return _ours(case, tangent.toarray()), _ours(case, damping.toarray())


def _masses(case: BothCodes) -> Floats:
    """Return masses (3N,) of the reference's nodes, then of its bodies."""
    return np.repeat(np.append(case.theirs.net.mass, case.theirs.system.bodies.mass), 3)


def _differences(case: BothCodes, state: State) -> tuple[Floats, Floats]:
    """Return the same from central differences of the reference's accelerations at a state."""
    mass, (there, speeds) = _masses(case), case.theirs_at(state.moving).particles
    # A step that changes the sign of no strain of `smooth_states`.
    step = 1e-6 * float(case.theirs.net.reference_length.min())
    pace = 1e-3 if "material_damping" in case.effects else 1.0  # [m/s]; all else is linear in the velocity,
    pace = PACE_IN_AIR[1] if "air_drag" in case.effects else pace  # or a slow motion in a fast flow

    def change(x: Floats, v: Floats) -> Floats:
        forth, back = (
            formulas.motion(case.theirs.system, 0.0, there + sign * x, speeds + sign * v)[0]
            for sign in (1.0, -1.0)
        )
        return -0.5 * mass * (forth - back).ravel()

    each = np.eye(there.size).reshape(there.size, *there.shape)
    still = np.zeros_like(there)
    stiffness = np.array([change(step * unit, still) for unit in each]).T / step
    damping = np.array([change(still, pace * unit) for unit in each]).T / pace
    return _ours(case, stiffness), _ours(case, damping)


def _ours(case: BothCodes, matrix: Floats) -> Floats:
    """Reorder a matrix (3N, 3N) of the reference for exunet's points, with zeros for fixed nodes."""
    points = case.reference_particles[: case.start.system.blocks.n_points]
    place, fixed = coordinates(points), coordinates(case.start.net.fixed_nodes)
    result = matrix[np.ix_(place, place)]
    result[fixed], result[:, fixed] = 0.0, 0.0
    return result
