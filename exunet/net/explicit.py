"""The explicit topology: nodes and elements as the case lists them; no corners, strings or bullets."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import suppress
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from exunet.base.faults import Wrong
from exunet.base.incomplete import Unknown
from exunet.base.table import FromArray, NonNegative, Vector, check
from exunet.net.arrays import Mesh
from exunet.net.base import NetTable, no_node, other_length

Pair = Annotated[tuple[int, int], FromArray]


class Keys(NetTable):
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

    @check
    def _elements_join_two_places(self) -> Iterator[Wrong]:
        for k in range(len(self.elements)):
            with suppress(Unknown):
                if reason := _unfit(self.elements[k], self.nodes):
                    yield Wrong(("elements", k), reason, self.elements[k])

    @check
    def _one_mass_a_node(self) -> Iterator[Wrong]:
        if self.node_masses is not None and (reason := other_length(self.node_masses, self.nodes)):
            yield Wrong(("node_masses",), reason)

    @check
    def _fixed_are_nodes(self) -> Iterator[Wrong]:
        fixed, count = self.fixed or (), len(self.nodes)
        for k in range(len(fixed)):
            with suppress(Unknown):
                if not 0 <= fixed[k] < count:
                    yield Wrong(("fixed", k), no_node(fixed[k], count), fixed[k])

    @check
    def _every_node_has_mass(self) -> Iterator[Wrong]:
        joined, count = {node for pair in self.elements for node in pair}, len(self.nodes)
        masses = self.node_masses or (0.0,) * count
        if len(masses) != count or not joined <= set(range(count)):
            return  # told above
        for k in range(count):
            with suppress(Unknown):
                if k not in joined and masses[k] == 0:
                    reason = "this node has no mass: join it to an element or give it one in node_masses"
                    yield Wrong(("nodes", k), reason)

    @property
    def n_sides(self) -> int:
        return len(self.elements)


def _unfit(pair: tuple[int, int], nodes: tuple[Vector, ...]) -> str | None:
    """Why `pair` cannot be an element, if it cannot."""
    for node in pair:
        if not 0 <= node < len(nodes):
            return no_node(node, len(nodes))
    if pair[0] == pair[1]:
        return f"joins node {pair[0]} to itself"
    length = math.dist(nodes[pair[0]], nodes[pair[1]])
    if not 0 < length < math.inf:
        return f"joins nodes {pair[0]} and {pair[1]}, which are {length:g} m apart: no length for a cable"
    return None


def mesh(keys: Keys) -> Mesh:
    """The nodes and elements as listed."""
    return Mesh(
        knots=np.array(keys.nodes, dtype=float),
        sides=np.array(keys.elements, dtype=np.int64).reshape(-1, 2),
        node_mass=None if keys.node_masses is None else np.array(keys.node_masses, dtype=float),
        fixed=np.array(keys.fixed or (), dtype=np.int64),
    )
