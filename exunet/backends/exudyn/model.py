"""The multibody system: a few verbs over Exudyn items, and the state as plain arrays."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array, diags_array

from exunet.backends.exudyn.coordinates import Coordinates, Places
from exunet.backends.exudyn.loading import exudyn, exudyn_items
from exunet.bodies.body import RigidBody
from exunet.bodies.kinematics import Kinematics
from exunet.bodies.rigid import RigidStates, rotation_vector
from exunet.forces import cable

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Evaluate = Callable[[float, Floats, Floats, Floats], None]
Rates = Callable[[float, Floats, Floats, Floats], Floats]
Jacobian = Callable[[float, Floats, Floats, float, float], csr_array]
_NONE = np.zeros(0)
_NO_NODE = -1  # of a point that has none of its own


class Model:
    """One Exudyn system that is filled by verbs, then assembled.

    A *point* is a mass point with three coordinates, a point of a body or, when fixed, a point of the ground.
    Points are numbered in the order they are added, those without coordinates included.

    system : one that is there already, such as a user's; None: a new one
    """

    def __init__(self, system: Any = None) -> None:
        self._engine, self._items = exudyn(quiet=system is None), exudyn_items()
        self.container = None if system is not None else self._engine.SystemContainer()
        self.system = system if self.container is None else self.container.AddSystem()
        self._counts: Counter[str] = Counter()
        self._nodes: list[int] = []
        self._markers: list[int] = []
        self._free: list[bool] = []
        self._reference: list[Sequence[float]] = []
        self._keep_alive: list[Any] = []  # the engine only borrows the functions it is given
        self._laws: dict[bool, Any] = {}
        self._seen: Coordinates | None = None
        self._connectors: dict[int, tuple[int, float]] = {}  # of elements: number, stiffness [N]
        self._carrying: Floats | None = None
        self._bodies: list[int] = []  # their nodes
        self._body_objects: list[int] = []
        self._n_first_order = 0
        self.applied: Any = None  # the AppliedKernel that pushes the points, if there is one
        self.elements_applied = False  # that kernel has the elements' forces too
        self.watching: Any = None  # an AppliedKernel that pushes nothing, but remembers what touches

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

    def point_of_body(self, body: int, local: Floats, position: Floats) -> int:
        """Add a point of a body, by the number of its object and the place in its frame; position: [m]."""
        marker = self._items.MarkerBodyPosition(bodyNumber=body, localPosition=local.tolist())
        return self._marked(_NO_NODE, marker, position, free=False)

    def _number(self, node: int, reference: Floats, *, free: bool) -> int:
        marker = self._items.MarkerNodePosition(nodeNumber=node)
        return self._marked(int(node), marker, reference, free=free)

    def _marked(self, node: int, marker: Any, reference: Floats, *, free: bool) -> int:
        self._nodes.append(node)
        self._free.append(free)
        self._reference.append(tuple(map(float, reference)))
        self._markers.append(int(self.system.AddMarker(marker)))
        return len(self._nodes) - 1

    def cable_element(
        self,
        element: int,
        i: int,
        j: int,
        natural_length: float,
        stiffness: float,
        relaxation_time: float | None = None,
    ) -> int:
        """Add a tension-only connector, of an element, between points i and j: eqs. (3) and (6)-(8).

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
        self._connectors[element] = number, float(stiffness)
        return number

    def carry(self, carrying: Floats) -> None:
        """Let the connectors of elements carry parts (n_elements,) of their stiffness; 0.0: nothing."""
        before = np.ones(len(carrying)) if self._carrying is None else self._carrying
        for element in np.flatnonzero(carrying != before).tolist():
            if element in self._connectors:  # else a kernel has it
                connector, stiffness = self._connectors[element]
                part = float(carrying[element])
                self.system.SetObjectParameter(connector, "activeConnector", part > 0.0)
                if part > 0.0:
                    self.system.SetObjectParameter(connector, "stiffness", part * stiffness)
        self._carrying = carrying.copy()

    def rigid_body(self, body: RigidBody, state: RigidStates) -> int:
        """Add a body in its principal axes.

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
        self._body_objects.append(self._add_object(item, "ObjectRigidBody"))
        return self._body_objects[-1]

    def sphere_contact(
        self, body: int, place: Floats, radius: float, points: Sequence[int], stiffness: float
    ) -> None:
        """Let a body push points that come nearer than a radius [m], by the engine's own contact.

        body  : its number among the model's; place : of the sphere in its axes, from its centre [m]
        stiffness : force over depth [N/m]; the engine puts those of two spheres in series
        """
        contact = self.system.AddGeneralContact()
        contact.verboseMode = 0
        contact.SetFrictionPairings(np.zeros((1, 1)))
        on_body = self._items.MarkerBodyRigid(
            bodyNumber=self._body_objects[body], localPosition=place.tolist()
        )
        spheres = [(int(self.system.AddMarker(on_body)), radius)]
        spheres += [(self._markers[point], 0.0) for point in points]
        for marker, size in spheres:
            contact.AddSphereWithMarker(
                marker,
                radius=size,
                contactStiffness=2.0 * stiffness,
                contactDamping=0.0,
                frictionMaterialIndex=0,
            )
        self._counts["GeneralContact"] += 1

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
        self,
        evaluate: Evaluate,
        jacobian: Jacobian | None = None,
        mass: Floats | None = None,
        *,
        bodies: bool = False,
    ) -> None:
        """Add forces on all free points, and on bodies, that a function computes at once.

        evaluate : evaluate(t, q, q_t, out) writes the forces [N] on the free coordinates into out
                   (3 n_free,); q, q_t are all the engine's coordinates (displacements, velocities)
        jacobian : jacobian(t, q, q_t, of_position, of_velocity) gives the csr matrix of
                   -(of_position df/dq + of_velocity df/dq_t), (3 n_free, 3 n_free); None: an explicit method
        mass     : (n,) of all points [kg], for points added by `node`
        bodies   : out goes on with the force [N] and the torque in body axes [N m] on each body; with the
                   engine's rotation vectors these are the forces of a body's six coordinates

        Two objects: the first, on one node only, computes the forces and puts them into the second, which
        holds them. The engine evaluates objects in their order (with one thread, which is its default); it
        makes Python lists of the coordinates of an object with a user function, which for all nodes costs
        more than the rest of the evaluation.
        """
        keep, nodes = self._free_coordinates(), self._free_nodes()
        turning = 6 * len(self._bodies) if bodies else 0
        out = np.zeros(len(nodes) * 3 + turning)
        if not len(out):
            return
        if bodies:
            nodes = nodes + self._bodies
        coordinates = self.coordinates_in_call
        nothing = [0.0] * (6 if nodes[0] in self._bodies else 3)
        arguments: dict[str, Any] = {"nodeNumbers": nodes, "forceVector": out.tolist()}
        if mass is not None:
            masses = np.append(np.repeat(mass, 3)[keep], np.zeros(turning))  # bodies bring theirs
            arguments["massMatrix"] = self._matrix(csr_array(diags_array(masses)))
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
        """Add first-order states (n_states,); rates(t, q, q_t, out) gives theirs (see `applied_forces`)."""
        node = self.system.AddNode(
            self._items.NodeGenericODE1(
                referenceCoordinates=[0.0] * len(initial),
                initialCoordinates=initial.tolist(),
                numberOfODE1Coordinates=len(initial),
            )
        )
        data, out = self.system.systemData, np.zeros(self.n_coordinates)

        def compute(_mbs: Any, t: float, _item: int, _q: Any) -> list[float]:
            q, q_t = data.GetODE2Coordinates(copy=False), data.GetODE2Coordinates_t(copy=False)
            return list(rates(t, q, q_t, out).tolist())

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
        starts = np.array([self.system.GetNodeODE2Index(node) for node in self._free_nodes()], dtype=np.int64)
        return np.asarray((starts[:, None] + np.arange(3)).ravel())

    def columns_of_bodies(self) -> Ints:
        """(n_bodies,) where the six coordinates of each body begin there."""
        return np.array([self.system.GetNodeODE2Index(node) for node in self._bodies], dtype=np.int64)

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

    def assemble(self, kinematics: Kinematics | None = None) -> None:
        """Finish the system; no item can be added afterwards. kinematics : of points without coordinates."""
        self.system.Assemble()
        reference = np.array(self._reference, dtype=float).reshape(-1, 3)
        bodies = self.columns_of_bodies()[:, None] + np.arange(6)
        self.places = Places(reference, self.free, self.columns(), bodies, kinematics or Kinematics())

    @property
    def kernels(self) -> tuple[Any, ...]:
        """Its kernels, which push or watch."""
        return tuple(one for one in (self.applied, self.watching) if one is not None)

    def items(self) -> dict[str, int]:
        """How many objects, and contacts, of each kind the engine holds."""
        return dict(self._counts)

    @property
    def nodes(self) -> list[int]:
        """The engine's number of each point's node; -1 for points of bodies."""
        return list(self._nodes)

    @property
    def all_points_alone(self) -> bool:
        """True if the mass matrix can be inverted body by body: no object has several nodes."""
        alone = {"MassPoint", "ObjectConnectorSpringDamper", "ObjectRigidBody", "GeneralContact"}
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
        """Second-order coordinates: of the free points (3 each) and of the bodies (6 each)."""
        return 3 * int(np.count_nonzero(self._free)) + 6 * len(self._bodies)

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
        if seen is None or self._n_first_order:
            seen = self._seen = self.coordinates()
        return seen


def _no_jacobian(container: Any) -> Any:
    def compute(*_: Any) -> Any:
        return container

    return compute
