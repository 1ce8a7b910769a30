"""Contact of threads and bullets with bodies: impacts, friction, belt friction, and what is refused."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scenes import (
    BACKENDS,
    CASES,
    DENSITY,
    DIAMETER,
    HERTZ,
    LINEAR,
    NET_ON_BOX,
    OUTLINE,
    PLATE,
    SIDE,
    STRING,
    as_mesh,
    case_in,
    contact,
    every_backend,
    extruded,
    mesh_keys,
    of_text,
    refused,
    restarted,
    simulation,
    stored,
    taken_by_contact,
)
from scipy.optimize import brentq
from scipy.special import gamma
from scripts import FALL as NODE_AND_BALL

import exunet
from exunet.forces.contact.law import (
    damping_of,
    friction,
    hertz_of_line,
    hertz_of_sphere,
    regularised_friction,
    shift_for,
)
from exunet.forces.contact.status import ContactKey, status_of
from exunet.kernels import kernel
from exunet.results.summary import summarise
from exunet.simulation.preparation import prepare_case

Floats = np.ndarray
LINE_MASS = DENSITY * math.pi / 4.0 * DIAMETER**2  # kg/m
G = 9.81  # m/s2
BULLETS, THREADS = slice(0, 4), slice(4, 8)  # nodes
FALL: Sequence[str] = ("initial.velocity=[0.0, 0.0, -1.0]",)


@pytest.mark.parametrize("restitution", [1e-3, 0.2, 0.5, 0.9, 1.0 - 2e-5])
def test_damping_and_restitution_obey_the_law(restitution: float) -> None:
    """d (1 + e) = ln((1 + d) / (1 - e d)) of d = a v, at the speed of the restitution."""
    d = 4.0 * damping_of(restitution, 4.0)
    if restitution < 0.01:  # there e d is 1 to the last bit
        assert d == pytest.approx(1.0 / restitution, rel=1e-12)
        return
    assert d * (1.0 + restitution) == pytest.approx(math.log1p(d) - math.log1p(-restitution * d), rel=1e-6)


def test_near_one_the_restitution_is_that_of_the_usual_law() -> None:
    """a = 3 (1 - e) / (2 v0)."""
    assert damping_of(1.0, 4.0) == 0.0
    assert damping_of(1.0 - 2.0**-20, 4.0) == pytest.approx(1.5 * 2.0**-22, rel=1e-12)
    assert damping_of(1.0 - 1.01e-5, 4.0) == pytest.approx(1.5 * 1.01e-5 / 4.0, rel=2e-5)


def test_stiffness_by_hertz() -> None:
    """4/3 E* R^(1/2), and pi/4 E*."""
    assert hertz_of_sphere(3e5, 0.04) == pytest.approx(8e4, rel=1e-12)
    assert hertz_of_line(3e5) == pytest.approx(0.75e5 * math.pi, rel=1e-12)


def test_friction_by_vectors() -> None:
    """A spring along the surface, of mu N at most, and the regularised law; a shift gives its force back."""
    rng, law, sliding = np.random.default_rng(1), SimpleNamespace(friction=0.4, slip_speed=0.1), 0
    for _ in range(40):
        n, u, w = rng.normal(size=(3, 3))
        n /= np.linalg.norm(n)
        push, surface = rng.uniform(0.0, 10.0), np.eye(3) - np.outer(n, n)
        spring = -2.0 * surface @ (u + 0.3 * w)
        wanted, most = np.linalg.norm(spring), 0.4 * push
        force, slides = friction(push, n, u, w, 2.0, 0.3, law)
        np.testing.assert_allclose(force, spring * min(1.0, most / wanted), rtol=1e-12)
        assert slides == (wanted > most)
        sliding += slides
        smooth = -most * surface @ w / math.sqrt(w @ surface @ w + 0.01)
        np.testing.assert_allclose(regularised_friction(push, n, w, law), smooth, rtol=1e-12)
        shift = shift_for(force, n, w, 2.0, 0.3)
        np.testing.assert_allclose(friction(1.1 * push, n, shift, w, 2.0, 0.3, law)[0], force, rtol=1e-11)
    assert 5 < sliding < 35


# Impacts


def bounced(
    folder: Path, which: slice, keys: dict[str, Any], *changes: str, until: float, text: str = PLATE
) -> float:
    """The speed [m/s] at which knots or bullets leave the plate, all of them the same."""
    sim = simulation(folder, text, *contact(**keys), *changes)
    sim.advance(until)
    velocity = sim.net.velocity[which]
    assert np.ptp(velocity[:, 2]) < 1e-9
    discrete = sim.view.discrete[f"contact/{'threads' if which is THREADS else 'bullets'}/plate"]
    assert status_of(discrete).first_touch > 0.0
    return float(velocity[0, 2])


# Laws, and masses of bullets or densities of threads.
IMPACTS: dict[str, tuple[slice, dict[str, Any], Sequence[str]]] = {
    "threads": (THREADS, LINEAR, ("net.bullets.mass=1e-12",)),
    "heavier threads": (
        THREADS,
        LINEAR | {"stiffness": 5e4},
        ("net.cable.density=8000.0", "net.strings.density=8000.0"),
    ),
    "threads, hertz": (THREADS, HERTZ | {"bullet_radius": 1e-12}, ("net.bullets.mass=1e-12",)),
    "bullets": (BULLETS, LINEAR | {"stiffness": 1e-9, "bullet_stiffness": 2e3}, ("net.bullets.mass=0.05",)),
    "bullets, hertz": (BULLETS, {"law": "hertz", "modulus": 2e5}, ("net.bullets.mass=0.1",)),
}


@pytest.mark.ci_for("bullets-solid-0.5")
@pytest.mark.slow
@pytest.mark.parametrize("restitution", [0.9, 0.5, 0.2])
@pytest.mark.parametrize(
    ("name", "shape"), [*((name, "solid") for name in IMPACTS), ("threads", "mesh"), ("bullets", "mesh")]
)
def test_restitution_is_what_was_stated(name: str, shape: str, restitution: float, tmp_path: Path) -> None:
    """The distance from a plane face of a mesh is exact, so that this is as exact as with a solid."""
    which, keys, changes = IMPACTS[name]
    text = as_mesh(tmp_path, PLATE, (4.0, 4.0, 0.4), "grid_spacing = 0.025") if shape == "mesh" else PLATE
    keys = keys | {"restitution": restitution, "impact_speed": 1.0}
    step = 2e-6 if which is THREADS else 2e-5
    soon = 0.098  # before threads, which nothing stops beside bullets, are too deep to be followed
    found = bounced(tmp_path, which, keys, *FALL, *changes, f"solver.step={step}", until=soon, text=text)
    assert found == pytest.approx(restitution, abs=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("speed", [0.4, 3.0])
def test_restitution_at_another_speed(speed: float, tmp_path: Path) -> None:
    """With a of e = 0.5 at 1 m/s: d (1 + e) = ln((1 + d) / (1 - e d)), d = a v."""

    def relation(d: float, e: float) -> float:
        return d * (1.0 + e) - math.log((1.0 + d) / (1.0 - e * d))

    a = brentq(lambda d: relation(d, 0.5), 0.1, 1.99, xtol=1e-15)
    d = a * speed
    e = brentq(lambda e: relation(d, e), 1e-3, min(1.0, 1.0 / d) - 1e-3, xtol=1e-15)
    which, keys, changes = IMPACTS["bullets"]
    keys = keys | {"restitution": 0.5, "impact_speed": 1.0}
    fall = f"initial.velocity=[0.0, 0.0, {-speed}]"
    found = bounced(tmp_path, which, keys, fall, *changes, "solver.step=2e-5", until=0.098 / speed)
    assert found / speed == pytest.approx(e, abs=1e-6)


@pytest.mark.slow
def test_the_duration_of_a_hertzian_impact(tmp_path: Path) -> None:
    """2.94 x_m / v with x_m = (5 m v^2 / (4 k))^(2/5): Johnson, "Contact Mechanics" (1985), eq. (11.24)."""
    _, keys, changes = IMPACTS["bullets, hertz"]
    keys, step = keys | {"damping": 0.0}, 2e-5
    sim = simulation(tmp_path, PLATE, *contact(**keys), *FALL, *changes, f"solver.step={step}")
    mass = float(sim.start.system.mass[0])
    deepest = (1.25 * mass / (4.0 / 3.0 * 2e5 * math.sqrt(0.02))) ** 0.4
    known = 2.0 * deepest * math.sqrt(math.pi) * gamma(0.4) / (5.0 * gamma(0.9)) * 2.0
    assert known == pytest.approx(2.94 * deepest, rel=2e-3)
    sim.advance(0.1)
    # It flew 0.03 m at 1 m/s, stayed for the time, and flies back at 1 m/s.
    assert sim.net.velocity[0, 2] == pytest.approx(1.0, abs=1e-6)
    height = sim.net.position[0, 2] - (-0.05 + 0.02)
    assert 0.1 - 0.03 - height == pytest.approx(known, rel=1e-6)
    status = status_of(sim.view.discrete["contact/bullets/plate"])
    assert status.depth == pytest.approx(deepest, rel=1e-6)
    assert status.first_touch == pytest.approx(0.03, abs=1.5 * step)


# Friction

BULLET = 0.02  # kg
STICKING: dict[str, Any] = {"friction.coefficient": 0.5, "friction.law": "sticking"}
REGULARISED: dict[str, Any] = {"friction.coefficient": 0.5, "friction.law": "regularised"}


def on_slope(
    folder: Path,
    degrees: float,
    friction: dict[str, Any],
    *changes: str,
    step: float = 1e-3,
    hard: float = 200.0,
) -> exunet.Simulation:
    """The net lies on a slope, as deep as it sinks in by its weight; bullets are of its threads' height.

    Bullets have 0.02 kg: their springs turn over at 100 rad/s, those of threads at 500 rad/s.
    """
    angle = math.radians(degrees)
    weight = [G * math.sin(angle), 0.0, -G * math.cos(angle)]
    deep, bullet = (mass * G * math.cos(angle) / hard for mass in (LINE_MASS, BULLET))
    keys = friction | {"law": "linear", "damping": 2.0, "stiffness": hard, "bullet_stiffness": hard}
    return simulation(
        folder,
        PLATE,
        *contact(**keys, bullet_radius=0.5 * DIAMETER - deep + bullet),
        f"effects.gravity.acceleration={weight}",
        f"bodies.plate.position=[0.0, 0.0, {-0.2 - 0.5 * DIAMETER + deep}]",
        f"net.bullets.mass={BULLET}",
        f"solver.step={step}",
        *changes,
    )


@pytest.mark.slow
def test_below_the_friction_angle_nothing_creeps(tmp_path: Path) -> None:
    """tan 20 deg = 0.36 < 0.5: once at rest, nothing moves for 60 s."""
    sim = on_slope(tmp_path, 20.0, STICKING)
    sim.advance(10.0)
    before = sim.net.position.copy()
    assert 0.0 < before[0, 0] + (0.5 * SIDE + STRING / math.sqrt(2.0)) < 5e-3  # bent its springs, and slid
    sim.advance(60.0)
    assert np.abs(sim.net.position - before).max() < 1e-12
    assert np.abs(sim.net.velocity).max() < 1e-12


@pytest.mark.slow
@pytest.mark.parametrize("law", [STICKING, REGULARISED | {"friction.slip_speed": 1e-4}])
def test_above_the_friction_angle_it_slides(law: dict[str, Any], tmp_path: Path) -> None:
    """g (sin - mu cos); by the springs that are bent first, some mu p later, and w / sqrt(w2 + v_s2) < 1."""
    sim = on_slope(tmp_path, 35.0, law)
    sim.advance(0.5)
    before = sim.net.velocity.copy()
    sim.advance(0.5)
    angle = math.radians(35.0)
    known = G * (math.sin(angle) - 0.5 * math.cos(angle))
    np.testing.assert_allclose((sim.net.velocity - before)[:, 0] / 0.5, known, rtol=1e-6)


@pytest.mark.slow
def test_the_regularised_law_creeps(tmp_path: Path) -> None:
    """Where mu N w / sqrt(w2 + v_s2) is the weight along the slope: v_s q / sqrt(1 - q2), q = tan / mu."""
    law = REGULARISED | {"friction.slip_speed": 1e-3}
    sim = on_slope(tmp_path, 20.0, law, step=5e-5)  # its damping mu g / v_s is 4900 1/s
    sim.advance(0.2)
    q = math.tan(math.radians(20.0)) / 0.5
    np.testing.assert_allclose(sim.net.velocity[:, 0], 1e-3 * q / math.sqrt(1.0 - q * q), rtol=1e-6)


@pytest.mark.ci
@pytest.mark.slow
def test_a_sliding_net_stops_after_v2_over_2_mu_g(tmp_path: Path) -> None:
    """From 0.5 m/s on the level: 25.5 mm, but for the springs along the surface, mu p / kappa,
    and the first step, in which nothing is remembered yet."""
    speed = 0.5
    sim = on_slope(tmp_path, 0.0, STICKING, f"initial.velocity=[{speed}, 0.0, 0.0]", step=2e-4, hard=2e4)
    start = sim.net.position.copy()
    sim.advance(5.0)
    way = (sim.net.position - start)[:, 0]
    bent = 0.5 * BULLET * G / 2e4 / 0.5  # 10 um, of bullets; they pull their strings back with them
    assert np.abs(way - speed**2 / (2.0 * 0.5 * G)).max() < 2.0 * bent + 1.5 * speed * 2e-4
    assert np.abs(sim.net.velocity).max() < 1e-9
    kinetic = 0.5 * float(sim.start.system.mass[:8].sum()) * speed**2
    assert taken_by_contact(sim)[1] == pytest.approx(kinetic, rel=1e-3)  # all of it, by friction
    assert sim.energy.total == pytest.approx(kinetic, rel=1e-3)


def test_a_sliding_impact_loses_what_damping_and_friction_take(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One bullet against a ball, off all axes of both; the strings are as soft as nothing."""
    monkeypatch.setattr(kernel, "numba_installed", lambda: False)
    corner = 0.5 * SIDE + STRING / math.sqrt(2.0)
    normal = np.array([0.48, 0.6, 0.64])
    centre = np.array([-corner, -corner, 0.0]) - 0.1205 * normal  # 0.5 mm from a ball of 0.1 m
    velocity = np.array([0.5, -0.8, 0.3]) - 1.5 * normal
    shape = 'shape = "box"\nsize = [20.0, 20.0, 0.4]\nedge_radius = 0.05'
    assert shape in PLATE
    text = PLATE.replace(shape, 'shape = "sphere"\nradius = 0.1')
    sim = simulation(
        tmp_path,
        text,
        *contact(
            law="linear",
            stiffness=1e-9,
            bullet_stiffness=2e3,
            damping=0.3,
            **REGULARISED,
            **{"friction.slip_speed": 0.1},
        ),
        f"bodies.plate.position={centre.tolist()}",
        f"initial.velocity={velocity.tolist()}",
        "net.bullets.mass=0.02",
        "solver.step=5e-5",
    )
    before = sim.energy.kinetic
    sim.advance(0.02)
    damping, friction = taken_by_contact(sim)
    assert min(damping, friction) > 1e-3
    assert float(sim.net.velocity[0] @ normal) > 0.3  # it has left
    assert before - sim.energy.kinetic == pytest.approx(
        damping + friction, rel=1e-4
    )  # steps over touch and release


