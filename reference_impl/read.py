"""Reads a case file, format 1 (`cases/README.md`), into frozen dataclasses.

Strict: whatever this reader does not know is refused by name, because a case that is half understood would
be a comparison of two different scenes.  All faults of a file are collected before it is refused.
SI units throughout: m, kg, s, Pa, N, rad.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

from reference_impl.effects import Effects, Vector, read_effects
from reference_impl.table import Table, count, number, numbers, refusal, text, triples

LARGEST_COUNT = 10_000_000  # of cells, elements or stored times; beyond it a slip of the pen is likelier


class Refused(ValueError):
    """A case that this program does not run; `faults` holds one line for each reason."""

    def __init__(self, faults: Sequence[str]) -> None:
        super().__init__("\n".join(faults))
        self.faults = tuple(faults)


@dataclass(frozen=True)
class Cable:
    """What an element is made of: undeformed area [m2], density [kg/m3], Young's modulus [Pa]."""

    area: float
    density: float
    youngs_modulus: float


@dataclass(frozen=True)
class Strings:
    """The strings between bullets and net: cable, reference length of each [m], elements on each."""

    cable: Cable
    length: float
    divisions: int


@dataclass(frozen=True)
class Rectangular:
    """Grid of `cells` = (nx, ny) meshes on a rectangle of `size` = (Lx, Ly) [m]; a square net is one too."""

    size: tuple[float, float]
    cells: tuple[int, int]


@dataclass(frozen=True)
class Hexagonal:
    """Honeycomb: side of a cell [m], rings of cells around the middle one."""

    mesh: float
    rings: int


@dataclass(frozen=True)
class Radial:
    """Spider's web: radius [m], spokes, rings."""

    radius: float
    spokes: int
    rings: int


@dataclass(frozen=True)
class Explicit:
    """A net listed node by node: positions [m], element ends, extra masses [kg], nodes held still."""

    nodes: tuple[Vector, ...]
    elements: tuple[tuple[int, int], ...]
    node_masses: tuple[float, ...]
    fixed: tuple[int, ...]


@dataclass(frozen=True)
class Start:
    """Packing factor [-], velocity [m/s] and spin [rad/s] of all nodes, lists for explicit nets."""

    packing: float
    velocity: Vector
    spin: Vector
    node_positions: tuple[Vector, ...] | None
    node_velocities: tuple[Vector, ...] | None


@dataclass(frozen=True)
class Case:
    """One scene.  Absent bullets, strings, launch are None."""

    title: str
    times: tuple[float, ...]  # stored times [s], from 0 to the end
    shape: Rectangular | Hexagonal | Radial | Explicit
    divisions: int
    cable: Cable
    strings: Strings | None
    bullet_mass: float | None
    start: Start
    launch: tuple[float, float] | None  # radial and axial speed [m/s]
    effects: Effects
    source: str = ""  # the file's text, for the record


def read(path: str | Path, overrides: Mapping[str, Any] | None = None) -> Case:
    """Reads the case file at `path`; `overrides`: dotted keys and their new values, None to drop a key."""
    try:
        source = Path(path).read_bytes().decode("utf-8")
        document = tomllib.loads(source)
    except OSError as error:
        raise Refused([f"{path}: {error.strerror or error}"]) from error
    except UnicodeDecodeError as error:
        raise Refused([f"{path}: not a text in UTF-8"]) from error
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        raise Refused([f"{path}: not TOML: {error}"]) from error
    return replace(read_document(document, overrides), source=source)


def parse_override(text: str) -> tuple[str, Any]:
    """`key.path=value` as typed on a command line; the value is TOML if it parses, else a plain string.

    An empty value is None, which removes the key.
    """
    key, equals, value = text.partition("=")
    if not equals or not key.strip():
        raise Refused([f"--set {text}: expected key.path=value"])
    if not value.strip():
        return key.strip(), None
    try:
        return key.strip(), tomllib.loads(f"value = {value}")["value"]
    except (tomllib.TOMLDecodeError, RecursionError):
        return key.strip(), value


