"""The effects of reference_impl against closed forms, the inertial frame, and the balance of energy."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from reference_impl import Refused, acceleration, damping, energy, read_document, tangent
from reference_impl.effects import EARTH_MU, EARTH_RADIUS
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


def test_ellipse_of_two_to_one(lone, scene):
    """field.md: closed 2 x 1 ellipse for y'(0) = -2 n x(0)."""
    made = scene(lone([1.0, 0.0, 0.0], [0.0, -2.0 * N, 0.0]), orbit("linear"))
    run = made.integrate(np.linspace(0.0, PERIOD, 9), rtol=1e-12, atol=1e-14)
    x, y, _ = run.x[:, 0].T
    assert np.allclose(x**2 + (y / 2.0) ** 2, 1.0, rtol=0, atol=1e-9)
    assert np.allclose(run.x[-1], run.x[0], rtol=0, atol=1e-9)


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


def test_two_bodies_conserve_what_kepler_conserves(lone, scene):
    made = scene(lone([300.0, -200.0, 500.0], [0.2, -0.4, 0.1]), orbit("two_body", TURNED))
    run = made.integrate(np.linspace(0.0, PERIOD, 5), rtol=1e-13, atol=1e-13)
    x, v = inertial(made, run)
    kepler = 0.5 * np.sum(v * v, axis=-1) - EARTH_MU / np.linalg.norm(x, axis=-1)
    momentum = np.cross(x, v)
    assert np.abs(run.x).max() > 1e3
    assert np.abs(kepler / kepler[0] - 1.0).max() < 1e-13
    assert np.abs(momentum - momentum[0]).max() < 1e-13 * np.abs(momentum).max()


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


@pytest.mark.parametrize("axes", [AXES, TURNED])
def test_linear_orbit_is_the_limit_of_two_bodies(document, scene, axes):
    """Their difference is of second order in x/R: 3/2 n^2 |x|^2/R at most 3 times."""
    linear, full = (
        scene(document(), {**orbit(m, axes), "initial.packing": 1.0}) for m in ("linear", "two_body")
    )
    x = linear.x0 + np.random.default_rng(3).standard_normal(linear.x0.shape)
    v = linear.v0
    made = full.system.effects.orbit
    bound = 4.5 * N**2 * np.max(np.sum(x * x, axis=1)) / made.radius
    net = (acceleration(s.system, 0.0, x, v) for s in (linear, full))
    rest = acceleration(scene(document(), {"initial.packing": 1.0}).system, 0.0, x, v)
    a, b = (f - rest for f in net)
    assert np.abs(a).max() > 1e3 * bound
    assert np.abs(a - b).max() < bound + 1e-13 * np.abs(rest).max()


def test_two_body_acceleration_is_the_textbooks(lone, scene):
    """docs/theory.md: -mu rho/|rho|^3 + n^2 P rho - 2 n h x v, which loses 7 digits to cancellation."""
    rng = np.random.default_rng(5)
    for axes in (AXES, TURNED):
        x, v = 1e5 * rng.standard_normal(3), rng.standard_normal(3)
        made = scene(lone(x.tolist(), v.tolist()), orbit("two_body", axes))
        o = made.system.effects.orbit
        r, t, h = np.array(o.radial), np.array(axes["along_track"]), np.array(o.normal)
        rho = o.radius * r + x
        expected = -EARTH_MU * rho / np.linalg.norm(rho) ** 3
        expected += N**2 * ((rho @ r) * r + (rho @ t) * t) - 2.0 * N * np.cross(h, v)
        got = acceleration(made.system, 0.0, made.x0, made.v0)[0]
        assert np.allclose(got, expected, rtol=0, atol=1e-13)  # of terms of 8 m/s2


@pytest.mark.parametrize("reach", [1e-3, 1.0, 1e3, 1e5, 3e6])
def test_two_body_potential_is_the_closed_form(lone, scene, reach):
    """n^2 [(x.h)^2/2 - R^2 q^2 (u + 2)/(2 u (1 + u)^2)], q = (|rho|/R)^2 - 1, u = sqrt(1 + q)."""
    made = scene(lone([0.0, 0.0, 0.0], [0.0, 0.0, 0.0]), orbit("two_body", TURNED))
    o = made.system.effects.orbit
    x = reach * np.random.default_rng(7).uniform(-1.0, 1.0, (200, 1, 3))
    q = (2.0 * (x[:, 0] @ o.radial) + np.sum(x[:, 0] ** 2, axis=1) / o.radius) / o.radius
    u = np.sqrt(1.0 + q)
    inward = o.radius**2 * q * q * (u + 2.0) / (2.0 * u * (1.0 + u) ** 2)
    expected = N**2 * (0.5 * (x[:, 0] @ o.normal) ** 2 - inward)
    got = energy.potential(made.system, x) / made.net.mass[0]
    assert got == pytest.approx(expected, rel=0, abs=1e-14 * np.abs(expected).max())


@pytest.mark.parametrize("model", ["linear", "two_body"])
@pytest.mark.parametrize("axes", [AXES, TURNED])
def test_orbital_force_is_the_slope_of_its_potential(lone, scene, model, axes):
    made = scene(lone([20.0, -30.0, 40.0], [0.0, 0.0, 0.0]), orbit(model, axes))
    force = acceleration(made.system, 0.0, made.x0, made.v0)[0]
    h = 0.1
    slope = [
        float(energy.potential(made.system, made.x0 + h * e) - energy.potential(made.system, made.x0 - h * e))
        / (2.0 * h)
        for e in np.eye(3)
    ]
    assert np.allclose(force, np.negative(slope), rtol=0, atol=1e-9 * np.abs(force).max())
    assert energy.potential(made.system, np.zeros((1, 3))) == 0.0


