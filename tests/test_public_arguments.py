"""Arguments of a wrong type are told in words by every public function, not by an error from within."""

from __future__ import annotations

import inspect
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import exunet
from exunet.base.errors import CaseError, InputError
from exunet.bodies.port import Piece

PLANAR = Path(__file__).parent.parent / "cases" / "planar_deployment.toml"
STILL = np.zeros((4, 3)), np.array([1.0, 0.0, 0.0, 0.0]), np.zeros((4, 3))  # of a Piece
SHORT = ("time.end=2e-3", "time.output_step=1e-3", 'engine.backend="compiled"')

# Arguments for which any value will do, or some of the wrong ones.
FREE = {"hosted", "overwrite"}
FITS = {
    ("summarise", "check"): ("absent",), ("summarise", "spread"): ("absent",),
    ("run_ensemble", "retries"): (1,), ("run_ensemble", "workers"): (1,), ("run_ensemble", "first"): (1,),
    ("perturbed_positions", "runs"): (1,), ("perturbed_positions", "amplitude"): (1,),
    ("perturbed_positions", "seed"): (1,), ("perturbed_positions", "first"): (1,),
    ("ensemble", "runs"): (1,), ("ensemble", "perturb"): (1,), ("ensemble", "seed"): (1,),
    ("ensemble", "case"): ("case",), ("run", "case"): ("case",), ("prepare", "scene"): ("case",),
    ("export_fmu", "case"): ("case",), ("export_fmu", "path"): ("absent",),
    ("save", "path"): ("absent",), ("save_figures", "folder"): ("absent",),
    ("save_ensemble", "path"): ("absent",), ("add_to", "case"): ("case",),
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
def several() -> exunet.EnsembleResult:
    return exunet.ensemble(case(), 2)


def arguments(name: str) -> dict[str, Any]:
    """Arguments with which a function does what it is for, or all but that."""
    of_result = {"result": result()}
    return {
        "load": {"path": PLANAR},
        "run": {"case": case()},
        "resume": {"folder": "absent"},
        "couple": {"mbs": None, "net": None, "ports": {}},
        "add_to": {"mbs": None, "case": case(), "ports": {}},
        "export_fmu": {"case": case(), "path": "absent/one.fmu"},
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
        "save_figures": of_result | {"folder": "absent"},
    }.get(name, of_result)


FUNCTIONS = sorted(
    name for names in exunet.API.values() for name in names if inspect.isfunction(getattr(exunet, name))
)


@pytest.mark.parametrize("name", FUNCTIONS)
def test_arguments_of_a_wrong_type_are_told(name: str) -> None:
    """As AttributeError, TypeError and the like they came from somewhere within."""
    function, good = getattr(exunet, name), arguments(name)
    for argument, parameter in inspect.signature(function).parameters.items():
        if argument in FREE:
            continue
        for wrong in WRONG.values():
            if wrong in FITS.get((name, argument), ()) or (wrong is None and parameter.default is None):
                continue
            given = case() if wrong == "case" else wrong
            with pytest.raises((InputError, CaseError)) as told:
                function(**good | {argument: given})
            assert str(told.value).strip(), (argument, wrong)


METHODS = sorted(
    name
    for name, method in inspect.getmembers(exunet.Simulation, inspect.isfunction)
    if not name.startswith("_") and len(inspect.signature(method).parameters) > 1
)


@pytest.mark.parametrize("name", METHODS)
@pytest.mark.parametrize("kind", ["none", "text", "list", "case", "object"])
def test_arguments_of_a_simulations_methods_are_told(name: str, kind: str) -> None:
    """And nothing has changed then: a port that is none was steered all the same, with a KeyError."""
    sim = exunet.Simulation(start())
    given = case() if kind == "case" else WRONG[kind]
    arguments = list(inspect.signature(getattr(exunet.Simulation, name)).parameters)[1:]
    before, acting = sim.state, sim.acting
    with pytest.raises(InputError):
        getattr(sim, name)(*[given] * len(arguments))
    assert sim.acting is acting
    assert sim.time == 0.0
    assert (sim.state.position == before.position).all()


def test_a_port_that_is_none_is_not_steered() -> None:
    sim = exunet.Simulation(start())
    piece = Piece.steady(0.0, *np.zeros((2, 3)), np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3))
    for call in (lambda: sim.steer("arm", piece), lambda: sim.steered("arm")):
        with pytest.raises(InputError, match="unknown port 'arm'"):
            call()


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: exunet.deployment("run"),
         "deployment: result: needs a Result (of exunet.run or exunet.load_result), got 'run'"),
        (lambda: exunet.save(None, "one.h5"), "save: result: needs a Result (of exunet.run or"),
        (lambda: exunet.summarise(1), "got 1"),
        (lambda: exunet.compare(result(), None), "compare: needs a Result or the name of a file, got None"),
        (lambda: exunet.perturbed_positions(case(), 1, 0.0, 0),
         "perturbed_positions: start: needs a Start (of exunet.prepare), got a value of type Case"),
        (lambda: exunet.save_figures(result(), "here", ensemble=1), "ensemble: needs an EnsembleResult"),
        (lambda: exunet.run(case(), progress=1), "run: progress: needs a function, got 1"),
        (lambda: exunet.mouth_area(start().net, None), "position: needs an array (..., 40, 3)"),
        (lambda: exunet.Simulation(case(), wrenches=1), "wrenches: must be a list of names of bodies, got 1"),
        (lambda: exunet.Simulation(case(), wrenches="ab"), "must be a list of names of bodies, got 'ab'"),
        (lambda: exunet.Simulation(case(), recorder=1), "recorder: must be a Recorder or None, got 1"),
        (lambda: exunet.margins(result(), [True]), "margins: among: needs 64 True or False"),
    ],
)  # fmt: skip
def test_what_was_expected_and_what_was_given_are_told(call: Any, words: str) -> None:
    with pytest.raises(InputError) as told:
        call()
    assert words in str(told.value)


