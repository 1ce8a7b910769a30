"""Effects of reference_impl against closed forms and the balance of energy."""

from __future__ import annotations

import math

import numpy as np
import pytest

from reference_impl import acceleration, energy
from reference_impl.effects.drag import LAYERS
from reference_impl.effects.drag import atmospheric_density as density
from reference_impl.effects.orbit import EARTH_J2, EARTH_MU, EARTH_RADIUS, J2, Frame, axis, oblate_gradient
from reference_impl.forces import motion

TURNED = {"radial": [0.6, 0.0, 0.8], "along_track": [0.0, -1.0, 0.0]}


def test_material_damping_never_pushes_and_lets_turn(explicit, scene):
    """theory_effects.md: S11 = max(E (E11 + tau E11'), 0) where E11 > 0; a rigid rotation takes nothing."""
    case = explicit([[0.0, 0, 0], [1.0, 0, 0]], [[0, 1]], cable={**CABLE})
    made = scene(case, {"effects.material_damping.relaxation_time": 1e-2})
    x = np.array([[0.0, 0, 0], [1.01, 0, 0]])
    force = made.net.mass[1] * CABLE["youngs_modulus"] * CABLE["area"] / made.net.mass[1]
    e11 = (1.01**2 - 1.0) / 2.0
    for rate, expected in ((0.0, e11), (0.5, e11 + 1e-2 * 0.5 * 1.01), (-10.0, 0.0)):
        v = np.array([[0.0, 0, 0], [rate, 0.3, 0]])
        a, power = motion(made.system, 0.0, x, v)
        assert a[1, 0] * made.net.mass[1] == pytest.approx(-force * expected * 1.01, rel=1e-12)
        stress = expected - e11
        assert power == pytest.approx(force * stress * rate * 1.01, rel=1e-12)
        assert power >= 0.0
    slack = motion(made.system, 0.0, 0.9 * x, np.array([[0.0, 0, 0], [5.0, 0, 0]]))
    assert not slack[0].any()
    assert slack[1] == 0.0


CABLE = {"area": 1e-6, "density": 1390.0, "youngs_modulus": 1e9}


IN_ORBIT = {
    "mass_damping": {"alpha": 0.3},
    "material_damping": {"relaxation_time": 2e-5},
    "orbit": {"mean_motion": 0.1, **TURNED, "model": "two_body"},
    "j2": {"mean_motion": 0.1, **TURNED, "inclination": 1.0, "argument_of_latitude": 0.5},
    "molecular_drag": {
        "density": 1e-4,
        "flow": [-70.0, 10.0, 0.0],
        "drag_coefficient": 2.2,
        "bullet_area": 0.01,
    },
    "solar_pressure": {
        "flux": 1e7,
        "direction": [0.0, 1.0, 0.0],
        "pressure_coefficient": 1.3,
        "bullet_area": 0.01,
    },
    "breaking": {"strain": 5e-3},
    "thermal_strain": {"temperature_change": -100.0, "expansion_coefficient": 5e-6},
    "launch_force": {
        "kind": "gas",
        "force": 200.0,
        "stroke": 0.05,
        "spread_angle": 0.7,
        "body": "chaser",
        "dead_length": 0.02,
        "exponent": 1.4,
    },
    "thrust": {"bullets": [0, 2], "time": [0.005, 0.015, 0.03], "force": [[5.0, 0.0, 2.0]] * 3},
}
ON_THE_GROUND = {
    "rayleigh_damping": {"alpha": 0.1, "beta": 1e-7},
    "gravity": {"acceleration": [0.0, 0.0, -9.81]},
    "air_drag": {
        "density": 1.2,
        "drag_coefficient": 1.1,
        "bullet_drag_coefficient": 0.5,
        "bullet_area": 0.01,
    },
    "bending": {"modulus": 1e10},
    "thermal_strain": IN_ORBIT["thermal_strain"],
    "launch_force": {
        "kind": "spring",
        "force": 200.0,
        "stroke": 0.05,
        "spread_angle": 0.7,
        "body": "chaser",
    },
    "thrust": IN_ORBIT["thrust"],
}
BODIES = {
    "chaser": {"mass": 5.0, "inertia": [1.0, 1.0, 1.0]},
    "box": {"mass": 2.0, "inertia": [1.0, 2.0, 2.5], "angular_velocity": [0.5, 3.0, 0.2]},
}


