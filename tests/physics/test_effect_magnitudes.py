"""The estimated magnitude of each effect in a scene, against hand calculations on small nets."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from pydantic import TypeAdapter
from scenes import basis_of, chain, opening

from exunet.forces.effects import (
    air_drag,
    bending,
    breaking,
    contact,
    j2,
    launch_force,
    mass_damping,
    molecular_drag,
    rayleigh_damping,
    self_contact,
    solar_pressure,
    thermal_strain,
    thrust,
)
from exunet.forces.environment import (
    EARTH_RADIUS,
    CircularOrbitConfig,
)
from exunet.forces.estimate import EstimateBasis, hardest_strain, snap_of

Floats = np.ndarray
WIDTH = 2.0 * math.sqrt(1e-3 / math.pi)  # [m] of the cables
AXES = {"radial": (0.0, 0.6, 0.8), "along_track": (0.6, 0.64, -0.48)}


def rms(basis: EstimateBasis, nodal: Floats) -> float:
    """Of free nodes, by their mass."""
    free = np.ones(basis.net.n_nodes)
    free[basis.net.fixed_nodes] = 0.0
    mass = free * basis.net.mass
    return math.sqrt(float(mass @ (nodal**2).sum(axis=1)) / float(mass.sum()))


def assert_magnitude(found: Any, acceleration: float, displacement: float, rel: float = 1e-12) -> None:
    assert found.acceleration == pytest.approx(acceleration, rel=rel)
    assert found.displacement == pytest.approx(displacement, rel=rel)


def skewed(duration: float = 0.4, **net: Any) -> EstimateBasis:
    """The chain, in no plane and everywhere on the move."""
    place = [[0.0, 0.1, -0.2], [0.3, -0.1, 0.1], [1.1, 0.8, 0.5]]
    speed = [[0.5, -0.2, 0.3], [1.5, 0.4, -0.6], [2.0, 3.0, 1.0]]
    first = chain(**net)
    return EstimateBasis(first.net, duration, np.array(place), np.array(speed))


def cross_flow(basis: EstimateBasis, density: float, coefficient: float) -> Floats:
    """rho C d L |u| u / 2 across each element, half of it on each end [N]."""
    force, x, v = np.zeros((basis.net.n_nodes, 3)), basis.middle, basis.motion
    for (i, j), length in zip(basis.net.element_nodes, basis.net.reference_length, strict=True):
        along = (x[j] - x[i]) / np.linalg.norm(x[j] - x[i])
        u = 0.5 * (v[i] + v[j])
        u = u - (u @ along) * along
        force[[i, j]] -= 0.25 * density * coefficient * WIDTH * length * np.linalg.norm(u) * u
    return force


@pytest.mark.parametrize("thrown", ["bullets", "all", "chain"])
def test_air_drag(thrown: str) -> None:
    """Cables that bullets pull from rest gain their speed over the scene: a sixth of the effect."""
    basis = skewed() if thrown == "chain" else opening(0.4)
    if thrown == "all":
        basis = EstimateBasis(basis.net, 0.4, basis.position, basis.velocity + np.array([0.0, 0.0, 0.5]))
    on_bullets = {"bullet_drag_coefficient": 0.4, "bullet_area": 0.02}
    keys = air_drag.AirDrag(density=1.3, drag_coefficient=1.2, **on_bullets)
    parts = [rms(basis, cross_flow(basis, 1.3, 1.2) / basis.net.mass[:, None])]
    bullets = basis.net.bullet_nodes
    if thrown != "chain":
        v, push = basis.motion[bullets], np.zeros((basis.net.n_nodes, 3))
        push[bullets] = -0.5 * 1.3 * 0.4 * 0.02 * np.linalg.norm(v, axis=1, keepdims=True) * v
        parts.append(rms(basis, push / basis.net.mass[:, None]))
    found = keys.magnitude(basis)
    assert found.acceleration == pytest.approx(math.hypot(*parts), rel=1e-12)
    lasting = math.hypot(parts[0] / (6.0 if thrown == "bullets" else 1.0), *parts[1:])
    way = basis.braked(lasting / rms(basis, basis.motion))
    assert found.displacement == pytest.approx(way, rel=1e-12)


def test_no_speed_has_no_drag() -> None:
    basis = skewed()
    still = EstimateBasis(basis.net, 0.4, basis.position, 0.0 * basis.velocity)
    keys = air_drag.AirDrag(density=1.3, drag_coefficient=1.2)
    found = keys.magnitude(still)
    damped = rayleigh_damping.RayleighDamping(alpha=0.3, beta=1e-3).magnitude(still)
    for item in (found, damped):
        assert (item.acceleration, item.displacement) == (0.0, 0.0)


@pytest.mark.parametrize("modulus", [1e3, 1e9])
def test_bending(modulus: float) -> None:
    """Six threads of 2 m with a joint each: k = E A^2 / (4 pi L), weights 1, -2 and 1 over L."""
    net = {"topology": "square", "size": 1.2, "mesh": 0.6, "bullets": {"mass": 3.0}}
    basis = basis_of(net, opening(0.4).position, opening(0.4).velocity, 0.4)
    k = modulus * 1e-6 / (4.0 * math.pi * 0.6)
    # Corners end two threads; nodes between them end one, and are the middle of one; the centre of two.
    squares = {2: 2.0, 3: 5.0, 4: 8.0}
    force = np.zeros((9, 3))
    ends = np.bincount(basis.net.element_nodes.ravel())
    force[:, 0] = [k / 0.6 * math.sqrt(squares[int(n)]) for n in ends]
    wanted = rms(basis, force / basis.net.mass[:, None])
    found = bending.Bending(modulus=modulus).magnitude(basis)
    assert found.acceleration == pytest.approx(wanted, rel=1e-12)
    way = min(0.5 * wanted * 0.16, 0.5 * 0.6)  # half a radian of half an element's length
    assert found.displacement == pytest.approx(way, rel=1e-12)
    assert (way == 0.3) == (modulus == 1e9)


def test_breaking() -> None:
    """Nothing up to the limit, and at it; beyond it the hardest snap, and the flight of what breaks off."""
    basis = opening(0.4)
    snap, strain = snap_of(basis), hardest_strain(basis)
    assert strain > snap.strain > 0.0
    assert breaking.Breaking(strain=strain).magnitude(basis).acceleration == 0.0
    stiffness = 500.0  # of the softest
    net = replace(basis.net, youngs_modulus=basis.net.youngs_modulus * np.linspace(0.5, 2.0, 12))
    mixed = replace(basis, net=net)
    for part, breaks in ((1.001, False), (0.999, True)):
        for one, keys in (
            (basis, breaking.Breaking(strain=part * strain)),
            (mixed, breaking.Breaking(force=part * hardest_strain(mixed) * stiffness)),
        ):
            found, snap = keys.magnitude(one), snap_of(one)
            assert found.acceleration == (snap.frequency * snap.speed if breaks else 0.0)
            way = rms(one, one.motion) * 0.4 if breaks else 0.0
            assert found.displacement == pytest.approx(way, rel=1e-12)


def test_limits_of_breaking_are_forces() -> None:
    """EA e sqrt(1 + 2 (e + e_free)): the strain relative to the reference length is both together."""
    net = chain().net
    given = breaking.Breaking(strain=0.04).breaking_limits(net, 0.01)
    np.testing.assert_allclose(given, 1e3 * 0.04 * math.sqrt(1.1), rtol=1e-13)
    assert breaking.Breaking(force=7.0).breaking_limits(net, 0.0).tolist() == [7.0, 7.0]


def test_oblateness_accelerates_by_the_gradient() -> None:
    keys = j2.J2(altitude=500e3, inclination=1.1, argument_of_latitude=0.7, **AXES)
    basis = skewed()
    found = keys.magnitude(basis)
    wanted = rms(basis, basis.middle @ keys.gradient())
    assert_magnitude(found, wanted, 0.5 * wanted * 0.16)


def test_the_assumed_launch_gives_the_bullets_the_speed_they_have() -> None:
    """Springs of 0.05 m that do m v^2 / 2 of 4 kg at sqrt(5) m/s, along it; nothing of bullets at rest."""
    basis = opening(0.4)
    found = launch_force.LaunchForce.nominal(basis)
    assert found is not None
    assert found[0].work == pytest.approx(0.5 * 4.0 * 5.0, rel=1e-12)
    assert found[0].stroke == 0.05
    assert math.tan(found[0].spread_angle) == pytest.approx(2.0, rel=1e-12)
    still = EstimateBasis(basis.net, 0.4, basis.position, 0.0 * basis.velocity)
    assert launch_force.LaunchForce.nominal(still) is None
    assert launch_force.LaunchForce.nominal(skewed()) is None


def test_damping_by_the_mass() -> None:
    basis = skewed()
    found = mass_damping.MassDamping(alpha=0.3).magnitude(basis)
    assert_magnitude(found, 0.3 * rms(basis, basis.motion), basis.braked(0.3))


def test_rayleigh_damping() -> None:
    """alpha M v + beta K v, K of just taut elements along x, on the speeds of the start."""
    basis, alpha, beta = skewed(), 0.3, 1e-4
    force = alpha * basis.net.mass[:, None] * basis.velocity
    for (i, j), length in zip(basis.net.element_nodes, (0.5, 2.0), strict=True):
        pull = beta * 1e3 / length * (basis.velocity[j] - basis.velocity[i])[0]
        force[i, 0] -= pull
        force[j, 0] += pull
    rate = rms(basis, force / basis.net.mass[:, None]) / rms(basis, basis.velocity)
    found = rayleigh_damping.RayleighDamping(alpha=alpha, beta=beta).magnitude(basis)
    assert_magnitude(found, rate * rms(basis, basis.motion), basis.braked(rate))


def test_thrust() -> None:
    """A constant force exactly; each piece of one that changes as if it came in the middle of its time.

    Of 24 kg two bullets with their share of the cables, 8 kg, are pushed.
    """
    basis, part = opening(0.5), math.sqrt(8.0 / 24.0)
    force = np.array([3.0, -4.0, 12.0])  # 13 N

    def found(times: list[float], forces: Any) -> Any:
        keys = thrust.Thrust.model_validate(
            {"bullets": [0, 2], "time": times, "force": np.array(forces).tolist()}
        )
        return keys.magnitude(basis)

    constant = found([0.1, 0.3, 0.4], [force] * 3)
    # 13/4 m/s2 for 0.3 s, and then 0.1 s at the speed of that.
    assert_magnitude(constant, 13.0 / 4.0 * part, 13.0 / 4.0 * (0.045 + 0.03) * part)
    varied = found([0.1, 0.3, 0.9], [force, 2.0 * force, -0.5 * force])
    path = 0.2 * 1.5 * (0.5 - 0.2) + 0.2 * 0.75 * (0.5 - 0.4)  # the last ends with the scene
    assert_magnitude(varied, 26.0 / 4.0 * part, 13.0 / 4.0 * path * part)


def areas(basis: EstimateBasis, bullet: float) -> Floats:
    """Quarter of the surface of the half elements at each node, and what a bullet adds [m2]."""
    ends = zip(basis.net.element_nodes, basis.net.reference_length, strict=True)
    found = np.zeros(basis.net.n_nodes)
    for nodes, length in ends:
        found[nodes] += 0.25 * math.pi * WIDTH * 0.5 * length
    found[basis.net.bullet_nodes] += bullet
    return found


@pytest.mark.parametrize("bullet", [0.0, 0.02])
def test_thin_gas_and_sunlight(bullet: float) -> None:
    basis = opening(0.4) if bullet else skewed()
    area = areas(basis, bullet)
    flow = (300.0, -200.0, 600.0)
    keys = molecular_drag.MolecularDrag(
        density=2e-3, flow=flow, drag_coefficient=2.2, bullet_area=bullet or None
    )
    wanted = rms(basis, np.outer(0.5 * 2e-3 * 2.2 * area * 700.0 / basis.net.mass, flow))
    found = keys.magnitude(basis)
    assert_magnitude(found, wanted, 0.5 * wanted * 0.16)
    (term,) = keys.terms(basis.blocks)
    rate = 2.0 * 700.0 * (0.5 * 2e-3 * 2.2 * area / basis.net.mass).max()
    assert term.damping_rate == pytest.approx(rate, rel=1e-12)
    light = solar_pressure.SolarPressure(flux=1e9, direction=(0.6, 0.0, 0.8), pressure_coefficient=1.4,
                                bullet_area=bullet or None)  # fmt: skip
    wanted = rms(basis, np.outer(1.4e9 / 299792458.0 * area / basis.net.mass, (0.6, 0.0, 0.8)))
    found = light.magnitude(basis)
    assert_magnitude(found, wanted, 0.5 * wanted * 0.16)


def test_an_orbit_by_its_height_or_its_mean_motion() -> None:
    """n^2 R^3 = mu; at 500 km a revolution takes 5677 s."""
    high = CircularOrbitConfig(altitude=500e3, **AXES)
    assert 2.0 * math.pi / high.rate == pytest.approx(5677.0, abs=0.5)
    assert high.rate**2 * (EARTH_RADIUS + 500e3) ** 3 == pytest.approx(3.986004418e14, rel=1e-12)
    assert high.radius == pytest.approx(EARTH_RADIUS + 500e3, rel=1e-14)
    assert high.height == 500e3
    same = CircularOrbitConfig(mean_motion=high.rate, **AXES)
    assert same.rate == high.rate
    assert same.height == pytest.approx(500e3, rel=1e-9)


def test_threads_that_touch_each_other() -> None:
    """pi/8 times mean length, speed, whole length and time over the volume; half the way for each."""
    basis = opening(1.0)
    basis = EstimateBasis(basis.net, 1.0, basis.position, basis.velocity + np.array([0.3, -0.2, 0.1]))
    speed = rms(basis, basis.velocity - basis.net.mass @ basis.velocity / 24.0)
    lasts = 1.0 - basis.opening_time
    keys = self_contact.SelfContact.model_validate({"stiffness": 50.0, "damping": 0.0})
    found = keys.magnitude(basis)
    meetings = math.pi / 8.0 * 1.0 * speed * 12.0 / 2.0**3 * lasts
    assert found.displacement == pytest.approx(min(meetings, 1.0) * speed * 0.5 * lasts, rel=1e-12)
    assert found.acceleration == pytest.approx(speed * math.sqrt(50.0 * 12.0 / 24.0), rel=1e-12)


@pytest.mark.parametrize("duration", [0.01, 0.04, 0.2])  # by distances, acceleration, energy, where taut
@pytest.mark.parametrize(
    ("place", "change"), [(1.0, -300.0), (1.0, 100.0), (0.5, -300.0), (1.0, 0.0), (1.02, 90.0)]
)
def test_warmth(place: float, change: float, duration: float) -> None:
    """A net just taut and then colder pulls itself together; else the open net has other distances."""
    first = skewed()
    net = replace(first.net, reference_position=first.net.reference_position - [1.3, 0.0, 0.0])
    basis = EstimateBasis(net, duration, place * net.reference_position, first.velocity)
    keys = thermal_strain.ThermalStrain(temperature_change=change, expansion_coefficient=1e-5)
    stretch = 1.0 + 1e-5 * change
    free = 0.5 * (stretch**2 - 1.0)
    strain = 0.5 * (place**2 - 1.0)
    taut, before = max(strain - free, 0.0), max(strain, 0.0)
    pull = 1e3 * (taut - before) * place  # EA (E11 - e) lambda, less that without the free strain
    force = np.zeros((3, 3))
    force[:, 0] = [pull, 0.0, -pull]
    wanted = rms(basis, force / basis.net.mass[:, None])
    found = keys.magnitude(basis)
    assert found.acceleration == pytest.approx(wanted, rel=1e-9)
    speed = math.sqrt(max(1e3 * (taut**2 - before**2), 0.0))  # of EA e^2 L / 2 of 2.5 m, on 2.5 kg
    flight = min(0.5 * wanted * duration**2, speed * duration)
    static = 1e-5 * abs(change) * rms(basis, basis.net.reference_position)
    assert found.displacement == pytest.approx(max(static, flight), rel=1e-9)


# Contact


def contact_keys(**given: Any) -> contact.Contact:
    keys: contact.Contact = TypeAdapter(contact.AnyContact).validate_python(
        {"law": "linear", "damping": 0.0} | given
    )
    return keys


def test_a_net_that_a_body_stops() -> None:
    """Over the scene at the nominal speed."""
    basis = opening(0.4)
    speed, lasts = rms(basis, basis.motion), 0.4
    for keys, stiffness in (
        (contact_keys(threads=["box", "ball"], stiffness=70.0), 70.0 * 12.0),
        (contact_keys(threads=["box"], law="hertz", modulus=70.0), 0.25 * math.pi * 70.0 * 12.0),
        (contact_keys(nodes=["box"], node_radius=0.02, node_stiffness=90.0), 90.0),
        (contact_keys(bullets=["box"], bullet_radius=0.03, bullet_stiffness=80.0), 80.0),
    ):
        found = keys.magnitude(basis)
        assert_magnitude(found, speed * math.sqrt(stiffness / 24.0), speed * lasts)
    for what in ("nodes", "bullets"):  # m v^2 / 2 = 2/5 k p^(5/2), k = 4/3 E* sqrt(R)
        radius: dict[str, Any] = {f"{what[:-1]}_radius": 0.03}
        hertz = contact_keys(**{what: ["box"]}, **radius, law="hertz", modulus=7e5)
        k = 4.0 / 3.0 * 7e5 * math.sqrt(0.03)
        depth = (hertz.magnitude(basis).acceleration * 24.0 / k) ** (2.0 / 3.0)
        assert 0.4 * k * depth**2.5 == pytest.approx(0.5 * 24.0 * speed**2, rel=1e-12)


def test_the_largest_radius_of_what_touches() -> None:
    net = opening(0.4).net
    own = math.sqrt(1e-3 / math.pi)
    threads = {"threads": ["box"], "stiffness": 70.0}
    assert contact_keys(**threads).largest_radius(net) == pytest.approx(own, rel=1e-15)
    bullets = {"bullets": ["box"], "bullet_radius": 0.03, "bullet_stiffness": 80.0}
    assert contact_keys(**threads, **bullets).largest_radius(net) == 0.03
    nodes = {"nodes": ["box"], "node_radius": 0.02, "node_stiffness": 80.0}
    assert contact_keys(**nodes).largest_radius(net) == 0.02
