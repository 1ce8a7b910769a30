"""The engine's accelerations at given states."""

from __future__ import annotations

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
    `motion`.
    """

    def __init__(self, model: Model) -> None:
        self._engine = exudyn()
        self._model = model
        self._system = model.system
        self._reference, self._free, self._columns = model.reference, model.free, model.columns()
        settings = quiet_settings()
        settings.timeIntegration.solverType = self._engine.DynamicSolverType.RK44
        settings.timeIntegration.explicit.useLieGroupIntegration = model.has_bodies
        self._solver = self._engine.MainSolverExplicit()
        self._solver.InitializeSolver(model.system, settings)
        self._solver.ComputeMassMatrix(model.system)
        self._mass = np.array(self._solver.GetSystemMassMatrix())
        self._divide_by_mass = splu(csc_array(self._mass)).solve

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
        """Evaluate the forces at these discrete states from now on; at first at those of the start."""
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
        self._solver.ComputeODE2RHS(self._system)
        force = np.array(self._solver.GetSystemResidual())[: len(self._mass)]
        return np.asarray(self._divide_by_mass(force))
