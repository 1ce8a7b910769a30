"""The public functions: what they accept, and that arguments of a wrong type are refused by them."""

from __future__ import annotations

import inspect
import sys
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from result_samples import square_net, unfolding
from scenes import CASES

import exunet
from exunet.base.errors import CaseError, InputError, MissingExtra
from exunet.bodies.port import Piece
from exunet.results import measures
from exunet.results.result import BodyStates

PLANAR = CASES / "planar_deployment.toml"
SHORT = ("time.end=2e-3", "time.output_step=1e-3", 'engine.backend="compiled"')
POSE = np.zeros((4, 3)), np.array([1.0, 0.0, 0.0, 0.0]), np.zeros((4, 3))  # of a Piece

# Arguments for which any value will do, or some of the wrong ones.
FREE = {"hosted", "overwrite"}
FITS = {
    ("summarise", "check"): ("absent",), ("summarise", "ensemble"): ("absent",),
    ("run_ensemble", "retries"): (1,), ("run_ensemble", "workers"): (1,),
    ("perturbed_positions", "runs"): (1,), ("perturbed_positions", "amplitude"): (1,),
    ("perturbed_positions", "seed"): (1,), ("perturbed_positions", "first"): (1,),
    ("ensemble", "runs"): (1,), ("ensemble", "perturb"): (1,), ("ensemble", "seed"): (1,),
    ("ensemble", "case"): ("case",), ("run", "case"): ("case",), ("prepare", "scene"): ("case",),
    ("export_fmu", "case"): ("case",), ("export_fmu", "path"): ("absent",),
    ("save", "path"): ("absent",), ("save_figures", "folder"): ("absent",),
    ("export", "source"): ("absent",),
    ("save_view", "path"): ("absent",), ("save_ensemble", "path"): ("absent",), ("add_to", "case"): ("case",),
}  # fmt: skip
WRONG = {"none": None, "text": "absent", "number": 1, "list": [object()], "case": "case", "object": object()}


@cache
def case() -> Any:
    return exunet.load(PLANAR, SHORT)


@cache
def result() -> exunet.Result:
    return exunet.run(case())


@cache
def start() -> exunet.Start:
    return exunet.prepare(case())


@cache
def several() -> exunet.Ensemble:
    return exunet.ensemble(case(), 2)


@cache
def study() -> exunet.Study:
    inputs = {"launch.radial_speed": {"uniform": [2.0, 3.0]}}
    return exunet.Study(PLANAR, design="random", runs=2, seed=1, inputs=inputs)


@cache
def simulation() -> exunet.Simulation:
    return exunet.Simulation(case())


@pytest.mark.parametrize("of", ["name", "path", "case", "scene"])
def test_run_and_prepare_take_whatever_names_a_case(of: str, tmp_path: Path) -> None:
    path = tmp_path / "case.toml"
    path.write_text(PLANAR.read_text(encoding="utf-8").replace("end = 2.0", "end = 0.001"))
    loaded = exunet.load(path)
    given = {"name": str(path), "path": path, "case": loaded, "scene": loaded.scene}[of]
    prepared = exunet.prepare(given)
    assert prepared.scene.model_copy(update={"engine": loaded.scene.engine}) == loaded.scene
    run = exunet.run(given)
    assert run.time[-1] == 0.001
    assert np.array_equal(exunet.run(prepared).position, run.position)
    assert run.run.case.name == ("scene.toml" if of == "scene" else "case.toml")


def arguments(name: str) -> dict[str, Any]:
    """Arguments with which a function does what it is for, or nearly."""
    of_result = {"result": result()}
    return {
        "load": {"path": PLANAR},
        "run": {"case": case()},
        "resume": {"folder": "absent"},
        "add_to": {"mbs": None, "case": case(), "ports": {}},
        "export_fmu": {"case": case(), "path": "absent/own.fmu"},
        "load_result": {"path": "absent"},
        "save": of_result | {"path": "absent/result.h5"},
        "mouth_area": {"net": start().net, "position": start().position},
        "mesh_area": {"net": start().net, "position": start().position},
        "achievable_area": {"net": start().net},
        "loads": of_result | {"body": "none"},
        "clearance": of_result | {"one": "none", "other": "none"},
        "compare": {"a": result(), "b": result()},
        "ensemble": {"case": case(), "runs": 1},
        "save_ensemble": {"result": several(), "path": "absent/ensemble.h5"},
        "load_ensemble": {"path": "absent"},
        "prepare": {"scene": case()},
        "perturbed_positions": {"start": start(), "runs": 1, "amplitude": 0.0, "seed": 0},
        "run_ensemble": {"start": start(), "position": start().position[None]},
        "figure": of_result | {"name": "area"},
        "optimise": {"study": study(), "folder": "absent"},
        "save_figures": of_result | {"folder": "absent"},
        "export": of_result | {"path": "absent/series.csv"},
        "save_view": of_result | {"path": "absent/view.html"},
    }.get(name, of_result)


