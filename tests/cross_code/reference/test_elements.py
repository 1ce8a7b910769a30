"""Forces and matrices of elements of reference_impl, bending, breaking, thermal strain."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.integrate import quad

from reference_impl import System, acceleration, energy
from reference_impl import forces as mechanics
from reference_impl.forces import motion, tension


@pytest.fixture(scope="module", params=["square", "hexagonal", "radial"])
def shaken(request, document, scene):
    """A net with damping and gravity in a random state, some elements taut, some slack."""
    made = scene(
        document(request.param),
        {
            "effects.rayleigh_damping": {"alpha": 0.3, "beta": 1e-5},
            "effects.gravity.acceleration": [1.0, 2.0, -9.81],
        },
    )
    rng = np.random.default_rng(7)
    shape = made.net.reference_position.shape
    x = made.net.reference_position + 0.05 * rng.standard_normal(shape)
    return made.system, x, rng.standard_normal(shape), rng


def dense_forces(system, x):
    """Nodal forces element by element, as in the paper."""
    net, force = system.net, np.zeros_like(x)
    for e, (i, j) in enumerate(net.element_nodes):
        squared = float(np.sum((x[j] - x[i]) ** 2))
        e11 = 0.5 * (squared - net.reference_length[e] ** 2) / net.reference_length[e] ** 2  # eq. (6)
        s11 = net.youngs_modulus[e] * e11 if e11 >= 0 else 0.0  # eq. (8)
        pull = s11 * net.area[e] / net.reference_length[e] * (x[j] - x[i])  # eq. (3)
        force[j] += pull
        force[i] -= pull
    return force


def test_elastic_forces_are_those_of_the_secant_stiffness(shaken):
    system, x, _, _ = shaken
    e11 = mechanics.strain(system, x)
    assert (e11 > 0).any()
    assert (e11 < 0).any()
    force = mechanics.elastic_forces(system, x)
    size = np.abs(force).max()
    assert np.allclose(force, dense_forces(system, x), rtol=0, atol=1e-12 * size)
    assert np.allclose(force.ravel(), mechanics.secant(system, x) @ x.ravel(), rtol=0, atol=1e-11 * size)


@pytest.mark.parametrize("arithmetic", ["symmetric", "assembled"])
def test_other_arithmetic_gives_the_same_forces(shaken, arithmetic):
    system, x, v, _ = shaken
    other = System(system.net, system.effects, **{arithmetic: True})
    size = np.abs(acceleration(system, 0.0, x, v)).max()
    assert np.allclose(
        acceleration(system, 0.0, x, v), acceleration(other, 0.0, x, v), rtol=0, atol=1e-12 * size
    )


def test_tangent_is_the_derivative_of_the_nodal_forces(shaken):
    """Eq. (5) against the complex step, which has no truncation error to speak of."""
    system, x, _, rng = shaken
    step = rng.standard_normal(x.shape)
    d = mechanics.span(system, x + 1e-30j * step)
    e11 = 0.5 * (mechanics.dot(d, d) / system.squared_reference_length - 1.0)
    pull = (np.where(e11.real >= 0, e11, 0.0) * system.axial_stiffness)[:, None] * d
    derivative = (system.incidence @ pull).imag / 1e-30
    tangent = (mechanics.tangent(system, x) @ step.ravel()).reshape(x.shape)
    assert np.allclose(tangent, derivative, rtol=0, atol=1e-12 * np.abs(derivative).max())
    h = 1e-6
    central = (
        mechanics.elastic_forces(system, x + h * step) - mechanics.elastic_forces(system, x - h * step)
    ) / (2 * h)
    assert np.allclose(tangent, central, rtol=0, atol=1e-8 * np.abs(central).max())


def test_element_tangent_against_the_closed_form(explicit, scene):
    """dN/dl = (E A / L0)(3 lambda^2 - 1)/2."""
    system = scene(explicit([[0.0, 0, 0], [2.0, 0, 0]], [[0, 1]])).system
    for stretch in (1.0, 1.01, 1.5):
        x = np.array([[0.0, 0, 0], [2.0 * stretch, 0, 0]])
        expected = system.axial_stiffness[0] * (3 * stretch**2 - 1) / 2
        assert mechanics.tangent_element(system, x)[0, 3, 3] == pytest.approx(expected, rel=1e-13)


def test_acceleration_is_equation_16(shaken):
    system, x, v, _ = shaken
    right = (system.weight - mechanics.elastic_forces(system, x)).ravel()
    right -= mechanics.damping(system) @ v.ravel()
    expected = right.reshape(x.shape) / system.net.mass[:, None]
    assert np.allclose(acceleration(system, 0.0, x, v), expected, rtol=0, atol=1e-12 * np.abs(expected).max())
    assert mechanics.motion(system, 0.0, x, v)[1] == pytest.approx(
        v.ravel() @ (mechanics.damping(system) @ v.ravel())
    )


WIRE = {"area": math.pi / 4.0 * 0.004**2, "density": 1000.0, "youngs_modulus": 1e9}
BENDING = 2e9  # [Pa]
INERTIA = math.pi / 64.0 * 0.004**4  # of a circle, any textbook


def three(explicit, first, second):
    """Three nodes on x, elements of the given lengths."""
    case = explicit([[0.0, 0, 0], [first, 0, 0], [first + second, 0, 0]], [[0, 1], [1, 2]], cable=WIRE)
    return {**case, "effects": {"bending": {"modulus": BENDING}}}


@pytest.mark.parametrize(("first", "second"), [(0.2, 0.2), (0.2, 0.5), (0.7, 0.1)])
def test_three_nodes_by_hand(explicit, scene, first, second):
    """Bent by the angle a: |d2/L2 - d1/L1| = 2 sin(a/2), k = 2 E_b I/(L1 + L2)."""
    made = scene(three(explicit, first, second))
    k = 2.0 * BENDING * INERTIA / (first + second)
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
        {"effects.bending.modulus": BENDING, "initial.packing": 0.3, "launch": None},
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
            made = scene(case, {"effects.bending.modulus": BENDING})
            assert len(made.system.hinges.pairs) == joined
            if not kink:
                x = np.array([[0.0, 0, 0], [1.0, 0, 0], [1.0, 1.0, 0]])
                k = 2.0 * BENDING * INERTIA / 2.0
                assert energy.potential(made.system, x) == pytest.approx(k)  # |w|^2/2 = 1
                assert motion(made.system, 0.0, made.x0, made.v0)[0] == pytest.approx(0.0, abs=1e-6)


MODULUS, AREA, LIMIT, SPEED = 70e9, math.pi / 4.0 * 1e-6, 0.004, 2.5  # cases/effects/breaking.toml
REDUCED = 0.25 + 0.25 * 0.5 * AREA * 1.0 / 0.5  # [kg] of two masses of 0.5 kg and half a cable each


def instant(limit, free=0.0, begin=1.0):
    """When two masses that part at SPEED reach E11 = limit: quadrature of the energy integral.

    m s'^2/2 + E A (E11 - e)^2/2 = m v^2/2 with E11 = (s^2 - 1)/2 on a cable of 1 m; free flight before.
    """

    def slowness(s):
        over = max(0.5 * (s * s - 1.0) - free, 0.0)
        return 1.0 / math.sqrt(SPEED**2 - MODULUS * AREA / REDUCED * over * over)

    taut = math.sqrt(1.0 + 2.0 * free)
    end = math.sqrt(1.0 + 2.0 * limit)
    return (taut - begin) / SPEED + quad(slowness, taut, end, epsabs=1e-15, epsrel=1e-13)[0]


PRECISE = {"rtol": 1e-12, "atol": 1e-14}


@pytest.mark.parametrize(
    ("options", "bound"),
    [
        (PRECISE, 2e-12),
        ({}, 1e-10),
        ({"method": "RK45", "rtol": 1e-10, "atol": 1e-12}, 1e-11),
        ({"method": "RK45"}, 1e-5),
    ],
    ids=["DOP853 precise", "DOP853", "RK45 precise", "RK45"],
)
def test_instant_of_a_break(scene, unbalanced, options, bound):
    """Two masses snap on a cable; the instant by quadrature, the energy E A L E11^2/2 by hand."""
    made = scene("effects/breaking.toml")
    run = made.integrate([0.0, 1e-3, 0.02], **options)
    assert [b.element for b in run.breaks] == [0]
    (broken,) = run.breaks
    assert broken.time == pytest.approx(instant(LIMIT), rel=0, abs=bound)
    assert broken.energy == pytest.approx(0.5 * MODULUS * AREA * LIMIT**2, rel=1e3 * bound)
    assert run.dissipated == pytest.approx([0.0, 0.0, broken.energy])
    assert run.intact[:, 0].tolist() == [True, True, False]
    assert not tension(made.system, run.x, run.intact)[-1].any()
    assert not energy.elastic(made.system, run.x, run.intact)[-1]
    left = 0.5 * REDUCED * SPEED**2 - broken.energy
    assert np.diff(run.v[-1, :, 0])[0] == pytest.approx(math.sqrt(2.0 * left / REDUCED), rel=1e3 * bound)
    assert unbalanced(made, run) < (1e-10 if "rtol" in options or not options else 1e-3)


@pytest.mark.parametrize(("share", "breaks"), [(0.99999999, 1), (1.00000001, 0)])
def test_limits_that_are_hardly_reached_inside_a_step(scene, share, breaks):
    """The greatest strain is 5.331e-3 at the turning point: 1e-8 of it decides, between two steps or not."""
    whole = 0.5 * REDUCED * SPEED**2
    peak = math.sqrt(2.0 * whole / (MODULUS * AREA))
    made = scene("effects/breaking.toml", {"effects.breaking.strain": share * peak})
    for options in (PRECISE, {"rtol": 1e-9, "atol": 1e-11}):
        run = made.integrate([0.0, 0.02], **options)
        assert len(run.breaks) == breaks
        if breaks:
            assert run.breaks[0].energy == pytest.approx(whole, rel=1e-7)


def test_cascade_of_parallel_cables(explicit, scene, unbalanced):
    """Three cables of 1.0, 1.0 and 1.001 m between two masses: two break together, then the third alone."""
    case = explicit(
        [[0.0, 0, 0], [1.0, 0, 0], [1.001, 0, 0]],
        [[0, 1], [0, 1], [0, 2], [1, 2]],
        {
            "node_positions": [[0.0, 0, 0], [1.0, 0, 0], [1.0, 0, 0]],
            "node_velocities": [[-3.0, 0, 0], *[[3.0, 0, 0]] * 2],
        },
        node_masses=[1.0, 0.5, 0.5],
        cable={"area": AREA, "density": 1.0, "youngs_modulus": MODULUS},
    )
    made = scene(case, {"effects.breaking.strain": 0.002})
    run = made.integrate([0.0, 0.01])
    assert [b.element for b in run.breaks] == [0, 1, 2]
    first, second, third = (b.time for b in run.breaks)
    assert first == second < third
    assert unbalanced(made, run) < 1e-9


def test_overstretched_at_the_start_breaks_at_once(scene, unbalanced):
    made = scene("effects/breaking.toml", {"initial.packing": 1.01})
    run = made.integrate([0.0, 0.01])
    assert run.breaks[0].time == 0.0
    assert run.dissipated[0] == pytest.approx(0.5 * MODULUS * AREA * (0.5 * (1.01**2 - 1.0)) ** 2)
    assert unbalanced(made, run) < 1e-14


@pytest.mark.ci
@pytest.mark.slow
def test_break_between_stored_times_of_ode45(scene):
    """RK45 interpolates: states stored in the step that ends with the break are still whole."""
    made = scene("effects/breaking.toml")
    times = np.linspace(0.0, 0.004, 401)
    run = made.integrate(times, method="RK45", rtol=1e-8, atol=1e-10)
    assert np.array_equal(run.intact[:, 0], times < run.breaks[0].time)
    fine = made.integrate(times, **PRECISE)
    assert np.abs(run.x - fine.x).max() < 1e-8
    assert np.abs(run.dissipated - fine.dissipated).max() < 1e-6


THERMAL = {"temperature_change": -200.0, "expansion_coefficient": 2e-5}  # shrinks by 0.4 %


@pytest.mark.parametrize("change", [200.0, -200.0])
def test_free_strain_does_not_count_at_a_break(scene, change):
    """theory_effects.md: the limit is of E11 - e; the same way beyond the free length, from there on."""
    begin = 0.9
    made = scene(
        "effects/breaking.toml",
        {
            "effects.thermal_strain": {**THERMAL, "temperature_change": change},
            "initial.packing": begin,
            "effects.breaking.strain": 0.003,
        },
    )
    stretch = 2e-5 * change
    free = stretch + 0.5 * stretch**2
    run = made.integrate([0.0, 0.06], **PRECISE)
    expected = instant(free + 0.003, free, begin)
    assert run.breaks[0].time == pytest.approx(expected, rel=0, abs=5e-12)
    assert run.breaks[0].energy == pytest.approx(0.5 * MODULUS * AREA * 0.003**2, rel=1e-9)
