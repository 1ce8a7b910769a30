"""Drag of air and of a molecular flow, and sunlight: forces on elements and motions that are known."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from scenes import EFFECT_CASES, ENDS, THREAD, every_backend, listed, one_thread, ran, random_states

from exunet.forces.blocks import Blocks
from exunet.forces.effects import air_drag
from exunet.forces.environment import (
    LAYERS,
    bullet_disc,
    exponential_density,
    tumbling_areas,
)
from exunet.results.measures import energy_balance, energy_scale
from exunet.scene.casefile import load
from exunet.simulation.preparation import prepare
from exunet.simulation.run import simulate


@every_backend
def test_a_cable_falls_in_air_towards_its_terminal_speed(backend: str) -> None:
    """Broadside: v = v_t tanh(g t / v_t), v_t = sqrt(2 m g / (rho C d L))."""
    case = one_thread(3.0,
        effects={
            "gravity": {"acceleration": [0.0, 0.0, -9.81]},
            "air_drag": {"density": 1.2, "drag_coefficient": 1.1},
        },
    )  # fmt: skip
    run = ran(case, backend)
    diameter = 2.0 * math.sqrt(1e-6 / math.pi)
    terminal = math.sqrt(2.0 * 1e-3 * 9.81 / (1.2 * 1.1 * diameter))
    assert np.abs(run.velocity[:, 0, 2] + terminal * np.tanh(9.81 * run.time / terminal)).max() < 1e-8
    assert run.velocity[-1, 0, 2] == pytest.approx(-terminal, rel=1e-3)
    turned_over = run.potential[0] - run.potential[-1]  # nothing of it is in play: it falls as a whole
    assert energy_balance(run) * energy_scale(run) < 1e-8 * turned_over


def test_a_cable_that_moves_along_itself_feels_no_cross_flow() -> None:
    case = one_thread(
1.0,
        initial={"velocity": [3.0, 0.0, 0.0]},
        effects={"air_drag": {"density": 1.2, "drag_coefficient": 1.1}},
    )  # fmt: skip
    assert np.abs(ran(case).velocity - [3.0, 0.0, 0.0]).max() < 1e-12


def test_nodes_on_one_spot_feel_the_whole_flow() -> None:
    case = one_thread(
1.0,
        initial={"packing": 0.0, "velocity": [3.0, 0.0, 0.0]},
        effects={"air_drag": {"density": 1.2, "drag_coefficient": 1.1}},
    )  # fmt: skip
    rate = 0.5 * 1.2 * 1.1 * 2.0 * math.sqrt(1e-6 / math.pi) / 1e-3
    run = ran(case)
    assert np.abs(run.velocity[:, 0, 0] - 3.0 / (1.0 + 3.0 * rate * run.time)).max() < 1e-9


@every_backend
def test_a_bullet_slows_down_by_its_own_drag(backend: str) -> None:
    """On a slack string: v = v0 / (1 + k v0 t), k = rho C A / 2m."""
    net = {
        "topology": "square", "size": 1.0, "mesh": 1.0, "cable": THREAD,
        "strings": THREAD | {"length": 0.5}, "bullets": {"mass": 0.01},
    }  # fmt: skip
    drag = {
        "density": 1.2, "drag_coefficient": 0.0, "bullet_drag_coefficient": 0.47, "bullet_area": 2e-3,
    }  # fmt: skip
    case = listed([], [], 0.5, effects={"air_drag": drag}) | {
        "net": net,
        "initial": {"packing": 0.5, "velocity": [3.0, 4.0, 0.0]},
    }
    run = ran(case, backend)
    bullet = run.net.bullet_nodes[0]
    rate = 0.5 * 1.2 * 0.47 * 2e-3 / run.net.mass[bullet]
    speed = 5.0 / (1.0 + 5.0 * rate * run.time)
    assert np.abs(run.velocity[:, bullet] - np.outer(speed, [0.6, 0.8, 0.0])).max() < 1e-8
    assert speed[-1] < 4.6


@every_backend
def test_molecular_flow_carries_a_node_along(backend: str) -> None:
    """u' = -k u^2 for the speed u of the gas against it: u = u0 / (1 + k u0 t), k = rho C A / 2m."""
    flow, density = [-40.0, 30.0, 0.0], 1e-3
    case = one_thread(2.0,
        effects={"molecular_drag": {"density": density, "flow": flow, "drag_coefficient": 2.2}},
    )  # fmt: skip
    run = ran(case, backend)
    area = math.pi / 4 * 2.0 * math.sqrt(1e-6 / math.pi)  # of the whole tumbling cable, mass 1e-3 kg
    left = 1.0 / (1.0 + 0.5 * density * 2.2 * area / 1e-3 * 50.0 * run.time)
    assert np.abs(run.velocity[:, 1] - np.outer(1.0 - left, flow)).max() < 1e-8
    assert left[-1] < 0.95


