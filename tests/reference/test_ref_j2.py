"""The J2 gravity gradient of reference_impl: against its force function, poles by hand, a known mean."""

from __future__ import annotations

import math

import numpy as np
import pytest
from reference_impl.effects.earth import EARTH_J2, EARTH_MU, EARTH_RADIUS
from reference_impl.effects.frame import Frame
from reference_impl.effects.j2 import J2, axis, oblate_gradient

from reference_impl import acceleration, energy, read_document

RADIUS = EARTH_RADIUS + 700e3
N = math.sqrt(EARTH_MU / RADIUS**3)
SIZE = EARTH_MU * EARTH_J2 * EARTH_RADIUS**2 / RADIUS**5  # [1/s2]
AXES = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0))
TURNED = ((0.6, 0.0, 0.8), (0.0, -1.0, 0.0))


def place(inclination, latitude, axes=AXES):
    return J2(N, *axes, inclination, latitude)


def test_gradient_by_hand_over_pole_and_equator():
    """On the axis U = -mu J2 Re^2/z^3, over the equator +mu J2 Re^2/(2 r^3): U'' = -12, 6 mu J2 Re^2/R^5."""
    pole = oblate_gradient(place(math.pi / 2.0, math.pi / 2.0))
    assert pole == pytest.approx(SIZE * np.diag([-12.0, 6.0, 6.0]), abs=1e-12 * SIZE)
    equator = oblate_gradient(place(0.0, 0.3))
    assert equator == pytest.approx(SIZE * np.diag([6.0, -1.5, -4.5]), abs=1e-12 * SIZE)


@pytest.mark.parametrize("axes", [AXES, TURNED])
@pytest.mark.parametrize(("inclination", "latitude"), [(1.714, 0.8), (0.4, 4.0), (2.9, -1.0)])
def test_gradient_is_the_second_derivative_of_the_force_function(axes, inclination, latitude):
    """docs/theory.md: mu J2 Re^2 (1 - 3 (k.rho)^2/|rho|^2)/(2 |rho|^3), by central differences over 2 km."""
    here = place(inclination, latitude, axes)
    k = axis(here).astype(np.longdouble)

    def force_function(x):
        rho = RADIUS * np.array(here.radial, dtype=np.longdouble) + x
        size = np.sqrt(rho @ rho)
        return EARTH_MU * EARTH_J2 * EARTH_RADIUS**2 * (1 - 3 * (k @ rho) ** 2 / size**2) / (2 * size**3)

    step = 2e3 * np.eye(3, dtype=np.longdouble)
    second = [
        [
            (force_function(a + b) - force_function(a - b) - force_function(b - a) + force_function(-a - b))
            / (4.0 * 2e3**2)
            for a in step
        ]
        for b in step
    ]
    assert oblate_gradient(here) == pytest.approx(np.array(second, dtype=float), abs=1e-5 * SIZE)
    assert np.trace(oblate_gradient(here)) == pytest.approx(0.0, abs=1e-14 * SIZE)


def test_axis_of_the_earth():
    """i = 90 degrees at the ascending node: north lies along the track; at u = 90 degrees it is overhead."""
    assert axis(place(math.pi / 2.0, 0.0)) == pytest.approx([0.0, 1.0, 0.0], abs=1e-15)
    assert axis(place(math.pi / 2.0, math.pi / 2.0)) == pytest.approx([1.0, 0.0, 0.0], abs=1e-15)
    assert axis(place(0.0, 1.0)) == pytest.approx([0.0, 0.0, 1.0], abs=1e-15)
    assert axis(place(math.pi, 1.0)) == pytest.approx([0.0, 0.0, -1.0], abs=1e-15)


@pytest.mark.parametrize("inclination", [0.2, 1.0, 1.7])
def test_mean_over_an_orbit(inclination):
    """Schweighart & Sedwick, J. Guid. Control Dyn. 25 (2002), doi:10.2514/2.4986: mu/R^3 diag(4 s, -s, -3 s)
    with s = 3 J2 Re^2/(8 R^2) (1 + 3 cos 2i), the secular part of relative motion."""
    places = [place(inclination, 2.0 * math.pi * k / 8) for k in range(8)]  # exact for its harmonics
    mean = np.mean([oblate_gradient(p) for p in places], axis=0)
    s = 3.0 * EARTH_J2 * EARTH_RADIUS**2 / (8.0 * RADIUS**2) * (1.0 + 3.0 * math.cos(2.0 * inclination))
    assert mean == pytest.approx(N**2 * np.diag([4.0 * s, -s, -3.0 * s]), abs=1e-12 * SIZE)


def test_scene_adds_the_gradient_to_the_orbit(scene):
    with_j2, without = scene("effects/j2.toml"), scene("effects/j2.toml", {"effects.j2": None})
    rng = np.random.default_rng(1)
    x, v = (rng.standard_normal(with_j2.x0.shape) for _ in range(2))
    x *= 0.01  # slack
    extra = acceleration(with_j2.system, 0.0, x, v) - acceleration(without.system, 0.0, x, v)
    gradient = oblate_gradient(with_j2.system.effects.j2)
    assert isinstance(with_j2.system.effects.j2, Frame)
    assert extra == pytest.approx(x @ gradient.T, abs=1e-6 * np.abs(gradient).max() * 0.01)
    rise = energy.potential(with_j2.system, x) - energy.potential(without.system, x)
    assert rise == pytest.approx(-0.5 * np.einsum("n,nc,cd,nd", with_j2.net.mass, x, gradient, x), rel=1e-6)


@pytest.mark.ci_for("options0")
@pytest.mark.slow
@pytest.mark.parametrize(
    ("model", "options"), [("linear", {}), ("two_body", {}), ("linear", {"method": "EM", "step": 0.05})]
)
def test_energy_balances_in_a_strong_field(document, scene, unbalanced, model, options):
    """An orbit of 0.1 rad/s would be inside the Earth: there J2 is worth seeing, and only numbers count."""
    frame = {"mean_motion": 0.1, "radial": [0.6, 0.0, 0.8], "along_track": [0.0, -1.0, 0.0]}
    made = scene(
        document("square", size=2.0),
        {
            "effects": {
                "orbit": {**frame, "model": model},
                "j2": {**frame, "inclination": 1.0, "argument_of_latitude": 0.5},
            },
            "initial.packing": 0.5,
            "launch": {"radial_speed": 0.5, "axial_speed": 0.3},
        },
    )
    run = made.integrate([0.0, 1.0, 2.0], **options)
    assert np.abs(energy.potential(made.system, run.x)).max() > 1e-3
    assert unbalanced(made, run) < 1e-8


def test_longest_scene_is_a_twentieth_of_an_orbit(document):
    frame = {"altitude": 700e3, "radial": [1.0, 0.0, 0.0], "along_track": [0.0, 1.0, 0.0]}
    effects = {
        "orbit": {**frame, "model": "linear"},
        "j2": {**frame, "inclination": 1.0, "argument_of_latitude": 0.5},
    }
    longest = 2.0 * math.pi / N / 20.0
    assert longest == pytest.approx(296.3, abs=0.1)
    case = {**document(), "effects": effects}
    read_document(case, {"time.end": 0.999 * longest})
    with pytest.raises(ValueError, match=r"effects\.j2: time\.end must be at most 1/20 orbit, 296"):
        read_document(case, {"time.end": 1.001 * longest})
