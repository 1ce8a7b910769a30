"""Air drag, molecular drag and sunlight of reference_impl against closed forms and areas taken by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest
from reference_impl.effects.atmosphere import LAYERS, density

from reference_impl import acceleration
from reference_impl.forces import motion

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


def test_terminal_velocity(document, scene):
    """v = vt tanh(g t/vt) with vt = sqrt(2 m g/(rho C A))."""
    drag = {**AIR, "drag_coefficient": 0.0, **BALLS}
    made = scene(falling(document, 0.0, air_drag=drag, gravity={"acceleration": [0.0, 0.0, -9.81]}))
    mass = 0.5 + 1e-3 * THREAD["area"]
    terminal = math.sqrt(2.0 * mass * 9.81 / (1.2 * 0.5 * 0.02))
    run = made.integrate([0.0, 1.0, 20.0])
    assert run.v[:, 0, 2] == pytest.approx(-terminal * np.tanh(9.81 * run.t / terminal), rel=1e-10)
    assert run.v[-1, 0, 2] == pytest.approx(-terminal, rel=1e-5)


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


def test_air_drag_takes_the_mean_velocity_of_the_ends_and_the_current_direction(explicit, scene):
    """Ends at 1 and 3 m/s across a rod turned from x to y and shortened: |u| = 2 m/s, L as in reference."""
    case = explicit([[0.0, 0, 0], [2.0, 0, 0]], [[0, 1]], cable=THREAD)
    made = scene(case, {"effects.air_drag": AIR})
    x = np.array([[0.0, 0, 0], [0.0, 1.5, 0]])
    v = np.array([[1.0, 5.0, 0.0], [3.0, -2.0, 0.0]])
    force = made.net.mass[:, None] * acceleration(made.system, 0.0, x, v)
    assert force == pytest.approx(
        np.tile([-0.5 * 0.5 * 1.2 * 1.1 * 0.01 * 2.0 * 4.0, 0, 0], (2, 1)), abs=1e-14
    )


def test_air_drag_on_cables_and_bullets_together(document, scene):
    """Both coefficients in one net: one cell, four cables of 1 m, moved along its normal."""
    made = scene(falling(document, 3.0, air_drag={**AIR, **BALLS}))
    cables, balls = 1.1 * 4 * 0.01 * 1.0, 0.5 * 4 * 0.02
    force = made.net.mass @ acceleration(made.system, 0.0, made.x0, made.v0)
    assert force == pytest.approx([0.0, 0.0, -0.5 * 1.2 * (cables + balls) * 9.0], abs=1e-12)


def test_drag_on_folded_elements_is_finite(document, scene):
    made = scene(document(), {"initial.packing": 0.0, "effects.air_drag": {**AIR, **BALLS}})
    v = np.random.default_rng(1).standard_normal(made.x0.shape)
    a, power = motion(made.system, 0.0, made.x0, v)
    assert np.isfinite(a).all()
    assert power > 0.0


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


@pytest.mark.parametrize("effect", ["molecular_drag", "solar_pressure"])
def test_area_of_the_bullets_counts(document, scene, effect):
    """One cell of 1 m with bullets of 0.02 m2: each node has two halves of pi/4 d L and its bullet."""
    keys = {
        "molecular_drag": GAS,
        "solar_pressure": {"flux": 1361.0, "direction": [0.0, 0.0, 1.0], "pressure_coefficient": 1.0},
    }
    made = scene(falling(document, 0.0, **{effect: {**keys[effect], "bullet_area": 0.02}}))
    area = math.pi / 4.0 * 0.01 + 0.02
    flow = np.array(GAS["flow"])
    pressure = {
        "molecular_drag": 0.5 * 2e-9 * 2.2 * np.linalg.norm(flow) * flow,
        "solar_pressure": np.array([0.0, 0.0, 1361.0 / 299792458.0]),
    }
    force = made.net.mass[:, None] * acceleration(made.system, 0.0, made.x0, made.v0)
    assert force == pytest.approx(np.tile(area * pressure[effect], (4, 1)), rel=1e-12, abs=1e-20)


def test_exponential_atmosphere():
    """Vallado, table 8-4: values at the bases, one between by hand; layers meet within the table's digits."""
    assert density(400e3) == 3.725e-12
    assert density(425e3) == pytest.approx(2.429827e-12, rel=1e-6)  # 3.725e-12 exp(-25/58.515)
    assert density(150e3) == 2.070e-9
    assert density(2000e3) == pytest.approx(3.019e-15 * math.exp(-1000.0 / 268.0))
    for base, at_base, _ in LAYERS[1:]:
        assert density(1e3 * base - 1e-6) == pytest.approx(at_base, rel=3e-4)


