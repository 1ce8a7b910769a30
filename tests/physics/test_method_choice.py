"""The choice of "auto" changes gradually with the numbers of a case."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from scenes import CASES

import exunet
from exunet.base.errors import CaseError
from exunet.methods.method import METHODS, Method
from exunet.model.limits import largest_damping_rate, largest_frequency, stable_step
from exunet.simulation.preparation import Start, prepare_case

SCENES = (
    "planar_undamped",
    "planar_deployment_006",
    "missions/throw_10m",
    "missions/throw_close_tow",
    "missions/cut_tether",
    "capture/free_sphere",
    "capture/l_shape",
    "bodies/tow",
    "nets/star",
    "effects/material_damping",
)
NUMBERS = 10  # of each scene
ALLOWED = {1.01: 1.3, 0.99: 1.3, 2.0: 3.0, 0.5: 3.0}  # change of the cost by the factor of a number
OWN = {"format", "end", "output_step", "seed", "eject_at"}  # not of the physics


def numbers(table: dict[str, Any], where: str = "") -> Iterator[tuple[str, float]]:
    """Yield the keys of floats in a case, with their values."""
    for key, value in table.items():
        if isinstance(value, dict):
            yield from numbers(value, f"{where}{key}.")
        elif isinstance(value, float) and value and key not in OWN:
            yield f"{where}{key}", value


def prepared(name: str, *changes: str) -> Start:
    table = tomllib.loads((CASES / f"{name}.toml").read_text(encoding="utf-8"))
    without = [f"{key}=" for key in ("solver",) if key in table]
    return prepare_case(exunet.load(CASES / f"{name}.toml", [*without, *changes]))


def parts(start: Start) -> float:
    """Force evaluations of a run over those of velocity Verlet at its stable step."""
    rates, plan = (largest_frequency(start.system), largest_damping_rate(start.system)), start.plan
    assert plan.step is not None
    evaluations = METHODS[plan.method].compiled_stages / plan.step
    return float(stable_step(Method.VELOCITY_VERLET, *rates)) * evaluations


@pytest.mark.ci_for("planar_undamped")
@pytest.mark.slow
@pytest.mark.parametrize("name", SCENES)
def test_the_cost_does_not_jump(name: str) -> None:
    table = tomllib.loads((CASES / f"{name}.toml").read_text(encoding="utf-8"))
    table.pop("solver", None)
    known, found = list(numbers(table)), 0
    own = parts(prepared(name))
    random = np.random.default_rng([37, SCENES.index(name)])
    for k in random.permutation(len(known))[:NUMBERS]:
        key, value = known[k]
        for factor, most in ALLOWED.items():
            try:
                cost = parts(prepared(name, f"{key}={factor * value!r}"))
            except CaseError:  # a size that is not a multiple of the mesh
                continue
            assert 1.0 / most <= cost / own <= most, (key, factor)
            found += 1
    assert found >= 3 * min(NUMBERS, len(known))  # others are sizes that are not multiples of the mesh


def test_a_tighter_accuracy_costs_more_and_little_more() -> None:
    """Right-hand sides of the paper's net to 1 s: a decade of accuracy takes 1.0 to 2.5 times as many."""
    counts = [
        exunet.run(
            exunet.load(
                CASES / "planar_undamped.toml",
                [f"solver={{accuracy={accuracy}}}", "time.end=1.0", "engine.backend=compiled"],
            )
        ).run.cost.right_hand_sides
        for accuracy in (1e-1, 1e-2, 1e-3, 1e-4)
    ]
    ratios = np.array(counts[1:]) / counts[:-1]
    assert ((ratios >= 1.0) & (ratios < 2.5)).all()