def errors(
    folder: Path, degrees: float, speed: tuple[float, float], method: str, begin: float = 1e-6
) -> Floats:
    """Of places of bullets after 0.05 s in steps of 0.25 ms and its halves [m], against steps of 4 us.

    speed : down the slope and across it [m/s], without damping along the surface
    begin : the first step [s], at whose end anchors are remembered; 0.0: as all others
    """
    found = []
    for step in (1e-3 / 256, 2.5e-4, 1.25e-4, 6.25e-5):
        changes = f'solver.method="{method}"', f"initial.velocity={[*speed, 0.0]}"
        sim = on_slope(folder, degrees, STICKING | {"friction.tangential_damping": 0.0}, *changes, step=step)
        if begin:
            sim.advance(begin)
        sim.advance_to(0.05)
        found.append(sim.net.position[BULLETS].copy())
    return np.abs(np.array(found[1:]) - found[0]).max(axis=(1, 2))


@pytest.mark.slow
def test_sticking_moves_by_the_order_of_the_method(tmp_path: Path) -> None:
    """On springs along the surface, which turn over at 100 rad/s; twice tan 10 deg is below 0.5."""
    found = errors(tmp_path, 10.0, (0.0, 0.0), "VelocityVerlet")
    np.testing.assert_allclose(np.log2(found[:-1] / found[1:]), 2.0, atol=0.2)
    assert errors(tmp_path, 10.0, (0.0, 0.0), "RK44").max() < 1e-9


