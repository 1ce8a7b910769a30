"""The engine's equations of motion at given states: accelerations, and its own linearisation."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.sparse import csc_array
from scipy.sparse.linalg import splu

from exunet.base.arrays import Floats
from exunet.forces.terms import DiscreteStates
from exunet.integrators.exudyn.build import remember
from exunet.integrators.exudyn.engine import exudyn, quiet_settings
from exunet.integrators.exudyn.model import Model
from exunet.model.system import Moving, System


class Probe:
    """Evaluates an assembled model at states of the caller's choice, without a step in time.

    States are position, velocity (n, 3) [m], [m/s] of all points; fixed points keep their place, and rigid
    bodies and first-order states theirs: that which the model was built with, or of the last call of
    `motion`. Matrices are (3n, 3n) over all points, with zero rows and columns for fixed points.
    """

    def __init__(self, model: Model) -> None:
        self._engine = exudyn()
        self._model = model
        self._system = model.system
        self._reference, self._free, self._columns = model.reference, model.free, model.columns()
        self._solver = self._initialised(0.01)  # [m, m/s], the engine's own choice
        # Coordinates below this change by 1e-7 of it where positions are differentiated: 1e-2 m in the
        # paper's net of 7 m. Much smaller parts of a net drown in round-off, much larger ones bend the law.
        size = float(np.ptp(self._reference, axis=0).max()) or 1.0
        self._differentiator = self._initialised(0.01 / 7.0 * size)
        self._solver.ComputeMassMatrix(model.system)
        self._mass = np.array(self._solver.GetSystemMassMatrix())
        self._divide_by_mass = splu(csc_array(self._mass)).solve
        # Last: the start of an implicit solver leaves a GeneralContact out of all forces from then on.
        self._forces = self._explicit()

    def _explicit(self) -> Any:
        """An explicit solver of the engine."""
        settings = quiet_settings()
        settings.timeIntegration.solverType = self._engine.DynamicSolverType.RK44
        settings.timeIntegration.explicit.useLieGroupIntegration = self._model.has_bodies
        solver = self._engine.MainSolverExplicit()
        solver.InitializeSolver(self._system, settings)
        return solver

    def _initialised(self, least: float) -> Any:
        """The engine's implicit solver; least : size below which coordinates count as so large."""
        settings = quiet_settings()
        settings.timeIntegration.newton.numericalDifferentiation.minimumCoordinateSize = least
        solver = self._engine.MainSolverImplicitSecondOrder()
        solver.InitializeSolver(self._system, settings)
        return solver

    def _set(self, position: Floats, velocity: Floats, time: float = 0.0) -> None:
        self._model.refresh()
        current = self._engine.ConfigurationType.Current
        data = self._system.systemData
        q, v = data.GetODE2Coordinates(current), data.GetODE2Coordinates_t(current)
        q[self._columns] = (position - self._reference)[self._free].ravel()
        v[self._columns] = velocity[self._free].ravel()
        data.SetODE2Coordinates(q, current)
        data.SetODE2Coordinates_t(v, current)
        data.SetTime(time, current)

    def remember(self, system: System, discrete: DiscreteStates) -> None:
        """Evaluate the forces at these discrete states of the system from now on; at first at those of the start."""
        remember(self._model, system, discrete)

    def accelerations(self, position: Floats, velocity: Floats, time: float = 0.0) -> Floats:
        """(n, 3) [m/s2], eq. (16), at a time [s]; zero for fixed points."""
        self._set(position, velocity, time)
        result = np.zeros_like(self._reference)
        result[self._free] = self._change()[self._columns].reshape(-1, 3)
        return result

    def motion(self, moving: Moving, time: float = 0.0) -> tuple[Floats, Floats]:
        """`accelerations` (n, 3) of the points, and (n_free_bodies, 6) of the free bodies, in their states.

        Of a body: that of its centre [m/s2], and the angular one in principal axes [rad/s2]. Points that are
        fixed to bodies have none, and are where their bodies put them.
        """
        data, current = self._system.systemData, self._engine.ConfigurationType.Current
        now = self._model.places.pack(moving, self._model.coordinates())
        data.SetODE2Coordinates(now.q, current)
        data.SetODE2Coordinates_t(now.v, current)
        if len(now.y):
            data.SetODE1Coordinates(now.y, current)
        points = self.accelerations(moving.position, moving.velocity, time)
        return points, self._change()[self._model.places.bodies]

    def _change(self) -> Floats:
        """Rates of the engine's velocities in its state."""
        self._forces.ComputeODE2RHS(self._system)
        force = np.array(self._forces.GetSystemResidual())[: len(self._mass)]
        return np.asarray(self._divide_by_mass(force))

    def mass(self) -> Floats:
        """M of eq. (10) [kg]."""
        return self._of_all_points(self._mass)

    def stiffness(self, position: Floats, velocity: Floats) -> Floats:
        """Minus the derivative of the forces by the positions [N/m]: T of eq. (14) under constant loads.

        The engine differentiates connectors with a force law of their own numerically.
        """
        return self._jacobian(self._differentiator, position, velocity, -1.0, 0.0)

    def damping(self, position: Floats, velocity: Floats) -> Floats:
        """Minus the derivative of the forces by the velocities [N s/m]: D of eq. (13)."""
        return self._jacobian(self._solver, position, velocity, 0.0, -1.0)

    def _jacobian(
        self, solver: Any, position: Floats, velocity: Floats, of_place: float, of_speed: float
    ) -> Floats:
        self._set(position, velocity)
        solver.ComputeJacobianODE2RHS(self._system, of_place, of_speed)
        size = len(self._mass)
        return self._of_all_points(np.array(solver.GetSystemJacobian())[:size, :size])

    def _of_all_points(self, matrix: Floats) -> Floats:
        keep = np.repeat(self._free, 3)
        whole = np.zeros((len(keep), len(keep)))
        whole[np.ix_(keep, keep)] = matrix[np.ix_(self._columns, self._columns)]
        return whole
