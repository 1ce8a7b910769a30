"""What `exunet check` says that the engine would hold is what it holds."""

from pathlib import Path

import pytest

import exunet
from exunet.backends.exudyn.build import build, expected_items
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
    for fused in (True, False):
        model = build(start.system, start.state, start.plan, fused=fused)
        assert expected_items(start.system, fused=fused) == model.items()