def test_the_atmosphere_is_continuous_from_layer_to_layer() -> None:
    """Vallado's table is made so, to the digits that he prints; a slip in the table would show."""
    for (base, density, scale), (upper, above, _) in itertools.pairwise(LAYERS):
        assert density * math.exp(-(upper - base) / scale) == pytest.approx(above, rel=2e-3)
    assert exponential_density(400e3) == 3.725e-12
    assert exponential_density(747.2119e3) == pytest.approx(2.1219854e-14, rel=1e-4)  # Vallado, example 8-4


def test_areas_of_tumbling_cables() -> None:
    net = prepare(load(EFFECT_CASES / "solar_pressure.toml").scene).net
    area = tumbling_areas(Blocks.of_net(net), 0.0021)
    diameter = np.where(net.is_string, 0.003, 0.002)
    cables = math.pi / 4 * (diameter * net.reference_length).sum()
    assert area.sum() == pytest.approx(cables + 4 * 0.0021, rel=1e-12)


def test_sunlight_pushes_the_centre_of_mass() -> None:
    bright = ["effects.solar_pressure.flux=1361e6", "engine.backend=exudyn"]
    run = simulate(prepare(load(EFFECT_CASES / "solar_pressure.toml", bright).scene))
    force = 1.3 * 1361e6 / 299792458.0 * tumbling_areas(Blocks.of_net(run.net), 0.0021).sum()
    momentum = run.momentum - run.momentum[0]
    np.testing.assert_allclose(momentum, np.outer(force * run.time, [0.0, 1.0, 0.0]), rtol=0, atol=1e-11)
    assert energy_balance(run) < 1e-6


RANDOM = np.random.default_rng(20261121)
FIRST, SECOND = 3 * ENDS.T


def test_cross_flow_brakes_what_is_normal_to_each_element() -> None:
    quarter = RANDOM.uniform(0.5, 2.0, 6)
    flow = air_drag.CrossFlow(FIRST, SECOND, quarter, np.full(6, 1e-12))
    for x, v in random_states(5):
        x[3] = x[0] + 1e-9  # on one spot but for less than counts: the whole flow
        wanted = np.zeros((4, 3))
        for e, (i, j) in enumerate(ENDS):
            u = 0.5 * (v[i] + v[j])
            along = (x[j] - x[i]) / np.linalg.norm(x[j] - x[i])
            normal = u if {i, j} == {0, 3} else u - (u @ along) * along
            wanted[[i, j]] -= quarter[e] * np.linalg.norm(normal) * normal
        force = np.zeros(12)
        air_drag.add_cross_flow(0.0, x.ravel(), v.ravel(), flow, force)
        np.testing.assert_allclose(force.reshape(4, 3), wanted, rtol=1e-12, atol=1e-13)


def test_the_assumed_ball_has_the_area_of_its_mass() -> None:
    """1 kg of aluminium, 2700 kg/m3: a radius of 44.55 mm, so a disc of 6.235e-3 m2; area as m^(2/3)."""
    radius = (3.0 / (4.0 * math.pi * 2700.0)) ** (1.0 / 3.0)
    assert radius == pytest.approx(0.04455, abs=5e-6)
    assert bullet_disc(1.0) == pytest.approx(math.pi * radius**2, rel=1e-14)
    assert bullet_disc(8.0) == pytest.approx(4.0 * bullet_disc(1.0), rel=1e-14)
    assert bullet_disc(1e-3) == pytest.approx(1e-2 * bullet_disc(1.0), rel=1e-14)