FUNCTIONS = sorted(
    name for names in exunet.API.values() for name in names if inspect.isfunction(getattr(exunet, name))
)


@pytest.mark.parametrize("name", FUNCTIONS)
def test_arguments_of_a_wrong_type_are_refused(name: str) -> None:
    """With an error of the input, no AttributeError or TypeError from within."""
    function, good = getattr(exunet, name), arguments(name)
    for argument, parameter in inspect.signature(function).parameters.items():
        if argument in FREE:
            continue
        for wrong in WRONG.values():
            if wrong in FITS.get((name, argument), ()) or (wrong is None and parameter.default is None):
                continue
            given = case() if wrong == "case" else wrong
            with pytest.raises((InputError, CaseError)):
                function(**good | {argument: given})


METHODS = sorted(
    name
    for name, method in inspect.getmembers(exunet.Simulation, inspect.isfunction)
    if not name.startswith("_") and len(inspect.signature(method).parameters) > 1
)


@pytest.mark.parametrize("name", METHODS)
def test_arguments_of_a_simulations_methods_are_refused_and_change_nothing(name: str) -> None:
    sim = exunet.Simulation(start())
    method = getattr(sim, name)
    before, acting = sim.state, sim.acting
    for wrong in (None, "text", [object()], case(), object()):
        with pytest.raises(InputError):
            method(*[wrong] * len(inspect.signature(method).parameters))
        assert sim.acting is acting
        assert sim.time == 0.0
        assert (sim.state.position == before.position).all()


@pytest.mark.parametrize(
    ("call", "argument"),
    [
        (lambda: exunet.run("nowhere.toml"), "nowhere.toml"),
        (lambda: exunet.save(None, "own.h5"), "save: result"),
        (lambda: exunet.perturbed_positions(case(), 1, 0.0, 0), "perturbed_positions: start"),
        (lambda: exunet.save_figures(result(), "here", ensemble=1), "ensemble"),
        (lambda: exunet.mouth_area(start().net, None), "position"),
        (lambda: exunet.mouth_area(start().net, np.full((40, 3), "a")), "position"),
        (lambda: exunet.mesh_area(start().net, np.full((40, 3), None)), "position"),
        (lambda: exunet.Simulation(case(), wrenches="ab"), "wrenches"),
        (lambda: exunet.Simulation(case(), recorder=1), "recorder"),
        (lambda: exunet.margins(result(), [True]), "margins: among"),
        (lambda: simulation().set_input(["a"], [1.0]), "set_input"),
        (lambda: simulation().restore(simulation().state), "State"),
        (lambda: simulation().steer("chaser", Piece(0.0, *POSE)), "'chaser'"),
        (lambda: simulation().steered("chaser"), "'chaser'"),
        (lambda: exunet.save(result(), "x" * 300 + ".h5"), "File name too long"),
        (lambda: exunet.save_ensemble(several(), "x" * 300), "File name too long"),
        (lambda: exunet.export_fmu(case(), "x" * 300 + ".fmu"), "File name too long"),
    ],
)
def test_the_argument_is_named_and_a_simulation_stays_as_it_was(call: Any, argument: str) -> None:
    with pytest.raises(InputError) as error:
        call()
    assert argument in str(error.value)
    assert "\n" not in str(error.value)
    assert simulation().snapshot().time == 0.0


def test_a_table_needs_pandas(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(MissingExtra):
        exunet.to_frame(unfolding(square_net()))


def test_a_table_has_the_results_numbers() -> None:
    pytest.importorskip("pandas")
    of = unfolding(square_net(cells=2, strings=True), lift=0.3)
    turning, still = np.linspace(0.0, 1.0, 21).reshape(7, 3), np.zeros((7, 3))
    upright = np.tile([1.0, 0.0, 0.0, 0.0], (7, 1))
    target = BodyStates(2.0, np.eye(3), still, still, upright, turning)
    chaser = BodyStates(5.0, np.eye(3), turning, still, upright, still)
    of = replace(of, bodies={"target": target, "chaser": chaser})
    table = exunet.to_frame(of)
    assert table.index.name == "time [s]"
    np.testing.assert_array_equal(table.index, of.time)
    known = {
        "kinetic [J]": of.kinetic,
        "elastic [J]": of.elastic,
        "area [m2]": measures.mouth_area(of.net, of.position),
        "tension [N]": of.tension.max(axis=1),
        "slowest_bullet [m/s]": measures.bullet_speeds(of).min(axis=1),
        "body_target/angular_velocity_y [rad/s]": turning[:, 1],
        "body_chaser/position_x [m]": turning[:, 0],
    }
    for name, values in known.items():
        np.testing.assert_allclose(table[name], values, rtol=1e-14)
