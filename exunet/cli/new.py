"""`exunet new`: write a first case, scaled to its target.

Lengths and times of a capture are proportional to the size D of its target and masses to D3, at one speed and
with one material: strains do not depend on D.
"""

from __future__ import annotations

import json
import math
import os
from pathlib import Path

import numpy as np

from exunet.base.errors import CaseError, InputError
from exunet.base.files import replacing
from exunet.bodies.mesh import METRES, read_mesh
from exunet.scene.casefile import Case, parse_case
from exunet.simulation.preparation import prepare_case

KINDS = ("deployment", "capture")
_EDGES = (0.02, 0.01, 0.005, 0.002)  # edge radius over D: the largest that the shape allows is taken
_NET = """# {about}
# Keys: docs/reference/keys; `exunet check FILE` describes the case, `exunet run FILE` runs it. Units are SI.
format = 1
title = "{title}"

[time]
end = {end}            # s
output_step = {step}   # s, between stored states

[net]
topology = "square"
size = {size}          # m, edge of the net
meshes = {meshes}            # along an edge

[net.cable]            # density, modulus and strength follow from fibre and construction
material = "nylon"
construction = "braided"
diameter = {diameter}  # m

[net.bullets]
mass = {bullet}        # kg, one at each corner

[effects.material_damping]
relaxation_time = {damping}  # s, 0.15 of what damps a side of a mesh critically
"""
_DEPLOYMENT = """
[initial]
packing = 0.1          # initial position = packing x reference position

[launch]
speed = 4.0            # m/s, of each bullet
spread_angle = 0.6     # rad, from the z axis
"""
_CAPTURE = """
[initial]
packing = 0.98         # the net begins open; smaller, with [launch], it is thrown
velocity = [0.0, 0.0, 4.0]  # m/s, towards the target

[bodies.target]
{shape}
edge_radius = {edge}   # m, by which edges are rounded for contact
density = 100.0        # kg/m3, of the evenly filled shape
position = {position}  # m, of the origin of the shape
angular_velocity = {spin}  # rad/s

[effects.contact]
threads = ["target"]
bullets = ["target"]
bullet_radius = {radius}  # m
law = "linear"
stiffness = 3e4        # N/m2: force per length of thread and per depth
bullet_stiffness = {stiffness}  # N/m
restitution = 0.5
impact_speed = 4.0     # m/s, at which it is 0.5
friction = {{ law = "sticking", coefficient = 0.3 }}

[capture]              # what counts as one; a closing line, [closing], would keep the mouth shut
target = "target"
enclosed = 0.9
relative_speed = 0.5   # m/s
touching = 10          # elements or nodes
duration = {duration}  # s
"""


def new_case(kind: str, target: Path | None, unit: str, out: Path, *, overwrite: bool) -> Path:
    """Write a case and return its path; raises InputError for a wrong kind, target or place."""
    if kind not in KINDS:
        raise InputError(f"new: KIND must be {' or '.join(KINDS)}, got {kind!r}")
    if target is not None and (kind == "deployment" or unit not in METRES):
        words = "deployment does not have a target" if kind == "deployment" else f"--unit: got {unit!r}"
        raise InputError(f"new: {words}")
    if out.exists() and not overwrite:
        raise InputError(f"{out}: exists already: give --out or --overwrite")
    case = _deployment(out) if kind == "deployment" else _capture(target, unit, out)
    with replacing(out) as part:
        part.write_text(case.text, encoding="utf-8")
    return out


def _deployment(out: Path) -> Case:
    head = {"about": "A square net opens, thrown by four bullets.", "title": "A net opens"}
    return parse_case(_net(head, 5.0, 10, 2.0, 1.0) + _DEPLOYMENT, out)


def _net(head: dict[str, str], size: float, meshes: int, end: float, bullets: float) -> str:
    """Return the tables of a net of a size [m]; bullets : mass of each over that of the threads."""
    diameter, side = 4e-3 * size / meshes, size / meshes
    density, modulus = 0.64 * 1140.0, 0.64 * 0.54 * 4.56e9
    threads = 2.0 * size * (meshes + 1) * density * math.pi / 4.0 * diameter**2  # [kg]
    damping = 0.3 * side / (math.pi * math.sqrt(modulus / density))
    numbers = {"end": end, "step": end / 100, "size": size, "diameter": diameter, "damping": damping}
    texts = {name: _text(value) for name, value in (numbers | {"bullet": bullets * threads}).items()}
    return _NET.format(**head, **texts, meshes=meshes)


def _capture(target: Path | None, unit: str, out: Path) -> Case:
    """Return the case with the largest edge radius that the target allows."""
    if target is None:
        low, high, shape = np.full(3, -0.5), np.full(3, 0.5), 'shape = "box"\nsize = [1.0, 1.0, 1.0]    # m'
    else:
        corners = read_mesh(target, unit).vertices
        low, high = corners.min(axis=0), corners.max(axis=0)
        file = json.dumps(Path(os.path.relpath(target, out.parent)).as_posix(), ensure_ascii=False)
        shape = f'shape = "mesh"\nfile = {file}\nunit = "{unit}"'
    across = float(np.linalg.norm(high - low))  # D
    centre = np.array([0.0, 0.0, 0.75 * across]) - 0.5 * (low + high)
    head = {"about": "An open net meets a target, and nothing closes it.", "title": "A net meets a target"}
    numbers = {"radius": 0.02 * across, "stiffness": 1e4 * across, "duration": 0.25 * across}
    texts = {name: _text(value) for name, value in numbers.items()}
    lists = {"position": centre, "spin": np.array([0.3, 0.4, 0.2]) / across}
    texts |= {name: f"[{', '.join(map(_text, values.tolist()))}]" for name, values in lists.items()}
    net = _net(head, float(_text(2.8 * across)), 20, 1.2 * across, 0.2)
    for edge in _EDGES:
        try:
            text = net + _CAPTURE.format(shape=shape, edge=_text(edge * across), **texts)
            prepare_case(case := parse_case(text, out), hosted=True)
        except CaseError as error:
            failure = error
        else:
            return case
    raise failure


def _text(value: float) -> str:
    return repr(float(f"{value:.3g}"))
