"""The multibody system: a few verbs over Exudyn items, and the state as plain arrays."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array, diags_array

from exunet.backends.exudyn.loading import exudyn
from exunet.bodies.rigid import RigidBody, RigidStates, quaternion_of, rotation_vector
from exunet.forces import cable

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Evaluate = Callable[[float, Floats, Floats, Floats], None]
Jacobian = Callable[[float, Floats, Floats, float, float], csr_array]


class Model:
    """One Exudyn system that is filled by verbs, then assembled.

    A *point* is a mass point with three coordinates or, when fixed, a point of the ground. Points are
    numbered in the order they are added, fixed ones included.
    """

    def __init__(self) -> None:
        import exudyn.itemInterface as items  # noqa: N813 - a module of the engine

        self._engine = exudyn()
        self._items = items
        self.container = self._engine.SystemContainer()
        self.system = self.container.AddSystem()
        self._counts: Counter[str] = Counter()
        self._nodes: list[int] = []
        self._markers: list[int] = []
        self._free: list[bool] = []
        self._reference: list[Sequence[float]] = []
        self._keep_alive: list[Any] = []  # the engine only borrows the functions it is given
        self._laws: dict[bool, Any] = {}
        self._views: list[Floats] = []
        self._connectors: list[int] = []
        self._carrying: NDArray[np.bool_] | None = None
        self._bodies: list[int] = []
        self.applied: Any = None  # the AppliedKernel that pushes the points, if there is one
        self.elements_applied = False  # that kernel has the elements' forces too

    def _add_object(self, item: Any, name: str) -> int:
        self._counts[name] += 1
        return int(self.system.AddObject(item))

    def point(self, mass: float, reference: Floats, position: Floats, velocity: Floats) -> int:
        """Add a mass point [kg] with its reference position, initial position [m] and velocity [m/s]."""
        number = self.node(reference, position, velocity)
        self._add_object(self._items.MassPoint(mass=float(mass), nodeNumber=self._nodes[number]), "MassPoint")
        return number

    def node(self, reference: Floats, position: Floats, velocity: Floats) -> int:
        """Add a point as `point` does, but without mass: for `applied_forces` that bring the mass."""
        node = self.system.AddNode(
            self._items.NodePoint(
                referenceCoordinates=reference.tolist(),
                initialCoordinates=(position - reference).tolist(),
                initialVelocities=velocity.tolist(),
            )
        )
        return self._number(node, reference, free=True)

    def fixed_point(self, position: Floats) -> int:
        """Add a point of the ground [m]."""
        node = self.system.AddNode(self._items.NodePointGround(referenceCoordinates=position.tolist()))
        return self._number(node, position, free=False)

    def _number(self, node: int, reference: Floats, *, free: bool) -> int:
        self._nodes.append(int(node))
        self._free.append(free)
        self._reference.append(tuple(map(float, reference)))
        marker = self.system.AddMarker(self._items.MarkerNodePosition(nodeNumber=node))
        self._markers.append(int(marker))
        return len(self._nodes) - 1

    def cable_element(
        self, i: int, j: int, natural_length: float, stiffness: float, relaxation_time: float | None = None
    ) -> int:
        """Add a tension-only connector between points i and j: eqs. (3) and (6)-(8).

        The connector's `stiffness`, `damping` and `force` slots carry stiffness [N], length [m] and
        relaxation time [s] to the one compiled force law that all elements share.
        """
        number = self._add_object(
            self._items.ObjectConnectorSpringDamper(
                markerNumbers=[self._markers[i], self._markers[j]],
                referenceLength=float(natural_length),
                stiffness=float(stiffness),
                damping=float(natural_length),
                force=0.0 if relaxation_time is None else float(relaxation_time),
            ),
            "ObjectConnectorSpringDamper",
        )
        self.system.SetObjectParameter(
            number, "springForceUserFunction", self._law(viscous=relaxation_time is not None)
        )
        self._connectors.append(number)
        return number

    def carry(self, intact: Floats) -> None:
        """Let the connectors of elements carry, or not: intact (n_elements,) is 1 or 0."""
        wanted = intact > 0.0
        before = np.ones(len(self._connectors), dtype=bool) if self._carrying is None else self._carrying
        for element in np.flatnonzero(wanted != before):
            connector = self._connectors[element]
            self.system.SetObjectParameter(connector, "activeConnector", bool(wanted[element]))
        self._carrying = wanted

    def rigid_body(self, body: RigidBody, state: RigidStates) -> int:
        """Add a body in its principal axes, free of forces.

        Its node has a rotation vector, as explicit methods need it. The reference attitude is that of the
        scene's axes, so the rotation vector is the attitude.
        """
        rotation = rotation_vector(state.attitude)
        node = self.system.AddNode(
            self._items.NodeRigidBodyRotVecLG(
                referenceCoordinates=[0.0] * 6,
                initialCoordinates=[*state.position.tolist(), *rotation.tolist()],
                initialVelocities=[*state.velocity.tolist(), *state.angular_velocity.tolist()],
            )
        )
        inertia = [*body.inertia, 0.0, 0.0, 0.0]
        item = self._items.ObjectRigidBody(mass=body.mass, nodeNumber=int(node), inertia=inertia)
        self._bodies.append(int(node))
        return self._add_object(item, "ObjectRigidBody")

    def _law(self, *, viscous: bool) -> Any:
        if viscous not in self._laws:
            self._laws[viscous] = self._compile_law(viscous=viscous)
        return self._laws[viscous]

    def _compile_law(self, *, viscous: bool) -> Any:
        from exudyn.advancedUtilities import CreateSymbolicUserFunction

        symbolic = self._engine.symbolic

        # The engine compiles these by their exact argument names; `damping` is the slot that holds the
        # length, `force` the one that holds the relaxation time.
        def elastic(mbs, t, itemNumber, deltaL, deltaL_t, stiffness, damping, force):  # type: ignore[no-untyped-def]
            return cable.tension(deltaL + damping, damping, stiffness, symbolic.max)

        def with_viscosity(mbs, t, itemNumber, deltaL, deltaL_t, stiffness, damping, force):  # type: ignore[no-untyped-def]
            return cable.viscous_tension(
                deltaL + damping, deltaL_t, damping, stiffness, force, symbolic.max, where
            )

        def where(condition: Any, then: Any, otherwise: float) -> Any:
            return symbolic.IfThenElse(condition, then, symbolic.Real(otherwise))

        return CreateSymbolicUserFunction(
            self.system,
            with_viscosity if viscous else elastic,
            "springForceUserFunction",
            itemTypeName="ObjectConnectorSpringDamper",
        )

    def linear_terms(
        self, on_velocity: csr_array | None, stiffness: csr_array | None, load: Floats | None
    ) -> None:
        """Add one constant object over all points: force = load - on_velocity @ v - stiffness @ x.

        Matrices (3n, 3n), load (3n,) or None; n counts all points, fixed included; x is the position.
        """
        if on_velocity is None and stiffness is None and load is None:
            return
        keep, nodes = self._free_coordinates(), self._free_nodes()
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
        self, evaluate: Evaluate, jacobian: Jacobian | None = None, mass: Floats | None = None
    ) -> None:
        """Add forces on all free points that a function computes at once.

        evaluate : evaluate(t, q, q_t, out) writes the forces [N] on the free coordinates into out
                   (3 n_free,); q, q_t are all the engine's coordinates (displacements, velocities)
        jacobian : jacobian(t, q, q_t, of_position, of_velocity) gives the csr matrix of
                   -(of_position df/dq + of_velocity df/dq_t), (3 n_free, 3 n_free); None: an explicit method
        mass     : (n,) of all points [kg], for points added by `node`

        Two objects: the first, on one node only, computes the forces and puts them into the second, which
        holds them. The engine evaluates objects in their order (with one thread, which is its default); it
        makes Python lists of the coordinates of an object with a user function, which for all nodes costs
        more than the rest of the evaluation.
        """
        keep, nodes = self._free_coordinates(), self._free_nodes()
        out = np.zeros(len(nodes) * 3)
        if not len(out):
            return
        data, views = self.system.systemData, self._views
        nothing = [0.0, 0.0, 0.0]
        arguments: dict[str, Any] = {"nodeNumbers": nodes, "forceVector": out.tolist()}
        if mass is not None:
            arguments["massMatrix"] = self._matrix(csr_array(diags_array(np.repeat(mass, 3)[keep])))
        self._keep_alive += [evaluate, jacobian]

        def compute(mbs: Any, t: float, item: int, _q: Any, _q_t: Any) -> list[float]:
            if not views:
                views.extend((data.GetODE2Coordinates(copy=False), data.GetODE2Coordinates_t(copy=False)))
            evaluate(t, views[0], views[1], out)
            mbs.SetObjectParameter(item + 1, "forceVector", out)
            return nothing

        own: dict[str, Any] = {"nodeNumbers": nodes[:1], "forceUserFunction": compute}
        if jacobian is not None:
            own["jacobianUserFunction"] = _no_jacobian(self._matrix(csr_array((3, 3))))
            arguments["jacobianUserFunction"] = self._system_jacobian(jacobian)
        self._add_object(self._items.ObjectGenericODE2(**own), "ObjectGenericODE2")
        self._add_object(self._items.ObjectGenericODE2(**arguments), "ObjectGenericODE2")

    def look_again(self) -> None:
        """Take new views of the engine's state at the next evaluation.

        A view costs as much as the forces of a hundred elements. Within a call of the engine its arrays stay
        where they are; between two calls nothing is presumed.
        """
        self._views.clear()

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
        starts = np.array([self.system.GetNodeODE2Index(node) for node in self._free_nodes()], dtype=np.int64)
        return np.asarray((starts[:, None] + np.arange(3)).ravel())

    def _free_nodes(self) -> list[int]:
        return [n for n, free in zip(self._nodes, self._free, strict=True) if free]

    def _free_coordinates(self) -> NDArray[np.bool_]:
        return np.repeat(self._free, 3)

    def _matrix(self, matrix: csr_array) -> Any:
        matrix = csr_array(matrix)
        matrix.eliminate_zeros()
        container = self._engine.MatrixContainer()
        container.SetWithSparseMatrix(matrix, numberOfRows=matrix.shape[0], numberOfColumns=matrix.shape[1])
        return container

    def assemble(self) -> None:
        """Finish the system; no item can be added afterwards."""
        self.system.Assemble()
        self._keep = np.array(self._free, dtype=bool)
        self._reference_array = np.array(self._reference, dtype=float).reshape(-1, 3)
        starts = [self.system.GetNodeODE2Index(node) for node in self._bodies]
        self._of_bodies = np.array(starts, dtype=np.int64)[:, None] + np.arange(6)
        self._of_points = self.columns()

    def items(self) -> dict[str, int]:
        """How many objects of each kind the engine holds."""
        return dict(self._counts)

    @property
    def all_points_alone(self) -> bool:
        """True if the mass matrix can be inverted body by body: no object has several nodes."""
        return set(self._counts) <= {"MassPoint", "ObjectConnectorSpringDamper", "ObjectRigidBody"}

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
        """Second-order coordinates: of the free points (3 each) and of the bodies (6 each)."""
        return 3 * int(np.count_nonzero(self._free)) + 6 * len(self._bodies)

    @property
    def reference(self) -> Floats:
        """(n_points, 3) [m], of an assembled model."""
        return self._reference_array

    def coordinates(self) -> tuple[Floats, Floats]:
        """Copies of the raw displacement and velocity coordinates, each (n_coordinates,)."""
        data = self.system.systemData
        return np.array(data.GetODE2Coordinates()), np.array(data.GetODE2Coordinates_t())

    def unpack(self, displacement: Floats, velocity: Floats) -> tuple[Floats, Floats]:
        """Raw coordinates (..., n_coordinates) -> position [m], velocity [m/s] of all points, (..., n, 3)."""
        shape = (*displacement.shape[:-1], len(self._nodes), 3)
        position = np.broadcast_to(self._reference_array, shape).copy()
        speed = np.zeros(shape)
        free = (*displacement.shape[:-1], -1, 3)
        position[..., self._keep, :] += displacement[..., self._of_points].reshape(free)
        speed[..., self._keep, :] = velocity[..., self._of_points].reshape(free)
        return position, speed

    def unpack_bodies(self, displacement: Floats, velocity: Floats) -> RigidStates:
        """Raw coordinates (..., n_coordinates) -> states of the bodies."""
        place, speed = displacement[..., self._of_bodies], velocity[..., self._of_bodies]
        attitude = quaternion_of(place[..., 3:])
        return RigidStates(place[..., :3], speed[..., :3], attitude, speed[..., 3:])


def _no_jacobian(container: Any) -> Any:
    def compute(*_: Any) -> Any:
        return container

    return compute
