"""Reads `[closing]`: a line through rings at the mouth of the net, or threads of its edge that shrink."""

from __future__ import annotations

from itertools import pairwise

from reference_impl.case import Case, ClosingLine, ClosingPerimeter, NetNode, Winch
from reference_impl.read_reels import read_drive, which_end
from reference_impl.read_ties import missing, net_node
from reference_impl.shape import Explicit
from reference_impl.table import Table, counts, number, one_of_names, refusal, text

NAME = "closing"  # in results; no body or tether has it


def read_closing(table: Table) -> ClosingLine | ClosingPerimeter | None:
    """Reads and closes the table; None where it is absent, or with faults noted."""
    if not table:
        return None
    before = len(table.faults)
    kind = table.need("kind", one_of_names("line", "perimeter"))
    made: ClosingLine | ClosingPerimeter | None = None
    if kind is None:
        table.ignore_rest()
    else:
        made = _line(table) if kind == "line" else _perimeter(table)
    table.close()
    return made if len(table.faults) == before else None


def _perimeter(table: Table) -> ClosingPerimeter:
    part = table.need("part", number(above=0.0))
    if part is not None and part >= 1.0:
        table.faults.append(f"{table.name('part')}: must be less than 1, not {part:g}")
    return ClosingPerimeter(table.need("at", number(0.0)), table.need("rate", number(above=0.0)), part)


def _line(table: Table) -> ClosingLine:
    rings, ends = _rings(table), _ends(table)
    length, stiffness = table.need("length", number(above=0.0)), table.need("stiffness", number(above=0.0))
    density = table.need("linear_density", number(0.0))
    diameter = table.need("ring_diameter", number(above=0.0))
    if friction := table.need("friction", number(0.0, maximum=2.0)):
        what, why = f"{table.name('friction')} = {friction:g}", "its line slides without friction, which is 0"
        table.faults.append(refusal(what, why))
    table.get("strength", number(above=0.0), None)  # nothing depends on it here
    winch = _winch(table.table("winch", required=False), length)
    return ClosingLine(rings, ends, length, stiffness, density, diameter, winch)


def _rings(table: Table) -> str | tuple[NetNode, ...]:
    """Where the rings are; faults are noted."""
    rings = table.get("rings", one_of_names("edge", "corners"), None)
    nodes = table.get("nodes", counts, None)
    if ("rings" in table.values) == ("nodes" in table.values):
        names = f"{table.name('rings')} and {table.name('nodes')}"
        table.faults.append(f"{table.path}: give exactly one of {names}")
    if nodes is None:
        return rings or ()
    loop, path = "start" not in table.values and "end" not in table.values, table.name("nodes")
    if len(nodes) < (2 if loop else 1):
        table.faults.append(f"{path}: {'a loop has two rings or more' if loop else 'has no ring'}")
    elif any(one == other for one, other in pairwise((*nodes, nodes[0]) if loop else nodes)):
        table.faults.append(f"{path}: a node stands twice in a row")
    return tuple(NetNode("node", number) for number in nodes)


def _ends(table: Table) -> tuple[NetNode | str, NetNode | str] | None:
    """The ends of an open line."""
    given = [key in table.values for key in ("start", "end")]
    if any(given) and not all(given):
        table.faults.append(f"{table.path}: give both of {table.path}.start and {table.path}.end, or neither")
    found = []
    for key in ("start", "end"):
        inner = table.table(key, required=False)
        found.append(_end(inner))
        inner.close()
    return None if found[0] is None or found[1] is None else (found[0], found[1])


def _end(table: Table) -> NetNode | str | None:
    """A node of the net, or the name of a tether; None with faults noted where it cannot be read."""
    if "tether" not in table.values:
        return net_node(table, ("node", "bullet", "tether"))
    for key in ("node", "bullet"):
        if key in table.values:
            table.seen.add(key)
            table.faults.append(f"{table.path}: give one of node, bullet and tether, not {key} beside tether")
    return table.need("tether", text)


def _winch(table: Table, length: float | None) -> Winch | None:
    if not table:
        return None
    table.get("at", which_end, "start")  # without friction either end is the same
    shortest = table.need("shortest", number(above=0.0))
    if shortest is not None and length is not None and shortest >= length:
        table.faults.append(f"{table.name('shortest')}: must be below the length of the line, {length:g} m")
    drive = read_drive(table)
    table.close()
    return Winch(shortest, *drive)


def closing_faults(case: Case, bullets: bool) -> list[str]:
    """Faults between what closes the mouth and the rest of a case."""
    closing, faults = case.closing, []
    if closing is None:
        return []
    for kind, names in (
        ("bodies", [body.name for body in case.bodies]),
        ("tethers", [t.name for t in case.tethers]),
    ):
        faults += [
            f"{kind}.{name}: in results this is the name of what closes the mouth; choose another"
            for name in names
            if name.lower() == NAME
        ]
    if isinstance(closing, ClosingLine):
        nodes = () if isinstance(closing.rings, str) else closing.rings
        for key, node in [("nodes", node) for node in nodes]:
            faults += missing(case, bullets, node, f"{NAME}.{key}")
        tethers = {tether.name for tether in case.tethers}
        for key, end in zip(("start", "end"), closing.ends or (), strict=False):
            if isinstance(end, NetNode):
                faults += missing(case, bullets, end, f"{NAME}.{key}")
            elif end not in tethers:
                faults.append(f"{NAME}.{key}.tether: there is no tether {end}")
        if isinstance(case.shape, Explicit) and isinstance(closing.rings, str):
            faults.append(
                f"{NAME}.rings: an explicit net has neither edge nor corners; list {NAME}.nodes instead"
            )
        return faults
    if isinstance(case.shape, Explicit):
        faults.append(f'{NAME}.kind = "perimeter": an explicit net has no edge; take a line through nodes')
    against = {
        "effects.breaking": case.effects.breaking is not None,
        "effects.bending": case.effects.bending is not None,
        "effects.rayleigh_damping.beta": bool(case.effects.beta),
    }
    return faults + [
        f"{NAME} and {key} contradict each other: leave one out" for key in against if against[key]
    ]
