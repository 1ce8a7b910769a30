"""What estimates rest on: the nominal motion and the hardest snap, of nets that are known by hand."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scenes import chain, opening

from exunet.forces.effects import launch_force, material_damping, orbit
from exunet.forces.estimate import EstimateBasis, hardest_strain, snap_of


def test_the_hardest_snap_is_that_of_the_largest_strain() -> None:
    """v sqrt(mu / (EA L)): 3 sqrt(0.2083 / 500) of the first element, 4 sqrt(0.5556 / 2000) of the second."""
    snap = snap_of(chain())
    reduced, other = 1.0 / (1.0 / 1.25 + 1.0), 1.0 / (1.0 / 0.25 + 1.0 / 1.25)
    assert 3.0 * math.sqrt(other / 500.0) < 4.0 * math.sqrt(reduced / 2000.0)
    assert snap.speed == 4.0
    assert snap.strain == pytest.approx(4.0 * math.sqrt(reduced / 2000.0), rel=1e-12)
    assert snap.frequency == pytest.approx(math.sqrt(1000.0 / 2.0 / reduced), rel=1e-12)


def test_a_snap_against_a_fixed_node_moves_the_other_alone() -> None:
    snap = snap_of(chain(fixed=[1]))
    assert snap.strain == pytest.approx(4.0 * math.sqrt(1.0 / 2000.0), rel=1e-12)
    assert snap.frequency == pytest.approx(math.sqrt(500.0), rel=1e-12)


@pytest.mark.parametrize("duration", [0.4, 5.0])
def test_the_nominal_motion_opens_the_net_as_the_bullets_fly(duration: float) -> None:
    """0.9 sqrt(2) m at 2 m/s; 12 kg of cable and 12 kg of bullets, which alone rise at the start."""
    basis = opening(duration)
    net, time = basis.net, 0.9 * math.sqrt(2.0) / 2.0
    assert basis.opening_time == pytest.approx(time, rel=1e-12)
    # 12 sides of 1 kg; a corner ends two of them: 1 kg, and its bullet.
    rise = 4.0 * 4.0 / (12.0 + 12.0)
    wanted = 0.9 * net.reference_position / time + [0.0, 0.0, rise]
    wanted[net.bullet_nodes] = basis.velocity[net.bullet_nodes]
    np.testing.assert_allclose(basis.motion, wanted, rtol=1e-12, atol=1e-14)
    half = 0.5 * min(duration, time)
    np.testing.assert_allclose(basis.middle, basis.position + half * wanted, rtol=1e-12, atol=1e-14)
    assert basis.rms(wanted) == pytest.approx(
        math.sqrt(float(net.mass @ (wanted**2).sum(axis=1)) / 24.0), rel=1e-12
    )


def test_the_hardest_strain_is_of_a_bullet_that_one_element_stops() -> None:
    """sqrt(m v^2 / (EA L)) of 4 kg at the speed relative to the mean of the motion."""
    basis = opening(0.4)
    relative = basis.velocity[basis.net.bullet_nodes] - basis.motion.mean(axis=0)
    assert np.ptp(np.linalg.norm(relative, axis=1)) < 1e-12
    strain = math.sqrt(4.0 * float(relative[0] @ relative[0]) / 1000.0)
    assert strain > snap_of(basis).strain
    assert hardest_strain(basis) == pytest.approx(strain, rel=1e-12)
    stiffness, length = np.linspace(1.0, 0.5, 12), np.linspace(0.3, 1.5, 12)  # EA L is least of the first
    net = replace(basis.net, youngs_modulus=1e6 * stiffness, reference_length=length)
    mixed = replace(basis, net=net)
    assert hardest_strain(mixed) == pytest.approx(strain / math.sqrt(0.3), rel=1e-12)


def test_ways_of_constant_accelerations_and_decaying_speeds() -> None:
    basis = opening(0.4)
    assert basis.ballistic(3.0) == pytest.approx(0.5 * 3.0 * 0.16, rel=1e-12)
    time = np.linspace(0.0, 0.4, 20001)
    for rate in (1e-6, 2e-4, 0.5, 30.0):  # the first two lose less than 1e-4, where digits would cancel
        way = basis.speed * np.trapezoid(-np.expm1(-rate * time), time)
        assert basis.braked(rate) == pytest.approx(way, rel=1e-4)


def test_a_launch_lags_behind_by_its_stroke_or_makes_the_way() -> None:
    """Springs of 60 N over 0.1 m do 3 J on bullets of 4 kg; 16 of 24 kg are the bullets'."""
    keys = launch_force.LaunchForceConfig.model_validate(
        {"kind": "spring", "force": 60.0, "stroke": 0.1, "spread_angle": 0.6, "chaser_mass": 500.0}
    )
    basis = opening(0.4)
    part = math.sqrt(16.0 / 24.0)
    flying = launch_force.magnitude(keys, basis)
    assert flying.displacement == pytest.approx(0.1 * part, rel=1e-12)
    still = EstimateBasis(basis.net, 0.4, basis.position, np.zeros((9, 3)))
    launched = launch_force.magnitude(keys, still)
    assert launched.displacement == pytest.approx(math.sqrt(2.0 * 3.0 / 4.0) * 0.4 * part, rel=1e-12)
    assert flying.acceleration == launched.acceleration == pytest.approx(60.0 / 4.0 * part, rel=1e-12)


def test_material_damping_takes_speed_in_the_hardest_snap() -> None:
    """v (1 - exp(-pi tau omega / 2)) over half of the time; beyond critical damping all of it."""
    basis = opening(0.4)
    snap = snap_of(basis)
    for ratio in (0.1, 0.7, 1.5):
        keys = material_damping.MaterialDampingConfig(relaxation_time=2.0 * ratio / snap.frequency)
        found = material_damping.magnitude(keys, basis)
        lost = 1.0 - math.exp(-math.pi * ratio) if ratio < 1.0 else 1.0
        assert found.displacement == pytest.approx(lost * basis.speed * 0.2, rel=1e-12)
        assert found.acceleration == pytest.approx(2.0 * ratio * snap.frequency * basis.speed, rel=1e-12)


def test_the_orbit_accelerates_the_nominal_motion_as_its_forces_do() -> None:
    """With 2 rad/s, Coriolis force and gradient are alike; without symmetry, their sum tells their signs."""
    keys = orbit.OrbitConfig.model_validate(
        {"mean_motion": 2.0, "radial": [0.0, 0.6, 0.8], "along_track": [1.0, 0.0, 0.0], "model": "linear"}
    )
    basis = chain()
    (term,) = orbit.terms(keys, basis.blocks)
    force = -(term.gyroscopic @ basis.motion.ravel()) - term.stiffness @ basis.middle.ravel()
    wanted = basis.of_force(force.reshape(-1, 3))
    found = orbit.magnitude(keys, basis)
    assert found.acceleration == pytest.approx(wanted, rel=1e-12)
    assert found.displacement == pytest.approx(basis.ballistic(wanted), rel=1e-12)