def test_density_by_altitude(document, scene):
    made = scene(
        falling(
            document, 0.0, molecular_drag={**GAS, "density": None, "altitude": 425e3, "bullet_area": 0.0}
        ),
        {"effects.molecular_drag.density": None},
    )
    assert made.system.effects.molecular_drag.density == pytest.approx(2.429827e-12, rel=1e-6)


DRAGS = {
    "air_drag": {**AIR, **BALLS},
    "molecular_drag": {**GAS, "density": 1e-3, "flow": [-50.0, 10.0, 5.0], "bullet_area": 0.02},
    "solar_pressure": {
        "flux": 1e9,
        "direction": [0.6, 0.0, -0.8],
        "pressure_coefficient": 1.0,
        "bullet_area": 0.02,
    },
}


@pytest.mark.ci_for("Verlet-air_drag")
@pytest.mark.slow_for("RK4", "Verlet-air_drag")
@pytest.mark.parametrize("effect", DRAGS)
@pytest.mark.parametrize(
    ("options", "bound"),
    [
        ({}, 1e-8),
        ({"method": "RK45", "rtol": 1e-7, "atol": 1e-9}, 1e-4),
        ({"method": "RK4", "step": 4e-5}, 3e-3),
        ({"method": "Verlet", "step": 4e-5}, 3e-3),
    ],
    ids=["DOP853", "RK45", "RK4", "Verlet"],
)
def test_energy_balances(document, scene, unbalanced, effect, options, bound):
    """A net that snaps out of its plane while gas or light push it."""
    made = scene(
        document("square", size=2.0),
        {"effects": {effect: DRAGS[effect]}, "initial.packing": 0.8, "launch.axial_speed": 1.0},
    )
    run = made.integrate([0.0, 0.06, 0.12], **options)
    speeds = np.linalg.norm(run.v[:, made.net.bullet_nodes], axis=2)
    assert np.ptp(speeds) > 0.1  # the net has snapped
    assert unbalanced(made, run) < bound
    if effect == "air_drag":
        assert np.all(np.diff(run.dissipated) > 0.0)


@pytest.mark.parametrize("effect", ["molecular_drag", "air_drag"])
def test_energy_momentum_refuses_drags_by_name(document, scene, effect):
    made = scene(document("square", size=2.0), {"effects": {effect: DRAGS[effect]}})
    with pytest.raises(ValueError, match=f"effects.{effect}, a damping that is not linear"):
        made.integrate(method="EM", step=1e-3)


def test_symmetric_arithmetic_keeps_mirrors_with_drag_sunlight_and_bending(document, scene):
    """A thrown square net: x -> -x, y -> -y, x <-> y to the last bit."""
    effects = {
        "molecular_drag": {**DRAGS["molecular_drag"], "flow": [0.0, 0.0, -40.0]},
        "solar_pressure": {**DRAGS["solar_pressure"], "direction": [0.0, 0.0, -1.0]},
        "bending": {"modulus": 1e10},
    }
    for chosen in (effects, {"air_drag": DRAGS["air_drag"], "bending": effects["bending"]}):
        made = scene(
            document("square", size=3.0, divisions=2),
            {"effects": chosen, "initial.packing": 0.8, "launch.axial_speed": 1.0},
            symmetric=True,
        )
        run = made.integrate([0.0, 0.1], method="RK45", rtol=1e-5, atol=1e-7)
        row = {tuple(p): i for i, p in enumerate((made.net.reference_position + 0.0).tolist())}
        for mirror in (lambda p: p * [-1, 1, 1], lambda p: p * [1, -1, 1], lambda p: p[..., [1, 0, 2]]):
            image = [row[tuple(p)] for p in (mirror(made.net.reference_position) + 0.0).tolist()]
            assert np.array_equal(run.x[:, image], mirror(run.x))
            assert np.array_equal(run.v[:, image], mirror(run.v))
