"""Reads a case file, format 1 (`docs/keys.md`), into frozen dataclasses.

Strict: whatever this reader does not know is refused by name, because a case that is half understood would
be a comparison of two different scenes.  All faults of a file are collected before it is refused.
SI units throughout: m, kg, s, Pa, N, rad.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from reference_impl.canister import fold_faults, read_fold
from reference_impl.case import Cable, Carrier, Case, Refused, Start, Strings
from reference_impl.effects import Surroundings, read_effects
from reference_impl.effects.launch_force import CHASER
from reference_impl.read_bodies import read_attitude, read_bodies
from reference_impl.read_closing import closing_faults, read_closing
from reference_impl.read_ties import read_tethers, tie_faults
from reference_impl.shape import LARGEST_COUNT, Explicit, Hexagonal, bullets_of, read_shape
from reference_impl.table import Table, count, number, numbers, refusal, text, triples

__all__ = ["Case", "Refused", "parse_override", "read", "read_document"]


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
    return replace(read_document(document, overrides, Path(path).parent), source=source)


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


def read_document(
    document: Mapping[str, Any], overrides: Mapping[str, Any] | None = None, folder: str | Path = ""
) -> Case:
    """The case in an already parsed TOML document, with `overrides` put in.

    Files that it names are relative to `folder`, the present one unless it is given.
    """
    faults: list[str] = []
    root = Table(_overridden(document, overrides or {}, faults), "", faults)
    if (version := root.need("format", count(0))) not in (1, None):
        faults.append(refusal("format", f"version {version}; it reads version 1"))
    title = root.need("title", text) or ""
    root.get("seed", count(0), 0)  # for runs of another program
    for ignored in ("solver", "engine"):  # how another program integrates
        root.table(ignored, required=False)
    times = _times(root.table("time"))
    net = root.table("net")
    shape = read_shape(net)
    divisions = net.get("divisions", count(1), 1)
    cable = _cable(net.table("cable"))
    border = _cable(net.table("border")) if net.values.get("topology") == "cut" else None
    strings = _strings(net.table("strings", required=False))
    bullets = net.table("bullets", required=False)
    bullet_mass = bullets.need("mass", number(above=0.0)) if bullets else None
    start = _start(root.table("initial"))
    launch_table = root.table("launch", required=False)
    launch = _launch(launch_table)
    bodies, attachments = read_bodies(
        root.table("bodies", required=False), times[-1] if times else None, Path(folder)
    )
    tethers = read_tethers(root.table("tethers", required=False), _section)
    closing = read_closing(root.table("closing", required=False))
    there = 0 if not bullets else bullets_of(shape) if shape is not None else None
    around = Surroundings(there or (None if bullets else 0), times[-1] if times else None, bool(launch_table))
    effects = read_effects(root.table("effects", required=False), around)
    root.seen.add("capture")  # when a target counts as captured: of results, not of the motion
    for table in (root, net, bullets, launch_table):
        table.close()
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
        bodies,
        effects,
        attachments,
        tethers,
        border,
        closing,
    )
    faults += _misfits(case, bool(bullets), bool(launch_table))
    if faults:
        raise Refused(faults)
    return case


def _launch(table: Table) -> tuple[float, float] | None:
    """Radial and axial speed [m/s]; None where the table is absent or cannot be read.

    They may be given as one speed v and an angle from +z: radial v sin(angle), axial v cos(angle).
    """
    if not table:
        return None
    ways = (("radial_speed", "axial_speed"), ("speed", "spread_angle"))
    first, second = ([key for key in way if key in table.values] for way in ways)
    if first and second:
        table.ignore_rest()
        names = " and ".join(map(table.name, first)), " and ".join(map(table.name, second))
        table.faults.append(f"launch: give either {names[0]} or {names[1]}, not both")
        return None
    if second:
        speed = table.need("speed", number(0.0))
        angle = table.need("spread_angle", number(0.0, maximum=math.pi / 2.0))
        if speed is None or angle is None:
            return None
        return speed * math.sin(angle), speed * math.cos(angle)
    return table.need("radial_speed", number()), table.need("axial_speed", number())


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
    table.get("strength", number(above=0.0), None)  # nothing depends on it here
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


def _start(table: Table) -> Start:
    zero = (0.0, 0.0, 0.0)
    folded = "fold" in table.values
    if folded and "packing" in table.values:
        table.seen.add("packing")
        table.faults.append("initial: give exactly one of initial.packing and initial.fold")
    start = Start(
        1.0 if folded else table.need("packing", number(0.0)),
        table.get("velocity", numbers(3), zero),
        table.get("spin", numbers(3), zero),
        table.get("node_positions", triples, None),
        table.get("node_velocities", triples, None),
        _carrier(table.table("frame", required=False)),
        read_fold(table.table("fold", required=False)),
    )
    table.close()
    return start


def _carrier(table: Table) -> Carrier | None:
    """What carries the net's axes; None where nothing does, or with faults noted where it cannot be read."""
    if not table:
        return None
    body, position = table.need("body", text), table.get("position", numbers(3), (0.0, 0.0, 0.0))
    attitude = read_attitude(table)
    eject_at = table.get("eject_at", number(0.0), 0.0)
    table.close()
    return (
        None
        if body is None or position is None or attitude is None
        else Carrier(body, np.array(position), attitude, eject_at or 0.0)
    )


