"""Topologies: one file each, listed here. `net.topology` in the case names one.

A new topology `spiral` is a module with `SpiralNet` (a NetConfig or ThrownNetConfig with
`topology: Literal["spiral"]`) and `mesh(keys) -> Mesh`; and one line in `_NAMES`. With
`fold_lines(keys)` its nets can be folded as an accordion (exunet.net.folding).
"""

from __future__ import annotations

from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING, Annotated, Union

from pydantic import Field

from exunet.base.record import config_of
from exunet.net.arrays import Net
from exunet.net.base import NetConfig
from exunet.net.weave import net_of

# The modules in this folder that are topologies. A new one is a line here.
_NAMES = (
    "square",
    "rectangular",
    "hexagonal",
    "radial",
    "cut",
    "explicit",
)
TOPOLOGIES: dict[str, ModuleType] = {name: import_module(f"{__name__}.{name}") for name in _NAMES}

if TYPE_CHECKING:
    AnyNetConfig = NetConfig
else:
    AnyNetConfig = Annotated[
        Union[tuple(config_of(module, "Net") for module in TOPOLOGIES.values())],  # noqa: UP007 - made from the registry
        Field(discriminator="topology"),
    ]


def weave(keys: NetConfig) -> Net:
    """The net that the [net] table asks for, in its reference configuration.

    Raises CaseError if a node's mass or position is beyond what floating-point numbers can hold.
    """
    topology = TOPOLOGIES[keys.topology]
    return net_of(topology.mesh(keys), keys)