@pytest.mark.slow
def test_from_slipping_to_sticking_it_is_of_second_order(tmp_path: Path) -> None:
    """The end of the slip is a kink of the force; 0.05 m/s on the level slide for 10 ms."""
    found = errors(tmp_path, 0.0, (0.05, 0.0), "VelocityVerlet")
    assert np.log2(found[0] / found[-1]) / 2.0 == pytest.approx(2.0, abs=0.2)
    assert found.max() < 5e-8
    assert errors(tmp_path, 0.0, (0.05, 0.0), "RK44").max() < 5e-9


@pytest.mark.slow
@pytest.mark.parametrize(
    ("degrees", "speed", "method", "begin"),
    [
        (0.0, (0.05, 0.0), "RK44", 0.0),  # nothing is remembered in the first step: mu g h less of the speed
        (35.0, (0.05, 0.1), "RK44", 1e-6),  # anchors are dragged along at the ends of steps
        (35.0, (0.05, 0.1), "VelocityVerlet", 1e-6),
    ],
)
def test_anchors_of_first_order(
    degrees: float, speed: tuple[float, float], method: str, begin: float, tmp_path: Path
) -> None:
    """A start that presses, and a slide that turns aside."""
    found = errors(tmp_path, degrees, speed, method, begin)
    np.testing.assert_allclose(np.log2(found[:-1] / found[1:]), 1.0, atol=0.15)
    assert begin == 0.0 or found.max() < 6e-6


