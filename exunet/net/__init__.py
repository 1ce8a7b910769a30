"""Topologies: one file each, listed here. `net.topology` in the case names one.

A new topology is a module with `Keys` (a NetTable or ThrownNetTable with `topology: Literal["its name"]`) and
`mesh(keys) -> Mesh`, and one line in `TOPOLOGIES`.
"""

from __future__ import annotations

from types import ModuleType
from typing import TYPE_CHECKING, Annotated, Union

from pydantic import Field

from exunet.net import explicit, hexagonal, radial, rectangular, square
from exunet.net.arrays import Net
from exunet.net.base import NetTable
from exunet.net.weave import assemble

TOPOLOGIES: dict[str, ModuleType] = {
    "square": square,
    "rectangular": rectangular,
    "hexagonal": hexagonal,
    "radial": radial,
    "explicit": explicit,
}

if TYPE_CHECKING:
    NetKeys = NetTable
else:
    NetKeys = Annotated[
        Union[tuple(module.Keys for module in TOPOLOGIES.values())],  # noqa: UP007 - made from the registry
        Field(discriminator="topology"),
    ]


def weave(keys: NetTable) -> Net:
    """The net that the [net] table asks for, in its reference configuration.

    Raises CaseError if a node's mass or position is beyond what floating-point numbers can hold.
    """
    topology = TOPOLOGIES[keys.topology]
    return assemble(topology.mesh(keys), keys)
