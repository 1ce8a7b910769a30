"""Folded nets: which topology can be folded how, and the fold."""

from __future__ import annotations

from collections.abc import Iterator
from types import ModuleType

from exunet.base.errors import Fault
from exunet.net import TOPOLOGIES, radial
from exunet.net.accordion import accordion
from exunet.net.arrays import Net
from exunet.net.base import NetTable
from exunet.net.canister import Fold, Folded
from exunet.net.star import star


def folded(net: Net, keys: NetTable, fold: Fold) -> Folded:
    """The net that `weave(keys)` gives, folded into its canister.

    Raises CaseError if it does not fit, with a size that would do.
    """
    if fold.pattern == "star" and isinstance(keys, radial.Keys):
        return star(net, keys, fold)
    return accordion(net, TOPOLOGIES[keys.topology].fold_lines(keys), fold)


def cross_checks(keys: NetTable, fold: Fold) -> Iterator[Fault]:
    """A net of this topology can be folded so."""
    if fold.pattern == "accordion" and keys.topology not in _creased():
        known = ", ".join(_creased())
        reason = f"{keys.topology} nets have no lines to crease them along; {known} nets have"
        yield Fault("pattern", reason)
    if fold.pattern == "star":
        if not isinstance(keys, radial.Keys):
            why = "a star is creased along spokes"
            if keys.topology == "cut":
                why += ", and a border cut from meshes has no knots there to bend at"
            other = '; use "accordion"' if keys.topology in _creased() else ""
            words = f"{why}: it is for radial nets, not for {keys.topology} ones{other}"
            yield Fault("pattern", words)
        elif keys.spokes % 2:
            reason = f"spokes go in and out in turn: an even number of them, not {keys.spokes}"
            yield Fault("pattern", reason)
        elif keys.spokes < 4:
            yield Fault("pattern", "a star has two arms or more, of two spokes each")


def _creased() -> dict[str, ModuleType]:
    """The topologies whose modules have `fold_lines(keys)`: x, and y, of lines that no side crosses."""
    return {name: module for name, module in TOPOLOGIES.items() if hasattr(module, "fold_lines")}