# Belt friction: the end of a thread is held, a mass hangs from the other, and a drum turns so that it drags
# the thread away from the held end.

RADIUS, PART, FREE = 0.1, 0.015, 4  # m, m; elements beyond the drum on each side
MASS, END = 0.2, 0.4  # kg; s: as mass damping takes half of 100/s, what the start moves is down to exp(-20)
TURN = 0.4  # rad until then; the drum slides at 0.1 m/s


def drum(phi: float) -> str:
    """The scene of a thread that is wrapped by an angle [rad] around a drum about y; its mass is at x > 0."""
    reach = RADIUS + 0.5 * DIAMETER
    count = round(phi * reach / PART)
    angles = np.linspace(phi, 0.0, count + 1)  # from x towards z
    around = reach * np.stack([np.cos(angles), 0.0 * angles, np.sin(angles)], axis=1)
    away = np.arange(1, FREE + 1)[:, None] * phi * reach / count
    # Backwards along the tangent at the beginning of the arc, and downwards from its end.
    back = away * [-math.sin(angles[0]), 0.0, math.cos(angles[0])]
    nodes = np.concatenate([(around[0] + back)[::-1], around, around[-1] - away * [0.0, 0.0, 1.0]])
    h = math.sqrt(0.5)  # a quarter turn about x brings the axis of the drum into y
    attitudes = [
        [c * h, c * h, s * h, -s * h] for c, s in ((1.0, 0.0), (math.cos(0.5 * TURN), math.sin(0.5 * TURN)))
    ]
    return f"""
format = 1
title = "A thread over a drum"
time = {{ end = {END}, output_step = {END} }}
solver = {{ method = "RK44", step = 2.5e-5 }}
engine.backend = "compiled"
initial = {{ packing = 1.0 }}
net.topology = "explicit"
net.nodes = {nodes.tolist()}
net.elements = {[[k, k + 1] for k in range(len(nodes) - 1)]}
net.node_masses = {[0.0] * (len(nodes) - 1) + [MASS]}
net.fixed = [0]
net.cable = {{ diameter = {DIAMETER}, density = {DENSITY}, youngs_modulus = 3e8 }}
effects.gravity.acceleration = [0.0, 0.0, {-G}]
effects.mass_damping.alpha = 100.0
effects.contact = {{ threads = ["drum"], law = "linear", stiffness = 1e5, damping = 5.0 }}
[bodies.drum]
shape = "cylinder"
radius = {RADIUS}
length = 0.5
edge_radius = 0.02
mass = 1.0
motion = "prescribed"
pose_times = [0.0, {END}]
pose_positions = [[0.0, 0.0, 0.0], [0.0, 0.0, 0.0]]
pose_attitudes = {attitudes}
"""