def read_document(document: Mapping[str, Any], overrides: Mapping[str, Any] | None = None) -> Case:
    """The case in an already parsed TOML document, with `overrides` put in."""
    faults: list[str] = []
    root = Table(_overridden(document, overrides or {}, faults), "", faults)
    if (version := root.need("format", count(0))) not in (1, None):
        faults.append(refusal("format", f"version {version}; it reads version 1"))
    title = root.need("title", text) or ""
    for ignored in ("solver", "engine"):  # how another program integrates
        root.table(ignored, required=False)
    times = _times(root.table("time"))
    net = root.table("net")
    shape = _shape(net)
    divisions = net.get("divisions", count(1), 1)
    cable = _cable(net.table("cable"))
    strings = _strings(net.table("strings", required=False))
    bullets = net.table("bullets", required=False)
    bullet_mass = bullets.need("mass", number(above=0.0)) if bullets else None
    start = _start(root.table("initial"))
    launch_table = root.table("launch", required=False)
    launch = _launch(launch_table)
    effects = read_effects(root.table("effects", required=False))
    for table in (root, net, bullets, launch_table):
        table.close()
    if faults:
        raise Refused(faults)
    case = Case(
        title,
        times,
        shape,
        divisions,
        cable,
        strings,
        bullet_mass,
        start,
        launch,
        effects,
    )
    if misfits := _misfits(case):
        raise Refused(misfits)
    return case


def _launch(table: Table) -> tuple[float, float] | None:
    """Radial and axial speed [m/s]; None where the table is absent, or gives the throw in another way."""
    if others := [table.name(key) for key in ("speed", "spread_angle") if key in table.values]:
        table.ignore_rest()
        table.faults.append(refusal(" and ".join(others), "it reads launch.radial_speed and .axial_speed"))
        return None
    speeds = table.need("radial_speed", number()), table.need("axial_speed", number())
    return speeds if table else None


def _overridden(
    document: Mapping[str, Any], overrides: Mapping[str, Any], faults: list[str]
) -> dict[str, Any]:
    """A copy of `document` in which each dotted key of `overrides` has its new value."""
    result = dict(document)
    for path, value in overrides.items():
        *parents, last = path.split(".")
        table = result
        for name in parents:
            inner = table.get(name, {})
            if not isinstance(inner, dict):
                faults.append(f"{path}: cannot be set, because {name} is not a table")
                break
            table[name] = table = dict(inner)
        else:
            table[last] = value
            if value is None:
                del table[last]
    return result


def _times(table: Table) -> tuple[float, ...]:
    """Stored times [s]: k * output_step and the end, or the listed ones with 0 and the end."""
    end = table.need("end", number(above=0.0))
    step = table.get("output_step", number(above=0.0), None)
    listed = table.get("output_times", numbers(None, minimum=0.0), None)
    given = [key for key in ("output_step", "output_times") if key in table.seen]
    table.close()
    if len(given) != 1:
        table.faults.append("time: give exactly one of time.output_step and time.output_times")
        return ()
    if end is None or (step is None and listed is None):
        return ()
    if listed is not None:
        if any(b <= a for a, b in pairwise(listed)) or any(t > end for t in listed):
            table.faults.append("time.output_times: must increase strictly and stay within [0, time.end]")
        return tuple(sorted({0.0, *listed, end}))
    if end / step > LARGEST_COUNT:
        table.faults.append(f"time.output_step: more than {LARGEST_COUNT} stored times")
        return ()
    whole = math.ceil(end / step * (1.0 - 1e-12)) if end > step else 1
    return (*(k * step for k in range(whole) if k * step < end), end)


def _cable(table: Table) -> Any:
    """Reads and closes a table of `net.cable`'s kind."""
    cable = _section(table)
    table.close()
    return cable


def _section(table: Table) -> Any:
    """Area (from diameter or area), density and modulus of a cable; None where the table is absent."""
    if not table:
        return None
    diameter = table.get("diameter", number(above=0.0), None)
    area = table.get("area", number(above=0.0), None)
    if ("diameter" in table.seen) == ("area" in table.seen):
        table.faults.append(f"{table.path}: give exactly one of {table.path}.diameter and {table.path}.area")
    if diameter is not None:
        area = math.pi / 4.0 * diameter**2
    density = table.need("density", number(above=0.0))
    return Cable(area, density, table.need("youngs_modulus", number(above=0.0)))


def _strings(table: Table) -> Strings | None:
    """The strings, None where there are none."""
    if not table:
        table.close()
        return None
    cable = _section(table)
    strings = Strings(cable, table.need("length", number(above=0.0)), table.get("divisions", count(1), 1))
    table.close()
    return strings


def _shape(net: Table) -> Any:
    """The topology with its keys; None with faults noted where it cannot be read."""
    shapes: dict[str, Callable[[Table], Any]] = {
        "square": _square,
        "rectangular": _rectangular,
        "hexagonal": _hexagonal,
        "radial": _radial,
        "explicit": _explicit,
    }
    topology = net.need("topology", text)
    if topology is None:
        net.ignore_rest()
        return None
    if topology not in shapes:
        net.faults.append(refusal(f'net.topology = "{topology}"', "it knows " + ", ".join(shapes)))
        net.ignore_rest()
        return None
    return shapes[topology](net)