def _misfits(case: Case, bullets: bool, thrown: bool) -> list[str]:
    """Faults between keys; what is faulty in itself is None here, and passed over.

    `bullets`, `thrown`: whether the case has the tables `[net.bullets]` and `[launch]`.
    """
    faults, shape, strings = [], case.shape, case.strings
    lists = {"node_positions": case.start.node_positions, "node_velocities": case.start.node_velocities}
    if isinstance(shape, Explicit):
        for key, present in (("net.strings", strings is not None), ("net.bullets", bullets)):
            if present:
                faults.append(f"{key}: an explicit net has none; list nodes and node_masses instead")
        for key, values in lists.items():
            if values is not None and shape.nodes is not None and len(values) != len(shape.nodes):
                faults.append(f"initial.{key}: {len(values)} entries for {len(shape.nodes)} nodes")
        if case.start.node_positions is not None and case.start.packing not in (1.0, None):
            faults.append("initial.packing: must be 1 where initial.node_positions is given")
    elif shape is not None:
        faults += [
            f"initial.{key}: only for an explicit net" for key, values in lists.items() if values is not None
        ]
    if isinstance(shape, Hexagonal):
        if bullets and strings is None:
            faults.append("net.bullets: the bullets of a hexagonal net need net.strings")
        given = strings is not None and strings.length is not None and shape.mesh is not None
        if strings is not None and given and strings.length <= shape.mesh / 2.0:
            faults.append("net.strings.length: must exceed half of net.mesh")
    if case.start.fold is not None and shape is not None:
        faults += fold_faults(case.start.fold, shape)
    if thrown and not bullets:
        faults.append("launch: needs net.bullets")
    faults += _chaser_faults(case)
    faults += _contact_faults(case)
    return faults + _carrier_faults(case) + tie_faults(case, bullets) + closing_faults(case, bullets)


def _carrier_faults(case: Case) -> list[str]:
    """Faults between the body that carries the net's axes and the rest."""
    carrier, faults = case.start.carrier, []
    if carrier is None:
        return []
    if all(body.name != carrier.body for body in case.bodies):
        faults.append(f"initial.frame.body: there is no body {carrier.body}")
    if not carrier.eject_at:
        return faults
    key = "initial.frame.eject_at"
    if case.times and carrier.eject_at >= case.times[-1]:
        faults.append(f"{key}: must be before time.end, {case.times[-1]:.10g}, not {carrier.eject_at:.10g}")
    if isinstance(case.shape, Explicit) and case.shape.fixed:
        faults.append(f"{key}: body {carrier.body} cannot hold nodes that net.fixed holds still")
    return faults


_ROUNDED = ("box", "sphere")  # the shapes that can be touched


def _contact_faults(case: Case) -> list[str]:
    """Faults between contact and the bodies that it names."""
    contact, faults, bodies = case.effects.contact, [], {body.name: body for body in case.bodies}
    if contact is None:
        return []
    for key, names in (("threads", contact.threads), ("nodes", contact.nodes), ("bullets", contact.bullets)):
        faults += [f"effects.contact.{key}: there is no body {name}" for name in names if name not in bodies]
    for name in dict.fromkeys((*contact.threads, *contact.nodes, *contact.bullets)):
        if name not in bodies:
            continue
        kinds = [block.kind for block in bodies[name].blocks]
        if not kinds:
            faults.append(f"bodies.{name}: has no shape that effects.contact could touch; give it one")
        for kind in dict.fromkeys(kinds):
            if kind not in _ROUNDED:
                known = " and ".join(_ROUNDED)
                faults.append(refusal(f"effects.contact with a {kind}, bodies.{name}", f"it knows {known}"))
        if "box" in kinds and not bodies[name].edge_radius:
            faults.append(f"bodies.{name}.edge_radius: must be above 0 for effects.contact")
    return faults


def _chaser_faults(case: Case) -> list[str]:
    """Faults between launch_force and the bodies."""
    faults, launch, names = [], case.effects.launch_force, [body.name for body in case.bodies]
    if launch is None:
        return []
    if launch.body is not None and launch.body not in names:
        faults.append(f"effects.launch_force.body: there is no body {launch.body}")
    if launch.chaser_mass is not None:
        if CHASER in names:
            faults.append(
                f"bodies.{CHASER}: effects.launch_force has a body of this name; choose another, or leave out"
                " chaser_mass and name the body of the barrels, effects.launch_force.body"
            )
        if case.start.carrier is not None:
            faults.append(
                "effects.launch_force.chaser_mass: a point mass at the origin has no place beside"
                " initial.frame; name the body that the barrels are fixed to, effects.launch_force.body"
            )
    return faults
