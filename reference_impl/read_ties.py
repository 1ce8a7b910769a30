"""Reads what ties the net to bodies: `[tethers.NAME]`, and the nodes in attachments of bodies."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from typing import Any

from reference_impl.case import Attachment, BodyPoint, Case, NetNode, Tether
from reference_impl.read_reels import read_reel, reel_faults
from reference_impl.shape import Explicit, bullets_of
from reference_impl.table import Table, count, number, numbers, refusal, text


def read_attachments(table: Table, body: str) -> list[Attachment]:
    """Reads and closes the table `attachments` of a body; faulty ones are left out."""
    made = []
    for name in table.values:
        inner = table.table(name, required=False)
        point, node = inner.need("point", numbers(3)), net_node(inner, ("node", "bullet"))
        inner.close()
        if node is not None and point is not None:
            made.append(Attachment(node, BodyPoint(body, point)))
    table.close()
    return made


def read_tethers(table: Table, section: Callable[[Table], Any]) -> tuple[Tether, ...]:
    """Reads and closes the table `[tethers]`; `section` reads the keys of a cable."""
    made = []
    for name in table.values:
        inner = table.table(name, required=False)
        cable = section(inner)
        length, divisions = inner.need("length", number(above=0.0)), inner.get("divisions", count(1), 1)
        start, end = _end(inner.table("start", required=bool(inner))), _end(inner.table("end"))
        before = len(table.faults)
        reel = read_reel(inner.table("reel", required=False), length, divisions)
        inner.close()
        if None not in (cable, length, divisions, start, end) and len(table.faults) == before:
            made.append(Tether(name, cable, length, divisions, start, end, reel))
    table.close()
    return tuple(made)


def _end(table: Table) -> Any:
    """A node of the net or a point of a body; None with faults noted where it cannot be read."""
    end: NetNode | BodyPoint | None = None
    if table:
        if "body" in table.values:
            body, point = table.need("body", text), table.get("point", numbers(3), (0.0, 0.0, 0.0))
            end = None if body is None or point is None else BodyPoint(body, point)
            for key in ("node", "bullet"):
                if key in table.values:
                    table.seen.add(key)
                    table.faults.append(
                        f"{table.path}: give one of node, bullet and body, not {key} beside body"
                    )
        else:
            end = net_node(table, ("node", "bullet", "body"))
            if "point" in table.values:
                table.seen.add("point")
                table.faults.append(f"{table.name('point')}: only with {table.name('body')}")
    table.close()
    return end


def net_node(table: Table, choice: tuple[str, ...]) -> NetNode | None:
    """The one of `node` and `bullet` that is given; None with faults noted where it cannot be read."""
    if not table:
        return None
    given = [key for key in ("node", "bullet") if key in table.values]
    values = [table.get(key, count(0), None) for key in given]
    if len(given) != 1:
        table.faults.append(f"{table.path}: give exactly one of {' and '.join(map(table.name, choice))}")
        return None
    return None if values[0] is None else NetNode(given[0], values[0])


def tie_faults(case: Case, bullets: bool) -> list[str]:
    """Faults between ties and the rest of a case.  `bullets`: whether it has the table `[net.bullets]`."""
    faults: list[str] = []
    taken: Counter[NetNode] = Counter(a.node for a in case.attachments)
    for attachment in case.attachments:
        path = f"bodies.{attachment.place.body}.attachments"
        faults += missing(case, bullets, attachment.node, path)
        fixed = isinstance(case.shape, Explicit) and attachment.node.number in (case.shape.fixed or ())
        if fixed and attachment.node.kind == "node":
            faults.append(f"{path}: node {attachment.node.number} is one of net.fixed")
    for node, times in taken.items():
        if times > 1:
            faults.append(f"bodies: {node.kind} {node.number} is attached {times} times, it must be once")
    names = {body.name for body in case.bodies}
    for tether in case.tethers:
        for key, end in (("start", tether.start), ("end", tether.end)):
            path = f"tethers.{tether.name}.{key}"
            if isinstance(end, NetNode):
                faults += missing(case, bullets, end, path)
            elif end.body not in names:
                faults.append(f"{path}.body: there is no body {end.body}")
        if _what(tether.start) == _what(tether.end):
            faults.append(f"tethers.{tether.name}: start and end must not both be tied to the same")
    return faults + reel_faults(case)


def _what(end: NetNode | BodyPoint) -> NetNode | str:
    return end.body if isinstance(end, BodyPoint) else end


def missing(case: Case, bullets: bool, node: NetNode, path: str) -> list[str]:
    """Why there is no such node in the net; nothing if there is, or if the net itself is faulty."""
    if case.shape is None or (isinstance(case.shape, Explicit) and case.shape.nodes is None):
        return []
    if isinstance(case.shape, Explicit):
        known = len(case.shape.nodes) if node.kind == "node" else 0
    elif node.kind == "bullet":
        known = bullets_of(case.shape) if bullets else 0
    else:
        known = bullets_of(case.shape) if case.strings is not None and not bullets else 0
        if node.number >= known:
            why = "of a woven net it knows bullets, and nodes that are free ends of strings without bullets"
            return [refusal(f"{path}.node = {node.number}", why)]
    if node.number < known:
        return []
    there = f"they go from 0 to {known - 1}" if known else "this net has none"
    return [f"{path}.{node.kind}: there is no {node.kind} {node.number}, {there}"]
