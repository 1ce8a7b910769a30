"""The explicit topology: nodes and elements as the case lists them; no corners, strings or bullets."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from exunet.base.errors import Fault
from exunet.base.record import FromArray, NonNegative, Vector, shortened
from exunet.net.arrays import Mesh
from exunet.net.base import NetConfig, no_node, other_length

Pair = Annotated[tuple[int, int], FromArray]


class ExplicitNetConfig(NetConfig):
    """Any arrangement of nodes and cable elements."""

    topology: Literal["explicit"] = Field(description="listed nodes and elements")
    nodes: Annotated[tuple[Vector, ...], FromArray] = Field(
        min_length=1,
        description="reference positions of the nodes [m]",
        examples=[[[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]],
    )
    elements: Annotated[tuple[Pair, ...], FromArray] = Field(
        description="the two nodes that each element joins, numbered from 0", examples=[[[0, 1]]]
    )
    node_masses: Annotated[tuple[NonNegative, ...], FromArray] | None = Field(
        None, description="mass added to each node [kg]", examples=[[0.0, 0.5]]
    )
    fixed: Annotated[tuple[int, ...], FromArray] | None = Field(
        None, description="numbers of the nodes that are held still", examples=[[0]]
    )

    @property
    def n_sides(self) -> int:
        return len(self.elements)

    def faults(self) -> Iterator[Fault]:
        """Require elements between two places, lists that fit the nodes, and a mass of every node."""
        yield from shortened(self._elements_without_length())
        if self.node_masses is not None and (reason := other_length(self.node_masses, self.nodes)):
            yield Fault("node_masses", reason)
        yield from shortened(
            Fault(f"fixed[{k}]", no_node(node, len(self.nodes)))
            for k, node in enumerate(self.fixed or ())
            if not 0 <= node < len(self.nodes)
        )
        yield from shortened(self._nodes_without_mass())
        yield from super().faults()

    def _elements_without_length(self) -> Iterator[Fault]:
        count = len(self.nodes)
        for k, pair in enumerate(self.elements):
            i, j = pair
            if missing := [node for node in pair if not 0 <= node < count]:
                yield Fault(f"elements[{k}]", no_node(missing[0], count))
            elif i == j:
                yield Fault(f"elements[{k}]", f"joins node {i} to itself")
            elif not 0 < (length := math.dist(self.nodes[i], self.nodes[j])) < math.inf:
                reason = f"joins nodes {i} and {j}, which are {length:g} m apart: not the length of a cable"
                yield Fault(f"elements[{k}]", reason)

    def _nodes_without_mass(self) -> Iterator[Fault]:
        count, joined = len(self.nodes), {node for pair in self.elements for node in pair}
        masses = self.node_masses or (0.0,) * count
        if len(masses) != count or not joined <= set(range(count)):
            return  # reported above
        for k in range(count):
            if k not in joined and masses[k] == 0:
                reason = "this node has no mass: join it to an element or give it a mass in node_masses"
                yield Fault(f"nodes[{k}]", reason)


def mesh(keys: ExplicitNetConfig) -> Mesh:
    """The nodes and elements as listed."""
    return Mesh(
        knots=np.array(keys.nodes, dtype=float),
        sides=np.array(keys.elements, dtype=np.int64).reshape(-1, 2),
        node_mass=None if keys.node_masses is None else np.array(keys.node_masses, dtype=float),
        fixed=np.array(keys.fixed or (), dtype=np.int64),
    )
