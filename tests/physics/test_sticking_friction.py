"""Sticking friction of threads and balls on a moving body, bounds, starts inside: by hand, interpreted.

All states are at random positions, attitudes and velocities, so that every term of a force counts.
"""

from __future__ import annotations

import math
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scenes import Placed

import exunet
from exunet.forces.contact.estimate import damping_rate, speed_of_net
from exunet.forces.contact.law import Friction, friction, shift_for
from exunet.forces.contact.sphere_contact import SphereLaw, nodes_of, sphere_contact
from exunet.forces.contact.status import status_of
from exunet.forces.contact.thread_contact import thread_contact
from exunet.forces.terms import KernelTerm, copied
from exunet.simulation.preparation import Start, prepare_case

Floats = NDArray[np.float64]

LENGTH, DIAMETER, DENSITY = 0.2, 0.004, 1000.0  # m, m, kg/m3

BOX, BALL = (0.6, 0.5, 0.4), 0.15  # m: edges of a box, radius of a ball beside it

BESIDE = (0.1, 0.0, 0.2)  # m, from the middle of the box to that of the ball: it stands out of the top

STIFFNESS, DAMPING = 3e3, 0.4  # N/m2 or N/m^n, s/m

MU, RATIO, ZETA, SLIP = 0.3, 0.7, 4.0, 0.05

RADIUS, MODULUS = 0.02, 2e4  # of balls [m], E* [Pa]

CASE = f"""format = 1
title = "one element and a body of a box and a ball"
time = {{ end = 1.0, output_step = 0.1 }}
engine.backend = "compiled"
initial.packing = 1.0
net.topology = "explicit"
net.nodes = [[0.0, 0.0, 0.0], [{LENGTH}, 0.0, 0.0]]
net.elements = [[0, 1]]
net.node_masses = [0.03, 0.05]
net.cable = {{ diameter = {DIAMETER}, density = {DENSITY}, youngs_modulus = 1e5 }}
[bodies.target]
edge_radius = 0.05
mass = 0.5
position = [0.0, 0.0, -1.0]
angular_velocity = [0.2, -0.1, 0.3]
parts.a = {{ shape = "box", size = {list(BOX)} }}
parts.b = {{ shape = "sphere", radius = {BALL}, position = {list(BESIDE)} }}
[effects.contact]
damping = {DAMPING}
"""

THREADS = ('effects.contact.threads=["target"]', f"effects.contact.stiffness={STIFFNESS}")

BALLS = ('effects.contact.nodes=["target"]', f"effects.contact.node_radius={RADIUS}")

LINEAR = 'effects.contact.law="linear"'

LAWS = {
    "sticking": (
        f"effects.contact.friction.coefficient={MU}",
        'effects.contact.friction.law="sticking"',
        f"effects.contact.friction.tangential_ratio={RATIO}",
        f"effects.contact.friction.tangential_damping={ZETA}",
    ),
    "regularised": (
        f"effects.contact.friction.coefficient={MU}",
        'effects.contact.friction.law="regularised"',
        f"effects.contact.friction.slip_speed={SLIP}",
    ),
}

SCENES = {
    "threads": (*THREADS, LINEAR),
    "balls": (*BALLS, LINEAR, f"effects.contact.node_stiffness={STIFFNESS}"),
    "balls of Hertz": (*BALLS, 'effects.contact.law="hertz"', f"effects.contact.modulus={MODULUS}"),
}


@cache
def prepared(what: str, law: str) -> Start:
    with TemporaryDirectory() as folder:
        path = Path(folder) / "case.toml"
        path.write_text(CASE)
        return prepare_case(exunet.load(path, [*SCENES[what], *LAWS[law]]))