@pytest.mark.ci
@pytest.mark.slow
def test_mass_damping_decays_the_momentum(document, scene):
    """P = P0 exp(-alpha t), whatever the net does."""
    made = scene(document(), {"effects.mass_damping.alpha": 0.7, "launch.axial_speed": 2.0})
    run = made.integrate([0.0, 0.5, 1.0])
    p = energy.momentum(made.system, run.v)
    assert p[:, 2] == pytest.approx(p[0, 2] * np.exp(-0.7 * run.t), rel=1e-9)


def test_mass_damping_is_the_first_part_of_rayleighs(document, scene):
    one = scene(document(), {"effects.mass_damping.alpha": 0.7})
    other = scene(document(), {"effects.rayleigh_damping": {"alpha": 0.7, "beta": 0.0}})
    v = np.random.default_rng(1).standard_normal(one.x0.shape)
    assert np.array_equal(motion(one.system, 0.0, one.x0, v)[0], motion(other.system, 0.0, one.x0, v)[0])
    assert abs(damping(one.system) - damping(other.system)).max() == 0.0


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
SUBSET = {
    "effects.rayleigh_damping": {"alpha": 0.2, "beta": 1e-6},
    "effects.gravity": {"acceleration": [0.3, -0.2, -9.81]},
    "effects.mass_damping": {"alpha": 0.3},
    "effects.material_damping": {"relaxation_time": 2e-5},
    "effects.orbit": {"mean_motion": 0.5, **TURNED, "model": "linear"},
}
SUBSETS = [
    keys
    for size in range(6)
    for keys in itertools.combinations(SUBSET, size)
    if not {"effects.gravity", "effects.orbit"} <= set(keys)  # they contradict each other
]
QUICK = (SUBSETS[0], SUBSETS[9], *SUBSETS[-2:])


def balance(made, run):
    """Total energy, and the largest value of a term: the energy turned over."""
    terms = np.array(
        [
            energy.kinetic(made.system, run.v),
            energy.elastic(made.system, run.x),
            energy.potential(made.system, run.x),
            run.dissipated,
        ]
    )
    return terms.sum(axis=0), np.abs(terms).max()


@pytest.mark.ci_for("keys0")
@pytest.mark.slow
@pytest.mark.parametrize(
    ("keys", "model"),
    [
        pytest.param(keys, model, marks=[] if keys in QUICK and model == "linear" else pytest.mark.slow)
        for keys in SUBSETS
        for model in ("linear", "two_body")
        if model == "linear" or "effects.orbit" in keys
    ],
)
def test_energy_balances_with_any_effects(document, scene, keys, model):
    """A net that snaps out of its plane; 1e-5 of the energy turned over, issue 6."""
    overrides = {key: dict(SUBSET[key]) for key in keys}
    if "effects.orbit" in overrides:
        overrides["effects.orbit"]["model"] = model
    made = scene(
        document("square", size=2.0),
        {**overrides, "initial.packing": 0.6, "initial.spin": [0.3, 0.0, 1.0], "launch.axial_speed": 1.0},
    )
    run = made.integrate(np.linspace(0.0, 0.3, 7))
    total, turned = balance(made, run)
    assert np.ptp(np.linalg.norm(run.v[:, made.net.bullet_nodes], axis=2)) > 0.1  # the net has snapped
    assert np.abs(total - total[0]).max() < 1e-5 * turned
    assert np.all(np.diff(run.dissipated) >= 0.0)


@pytest.mark.parametrize(
    ("overrides", "named"),
    [
        ({"effects.orbit.altitude": 5e5}, "effects.orbit: give exactly one"),
        ({"effects.orbit.mean_motion": None}, "effects.orbit: give exactly one"),
        ({"effects.orbit.mean_motion": 0.0}, "effects.orbit.mean_motion: must be greater"),
        ({"effects.orbit.radial": [1.0, 1.0, 0.0]}, "effects.orbit.radial: must be of length 1"),
        ({"effects.orbit.along_track": [0.6, 0.8, 0.0]}, "effects.orbit.along_track: must be orthogonal"),
        ({"effects.orbit.along_track": None}, "effects.orbit.along_track: missing"),
        ({"effects.orbit.model": "j2"}, 'reference_impl does not know effects.orbit.model = "j2"'),
        ({"effects.orbit.inclination": 1.0}, "reference_impl does not know effects.orbit.inclination"),
        ({"effects.mass_damping": {}}, "effects.mass_damping.alpha: missing"),
        ({"effects.mass_damping.alpha": -1.0}, "effects.mass_damping.alpha: must be at least 0"),
        ({"effects.material_damping": {}}, "effects.material_damping.relaxation_time: missing"),
        (
            {"effects.material_damping.relaxation_time": -1.0},
            "effects.material_damping.relaxation_time: must",
        ),
    ],
)
def test_refuses_by_name(document, overrides, named):
    with pytest.raises(Refused) as refused:
        read_document(document(), {**orbit("linear"), **overrides})
    assert any(fault.startswith(named) for fault in refused.value.faults), refused.value.faults


def test_absent_effects_cost_nothing(document, scene):
    """The bare net computes no array for them: what is cached on first use stays unborn."""
    made = scene(document())
    acceleration(made.system, 0.0, made.x0, made.v0)
    assert not {"drag", "weight", "damping", "graph", "reference_direction", "leaves"} & set(
        vars(made.system)
    )


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