@pytest.mark.ci_for("0.5")
@pytest.mark.slow
@pytest.mark.parametrize(
    ("friction", "phi", "law"),
    [(0.3, math.pi, REGULARISED | {"friction.slip_speed": 1e-4}), (0.5, 0.5 * math.pi, STICKING)],
)
def test_tensions_of_euler_and_eytelwein(
    friction: float, phi: float, law: dict[str, Any], tmp_path: Path
) -> None:
    """T_held = T_mass exp(mu phi) over the angle phi of the wrap."""
    sim = simulation(tmp_path, drum(phi), *contact(**law | {"friction.coefficient": friction}))
    sim.advance(END)
    tension = sim.net.tension
    assert np.abs(sim.net.velocity).max() < 1e-3  # the thread rests, the drum slides
    # What hangs is the mass, and half of each element; the last one bears the mass.
    assert tension[-1] == pytest.approx(MASS * G, rel=2e-3)
    assert tension[0] / tension[-FREE] == pytest.approx(math.exp(friction * phi), rel=0.02)


# What is refused

RULED = "{ law = 'regularised', coefficient = 0.3"
WRONG: dict[str, tuple[list[str], str]] = {
    "no pair": (["threads=", "bullets=", "stiffness=", "bullet_radius=", "bullet_stiffness="], ""),
    "empty pairs": (["threads=[]"], "stiffness"),
    "unknown body": (["threads=['bxo']"], "threads[0]"),
    "twice": (["threads=['box', 'box']"], "threads[1]"),
    "radius alone": (["bullets=", "bullet_stiffness="], "bullet_radius"),
    "no radius": (["bullet_radius="], "bullet_radius"),
    "no stiffness": (["stiffness="], "stiffness"),
    "no stiffness of bullets": (["bullet_stiffness="], "bullet_stiffness"),
    "no modulus": (["law='hertz'", "stiffness=", "bullet_stiffness="], "modulus"),
    "stiffness of hertz": (["law='hertz'", "modulus=1e6", "bullet_stiffness="], "stiffness"),
    "neither damping nor restitution": (["restitution=", "impact_speed="], ""),
    "both": (["damping=0.1"], ""),
    "half": (["impact_speed="], ""),
    "restitution above one": (["restitution=1.1"], "restitution"),
    "no restitution": (["restitution=0.0"], "restitution"),
    "negative friction": (["friction.coefficient=-0.1"], "friction.coefficient"),
    "no slip speed": ([f"friction={RULED} }}"], "friction.slip_speed"),
    "damping without anchors": (
        [f"friction={RULED}, slip_speed = 1.0, tangential_damping = 1.0 }}"],
        "friction.tangential_damping",
    ),
    "ratio": (["friction.tangential_ratio=1.5"], "friction.tangential_ratio"),
    "law": (["law='springs'"], "law"),
    "zero stiffness": (["stiffness=0.0"], "stiffness"),
    "sharp edges": (["../bodies.box.edge_radius="], "threads[0]"),
}


