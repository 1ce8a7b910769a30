"""What `exunet check` says that the engine would hold is what it holds."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.sparse import csr_array

import exunet
from exunet.coupling import native_items
from exunet.integrators.exudyn.build import build, expected_items
from exunet.simulation.preparation import prepare

CASES = Path(__file__).parents[1] / "cases"
SOME = [
    "planar_deployment",
    "effects/launch_force",
    "effects/parabolic_flight",
    "effects/molecular_drag",
    "verification/hanging",
]
BODY = "bodies.target={mass=7.0, inertia=[2.0, 3.0, 4.0]}"


@pytest.mark.parametrize("overrides", [[], [BODY]])
@pytest.mark.parametrize("name", SOME)
def test_the_expected_items_are_those_that_are_built(name, overrides):
    start = prepare(exunet.load(CASES / f"{name}.toml", overrides).scene)
    model = build(start.system, start.state, start.plan)
    assert expected_items(start.system) == model.items()


def test_matrices_couple_attached_nodes_where_their_own_columns_do() -> None:
    """Of three free nodes the middle one is attached: columns 3 to 5 of a matrix count, and no other."""
    found = []
    for column in range(9):
        matrix = np.zeros((9, 9))
        matrix[0, column] = -1.0
        linear = SimpleNamespace(damping=csr_array(matrix), gyroscopic=None, stiffness=None)
        found.append(native_items._couples_attached(with_one_attached(linear)))
    assert found == [False] * 3 + [True] * 3 + [False] * 3
    assert not native_items._couples_attached(with_one_attached(None))


def with_one_attached(linear: Any) -> Any:
    """What is asked of a system whose matrices are those of `linear`, or which has none."""
    forces, attached = SimpleNamespace(linear=linear), SimpleNamespace(point=np.array([1]))
    return SimpleNamespace(free=np.zeros(3, dtype=bool), forces=forces, kinematics=attached)