class Pushed(Placed):
    """Both nodes at places in the axes of the box, from its middle; all else at random."""

    def __init__(self, what: str, law: str, places: Any, seed: int = 1) -> None:
        super().__init__(prepared(what, law))
        random = np.random.default_rng(seed)
        ((self.term, data),) = super().terms()
        self.data: Any = copied(data)
        (self.body,) = self.start.system.bodies
        self.centre()[:] = random.normal(size=3)
        turned = random.normal(size=4)
        self.attitude()[:] = turned / np.linalg.norm(turned)
        self.place(places)
        self.v[: self.blocks.n_v] = 0.2 * random.normal(size=self.blocks.n_v)

    @property
    def up(self) -> Floats:
        """The normal of the box's top in the scene."""
        return np.asarray(self.turn() @ self.body.rotation.T @ [0.0, 0.0, 1.0])

    def place(self, places: Any) -> None:
        """Put the nodes at places (2, 3) [m] in the axes of the box."""
        for k, place in enumerate(places):
            self.x[3 * k : 3 * k + 3] = self.in_scene(self.body.in_principal_axes(place))

    def at(self, s: float) -> tuple[Floats, Floats]:
        """Place of the thread, and its velocity against the body there."""
        place, velocity = ((1.0 - s) * item[:3] + s * item[3:6] for item in (self.x, self.v))
        return place, velocity - self.velocity(place)

    def force(self, time: float = 0.0) -> Floats:
        """(n_force,), which changes neither momentum."""
        found = np.zeros(self.blocks.n_force)
        self.term.add(time, self.x, self.v, self.data, found)
        size = np.abs(found[:6]).sum() + 1e-300
        total, moment = self.gained(found)
        assert total < 1e-14 * size
        assert moment < 1e-13 * size
        return found

    def taken(self, found: Floats) -> Floats:
        """Powers [W] of damping and of friction."""
        at = self.blocks.rate("contact/damping")
        return np.asarray(found[at : at + 2])

    def remember(self, time: float = 0.0) -> None:
        assert self.term.remember is not None
        self.term.remember(time, self.x, self.v, self.data)


def across(n: Floats, a: Floats) -> Floats:
    """The part of a along the surface."""
    return np.asarray(a - (a @ n) * n)


TOP = 0.5 * BOX[2] + 0.5 * DIAMETER  # m, where the axis of a thread begins to touch

FLAT = ((-0.22, -0.12, TOP - 0.004), (-0.08, 0.02, TOP - 0.009))  # beside the ball

GAUSS = tuple(0.5 + 0.5 * item for item in np.polynomial.legendre.leggauss(4)[0])

WEIGHTS = tuple(0.5 * np.polynomial.legendre.leggauss(4)[1])


def across_by_hand(thread: Pushed) -> tuple[Floats, float, float]:
    """(2, 3) forces on both ends across the surface, where they act, and power that damping takes.

    The depth is that below the plane of the top; products of three linear functions, so the rule is exact.
    """
    n, length = thread.up, float(thread.data.threads.length[0])
    on, moment, taken = np.zeros((2, 3)), 0.0, 0.0
    for s, weight in zip(GAUSS, WEIGHTS, strict=True):
        place, w = thread.at(s)
        depth = TOP - float((thread.in_body(place) @ thread.body.rotation.T + thread.body.centre)[2])
        rate = -float(w @ n)
        f = STIFFNESS * length * depth * (1.0 + DAMPING * rate)
        on += weight * f * np.outer([1.0 - s, s], n)
        moment += weight * f * s
        taken += weight * (f - STIFFNESS * length * depth) * rate
    return on, moment / float(on.sum(axis=0) @ n), taken


def thread(law: str, places: Any = FLAT) -> Pushed:
    return Pushed("threads", law, places)


def test_what_the_law_gets_is_what_the_case_says() -> None:
    """k_t = kappa K L, theta = 2 zeta (m / k_t)^(1/2); of balls by Hertz 4/3 E* R in place of k."""
    data = thread("sticking").data
    length = float(data.threads.length[0])
    spring = RATIO * STIFFNESS * length
    mass = DENSITY * math.pi / 4.0 * DIAMETER**2 * length
    assert length == pytest.approx(LENGTH, rel=1e-12)
    assert data.threads.thick[0] == pytest.approx(0.5 * DIAMETER, rel=1e-12)
    assert data.threads.spring[0] == pytest.approx(spring, rel=1e-12)
    assert data.threads.relaxation[0] == pytest.approx(2.0 * ZETA * math.sqrt(mass / spring), rel=1e-12)
    for what, k, slope in (
        ("balls", STIFFNESS, STIFFNESS),
        ("balls of Hertz", 4.0 / 3.0 * MODULUS * math.sqrt(RADIUS), 4.0 / 3.0 * MODULUS * RADIUS),
    ):
        balls = Pushed(what, "sticking", FLAT)
        mass = balls.blocks.net.mass
        assert balls.data.law.stiffness == pytest.approx(k, rel=1e-12)
        assert balls.data.spheres.spring == pytest.approx(RATIO * slope, rel=1e-12)
        assert balls.data.spheres.relaxation == pytest.approx(
            2.0 * ZETA * np.sqrt(mass / (RATIO * slope)), rel=1e-12
        )


