"""The scalar loops of forces on rigid bodies, and of what forces give, as plain Python against vectors."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.sparse import csr_array
from scipy.spatial.transform import Rotation

from exunet.forces import corner_units, from_outside, loops, on_bodies
from exunet.forces.blocks import Blocks, Inertia, PointMass
from exunet.forces.linear_term import LinearTerm
from exunet.forces.terms import Constraint, KernelTerm
from exunet.net.arrays import Net

Floats = np.ndarray
RANDOM = np.random.default_rng(7)
NAMES = ("one", "two")
EFFECT = "push"


def cloud(n: int) -> tuple[Floats, Floats]:
    """Masses [kg] of some points, and their places in the principal axes of all of them [m]."""
    mass, place = RANDOM.uniform(0.2, 1.5, n), RANDOM.normal(size=(n, 3))
    place -= mass @ place / mass.sum()
    _, axes = np.linalg.eigh((place.T * mass) @ place)
    return mass, place @ axes


CLOUDS = [cloud(7), cloud(6)]


def moments(mass: Floats, place: Floats) -> Floats:
    """Principal moments of inertia [kg m2]."""
    square = mass @ place**2
    return np.asarray(square.sum() - square)


def blocks() -> Blocks:
    """Three nodes, two of them fixed, a point mass, two bodies, the states of an effect and of what holds."""
    none = np.zeros(0)
    net = Net(np.eye(3), np.array([0.3, 0.4, 0.2]), np.zeros((0, 2), dtype=np.int64), none, none, none, none,
              none.astype(bool), np.zeros(0, dtype=np.int64), np.array([0, 2]))  # fmt: skip
    inertia = Inertia(np.array([m.sum() for m, _ in CLOUDS]), np.array([moments(*item) for item in CLOUDS]))
    given = *from_outside.states_of(EFFECT), *from_outside.states_of(from_outside.FIXED_NODES)
    return Blocks.of(net, np.eye(3), (PointMass("chaser", 2.0),), NAMES, given, inertia)


BLOCKS = blocks()
N_V, N_FORCE = BLOCKS.n_v, BLOCKS.n_force


def state() -> tuple[Floats, Floats]:
    """Any x and v, with attitudes of length one."""
    x, v = RANDOM.normal(size=BLOCKS.n_x), RANDOM.normal(size=N_V)
    for name in NAMES:
        q = slice(BLOCKS.attitude(name), BLOCKS.attitude(name) + 4)
        x[q] /= np.linalg.norm(x[q])
    return x, v


def turn_of(x: Floats, name: str) -> Floats:
    """From the body's axes to the scene's."""
    q = BLOCKS.attitude(name)
    return np.asarray(Rotation.from_quat(x[q : q + 4], scalar_first=True).as_matrix())


def elements(x: Floats, v: Floats, name: str) -> tuple[Floats, Floats, Floats, Floats]:
    """Of a body made of points: their masses, arms in the body's axes, places and velocities in the scene."""
    mass, arm = CLOUDS[NAMES.index(name)]
    c, s, turn = BLOCKS.centre(name), BLOCKS.spin(name), turn_of(x, name)
    return mass, arm, x[c : c + 3] + arm @ turn.T, v[c : c + 3] + np.cross(v[s : s + 3], arm) @ turn.T


def summed(x: Floats, v: Floats, law: Any) -> Floats:
    """Forces and torques of what law(mass, place, velocity) [N] gives on each point of each body."""
    force = np.zeros(N_FORCE)
    for name in NAMES:
        mass, arm, place, speed = elements(x, v, name)
        pull = law(mass[:, None], place, speed)
        c, s = BLOCKS.centre(name), BLOCKS.spin(name)
        force[c : c + 3] = pull.sum(axis=0)
        force[s : s + 3] = np.cross(arm, pull @ turn_of(x, name)).sum(axis=0)
    return force


def added(term: KernelTerm, x: Floats, v: Floats) -> Floats:
    force = np.zeros(N_FORCE)
    term.add(0.0, x, v, term.data, force)
    return force


def test_blocks_stand_one_after_the_other() -> None:
    """Three nodes and a point mass, two centres, two attitudes or spins, and the 12 states."""
    assert [BLOCKS.centre(name) for name in ("chaser", *NAMES)] == [9, 12, 15]
    assert [BLOCKS.attitude(name) for name in NAMES] == [18, 22]
    assert [BLOCKS.spin(name) for name in NAMES] == [18, 21]
    assert (BLOCKS.n_points, BLOCKS.centres, BLOCKS.n_states) == (4, 18, 12)
    assert (BLOCKS.n_x, BLOCKS.n_v, BLOCKS.n_force) == (38, 24, 36)
    names = [item.name for item in BLOCKS.states]
    assert [BLOCKS.state(name) for name in names] == [26, 29, 32, 35]
    assert [BLOCKS.rate(name) for name in names] == [24, 27, 30, 33]
    assert from_outside.effects_of(names) == (EFFECT, from_outside.FIXED_NODES)


