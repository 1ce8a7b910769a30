"""The multibody system: Exudyn items, forces that functions compute, and the state as plain arrays."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from exunet.backends.exudyn.coordinates import Coordinates, Places
from exunet.backends.exudyn.items import Items
from exunet.bodies.kinematics import Kinematics

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Evaluate = Callable[[float, Floats, Floats, Floats], None]
Rates = Callable[[float, Floats, Floats], Floats]
Jacobian = Callable[[float, Floats, Floats, float, float], csr_array]
_NONE = np.zeros(0)


class Model(Items):
    """A system whose forces functions compute and whose state is plain arrays, once it is assembled."""

    def __init__(self, system: Any = None) -> None:
        super().__init__(system)
        self._seen: Coordinates | None = None
        self._n_first_order = 0
        self._n_ballast = 0
        self.applied: Any = None  # the AppliedKernel that pushes the points, if there is one

    def linear_terms(
        self, on_velocity: csr_array | None, stiffness: csr_array | None, load: Floats | None
    ) -> None:
        """Add one constant object over all points: force = load - on_velocity @ v - stiffness @ x.

        Matrices (3n, 3n), load (3n,) or None; n counts all points, fixed included; x is the position.
        """
        keep, nodes = self._free_coordinates(), self._free_nodes()
        if not nodes or (on_velocity is None and stiffness is None and load is None):
            return
        arguments: dict[str, Any] = {"nodeNumbers": nodes}
        if on_velocity is not None:
            arguments["dampingMatrix"] = self._matrix(on_velocity[keep][:, keep])
        if stiffness is not None:
            # The engine's stiffness acts on the displacement from the reference position.
            arguments["stiffnessMatrix"] = self._matrix(stiffness[keep][:, keep])
            constant = -(stiffness @ np.array(self._reference).ravel())
            load = constant if load is None else load + constant
        if load is not None:
            arguments["forceVector"] = load[keep].tolist()
        self._add_object(self._items.ObjectGenericODE2(**arguments), "ObjectGenericODE2")

    def applied_forces(
        self,
        evaluate: Evaluate,
        jacobian: Jacobian | None = None,
        *,
        bodies: bool = False,
    ) -> None:
        """Add forces on all free points, and on bodies, that a function computes at once.

        evaluate : evaluate(t, q, q_t, out) writes the forces [N] on the free coordinates into out
                   (3 n_free,); q, q_t are all the engine's coordinates (displacements, velocities)
        jacobian : jacobian(t, q, q_t, of_position, of_velocity) gives the csr matrix of
                   -(of_position df/dq + of_velocity df/dq_t), (3 n_free, 3 n_free); None: an explicit method
        bodies   : out goes on with the force [N] and the torque in body axes [N m] on each body; with the
                   engine's rotation vectors these are the forces of a body's six coordinates

        Two objects: the first, on one node only, computes the forces and puts them into the second, which
        holds them. The engine evaluates objects in their order (with one thread, which is its default); it
        makes Python lists of the coordinates of an object with a user function, which for all nodes costs
        more than the rest of the evaluation.
        """
        keep, nodes = self._free_coordinates(), self._free_nodes()
        turning = 6 * len(self._bodies) if bodies else 0
        out = np.zeros(np.count_nonzero(keep) + turning)
        if not len(out):
            return
        if bodies:
            nodes = nodes + self._bodies
        coordinates = self.coordinates_in_call
        nothing = [0.0] * (6 if nodes[0] in self._bodies else 3)
        arguments: dict[str, Any] = {"nodeNumbers": nodes, "forceVector": out.tolist()}
        self._keep_alive += [evaluate, jacobian]

        def compute(mbs: Any, t: float, item: int, _q: Any, _q_t: Any) -> list[float]:
            q, q_t, _ = coordinates()
            evaluate(t, q, q_t, out)
            mbs.SetObjectParameter(item + 1, "forceVector", out)
            return nothing

        own: dict[str, Any] = {"nodeNumbers": nodes[:1], "forceUserFunction": compute}
        if jacobian is not None:
            own["jacobianUserFunction"] = _no_jacobian(self._matrix(csr_array((3, 3))))
            arguments["jacobianUserFunction"] = self._system_jacobian(jacobian)
        self._add_object(self._items.ObjectGenericODE2(**own), "ObjectGenericODE2")
        self._add_object(self._items.ObjectGenericODE2(**arguments), "ObjectGenericODE2")

    def first_order_states(self, initial: Floats, rates: Rates) -> None:
        """Add first-order states (n_states,); rates(t, q, q_t) gives theirs (see `applied_forces`)."""
        node = self.system.AddNode(
            self._items.NodeGenericODE1(
                referenceCoordinates=[0.0] * len(initial),
                initialCoordinates=initial.tolist(),
                numberOfODE1Coordinates=len(initial),
            )
        )
        coordinates = self.coordinates_in_call

        def compute(_mbs: Any, t: float, _item: int, _q: Any) -> list[float]:
            q, q_t, _ = coordinates()
            return list(rates(t, q, q_t).tolist())

        self._keep_alive.append(compute)
        self._n_first_order = len(initial)
        arguments: dict[str, Any] = {"nodeNumbers": [int(node)], "rhsUserFunction": compute}
        self._add_object(self._items.ObjectGenericODE1(**arguments), "ObjectGenericODE1")

    def first_order(self) -> Floats:
        """(n_states,) the first-order states now; a view."""
        if not self._n_first_order:
            return _NONE
        return np.asarray(self.system.systemData.GetODE1Coordinates(copy=False))

    def look_again(self) -> None:
        """Let `coordinates_in_call` take new views of the engine's state.

        A view costs as much as the forces of a hundred elements. Within a call of the engine its arrays stay
        where they are; between two calls nothing is presumed.
        """
        self._seen = None

    def _system_jacobian(self, jacobian: Jacobian) -> Any:
        data = self.system.systemData
        container = self._engine.MatrixContainer()

        def compute(_mbs: Any, t: float, _item: int, _q: Any, _q_t: Any, of_q: float, of_q_t: float) -> Any:
            q, q_t = data.GetODE2Coordinates(copy=False), data.GetODE2Coordinates_t(copy=False)
            container.SetWithSparseMatrix(jacobian(t, q, q_t, of_q, of_q_t))
            return container

        return compute

    def columns(self) -> Ints:
        """(3 n_free,) where the free points' coordinates stand in the engine's second-order ones."""
        begins = {node: self.system.GetNodeODE2Index(node) for node in self._free_nodes()}
        free = np.flatnonzero(self._free).tolist()
        starts = np.array([begins[self._nodes[k]] for k in free], dtype=np.int64)
        return np.asarray((starts[:, None] + np.arange(3)).ravel())

    def columns_of_bodies(self) -> Ints:
        """(n_bodies,) where the six coordinates of each body begin there."""
        return np.array([self.system.GetNodeODE2Index(node) for node in self._bodies], dtype=np.int64)

    def _matrix(self, matrix: csr_array) -> Any:
        matrix = csr_array(matrix)
        matrix.eliminate_zeros()
        container = self._engine.MatrixContainer()
        container.SetWithSparseMatrix(matrix, numberOfRows=matrix.shape[0], numberOfColumns=matrix.shape[1])
        return container

    def ballast(self) -> None:
        """Add a mass without forces if nothing else is free: the engine cannot integrate zero coordinates.

        No place refers to its coordinates. It is no part of the scene, so `items` does not count it.
        """
        if not self.n_coordinates:
            node = self.system.AddNode(self._items.NodePoint())
            self.system.AddObject(self._items.MassPoint(mass=1.0, nodeNumber=node))
            self._n_ballast = 3

    def assemble(self, kinematics: Kinematics | None = None) -> None:
        """Finish the system; no item can be added afterwards. kinematics : of points without coordinates."""
        self.system.Assemble()
        reference = np.array(self._reference, dtype=float).reshape(-1, 3)
        bodies = self.columns_of_bodies()[:, None] + np.arange(6)
        self.places = Places(reference, self.free, self.columns(), bodies, kinematics or Kinematics())

    def items(self) -> dict[str, int]:
        """How many objects of each kind the engine holds."""
        return dict(self._counts)

    @property
    def nodes(self) -> list[int]:
        """The engine's number of each point's node; -1 for points of bodies."""
        return list(self._nodes)

    @property
    def all_points_alone(self) -> bool:
        """True if the mass matrix can be inverted body by body: no object has several nodes."""
        alone = {"MassPoint", "ObjectConnectorSpringDamper", "ObjectRigidBody"}
        return set(self._counts) <= alone

    @property
    def free(self) -> NDArray[np.bool_]:
        """(n,) False for the fixed points."""
        return np.array(self._free, dtype=bool)

    @property
    def has_bodies(self) -> bool:
        """True if there are rigid bodies."""
        return bool(self._bodies)

    @property
    def n_points(self) -> int:
        """Points, fixed ones included."""
        return len(self._nodes)

    @property
    def n_coordinates(self) -> int:
        """Second-order coordinates: of the free points (3 each), of the bodies (6 each), of the ballast."""
        return 3 * int(np.count_nonzero(self._free)) + 6 * len(self._bodies) + self._n_ballast

    @property
    def reference(self) -> Floats:
        """(n_points, 3) [m], of an assembled model."""
        return self.places.reference

    def coordinates(self) -> Coordinates:
        """Where the engine stands, as views."""
        data = self.system.systemData
        q, v = data.GetODE2Coordinates(copy=False), data.GetODE2Coordinates_t(copy=False)
        return Coordinates(q, v, self.first_order())

    def coordinates_in_call(self) -> Coordinates:
        """The same between `look_again` and the end of the engine's next call."""
        seen = self._seen
        if seen is None:
            seen = self._seen = self.coordinates()
        return seen


def _no_jacobian(container: Any) -> Any:
    def compute(*_: Any) -> Any:
        return container

    return compute
