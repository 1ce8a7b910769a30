"""Reads a case file, format 1 (`docs/reference/keys`), into frozen dataclasses.

Whatever this reader does not know is refused by name (`table`).  SI units throughout: m, kg, s, Pa, N, rad.
"""

from __future__ import annotations

import copy
import math
import re
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from reference_impl import solids
from reference_impl.arrays import Floats, rotation, turn
from reference_impl.bodies import Body, Poses, driven
from reference_impl.case import (
    Attachment,
    BodyPoint,
    Cable,
    Carrier,
    Case,
    ClosingLine,
    ClosingPerimeter,
    Command,
    Fold,
    Launch,
    NetNode,
    Reel,
    Start,
    Strings,
    Tether,
    Winch,
)
from reference_impl.cords import properties
from reference_impl.effects import read_effects
from reference_impl.mesh_files import triangles
from reference_impl.solids import Solid, enclosed
from reference_impl.table import (
    Refused,
    Table,
    count,
    list_of,
    mapping,
    number,
    numbers,
    text,
    triple,
    triples,
    unknown,
)
from reference_impl.thrusters import Thruster, read_thruster
from reference_impl.topology import Explicit, bullets_of, read_shape

_MODES = ("lock", "brake", "rate", "tension")


def read_cable(table: Table) -> Cable:
    """Area [m2] (from diameter or area), density and modulus of a cable, given or those of its cord."""
    if "diameter" in table:
        area = math.pi / 4.0 * table.need("diameter", number) ** 2
    else:
        area = table.need("area", number)
    cord = properties(table)
    law = table.choice("law", "green_lagrange", "hooke", "table") if "law" in table else "green_lagrange"
    density = table.get("density", number, cord[0]) if cord else table.need("density", number)
    if law != "table":
        hooke = ((0.0, 0.0), (10.0, 10.0))  # N = E A (stretch - 1)
        points = hooke if law == "hooke" else ()
        key = "youngs_modulus"
        modulus = table.get(key, number, cord[1]) if cord else table.need(key, number)
        return Cable(area, density, modulus, points)
    rows = table.need("table", list_of(list_of(number, 2)))
    stiffness = rows[1][1] / rows[1][0]
    return Cable(area, density, stiffness / area, tuple((row[0], row[1] / stiffness) for row in rows))


def read_attachments(tables: dict[str, Table], body: str) -> list[Attachment]:
    """The nodes that are points of a body."""
    made = []
    for table in tables.values():
        made.append(Attachment(_net_node(table), BodyPoint(body, table.need("point", triple))))
        table.close()
    return made


def _net_node(table: Table) -> NetNode:
    if "bullet" in table:
        return NetNode("bullet", table.need("bullet", count))
    return table.need("node", _node)


def _node(value: Any) -> NetNode:
    return NetNode("name", value) if isinstance(value, str) else NetNode("node", count(value))


def read_tethers(tables: dict[str, Table]) -> tuple[Tether, ...]:
    """The tethers with their reels."""
    made = []
    for name, table in tables.items():
        cable = read_cable(table)
        length, divisions = table.need("length", number), table.get("divisions", count, 1)
        start, end = _tether_end(table.table("start")), _tether_end(table.table("end"))
        reel = table.optional("reel")
        drum = None if reel is None else _reel(reel, length, divisions)
        table.close()
        made.append(Tether(name, cable, length, divisions, start, end, drum))
    return tuple(made)


def _tether_end(table: Table) -> NetNode | BodyPoint:
    if "body" in table:
        end: NetNode | BodyPoint = BodyPoint(
            table.need("body", text), table.get("point", triple, (0.0, 0.0, 0.0))
        )
    else:
        end = _net_node(table)
    table.close()
    return end


def _reel(table: Table, length: float, divisions: int) -> Reel:
    at = table.get("at", text, "start")
    paid_out = table.get("paid_out", number, length)
    shortest = table.get("shortest", number, 0.25 * length / divisions)
    reel = Reel(at == "start", paid_out, shortest, *_drive(table))
    table.close()
    return reel