def test_vectors_turn_as_those_of_scipy() -> None:
    x = RANDOM.normal(size=6)
    x[1:5] /= np.linalg.norm(x[1:5])
    turn = Rotation.from_quat(x[1:5], scalar_first=True)
    for vector in RANDOM.normal(size=(3, 3)):
        seen = loops.in_scene_axes(x, 1, *vector)
        np.testing.assert_allclose(seen, turn.apply(vector), rtol=1e-13, atol=1e-14)
        np.testing.assert_allclose(
            loops.in_body_axes(x, 1, *vector), turn.inv().apply(vector), rtol=1e-13, atol=1e-14
        )


def test_the_weight_of_bodies() -> None:
    gravity = np.array([0.4, -1.2, 2.3])
    (term,) = on_bodies.weight_on_bodies(BLOCKS, gravity)
    x, v = state()
    np.testing.assert_allclose(added(term, x, v), summed(x, v, lambda m, y, u: m * gravity), atol=1e-13)
    assert term.potential is not None
    stored = -sum(float((m @ y) @ gravity) for m, _, y, _ in (elements(x, v, name) for name in NAMES))
    assert term.potential(x, term.data) == pytest.approx(stored, rel=1e-13)


@pytest.mark.parametrize("at_centre", [True, False])
def test_a_field_on_bodies_is_that_on_their_points(at_centre: bool) -> None:
    """m (G x - w x v) of each, and -m x.Gx / 2; without that of the centres where others have it."""
    gradient, turning = RANDOM.normal(size=(3, 3)), RANDOM.normal(size=3)
    gradient += gradient.T
    (term,) = on_bodies.field_on_bodies(BLOCKS, gradient, turning, at_centre=at_centre)
    assert term.stiffness_rate == pytest.approx(np.abs(np.linalg.eigvalsh(gradient)).max())
    assert term.potential is not None
    for _ in range(3):
        x, v = state()
        wanted = summed(x, v, lambda m, y, u: m * (y @ gradient - np.cross(turning, u)))
        stored = 0.0
        for name in NAMES:
            mass, _, place, _ = elements(x, v, name)
            stored -= 0.5 * float(mass @ np.einsum("ka,ab,kb->k", place, gradient, place))
            if not at_centre:
                c = BLOCKS.centre(name)
                wanted[c : c + 3] -= mass.sum() * gradient @ x[c : c + 3]
                stored += 0.5 * float(mass.sum() * x[c : c + 3] @ gradient @ x[c : c + 3])
        np.testing.assert_allclose(added(term, x, v), wanted, rtol=1e-11, atol=1e-12)
        assert term.potential(x, term.data) == pytest.approx(stored, rel=1e-11)


def test_braking_of_bodies_is_that_of_their_points() -> None:
    (term,) = on_bodies.braking_on_bodies(BLOCKS, 0.7)
    assert term.damping_rate == 0.7
    x, v = state()
    np.testing.assert_allclose(added(term, x, v), summed(x, v, lambda m, y, u: -0.7 * m * u), atol=1e-12)
    assert on_bodies.braking_on_bodies(BLOCKS, 0.0) == ()


def test_a_wrench_acts_at_its_arm() -> None:
    """A force [N] at a point and a torque [N m] in the scene's axes; both count in those of the body."""
    arm, load = RANDOM.normal(size=3), RANDOM.normal(size=6)
    term = on_bodies.wrench_on(BLOCKS, "two", arm)
    x, v = state()
    assert not added(term, x, v).any()
    force, wanted, turn = np.zeros(N_FORCE), np.zeros(N_FORCE), turn_of(x, "two")
    term.add(0.0, x, v, term.data._replace(load=load), force)
    c, s = BLOCKS.centre("two"), BLOCKS.spin("two")
    wanted[c : c + 3] = load[:3]
    wanted[s : s + 3] = (load[3:] + np.cross(turn @ arm, load[:3])) @ turn
    np.testing.assert_allclose(force, wanted, rtol=1e-12, atol=1e-13)


# What forces give: impulse and angular impulse


def given(x: Floats, force: Floats) -> Floats:
    """Resultant of the forces and torques at all blocks, and its moment about the origin."""
    pulls, places = force[: BLOCKS.centres].reshape(-1, 3), x[: BLOCKS.centres].reshape(-1, 3)
    moment = np.cross(places, pulls).sum(axis=0)
    for name in NAMES:
        s = BLOCKS.spin(name)
        moment += turn_of(x, name) @ force[s : s + 3]
    return np.concatenate([pulls.sum(axis=0), moment])