@cache
def simulation() -> exunet.Simulation:
    return exunet.Simulation(case())


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: simulation().attempt("x"), "attempt: time [s] must be a finite number, got 'x'"),
        (lambda: simulation().attempt(float("nan")), "attempt: time [s] must be a finite number, got nan"),
        (lambda: simulation().set_input(["a"], [1.0]), "set_input: unknown input ['a']"),
        (lambda: simulation().repeat_changes(1, None), "needs two arrays of `acting`, (120,), got 1"),
        (lambda: simulation().controlled_as(None), "controlled_as: must be a Simulation, got None"),
        (lambda: simulation().restore(simulation().state), "got a value of type State"),
        (lambda: simulation().steer("chaser", None), "steer: piece must be a Piece (of exunet.bodies.port)"),
        (lambda: simulation().steer("chaser", Piece(0.0, *STILL)),
         "unknown port 'chaser'"),
        (lambda: simulation().steered("chaser"), "unknown port 'chaser'"),
        (lambda: exunet.mouth_area(start().net, np.full((40, 3), "a")), "an array of (40, 3) of <U1"),
        (lambda: exunet.mesh_area(start().net, np.full((40, 3), None)), "an array of (40, 3) of object"),
        (lambda: exunet.save(result(), "x" * 300 + ".h5"), "cannot be written: File name too long"),
        (lambda: exunet.save_ensemble(several(), "x" * 300), "cannot be written: File name too long"),
        (lambda: exunet.export_fmu(case(), "x" * 300 + ".fmu"), "cannot be written: File name too long"),
    ],
)  # fmt: skip
def test_wrong_values_are_told_and_leave_a_simulation_as_it_was(call: Any, words: str) -> None:
    """A piece for no port stayed in the simulation: every snapshot failed from then on."""
    with pytest.raises(InputError) as told:
        call()
    assert words in str(told.value)
    assert "\n" not in str(told.value)
    assert simulation().snapshot().time == 0.0