def _drive(table: Table) -> tuple[float, float, tuple[Command, ...]]:
    """Largest rate [m/s], damping [N s/m], both infinite where they are absent, and commands of a drive."""
    commands = tuple(
        _command(Table(values, f"{table.name('commands')}[{row}]"))
        for row, values in enumerate(table.get("commands", list_of(mapping), ()))
    )
    rate, damping = (table.get(key, number, math.inf) for key in ("largest_rate", "damping"))
    return rate, damping, commands


def _command(table: Table) -> Command:
    mode = table.choice("mode", *_MODES)
    rate, force = (table.get(key, number, None) for key in ("rate", "force"))
    command = Command(table.need("at", number), mode, rate, force)
    table.close()
    return command


def read_closing(table: Table | None) -> ClosingLine | ClosingPerimeter | None:
    """What closes the mouth of the net; None where nothing does."""
    if table is None:
        return None
    closing: ClosingLine | ClosingPerimeter
    if table.choice("kind", "line", "perimeter") == "perimeter":
        closing = ClosingPerimeter(*(table.need(key, number) for key in ("at", "rate", "part")))
    else:
        closing = _line(table)
    table.close()
    return closing


def _line(table: Table) -> ClosingLine:
    if "nodes" in table:
        rings: Any = table.need("nodes", list_of(_node))
    else:
        rings = table.choice("rings", "edge", "corners")
    ends = None
    if "start" in table:
        ends = (_line_end(table.table("start")), _line_end(table.table("end")))
    if friction := table.need("friction", number):
        what = f"{table.name('friction')} = {friction:g}"
        raise unknown(what, "its line slides without friction, which is 0")
    table.ignore("strength")  # nothing depends on it here
    length = table.need("length", number)
    stiffness, density = table.need("stiffness", number), table.need("linear_density", number)
    diameter = table.need("ring_diameter", number)
    drive, winch = table.optional("winch"), None
    if drive is not None:
        drive.ignore("at")  # without friction either end is the same
        winch = Winch(drive.need("shortest", number), *_drive(drive))
        drive.close()
    return ClosingLine(rings, ends, length, stiffness, density, diameter, winch)


def _line_end(table: Table) -> NetNode | str:
    end = table.need("tether", text) if "tether" in table else _net_node(table)
    table.close()
    return end


def check_numbers(case: Case) -> None:
    """Refuses numbers of nodes of woven nets but for free ends of strings, and names of others."""
    listed = isinstance(case.shape, Explicit)
    free = bullets_of(case.shape) if case.strings is not None and case.bullet_mass is None else 0
    named = [(f"bodies.{item.place.body}.attachments", item.node) for item in case.attachments]
    for tether in case.tethers:
        ends = (("start", tether.start), ("end", tether.end))
        named += [(f"tethers.{tether.name}.{key}", end) for key, end in ends if isinstance(end, NetNode)]
    if isinstance(line := case.closing, ClosingLine):
        nodes = (*(line.ends or ()), *(() if isinstance(line.rings, str) else line.rings))
        named += [("closing", node) for node in nodes if isinstance(node, NetNode)]
    for path, node in named:
        if listed and node.kind == "name" and not bullets_of(case.shape):
            raise unknown(f'{path}.node = "{node.number}"', "nodes of a net without corners have numbers")
        if not listed and node.kind == "node" and int(node.number) >= free:
            why = "of a woven net it knows bullets, names, and free ends of strings without bullets"
            raise unknown(f"{path}.node = {node.number}", why)


_UNITS = {"m": 1.0, "cm": 0.01, "mm": 0.001, "inch": 0.0254}  # [m]
_ZERO = (0.0, 0.0, 0.0)


_Thrusters = tuple[tuple[str, Thruster], ...]


