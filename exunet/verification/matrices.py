"""Constant matrices and symmetries of a net in both codes.

The net, its start and the equations have the mirror symmetries of the square, so the four bullets must keep
exactly the same speed. An error of an integrator is the same for mirrored nodes and keeps the symmetry; only
round-off, which depends on the order of additions, breaks it. In mirrored arithmetic, which differs in that
order only, the spread must be zero. benchmarks/separation.py times the separation in ordinary arithmetic.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

import reference_impl as reference
from exunet.model.system import State
from exunet.studies.both_codes import BothCodes, Floats, Trajectory, coordinates
from exunet.studies.perturbation import PAPER_SIZE
from exunet.verification import tolerances as tol
from exunet.verification.check import Check, difference, left_out, worst_of
from exunet.verification.horizon import nearby
from exunet.verification.states import HALF_SLACK, NO_HALF_SLACK, smooth_states
from exunet.verification.tolerances import SYMMETRIC
from reference_impl import forces as formulas

LATER = 1.25  # of the run of the case: how far the symmetric solution is followed
INSTANTS = 501
TOLERANCES = (1e-10, 1e-11)  # rtol of DOP853, the absolute one [m, m/s] is a hundredth
NUDGE = 1e-15 / PAPER_SIZE  # of the size: a few units in the last place of the coordinates
SEPARATE = 0.01  # of the launch speed: two curves that far apart are seen as two


def symmetry(case: BothCodes) -> Iterator[Check]:
    """Spread of the bullets' speeds in mirrored arithmetic, and when it is seen in ordinary arithmetic."""
    end = case.start.scene.time.end
    equal = [_run(mirrored(case), tolerance, LATER * end) for tolerance in TOLERANCES]
    ordinary = _run(nearby(case, NUDGE), TOLERANCES[0], end)
    rows = []
    for tolerance, motion in zip(TOLERANCES, equal, strict=True):
        spread = bullet_spread(case, motion)
        at = int(np.argmax(spread))
        words = f"t = {motion.time[at]:.4g} s"
        rows.append(Check(f"tolerance {tolerance:.0e}", float(spread[at]), SYMMETRIC, words))
    yield worst_of(f"spread of speeds in mirrored arithmetic to t = {LATER * end:g} s", rows)
    name = f"bullets {SEPARATE:.0%} of the launch speed apart, start moved by {NUDGE * case.size:.0e} m [s]"
    yield Check(name, separation(case, ordinary), None, f"tolerance {TOLERANCES[0]:.0e}, ordinary arithmetic")


def mirrored(case: BothCodes) -> BothCodes:
    """The case with the reference's mirrored arithmetic, which keeps mirror symmetries to the last bit."""
    system = replace(case.theirs.system, symmetric=True)
    return replace(case, theirs=replace(case.theirs, system=system))


def bullet_spread(case: BothCodes, motion: Trajectory) -> Floats:
    """(t,) largest less smallest speed of a bullet [m/s]."""
    # x and y first, as the mirrored arithmetic adds them, so that mirrored speeds are equal.
    x, y, z = np.moveaxis(motion.velocity[:, case.start.net.bullet_nodes] ** 2, -1, 0)
    return np.asarray(np.ptp(np.sqrt((x + y) + z), axis=1))


def separation(case: BothCodes, motion: Trajectory, part: float = SEPARATE) -> float:
    """First stored time [s] at which the spread exceeds a part of the launch speed; infinite if never."""
    apart = np.flatnonzero(bullet_spread(case, motion) > part * case.speed)
    return float(motion.time[apart[0]]) if len(apart) else float("inf")