def _cells(size: float | None, mesh: float | None, faults: list[str]) -> int:
    """How many meshes fit on a side: must be a whole number within 1e-9."""
    if size is None or mesh is None:
        return 1
    ratio = size / mesh
    if not 0.5 < ratio < LARGEST_COUNT or abs(ratio - round(ratio)) > 1e-9:
        faults.append(f"net.mesh: net.size / net.mesh must be a whole number, not {ratio:.12g}")
        return 1
    return round(ratio)


def _square(net: Table) -> Rectangular:
    size, mesh = net.need("size", number(above=0.0)), net.need("mesh", number(above=0.0))
    cells = _cells(size, mesh, net.faults)
    return Rectangular((size, size), (cells, cells))


def _rectangular(net: Table) -> Rectangular:
    size = net.need("size", numbers(2, above=0.0))
    mesh = net.need("mesh", numbers(2, above=0.0))
    pairs = zip(size or (None, None), mesh or (None, None), strict=True)
    cells = tuple(_cells(s, m, net.faults) for s, m in pairs)
    return Rectangular(size, (cells[0], cells[1]))


def _hexagonal(net: Table) -> Hexagonal:
    return Hexagonal(net.need("mesh", number(above=0.0)), net.need("rings", count(0)))


def _radial(net: Table) -> Radial:
    return Radial(
        net.need("radius", number(above=0.0)), net.need("spokes", count(3)), net.need("rings", count(1))
    )


def _explicit(net: Table) -> Explicit:
    nodes = net.need("nodes", triples)
    elements = net.need("elements", _pairs)
    masses = net.get("node_masses", numbers(None, minimum=0.0), ())
    fixed = net.get("fixed", _counts, ())
    if nodes is not None:
        if "node_masses" in net.seen and masses is not None and len(masses) != len(nodes):
            net.faults.append(f"net.node_masses: {len(masses)} masses for {len(nodes)} nodes")
        for key, listed in (
            ("elements", [e for pair in elements or () for e in pair]),
            ("fixed", fixed or ()),
        ):
            if outside := [i for i in listed if i >= len(nodes)]:
                net.faults.append(f"net.{key}: there is no node {outside[0]}")
    for i, j in elements or ():
        if i == j or (nodes is not None and max(i, j) < len(nodes) and nodes[i] == nodes[j]):
            net.faults.append(f"net.elements: [{i}, {j}] has no length")
    return Explicit(nodes, elements, masses or (), fixed)


def _pairs(value: Any) -> tuple[tuple[int, ...], ...]:
    if not isinstance(value, list) or any(not isinstance(v, list) or len(v) != 2 for v in value):
        raise ValueError("must be a list of [i, j]")
    return tuple(_counts(v) for v in value)


def _counts(value: Any) -> tuple[int, ...]:
    if not isinstance(value, list):
        raise ValueError("must be a list of node numbers")
    return tuple(count(0)(v) for v in value)


def _start(table: Table) -> Start:
    zero = (0.0, 0.0, 0.0)
    start = Start(
        table.need("packing", number(0.0)),
        table.get("velocity", numbers(3), zero),
        table.get("spin", numbers(3), zero),
        table.get("node_positions", triples, None),
        table.get("node_velocities", triples, None),
    )
    table.close()
    return start


def _misfits(case: Case) -> list[str]:
    """Faults between keys that are each well formed."""
    faults, shape, strings = [], case.shape, case.strings
    lists = {"node_positions": case.start.node_positions, "node_velocities": case.start.node_velocities}
    if isinstance(shape, Explicit):
        for key, present in (("net.strings", strings), ("net.bullets", case.bullet_mass)):
            if present is not None:
                faults.append(f"{key}: an explicit net has none; list nodes and node_masses instead")
        for key, values in lists.items():
            if values is not None and len(values) != len(shape.nodes):
                faults.append(f"initial.{key}: {len(values)} entries for {len(shape.nodes)} nodes")
        if case.start.node_positions is not None and case.start.packing != 1.0:
            faults.append("initial.packing: must be 1 where initial.node_positions is given")
    else:
        faults += [
            f"initial.{key}: only for an explicit net" for key, values in lists.items() if values is not None
        ]
    if isinstance(shape, Hexagonal):
        if case.bullet_mass is not None and strings is None:
            faults.append("net.bullets: the bullets of a hexagonal net need net.strings")
        if strings is not None and strings.length <= shape.mesh / 2.0:
            faults.append("net.strings.length: must exceed half of net.mesh")
    if case.launch is not None and case.bullet_mass is None:
        faults.append("launch: needs net.bullets")
    return faults