@pytest.mark.slow
@pytest.mark.parametrize("effects", [IN_ORBIT, ON_THE_GROUND], ids=["in orbit", "on the ground"])
@pytest.mark.parametrize(
    ("options", "bound"),
    [({}, 1e-8), ({"method": "RK45", "rtol": 1e-8, "atol": 1e-10}, 1e-4)],
    ids=["DOP853", "RK45"],
)
def test_books_close_with_everything_at_once(document, scene, unbalanced, effects, options, bound):
    """All effects that go together, with a chaser and a body beside a net that snaps and breaks."""
    case = document("square", size=2.0)
    del case["launch"]
    soft = {"net.cable.youngs_modulus": 1e9, "net.strings.youngs_modulus": 1e9}
    made = scene({**case, "effects": effects, "bodies": BODIES}, {"initial.packing": 0.99, **soft})
    run = made.integrate([0.0, 0.015, 0.03, 0.04], **options)
    assert bool(run.breaks) == ("breaking" in effects)
    assert np.ptp(np.linalg.norm(run.v[1:, made.net.bullet_nodes], axis=2)) > 0.1
    assert unbalanced(made, run) < bound


RADIUS = EARTH_RADIUS + 700e3
MEAN_MOTION = math.sqrt(EARTH_MU / RADIUS**3)
OBLATE = EARTH_MU * EARTH_J2 * EARTH_RADIUS**2 / RADIUS**5  # [1/s2]
FRAME = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0))
OTHER_FRAME = ((0.6, 0.0, 0.8), (0.0, -1.0, 0.0))


def place(inclination, latitude, axes=FRAME):
    return J2(MEAN_MOTION, *axes, inclination, latitude)


@pytest.mark.parametrize("axes", [FRAME, OTHER_FRAME])
@pytest.mark.parametrize(("inclination", "latitude"), [(1.714, 0.8), (0.4, 4.0), (2.9, -1.0)])
def test_gradient_is_the_second_derivative_of_the_force_function(axes, inclination, latitude):
    """mu J2 Re^2 (1 - 3 (k.rho)^2/|rho|^2)/(2 |rho|^3), theory_effects.md, by differences over 2 km."""
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
    assert oblate_gradient(here) == pytest.approx(np.array(second, dtype=float), abs=1e-5 * OBLATE)
    assert np.trace(oblate_gradient(here)) == pytest.approx(0.0, abs=1e-14 * OBLATE)


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


def test_exponential_atmosphere():
    """Vallado, table 8-4: values at the bases, one between by hand; layers meet within the table's digits."""
    assert density(400e3) == 3.725e-12
    assert density(425e3) == pytest.approx(2.429827e-12, rel=1e-6)  # 3.725e-12 exp(-25/58.515)
    assert density(150e3) == 2.070e-9
    assert density(2000e3) == pytest.approx(3.019e-15 * math.exp(-1000.0 / 268.0))
    for base, at_base, _ in LAYERS[1:]:
        assert density(1e3 * base - 1e-6) == pytest.approx(at_base, rel=3e-4)


TIME = [0.013, 0.05, 0.09]
FORCE = [[1.0, 0.0, 5.0], [0.0, -3.0, 2.0], [0.5, 2.0, 1.0]]  # jumps at the first and the last knot
THRUST = {"bullets": [1, 2], "time": TIME, "force": FORCE}


@pytest.mark.parametrize("method", ["DOP853", "RK45"])
def test_knots_next_to_stored_times(loose, scene, method):
    """A knot one rounding away from a stored time, as 0.3 is from 3 x 0.1: no step is left between them."""
    made = scene(loose(thrust={**THRUST, "time": [0.1, 0.2, 0.3]}))
    times = [0.0, 0.1, 0.2, 3 * 0.1, 0.4]
    assert times[3] > 0.3
    run = made.integrate(times, method=method)
    assert run.t.tolist() == times
