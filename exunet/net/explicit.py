"""The explicit topology: nodes and elements as the case lists them; no corners, strings or bullets."""

from __future__ import annotations

import math
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import Field, ValidationInfo, field_validator, model_validator

from exunet.checks import Wrong, refuse
from exunet.net.arrays import Mesh
from exunet.net.base import NetTable, no_node, refuse_other_length
from exunet.record import FromArray, NonNegative, Vector

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

    @field_validator("elements")
    @classmethod
    def _join_two_places(cls, elements: tuple[Pair, ...], others: ValidationInfo) -> tuple[Pair, ...]:
        if "nodes" in others.data:
            nodes = others.data["nodes"]
            reasons = ((k, _unfit(pair, nodes)) for k, pair in enumerate(elements))
            refuse([Wrong((k,), reason, elements[k]) for k, reason in reasons if reason])
        return elements

    @field_validator("node_masses")
    @classmethod
    def _one_a_node(
        cls, masses: tuple[float, ...] | None, others: ValidationInfo
    ) -> tuple[float, ...] | None:
        if masses is not None and "nodes" in others.data:
            refuse_other_length(masses, others.data["nodes"])
        return masses

    @field_validator("fixed")
    @classmethod
    def _are_nodes(cls, fixed: tuple[int, ...] | None, others: ValidationInfo) -> tuple[int, ...] | None:
        if fixed is not None and "nodes" in others.data:
            count = len(others.data["nodes"])
            refuse([Wrong((k,), no_node(i, count), i) for k, i in enumerate(fixed) if not 0 <= i < count])
        return fixed

    @model_validator(mode="after")
    def _every_node_has_mass(self) -> Self:
        joined = {node for pair in self.elements for node in pair}
        added = self.node_masses or (0.0,) * len(self.nodes)
        reason = "this node has no mass: join it to an element or give it one in node_masses"
        massless = [k for k, mass in enumerate(added) if mass == 0 and k not in joined]
        refuse([Wrong(("nodes", k), reason, self.nodes[k]) for k in massless])
        return self

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