@pytest.mark.parametrize("name", WRONG)
def test_wrong_keys_are_refused(name: str) -> None:
    changes, key = WRONG[name]
    given = [f"effects.contact.{change}".replace("effects.contact.../", "") for change in changes]
    assert f"effects.contact.{key}".removesuffix(".") in refused(NET_ON_BOX, *given)


THIN_LEG = [(-0.05, -0.22), *OUTLINE[1:5], (0.25, -0.22)]
MESHES: dict[str, tuple[Any, float, list[str], str]] = {
    "sharp": (OUTLINE, 0.15, ["edge_radius="], "effects.contact.threads[0]"),
    "coarse": (OUTLINE, 0.15, ["grid_spacing=0.011"], "bodies.box.grid_spacing"),
    "thin everywhere": (OUTLINE, 0.015, [], "bodies.box.edge_radius"),
    "a thin leg": (THIN_LEG, 0.15, [], "bodies.box.edge_radius"),
    "too fine": (OUTLINE, 0.15, ["grid_spacing=1e-4"], "bodies.box.edge_radius"),
}


@pytest.mark.slow_for("a thin leg")
@pytest.mark.parametrize("name", MESHES)
def test_meshes_that_cannot_be_touched_are_refused(name: str, tmp_path: Path) -> None:
    outline, half, changes, key = MESHES[name]
    scene = tmp_path / "scene.toml"
    scene.write_text(NET_ON_BOX)
    mesh = mesh_keys(extruded(outline, half), tmp_path, "box") | {"size": ""}
    keys = [*(f"{name}={value}" for name, value in mesh.items()), "position=[9.0, 0.0, 0.0]", *changes]
    assert refused(scene, *(f"bodies.box.{change}" for change in keys))[0] == key


