"""Effects of reference_impl against closed forms, the inertial frame and the balance of energy."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from reference_impl import acceleration, damping, energy, tangent
from reference_impl.effects.drag import LAYERS
from reference_impl.effects.drag import atmospheric_density as density
from reference_impl.effects.orbit import EARTH_J2, EARTH_MU, EARTH_RADIUS, J2, Frame, axis, oblate_gradient
from reference_impl.forces import motion

N = 1.1e-3  # mean motion of a low orbit [rad/s]
PERIOD = 2.0 * math.pi / N
AXES = {"radial": [1.0, 0.0, 0.0], "along_track": [0.0, 1.0, 0.0]}
TURNED = {"radial": [0.6, 0.0, 0.8], "along_track": [0.0, -1.0, 0.0]}


def orbit(model, axes=None, **size):
    return {"effects.orbit": {**(size or {"mean_motion": N}), **(axes or AXES), "model": model}}


@pytest.fixture(scope="module")
def lone(explicit):
    """lone(position, velocity): a single mass of 1 kg."""

    def make(position, velocity):
        start = {"node_positions": [position], "node_velocities": [velocity]}
        return explicit([[0.0, 0.0, 0.0]], [], start, node_masses=[1.0])

    return make


@pytest.mark.parametrize("axes", [AXES, TURNED])
def test_linear_orbit_is_the_state_transition_of_clohessy_and_wiltshire(lone, scene, axes):
    """The closed form of any textbook (Curtis, Orbital Mechanics for Engineering Students, ch. 7)."""
    r = np.array(axes["radial"])
    t = np.array(axes["along_track"])
    turn = np.array([r, t, np.cross(r, t)])  # from the scene's axes to Hill's
    x0, v0 = np.array([3.0, -2.0, 5.0]), np.array([2e-3, -4e-3, 1e-3])
    made = scene(lone((x0 @ turn).tolist(), (v0 @ turn).tolist()), orbit("linear", axes))
    times = np.linspace(0.0, PERIOD, 5)
    run = made.integrate(times, rtol=1e-12, atol=1e-14)
    for time, position, velocity in zip(times, run.x[:, 0], run.v[:, 0], strict=True):
        c, s, w = math.cos(N * time), math.sin(N * time), N * time
        rr = np.array([[4 - 3 * c, 0, 0], [6 * (s - w), 1, 0], [0, 0, c]])
        rv = np.array([[s, 2 * (1 - c), 0], [-2 * (1 - c), 4 * s - 3 * w, 0], [0, 0, s]]) / N
        vr = N * np.array([[3 * s, 0, 0], [-6 * (1 - c), 0, 0], [0, 0, -s]])
        vv = np.array([[c, 2 * s, 0], [-2 * s, 4 * c - 3, 0], [0, 0, c]])
        assert np.allclose(turn @ position, rr @ x0 + rv @ v0, rtol=0, atol=1e-9 * 46)  # it drifts 46 m
        assert np.allclose(turn @ velocity, vr @ x0 + vv @ v0, rtol=0, atol=1e-9 * N * 46)
    assert np.abs(run.x).max() > 46.0


def inertial(made, run):
    """Positions, velocities (nt, n, 3) in axes that do not turn, with Earth's centre as the origin."""
    o = made.system.effects.orbit
    r, h = np.array(o.radial), np.array(o.normal)
    rho = o.radius * r + run.x
    speed = run.v + o.mean_motion * np.cross(h, rho)
    positions, speeds = np.empty_like(rho), np.empty_like(rho)
    for k, time in enumerate(run.t):
        skew = np.cross(h, np.eye(3)).T  # skew @ a = h x a
        turned = expm(o.mean_motion * time * skew)
        positions[k], speeds[k] = rho[k] @ turned.T, speed[k] @ turned.T
    return positions, speeds


def test_two_bodies_follow_keplers_motion(lone, scene):
    """Integrated in the inertial frame by SciPy: the same place after one orbit, of 1e4 m of drift."""
    made = scene(lone([300.0, -200.0, 500.0], [0.2, -0.4, 0.1]), orbit("two_body", altitude=5e5))
    n = made.system.effects.orbit.mean_motion
    assert n == pytest.approx(math.sqrt(EARTH_MU / (EARTH_RADIUS + 5e5) ** 3), rel=1e-15)
    run = made.integrate([0.0, 2.0 * math.pi / n], rtol=1e-13, atol=1e-13)
    x, v = inertial(made, run)

    def rate(t, y):
        return np.concatenate((y[3:], -EARTH_MU * y[:3] / np.linalg.norm(y[:3]) ** 3))

    y0 = np.concatenate((x[0, 0], v[0, 0]))
    end = solve_ivp(rate, (0.0, run.t[-1]), y0, method="DOP853", rtol=3e-14, atol=1e-9).y[:, -1]
    assert np.abs(end[:3] - x[-1, 0]).max() < 1e-5
    assert np.abs(end[3:] - v[-1, 0]).max() < 1e-8


