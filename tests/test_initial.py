"""The state at time 0, against the rules of docs/theory.md."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydantic import TypeAdapter

from exunet.model.initial import initial_state
from exunet.net import AnyNetConfig, weave
from exunet.scene.casefile import load
from exunet.scene.scene import Scene

CASES = Path(__file__).parents[1] / "cases"
CABLE = {"area": 1e-6, "density": 1000.0, "youngs_modulus": 1e9}
PAIR = {"topology": "explicit", "nodes": [[0, 0, 0], [2, 0, 0]], "elements": [[0, 1]]}


def state(net: dict[str, Any], initial: dict[str, Any], **others: Any) -> tuple[np.ndarray, np.ndarray]:
    time = {"end": 1.0, "output_step": 0.1}
    table = {"format": 1, "title": "", "time": time, "net": {"cable": CABLE, **net}, "initial": initial}
    scene = Scene.model_validate(table | others)
    return initial_state(scene, weave(scene.net))


def test_the_papers_state() -> None:
    """Sec. 3.3 of the paper: a tenth of the reference; 2.5 m/s outwards at the bullets, the rest at rest."""
    scene = load(CASES / "planar_deployment.toml").scene
    net = weave(scene.net)
    position, velocity = initial_state(scene, net)
    np.testing.assert_array_equal(position, 0.1 * net.reference_position)
    component = 2.5 / math.sqrt(2)
    expected = component * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    np.testing.assert_allclose(velocity[:4], expected, rtol=1e-14)
    np.testing.assert_array_equal(velocity[4:], 0.0)


def test_axial_launch_is_along_z_and_adds_to_the_common_velocity() -> None:
    net = {"topology": "square", "size": 1.0, "mesh": 1.0, "bullets": {"mass": 1.0}}
    launch = {"radial_speed": 0.0, "axial_speed": 3.0}
    _, velocity = state(net, {"packing": 1, "velocity": [1.0, 2.0, 4.0]}, launch=launch)
    np.testing.assert_array_equal(velocity, [[1.0, 2.0, 7.0]] * 4)


def test_spin_turns_about_the_origin_by_the_initial_position() -> None:
    """omega x r with omega = 3 z, r = packing (2, 0, 0) = (1, 0, 0): (0, 3, 0) m/s."""
    position, velocity = state(PAIR, {"packing": 0.5, "spin": [0.0, 0.0, 3.0]})
    np.testing.assert_array_equal(position, [[0, 0, 0], [1, 0, 0]])
    np.testing.assert_array_equal(velocity, [[0, 0, 0], [0, 3, 0]])


def test_packing_zero_gathers_all_nodes_at_the_origin() -> None:
    position, _ = state({"topology": "square", "size": 1.0, "mesh": 0.5}, {"packing": 0})
    np.testing.assert_array_equal(position, np.zeros((9, 3)))


def test_listed_positions_and_velocities_are_interpolated_on_divided_elements() -> None:
    """Three inner nodes between (0, 0, 4) and (4, 0, 0), between (0, 8, 0) and 0 m/s; omega x r on top."""
    initial = {
        "packing": 1.0,
        "velocity": [1.0, 0.0, 0.0],
        "spin": [0.0, 1.0, 0.0],
        "node_positions": [[0, 0, 4], [4, 0, 0]],
        "node_velocities": [[0, 8, 0], [0, 0, 0]],
    }
    position, velocity = state({**PAIR, "divisions": 4}, initial)
    np.testing.assert_allclose(position, [[0, 0, 4], [4, 0, 0], [1, 0, 3], [2, 0, 2], [3, 0, 1]])
    # y x (x, 0, z) = (z, 0, -x)
    expected = [[1 + 4, 8, 0], [1, 0, -4], [1 + 3, 6, -1], [1 + 2, 4, -2], [1 + 1, 2, -3]]
    np.testing.assert_allclose(velocity, expected)


def test_fixed_nodes_are_at_rest() -> None:
    initial = {"packing": 1, "velocity": [1.0, 0, 0], "node_velocities": [[0, 1.0, 0], [0, 1.0, 0]]}
    _, velocity = state({**PAIR, "fixed": [0]}, initial)
    np.testing.assert_array_equal(velocity, [[0, 0, 0], [1, 1, 0]])


def test_strings_of_a_bridle_are_launched_radially() -> None:
    """Bullet k of a honeycomb flies at 60 k degrees."""
    strings = {**CABLE, "length": 1.0}
    net = {"topology": "hexagonal", "mesh": 0.5, "rings": 1, "strings": strings, "bullets": {"mass": 1.0}}
    _, velocity = state(net, {"packing": 0.2}, launch={"radial_speed": 2.0, "axial_speed": 0.5})
    angle = np.radians(60.0 * np.arange(6))
    expected = np.stack([2 * np.cos(angle), 2 * np.sin(angle), 0 * angle + 0.5], axis=1)
    np.testing.assert_allclose(velocity[:6], expected, atol=1e-13)
    assert not velocity[6:].any()


@pytest.mark.parametrize("divisions", [1, 3])
def test_a_turned_net_spins_as_a_rigid_body(divisions: int) -> None:
    """Rigid rotation: no element changes its length, (v_j - v_i) . (x_j - x_i) = 0."""
    net = {"topology": "radial", "radius": 2.0, "spokes": 6, "rings": 2, "divisions": divisions}
    position, velocity = state(net, {"packing": 0.7, "spin": [0.3, -0.2, 0.9]})
    woven = weave(TypeAdapter(AnyNetConfig).validate_python({"cable": CABLE, **net}))
    i, j = woven.element_nodes.T
    rate = np.einsum("ea,ea->e", velocity[j] - velocity[i], position[j] - position[i])
    assert np.abs(rate).max() < 1e-14
    assert np.abs(velocity).max() > 0.5
