"""Every method of the engine: declared orders and costs, on a smooth case, through the whole program."""

from __future__ import annotations

import numpy as np
import pytest

from exunet.methods.method import METHODS
from exunet.results.result import Result
from exunet.scene.scene import Scene
from exunet.simulation.preparation import prepare
from exunet.simulation.run import simulate

STEPS = {"ExplicitEuler": (100, 200), "RK67": (6, 12), "RK44": (10, 20), "RK33": (20, 40)}
FIXED = [name for name, method in METHODS.items() if method.kind != "adaptive"]


def taut(solver: dict[str, object], end: float = 0.5) -> Result:
    """Two masses on a soft cable that stays taut, spinning and stretching: smooth to all orders."""
    scene = Scene.model_validate(
        {
            "format": 1,
            "title": "a taut, spinning pair of masses",
            "time": {"end": end, "output_step": end},
            "solver": solver,
            "net": {
                "topology": "explicit",
                "nodes": [[-0.5, 0.0, 0.0], [0.5, 0.0, 0.0]],
                "elements": [[0, 1]],
                "node_masses": [0.5, 0.5],
                "cable": {"area": 1e-4, "density": 10.0, "youngs_modulus": 1e5},
            },
            "initial": {
                "packing": 1.0,
                "node_positions": [[-0.6, 0.0, 0.0], [0.6, 0.0, 0.0]],
                "node_velocities": [[0.0, -2.0, 0.1], [0.0, 2.0, 0.0]],
            },
        }
    )
    return simulate(prepare(scene))


@pytest.fixture(scope="module")
def exact() -> np.ndarray:
    run = taut({"tolerance": 1e-12})
    assert run.strain.min() > 0.0  # never slack, so never a kink
    return run.position[-1]


@pytest.mark.parametrize("method", FIXED)
def test_observed_order_is_the_declared_one(method, exact):
    coarse, fine = STEPS.get(method, (100, 200))
    errors = [
        np.abs(taut({"method": method, "step": 0.5 / n}).position[-1] - exact).max() for n in (coarse, fine)
    ]
    assert np.log2(errors[0] / errors[1]) == pytest.approx(METHODS[method].order, abs=0.35)


@pytest.mark.parametrize("method", FIXED)
def test_counts_of_fixed_steps(method):
    run = taut({"method": method, "step": 0.002}, end=0.1)
    assert run.provenance["steps"] == 50
    assert run.provenance["rejected_steps"] == 0
    if METHODS[method].kind == "explicit":
        assert run.provenance["right_hand_sides"] == 50 * METHODS[method].stages
    else:
        assert run.provenance["newton_iterations"] >= 50


@pytest.mark.parametrize("method", ["DOPRI5", "ODE23"])
def test_adaptive_error_follows_the_tolerance(method, exact):
    errors = [
        np.abs(taut({"method": method, "tolerance": tol}).position[-1] - exact).max() for tol in (1e-6, 1e-9)
    ]
    assert errors[1] < 0.02 * errors[0]
    assert errors[1] < 1e-6


@pytest.mark.parametrize("method", list(METHODS))
def test_every_method_keeps_momentum(method):
    solver = {"method": method} | ({} if METHODS[method].kind == "adaptive" else {"step": 1e-3})
    run = taut(solver)
    assert np.abs(run.momentum - run.momentum[0]).max() < 1e-12


def test_output_times_are_hit_exactly_by_every_kind():
    times = (0.1, 0.123456789, 0.3, 0.5)
    scene = prepare(
        Scene.model_validate(
            {"format": 1, "title": "t",
             "time": {"end": 0.5, "output_times": list(times)},
             "net": {"topology": "explicit", "nodes": [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]],
                     "elements": [[0, 1]], "cable": {"area": 1e-4, "density": 10.0, "youngs_modulus": 1e5}},
             "initial": {"packing": 0.5, "velocity": [1.0, 2.0, 3.0]}}
        ).model_copy()
    )  # fmt: skip
    run = simulate(scene)
    assert run.time.tolist() == [0.0, *times]
    moved = run.position - run.position[0]
    assert moved[:, 0] == pytest.approx(np.outer(run.time, [1.0, 2.0, 3.0]), abs=1e-13)  # free flight
