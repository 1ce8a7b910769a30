"""Scenes from Python: the same tables, checks, files and results as case files."""

from __future__ import annotations

import os
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scenes import CASES, SHIPPED_CASES

import exunet as ex
from exunet.scene.casefile import case_of
from exunet.simulation.run import Request, run_into

CORD = {"diameter": 1e-3, "density": 970.0, "youngs_modulus": 1e11}


def net(**keys: Any) -> ex.SquareNet:
    return ex.SquareNet(**{"size": 10.0, "meshes": 4, "cable": ex.Cable(**CORD), **keys})


def scene(**keys: Any) -> ex.Scene:
    made = {
        "title": "x",
        "time": ex.Time(end=1e-3, output_step=5e-4),
        "net": net(),
        "initial": {"packing": 0.1},
    }
    return ex.Scene(**made | keys)


# Files


def test_every_shipped_case_is_the_same_scene_once_saved(tmp_path: Path) -> None:
    """Its numbers are written as they were given: an attitude is not brought to length 1 twice."""
    assert len(SHIPPED_CASES) > 100
    for path in SHIPPED_CASES:
        given = ex.Scene.load(path)
        given.save(tmp_path / path.name)
        assert ex.Scene.load(tmp_path / path.name) == given, path
        assert ex.Scene.of(given.document()) == given, path


SHORTENED = {
    "planar_deployment": 0.01, "capture/cylinder": 0.01, "capture/box": 0.01, "bodies/frame": 0.01,
    "bodies/tow": 0.02, "verification/bodies/reel_rate": 0.05, "verification/closing/open_line": 0.02,
    "effects/orbit": 0.01, "missions/missed": 0.01, "hard/folded": 0.01, "effects/air_drag": 0.01,
    "effects/launch_force": 0.01,
}  # fmt: skip


@pytest.mark.parametrize("name", SHORTENED)
def test_a_saved_case_has_the_same_bits(tmp_path: Path, name: str) -> None:
    end = SHORTENED[name]
    case = ex.load(CASES / f"{name}.toml", [f"time.end={end}", f"time.output_step={end}"])
    case.scene.save(tmp_path / "saved.toml")
    one, other = ex.run(case), ex.run(ex.Scene.load(tmp_path / "saved.toml"))
    same_bits(one, other)


def test_the_scene_of_the_tutorial_has_the_same_bits_from_python_and_from_its_file(tmp_path: Path) -> None:
    """Carried net, two bodies, tether, closing line with a winch, contact, capture, script."""
    page = (CASES.parent / "docs" / "how_to" / "scenes.md").read_text(encoding="utf-8")
    names: dict[str, Any] = {}
    exec(page.partition("```python\n")[2].partition("```")[0], names)
    names["scene"].save(tmp_path / "capture.toml")
    same_bits(ex.run(names["scene"]), ex.run(ex.load(tmp_path / "capture.toml")))


def same_bits(one: ex.Result, other: ex.Result) -> None:
    assert one.position.tobytes() == other.position.tobytes()
    assert one.velocity.tobytes() == other.velocity.tobytes()
    for name, states in one.bodies.items():
        assert np.asarray(states.position).tobytes() == np.asarray(other.bodies[name].position).tobytes()