def test_the_impulse_of_linear_terms() -> None:
    """-D v - W v - K x + F of points and centres, with matrices that couple all of them."""
    n = BLOCKS.centres
    damping, turning, stiffness = RANDOM.normal(size=(3, n, n))
    load, (x, v) = RANDOM.normal(size=n), state()
    term = LinearTerm(*(csr_array(part) for part in (damping, turning - turning.T, stiffness)), load)
    (same, *more) = from_outside.counted(EFFECT, [term], BLOCKS)
    assert same is term
    force = load - (damping + turning - turning.T) @ v[:n] - stiffness @ x[:n]
    found = sum(added(item, x, v) for item in more)
    assert not found[:N_V].any()
    wanted = given(x, np.append(force, np.zeros(N_FORCE)))
    np.testing.assert_allclose(found[N_V:], np.append(wanted, np.zeros(6)), rtol=1e-11)


def test_potential_and_power_of_linear_terms() -> None:
    """x.Kx / 2 - F.x, and v.Dv without what is antisymmetric; of many states, with what stands beside."""
    n = BLOCKS.centres
    damping, turning, stiffness = RANDOM.normal(size=(3, n, n))
    load, x, v = RANDOM.normal(size=n), RANDOM.normal(size=(4, n + 5)), RANDOM.normal(size=(4, n + 2))
    parts = (damping + damping.T, turning - turning.T, stiffness + stiffness.T)
    term = LinearTerm(*(csr_array(part) for part in parts), load)
    twice = term + term
    for k in range(4):
        y, w = x[k, :n], v[k, :n]
        stored = 0.5 * y @ parts[2] @ y - load @ y
        assert term.potential(x)[k] == pytest.approx(stored, rel=1e-11)
        assert twice.potential(x)[k] == pytest.approx(2.0 * stored, rel=1e-11)
        assert term.power(v)[k] == pytest.approx(w @ parts[0] @ w, rel=1e-11)
    assert LinearTerm(load=load).power(v).tolist() == [0.0] * 4
    (moving, *_) = (call for call in term.calls if call.tells_power)
    assert moving.power is not None
    assert moving.power(0.0, x[0], v[0], moving.data) == pytest.approx(term.power(v)[0], rel=1e-11)


def test_the_impulse_of_other_terms_is_of_what_they_add() -> None:
    """Marks before and after them: what stood in force before does not count, nor do other rates."""
    pushed, before = RANDOM.normal(size=N_FORCE), RANDOM.normal(size=N_FORCE)
    pushed[N_V:] = 0.0

    def push(t: float, x: Any, v: Any, data: Any, force: Any) -> None:
        force += pushed

    (first, _, last) = from_outside.counted(EFFECT, [KernelTerm("nodes", push)], BLOCKS)
    x, v = state()
    force = before.copy()
    first.add(0.0, x, v, first.data, force)
    push(0.0, x, v, (), force)
    last.add(0.0, x, v, last.data, force)
    np.testing.assert_allclose(force[:N_V], (before + pushed)[:N_V], rtol=1e-15)
    wanted = np.append(given(x, pushed), np.zeros(6))
    np.testing.assert_allclose(force[N_V:] - before[N_V:], wanted, rtol=1e-11, atol=1e-12)


def test_what_holds_fixed_nodes_balances_what_pulls_them() -> None:
    other = Constraint((), (lambda memory: (memory,),))
    kept = from_outside.with_reactions(other, BLOCKS)
    assert kept.data[0] is other.data[0]
    for constraint in (kept, from_outside.with_reactions(None, BLOCKS)):
        (call,) = constraint.calls
        assert constraint.data[-1]({}) is call.data
        x, v = state()
        force = RANDOM.normal(size=N_FORCE)
        before, held = force.copy(), np.zeros(N_FORCE)
        held[:3], held[6:9] = -force[:3], -force[6:9]
        call.add(0.0, x, v, call.data, force)
        wanted = np.concatenate([np.zeros(N_V + 6), given(x, held)])
        np.testing.assert_allclose(force - before, wanted, atol=1e-13)


def test_thrusters_push_and_count_what_they_spend_and_give() -> None:
    """Two units: forces, |F| of each, the power of all; and the impulse of these few forces by themselves."""
    memory, units = np.append(np.zeros(4), RANDOM.normal(size=6)), np.array([0, 6], dtype=np.uint32)
    pulls, rate = memory[4:].reshape(2, 3), N_FORCE
    x, v = state()
    wanted = np.zeros(N_FORCE + 3)
    wanted[:3], wanted[6:9] = pulls
    power = pulls[0] @ v[:3] + pulls[1] @ v[6:9]
    wanted[rate:] = [*np.linalg.norm(pulls, axis=1), power]
    start = RANDOM.normal(size=len(wanted))
    force = start.copy()
    corner_units.add_thrusters(0.0, x, v, corner_units.Thrusters(units, memory, 4, rate), force)
    np.testing.assert_allclose(force - start, wanted, rtol=1e-12, atol=1e-14)
    wanted[N_V : N_V + 6] = given(x, wanted[:N_FORCE])
    force = start.copy()
    counted = corner_units.CountedThrusters(units, memory, 4, rate, N_V)
    corner_units.add_counted_thrusters(0.0, x, v, counted, force)
    np.testing.assert_allclose(force - start, wanted, rtol=1e-12, atol=1e-14)