def oscillator(explicit, **effects):
    """A mass on a taut cable that it stretches by 1 %, in small axial motion."""
    case = explicit(
        [[0.0, 0, 0], [1.0, 0, 0], [2.0, 0, 0]],
        [[0, 1], [1, 2]],
        {
            "node_positions": [[-0.01, 0, 0], [1.0 + 1e-6, 0, 0], [2.01, 0, 0]],
        },
        fixed=[0, 2],
        node_masses=[0.0, 2.0, 0.0],
        cable={"area": 1e-4, "density": 1.0, "youngs_modulus": 1e6},
    )
    return {**case, "effects": effects}


def test_material_damping_decays_a_taut_oscillation(explicit, scene):
    """m x'' + c x' + k x = 0 with c = tau dS11/dE11 A/L^3 d^2, twice: decay exp(-c t/(2 m))."""
    tau, stretch = 2e-3, 1.01
    made = scene(oscillator(explicit, material_damping={"relaxation_time": tau}))
    c = 2.0 * tau * (1e6 * 1e-4 / 1.0) * stretch**2
    k = 2.0 * (1e6 * 1e-4 / 1.0) * (3.0 * stretch**2 - 1.0) / 2.0
    mass = made.net.mass[1]
    decay = c / (2.0 * mass)
    omega = math.sqrt(k / mass - decay**2)
    t = np.linspace(0.0, 6.0 * math.pi / omega, 7)
    run = made.integrate(t, rtol=1e-12, atol=1e-16)
    expected = 1e-6 * np.exp(-decay * t) * (np.cos(omega * t) + decay / omega * np.sin(omega * t))
    assert np.exp(-decay * t[-1]) < 0.9
    assert run.x[:, 1, 0] - 1.0 == pytest.approx(expected, abs=1e-10)  # 1e-6 of 1e-6 of nonlinearity
    assert damping(made.system, made.x0).toarray()[3, 3] == pytest.approx(c, rel=1e-5)
    assert tangent(made.system, made.x0).toarray()[3, 3] == pytest.approx(k, rel=1e-5)


def test_material_damping_never_pushes_and_lets_turn(explicit, scene):
    """docs/theory.md: S11 = max(E (E11 + tau E11'), 0) where E11 > 0; a rigid rotation takes nothing."""
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
        "chaser_mass": 5.0,
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
        "chaser_mass": 5.0,
    },
    "thrust": IN_ORBIT["thrust"],
}
BOX = {"mass": 2.0, "inertia": [1.0, 2.0, 2.5], "angular_velocity": [0.5, 3.0, 0.2]}


@pytest.mark.slow
@pytest.mark.parametrize("effects", [IN_ORBIT, ON_THE_GROUND], ids=["in orbit", "on the ground"])
@pytest.mark.parametrize(
    ("options", "bound"),
    [({}, 1e-8), ({"method": "RK45", "rtol": 1e-8, "atol": 1e-10}, 1e-4)],
    ids=["DOP853", "RK45"],
)
def test_books_close_with_everything_at_once(document, scene, unbalanced, effects, options, bound):
    """All effects that go together, with a chaser and a rigid body beside a net that snaps and breaks."""
    case = document("square", size=2.0)
    del case["launch"]
    soft = {"net.cable.youngs_modulus": 1e9, "net.strings.youngs_modulus": 1e9}
    made = scene({**case, "effects": effects, "bodies": {"box": BOX}}, {"initial.packing": 0.99, **soft})
    run = made.integrate([0.0, 0.015, 0.03, 0.04], **options)
    assert bool(run.breaks) == ("breaking" in effects)
    assert made.system.bodies.names == ("chaser", "box")
    assert np.ptp(np.linalg.norm(run.v[1:, made.net.bullet_nodes], axis=2)) > 0.1
    assert unbalanced(made, run) < bound


RADIUS = EARTH_RADIUS + 700e3
MEAN_MOTION = math.sqrt(EARTH_MU / RADIUS**3)
OBLATE = EARTH_MU * EARTH_J2 * EARTH_RADIUS**2 / RADIUS**5  # [1/s2]
FRAME = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0))
OTHER_FRAME = ((0.6, 0.0, 0.8), (0.0, -1.0, 0.0))


def place(inclination, latitude, axes=FRAME):
    return J2(MEAN_MOTION, *axes, inclination, latitude)