def read_bodies(
    tables: dict[str, Table], folder: Path
) -> tuple[tuple[Body, ...], tuple[Attachment, ...], _Thrusters]:
    """The bodies, the nodes that are points of them, and what thrusts on them.

    Files of shapes are relative to `folder`.
    """
    attached: list[Attachment] = []
    given = {name: table.optional("thrust") for name, table in tables.items()}
    read = {name: read_thruster(table) for name, table in given.items() if table is not None}
    thrusters = tuple((name, thruster) for name, thruster in read.items() if thruster is not None)
    bodies = [_body(table, name, attached, folder) for name, table in tables.items()]
    return tuple(bodies), tuple(attached), thrusters


def _body(table: Table, name: str, attached: list[Attachment], folder: Path) -> Body:
    solid = _solid(table, folder)
    mass, inertia, centre = _mass(table, solid)
    attitude = read_attitude(table)
    position, velocity, spin = (
        table.get(key, triple, _ZERO) for key in ("position", "velocity", "angular_velocity")
    )
    of_scene = table.get("angular_velocity_frame", text, "body") == "scene"
    angular = attitude.T @ spin if of_scene else np.array(spin)
    motion = "free" if "motion" not in table else table.choice("motion", "free", "fixed", "prescribed")
    poses = _poses(table, attitude)
    rounding = table.get("edge_radius", number, 0.0)
    attached += read_attachments(table.tables("attachments"), name)
    table.close()
    start = (np.array(position), np.array(velocity), attitude, angular)
    blocks = () if solid is None else solid.blocks
    body = Body(name, mass, inertia, centre, *start, blocks=blocks, edge_radius=rounding)
    return body if motion == "free" else driven(body, poses)


def _poses(table: Table, attitude: Floats) -> Poses | None:
    """The poses of a prescribed body; without `pose_attitudes` it keeps its own attitude (3, 3)."""
    if "pose_times" not in table:
        return None
    times = table.need("pose_times", numbers)
    quaternions = table.get("pose_attitudes", list_of(list_of(number, 4)), None)
    turns = [attitude] * len(times) if quaternions is None else [rotation(q) for q in quaternions]
    return Poses(times, table.need("pose_positions", triples), np.array(turns))


def _solid(table: Table, folder: Path) -> Solid | None:
    """What a body is made of; None where only its mass and inertia are given."""
    if "parts" in table:
        return solids.union([_part(part) for part in table.tables("parts").values()])
    if table.values.get("shape") != "mesh":
        return _shape(table) if "shape" in table else None
    table.ignore("shape", "grid_spacing")
    file, unit = table.need("file", text), table.choice("unit", *_UNITS)
    try:
        return enclosed(_UNITS[unit] * triangles(folder / file))
    except ValueError as error:
        raise Refused([f"{table.name('file')}: {error}"]) from error


def _part(table: Table) -> Solid:
    solid, attitude = _shape(table), read_attitude(table)
    position = np.array(table.get("position", triple, _ZERO))
    table.close()
    return solid.moved(attitude, position)


def _shape(table: Table) -> Solid:
    kind = table.choice("shape", "box", "cylinder", "sphere", "capsule", "frustum")
    if kind == "box":
        return solids.box(table.need("size", triple))
    if kind == "sphere":
        return solids.sphere(table.need("radius", number))
    length = table.need("length", number)
    if kind == "frustum":
        return solids.frustum(table.need("radii", list_of(number, 2)), length)
    make = solids.cylinder if kind == "cylinder" else solids.capsule
    return make(table.need("radius", number), length)