def _run(case: BothCodes, tolerance: float, end: float) -> Trajectory:
    return case.run_reference(np.linspace(0.0, end, INSTANTS), rtol=tolerance, atol=1e-2 * tolerance)


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
    """Mass, damping (eq. 13), tangent (eqs. 5, 14) and secant stiffness (eqs. 3, 12) of one case."""
    net = case.start.net
    if net.n_nodes > MOST_NODES:
        yield left_out("matrices", f"dense, for up to {MOST_NODES} nodes, not {net.n_nodes}")
        return
    probe, system = case.probe(), case.theirs.system
    masses = _ours(case, np.diag(_masses(case)))
    yield difference("mass matrix", probe.mass(), masses, tol.MASS, ENTRY)
    found: dict[str, list[Check]] = {}
    others = sorted(case.effects - WITH_FORMULAS)
    how = f" by differences ({', '.join(others)})" if others else ""
    viscous = not case.effects.isdisjoint(DIFFERENTIATED)
    of_damping = tol.STIFFNESS if viscous else tol.DIFFERENCED if others else tol.DAMPING
    resolved = tol.RESOLVED.value if viscous else tol.RESOLVED_BY_STEPS.value if others else 0.0
    least = resolved * float((net.youngs_modulus * net.area).max())
    states = smooth_states(net, np.random.default_rng(SEED))
    if HALF_SLACK not in states:
        yield left_out(f"matrices, {HALF_SLACK}", NO_HALF_SLACK)
    # The drag of still air has no slope at rest.
    speed = PACE_IN_AIR[0] if "air_drag" in case.effects else 0.0
    velocity = speed * np.random.default_rng(SEED).normal(size=case.start.position.shape)
    velocity[net.fixed_nodes] = 0.0
    held = coordinates(case.reference_nodes[net.fixed_nodes])
    for kind, position in states.items():
        position[net.fixed_nodes] = case.start.position[net.fixed_nodes]
        there = case.to_reference(position)
        state = case.from_state(position, velocity).start.state
        position = state.position
        tangent, damping = _differences(case, state) if others else _formulas(case, there)
        secant = formulas.secant(system, there).toarray()
        compared = [
            (f"tangent stiffness{how}", probe.stiffness(position, velocity), tangent, tol.STIFFNESS, 0.0),
            (f"damping matrix{how}", probe.damping(position, velocity), damping, of_damping, least),
            ("secant stiffness, S - S^T", secant, secant.T, tol.SECANT_SYMMETRY, 0.0),
        ]
        if not others:
            pull = secant @ there.ravel()
            felt = case.to_reference(probe.accelerations(position, velocity) - _gravity(case)).ravel()
            force = -np.repeat(case.theirs.net.mass, 3) * felt
            force[held] = pull[held]  # the engine's fixed points feel nothing
            compared.append(("forces against S(x) x", force, pull, tol.SECANT_FORCE, 0.0))
        for name, a, b, allowed, floor in compared:
            found.setdefault(name, []).append(difference(kind, a, b, allowed, ENTRY[: a.ndim], least=floor))
    for name, checks in found.items():
        yield worst_of(f"{name}, {' and '.join(check.name for check in checks)}", checks)


def _formulas(case: BothCodes, there: Floats) -> tuple[Floats, Floats]:
    """Tangent stiffness and damping matrix of the reference, (3n, 3n) in exunet's order."""
    tangent, damping = (of(case.theirs.system, there) for of in (formulas.tangent, formulas.damping))
    return _ours(case, tangent.toarray()), _ours(case, damping.toarray())


def _masses(case: BothCodes) -> Floats:
    """(3N,) of the reference's nodes, then of its bodies."""
    return np.repeat(np.append(case.theirs.net.mass, case.theirs.system.bodies.mass), 3)


def _differences(case: BothCodes, state: State) -> tuple[Floats, Floats]:
    """The same from central differences of the reference's accelerations at a state."""
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


def _gravity(case: BothCodes) -> Floats:
    """(n, 3) accelerations of the reference where no cable pulls: all nodes at rest on one spot."""
    nowhere = np.zeros_like(case.theirs.net.reference_position)
    return case.from_reference(reference.acceleration(case.theirs.system, 0.0, nowhere, nowhere))


def _ours(case: BothCodes, matrix: Floats) -> Floats:
    """A matrix of the reference (3N, 3N) for exunet's points, with zero rows and columns for fixed nodes."""
    points = case.reference_particles[: case.start.system.blocks.n_points]
    place, fixed = coordinates(points), coordinates(case.start.net.fixed_nodes)
    result = matrix[np.ix_(place, place)]
    result[fixed], result[:, fixed] = 0.0, 0.0
    return result
