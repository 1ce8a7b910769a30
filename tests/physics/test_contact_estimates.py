"""Estimates of contact before a run: approaches, impacts, and the step that damping and friction allow."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scenes import CASES, NET_ON_BOX, of_text
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

import exunet
from exunet.forces.contact.estimate import (
    damping_rate,
    friction_rate,
    speed_of_bodies,
    speed_of_net,
    speed_of_threads,
)
from exunet.forces.contact.law import Friction
from exunet.forces.effects.contact import Contact
from exunet.forces.estimate import Approach, EstimateBasis
from exunet.model.build import system_of
from exunet.model.effect_survey import approaches, setting_of
from exunet.scene.scene import Scene
from exunet.simulation.preparation import prepare_case

SIZE = np.array([0.25, 0.2, 0.1])
TURNED = Rotation.from_rotvec([0.4, -0.7, 0.3])
SPEED, SPIN = np.array([-0.2, 0.05, 0.4]), np.array([1.3, -0.8, 2.5])
# It opens from half of its size, sideways as it flies along -z.
OPENS = (
    "initial={packing=0.5}",
    "launch={radial_speed=1.0, axial_speed=-1.5}",
    f"bodies.box.attitude={TURNED.as_quat(scalar_first=True).tolist()}",
    f"bodies.box.velocity={SPEED.tolist()}",
    f"bodies.box.angular_velocity={SPIN.tolist()}",
)


def first_approach(scene: Scene, what: str) -> tuple[Approach, EstimateBasis]:
    """Of "threads" or "bullets" to the touched body."""
    system, state = system_of(scene, [])
    basis, keys = setting_of(scene, "contact"), scene.effects.get(Contact)
    assert keys is not None
    found, *_ = (item for item in approaches(keys, basis, system, state) if item.what == what)
    return found, basis


def approach_of(what: str, place: list[float], end: float, *changes: str) -> tuple[Approach, EstimateBasis]:
    more = (f"bodies.box.position={place}", f"time.end={end}", *OPENS, *changes)
    return first_approach(of_text(NET_ON_BOX, *more).scene, what)


def seen(basis: EstimateBasis, what: str, place: list[float], time: float) -> tuple[np.ndarray, np.ndarray]:
    """Distances from the box [m], and speeds against what it is made of [m/s], of bullets or threads."""
    net = basis.net
    common = net.mass @ basis.motion / net.mass.sum()
    opening = basis.motion - common
    x = basis.position + common * time + opening * min(time, basis.opening_time)
    v = common + opening * (time < basis.opening_time)
    if what == "bullets":
        x, v = x[net.bullet_nodes], v[net.bullet_nodes]
    else:
        parts = np.array([0.0, 0.25, 0.5, 0.75, 1.0])[:, None, None]
        i, j = net.element_nodes.T
        x, v = (((1.0 - parts) * item[i] + parts * item[j]).reshape(-1, 3) for item in (x, v))
    turn = TURNED * Rotation.from_rotvec(SPIN * time)
    arm = x - np.array(place) - SPEED * time
    own = turn.inv().apply(arm)
    against = v - SPEED - np.cross(turn.apply(SPIN), arm)
    return np.linalg.norm(np.maximum(abs(own) - SIZE / 2, 0.0), axis=1), np.linalg.norm(against, axis=1)


@pytest.mark.parametrize(
    ("what", "place"),
    [("bullets", [0.35, 0.3, -0.5]), ("threads", [0.05, 0.1, -0.3])],
)
def test_time_and_speed_of_the_first_contact(what: str, place: list[float]) -> None:
    """To 1/2000 of the duration."""
    only = 'threads=["box"]' if what == "threads" else "threads=[]"
    change = ["bullets=[]", "bullet_radius=", "bullet_stiffness="] if what == "threads" else ["stiffness="]
    radius = 0.0 if what == "threads" else 0.01
    found, basis = approach_of(what, place, 1.0, *(f"effects.contact.{item}" for item in (only, *change)))
    before = np.linspace(0.0, found.time - 1.0 / 2000 - 1e-9, 150)
    assert all(seen(basis, what, place, t)[0].min() > radius for t in before)
    gap, speed = seen(basis, what, place, found.time)
    assert gap.min() <= radius
    assert found.speed == pytest.approx(speed[gap.argmin()], rel=1e-9)
    assert (found.body, found.what, found.distance, found.mass) == ("box", what, 0.0, 0.5)
    assert found.time > 0.02


@pytest.mark.parametrize(
    ("case", "time", "apart"),
    [
        ("capture/fixed_sphere.toml", (0.5 - 0.25) / 2.0, 0.0),  # 0.25 m before its middle, at 2 m/s
        ("capture/box.toml", 0.1846, 0.0),  # first contacts of runs, as the heads of the cases have them
        ("missions/closed_box.toml", 0.155, 0.0),
        ("capture/miss.toml", math.inf, 1.2 - 0.25 - 0.735),  # 1.2 m beside a ball, 0.735 m of the net
    ],
)
def test_first_contacts_of_shipped_cases(case: str, time: float, apart: float) -> None:
    found, _ = first_approach(exunet.load(CASES / case).scene, "threads")
    assert found.time == pytest.approx(time, rel=0.02)
    assert found.distance == pytest.approx(apart, abs=0.01)


MASS, STIFFNESS = 0.02, 5e3  # kg, N/m^n


@pytest.mark.parametrize("exponent", [1.0, 1.5])
@pytest.mark.parametrize("hit", [1e-3, 0.3, 2.0, 30.0, 1000.0])
def test_the_bound_is_that_of_an_impact(hit: float, exponent: float) -> None:
    """Of m p'' = -k p^n (1 + a p'), p' = 1 m/s at first: the most of a k p^n / m until it turns back."""

    def rates(t: float, y: np.ndarray) -> list[float]:
        depth, speed = max(y[0], 0.0), y[1]
        return [speed, -STIFFNESS * depth**exponent * max(1.0 + hit * speed, 0.0) / MASS]

    def turns(t: float, y: np.ndarray) -> float:
        return float(y[1])

    turns.terminal, turns.direction = True, -1.0  # type: ignore[attr-defined]
    deepest = ((exponent + 1.0) / 2.0 * MASS / STIFFNESS) ** (1.0 / (exponent + 1.0))
    found = solve_ivp(rates, (0.0, 1.0), [0.0, 1.0], events=turns, rtol=1e-8, atol=1e-12, method="LSODA")
    depth = float(found.y[0].max())
    assert 0.0 < depth <= deepest * (1.0 + 1e-6)
    most = hit * STIFFNESS * depth**exponent / MASS
    slope = exponent * STIFFNESS * deepest ** (exponent - 1.0)
    bound = damping_rate(hit, slope / MASS, 1.0, exponent)
    assert most < bound
    assert bound < 3.0 * most


@pytest.mark.parametrize("exponent", [1.0, 1.5, 3.0])
def test_the_slope_of_friction_is_at_most_that_of_an_impact(exponent: float) -> None:
    """Of N = k p^n where m v^2 / 2 = k p^(n + 1) / (n + 1): exactly so of a linear force."""
    speed, rubs = 2.0, Friction(0.3, 0.01)
    depth = (0.5 * (exponent + 1.0) * MASS * speed**2 / STIFFNESS) ** (1.0 / (exponent + 1.0))
    slope = exponent * STIFFNESS * depth ** (exponent - 1.0)
    steepest = 0.3 * STIFFNESS * depth**exponent / (MASS * 0.01)
    bound = friction_rate(rubs, slope / MASS, speed)
    assert steepest <= bound * (1.0 + 1e-12)
    assert bound < 1.3 * steepest
    assert (bound < steepest * (1.0 + 1e-12)) == (exponent == 1.0)
    assert friction_rate(Friction(0.3), slope / MASS, speed) == 0.0


def test_speeds_are_those_of_the_start() -> None:
    """A net at (0.1, 0, -1) m/s, a box at (0, 0.05, 0) m/s that turns at (0.3, -0.2, 0.5) rad/s."""
    blocks = prepare_case(of_text(NET_ON_BOX)).system.blocks
    against = math.sqrt(0.1**2 + 0.05**2 + 1.0)
    spin = math.sqrt(0.3**2 + 0.2**2 + 0.5**2)
    assert speed_of_net(blocks, "box", 0.0) == pytest.approx(against, rel=1e-12)
    assert speed_of_net(blocks, "box", 0.2) == pytest.approx(against + 0.2 * spin, rel=1e-12)
    assert speed_of_bodies(blocks, "box", "box", (0.1, 0.2)) == pytest.approx(0.3 * spin, rel=1e-12)
    assert speed_of_threads(blocks) == pytest.approx(against, rel=1e-12)


def test_a_throw_that_comes_later_counts() -> None:
    case = exunet.load(CASES / "missions" / "throw_close_tow.toml")
    start = prepare_case(case)
    nodes = slice(start.net.n_nodes)
    assert np.abs(start.velocity[nodes]).max() < 0.1
    assert 1.5 < speed_of_net(start.system.blocks, "box", 0.0) < 3.0