def test_gradient_by_hand_over_pole_and_equator():
    """On the axis U = -mu J2 Re^2/z^3, over the equator +mu J2 Re^2/(2 r^3): U'' = -12, 6 mu J2 Re^2/R^5."""
    pole = oblate_gradient(place(math.pi / 2.0, math.pi / 2.0))
    assert pole == pytest.approx(OBLATE * np.diag([-12.0, 6.0, 6.0]), abs=1e-12 * OBLATE)
    equator = oblate_gradient(place(0.0, 0.3))
    assert equator == pytest.approx(OBLATE * np.diag([6.0, -1.5, -4.5]), abs=1e-12 * OBLATE)


@pytest.mark.parametrize("axes", [FRAME, OTHER_FRAME])
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
    assert oblate_gradient(here) == pytest.approx(np.array(second, dtype=float), abs=1e-5 * OBLATE)
    assert np.trace(oblate_gradient(here)) == pytest.approx(0.0, abs=1e-14 * OBLATE)


@pytest.mark.parametrize("inclination", [0.2, 1.0, 1.7])
def test_mean_over_an_orbit(inclination):
    """Schweighart & Sedwick, J. Guid. Control Dyn. 25 (2002), doi:10.2514/2.4986: mu/R^3 diag(4 s, -s, -3 s)
    with s = 3 J2 Re^2/(8 R^2) (1 + 3 cos 2i), the secular part of relative motion."""
    places = [place(inclination, 2.0 * math.pi * k / 8) for k in range(8)]  # exact for its harmonics
    mean = np.mean([oblate_gradient(p) for p in places], axis=0)
    s = 3.0 * EARTH_J2 * EARTH_RADIUS**2 / (8.0 * RADIUS**2) * (1.0 + 3.0 * math.cos(2.0 * inclination))
    assert mean == pytest.approx(MEAN_MOTION**2 * np.diag([4.0 * s, -s, -3.0 * s]), abs=1e-12 * OBLATE)


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


THREAD = {"area": math.pi / 4.0 * 0.01**2, "density": 1000.0, "youngs_modulus": 1e9}  # 1 cm thick
AIR = {"density": 1.2, "drag_coefficient": 1.1}
BALLS = {"bullet_drag_coefficient": 0.5, "bullet_area": 0.02}


def falling(document, speed, **effects):
    """A square net without strings that moves along z as a whole; its cables have no drag."""
    case = document("square", size=1.0, cable={**THREAD, "density": 1e-3})
    del case["launch"], case["net"]["strings"]
    case["initial"] = {"packing": 1.0, "velocity": [0.0, 0.0, speed]}
    return {**case, "effects": effects}


def test_ball_in_air_slows_down_hyperbolically(document, scene):
    """v = v0/(1 + k v0 t), k = rho C A/(2 m): any textbook of mechanics, e.g. Taylor, ch. 2."""
    made = scene(falling(document, 8.0, air_drag={**AIR, "drag_coefficient": 0.0, **BALLS}))
    mass = 0.5 + 1e-3 * THREAD["area"]
    k = 1.2 * 0.5 * 0.02 / (2.0 * mass)
    run = made.integrate([0.0, 2.0, 5.0])
    expected = 8.0 / (1.0 + k * 8.0 * run.t)
    assert expected[-1] < 6.0
    assert run.v[:, :, 2] == pytest.approx(np.tile(expected, (4, 1)).T, rel=1e-10)
    lost = 4 * 0.5 * mass * (64.0 - expected**2)
    assert run.dissipated == pytest.approx(lost, rel=1e-10)


def test_cross_flow_counts_the_normal_velocity_only(explicit, scene):
    """A rod along (3, 4, 0)/5 moved along x: normal part (0.64, -0.48, 0) v, of size 0.8 v; half an end."""
    case = explicit([[0.0, 0, 0], [3.0, 4.0, 0]], [[0, 1]], cable=THREAD)
    made = scene(case, {"effects.air_drag": AIR})
    size = 0.5 * 1.2 * 1.1 * 0.01 * 5.0  # rho C d L/2
    for speed, expected in (
        ([2.0, 0.0, 0.0], -size * 1.6 * np.array([1.28, -0.96, 0.0])),
        ([-2.0, 0.0, 0.0], size * 1.6 * np.array([1.28, -0.96, 0.0])),
        ([3.0, 4.0, 0.0], np.zeros(3)),  # along itself
        ([0.0, 0.0, 7.0], -size * 49.0 * np.array([0.0, 0.0, 1.0])),
    ):
        v = np.tile(speed, (2, 1))
        a, power = motion(made.system, 0.0, made.x0, v)
        force = made.net.mass[:, None] * a
        assert force == pytest.approx(np.tile(0.5 * expected, (2, 1)), abs=1e-14)
        assert power == pytest.approx(-float(expected @ speed), abs=1e-14)


