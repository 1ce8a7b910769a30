"""Exudyn model: points, bodies and connectors, forces that functions compute, the state as plain arrays."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from exunet.base.arrays import Floats, Ints
from exunet.bodies.kinematics import Kinematics
from exunet.bodies.rigid import RigidBody, RigidStates
from exunet.bodies.rotations import quaternion_of, rotation_vector
from exunet.integrators.exudyn.engine import compiled_law, exudyn, exudyn_items
from exunet.model.system import DiscreteStates, Layout, Moving


class Coordinates(NamedTuple):
    """Displacements and rotation vectors q, their velocities v, first-order states y; (..., n) each."""

    q: Floats
    v: Floats
    y: Floats


class Places(NamedTuple):
    """Where the blocks stand in the engine's second-order coordinates.

    reference : (n_points, 3) places of the points without displacement [m]
    free      : (n_points,) False for fixed points, which have no coordinates
    points    : (3 n_free,) coordinates of the free points
    bodies    : (n_free_bodies, 6) of the free bodies, whose rotation vector is their attitude
    kinematics : what of the system has no coordinates
    plain     : there are points alone, all free and in their order
    """

    reference: Floats
    free: NDArray[np.bool_]
    points: Ints
    bodies: Ints
    kinematics: Kinematics
    plain: bool

    def unpack(self, now: Coordinates, time: float | Floats, discrete: DiscreteStates) -> Moving:
        """Return the state of the engine's coordinates at times (...) [s], at these discrete states."""
        return self.of_coordinates(now).completed(self.kinematics, time, discrete)

    def flat(
        self, now: Coordinates, time: float | Floats, discrete: DiscreteStates, layout: Layout
    ) -> tuple[Floats, Floats]:
        """The same as x and v, see `exunet.forces.blocks`; copies."""
        if self.plain and not now.y.shape[-1]:  # a step at a time, unpacking would take long
            return self.reference.ravel() + now.q, now.v.copy()
        return layout.pack(self.unpack(now, time, discrete))

    def of_coordinates(self, now: Coordinates) -> Moving:
        """Return the states of the coordinates; points without stay at rest where they began."""
        shape = (*now.q.shape[:-1], *self.reference.shape)
        position = np.broadcast_to(self.reference, shape).copy()
        speed = np.zeros(shape)
        free = (*now.q.shape[:-1], -1, 3)
        position[..., self.free, :] += now.q[..., self.points].reshape(free)
        speed[..., self.free, :] = now.v[..., self.points].reshape(free)
        place, turning = now.q[..., self.bodies], now.v[..., self.bodies]
        attitude = quaternion_of(place[..., 3:])
        bodies = RigidStates(place[..., :3], turning[..., :3], attitude, turning[..., 3:])
        return Moving(position, speed, bodies, now.y)

    def pack(self, moving: Moving, like: Coordinates) -> Coordinates:
        """The engine's coordinates; where a place or an attitude is that of `like`, so is its coordinate."""
        q, v = like.q.copy(), like.v.copy()
        before = self.of_coordinates(like)
        bodies = RigidStates(*(part[: len(self.bodies)] for part in moving.bodies.parts()))
        moved = (moving.position != before.position)[self.free].ravel()
        q[self.points[moved]] = (moving.position - self.reference)[self.free].ravel()[moved]
        v[self.points] = moving.velocity[self.free].ravel()
        turned = (bodies.attitude != before.bodies.attitude).any(axis=1)
        q[self.bodies[:, :3]] = bodies.position
        q[self.bodies[turned, 3:]] = rotation_vector(bodies.attitude[turned])
        v[self.bodies] = np.concatenate([bodies.velocity, bodies.angular_velocity], axis=1)
        return Coordinates(q, v, np.array(moving.first_order))


_NO_NODE = -1  # of a point that has none of its own


class Items:
    """The items of one Exudyn system, which is filled by verbs.

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
        self._laws: dict[tuple[bool, bool], Any] = {}
        self._connectors: dict[int, tuple[int, float]] = {}  # of elements: number, stiffness [N]
        self._carrying: Floats | None = None
        self._bodies: list[int] = []  # their nodes

    def _add_object(self, item: Any, name: str) -> int:
        self._counts[name] += 1
        return int(self.system.AddObject(item))

    def point(self, mass: float, reference: Floats, position: Floats, velocity: Floats) -> int:
        """Add a mass point [kg] with its reference position, initial position [m] and velocity [m/s]."""
        node = self.system.AddNode(
            self._items.NodePoint(
                referenceCoordinates=reference.tolist(),
                initialCoordinates=(position - reference).tolist(),
                initialVelocities=velocity.tolist(),
            )
        )
        number = self._number(node, reference, free=True)
        self._add_object(self._items.MassPoint(mass=float(mass), nodeNumber=int(node)), "MassPoint")
        return number

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
        law: int = 0,
    ) -> int:
        """Add a tension-only connector, of an element, between points i and j, of law 0 or 1.

        The connector's `stiffness`, `damping` and `force` slots carry stiffness [N], length [m] and
        relaxation time [s] to the compiled force law that all elements of one law share.
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
            number, "springForceUserFunction", self._law(relaxation_time is not None, law == 1)
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
        return self._add_object(item, "ObjectRigidBody")

    def _law(self, viscous: bool, hooke: bool) -> Any:
        if (viscous, hooke) not in self._laws:
            self._laws[viscous, hooke] = compiled_law(self.system, viscous=viscous, hooke=hooke)
        return self._laws[viscous, hooke]

    def _free_nodes(self) -> list[int]:
        return list(dict.fromkeys(n for n, free in zip(self._nodes, self._free, strict=True) if free))

    def _free_coordinates(self) -> NDArray[np.bool_]:
        return np.repeat(self._free, 3)


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
        self.applied: Any = None  # the AppliedKernel that acts on the points, if there is one

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

    def refresh(self) -> None:
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
        kinematics, columns = kinematics or Kinematics(), self.columns()
        plain = np.array_equal(columns, np.arange(3 * len(reference))) and not (kinematics or len(bodies))
        self.places = Places(reference, self.free, columns, bodies, kinematics, plain and not self._n_ballast)

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
        return Coordinates(q, v, data.GetODE1Coordinates(copy=False) if self._n_first_order else _NONE)

    def coordinates_in_call(self) -> Coordinates:
        """The same between `refresh` and the end of the engine's next call."""
        seen = self._seen
        if seen is None:
            seen = self._seen = self.coordinates()
        return seen


def _no_jacobian(container: Any) -> Any:
    def compute(*_: Any) -> Any:
        return container

    return compute