def _mass(table: Table, solid: Solid | None) -> tuple[float, Floats, Floats]:
    """Mass [kg], matrix of inertia (3, 3) [kg m2] and centre of mass (3,) [m].

    Inertia and centre of mass are those of the evenly filled solid unless they are given.
    """
    volume, centre, over_mass = (
        (0.0, np.zeros(3), np.zeros((3, 3))) if solid is None else solids.moments(solid)
    )
    filled = "density" in table
    mass = volume * table.need("density", number) if filled else table.need("mass", number)
    inertia = over_mass * mass
    if solid is None or "inertia" in table:
        xy, xz, yz = table.get("products_of_inertia", triple, _ZERO)
        products = np.array([[0.0, xy, xz], [xy, 0.0, yz], [xz, yz, 0.0]])
        inertia = np.diag(table.need("inertia", triple)) + products
    return mass, inertia, np.array(table.get("centre_of_mass", triple, centre))


def read_attitude(table: Table) -> Floats:
    """Rotation matrix (3, 3) of `attitude`, or of `axis` and `angle`."""
    if "axis" not in table:
        return rotation(table.get("attitude", list_of(number, 4), (1.0, 0.0, 0.0, 0.0)))
    axis = np.array(table.need("axis", triple))
    scaled = axis / np.abs(axis).max()
    return turn(scaled / np.linalg.norm(scaled), table.need("angle", number))


_ROUNDED = ("box", "sphere")  # the shapes that can be touched


def read(path: str | Path, overrides: Mapping[str, Any] | None = None) -> Case:
    """Reads the case file at `path`; `overrides`: dotted keys and their new values, None to drop a key."""
    try:
        document = tomllib.loads(Path(path).read_text(encoding="utf-8"))
    except OSError as error:
        raise Refused([f"{path}: {error.strerror or error}"]) from error
    except ValueError as error:
        raise Refused([f"{path}: not TOML in UTF-8: {error}"]) from error
    return read_document(document, overrides, Path(path).parent)


def parse_override(text: str) -> tuple[str, Any]:
    """`key.path=value` as typed on a command line; the value is TOML if it parses, else a plain string.

    An empty value removes the key.
    """
    key, equals, value = text.partition("=")
    if not equals or not key.strip():
        raise Refused([f"--set {text}: expected key.path=value"])
    if not value.strip():
        return key.strip(), None
    try:
        return key.strip(), tomllib.loads(f"value = {value}")["value"]
    except tomllib.TOMLDecodeError:
        return key.strip(), value


def read_document(
    document: Mapping[str, Any], overrides: Mapping[str, Any] | None = None, folder: str | Path = ""
) -> Case:
    """The case in an already parsed TOML document, with `overrides` put in.

    Files that it names are relative to `folder`, the present one unless it is given.
    """
    root = Table(_overridden(document, overrides or {}))
    if (version := root.need("format", count)) != 1:
        raise unknown("format", f"version {version}; it reads version 1")
    # how exunet integrates, its random numbers, and what it derives from results
    root.ignore("solver", "engine", "seed", "capture")
    net = root.table("net")
    shape, cable, threads = read_shape(net, Path(folder)), net.table("cable"), net.tables("threads")
    strings, border, bullets = net.optional("strings"), net.optional("border"), net.optional("bullets")
    bodies, attachments, thrusters = read_bodies(root.tables("bodies"), Path(folder))
    case = Case(
        root.need("title", text),
        _times(root.table("time")),
        shape,
        net.get("divisions", count, 1),
        read_cable(cable),
        None if strings is None else _strings(strings),
        None if bullets is None else bullets.need("mass", number),
        _start(root.table("initial")),
        _launch(root.optional("launch")),
        bodies,
        read_effects(root.optional("effects")),
        attachments,
        read_tethers(root.tables("tethers")),
        None if border is None else read_cable(border),
        read_closing(root.optional("closing")),
        thrusters,
        {name: read_cable(thread) for name, thread in threads.items()},
    )
    for table in (*threads.values(), cable, strings, border, bullets, net, root):
        if table is not None:
            table.close()
    check_numbers(case)
    _check_surfaces(case)
    return case