def held(pushed: Pushed, s: float, anchor: Floats) -> Floats:
    """The force of the spring along the surface at a place of the thread; anchor : (3,) in the body."""
    place, w = pushed.at(s)
    shift = place - pushed.in_scene(anchor)
    spring, time = pushed.data.threads.spring[0], pushed.data.threads.relaxation[0]
    return np.asarray(-spring * across(pushed.up, shift + time * w))


def test_a_thread_remembers_where_it_was_held() -> None:
    """Three states: without an anchor damping alone holds; then the spring; then it slides and drags that.

    What is remembered of a state gives the same force there.
    """
    pushed = thread("sticking")
    pushed.v *= 0.1  # so slowly that damping alone does not slide
    on, first, _ = across_by_hand(pushed)
    anchor = pushed.in_body(pushed.at(first)[0])
    w = across(pushed.up, pushed.at(first)[1])
    rub = -pushed.data.threads.spring[0] * pushed.data.threads.relaxation[0] * w
    assert 0.05 < np.linalg.norm(rub) / np.linalg.norm(on.sum(axis=0)) < 0.9 * MU
    force = pushed.force()
    size = np.abs(on).sum()
    known = on + np.outer([1.0 - first, first], rub)
    np.testing.assert_allclose(force[:6].reshape(2, 3), known, rtol=0.0, atol=1e-12 * size)
    pushed.remember()
    np.testing.assert_allclose(pushed.data.kept[:5], [1.0, first, *anchor], rtol=1e-12, atol=1e-15)

    pushed.move_on(0.02)
    on, middle, _ = across_by_hand(pushed)
    rub = held(pushed, first, anchor)
    assert abs(first - middle) > 1e-4
    assert 0.1 < np.linalg.norm(rub) / np.linalg.norm(on.sum(axis=0)) < 0.9 * MU
    for _ in range(2):  # before and after it is remembered
        force = pushed.force(0.02)
        known = on + np.outer([1.0 - first, first], rub)
        np.testing.assert_allclose(force[:6].reshape(2, 3), known, rtol=0.0, atol=1e-12 * size)
        assert pushed.taken(force)[1] == pytest.approx(-rub @ pushed.at(first)[1], rel=1e-10)
        pushed.remember(0.02)
        np.testing.assert_allclose(pushed.data.kept[:5], [1.0, first, *anchor], rtol=1e-12, atol=1e-15)

    pushed.move_on(0.1)
    on, middle, _ = across_by_hand(pushed)
    push = float(np.linalg.norm(on.sum(axis=0)))
    rub = held(pushed, first, anchor)
    assert np.linalg.norm(rub) > 1.2 * MU * push
    rub *= MU * push / np.linalg.norm(rub)
    for _ in range(2):
        force = pushed.force(0.12)
        known = on + np.outer([1.0 - middle, middle], rub)
        np.testing.assert_allclose(force[:6].reshape(2, 3), known, rtol=0.0, atol=1e-12 * size)
        assert pushed.taken(force)[1] == pytest.approx(-rub @ pushed.at(middle)[1], rel=1e-10)
        pushed.remember(0.12)
        assert pushed.data.kept[1] == pytest.approx(middle, rel=1e-12)
        np.testing.assert_allclose(held(pushed, middle, pushed.data.kept[2:5]), rub, rtol=1e-10)


def test_an_anchor_at_a_place_that_touches_no_more_is_moved_to_where_it_does() -> None:
    """With the force that it had; a thread that leaves forgets it."""
    pushed = thread("sticking")
    pushed.v *= 0.02
    _, first, _ = across_by_hand(pushed)
    pushed.force()
    pushed.remember()
    anchor = pushed.data.kept[2:5].copy()
    pushed.place(np.add(FLAT, [[4e-4, 1e-4, 0.020], [4e-4, 1e-4, 0.0]]))
    rub = held(pushed, first, anchor)
    begins = 0.016 / 0.025  # the thread goes from 16 mm above to 9 mm below where it begins to touch
    assert begins > first
    on_both = pushed.force(0.01)[:6].reshape(2, 3).sum(axis=0)
    np.testing.assert_allclose(across(pushed.up, on_both), rub, rtol=1e-9)
    pushed.remember(0.01)
    middle = float(pushed.data.kept[1])
    assert middle > begins
    np.testing.assert_allclose(held(pushed, middle, pushed.data.kept[2:5]), rub, rtol=1e-9)
    pushed.place(np.add(FLAT, [0.0, 0.0, 0.02]))
    assert not pushed.force(0.02)[:6].any()
    pushed.remember(0.02)
    assert not pushed.data.kept[:5].any()


