"""The energy-momentum method (EM): implicit, of order 2, conserving at any step.

Mid-point rule with a discrete gradient: Simo & Tarnow, ZAMP 43 (1992), doi:10.1007/BF00913408; Gonzalez,
CMAME 190 (2000), doi:10.1016/S0045-7825(00)00189-4.  With u = x1 - x0 unknown and v_m = (v0 + v1)/2 = u/h,

    M (v1 - v0)/h + sum A_e^T S (A/L) Delta x_m + D v_m = p(x_m, v_m),

where S is the discrete derivative (W(E1) - W(E0))/(E1 - E0) of W = E/2 max(E11, 0)^2, eqs. (8), (19).
Since E1 - E0 = d_m.(d1 - d0)/L^2, the work of each element over the step is its change of energy; forces
along d_m keep both momenta; damping takes h v_m^T D v_m.

With a = max(E0, 0), b = max(E1, 0): S = E (a + b)/2 (b - a)/(E1 - E0).  The last ratio is 1 if the element is
taut at both ends of the step, 0 if slack at both; else E1 - E0 is a sum of like signs: no limit to take.
material_damping adds max(E tau (b - a)/h, -S), whose product with E1 - E0 is never negative.

Other potentials likewise: quadratic ones (orbit, j2, bending) by the force at the mid-point, constant forces
as they are.  A free strain is taken off E0 and E1.  Bodies turn by Cayley's transform
(`bodies.conserving_turn`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array, csc_array, diags_array
from scipy.sparse.linalg import splu

from reference_impl import body_forces
from reference_impl.arrays import Floats, Ints, dot
from reference_impl.bodies import conserving_turn
from reference_impl.effects.orbit import coriolis
from reference_impl.elements import damping, excess, span, strain
from reference_impl.forces import gather
from reference_impl.run import Breakdown, Run
from reference_impl.state import Mode
from reference_impl.system import System

GOAL = 1e-14  # residual over the forces at work at which Newton's method stops
ENOUGH = 1e-12  # the same, at which it may stop where round-off lets it come no closer
ITERATIONS = 60
HALVINGS = 12  # of a step that fails


def unsupported(system: System) -> str:
    """What the method cannot take in this system; empty if nothing."""
    effects, reasons = system.effects, []
    if effects.orbit is not None and effects.orbit.two_body:
        reasons.append('effects.orbit.model = "two_body", whose potential has no discrete gradient here')
    reasons += [
        f"effects.{name}, a damping that is not linear in the velocity"
        for name in ("air_drag", "molecular_drag")
        if getattr(effects, name) is not None
    ]
    if effects.thrust is not None:
        reasons.append("effects.thrust, which puts energy in")
    if system.propelled:
        reasons.append("thrust on bodies, which puts energy in")
    if system.net.curves:
        reasons.append('cable laws other than "green_lagrange", whose energy is not quadratic in the strain')
    if effects.breaking is not None:
        reasons.append("effects.breaking, which ends an element's energy")
    if effects.self_contact is not None:
        reasons.append("effects.self_contact, whose forces have no discrete gradient here")
    if effects.contact is not None:
        reasons.append("effects.contact, whose forces have no discrete gradient here")
    if system.barrels is not None:
        reasons.append("effects.launch_force, whose barrels would couple its steps to their turning")
    if len(system.levers):
        reasons.append("nodes that are points of bodies, which would couple its steps to their turning")
    if system.packed is not None:
        reasons.append("initial.frame.eject_at, before which a net would couple its steps to turning")
    if len(system.bodies.driven):
        reasons.append("bodies whose motion is given")
    if body_forces.turn(system):
        reasons.append("effects that turn bodies (effects.orbit, or damping by the mass)")
    if system.closing is not None:
        reasons.append("closing, which puts energy in")
    if system.assembled:
        reasons.append("assembled arithmetic, which it does not have")
    return "; ".join(reasons)


class EnergyMomentum:
    """Steps of one length [s].  A step at which Newton's method fails is done in two halves, and counted.

    Whole steps are counted from the last stored time, so that none drifts; the last one before a stored time
    is shorter where the step does not divide the interval.
    """

    def __init__(self, run: Run, step: float) -> None:
        self.run, self.step = run, step
        self.scheme = _Scheme(run.system)

    def advance(self, end: float) -> tuple[Floats, Mode]:
        """Takes the run to t = end [s]; the state and mode then."""
        begin = self.run.t
        whole = math.ceil((end - begin) / self.step * (1.0 - 1e-12))
        for k in range(1, whole + 1):
            self.take(end if k == whole else begin + k * self.step)
        return self.run.y, self.run.mode

    def renew(self, until: float) -> None:
        """Nothing is kept from step to step."""

    def take(self, arrival: float, depth: int = 0) -> None:
        """One step, to `arrival` [s], after `depth` halvings."""
        run, scheme, y, h = self.run, self.scheme, self.run.y, arrival - self.run.t
        x, v = run.layout.positions(y), run.layout.velocities(y)
        try:
            try:
                u, taken, solved = scheme.solve(x, v, h)
                rotation = _turn(run, h)
            finally:
                run.n_rhs = scheme.evaluations
            run.n_newton += solved
        except _NoRoot as failure:
            run.n_newton += failure.solved
            if depth == HALVINGS:
                raise Breakdown(
                    f"Newton's method failed in a step of {h:.3g} s, after {HALVINGS} halvings: residual"
                    f" {failure.residual:.3g} of the forces at work, worst at node {failure.node},"
                ) from None
            run.n_halvings += 1
            self.take(run.t + 0.5 * h, depth + 1)
            self.take(arrival, depth + 1)
            return
        after = (x + u, 2.0 / h * u - v, rotation, y[-1] + taken)
        run.arrive(arrival, np.concatenate([np.ravel(part) for part in after]))


def _turn(run: Run, h: float) -> Floats:
    """R, h (12 b,) of the bodies after h [s]."""
    bodies = run.system.bodies
    now = run.layout.held(run.y)
    attitude = conserving_turn(now.attitude, now.spin, bodies, h)
    if attitude is None:
        raise _NoRoot(0, np.nan, -1)
    return np.concatenate((attitude.ravel(), now.spin.ravel()))


class _NoRoot(Exception):
    """Newton's method did not converge: linear systems solved, relative residual, the node of the largest."""

    def __init__(self, solved: int, residual: float, node: int) -> None:
        super().__init__()
        self.solved, self.residual, self.node = solved, residual, node