def _launch(table: Table | None) -> Launch | None:
    """What bullets are given; None where the table is absent.

    The speeds may be given as one speed v and an angle from +z: radial v sin(angle), axial v cos(angle).
    """
    if table is None:
        return None
    if "speed" in table:
        speed, angle = table.need("speed", number), table.need("spread_angle", number)
        radial, axial = speed * math.sin(angle), speed * math.cos(angle)
    else:
        radial, axial = table.need("radial_speed", number), table.need("axial_speed", number)
    factors = table.get("speed_factors", numbers, None)
    tilts = table.get("tilts", list_of(list_of(number, 2)), None)
    table.close()
    return Launch(radial, axial, factors, tilts)


def _overridden(document: Mapping[str, Any], overrides: Mapping[str, Any]) -> dict[str, Any]:
    """A copy of `document` in which each key of `overrides`, such as `bodies.sat.size[0]`, has its new value.

    An index is of an item of a list, or of a table among tables.
    """
    result = copy.deepcopy(dict(document))
    for path, value in overrides.items():
        holder: Any = {"": result}
        last: str | int = ""
        for index, *name in re.findall(r"""\[\s*(\d+)\s*\]|["']([^"']+)["']|([\w-]+)""", path):
            holder = holder.setdefault(last, {}) if isinstance(holder, dict) else holder[last]
            last = int(index) if index else "".join(name)
            if index and isinstance(holder, dict | list) and int(index) < len(holder):
                last = list(holder)[int(index)] if isinstance(holder, dict) else int(index)
            elif index or not isinstance(holder, dict):
                raise Refused([f"{path}: cannot be set, because what should hold it does not"])
        holder[last] = value
        if value is None:
            del holder[last]
    return result


def _times(table: Table) -> tuple[float, ...]:
    """Stored times [s]: k * output_step and the end, or the listed ones with 0 and the end."""
    end = table.need("end", number)
    step, listed = table.get("output_step", number, None), table.get("output_times", numbers, None)
    table.close()
    if listed is not None:
        return tuple(sorted({0.0, *listed, end}))
    if step is None:
        raise Refused(["time: neither output_step nor output_times is there"])
    whole = math.ceil(end / step * (1.0 - 1e-12)) if end > step else 1
    return (*(k * step for k in range(whole) if k * step < end), end)


def _strings(table: Table) -> Strings:
    return Strings(read_cable(table), table.need("length", number), table.get("divisions", count, 1))


def _start(table: Table) -> Start:
    frame, fold = table.optional("frame"), table.optional("fold")
    start = Start(
        1.0 if fold is not None else table.need("packing", number),
        table.get("velocity", triple, _ZERO),
        table.get("spin", triple, _ZERO),
        table.get("node_positions", triples, None),
        table.get("node_velocities", triples, None),
        None if frame is None else _carrier(frame),
        None if fold is None else _fold(fold),
    )
    table.close()
    return start


def _carrier(table: Table) -> Carrier:
    position, attitude = np.array(table.get("position", triple, _ZERO)), read_attitude(table)
    carrier = Carrier(table.need("body", text), position, attitude, table.get("eject_at", number, 0.0))
    table.close()
    return carrier


def _fold(table: Table) -> Fold:
    table.choice("pattern", "accordion", "star")
    fold = Fold(*(table.get(key, list_of(number, size), None) for key, size in (("box", 3), ("cylinder", 2))))
    table.close()
    return fold


def _check_surfaces(case: Case) -> None:
    """Refuses contact with bodies whose surface is not made of boxes and spheres."""
    contact = case.effects.contact
    if contact is None:
        return
    touched = {*contact.threads, *contact.nodes, *contact.bullets}
    for body in case.bodies:
        for kind in {block.kind for block in body.blocks} - {*_ROUNDED} if body.name in touched else ():
            what = f"effects.contact with a {kind}, bodies.{body.name}"
            raise unknown(what, f"it knows {' and '.join(_ROUNDED)}")