ON_TOP = 0.5 * BOX[2] + RADIUS  # m, where the middle of a ball begins to touch


def depth_by_hand(pushed: Pushed, place: Floats) -> tuple[float, Floats]:
    """Depth and direction (in the scene) of a ball over the top, near the body's ball: of both as one."""
    own = pushed.in_body(place) @ pushed.body.rotation.T + pushed.body.centre
    arm = own - np.array(BESIDE)
    far = float(np.linalg.norm(arm))
    depths = np.array([ON_TOP - own[2], BALL + RADIUS - far])
    ways = np.array([[0.0, 0.0, 1.0], arm / far])
    depths = np.maximum(depths, 0.0)
    both = float((depths**8).sum() ** 0.125)
    way = ((depths / both) ** 7) @ ways if both > 0.0 else np.zeros(3)
    return both, pushed.turn() @ pushed.body.rotation.T @ way


SEAM = (0.1 - math.sqrt((BALL + RADIUS - 0.005) ** 2 - (ON_TOP - 0.006 - 0.2) ** 2), 0.0, ON_TOP - 0.006)

PLACES = (SEAM, (-0.2, 0.15, ON_TOP - 0.009))


def test_balls_remember_where_they_were_held() -> None:
    """As threads: damping alone, the springs, and one spring that is dragged along."""
    pushed = Pushed("balls", "sticking", PLACES)
    pushed.v *= 0.05
    anchors = [pushed.in_body(pushed.x[k : k + 3]) for k in (0, 3)]
    states = []
    for time in (0.0, 0.05, 0.6):
        pushed.move_on(time)
        slides = []
        for again in range(2 if time else 1):
            force = pushed.force(time)
            for node, anchor in enumerate(anchors):
                k = slice(3 * node, 3 * node + 3)
                depth, way = depth_by_hand(pushed, pushed.x[k])
                w = pushed.v[k] - pushed.velocity(pushed.x[k])
                push = STIFFNESS * depth * (1.0 - DAMPING * float(w @ way))
                n = way / np.linalg.norm(way)
                shift = pushed.x[k] - pushed.in_scene(anchor)
                spring, theta = pushed.data.spheres.spring[node], pushed.data.spheres.relaxation[node]
                rub = -spring * across(n, shift + theta * w)
                ratio = float(np.linalg.norm(rub)) / (MU * push)
                slides.append(ratio > 1.0 + 1e-9)
                rub /= max(ratio, 1.0)
                np.testing.assert_allclose(force[k], push * way + rub, rtol=1e-9, err_msg=f"{time} {again}")
            pushed.remember(time)
            for node in range(2):
                row = pushed.data.kept[5 * node : 5 * node + 5]
                if slides[node]:
                    anchors[node] = row[2:].copy()
                np.testing.assert_allclose(row, [1.0, 0.0, *anchors[node]], rtol=1e-12, atol=1e-15)
        states.append(slides)
    held, slid = [False, False], [False, True]
    assert states == [held, held + held, slid + held]


@pytest.mark.parametrize("what", SCENES)
def test_bounds_are_those_of_the_stiffest_state_by_hand(what: str) -> None:
    """Of the lightest node, and of the body at its farthest points; with its speeds at the start."""
    pushed = Pushed(what, "regularised", FLAT)
    blocks, surface = pushed.blocks, pushed.blocks.surfaces["target"]
    mass, moments = blocks.inertia.mass[0], blocks.inertia.moments[0]
    arm = float(np.linalg.norm(surface.middle)) + surface.radius
    assert arm > surface.radius + 0.01
    mobility = 1.0 / mass + arm**2 / min(moments)
    light = float(blocks.net.mass[:2].min())
    if what == "threads":
        exponent, rate = 1.0, STIFFNESS * LENGTH * (0.5 / light + mobility)
    elif what == "balls":
        exponent, rate = 1.0, STIFFNESS * (1.0 / light + 2.0 * mobility)
    else:
        exponent, deepest = 1.5, pushed.data.body.allowed + RADIUS
        slope = 1.5 * 4.0 / 3.0 * MODULUS * math.sqrt(RADIUS * deepest)
        rate = slope * (1.0 / light + 2.0 * mobility)
    assert pushed.term.stiffness_rate == pytest.approx(rate, rel=1e-9)
    speed = speed_of_net(blocks, "target", arm)
    assert speed == pytest.approx(arm * math.sqrt(0.14), rel=1e-9)
    assert pushed.term.damping_rate == pytest.approx(damping_rate(DAMPING, rate, speed, exponent), rel=1e-9)
    assert pushed.term.friction_rate == pytest.approx(MU * speed * math.sqrt(rate) / SLIP, rel=1e-9)


