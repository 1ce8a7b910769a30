"""Impacts on a plate and friction on it, in the compiled loop: known answers."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from contact_scenes import (
    DENSITY,
    DIAMETER,
    HERTZ,
    LINEAR,
    PLATE,
    SIDE,
    STRING,
    as_mesh,
    contact,
    simulation,
    taken_by_contact,
)
from scipy.optimize import brentq
from scipy.special import gamma

import exunet
from exunet.forces.contact.status import status_of

pytestmark = pytest.mark.slow  # one kernel, compiled in a minute

Floats = np.ndarray
LINE_MASS = DENSITY * math.pi / 4.0 * DIAMETER**2  # kg/m
G = 9.81  # m/s2
BULLETS, THREADS = slice(0, 4), slice(4, 8)  # nodes
FALL: Sequence[str] = ("initial.velocity=[0.0, 0.0, -1.0]",)


def bounced(
    folder: Path, which: slice, keys: dict[str, Any], *changes: str, until: float = 0.1, text: str = PLATE
) -> float:
    """The speed [m/s] at which knots or bullets leave the plate, all of them the same."""
    sim = simulation(folder, text, *contact(**keys), *(changes or FALL))
    sim.advance(until)
    velocity = sim.net.velocity[which]
    assert np.ptp(velocity[:, 2]) < 1e-9
    memory = sim.view.memory[f"contact/{'threads' if which is THREADS else 'bullets'}/plate"]
    assert status_of(memory).first_touch > 0.0
    return float(velocity[0, 2])


# Laws and masses of bullets, or densities of threads; steps follow, about 1500 in each impact.
IMPACTS: dict[str, tuple[slice, dict[str, Any], Sequence[str]]] = {
    "threads": (THREADS, LINEAR, ("net.bullets.mass=1e-12",)),
    "heavier threads": (
        THREADS,
        LINEAR | {"stiffness": 5e4},
        ("net.cable.density=8000.0", "net.strings.density=8000.0"),
    ),
    "threads, hertz": (THREADS, HERTZ | {"bullet_radius": 1e-12}, ("net.bullets.mass=1e-12",)),
    "bullets": (BULLETS, LINEAR | {"stiffness": 1e-9, "bullet_stiffness": 2e3}, ("net.bullets.mass=0.05",)),
    "heavier bullets": (
        BULLETS,
        LINEAR | {"stiffness": 1e-9, "bullet_stiffness": 3e4},
        ("net.bullets.mass=2.0",),
    ),
    "bullets, hertz": (BULLETS, {"law": "hertz", "modulus": 2e5}, ("net.bullets.mass=0.1",)),
}


ON_MESHES = [("threads", "mesh"), ("bullets", "mesh")]


@pytest.mark.ci_for("heavier bullets-solid-0.5")
@pytest.mark.slow
@pytest.mark.parametrize("restitution", [0.9, 0.5, 0.2])
@pytest.mark.parametrize(("name", "shape"), [*((name, "solid") for name in IMPACTS), *ON_MESHES])
def test_restitution_is_what_was_stated(name: str, shape: str, restitution: float, tmp_path: Path) -> None:
    """The distance from a plane face of a mesh is exact, so that this is as exact as with a solid."""
    which, keys, changes = IMPACTS[name]
    text = PLATE
    if shape == "mesh":
        text = as_mesh(tmp_path, PLATE, (4.0, 4.0, 0.4), "grid_spacing = 0.025")
    keys = keys | {"restitution": restitution, "impact_speed": 1.0}
    step = 2e-6 if which is THREADS else 2e-5
    soon = 0.098  # before threads, which nothing stops beside bullets, are too deep to be followed
    found = bounced(tmp_path, which, keys, *FALL, *changes, f"solver.step={step}", until=soon, text=text)
    assert found == pytest.approx(restitution, abs=1e-6)


@pytest.mark.ci_for("0.4")
@pytest.mark.slow
@pytest.mark.parametrize("speed", [0.4, 3.0])
def test_at_another_speed_restitution_is_what_the_relation_says(speed: float, tmp_path: Path) -> None:
    """With a of e = 0.5 at 1 m/s: d (1 + e) = ln((1 + d) / (1 - e d)), d = a v."""

    def relation(d: float, e: float) -> float:
        return d * (1.0 + e) - math.log((1.0 + d) / (1.0 - e * d))

    a = brentq(lambda d: relation(d, 0.5), 0.1, 1.99, xtol=1e-15)
    d = a * speed
    e = brentq(lambda e: relation(d, e), 1e-3, min(1.0, 1.0 / d) - 1e-3, xtol=1e-15)
    which, keys, changes = IMPACTS["bullets"]
    keys = keys | {"restitution": 0.5, "impact_speed": 1.0}
    fall = f"initial.velocity=[0.0, 0.0, {-speed}]"
    soon = 0.098 / speed  # before threads, which nothing stops here, are too deep to be followed
    found = bounced(tmp_path, which, keys, fall, *changes, "solver.step=2e-5", until=soon)
    assert found / speed == pytest.approx(e, abs=1e-6)


@pytest.mark.slow
def test_the_time_of_a_hertzian_impact(tmp_path: Path) -> None:
    """2.94 x_m / v with x_m = (5 m v^2 / (4 k))^(2/5): Johnson, "Contact Mechanics" (1985), eq. (11.24)."""
    _, keys, changes = IMPACTS["bullets, hertz"]
    keys = keys | {"damping": 0.0}
    step = 2e-5
    sim = simulation(tmp_path, PLATE, *contact(**keys), *FALL, *changes, f"solver.step={step}")
    mass = float(sim.start.system.mass[0])
    k = 4.0 / 3.0 * 2e5 * math.sqrt(0.02)
    deepest = (1.25 * mass / k) ** 0.4
    known = 2.0 * deepest * math.sqrt(math.pi) * gamma(0.4) / (5.0 * gamma(0.9)) * 2.0
    assert known == pytest.approx(2.94 * deepest, rel=2e-3)
    sim.advance(0.1)
    # It flew 0.03 m at 1 m/s, stayed for the time, and flies back at 1 m/s.
    assert sim.net.velocity[0, 2] == pytest.approx(1.0, abs=1e-6)
    height = sim.net.position[0, 2] - (-0.05 + 0.02)
    assert 0.1 - 0.03 - height == pytest.approx(known, rel=1e-6)
    status = status_of(sim.view.memory["contact/bullets/plate"])
    assert status.depth == pytest.approx(deepest, rel=1e-6)
    assert status.first_touch == pytest.approx(0.03, abs=1.5 * step)


# Friction


RUBBING = {"law": "linear", "damping": 2.0}
BULLET = 0.02  # kg


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
    deep = LINE_MASS * G * math.cos(angle) / hard
    bullet = BULLET * G * math.cos(angle) / hard
    return simulation(
        folder,
        PLATE,
        *contact(
            **RUBBING,
            **friction,
            stiffness=hard,
            bullet_stiffness=hard,
            bullet_radius=0.5 * DIAMETER - deep + bullet,
        ),
        f"effects.gravity.acceleration={weight}",
        f"bodies.plate.position=[0.0, 0.0, {-0.2 - 0.5 * DIAMETER + deep}]",
        f"net.bullets.mass={BULLET}",
        f"solver.step={step}",
        *changes,
    )


STICKING: dict[str, Any] = {"friction.coefficient": 0.5, "friction.law": "sticking"}
REGULARISED: dict[str, Any] = {"friction.coefficient": 0.5, "friction.law": "regularised"}


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


@pytest.mark.ci
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
    known = speed**2 / (2.0 * 0.5 * G)
    bent = 0.5 * BULLET * G / 2e4 / 0.5  # 10 um, of bullets; they pull their strings back with them
    assert np.abs(way - known).max() < 2.0 * bent + 1.5 * speed * 2e-4
    assert np.abs(sim.net.velocity).max() < 1e-9
    book = sim.energy
    kinetic = 0.5 * float(sim.start.system.mass[:8].sum()) * speed**2
    assert taken_by_contact(sim)[1] == pytest.approx(kinetic, rel=1e-3)  # all of it, by friction
    assert book.total == pytest.approx(kinetic, rel=1e-3)


# Order of steps: bullets on the slope.


def placed(
    folder: Path, degrees: float, speed: float | tuple[float, float], method: str, step: float, begin: float
) -> Floats:
    """Places of the bullets after 0.05 s, without damping along the surface, from a speed [m/s] along it.

    speed : down the slope, or that and across it
    begin : the first step [s], at whose end anchors are remembered; 0.0: as all others
    """
    along = (*speed, 0.0) if isinstance(speed, tuple) else (speed, 0.0, 0.0)
    changes = f'solver.method="{method}"', f"initial.velocity={list(along)}"
    law = STICKING | {"friction.tangential_damping": 0.0}
    sim = on_slope(folder, degrees, law, *changes, step=step)
    if begin:
        sim.advance(begin)
    sim.advance_to(0.05)
    return sim.net.position[BULLETS].copy()


def errors(folder: Path, *scene: Any, begin: float = 1e-6) -> Floats:
    """Of steps of 0.25 ms and its halves [m], against those of 4 us."""
    known = placed(folder, *scene, 1e-3 / 256, begin)
    found = [placed(folder, *scene, step, begin) - known for step in (2.5e-4, 1.25e-4, 6.25e-5)]
    return np.abs(found).max(axis=(1, 2))


@pytest.mark.slow
def test_what_sticks_moves_by_the_order_of_the_method(tmp_path: Path) -> None:
    """On springs along the surface, which turn over at 100 rad/s; twice tan 10 deg is below 0.5."""
    found = errors(tmp_path, 10.0, 0.0, "VelocityVerlet")
    np.testing.assert_allclose(np.log2(found[:-1] / found[1:]), 2.0, atol=0.2)
    assert errors(tmp_path, 10.0, 0.0, "RK44").max() < 1e-9


@pytest.mark.slow
def test_from_slipping_straight_on_to_sticking_it_is_of_second_order(tmp_path: Path) -> None:
    """The end of the slip is a kink of the force; 0.05 m/s on the level slide for 10 ms."""
    found = errors(tmp_path, 0.0, 0.05, "VelocityVerlet")
    assert np.log2(found[0] / found[-1]) / 2.0 == pytest.approx(2.0, abs=0.2)
    assert found.max() < 5e-8
    assert errors(tmp_path, 0.0, 0.05, "RK44").max() < 5e-9


@pytest.mark.slow
def test_a_start_that_presses_is_of_first_order(tmp_path: Path) -> None:
    """Nothing is remembered in its first step, so that friction takes mu g h less of the speed."""
    found = errors(tmp_path, 0.0, 0.05, "RK44", begin=0.0)
    np.testing.assert_allclose(np.log2(found[:-1] / found[1:]), 1.0, atol=0.15)


@pytest.mark.slow
def test_a_slide_that_turns_aside_is_of_first_order(tmp_path: Path) -> None:
    """Anchors are dragged along at the ends of steps, and friction points to where they were."""
    for method in ("VelocityVerlet", "RK44"):
        found = errors(tmp_path, 35.0, (0.05, 0.1), method)
        np.testing.assert_allclose(np.log2(found[:-1] / found[1:]), 1.0, atol=0.15)
        assert found.max() < 6e-6