@dataclass(frozen=True, eq=False)
class _Element:
    """Elements in a step: d_m and d1; S A/L, its derivative with respect to E1, what of it is viscous."""

    mid: Floats  # (m, 3) [m]
    end: Floats  # (m, 3) [m]
    change: Floats  # E1 - E0 (m,) [-]
    total: Floats  # (m,) [N/m]
    slope: Floats  # (m,) [N/m]
    viscous: Floats  # (m,) [N/m]


class _Scheme:
    """Residual and tangent of one step of a system, in the step u (N, 3) [m] of nodes and bodies."""

    def __init__(self, system: System) -> None:
        self.system = system
        self.evaluations = 0  # of the forces, one in each residual
        effects, net = system.effects, system.net
        self.nodes = n = len(net.mass)
        self.mass = np.concatenate((net.mass, system.bodies.mass))[:, None]
        self.free = np.concatenate((system.compliance_of_inertia[:, 0] > 0.0, system.bodies.mass > 0.0))
        self.damping = damping(system)
        self.drag = body_forces.damping_rate(system) * self.mass
        self.load = self.mass * np.array(effects.gravity)
        if effects.solar_pressure is not None:
            self.load[:n] += system.sunlight
        self.gradient = body_forces.gradient_of(system)
        self.coriolis = coriolis(effects.orbit) if effects.orbit else np.zeros((3, 3))
        direction = system.reference_direction
        self.viscous = (effects.beta * system.axial_stiffness)[:, None, None] * (
            direction[:, :, None] * direction[:, None, :]
        )
        bent = _bending_stiffness(system)
        self.bent = 0.5 * bent.data[:, None, None] * np.eye(3)
        i, j = system.ends
        all_of = np.arange(len(self.mass))
        rows, columns = [i, j, i, j, all_of, bent.row], [i, j, j, i, all_of, bent.col]
        self.shape, self.slots, self.pattern = _pattern(
            np.concatenate(rows), np.concatenate(columns), self.free
        )

    def elements(self, x: Floats, u: Floats, h: float) -> _Element:
        """Stresses of the step u (N, 3) [m] from x."""
        system, n = self.system, self.nodes
        d0, du = span(system, x[:n]), span(system, u[:n])
        mid, end = d0 + 0.5 * du, d0 + du
        e0 = excess(system, strain(system, x[:n]))
        change = dot(mid, du) / system.squared_reference_length
        e1 = e0 + change
        a, b = np.maximum(e0, 0.0), np.maximum(e1, 0.0)
        mixed = (e0 > 0.0) != (e1 > 0.0)
        safe = np.where(mixed & (change != 0.0), change, 1.0)
        share = np.where(mixed, (b - a) / safe, np.where(e0 > 0.0, 1.0, 0.0))
        stiffness = system.axial_stiffness
        elastic = 0.5 * stiffness * (a + b) * share
        # d/dE1 of (b^2 - a^2)/(2 (E1 - E0)) = (b - (a + b)/2 share)/(E1 - E0), 1/2 where taut throughout
        slope = stiffness * np.where(mixed, (b - 0.5 * (a + b) * share) / safe, 0.5 * share)
        viscous = np.zeros_like(elastic)
        if tau := system.effects.relaxation_time:
            viscous = np.maximum(tau / h * stiffness * (b - a), -elastic)
            slope = np.where(
                viscous > -elastic, slope + tau / h * stiffness * np.where(e1 > 0.0, 1.0, 0.0), 0.0
            )
        return _Element(mid, end, change, elastic + viscous, slope, viscous)

    def residual(self, x: Floats, v: Floats, u: Floats, h: float, state: _Element) -> tuple[Floats, Floats]:
        """Out-of-balance forces (N, 3) [N], zero at fixed nodes, and the sizes (N, 3) of what balances."""
        self.evaluations += 1
        system, n, mean = self.system, self.nodes, u / h
        pull = state.total[:, None] * state.mid
        if system.effects.bending is not None:
            pull = pull + system.hinges.pull(state.mid)
        result = 2.0 / h * self.mass * (mean - v)
        drag = self.drag * mean
        drag[:n] = (self.damping @ mean[:n].ravel()).reshape(-1, 3)
        field = (x + 0.5 * u) @ self.gradient.T + mean @ self.coriolis.T
        push = self.load + self.mass * field
        at_work = 2.0 / h * self.mass * (np.abs(mean) + np.abs(v)) + np.abs(drag) + np.abs(push)
        at_work[:n] += system.touching @ np.abs(pull)
        result[:n] = result[:n] + gather(system, pull)
        result += drag - push
        result[~self.free] = 0.0
        return result, at_work

    def tangent(self, h: float, state: _Element) -> csc_array:
        """Derivative (3f, 3f) [N/m] of the residual at the f free particles with respect to u."""
        system = self.system
        direction = state.slope / system.squared_reference_length
        block = direction[:, None, None] * (state.mid[:, :, None] * state.end[:, None, :]) + self.viscous / h
        block += (0.5 * state.total)[:, None, None] * np.eye(3)
        diagonal = (2.0 / h**2 * self.mass + self.drag / h)[:, :, None] * np.eye(3)
        diagonal -= self.mass[:, :, None] * (0.5 * self.gradient + self.coriolis / h)
        values = np.concatenate((block, block, -block, -block, diagonal, self.bent)).ravel()
        indices, indptr = self.pattern
        data = np.bincount(self.slots, values, minlength=len(indices) + 1)[: len(indices)]
        return csc_array((data, indices, indptr), shape=self.shape)

    def solve(self, x: Floats, v: Floats, h: float) -> tuple[Floats, float, int]:
        """The step u (N, 3) [m], the energy that damping takes in it [J], linear systems solved."""
        u = h * v
        state = self.elements(x, u, h)
        residual, at_work = self.residual(x, v, u, h, state)
        size, solved = np.linalg.norm(residual), 0
        while True:
            scale = np.linalg.norm(at_work)
            if size <= GOAL * scale:
                break
            improved = False
            if solved < ITERATIONS:
                step = self._newton_step(residual, h, state)
                solved += 1
                length = 1.0
                for _ in range(20):
                    trial = u + length * step
                    trial_state = self.elements(x, trial, h)
                    trial_residual, trial_work = self.residual(x, v, trial, h, trial_state)
                    trial_size = np.linalg.norm(trial_residual)
                    if trial_size < (1.0 - 1e-4 * length) * size:
                        u, state, residual, at_work = trial, trial_state, trial_residual, trial_work
                        size, improved = trial_size, True
                        break
                    if size <= ENOUGH * scale:  # round-off: a shorter step comes no closer
                        break
                    length *= 0.5
            if not improved:
                if size <= ENOUGH * scale and solved < ITERATIONS:
                    break
                worst = int(np.argmax(np.max(np.abs(residual), axis=1)))
                raise _NoRoot(solved, float(size / scale), worst)
        mean = u[: self.nodes] / h
        taken = h * float(mean.ravel() @ (self.damping @ mean.ravel()))
        taken += float(np.sum(self.drag[self.nodes :] * u[self.nodes :] ** 2)) / h
        taken += float(np.sum(state.viscous * state.change * self.system.squared_reference_length))
        return u, taken, solved

    def _newton_step(self, residual: Floats, h: float, state: _Element) -> Floats:
        step = np.zeros_like(residual)
        try:
            step[self.free] = splu(self.tangent(h, state)).solve(-residual[self.free].ravel()).reshape(-1, 3)
        except RuntimeError:  # exactly singular: no step, which the line search reports
            step[:] = np.nan
        return step