def made(what: str, blocks: Any, surface: Any, inside: bool = False) -> KernelTerm:
    """The term by itself, of a surface that may be another than the case's."""
    rubbing = Friction(MU, 0.0, RATIO, ZETA)
    if what == "threads":
        elements = np.arange(1 if inside else 0)
        return thread_contact(blocks, "target", surface, (STIFFNESS, DAMPING), rubbing, elements)
    law = SphereLaw(STIFFNESS, 1.0, DAMPING, STIFFNESS)
    return sphere_contact(blocks, nodes_of(blocks.net), "target", surface, RADIUS, law, rubbing, inside)


@pytest.mark.parametrize("what", ["threads", "balls"])
def test_what_starts_inside_touches_once_it_has_come_out(what: str) -> None:
    """As a net in its canister: it is not pushed until it has been seen outside."""
    pushed = Pushed(what, "sticking", FLAT)
    surface = pushed.blocks.surfaces["target"]
    pushed.term = made(what, pushed.blocks, surface, inside=True)
    pushed.data = copied(pushed.term.data)
    assert pushed.term.potential is not None
    number = 1 if what == "threads" else 2
    for time, above, touches in ((0.0, 0.0, False), (0.01, 0.1, False), (0.02, 0.0, True)):
        pushed.place(np.add(FLAT, [0.0, 0.0, above]))
        assert bool(pushed.force(time)[:6].any()) == touches
        assert (pushed.term.potential(pushed.x, copied(pushed.data)) > 0.0) == touches
        pushed.remember(time)
        kept = pushed.data.kept[: 5 * number : 5]
        assert kept.tolist() == [-1.0 if time == 0.0 else float(touches)] * number
        assert status_of(pushed.data.kept).touching == (number if touches else 0)


def test_threads_that_are_fixed_to_the_body_or_may_be_wound_up_do_not_touch_it() -> None:
    blocks = prepared("threads", "sticking").system.blocks
    surface = blocks.surfaces["target"]
    for other, number in (
        (surface, 1),
        (surface._replace(attached=np.array([1])), 0),
        (surface._replace(wound=((0,),)), 0),
    ):
        assert len(made("threads", blocks, other).data.threads.length) == number  # type: ignore[attr-defined]
    for attached, number in (([], 2), ([0], 1)):
        other = surface._replace(attached=np.array(attached, dtype=np.int64))
        assert len(made("balls", blocks, other).data.spheres.node) == number  # type: ignore[attr-defined]


def test_friction_that_is_just_enough_holds() -> None:
    """3-4-5, exact: of the spring, of the damping, and where both ask for more."""
    n, rubbing = (0.0, 0.0, 1.0), Friction(0.5)
    zero = (0.0, 0.0, 0.0)
    assert friction(10.0, n, (3.0, 4.0, 7.0), zero, 1.0, 9.0, rubbing) == ((-3.0, -4.0, 0.0), False)
    assert friction(10.0, n, zero, (6.0, 8.0, 7.0), 1.0, 0.5, rubbing) == ((-3.0, -4.0, 0.0), False)
    assert friction(10.0, n, (3.0, 4.0, 0.0), (6.0, 8.0, 0.0), 2.0, 0.5, rubbing) == ((-3.0, -4.0, 0.0), True)
    found, slides = friction(0.0, n, zero, zero, 1.0, 9.0, rubbing)
    assert (found, slides) == (zero, False)
    for stiffness, time in ((2.0, 0.25), (0.5, 3.0)):
        u = shift_for((-3.0, -4.0, 0.0), n, (0.3, -0.2, 0.7), stiffness, time)
        again, _ = friction(1e9, n, u, (0.3, -0.2, 0.7), stiffness, time, rubbing)
        assert again == pytest.approx((-3.0, -4.0, 0.0), rel=1e-12)
