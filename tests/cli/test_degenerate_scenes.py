"""Scenes with an empty set somewhere run to their end: no element, no free node, no motion of its own."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from commands import command

import exunet
from exunet.integrators.exudyn.build import expected_items
from exunet.results.io import load_result
from exunet.results.summary import summarise
from exunet.scene.scene import Scene
from exunet.simulation.preparation import prepare
from exunet.simulation.run import run_into

SCENES = Path(__file__).parents[1] / "data" / "faults"
ONE_ELEMENT = (
    "net.nodes=[[0.0, 0.0, 0.0], [0.0, 0.0, 1.0]]",
    "net.elements=[[0, 1]]",
    "net.node_masses=[0.1, 0.1]",
)
NO_ELEMENT = "no_elements.toml"


@pytest.mark.parametrize("backend", ["exudyn", "compiled"])
@pytest.mark.parametrize(
    ("name", "changes"),
    [
        (NO_ELEMENT, ()),
        (NO_ELEMENT, ONE_ELEMENT),
        ("all_fixed.toml", ()),
        ("tether_between_prescribed.toml", ()),
        ("thread_between_prescribed.toml", ()),
        ("slack_or_taut.toml", ()),
    ],
    ids=["no element", "one element", "all fixed", "tether", "thread", "slack or taut"],
)
def test_a_scene_with_an_empty_set_runs_with_checkpoints(
    tmp_path: Path, name: str, changes: tuple[str, ...], backend: str
) -> None:
    """No number of its result is NaN; a summary is made of it."""
    changes = ("time.end=0.2", "time.output_step=0.1", f"engine.backend={backend}", *changes)
    run_into(tmp_path, exunet.load(SCENES / name, changes), checkpoint_every=0.1)
    result = load_result(tmp_path)
    assert np.isfinite(result.position).all()
    assert np.isfinite(result.kinetic + result.potential).all()
    assert summarise(result)["verdict"] == "ok"


def test_the_command_describes_a_scene_without_elements(tmp_path: Path) -> None:
    settings = ("--set", "time.end=0.2", "--set", "time.output_step=0.1", "--out", "out")
    ended = command("run", SCENES / NO_ELEMENT, *settings, folder=tmp_path)
    assert ended.returncode == 0, ended.stderr


@pytest.mark.slow
def test_a_long_fall_is_not_taken_for_a_divergence(tmp_path: Path) -> None:
    """The balance of free fall is off by round-off of the kinetic energy, 1e-10 of it after 4e6 steps."""
    case = exunet.load(SCENES / "long_fall.toml", ["time.end=36.0", "solver.method=VelocityVerlet"])
    result = exunet.run(case)
    assert result.time[-1] == 36.0


# Against hand calculations, by Exudyn

CABLE = {"diameter": 0.002, "density": 1390.0, "youngs_modulus": 1e9}
SPHERE = {"shape": "sphere", "radius": 0.1, "mass": 1.0}
PRESCRIBED = {
    "a": SPHERE | {"motion": "prescribed", "velocity": [0.0, 0.0, 0.1]},
    "b": SPHERE | {"motion": "prescribed", "position": [1.0, 0.0, 0.0], "velocity": [0.1, 0.0, 0.0]},
}
THREAD = {"nodes": [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]], "elements": [[0, 1]]}


def run(net: dict[str, object], **tables: object) -> exunet.Result:
    """Run a scene; the items that Exudyn makes are those that `exunet check` reports."""
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


@pytest.mark.parametrize("between", ["thread", "tether"])
def test_an_element_between_prescribed_bodies(between: str) -> None:
    """From (0, 0, 0.1 t) to (1 + 0.1 t, 0, 0): by EA and the Green-Lagrange strain."""
    if between == "thread":
        ties = [{"attachments": {"x": {"point": [0.0, 0.0, 0.0], "node": node}}} for node in (0, 1)]
        tied = {name: PRESCRIBED[name] | tie for name, tie in zip("ab", ties, strict=True)}
        result = run(THREAD, bodies=tied)
    else:
        far = {"nodes": [[0.0, 30.0, 0.0]], "elements": [], "node_masses": [0.1], "fixed": [0]}
        tether = CABLE | {"length": 1.0, "start": {"body": "a"}, "end": {"body": "b"}}
        result = run(far, bodies=PRESCRIBED, tethers={"t": tether})
    squared = (1.0 + 0.1 * result.time) ** 2 + (0.1 * result.time) ** 2
    tension = 1e9 * np.pi * 1e-6 * 0.5 * (squared - 1.0) * np.sqrt(squared)
    assert result.tension[:, -1] == pytest.approx(tension, rel=1e-12)


def test_a_free_body_beside_a_net_of_fixed_nodes() -> None:
    result = run(THREAD | {"fixed": [0, 1]}, bodies={"a": SPHERE | {"position": [0.0, 3.0, 0.0]}})
    assert result.bodies["a"].position[:, 2] == pytest.approx(-0.5 * 9.81 * result.time**2, abs=1e-12)
    assert np.array_equal(result.position, np.broadcast_to(THREAD["nodes"], (3, 2, 3)))
    assert not result.tension.any()
