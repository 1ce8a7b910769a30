"""Random small nets that fly at a random body, and what is wrong with what comes of one."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from fuzz_scenes import judged, text
from numpy.random import Generator
from solids import OUTLINE, extruded, mesh_keys

from exunet.bodies.overlap import polyhedron
from exunet.bodies.shapes import Solid
from exunet.results.measures import momentum_books

Tables = dict[str, dict[str, Any]]
TARGET = "target"
MESH = 0.25  # m
# Of the size of the books: what round-off of some ten thousand steps leaves; the issue of captures asks for
# 1e-10 and 1e-8 of scenes whose steps are of use, these steps may be the largest that are stable.
LINEAR = 1e-10
SHAPES = ("sphere", "box", "cylinder", "capsule", "frustum", "parts", "mesh")


class Ended(NamedTuple):
    """How a scene ended, what is wrong with it ("": nothing), whether anything touched, whether it rubbed."""

    end: str
    fault: str
    touched: bool
    rubbed: bool


def capture(seed: int, folder: Path) -> Tables:
    """The tables of a random capture; the same seed gives the same case. A mesh goes into the folder."""
    random = np.random.default_rng([seed, 14])
    speed = float(10.0 ** random.uniform(-0.5, 1.0))
    shape, half = _shape(random, folder)
    gap = float(random.uniform(0.01, 0.1))
    end = (gap + float(random.uniform(0.1, 1.0)) * half) / speed
    tables: Tables = {"": {"format": 1, "title": f"capture {seed}"}}
    tables["time"] = {"end": end, "output_step": end / 20.0}
    tables["solver"] = _solver(random)
    tables["engine"] = {"backend": "compiled" if random.random() < 0.9 else "exudyn"}
    tables["net"] = _net(random)
    tables["net.cable"] = {
        "diameter": 1e-3,
        "density": 1390.0,
        "youngs_modulus": float(10.0 ** random.uniform(6.5, 8.5)),
    }
    if bullets := random.random() < 0.7:
        tables["net.bullets"] = {"mass": float(10.0 ** random.uniform(-3.0, 0.0))}
        if tables["net"]["topology"] == "hexagonal":  # whose bullets hang on bridles
            tables["net.strings"] = tables["net.cable"] | {"length": 0.3}
    tables["initial"] = {
        "packing": float(random.uniform(0.7, 1.0)),
        "velocity": [*(0.2 * speed * random.normal(size=2)).tolist(), speed],
    }
    if random.random() < 0.3:
        tables["effects.material_damping"] = {"relaxation_time": 1e-5}
    free = random.random() < 0.7
    tables[f"bodies.{TARGET}"] = shape | {
        "mass": float(10.0 ** random.uniform(-1.5, 3.0)),
        "position": [*random.uniform(-0.2, 0.2, size=2).tolist(), half + gap],
        "attitude": random.normal(size=4).tolist(),
        **({} if free else {"motion": "fixed"}),
    }
    if free:
        tables[f"bodies.{TARGET}"]["angular_velocity"] = (2.0 * random.normal(size=3)).tolist()
    tables |= {f"bodies.{TARGET}.parts.{name}": keys for name, keys in _parts(shape).items()}
    tables["effects.contact"] = _contact(random, speed, bullets=bullets)
    return tables


def judge_capture(seed: int, folder: Path) -> Ended:
    """Run a scene of `capture`."""
    tables = capture(seed, folder)
    end, fault, result = judged(text(tables), folder)
    if result is None:
        return Ended(end, fault, touched=False, rubbed=False)
    touched = any(
        states.values[-1, 0] >= 0.0
        for name, states in result.states.items()
        if name.startswith(f"contact_{TARGET}/") and name.endswith("_first")
    )
    rubs = touched and "friction" in tables["effects.contact"]
    summed = tables["engine"]["backend"] == "exudyn" and result.provenance["method"] == "VelocityVerlet"
    if summed and "motion" in tables[f"bodies.{TARGET}"]:  # what that body gives: at first order in the step
        return Ended(end, fault, touched, rubs)
    if not fault and (off := momentum_books(result)["linear"]).residual > LINEAR * off.size + 1e-15:
        fault = f"the books of momentum are off by {off.residual / off.size:.3g}"
    return Ended(end, fault, touched, rubs)


def _net(random: Generator) -> dict[str, Any]:
    meshes = int(random.integers(2, 5))
    match str(random.choice(["square", "square", "rectangular", "hexagonal", "radial"])):
        case "square":
            return {"topology": "square", "mesh": MESH, "size": MESH * meshes}
        case "rectangular":
            return {"topology": "rectangular", "mesh": [MESH, 0.2], "size": [MESH * meshes, 0.6]}
        case "hexagonal":
            return {"topology": "hexagonal", "mesh": 0.2, "rings": int(random.integers(1, 3))}
        case _:
            return {"topology": "radial", "radius": 0.2 * meshes, "spokes": 6, "rings": meshes}


def _shape(random: Generator, folder: Path) -> tuple[dict[str, Any], float]:
    """Keys of a body without parts, or "parts"; the radius of a ball about its origin that holds it [m]."""
    kind = str(random.choice(SHAPES))
    a, b, c = (float(size) for size in random.uniform(0.15, 0.5, size=3))
    rounded = {"edge_radius": float(random.uniform(0.1, 0.4)) * min(a, b, c)}
    match kind:
        case "sphere":
            return {"shape": kind, "radius": a}, a
        case "capsule":
            return {"shape": kind, "radius": a, "length": b}, a + b
        case "box":
            return {"shape": kind, "size": [a, b, c]} | rounded, float(np.hypot(np.hypot(a, b), c)) / 2.0
        case "cylinder":
            return {"shape": kind, "radius": a, "length": b} | rounded, float(np.hypot(a, b))
        case "frustum":
            return {"shape": kind, "radii": [a, b], "length": c} | rounded, max(a, b) + c
        case "mesh":
            return _mesh(random, (a, b, c), rounded, folder)
    return {"edge_radius": 0.03}, 0.7


def _mesh(
    random: Generator, size: tuple[float, float, float], edge: dict[str, float], folder: Path
) -> tuple[dict[str, Any], float]:
    """As `_shape`, of an L, which has an inner edge, or of the polyhedron of a solid of this size."""
    if random.random() < 0.5:
        legs = 5.0 * min(size)  # of the outline, so that they are as wide as this
        mesh = extruded([(legs * x, legs * y) for x, y in OUTLINE], 0.5 * max(size))
    else:
        mesh = polyhedron(Solid(str(random.choice(SHAPES[:5])), size))
    if random.random() < 0.5:
        edge = edge | {"grid_spacing": 0.5 * edge["edge_radius"]}
    keys = mesh_keys(mesh, folder, TARGET)
    return keys | edge, float(np.linalg.norm(mesh.vertices, axis=1).max())


def _parts(shape: dict[str, Any]) -> Tables:
    """A box with an arm across it, if the body has no shape of its own."""
    if "shape" in shape:
        return {}
    return {
        "bus": {"shape": "box", "size": [0.4, 0.3, 0.3]},
        "arm": {"shape": "box", "size": [0.1, 0.9, 0.1], "position": [0.1, 0.0, 0.1]},
    }


def _contact(random: Generator, speed: float, *, bullets: bool) -> dict[str, Any]:
    stiffness = float(10.0 ** random.uniform(2.5, 5.0))
    keys: dict[str, Any] = {"threads": [TARGET]}
    if bullets:
        keys |= {"bullets": [TARGET], "bullet_radius": float(random.uniform(0.002, 0.03))}
    if random.random() < 0.7:
        keys |= {"law": "linear", "stiffness": stiffness}
        keys |= {"bullet_stiffness": stiffness} if bullets else {}
    else:
        keys |= {"law": "hertz", "modulus": stiffness}
    if random.random() < 0.5:
        keys |= {"restitution": float(random.uniform(0.2, 1.0)), "impact_speed": speed}
    else:
        keys |= {"damping": float(random.uniform(0.0, 1.0))}
    law = str(random.choice(["none", "sticking", "regularised"], p=[0.3, 0.4, 0.3]))
    if law != "none":
        keys["friction"] = {"law": law, "coefficient": float(random.uniform(0.05, 1.0))}
    if law == "regularised":
        keys["friction"]["slip_speed"] = 0.05 * speed
    return keys


def _solver(random: Generator) -> dict[str, Any]:
    choice = random.random()
    if choice < 0.5:
        return {"method": "DOPRI5", "accuracy": float(10.0 ** random.uniform(-5.0, -2.0))}
    if choice < 0.6:
        return {"accuracy": 1e-3}
    return {"method": "RK44" if choice < 0.8 else "VelocityVerlet"}
