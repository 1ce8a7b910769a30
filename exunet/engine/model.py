"""The multibody system: a few verbs over Exudyn items, and the state as plain arrays."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from exunet import cable
from exunet.engine.loading import exudyn

Floats = NDArray[np.float64]


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
        self._law: Any = None  # the engine keeps only a borrowed reference to a symbolic function

    def _add_object(self, item: Any, name: str) -> int:
        self._counts[name] += 1
        return int(self.system.AddObject(item))

    def point(self, mass: float, reference: Floats, position: Floats, velocity: Floats) -> int:
        """Add a mass point [kg] with its reference position, initial position [m] and velocity [m/s]."""
        node = self.system.AddNode(
            self._items.NodePoint(
                referenceCoordinates=list(map(float, reference)),
                initialCoordinates=list(map(float, position - reference)),
                initialVelocities=list(map(float, velocity)),
            )
        )
        self._add_object(self._items.MassPoint(mass=float(mass), nodeNumber=node), "MassPoint")
        return self._number(node, reference, free=True)

    def fixed_point(self, position: Floats) -> int:
        """Add a point of the ground [m]."""
        node = self.system.AddNode(
            self._items.NodePointGround(referenceCoordinates=list(map(float, position)))
        )
        return self._number(node, position, free=False)

    def _number(self, node: int, reference: Floats, *, free: bool) -> int:
        self._nodes.append(int(node))
        self._free.append(free)
        self._reference.append(tuple(map(float, reference)))
        marker = self.system.AddMarker(self._items.MarkerNodePosition(nodeNumber=node))
        self._markers.append(int(marker))
        return len(self._nodes) - 1

    def cable_element(self, i: int, j: int, reference_length: float, axial_stiffness: float) -> int:
        """Add a tension-only connector between points i and j: eqs. (3) and (6)-(8).

        The connector's own `stiffness` and `damping` slots carry EA [N] and L0 [m] to the one compiled
        force law that all elements share.
        """
        number = self._add_object(
            self._items.ObjectConnectorSpringDamper(
                markerNumbers=[self._markers[i], self._markers[j]],
                referenceLength=float(reference_length),
                stiffness=float(axial_stiffness),
                damping=float(reference_length),
            ),
            "ObjectConnectorSpringDamper",
        )
        if self._law is None:
            self._law = self._compile_law()
        self.system.SetObjectParameter(number, "springForceUserFunction", self._law)
        return number

    def _compile_law(self) -> Any:
        from exudyn.advancedUtilities import CreateSymbolicUserFunction

        symbolic_maximum = self._engine.symbolic.max

        # The engine compiles this by its exact argument names; `damping` is the slot that holds L0.
        def law(mbs, t, itemNumber, deltaL, deltaL_t, stiffness, damping, force):  # type: ignore[no-untyped-def]
            return cable.tension(deltaL + damping, damping, stiffness, symbolic_maximum)

        return CreateSymbolicUserFunction(
            self.system, law, "springForceUserFunction", itemTypeName="ObjectConnectorSpringDamper"
        )

    def linear_terms(self, damping: csr_array | None, load: Floats | None) -> None:
        """Add one constant object over all points: force = load - damping @ velocity.

        damping : (3n, 3n) [N s/m] or None; load : (3n,) [N] or None; n counts all points, fixed included.
        """
        if damping is None and load is None:
            return
        keep = np.repeat(self._free, 3)
        nodes = [n for n, free in zip(self._nodes, self._free, strict=True) if free]
        arguments: dict[str, Any] = {"nodeNumbers": nodes}
        if damping is not None:
            inner = csr_array(damping[keep][:, keep])
            inner.eliminate_zeros()
            container = self._engine.MatrixContainer()
            container.SetWithSparseMatrix(inner, numberOfRows=inner.shape[0], numberOfColumns=inner.shape[1])
            arguments["dampingMatrix"] = container
        if load is not None:
            arguments["forceVector"] = load[keep].tolist()
        self._add_object(self._items.ObjectGenericODE2(**arguments), "ObjectGenericODE2")

    def assemble(self) -> None:
        """Finish the system; no item can be added afterwards."""
        self.system.Assemble()
        self._keep = np.array(self._free, dtype=bool)
        self._reference_array = np.array(self._reference, dtype=float).reshape(-1, 3)

    def items(self) -> dict[str, int]:
        """How many objects of each kind the engine holds."""
        return dict(self._counts)

    @property
    def all_points_alone(self) -> bool:
        """True if the mass matrix can be inverted body by body (mass points and connectors only)."""
        return set(self._counts) <= {"MassPoint", "ObjectConnectorSpringDamper"}

    @property
    def n_coordinates(self) -> int:
        """Coordinates of the free points."""
        return 3 * int(np.count_nonzero(self._free))

    def coordinates(self) -> tuple[Floats, Floats]:
        """Copies of the raw displacement and velocity coordinates of the free points, each (3 n_free,)."""
        data = self.system.systemData
        return np.array(data.GetODE2Coordinates()), np.array(data.GetODE2Coordinates_t())

    def unpack(self, displacement: Floats, velocity: Floats) -> tuple[Floats, Floats]:
        """Raw coordinates (..., 3 n_free) -> position [m] and velocity [m/s] of all points, (..., n, 3)."""
        shape = (*displacement.shape[:-1], len(self._nodes), 3)
        position = np.broadcast_to(self._reference_array, shape).copy()
        speed = np.zeros(shape)
        free = (*displacement.shape[:-1], -1, 3)
        position[..., self._keep, :] += displacement.reshape(free)
        speed[..., self._keep, :] = velocity.reshape(free)
        return position, speed
