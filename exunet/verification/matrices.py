"""Rung 3: mass, damping and tangent stiffness of the engine's own linearisation against the formulas."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

import reference_impl as reference
from exunet.methods.method import NetForm
from exunet.studies.both_codes import Pair
from exunet.verification.check import Check, left_out, worst_of
from exunet.verification.states import HALF_SLACK, NO_HALF_SLACK, smooth_states
from exunet.verification.tolerances import (
    DAMPING,
    DIFFERENCED,
    EXACT_STIFFNESS,
    MASS,
    RESOLVED,
    SECANT_FORCE,
    SECANT_SYMMETRY,
    STIFFNESS,
    Tolerance,
)
from reference_impl import forces as formulas

Floats = NDArray[np.float64]

SEED = 20210615
# Effects of which the reference has the matrices too (at rest), as formulas. With others its accelerations
# are differentiated numerically.
WITH_FORMULAS = {"gravity", "rayleigh_damping", "mass_damping", "material_damping"}
# Effects with which the engine differentiates numerically by the velocities too: a tension that depends on
# them, or a constant load beside a constant damping matrix.
DIFFERENTIATED = {"material_damping", "gravity"}
MOST_NODES = 500  # the engine's matrices are dense here


def matrices(pair: Pair) -> Iterator[Check]:
    """Mass, damping (eq. 13), tangent (eqs. 5, 14) and secant stiffness (eqs. 3, 12) of one case."""
    net = pair.start.net
    if net.n_nodes > MOST_NODES:
        yield left_out(3, pair.name, "matrices", f"dense, for up to {MOST_NODES} nodes, not {net.n_nodes}")
        return
    probe, system = pair.probe(), pair.system
    yield _compare(pair, "mass matrix", probe.mass(), np.diag(_masses(pair)), MASS)
    at_rest = np.zeros_like(net.reference_position)
    found: dict[str, list[Check]] = {}
    beyond = sorted(pair.effects - WITH_FORMULAS)
    how = f" by differences ({', '.join(beyond)})" if beyond else ""
    numerical = pair.start.scene.engine.net != NetForm.FUSED
    exact = DIFFERENCED if beyond else EXACT_STIFFNESS
    viscous = numerical and not pair.effects.isdisjoint(DIFFERENTIATED)
    least = RESOLVED.value * float((net.youngs_modulus * net.area).max()) if viscous else 0.0
    of_damping = STIFFNESS if viscous else DIFFERENCED if beyond else DAMPING
    states = smooth_states(net, np.random.default_rng(SEED))
    if HALF_SLACK not in states:
        yield left_out(3, pair.name, f"matrices, {HALF_SLACK}", NO_HALF_SLACK)
    for kind, position in states.items():
        position[net.fixed_nodes] = pair.start.position[net.fixed_nodes]
        there = pair.give(position)
        tangent, damping = _differences(pair, there) if beyond else _formulas(pair, there)
        secant = formulas.secant(system, there).toarray()
        compared = [
            (
                f"tangent stiffness{how}",
                probe.stiffness(position, at_rest),
                tangent,
                STIFFNESS if numerical else exact,
                0.0,
            ),
            (f"damping matrix{how}", probe.damping(position, at_rest), damping, of_damping, least),
            ("secant stiffness, S - S^T", secant, secant.T, SECANT_SYMMETRY, 0.0),
        ]
        if not beyond:
            pull = pair.take((secant @ there.ravel()).reshape(-1, 3))
            felt = probe.accelerations(position, at_rest) - _gravity(pair)
            force = -_masses(pair).reshape(-1, 3) * felt
            force[net.fixed_nodes] = pull[net.fixed_nodes]  # the engine's fixed points feel nothing
            compared.append(("forces against S(x) x", force, pull, SECANT_FORCE, 0.0))
        for name, a, b, allowed, floor in compared:
            found.setdefault(name, []).append(_compare(pair, kind, a, b, allowed, floor))
    for name, checks in found.items():
        yield worst_of(f"{name}, {' and '.join(check.name for check in checks)}", checks)


def _formulas(pair: Pair, there: Floats) -> tuple[Floats, Floats]:
    """Tangent stiffness and damping matrix of the reference, (3n, 3n) in exunet's order."""
    tangent, damping = formulas.tangent(pair.system, there), formulas.damping(pair.system, there)
    return _ours(pair, tangent.toarray()), _ours(pair, damping.toarray())


def _differences(pair: Pair, there: Floats) -> tuple[Floats, Floats]:
    """The same from central differences of the reference's accelerations at rest."""
    mass = np.repeat(pair.net.mass, 3)
    still = np.zeros_like(there)
    step = 1e-6 * float(pair.net.reference_length.min())  # no strain of `smooth_states` changes its sign
    pace = 1e-3 if "material_damping" in pair.effects else 1.0  # [m/s]; all else is linear in the velocity

    def change(x: Floats, v: Floats) -> Floats:
        forth, back = (
            reference.acceleration(pair.system, 0.0, there + sign * x, still + sign * v)
            for sign in (1.0, -1.0)
        )
        return -0.5 * mass * (forth - back).ravel()

    each = np.eye(there.size).reshape(there.size, *there.shape)
    stiffness = np.array([change(step * unit, still) for unit in each]).T / step
    damping = np.array([change(still, pace * unit) for unit in each]).T / pace
    return _ours(pair, stiffness), _ours(pair, damping)


def _masses(pair: Pair) -> Floats:
    """(3n,) the reference's masses in exunet's order, zero where fixed."""
    mass = pair.net.mass[pair.to_theirs].copy()
    mass[pair.start.net.fixed_nodes] = 0.0
    return np.repeat(mass, 3)


def _gravity(pair: Pair) -> Floats:
    """(n, 3) accelerations of the reference where no cable pulls: all nodes at rest on one spot."""
    nowhere = np.zeros_like(pair.net.reference_position)
    return pair.take(reference.acceleration(pair.system, 0.0, nowhere, nowhere))


def _ours(pair: Pair, matrix: Floats) -> Floats:
    """A matrix of the reference (3n, 3n) in exunet's order, with zero rows and columns for fixed nodes."""
    place = (3 * pair.to_theirs[:, None] + np.arange(3)).ravel()
    result = matrix[np.ix_(place, place)]
    fixed = (3 * pair.start.net.fixed_nodes[:, None] + np.arange(3)).ravel()
    result[fixed], result[:, fixed] = 0.0, 0.0
    return result


def _compare(
    pair: Pair, name: str, ours: Floats, theirs: Floats, allowed: Tolerance, least: float = 0.0
) -> Check:
    """Largest difference of two arrays with a row for each coordinate, over the largest entry or `least`."""
    gap = np.abs(ours - theirs)
    at = np.unravel_index(int(np.argmax(gap)), gap.shape)
    scale = max(float(np.abs(ours).max()), float(np.abs(theirs).max()), least) or 1.0
    nodes = " and ".join(str(int(k) // 3) for k in at) if gap.shape[1] > 3 else str(int(at[0]))
    worst = f"node {nodes}: {ours[at]:.16g} and {theirs[at]:.16g}"
    return Check(3, pair.name, name, float(gap[at]) / scale, allowed, worst)
