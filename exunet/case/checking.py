"""From a TOML document to a Scene: each key by itself, then the keys with each other, all faults at once."""

from __future__ import annotations

from typing import Any, TypeVar

from pydantic import ValidationError

from exunet.base.errors import KeyPath
from exunet.base.faults import each, exactly_one, within
from exunet.base.table import Table
from exunet.base.valid_part import valid_part
from exunet.case.cross_checks import cross_checks
from exunet.case.fault_messages import explain, without_topology
from exunet.case.scene import Scene
from exunet.net import common_keys
from exunet.net import cross_checks as net_checks
from exunet.net.base import AnyNet

AnyTable = TypeVar("AnyTable", bound=Table)


def checked(document: dict[str, Any]) -> tuple[Scene | None, list[tuple[tuple[KeyPath, ...], str]]]:
    """The scene, None if a key of it is not valid, and every fault: paths of its keys, reason."""
    scene, errors = _each_key(Scene, document)
    faults = list(cross_checks(scene))
    if any(error["type"].startswith("union_tag") for error in errors):
        net, more = _each_key(AnyNet, common_keys(document["net"]))
        errors += [error | {"loc": ("net", *error["loc"])} for error in more]
        faults += within("net", each(exactly_one(net), net_checks(net)))
    explained = (explain(error, document) for error in errors)
    found: list[tuple[tuple[KeyPath, ...], str]] = [((path,), reason) for path, reason in explained]
    found += [(fault.paths, fault.reason) for fault in faults]
    return None if errors else scene, found


def _each_key(model: type[AnyTable], keys: dict[str, Any]) -> tuple[AnyTable, list[Any]]:
    """The record of `keys`, or its valid part and what pydantic found wrong with the rest."""
    try:
        return model.model_validate(keys), []
    except ValidationError as error:
        errors: list[Any] = [one for one in error.errors(include_url=False) if not _only_by_items(one)]
        return valid_part(model, keys, [without_topology(one["loc"]) for one in errors]), errors


def _only_by_items(error: Any) -> bool:
    """True for a list that is too short only because pydantic does not count the items that are not valid."""
    return error["type"] == "too_short" and len(error["input"]) >= error["ctx"]["min_length"]
