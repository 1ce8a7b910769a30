"""Scenes without a free coordinate: every point is fixed or moves with a prescribed body."""

import numpy as np
import pytest

import exunet
from exunet.integrators.exudyn.build import expected_items
from exunet.scene.scene import Scene
from exunet.simulation.preparation import prepare

CABLE = {"diameter": 0.002, "density": 1390.0, "youngs_modulus": 1e9}
SPHERE = {"shape": "sphere", "radius": 0.1, "mass": 1.0}
PRESCRIBED = {
    "a": SPHERE | {"motion": "prescribed", "velocity": [0.0, 0.0, 0.1]},
    "b": SPHERE | {"motion": "prescribed", "position": [1.0, 0.0, 0.0], "velocity": [0.1, 0.0, 0.0]},
}
THREAD = {"nodes": [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]], "elements": [[0, 1]]}
NODE = {"nodes": [[0.0, 30.0, 0.0]], "elements": [], "node_masses": [0.1], "fixed": [0]}
TETHER = CABLE | {"length": 1.0, "start": {"body": "a"}, "end": {"body": "b"}}


def attached(node):
    return {"attachments": {"x": {"point": [0.0, 0.0, 0.0], "node": node}}}


def run(net, **tables):
    """Run a scene by Exudyn; the items that it makes are those that `exunet check` reports."""
    document = {
        "format": 1,
        "title": "nothing is free",
        "time": {"end": 0.02, "output_step": 0.01},
        "engine": {"backend": "exudyn"},
        "net": {"topology": "explicit", "cable": CABLE, **net},
        "initial": {"packing": 1.0},
        "effects": {"gravity": {"acceleration": [0.0, 0.0, -9.81]}},
        **tables,
    }
    scene = Scene.model_validate(document)
    result = exunet.run(scene)
    assert result.provenance["items"] == expected_items(prepare(scene).system)
    return result


def tension_of_prescribed(time):
    """Between (0, 0, 0.1 t) and (1 + 0.1 t, 0, 0), by EA and the Green-Lagrange strain."""
    squared = (1.0 + 0.1 * time) ** 2 + (0.1 * time) ** 2
    return 1e9 * np.pi * 1e-6 * 0.5 * (squared - 1.0) * np.sqrt(squared)


@pytest.mark.parametrize("method", ["RK44", "DOPRI5"])
def test_a_net_of_fixed_nodes_stays(method):
    result = run(THREAD | {"fixed": [0, 1]}, solver={"method": method})
    assert np.array_equal(result.position, np.broadcast_to(THREAD["nodes"], (3, 2, 3)))
    assert not result.tension.any()


@pytest.mark.parametrize("between", ["thread", "tether"])
def test_an_element_between_prescribed_bodies(between):
    if between == "thread":
        bodies = {name: body | attached(node) for node, (name, body) in enumerate(PRESCRIBED.items())}
        result = run(THREAD, bodies=bodies)
    else:
        result = run(NODE, bodies=PRESCRIBED, tethers={"t": TETHER})
    assert result.tension[:, -1] == pytest.approx(tension_of_prescribed(result.time), rel=1e-12)


def test_a_free_body_beside_a_net_of_fixed_nodes():
    result = run(THREAD | {"fixed": [0, 1]}, bodies={"a": SPHERE | {"position": [0.0, 3.0, 0.0]}})
    fallen = -0.5 * 9.81 * result.time**2
    assert result.bodies["a"].position[:, 2] == pytest.approx(fallen, abs=1e-12)
