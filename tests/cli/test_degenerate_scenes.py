"""Scenes with an empty set somewhere run to their end: no element, no free node, no motion of its own."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from commands import command

import exunet
from exunet.results.io import load_result

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
    """The command ends well, and no number of its result is NaN."""
    changes = ("time.end=0.2", "time.output_step=0.1", f"engine.backend={backend}", *changes)
    sets = [word for change in changes for word in ("--set", change)]
    ended = command("run", SCENES / name, *sets, "--checkpoint-every", 0.1, "--out", "out", folder=tmp_path)
    assert ended.returncode == 0, ended.stderr
    result = load_result(tmp_path / "out")
    assert np.isfinite(result.position).all()
    assert np.isfinite(result.kinetic + result.potential).all()


@pytest.mark.slow
def test_a_long_fall_is_not_taken_for_a_divergence(tmp_path: Path) -> None:
    """The balance of free fall is off by round-off of the kinetic energy, 1e-10 of it after 4e6 steps."""
    case = exunet.load(SCENES / "long_fall.toml", ["time.end=36.0", "solver.method=VelocityVerlet"])
    result = exunet.run(case)
    assert result.time[-1] == 36.0