def _bending_stiffness(system: System) -> coo_array:
    """Stiffness (n, n) [N/m] of the springs of `bending`, the same in each direction; empty without them."""
    n = len(system.net.mass)
    if system.effects.bending is None:
        return coo_array((n, n))
    hinges = system.hinges
    rows = np.arange(len(hinges.pairs))
    kinks = (
        sum(
            coo_array(
                (hinges.share[:, k], (rows, hinges.pairs[:, k])), shape=(len(rows), len(system.net.area))
            )
            for k in (0, 1)
        )
        @ system.incidence.T
    )
    return coo_array(kinks.T @ diags_array(hinges.stiffness) @ kinks)


def _pattern(rows: Ints, columns: Ints, free: np.ndarray) -> tuple[tuple[int, int], Ints, tuple[Ints, Ints]]:
    """CSC pattern of blocks (3, 3) at nodes (rows, columns), fixed nodes struck out.

    Returns the shape, for each entry of the blocks its place in the data (the place after the last where it
    is struck out), and (indices, indptr).
    """
    size = 3 * int(np.count_nonzero(free))
    number = np.full(len(free), -1)
    number[free] = np.arange(size // 3)
    axis = np.arange(3)
    row = np.broadcast_to(3 * number[rows][:, None, None] + axis[:, None], (len(rows), 3, 3)).ravel()
    column = np.broadcast_to(3 * number[columns][:, None, None] + axis, (len(rows), 3, 3)).ravel()
    kept = (row >= 0) & (column >= 0)
    filled, place = np.unique(column[kept] * size + row[kept], return_inverse=True)
    slots = np.full(len(row), len(filled))
    slots[kept] = place
    start = np.searchsorted(filled // max(size, 1), np.arange(size + 1))
    return (size, size), slots, (filled % max(size, 1), start)