SPHERE = CASES / "capture" / "fixed_sphere.toml"


@pytest.mark.parametrize("step", ["solver.step=1e-4", "solver.step="])
def test_contact_that_no_step_can_follow_is_refused(step: str) -> None:
    """Not the net's fastest element, which is 10 orders softer."""
    keys = refused(NET_ON_BOX, "effects.contact.stiffness=1e25", step)
    assert keys == ["solver.step" if "1e-4" in step else "effects.contact"]


def test_damping_that_a_step_cannot_follow_is_refused() -> None:
    """A ball that is met at 2 m/s, with the restitution of an impact at 1 mm/s: such a run gained energy."""
    prepare_case(exunet.load(SPHERE))
    slow = ["effects.contact.impact_speed=1e-3", "effects.contact.restitution=0.2"]
    assert refused(SPHERE, *slow) == ["solver.step"]
    elsewhere = [*slow, "initial.velocity=[0.0, 0.0, 0.0]", "bodies.ball.position=[0.0, 0.0, 0.5]"]
    prepare_case(exunet.load(SPHERE, elsewhere))  # nothing comes to it


@pytest.mark.parametrize("radius", [1.0, 10.0])
def test_a_start_with_the_body_in_a_bullet_is_refused(radius: float) -> None:
    """A ball of 0.25 m near a corner of a net with sides of 1.5 m: whole within a bullet of 10 m, for more
    than its middle within a bullet of 1 m.
    """
    keys = [f"effects.contact.bullet_radius={radius}", "bodies.ball.position=[0.6, 0.6, 0.3]"]
    assert refused(SPHERE, *keys) == ["effects.contact"]


