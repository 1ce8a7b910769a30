"""What contact with a body whose shape is a mesh has of its own; `test_contact_momentum` has its books."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from contact_scenes import taken_by_contact, thrown
from test_contact_momentum import END

import exunet

pytestmark = pytest.mark.slow  # a kernel, compiled in a minute


@pytest.mark.slow
def test_a_mesh_of_a_box_moves_as_the_box(tmp_path: Path) -> None:
    """What the box got of momentum, with finer grids; of 0.033 m/s and 0.47 rad/s."""
    known = thrown(tmp_path, "solid", "solver.step=2e-5")
    known.advance_to(END)
    errors = []
    for spacing in (0.01, 0.0025):
        sim = thrown(tmp_path, "mesh", "solver.step=2e-5", f"bodies.box.grid_spacing={spacing}")
        sim.advance_to(END)
        mine, theirs = sim.state.bodies, known.state.bodies
        errors.append(
            [
                float(np.abs(mine.velocity - theirs.velocity).max()),
                float(np.abs(mine.angular_velocity - theirs.angular_velocity).max()),
                abs(sum(taken_by_contact(sim)) / sum(taken_by_contact(known)) - 1.0),
            ]
        )
    assert (np.array(errors[1]) < 0.5 * np.array(errors[0])).all()
    assert errors[1][0] < 2e-6
    assert errors[1][1] < 2e-5
    assert errors[1][2] < 1e-4


@pytest.mark.slow
def test_a_start_inside_is_refused(tmp_path: Path) -> None:
    with pytest.raises(exunet.CaseError, match=r"scene.toml:\d+: .*deeper than .* in box"):
        thrown(tmp_path, "mesh", "bodies.box.position=[0.25, 0.2, 0.0]")
