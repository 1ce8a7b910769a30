"""The explicit topology: nodes and elements as the case lists them; no corners, strings or bullets."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from exunet.base.errors import Fault
from exunet.base.faults import each, shortened
from exunet.base.table import FromArray, NonNegative, Vector
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

    @property
    def n_sides(self) -> int:
        return len(self.elements)


def cross_checks(keys: Keys) -> Iterator[Fault]:
    """Elements join two places, lists fit the nodes, and every node has mass."""
    yield from each(
        shortened(_elements_join_two_places(keys)),
        _one_mass_a_node(keys),
        shortened(_fixed_are_nodes(keys)),
        shortened(_every_node_has_mass(keys)),
    )


# In these lists None stands for an item that is not valid.


def _elements_join_two_places(keys: Keys) -> Iterator[Fault]:
    for k, pair in enumerate(keys.elements):
        if pair is not None and (reason := _unfit(pair, keys.nodes)):
            yield Fault(f"elements[{k}]", reason)


def _one_mass_a_node(keys: Keys) -> Iterator[Fault]:
    if keys.node_masses is not None and (reason := other_length(keys.node_masses, keys.nodes)):
        yield Fault("node_masses", reason)


def _fixed_are_nodes(keys: Keys) -> Iterator[Fault]:
    for k, node in enumerate(keys.fixed or ()):
        if node is not None and not 0 <= node < len(keys.nodes):
            yield Fault(f"fixed[{k}]", no_node(node, len(keys.nodes)))


def _every_node_has_mass(keys: Keys) -> Iterator[Fault]:
    count = len(keys.nodes)
    masses = keys.node_masses or (0.0,) * count
    if None in keys.elements or len(masses) != count:
        return
    joined = {node for pair in keys.elements for node in pair}
    if not joined <= set(range(count)):
        return
    for k in range(count):
        if k not in joined and masses[k] == 0:
            yield Fault(
                f"nodes[{k}]", "this node has no mass: join it to an element or give it one in node_masses"
            )


def _unfit(pair: tuple[int, int], nodes: Sequence[Vector | None]) -> str | None:
    """Why `pair` cannot be an element, if it cannot; None among `nodes` is one that is not valid."""
    for node in pair:
        if not 0 <= node < len(nodes):
            return no_node(node, len(nodes))
    if pair[0] == pair[1]:
        return f"joins node {pair[0]} to itself"
    first, second = nodes[pair[0]], nodes[pair[1]]
    if first is None or second is None:
        return None
    length = math.dist(first, second)
    if not 0 < length < math.inf:
        return f"joins nodes {pair[0]} and {pair[1]}, which are {length:g} m apart: not the length of a cable"
    return None


def mesh(keys: Keys) -> Mesh:
    """The nodes and elements as listed."""
    return Mesh(
        knots=np.array(keys.nodes, dtype=float),
        sides=np.array(keys.elements, dtype=np.int64).reshape(-1, 2),
        node_mass=None if keys.node_masses is None else np.array(keys.node_masses, dtype=float),
        fixed=np.array(keys.fixed or (), dtype=np.int64),
    )