@pytest.mark.parametrize("slip_speed", [1e-300, 1e-3, 0.03, 0.1])
def test_steps_too_long_for_smooth_friction_are_noted(slip_speed: float) -> None:
    """Measured with these steps: the energy is off by 2.8e-3, 2.7e-3, 3.4e-4, and by 2.0e-4 as without it."""
    keys = ['effects.contact.friction.law="regularised"', f"effects.contact.friction.slip_speed={slip_speed}"]
    for step, noted in (([], slip_speed < 0.1), (["solver.step=1e-6"], slip_speed < 1e-4)):
        notes = prepare_case(exunet.load(SPHERE, [*keys, *step])).plan.notes
        assert any("does not resolve friction" in note for note in notes) == noted


def test_a_net_without_bullets_has_no_contact_of_bullets() -> None:
    assert "effects.contact.bullets" in refused(NET_ON_BOX, "net.bullets=", "net.strings=")
    point = "bodies.point={mass=1.0, inertia=[1.0, 1.0, 1.0]}"
    assert refused(NET_ON_BOX, point, "effects.contact.threads=['point']") == ["effects.contact.threads[0]"]
    prepare_case(of_text(NET_ON_BOX, "effects.contact.damping=0.0", "effects.contact.restitution=",
                         "effects.contact.impact_speed="))  # fmt: skip


PRESSED = (  # a sphere of 0.05 m, 0.01 m deep in a ball of 0.1 m
    "time.end=0.02", "time.output_step=0.01", "net.nodes=[[0.0, 0.0, 0.14]]", "effects.gravity=",
    "initial.node_velocities=",
    "effects.contact={nodes=['target'], node_radius=0.05, law='linear', node_stiffness=200.0, damping=0.0}",
)  # fmt: skip


@every_backend
def test_contact_at_the_start_is_in_the_first_row(backend: str, tmp_path: Path) -> None:
    """F = k p = 2 N and k p^2 / 2 = 0.01 J; a restart begins with the contact of the state."""
    changes = (*PRESSED, BACKENDS[backend])
    first = stored(tmp_path, case_in(tmp_path, NODE_AND_BALL, *changes))
    names = ("touching", "force", "stored", "first", "deepest", "resultant")
    *keys, resultant = (ContactKey("target", "nodes", name) for name in names)
    found = np.array([first.contacts[key].values[:, 0] for key in keys])
    assert found[:, 0] == pytest.approx([1.0, 2.0, 0.01, 0.0, 0.01], rel=1e-12)
    assert first.contacts[resultant].values[0] == pytest.approx([0.0, 0.0, -2.0], rel=1e-12)
    metrics = summarise(first)["metrics"]
    assert metrics["contact_target_first_s"]["value"] == 0.0
    assert metrics["contact_target_largest_force_N"]["value"] == pytest.approx(2.0, rel=1e-12)
    second = exunet.run(restarted(tmp_path, NODE_AND_BALL, "first@0.01", changes))
    again = [second.contacts[key].values[0, 0] for key in keys[:4]]
    assert again == pytest.approx([*found[:3, 1], 0.0], rel=1e-12)
    assert 0.0 < again[1] < 2.0
