"""What a model is made of: points, bodies, connectors and contacts of the engine, by a few verbs."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from exunet.backends.exudyn.cable_law import compiled_law
from exunet.backends.exudyn.loading import exudyn, exudyn_items
from exunet.bodies.rigid import RigidBody, RigidStates
from exunet.bodies.rotations import rotation_vector

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
_NO_NODE = -1  # of a point that has none of its own
_NO_MARKER = -1


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
        self._laws: dict[bool, Any] = {}
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
        return self._add_object(item, "ObjectRigidBody")

    def _law(self, *, viscous: bool) -> Any:
        if viscous not in self._laws:
            self._laws[viscous] = compiled_law(self.system, viscous=viscous)
        return self._laws[viscous]

    def _free_nodes(self) -> list[int]:
        return list(dict.fromkeys(n for n, free in zip(self._nodes, self._free, strict=True) if free))

    def _free_coordinates(self) -> NDArray[np.bool_]:
        return np.repeat(self._free, 3)
