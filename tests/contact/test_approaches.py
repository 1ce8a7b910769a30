"""When a net that opens comes to a box that flies and turns, by small steps; and what an estimate costs."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from contact_scenes import THROWN
from scipy.spatial.transform import Rotation

from exunet.forces.blocks import Blocks
from exunet.forces.effects import switched_on, terms_of
from exunet.forces.effects.contact import ContactConfig as Contact
from exunet.forces.estimate import Approach, EstimateBasis
from exunet.methods.method import Backend
from exunet.model.build import system_of
from exunet.model.effect_survey import approaches, cost_of, finding, setting_of
from exunet.scene.casefile import parse_case

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


def told(place: list[float], end: float, *changes: str) -> tuple[Approach, EstimateBasis]:
    more = (f"bodies.box.position={place}", f"time.end={end}", *OPENS, *changes)
    scene = parse_case(THROWN, Path("thrown.toml"), more).scene
    system, state = system_of(scene, [])
    basis, keys = setting_of(scene, "contact"), switched_on(scene.effects)["contact"]
    assert isinstance(keys, Contact)
    (found,) = approaches(keys, basis, system, state)
    return found, basis


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
def test_when_and_how_fast_it_comes(what: str, place: list[float]) -> None:
    """To one in 2000 parts of the time that is looked at."""
    only = 'threads=["box"]' if what == "threads" else "threads=[]"
    change = ["bullets=[]", "bullet_radius=", "bullet_stiffness="] if what == "threads" else ["stiffness="]
    radius = 0.0 if what == "threads" else 0.01
    found, basis = told(place, 1.0, *(f"effects.contact.{item}" for item in (only, *change)))
    before = np.linspace(0.0, found.time - 1.0 / 2000 - 1e-9, 150)
    assert all(seen(basis, what, place, t)[0].min() > radius for t in before)
    gap, speed = seen(basis, what, place, found.time)
    assert gap.min() <= radius
    assert found.speed == pytest.approx(speed[gap.argmin()], rel=1e-9)
    assert (found.body, found.what, found.distance, found.mass) == ("box", what, 0.0, 0.5)
    assert found.time > 0.02


def test_how_near_it_comes() -> None:
    """To a box beside its way: the least distance of all times, and the speed then."""
    place = [0.9, 0.7, -0.8]
    found, basis = told(place, 0.8, "effects.contact.threads=[]", "effects.contact.stiffness=")
    every = [seen(basis, "bullets", place, t) for t in np.linspace(0.0, 0.8, 200)]
    least = min(range(200), key=lambda k: every[k][0].min())
    assert 20 < least < 180
    assert found.time == np.inf
    nearest = every[least][0].min() - 0.01
    assert nearest * (1.0 - 1e-3) < found.distance < nearest * 1.02  # it goes on by as much as it is away
    assert found.speed == pytest.approx(every[least][1][every[least][0].argmin()], rel=0.05)


def test_threads_that_lie_on_a_side_of_a_box() -> None:
    """Its mean shadow is a quarter of its surface; as many lie on it as the whole net has for each area."""
    found, basis = told([0.35, 0.3, -0.5], 1.0)
    surface = 2.0 * (0.25 * 0.2 + 0.2 * 0.1 + 0.1 * 0.25)
    count = basis.net.n_net_elements
    length = float(basis.net.reference_length.sum())
    known = length * surface / 4.0 / basis.size**2 / (length / count)
    assert count > round(known) > 1
    assert found.touching == round(known)


def costs(backend: Backend, name: str, **keys: Any) -> tuple[float, Blocks]:
    scene = parse_case(
        THROWN, Path("thrown.toml"), [f"effects.{name}={{{', '.join(f'{k}={v}' for k, v in keys.items())}}}"]
    )
    basis = setting_of(scene.scene, name)
    blocks = Blocks.of(basis.net, basis.position, (), (), ())
    return cost_of(terms_of(name, switched_on(scene.scene.effects)[name], blocks), blocks, backend), blocks


def test_what_terms_cost() -> None:
    """Nanoseconds over those of the bare net: of a step, and 250 or 7 of each element."""
    bare = {Backend.EXUDYN: (1000.0, 250.0), Backend.COMPILED: (0.0, 7.0)}
    for backend, (fixed, each) in bare.items():
        cost, blocks = costs(backend, "gravity", acceleration=[0.0, 0.0, -9.81])
        whole = fixed + each * blocks.net.n_elements
        load = 3.0 * blocks.n_points + (80.0 * blocks.n_points if backend == Backend.EXUDYN else 0.0)
        assert cost == pytest.approx(load / whole, rel=1e-12)
        cost, _ = costs(backend, "material_damping", relaxation_time=1e-4)
        assert cost == pytest.approx(3.0 * blocks.net.n_elements / whole, rel=1e-12)


def test_a_displacement_is_told_as_a_part_of_the_nets_size() -> None:
    scene = parse_case(THROWN, Path("thrown.toml"), ["effects.gravity.acceleration=[0.0, 0.0, -9.81]"]).scene
    found = finding(scene, "gravity")
    assert found.estimate is not None
    assert found.relative == pytest.approx(
        found.estimate.displacement / (0.4 + 0.2 * math.sqrt(0.5)), rel=1e-12
    )


BALL = (
    "bodies.ball={shape='sphere', radius=0.1, mass=1.5, position=[1.25, 2.2, 1.92], "
    "velocity=[-0.5, 0.05, 0.0]%s}"
)


@pytest.mark.parametrize(("motion", "mass"), [("", 0.5 * 1.5 / 2.0), (", motion='fixed'", 0.5)])
def test_how_two_bodies_meet(motion: str, mass: float) -> None:
    """3 m apart, (1, 2, 2) m: it comes along x at 0.5 m/s, of which a third is on the line."""
    ball = BALL % motion if not motion else BALL.replace(", velocity=[-0.5, 0.05, 0.0]", "") % motion
    more = ["effects.contact.bodies=[['box', 'ball']]", "effects.contact.body_stiffness=1e4", ball]
    (found,) = setting_of(parse_case(THROWN, Path("thrown.toml"), more).scene).meetings
    assert found.bodies == ("ball", "box")
    assert found.mass == pytest.approx(mass, rel=1e-12)
    speed = 0.5 / 3.0 if not motion else 0.05 * 2.0 / 3.0
    assert found.speed == pytest.approx(speed, rel=1e-12)
    corner = float(np.linalg.norm(SIZE)) / 2.0
    assert found.distance == pytest.approx(3.0 - 0.1 - corner, rel=1e-3)
