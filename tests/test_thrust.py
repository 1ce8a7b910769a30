"""The keys of effects.thrust and what they demand of the net."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from pydantic import ValidationError

from exunet.case.casefile import load
from exunet.forces.effects import thrust
from exunet.forces.requirements import RestOfCase

PLANAR = Path(__file__).parents[1] / "cases" / "planar_deployment.toml"  # four bullets
GOOD: dict[str, Any] = {"bullets": [0, 3], "time": [0.0, 0.5], "force": [[0, 0, 1], [0, 0, 2]]}


def faults(changes: dict[str, Any]) -> list[str]:
    keys = thrust.Keys.model_validate(GOOD | changes)
    return [fault.key for fault in thrust.cross_checks(keys, RestOfCase(load(PLANAR).scene))]


def test_good_keys_have_no_faults() -> None:
    assert faults({}) == []


@pytest.mark.parametrize(
    ("changes", "found"),
    [
        ({"bullets": [0, 4, 7]}, ["bullets[1]", "bullets[2]"]),
        ({"bullets": [1, 2, 1]}, ["bullets[2]"]),
        ({"time": [0.5, 0.5]}, ["time[1]"]),
        ({"time": [0.5, 0.2]}, ["time[1]"]),
        ({"time": [0.0, 0.5, 1.0]}, ["force"]),
        ({"bullets": [9], "time": [0.5, 0.1], "force": [[0, 0, 1]] * 3}, ["bullets[0]", "time[1]", "force"]),
    ],
)
def test_faults_between_keys(changes: dict[str, Any], found: list[str]) -> None:
    assert faults(changes) == found


@pytest.mark.parametrize(
    "changes",
    [
        {"bullets": []},
        {"bullets": [-1]},
        {"bullets": [0.5]},
        {"time": [0.0], "force": [[0, 0, 1]]},
        {"time": [-0.1, 0.5]},
        {"force": [[0, 0], [0, 0, 1]]},
    ],
)
def test_faults_of_single_keys(changes: dict[str, Any]) -> None:
    with pytest.raises(ValidationError):
        thrust.Keys.model_validate(GOOD | changes)
