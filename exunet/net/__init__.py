"""Topologies: one file each, listed here. `net.topology` in the case names one.

A new topology is a module with `Keys` (a NetTable or ThrownNetTable with `topology: Literal["its name"]`) and
`mesh(keys) -> Mesh`, and one line in `TOPOLOGIES`.
"""

from __future__ import annotations

from types import ModuleType
from typing import TYPE_CHECKING, Annotated, Any, Union

from pydantic import Field, ValidationError

from exunet.net import explicit, hexagonal, radial, rectangular, square
from exunet.net.arrays import Net
from exunet.net.base import AnyNet, NetTable
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


def common_faults(keys: dict[str, Any]) -> ValidationError | None:
    """The faults of a [net] table without a valid topology: of the keys that all have, and unknown keys."""
    every = {name for module in TOPOLOGIES.values() for name in module.Keys.model_fields}
    known = {name: value for name, value in keys.items() if name not in every or name in AnyNet.model_fields}
    try:
        AnyNet.model_validate({name: value for name, value in known.items() if name != "topology"})
    except ValidationError as error:
        return error
    return None
