"""Forces of two bodies in contact at states: known answers, continuity, momentum, work; interpreted."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from scenes import BALLS, FRICTION, ODD, TWO_BODIES, Floats, Placed, of_text

from exunet.bodies.distance import distances
from exunet.bodies.rotations import product, rotation_matrix
from exunet.forces.terms import KernelTerm, copied
from exunet.simulation.preparation import prepare_case

STIFFNESS = 1e4  # N/m, of the scene

NAMES = ("one", "other")

# A box over a plate, whose upper face is the plane z = 0.
PLATE = 'bodies.other={shape="box",size=[4.0,4.0,0.4],edge_radius=0.05,mass=5.0,position=[0.0,0.0,-0.2]}'

BOX = 'bodies.one={shape="box",size=[0.4,0.3,0.2],edge_radius=0.03,mass=2.0,position=[0.0,0.0,1.0]}'

BALL = 'bodies.one={shape="sphere",radius=0.1,mass=2.0,position=[0.0,0.0,1.0]}'


@dataclass(frozen=True, eq=False)
class Pressed:
    """Forces (3,) [N] and torques (3,) [N m] about each centre, in the scene's axes, by body; depth [m].

    gained : momentum and angular momentum in sum [N, N m].
    """

    force: dict[str, Floats]
    torque: dict[str, Floats]
    depth: float
    power: float
    taken: Floats
    gained: tuple[float, float]


class Scene(Placed):
    """A start, and what contact does when its bodies are somewhere else."""

    def __init__(self, *changes: str) -> None:
        super().__init__(prepare_case(of_text(TWO_BODIES, *changes)))
        self._axes = {name: self.attitude(name).copy() for name in NAMES}

    def terms(self) -> list[tuple[KernelTerm, Any]]:
        return [(term, data) for term, data in super().terms() if term.discrete.name.startswith("contact/")]  # type: ignore[union-attr]

    def place(self, name: str, centre: Any = None, attitude: Any = None) -> None:
        """Put a body somewhere: its centre of mass (3,) [m], a quaternion of its frame (4,)."""
        if centre is not None:
            self.centre(name)[:] = centre
        if attitude is not None:
            turned = np.array(attitude) / np.linalg.norm(attitude)
            self.attitude(name)[:] = product(turned, self._axes[name])

    def move(self, name: str, velocity: Any, spin: Any) -> None:
        """Velocities (3,) [m/s], and (3,) [rad/s] in its principal axes."""
        self.v[self.blocks.centre(name) :][:3] = velocity
        self.v[self.blocks.spin(name) :][:3] = spin

    def pressed(self, *discrete_states: Any) -> Pressed:
        """At this state; discrete_states : data of the terms, where what happened before counts."""
        force, depth = np.zeros(self.blocks.n_force), 0.0
        for k, (term, fresh) in enumerate(self.terms()):
            data = discrete_states[k] if discrete_states else copied(fresh)
            term.add(0.0, self.x, self.v, data, force)
            depth = max(depth, data.now[0])
        on = {name: force[self.blocks.centre(name) :][:3].copy() for name in NAMES}
        torque = {name: self.turn(name) @ force[self.blocks.spin(name) :][:3] for name in NAMES}
        at = self.blocks.rate("contact/damping")
        power = float(force[: self.blocks.n_v] @ self.v[: self.blocks.n_v])
        return Pressed(on, torque, depth, power, force[at : at + 2].copy(), self.gained(force))


def random_states(scene: Scene, count: int) -> Any:
    """States of two odd bodies that press into each other, by no more than a run may have."""
    random = np.random.default_rng(20261123)
    allowed = min(data.allowed for _, data in scene.terms())
    while count:
        for name in NAMES:
            scene.place(name, 0.18 * random.normal(size=3), random.normal(size=4))
            scene.move(name, random.normal(size=3), random.normal(size=3))
        found = scene.pressed()
        if 0.0 < found.depth < 0.9 * allowed:
            count -= 1
            yield found


@pytest.mark.parametrize(
    "changes", [(), (*FRICTION, "effects.contact.damping=0.2")], ids=["smooth", "rubbing"]
)
def test_forces_follow_from_the_energy_and_change_no_momentum(changes: tuple[str, ...]) -> None:
    """Six states of a box and a body of three solids: the power is that of the energy and the losses."""
    scene = Scene(*ODD, *changes)
    for found in random_states(scene, 6):
        assert found.power == pytest.approx(-scene.rate_of_energy() - found.taken.sum(), rel=1e-6, abs=1e-4)
        assert (found.taken[1] > 0.0, found.taken.any()) == (bool(changes), bool(changes))
        size = np.linalg.norm(found.force["one"])
        assert found.gained[0] <= 1e-15 * size
        assert found.gained[1] < 1e-13 * size


def test_two_balls_press_with_the_overlap() -> None:
    """k p for the linear law; 4/3 E* sqrt(R R' / (R + R')) p^1.5 by Hertz: Johnson (1985), eq. (4.23)."""
    hertz = 'effects.contact={bodies=[["one","other"]],law="hertz",modulus=1e6,damping=0.0}'
    known = 4.0 / 3.0 * 1e6 * math.sqrt(0.3 * 0.2 / 0.5) * 0.01**1.5
    for changes, force in (((), STIFFNESS * 0.01), ((hertz,), known)):
        scene = Scene(*BALLS, *changes)
        scene.place("one", [0.0, 0.0, 0.0])
        scene.place("other", [0.294, 0.392, 0.0])  # 0.49 m away
        found = scene.pressed()
        assert found.depth == pytest.approx(0.01, rel=1e-12)
        assert found.force["other"] == pytest.approx([0.6 * force, 0.8 * force, 0.0], rel=1e-12)
        assert np.abs(found.torque["other"]).max() < 1e-13 * force


def test_a_ball_is_pressed_by_face_edge_and_corner_alike() -> None:
    """k p along the line to the nearest point of the core of the box, which ends 0.05 m inside its faces."""
    scene = Scene(BALL, PLATE)
    near = {(0.3, -0.2, -0.05): (0, 0, 1), (1.95, 0.4, -0.05): (3, 0, 4), (1.95, 1.95, -0.05): (1, 2, 2)}
    for place, way in near.items():
        n = np.array(way) / np.linalg.norm(way)
        scene.place("one", np.array(place) + (0.15 - 0.004) * n)
        found = scene.pressed()
        assert found.force["one"] == pytest.approx(STIFFNESS * 0.004 * n, rel=1e-9, abs=1e-9)


@pytest.mark.parametrize("ball", [True, False])
def test_no_force_jumps_over_faces_edges_and_corners(ball: bool) -> None:
    """On a way past a corner, and turning through face on face: half of a step changes half as much.

    The nearest points jump there: by 0.4 m as the lower face of the box turns through that of the plate.
    """
    scene = Scene(BALL if ball else BOX, PLATE)

    def force(s: float) -> Floats:
        if ball:
            scene.place("one", [1.97 + 0.1 * s, 1.95 + 0.12 * s, 0.09 - 0.02 * s])
        else:
            scene.place("one", [0.0, 0.0, 0.097], [1.0, 0.01 * s, 0.013 * s, 0.0])
        found = scene.pressed()
        return np.concatenate([found.force["one"], found.torque["one"]])

    changes = []
    for count in (30, 60, 120):
        values = np.array([force(s) for s in np.linspace(-1.0, 1.0, count + 1)])
        changes.append(np.abs(np.diff(values, axis=0)).max())
    assert changes[0] > 0.1  # N, N m
    assert changes[1] < 0.6 * changes[0]
    assert changes[2] < 0.6 * changes[1]


def test_face_on_face_presses_in_the_middle() -> None:
    """Corners with k each, edges with K = k / (0.03 + 0.05) on lengths of 0.34 m and 0.24 m, and upright ones
    with K p^2 / 2; no torque at noise.
    """
    scene = Scene(BOX, PLATE)
    for noise in (0.0, 1e-15, -1e-15):
        scene.place("one", [0.1, -0.2, 0.1 - 1e-3], [1.0, noise, -noise, 0.0])
        found = scene.pressed()
        known = STIFFNESS * 1e-3 * (4.0 + 2.0 * (0.34 + 0.24 + 1e-3) / 0.08)
        assert found.force["one"][2] == pytest.approx(known, rel=1e-9)
        assert np.abs(found.torque["one"]).max() < 1e-8 * known


def test_nothing_that_overlaps_is_missed() -> None:
    """Rounded boxes overlap where their cores are nearer than both roundings: there they push, else not."""
    scene = Scene(BOX, BOX.replace("one", "other").replace("1.0]}", "-1.0]}"))
    random = np.random.default_rng(7)
    shape = scene.start.system.bodies[0].shape
    assert shape is not None
    (solid,) = shape.solids
    inner = type(shape)((type(solid)("box", (0.34, 0.24, 0.14), solid.position, solid.attitude),))
    met = 0
    for _ in range(60):
        poses = [np.concatenate([0.12 * random.normal(size=3), random.normal(size=4)]) for _ in NAMES]
        for name, pose in zip(NAMES, poses, strict=True):
            pose[3:] /= np.linalg.norm(pose[3:])
            scene.place(name, pose[:3], pose[3:])
        gap = float(distances(inner, poses[0][None], inner, poses[1][None])[0])
        if gap == 0.0:
            continue
        found = scene.pressed()
        assert (found.depth > 0.0) == (gap < 0.06)
        # along edges it is the largest at the places of a rule of integration
        assert 0.95 * (0.06 - gap) < found.depth < 0.06 - gap + 1e-9 or found.depth == 0.0
        met += found.depth > 0.0
    assert 5 < met < 50


def test_friction_acts_where_the_surfaces_are() -> None:
    """A ball that spins on a plate: mu N on its lowest point; the lever is its radius less half the depth."""
    scene = Scene(BALL, PLATE, *FRICTION)
    scene.place("one", [0.2, 0.1, 0.1 - 2e-3])
    scene.move("one", [0.0, 0.0, 0.0], [0.0, 5.0, 0.0])
    found = scene.pressed()
    push, lever = STIFFNESS * 2e-3, 0.1 - 1e-3
    slip = 5.0 * lever
    rubbed = 0.3 * push * slip / math.hypot(slip, 1e-2)
    assert found.force["one"] == pytest.approx([rubbed, 0.0, push], rel=1e-9)
    assert found.torque["one"] == pytest.approx([0.0, -lever * rubbed, 0.0], rel=1e-9)
    assert found.taken == pytest.approx([0.0, rubbed * slip], rel=1e-9)


STICKING = (
    "effects.contact.friction.coefficient=0.3",
    'effects.contact.friction.law="sticking"',
    "effects.contact.friction.tangential_ratio=0.7",
    "effects.contact.friction.tangential_damping=1.5",
    "effects.contact.damping=0.2",
)


def test_friction_with_memory_holds_a_ball_by_a_point_of_each_body() -> None:
    """Damping alone, then the spring between both points, then one that slides; all moves and turns.

    Both points are where the surfaces are at the end of a step, apart by what the spring is stretched by.
    What is remembered of a state gives the same force there.
    """
    scene = Scene(BALL, PLATE, *STICKING)
    random = np.random.default_rng(3)
    attitude = random.normal(size=4)
    turn = rotation_matrix(attitude / np.linalg.norm(attitude))
    scene.place("other", random.normal(size=3), attitude)
    middle = scene.centre("other") + turn @ [0.7, -0.4, 0.3 - 0.004]
    scene.place("one", middle, random.normal(size=4))
    for name in NAMES:
        scene.move(name, 0.02 * random.normal(size=3), 0.05 * random.normal(size=3))
    apart = scene.velocity(middle, "one") - scene.velocity(middle, "other")
    scene.v[scene.blocks.centre("one") :][:3] -= turn[:, 2] * (apart @ turn[:, 2] + 0.002)  # it goes deeper
    ((term, fresh),) = scene.terms()
    data: Any = copied(fresh)
    spring = 0.7 * STIFFNESS
    theta = 2.0 * 1.5 * math.sqrt(2.0 * 5.0 / 7.0 / spring)
    assert data.springs.along == pytest.approx([spring], rel=1e-12)
    assert data.springs.relaxation == pytest.approx([theta], rel=1e-12)
    points, slid = (np.zeros(3), np.zeros(3)), []
    for time in (0.0, 0.01, 0.01, 0.15):
        scene.move_on(time)
        axis = scene.turn("other")[:, 2]
        one, other = (scene.centre(name) for name in NAMES)
        depth = 0.3 - float((one - other) @ axis)
        q = one - (0.1 - 0.5 * depth) * axis
        rate = -float((scene.velocity(one, "one") - scene.velocity(one, "other")) @ axis)
        push = STIFFNESS * depth * (1.0 + 0.2 * rate)
        w = scene.velocity(q, "one") - scene.velocity(q, "other")
        w -= (w @ axis) * axis
        shift = np.zeros(3)
        if slid:
            shift = scene.in_scene(points[0], "one") - scene.in_scene(points[1], "other")
            shift -= (shift @ axis) * axis
        rub = -spring * (shift + theta * w)
        slid.append(bool(np.linalg.norm(rub) > 0.3 * push))
        if slid[-1]:
            rub *= 0.3 * push / np.linalg.norm(rub)
            shift = -rub / spring - theta * w
        for _ in range(2):
            found = scene.pressed(data)
            np.testing.assert_allclose(found.force["one"], push * axis + rub, rtol=1e-9)
            np.testing.assert_allclose(found.torque["one"], np.cross(q - one, rub), rtol=1e-9, atol=1e-9)
            np.testing.assert_allclose(
                found.torque["other"],
                -np.cross(one - other, push * axis) - np.cross(q - other, rub),
                rtol=1e-9,
            )
            powers = [0.2 * rate * STIFFNESS * depth * rate, -float(rub @ w)]
            np.testing.assert_allclose(found.taken, powers, rtol=1e-9)
            assert term.remember is not None
            term.remember(0.01, scene.x, scene.v, data)
            points = scene.in_body(q, "one"), scene.in_body(q - shift, "other")
            np.testing.assert_allclose(data.kept[:7], [1.0, *points[0], *points[1]], rtol=1e-9, atol=1e-12)
    assert slid == [False, False, False, True]
    assert data.kept[7 + 9 : 7 + 12] == pytest.approx([1.0, push, 0.5 * STIFFNESS * depth**2], rel=1e-9)


def test_bounds_of_the_stiffness_are_those_of_springs_at_corners_and_edges() -> None:
    """A free box and a small fixed cube, each against the other; all by hand."""
    cube = 'bodies.other={shape="box",size=[0.1,0.1,0.1],edge_radius=0.02,motion="fixed",mass=1.0}'
    scene = Scene(BOX, cube)
    blocks, half = scene.blocks, np.array([0.17, 0.12, 0.07])
    moments = [2.0 / 12.0 * (np.sum(np.square([0.4, 0.3, 0.2])) - a * a) for a in (0.4, 0.3, 0.2)]
    assert blocks.inertia.moments[0] == pytest.approx(moments, rel=1e-9)  # its principal axes are its own
    (on_cube, _), (on_box, _) = scene.terms()
    modulus = STIFFNESS / (0.03 + 0.02)
    reach = math.sqrt(3.0) * 0.05
    each = STIFFNESS + 0.5 * modulus * np.minimum(2.0 * half, 2.0 * reach).sum()  # of a corner and its edges
    place = half * (1.0 + 0.03 / np.linalg.norm(half))
    turning = 8.0 * each * ((place**2).sum() - place**2) / blocks.inertia.moments[0]
    assert on_cube.stiffness_rate == pytest.approx(max(8.0 * each / 2.0, *turning), rel=1e-9)
    far = np.linalg.norm([0.2, 0.15, 0.1])
    total = 8.0 * STIFFNESS + 12.0 * modulus * min(0.06, 2.0 * far)
    x, y, z = 0.2, 0.15, 0.1
    crossed = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    moved = np.eye(3) / 2.0 + crossed @ np.diag(1.0 / blocks.inertia.moments[0]) @ crossed.T
    assert on_box.stiffness_rate == pytest.approx(total * np.linalg.eigvalsh(moved)[-1], rel=1e-9)


@pytest.mark.parametrize("hertz", [False, True])
def test_bounds_of_two_balls_are_by_hand(hertz: bool) -> None:
    """k (1 / m + r^2 / I) = 3.5 k / m at the surface of one, 8.5 k / m at a corner of a cube about the other.

    By Hertz's law k is the slope at the depth that is allowed, and the reduced radius is 0.12 m.
    """
    law = 'effects.contact={bodies=[["one","other"]],law="hertz",modulus=1e6,damping=0.0}'
    scene = Scene(*BALLS, *((law,) if hertz else ()))
    ((term, data),) = scene.terms()
    slope = STIFFNESS
    if hertz:
        allowed = sum(0.25 * 2.0 * radius for radius in (0.3, 0.2))
        assert data.allowed == pytest.approx(allowed, rel=1e-12)
        slope = 1.5 * 4.0 / 3.0 * 1e6 * math.sqrt(0.12 * allowed)
    assert term.stiffness_rate == pytest.approx(3.5 * slope / 2.0 + 8.5 * slope / 3.0, rel=1e-9)
