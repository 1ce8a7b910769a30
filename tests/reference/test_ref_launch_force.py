"""Launch forces of reference_impl: speeds from work, recoil, direction, books with the chaser."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from reference_impl import acceleration, energy
from reference_impl.effects.launch_force import LaunchForce
from reference_impl.forces import ways

SPRING = {"kind": "spring", "force": 64.0, "stroke": 0.05, "spread_angle": 0.4, "chaser_mass": 5.0}
GAS = {**SPRING, "kind": "gas", "dead_length": 0.02, "exponent": 1.4}
WORK = {
    "spring": 0.5 * 64.0 * 0.05,
    "gas": 64.0 * 0.02 / 0.4 * (1.0 - (0.02 / 0.07) ** 0.4),  # F0 V/(gamma - 1) (1 - (V/(V + s))^(gamma - 1))
}


@pytest.mark.parametrize("launch", [SPRING, GAS], ids=["spring", "gas"])
@pytest.mark.parametrize("angle", [0.0, 0.4, math.pi / 2.0])
def test_speed_from_work_and_recoil(loose, scene, launch, angle):
    """Four bullets m and a chaser M: 1/mu = 1/m + 4 cos^2/M along a barrel, mu s'^2/2 = W at the muzzle.

    Each bullet has the impulse mu s' along its barrel, sin outwards and cos along +z; the chaser the opposite
    of their sum.
    """
    made = scene(loose(launch_force={**launch, "spread_angle": angle}))
    run = made.integrate([0.0, 0.1])
    m = made.net.mass[made.net.bullet_nodes[0]]
    reduced = 1.0 / (1.0 / m + 4.0 * math.cos(angle) ** 2 / 5.0)
    impulse = math.sqrt(2.0 * WORK[launch["kind"]] * reduced)
    outwards = np.array([[-1.0, -1.0, 0], [1.0, -1.0, 0], [1.0, 1.0, 0], [-1.0, 1.0, 0]]) / math.sqrt(2.0)
    expected = impulse / m * (math.sin(angle) * outwards + math.cos(angle) * np.array([0.0, 0.0, 1.0]))
    assert run.v[-1, made.net.bullet_nodes] == pytest.approx(expected, rel=1e-9, abs=1e-11)
    recoil = [0.0, 0.0, -4.0 * impulse * math.cos(angle) / 5.0]
    assert run.bodies.velocity[-1, 0] == pytest.approx(recoil, rel=1e-9, abs=1e-12)
    assert made.system.bodies.names == ("chaser",)


def test_way_over_time_in_the_barrel(loose, scene):
    """A spring is a quarter of a harmonic swing: s = stroke (1 - cos(w t)), w = sqrt(F0/(mu stroke))."""
    made = scene(loose(launch_force=SPRING))
    m = made.net.mass[made.net.bullet_nodes[0]]
    omega = math.sqrt(64.0 / 0.05 * (1.0 / m + 4.0 * math.cos(0.4) ** 2 / 5.0))
    times = np.linspace(0.0, 0.5 * math.pi / omega, 6)
    run = made.integrate(times, rtol=1e-12, atol=1e-14)
    s = ways(made.system, np.concatenate((run.x, run.bodies.position), axis=1))
    expected = 0.05 * (1.0 - np.cos(omega * times))
    assert s == pytest.approx(np.tile(expected, (4, 1)).T, abs=1e-13)


@pytest.mark.parametrize("kind", ["spring", "gas"])
def test_law_by_hand(kind):
    """F0 (1 - s/stroke) and F0 (V/(V + s))^gamma; F0 behind the start for gas, more than F0 for a spring."""
    gas = (0.02, 1.4) if kind == "gas" else (None, None)
    law = LaunchForce(64.0, 0.05, 0.0, 5.0, *gas)
    s = np.array([-0.01, 0.0, 0.02, 0.0499999, 0.0500001, 0.3])
    expected = {
        "spring": [76.8, 64.0, 38.4, 1.28e-4, 0.0, 0.0],
        "gas": [64.0, 64.0, 64.0 * 0.5**1.4, 64.0 * (0.02 / 0.0699999) ** 1.4, 0.0, 0.0],
    }
    assert law.push(s) == pytest.approx(expected[kind], rel=1e-9)
    assert law.held(np.array([0.0])) == pytest.approx([WORK[kind]], rel=1e-14)
    assert law.held(np.array([0.05, 0.2])).tolist() == [0.0, 0.0]
    h = 1e-6
    inside = np.array([-0.01, 0.001, 0.02, 0.049])
    slope = (law.held(inside - h) - law.held(inside + h)) / (2.0 * h)
    assert slope == pytest.approx(law.push(inside), rel=1e-7)


@pytest.mark.parametrize("kind", ["spring", "gas"])
def test_mean_force_is_the_fall_of_the_energy_over_the_way(kind):
    """The discrete gradient of the energy-momentum method, also over vanishing ways and across the muzzle."""
    law = LaunchForce(64.0, 0.05, 0.0, 5.0, *((0.02, 1.4) if kind == "gas" else (None, None)))
    places = [-0.01, 0.0, 1e-3, 0.02, 0.05, 0.06, 0.4]
    s0, s1 = (a.ravel() for a in np.meshgrid(places, places))
    mean, slope = law.mean(s0, s1)
    apart = s0 != s1
    assert (mean * (s1 - s0))[apart] == pytest.approx(
        (law.held(s0) - law.held(s1))[apart], rel=1e-12, abs=1e-15
    )
    same = (s0 == s1) & (s0 != 0.05)
    assert mean[same] == pytest.approx(law.push(s0[same]), rel=1e-12)
    inside = apart & (np.minimum(np.abs(s1 - 0.05), np.abs(s1)) > 1e-6)
    h = 1e-8
    numeric = (law.mean(s0, s1 + h)[0] - law.mean(s0, s1 - h)[0]) / (2.0 * h)
    assert slope[inside] == pytest.approx(numeric[inside], rel=1e-5, abs=1e-2)
    near = law.mean(np.full(5, 0.02), 0.02 + np.array([0.0, 1e-18, 1e-12, -1e-12, 1e-9]))
    assert near[0] == pytest.approx(law.push(np.full(5, 0.02)), rel=1e-6)
    assert np.isfinite(slope).all()


METHODS = [
    ({}, 1e-7, 1e-13),
    ({"method": "RK45", "rtol": 1e-8, "atol": 1e-10}, 1e-5, 1e-13),
    ({"method": "RK4", "step": 4e-5}, 3e-3, 1e-12),
    ({"method": "Verlet", "step": 4e-5}, 3e-3, 1e-12),
    ({"method": "EM", "step": 5e-4}, 1e-11, 1e-12),
]
NAMES = ["DOP853", "RK45", "RK4", "Verlet", "EM"]


@pytest.mark.ci_for("EM-gas")
@pytest.mark.slow_for("gas", "RK4", "RK45", "DOP853", "Verlet")
@pytest.mark.parametrize("launch", [SPRING, GAS], ids=["spring", "gas"])
@pytest.mark.parametrize(("options", "bound", "drift"), METHODS, ids=NAMES)
def test_books_close_and_momentum_counts_the_chaser(loose, scene, unbalanced, launch, options, bound, drift):
    made = scene(loose(launch_force=launch), {"initial.packing": 0.95})
    run = made.integrate([0.0, 0.01, 0.08, 0.15], **options)
    books = energy.books(made.system, run)
    assert books.potential[0] == pytest.approx(4.0 * WORK[launch["kind"]])
    assert books.potential[-1] == 0.0
    assert unbalanced(made, run) < bound
    assert np.abs(books.momentum).max() < drift
    assert abs(run.bodies.velocity[-1, 0, 2]) > 0.1
    assert np.ptp(np.linalg.norm(run.v[2:, made.net.bullet_nodes], axis=2)) > 0.02  # the net has snapped


@pytest.mark.ci_for("DOP853-spring")
@pytest.mark.slow
@pytest.mark.parametrize("launch", [SPRING, GAS], ids=["spring", "gas"])
@pytest.mark.parametrize(
    ("options", "bound"),
    [
        ({}, 1e-9),
        ({"method": "RK45", "rtol": 1e-8, "atol": 1e-10}, 1e-5),
        ({"method": "RK4", "step": 2e-4}, 2e-3),
    ],
    ids=["DOP853", "RK45", "RK4"],
)
def test_bullets_that_come_back_are_pushed_again(loose, scene, unbalanced, launch, options, bound):
    """Thrust brings the bullets back into their barrels: the force is still one of s, so the books close."""
    back = {"bullets": [0, 1, 2, 3], "time": [0.0, 1.0], "force": [[0.0, 0.0, -6.0]] * 2}
    made = scene(loose(launch_force={**launch, "spread_angle": 0.0}, thrust=back))
    run = made.integrate(np.linspace(0.0, 0.8, 17), **options)
    s = ways(made.system, np.concatenate((run.x, run.bodies.position), axis=1))
    out = (s[:, 0] > 0.05).astype(int)
    assert np.diff(out).min() == -1  # back again
    assert np.abs(np.diff(out)).sum() >= 3  # and out again
    assert unbalanced(made, run) < bound


def test_reaction_counts_at_once(loose, scene):
    """At the start each bullet feels F0 and the chaser 4 F0 cos(angle) backwards."""
    made = scene(loose(launch_force=SPRING))
    a = acceleration(made.system, 0.0, made.x0, made.v0, made.bodies0)
    force = made.net.mass[:, None] * a
    assert np.linalg.norm(force[made.net.bullet_nodes], axis=1) == pytest.approx([64.0] * 4)
    assert np.count_nonzero(np.linalg.norm(force, axis=1)) == 4
    with pytest.raises(ValueError, match="give the states of the bodies"):
        acceleration(made.system, 0.0, made.x0, made.v0)
    with pytest.raises(ValueError, match="give the states of the bodies"):
        energy.potential(made.system, made.x0)


def test_barrels_move_with_the_chaser(loose, scene):
    """s is relative to the chaser and since the start: moving both along changes no force."""
    made = scene(loose(launch_force=SPRING))
    shift = np.array([0.3, -0.2, 0.7])
    moved = replace(made.bodies0, position=made.bodies0.position + shift)
    a = acceleration(made.system, 0.0, made.x0, made.v0, made.bodies0)
    assert acceleration(made.system, 0.0, made.x0 + shift, made.v0, moved) == pytest.approx(a, abs=1e-10)


def test_symmetric_arithmetic_keeps_mirrors(loose, scene):
    made = scene(loose(launch_force=GAS), {"initial.packing": 0.8}, symmetric=True)
    run = made.integrate([0.0, 0.1, 0.2])
    row = {tuple(p): i for i, p in enumerate((made.net.reference_position + 0.0).tolist())}
    for mirror in (lambda p: p * [-1, 1, 1], lambda p: p * [1, -1, 1], lambda p: p[..., [1, 0, 2]]):
        image = [row[tuple(p)] for p in (mirror(made.net.reference_position) + 0.0).tolist()]
        assert np.array_equal(run.x[:, image], mirror(run.x))
    assert not run.bodies.position[:, 0, :2].any()


def test_a_launch_is_the_same_from_a_moving_frame(loose, scene):
    """Galilei: with a velocity given to all, the chaser flies along, and all are where they were plus v t."""
    v = np.array([0.3, -0.2, 0.5])
    case = loose(launch_force=SPRING)
    runs = [
        scene(item).integrate([0.0, 0.1])
        for item in (case, {**case, "initial": {**case["initial"], "velocity": v.tolist()}})
    ]
    assert runs[1].x[-1] == pytest.approx(runs[0].x[-1] + 0.1 * v, abs=1e-11)
    assert runs[1].bodies.position[-1] == pytest.approx(runs[0].bodies.position[-1] + 0.1 * v, abs=1e-11)
