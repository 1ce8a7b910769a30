"""Bending of reference_impl: energy and forces by hand, which elements are joined, a beam of a textbook."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import eigh

from reference_impl import acceleration, energy
from reference_impl.effects.bending import Bending, hinges
from reference_impl.forces import gather, motion, span

WIRE = {"area": math.pi / 4.0 * 0.004**2, "density": 1000.0, "youngs_modulus": 1e9}
MODULUS = 2e9  # [Pa]
INERTIA = math.pi / 64.0 * 0.004**4  # of a circle, any textbook


def three(explicit, first, second):
    """Three nodes on x, elements of the given lengths."""
    case = explicit([[0.0, 0, 0], [first, 0, 0], [first + second, 0, 0]], [[0, 1], [1, 2]], cable=WIRE)
    return {**case, "effects": {"bending": {"modulus": MODULUS}}}


@pytest.mark.parametrize(("first", "second"), [(0.2, 0.2), (0.2, 0.5), (0.7, 0.1)])
def test_three_nodes_by_hand(explicit, scene, first, second):
    """Bent by the angle a: |d2/L2 - d1/L1| = 2 sin(a/2), k = 2 E_b I/(L1 + L2)."""
    made = scene(three(explicit, first, second))
    k = 2.0 * MODULUS * INERTIA / (first + second)
    for angle in (0.1, 1.0, math.pi):
        x = np.array(
            [[0.0, 0, 0], [first, 0, 0], [first + second * math.cos(angle), second * math.sin(angle), 0]]
        )
        assert energy.potential(made.system, x) == pytest.approx(2.0 * k * math.sin(angle / 2.0) ** 2)
    # a quarter turn: w = (-1, 1, 0), so that k w/L2 acts on the tip against it, -k w/L1 on the first node
    x = np.array([[0.0, 0, 0], [first, 0, 0], [first, second, 0]])
    w = np.array([-1.0, 1.0, 0.0])
    expected = np.array([-k * w / first, k * w / second + k * w / first, -k * w / second])
    force = made.net.mass[:, None] * acceleration(made.system, 0.0, x, np.zeros((3, 3)))
    assert force == pytest.approx(expected, rel=1e-9, abs=1e-9 * k / first)
    assert energy.potential(made.system, made.net.reference_position) == pytest.approx(0.0, abs=1e-30)


@pytest.mark.parametrize("topology", ["square", "hexagonal", "radial"])
def test_force_is_the_slope_of_the_energy(document, scene, topology):
    """Central differences of the quadratic energy along random directions; nothing is taut."""
    made = scene(
        document(topology, divisions=3),
        {"effects.bending.modulus": MODULUS, "initial.packing": 0.3, "launch": None},
    )
    rng = np.random.default_rng(2)
    x = made.x0 + 0.01 * rng.standard_normal(made.x0.shape)
    assert not energy.elastic(made.system, x)
    force = made.net.mass[:, None] * acceleration(made.system, 0.0, x, np.zeros_like(x))
    for _ in range(3):
        way = rng.standard_normal(x.shape)
        rise = energy.potential(made.system, x + 1e-3 * way) - energy.potential(made.system, x - 1e-3 * way)
        assert -np.sum(force * way) == pytest.approx(rise / 2e-3, rel=1e-8)


def test_threads_are_joined_where_they_run_straight(explicit, scene):
    """Within 1e-6 rad: a kink of 0.9e-6 is straight, one of 1.1e-6 is not; however elements are listed."""
    for kink, joined in ((0.0, 1), (0.9e-6, 1), (1.1e-6, 0), (0.5, 0)):
        tip = [1.0 + math.cos(kink), math.sin(kink), 0.0]
        for elements in ([[0, 1], [1, 2]], [[1, 0], [1, 2]], [[0, 1], [2, 1]], [[2, 1], [1, 0]]):
            case = explicit([[0.0, 0, 0], [1.0, 0, 0], tip], elements, cable=WIRE)
            made = scene(case, {"effects.bending.modulus": MODULUS})
            assert len(made.system.hinges.pairs) == joined
            if not kink:
                x = np.array([[0.0, 0, 0], [1.0, 0, 0], [1.0, 1.0, 0]])
                k = 2.0 * MODULUS * INERTIA / 2.0
                assert energy.potential(made.system, x) == pytest.approx(k)  # |w|^2/2 = 1
                assert motion(made.system, 0.0, made.x0, made.v0)[0] == pytest.approx(0.0, abs=1e-6)


def test_elements_that_come_back_are_not_joined(explicit, scene):
    """Two elements that leave a node in the same direction enclose an angle of 180 degrees."""
    made = scene(
        explicit([[0.0, 0, 0], [1.0, 0, 0], [2.0, 0, 0]], [[0, 1], [0, 2]]), {"effects.bending.modulus": 1.0}
    )
    assert len(made.system.hinges.pairs) == 0


def test_counts_of_a_square_net(document, scene):
    """3 x 2 meshes: 3 + 4 threads with a hinge at each knot inside; divided in two, also between knots."""
    case = document("rectangular", size=[3.0, 2.0], mesh=[1.0, 1.0])
    whole = scene(case, {"effects.bending.modulus": 1.0})
    assert len(whole.system.hinges.pairs) == 3 * 2 + 4 * 1
    fine = scene(case, {"effects.bending.modulus": 1.0, "net.divisions": 2, "net.strings.divisions": 3})
    assert len(fine.system.hinges.pairs) == 3 * 5 + 4 * 3 + 4 * 2


@pytest.mark.parametrize("divisions", [1, 2])
def test_strings_are_not_joined_with_cables(document, scene, divisions):
    """A web of 4 spokes, 2 rings: hinges at the hub (2) and the inner knots (4); strings go straight on."""
    strings = {"diameter": 0.002, "density": 1390.0, "youngs_modulus": 70e9, "length": 0.5}
    made = scene(
        document("radial", spokes=4, rings=2, strings={**strings, "divisions": divisions}),
        {"effects.bending.modulus": 1.0},
    )
    assert np.ptp(made.net.area) == 0.0
    assert len(made.system.hinges.pairs) == 2 + 4 + 4 * (divisions - 1)


def test_other_sections_are_not_joined(explicit, scene):
    """Strings of another area than their own do not exist in a case: the rule is looked at on the net."""
    net = scene(explicit([[0.0, 0, 0], [1.0, 0, 0], [2.0, 0, 0]], [[0, 1], [1, 2]])).net
    assert len(hinges(Bending(1.0), net).pairs) == 1
    assert len(hinges(Bending(1.0), replace(net, area=net.area * [1.0, 1.001])).pairs) == 0


def test_free_beam_vibrates_as_the_textbook_says(explicit, scene):
    """Free-free Euler beam: omega = 22.3733, 61.6728 sqrt(E I/(rho A L^4)) (Blevins, table 8-1)."""
    n, length = 60, 1.2
    nodes = [[length * k / n, 0.0, 0.0] for k in range(n + 1)]
    made = scene(
        explicit(nodes, [[k, k + 1] for k in range(n)], cable=WIRE), {"effects.bending.modulus": MODULUS}
    )
    stiffness = np.zeros((n + 1, n + 1))
    for k in range(n + 1):
        x = np.zeros((n + 1, 3))
        x[k, 1] = 1.0
        stiffness[:, k] = gather(made.system, made.system.hinges.pull(span(made.system, x)))[:, 1]
    omega = np.sqrt(np.maximum(eigh(stiffness, np.diag(made.net.mass), eigvals_only=True), 0.0))
    unit = math.sqrt(MODULUS * INERTIA / (1000.0 * WIRE["area"] * length**4))
    assert omega[:2] == pytest.approx(0.0, abs=1e-3 * unit)  # translation and rotation
    assert omega[2] / unit == pytest.approx(22.3733, rel=2e-3)
    assert omega[3] / unit == pytest.approx(61.6728, rel=5e-3)


@pytest.mark.ci_for("Verlet")
@pytest.mark.slow_for("RK4", "Verlet")
@pytest.mark.parametrize(
    ("options", "bound"),
    [
        ({}, 1e-12),
        ({"method": "RK45", "rtol": 1e-7, "atol": 1e-9}, 1e-6),
        ({"method": "RK4", "step": 4e-5}, 1e-10),
        ({"method": "Verlet", "step": 1e-5}, 1e-5),
        ({"method": "EM", "step": 1e-3}, 1e-12),
    ],
    ids=["DOP853", "RK45", "RK4", "Verlet", "EM"],
)
def test_bent_thread_keeps_energy_and_momenta(scene, unbalanced, options, bound):
    made = scene("effects/bending.toml")
    run = made.integrate([0.0, 0.025, 0.05], **options)
    books = energy.books(made.system, run)
    assert np.ptp(books.kinetic) > 0.5 * books.potential[0] > 0.0
    assert unbalanced(made, run) < bound
    assert np.abs(books.momentum).max() < 1e-14
    assert np.abs(books.angular_momentum).max() < 1e-14


def test_assembled_arithmetic_bends_alike(document, scene):
    runs = [
        acceleration(made.system, 0.0, made.net.reference_position * [1.0, 0.9, 1.0] + 0.01, made.v0)
        for made in (
            scene(document(divisions=2), {"effects.bending.modulus": 1e9}, assembled=flag)
            for flag in (False, True)
        )
    ]
    assert runs[0] == pytest.approx(runs[1], rel=1e-11, abs=1e-11 * np.abs(runs[0]).max())