def test_files_are_relative_to_the_current_folder_and_saved_relative_to_the_case(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(CASES / "capture")
    body = ex.Body(shape="mesh", file="l_shape.obj", unit="m", mass=5.0, attitude=(1, 2, 3, 4))
    made = scene(bodies={"target": body}, initial={"packing": 1.0, "spin": np.array([0, 0, 0.1])})
    monkeypatch.chdir(tmp_path)
    (tmp_path / "deep").mkdir()
    made.save("deep/own.toml")
    written = tomllib.loads((tmp_path / "deep" / "own.toml").read_text())["bodies"]["target"]
    assert not os.path.isabs(written["file"])
    assert (tmp_path / "deep" / written["file"]).samefile(CASES / "capture" / "l_shape.obj")
    assert written["attitude"] == [1.0, 2.0, 3.0, 4.0]
    monkeypatch.chdir(CASES)
    loaded = ex.Scene.load(tmp_path / "deep" / "own.toml")
    assert loaded == made
    same_bits(ex.run(loaded), ex.run(made))


def test_a_result_to_start_from_is_saved_relative(tmp_path: Path) -> None:
    made = scene(initial={"restart": tmp_path / "results" / "first@0.5"})
    made.save(tmp_path / "next.toml")
    text = (tmp_path / "next.toml").read_text()
    assert tomllib.loads(text)["initial"]["restart"] == "results/first@0.5"
    assert ex.Scene.load(tmp_path / "next.toml") == made


# Arguments


def test_numpy_values_and_records_are_those_of_a_file() -> None:
    made = scene(
        net=net(meshes=np.int64(4), bullets=ex.Bullets(mass=np.float32(0.5))),
        solver={"force": np.bool_(True), "retry": np.int32(1)},
        initial=ex.Initial(packing=np.float64(0.1), velocity=np.arange(3)),
        engine={"backend": np.str_("compiled")},
    )
    plain = {
        "format": 1,
        "title": "x",
        "time": {"end": 1e-3, "output_step": 5e-4},
        "net": {"topology": "square", "size": 10, "meshes": 4, "cable": CORD, "bullets": {"mass": 0.5}},
        "solver": {"force": True, "retry": 1},
        "initial": {"packing": 0.1, "velocity": [0, 1, 2]},
        "engine": {"backend": "compiled"},
    }
    assert made == ex.Scene.of(plain) == ex.Scene.of(made.text())
    assert made.document() == plain
    assert len(repr(made)) < 200


NODES = {"packing": 1.0, "node_positions": np.eye(2, 3)}
LISTED = ex.ExplicitNet(nodes=np.eye(3), elements=[(0, 1), (1, 2)], cable=CORD)


@pytest.mark.parametrize(
    ("make", "keys"),
    [
        (lambda: net(mesh=0.3, meshes=None), ["net.mesh"]),
        (lambda: net(mash=0.5), ["net.mash"]),
        (lambda: ex.Body(shape="box", size=[], mass=1.0), ["Body.size"]),
        (lambda: ex.Study(CASES / "planar_deployment.toml", inputs=[1, 2]), ["inputs"]),
        (lambda: net(radius=0.5), ["net.radius"]),
        (lambda: ex.Cable(diameter=-1, density=0, youngs_modulus=1.0), ["Cable.diameter", "Cable.density"]),
        (lambda: ex.ExplicitNet(nodes=np.eye(3), elements=[(0, 3)], cable=CORD), ["net.elements[0]"]),
        (lambda: ex.ExplicitNet(nodes=np.eye(3), elements=[(0, 2**63)], cable=CORD), ["net.elements[0][1]"]),
        (lambda: scene(launch=ex.ConeLaunch(speed=1.0, spread_angle=0.1)), ["launch"]),
        (lambda: scene(net=LISTED, initial=NODES), ["initial.node_positions"]),
        (lambda: scene(capture={"target": "sat", "enclosed": 0.9, "duration": 0.1}), ["capture.target"]),
        (lambda: scene(title=None, seed=2**63), ["title", "seed"]),
        (lambda: scene().replace({"net.cable.densty": 1.0}), ["net.cable.densty"]),
        (lambda: scene().replace({"launch": {"speed": 1.0, "spread_angle": 0.1}}), ["launch"]),
        (lambda: scene().replace({"nets.size": 1.0}), ["nets"]),
        (lambda: scene().replace({"script[0].force": 1.0}), [""]),
        (lambda: ex.Scene.of("format = 1\ntime.end = [np.float64(0.59)]"), [""]),
    ],
)  # fmt: skip
def test_errors_name_the_argument(make: Any, keys: list[str]) -> None:
    with pytest.raises(ex.CaseError) as error:
        make()
    assert [fault.key for fault in error.value.faults] == keys


@pytest.mark.parametrize(
    "make",
    [
        lambda: ex.SquareNet(10.0, 0.5),
        lambda: ex.Scene("title"),
        lambda: ex.Scene.of(3),
        lambda: setattr(net(), "size", 3.0),
        lambda: ex.ExplicitNet.from_csv("nodes.csv"),
        lambda: scene().replace([("time.end", 1.0)]),
        lambda: scene().save("nowhere/own.toml"),
    ],
)
def test_other_arguments_are_refused(make: Any) -> None:
    with pytest.raises(ex.InputError):
        make()


def test_replace_gives_another_scene() -> None:
    made = scene(
        bodies={"a": {"mass": 1, "inertia": [1, 1, 1]}}, script=[{"name": "one", "at": 5e-4, "do": "note"}]
    )
    changed = made.replace(
        {"net.mesh": 0.5, "bodies.a": None, "script[0].at": np.float64(2.5e-4), "engine.backend": "compiled"}
    )
    assert (changed.net.mesh, changed.net.meshes, changed.bodies) == (0.5, None, {})
    assert (changed.script[0].at, changed.engine.backend) == (2.5e-4, "compiled")
    assert (made.net.meshes, list(made.bodies), made.script[0].at) == (4, ["a"], 5e-4)


# Results


def test_a_result_of_a_scene_has_its_text_with_which_it_is_compared_and_resumed(tmp_path: Path) -> None:
    made = scene(net=net(bullets={"mass": 0.5}), launch={"speed": 1.0, "spread_angle": 0.1})
    faster = made.replace({"launch.speed": 2.0})
    for name, one in (("one", made), ("other", faster)):
        ex.save(ex.run(one), tmp_path / f"{name}.h5")
    stored = ex.load_result(tmp_path / "one.h5").run.case
    assert ex.Scene.of(stored.text) == made
    assert Request.of_json(Request(case_of(made, "run")).as_json()).case.scene == made
    assert ex.ensemble(made, 1).run.case.text == stored.text
    result = run_into(tmp_path, made)
    same_bits(result, ex.run(ex.Simulation(made).start))
