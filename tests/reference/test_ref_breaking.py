"""Breaking and thermal strain of reference_impl: known instants, cascades, free lengths by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import brentq

from reference_impl import Diverged, energy
from reference_impl.forces import strain, tension

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


def test_force_limit(scene):
    """N = A E E11 sqrt(1 + 2 E11) = 250 N, solved by bracketing."""
    limit = brentq(lambda e: AREA * MODULUS * e * math.sqrt(1.0 + 2.0 * e) - 250.0, 0.0, 0.01, xtol=1e-16)
    made = scene("effects/breaking.toml", {"effects.breaking": {"force": 250.0}})
    assert made.system.limits == pytest.approx([limit], rel=1e-14)
    run = made.integrate([0.0, 0.02], **PRECISE)
    assert run.breaks[0].time == pytest.approx(instant(limit), rel=0, abs=2e-12)


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


@pytest.mark.ci_for("Verlet")
@pytest.mark.slow
@pytest.mark.parametrize("method", ["RK4", "Verlet"])
def test_equal_steps_break_at_their_end(scene, method, unbalanced):
    """The first multiple of the step at which the limit is passed; the books close all the same."""
    made, h = scene("effects/breaking.toml"), 1e-5
    run = made.integrate([0.0, 0.02], method=method, step=h)
    (broken,) = run.breaks
    assert broken.time == pytest.approx(math.ceil(instant(LIMIT) / h) * h, rel=1e-12)
    assert LIMIT < math.sqrt(2.0 * broken.energy / (MODULUS * AREA)) < LIMIT + SPEED * h * 1.01
    assert unbalanced(made, run) < 1e-5


@pytest.mark.slow
def test_equals_break_at_the_same_instant(document, scene, unbalanced):
    """A symmetric net pulled by four bullets: the four strings break together, with plain arithmetic too."""
    made = scene(
        document(),
        {
            "effects.breaking.strain": 5e-4,
            "initial.packing": 0.7,
            "net.cable.youngs_modulus": 1e12,
            "time.end": 1.0,
        },
    )
    run = made.integrate([0.0, 0.5, 1.0])
    strings = np.flatnonzero(made.net.of_string)
    first = [b for b in run.breaks if b.time == run.breaks[0].time]
    assert sorted(b.element for b in first) == strings.tolist()
    assert unbalanced(made, run) < 1e-9


def hanging(explicit):
    """Three masses of 1 kg on a line that hangs from a fixed node, let go unstretched."""
    return explicit(
        [[0.0, 0, 0], [0.0, -1.0, 0], [0.0, -2.0, 0], [0.0, -3.0, 0]],
        [[0, 1], [1, 2], [2, 3]],
        fixed=[0],
        node_masses=[0.0, 1.0, 1.0, 1.0],
        cable={"area": AREA, "density": 1.0, "youngs_modulus": MODULUS},
    )


def test_first_break_of_a_hanging_line(explicit, scene, unbalanced):
    """The uppermost element carries the most; its break lets the rest fall together, slack."""
    gravity = {"effects.gravity.acceleration": [0.0, -9.81, 0.0]}
    made = scene(hanging(explicit), {"effects.breaking.force": 40.0, **gravity})
    run = made.integrate([0.0, 0.05, 0.1])
    assert run.breaks[0].element == 0
    assert [b.time for b in run.breaks] == sorted(b.time for b in run.breaks)
    assert unbalanced(made, run) < 1e-9
    centre = run.v[1:, 1:, 1] @ made.net.mass[1:] / made.net.mass[1:].sum()
    assert np.diff(centre)[0] == pytest.approx(-9.81 * 0.05, rel=1e-9)


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
    for options in ({}, {"method": "RK4", "step": 1e-4}):
        run = made.integrate([0.0, 0.01], **options)
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


@pytest.mark.ci
@pytest.mark.slow
def test_symmetric_net_breaks_symmetrically(document, scene, bullet_speeds):
    made = scene(
        document(), {"effects.breaking.strain": 4e-4, "initial.packing": 0.7, "time.end": 1.0}, symmetric=True
    )
    run = made.integrate([0.0, 0.4, 0.8])
    assert run.breaks
    speeds = bullet_speeds(made, run)
    assert np.all(speeds == speeds[:, :1])


def test_energy_momentum_refuses_breaking(scene):
    made = scene("effects/breaking.toml")
    with pytest.raises(ValueError, match=r"effects\.breaking, which ends an element's energy"):
        made.integrate(method="EM", step=1e-4)


THERMAL = {"temperature_change": -200.0, "expansion_coefficient": 2e-5}  # shrinks by 0.4 %


def test_free_length_and_tension_by_hand(explicit, scene):
    """Free of stress at 0.996 m; at 1 m held by E A (E11 - e), e = -0.004 + 0.000008."""
    case = explicit(
        [[0.0, 0, 0], [1.0, 0, 0]],
        [[0, 1]],
        cable={"area": AREA, "density": 1000.0, "youngs_modulus": MODULUS},
    )
    made = scene(case, {"effects.thermal_strain": THERMAL})
    for length, force in (
        (0.996, 0.0),
        (0.99, 0.0),
        (1.0, MODULUS * AREA * 0.003992),
        (1.01, MODULUS * AREA * 1.01 * (0.01005 + 0.003992)),
    ):
        x = np.array([[0.0, 0, 0], [length, 0, 0]])
        assert tension(made.system, x) == pytest.approx([force], rel=1e-12, abs=1e-9)
        assert strain(made.system, x) == pytest.approx([0.5 * (length**2 - 1.0)], abs=1e-15)
        stored = 0.5 * MODULUS * AREA * max(0.5 * (length**2 - 1.0) + 0.003992, 0.0) ** 2
        assert energy.elastic(made.system, x) == pytest.approx(stored, rel=1e-11, abs=1e-12)
    warm = scene(case, {"effects.thermal_strain": {**THERMAL, "temperature_change": 200.0}})
    assert tension(warm.system, np.array([[0.0, 0, 0], [1.0039, 0, 0]])) == pytest.approx([0.0])
    assert tension(warm.system, np.array([[0.0, 0, 0], [1.0041, 0, 0]]))[0] > 0.0


@pytest.mark.parametrize("change", [200.0, -200.0])
def test_free_strain_does_not_count_at_a_break(scene, change):
    """docs/theory.md: the limit is of E11 - e; the same way beyond the free length, from there on."""
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


@pytest.mark.slow_for("RK4")
@pytest.mark.parametrize(
    ("options", "bound"),
    [({}, 1e-8), ({"method": "EM", "step": 2e-5}, 1e-11), ({"method": "RK4", "step": 1e-6}, 1e-6)],
    ids=["DOP853", "EM", "RK4"],
)
def test_cooling_net_keeps_its_energy(scene, unbalanced, options, bound):
    made = scene("effects/thermal_strain.toml")
    run = made.integrate([0.0, 0.002, 0.004], **options)
    assert np.ptp(energy.kinetic(made.system, run.v)) > 0.1 * energy.elastic(made.system, run.x)[0] > 0.0
    assert unbalanced(made, run) < bound


@pytest.mark.ci
@pytest.mark.slow
def test_material_damping_acts_beyond_the_free_length(explicit, scene, unbalanced):
    """A snap with viscous stress of a cable made longer: nothing happens before 1.004 m."""
    made = scene(
        "effects/material_damping.toml", {"effects.thermal_strain": {**THERMAL, "temperature_change": 200.0}}
    )
    run = made.integrate([0.0, 0.0015, 0.01], **PRECISE)
    assert run.dissipated[1] == 0.0
    assert run.dissipated[2] > 0.01
    assert unbalanced(made, run) < 1e-9


def test_divergence_reports_with_broken_elements(document, scene):
    made = scene(document(), {"effects.breaking.strain": 1e-3})
    with pytest.raises(Diverged):
        made.integrate(method="RK4", step=5e-3, x0=made.x0 * 1e200)