GAS = {"density": 2e-9, "flow": [-7000.0, 0.0, 100.0], "drag_coefficient": 2.2}


def chain(explicit, **effects):
    """Elements of 1 and 2 m, 1 cm thick: nodes with half of pi/4 d L of each."""
    case = explicit([[0.0, 0, 0], [1.0, 0, 0], [3.0, 0, 0]], [[0, 1], [1, 2]], cable=THREAD)
    return {**case, "effects": effects}


AREAS = 0.5 * math.pi / 4.0 * 0.01 * np.array([1.0, 3.0, 2.0])  # [m2]


def test_molecular_drag_by_hand(explicit, scene):
    made = scene(chain(explicit, molecular_drag=GAS))
    v = np.array([[100.0, 0.0, 0.0], [0.0, 50.0, 0.0], [0.0, 0.0, 0.0]])
    u = np.array([[-7100.0, 0.0, 100.0], [-7000.0, -50.0, 100.0], [-7000.0, 0.0, 100.0]])
    expected = 0.5 * 2e-9 * 2.2 * AREAS[:, None] * np.linalg.norm(u, axis=1)[:, None] * u
    a, power = motion(made.system, 0.0, made.x0, v)
    assert made.net.mass[:, None] * a == pytest.approx(expected, rel=1e-13, abs=1e-20)
    assert power == pytest.approx(-float(np.sum(expected * v)), rel=1e-12)


def test_sunlight_by_hand(explicit, scene):
    """Force C W/c A along the light, whatever moves: 1361/299792458 Pa."""
    light = {"flux": 1361.0, "direction": [0.6, 0.0, -0.8], "pressure_coefficient": 1.3}
    made = scene(chain(explicit, solar_pressure=light))
    expected = 1.3 * 4.539807e-6 * AREAS[:, None] * np.array([0.6, 0.0, -0.8])
    for v in (np.zeros((3, 3)), np.ones((3, 3))):
        force = made.net.mass[:, None] * acceleration(made.system, 0.0, made.x0, v)
        assert force == pytest.approx(expected, rel=1e-6)


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


def integral(t, order):
    """Velocity (order 1) and way (order 2) per mass of the force at time t, by hand: polynomials a knot."""
    total, slope_sum = np.zeros(3), np.zeros(3)  # way and velocity so far
    now = 0.0
    for (a, b), (f, g) in zip(pairwise(TIME), pairwise(FORCE), strict=True):
        f, g = np.array(f), np.array(g)
        if t <= a:
            break
        total, now = total + slope_sum * (a - now), a
        h = min(t, b) - a
        rate = (g - f) / (b - a)
        total = total + slope_sum * h + f * h**2 / 2.0 + rate * h**3 / 6.0
        slope_sum = slope_sum + f * h + rate * h**2 / 2.0
        now = a + h
    total = total + slope_sum * (t - now)
    return (slope_sum, total)[order - 1]


@pytest.mark.parametrize(
    ("options", "bound"),
    [
        ({}, 1e-13),
        ({"method": "RK45"}, 1e-13),
    ],
    ids=["DOP853", "RK45"],
)
def test_free_bullets_follow_the_integrals(loose, scene, options, bound):
    """Slack net: x = int int F/m, on bullets 1 and 2 only; steps end at the knots, where the force jumps."""
    made = scene(loose(thrust=THRUST))
    times = np.array([0.0, 0.01, 0.013, 0.03, 0.05, 0.07, 0.09, 0.12])
    run = made.integrate(times, **options)
    pushed, others = made.net.bullet_nodes[[1, 2]], made.net.bullet_nodes[[0, 3]]
    m = made.net.mass[pushed[0]]
    for k, t in enumerate(times.tolist()):
        for node in pushed:
            assert run.v[k, node] == pytest.approx(integral(t, 1) / m, abs=max(bound, 1e-14))
            assert run.x[k, node] - run.x[0, node] == pytest.approx(integral(t, 2) / m, abs=bound)
    assert not run.v[:, others].any()
    assert not energy.elastic(made.system, run.x).any()


@pytest.mark.parametrize("method", ["DOP853", "RK45"])
def test_knots_next_to_stored_times(loose, scene, method):
    """A knot one rounding away from a stored time, as 0.3 is from 3 x 0.1: no step is left between them."""
    made = scene(loose(thrust={**THRUST, "time": [0.1, 0.2, 0.3]}))
    times = [0.0, 0.1, 0.2, 3 * 0.1, 0.4]
    assert times[3] > 0.3
    run = made.integrate(times, method=method)
    assert run.t.tolist() == times
