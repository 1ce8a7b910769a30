"""A snapshot of a case that names files: what is in them counts, not how or from where they are named."""

from __future__ import annotations

import shutil
from pathlib import Path

import h5py
import numpy as np
import pytest

import exunet
from exunet.base.errors import InputError
from exunet.results.run_folder import RESULT_FILE
from exunet.scene.casefile import parse_case
from exunet.simulation.run import run_into

CABLE = """
format = 1
title = "a cable"
time = { end = 0.1, output_step = 0.05 }
initial.packing = 1.0
[net]
topology = "explicit"
nodes = [[-0.5, 5.0, 0.0], [0.5, 5.0, 0.0]]
elements = [[0, 1]]
node_masses = [0.5, 0.5]
cable = { area = 1e-4, density = 10.0, youngs_modulus = 1e5 }
"""
BALL = """
[bodies.ball]
shape = "mesh"
file = "ball.stl"
unit = "m"
mass = 1.0
inertia = [0.1, 0.1, 0.1]
centre_of_mass = [0.0, 0.0, 0.0]
angular_velocity = [0.1, 1.0, 0.2]
"""


def ball(folder: Path, radius: float) -> None:
    """ball.stl, 80 triangles; mass and inertia of the body are given: the radius changes the shape alone."""
    trimesh = pytest.importorskip("trimesh")
    trimesh.creation.icosphere(subdivisions=1, radius=radius).export(folder / "ball.stl")


@pytest.fixture
def one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with a case and its mesh, which is the working directory; beside it a copy, `other`."""
    one = tmp_path / "one"
    one.mkdir()
    ball(one, 0.3)
    (one / "case.toml").write_text(CABLE + BALL)
    shutil.copytree(one, tmp_path / "other")
    monkeypatch.chdir(one)
    return one


def test_a_mesh_may_be_named_otherwise_and_stand_elsewhere(one: Path) -> None:
    here = exunet.Simulation("case.toml")
    here.advance(0.01)
    here.snapshot().save("here.exu")
    here.advance(0.01)
    for name, overrides in (
        (one / "case.toml", []),
        ("../other/case.toml", []),
        ("case.toml", ["bodies.ball.file='../other/ball.stl'"]),
    ):
        again = exunet.Simulation(name, overrides)
        again.restore(exunet.Snapshot.load("here.exu"))
        again.advance(0.01)
        assert np.array_equal(again.bodies["ball"].attitude, here.bodies["ball"].attitude)


def test_another_mesh_under_the_same_name_is_refused(one: Path) -> None:
    here = exunet.Simulation("case.toml").snapshot()
    ball(one, 0.4)
    words = r"of a case whose files \(bodies\.\*\.file, initial\.restart\) have another content: run the case"
    with pytest.raises(InputError, match=words):
        exunet.Simulation("case.toml").restore(here)


def test_the_result_that_a_case_starts_from(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Under any name the same; the same state out of another file is another content."""
    folder = tmp_path / "first"
    folder.mkdir()
    run_into(folder, parse_case(CABLE, tmp_path / "first.toml"))
    monkeypatch.chdir(folder)

    def simulation(path: Path, named: str) -> exunet.Simulation:
        overrides = ["initial.packing=", f"initial.restart={named!r}"]
        return exunet.Simulation(parse_case(CABLE, path, overrides))

    here = simulation(Path("../second.toml"), "first").snapshot()
    simulation(tmp_path / "second.toml", "first/result.h5@0.1").restore(here)
    shutil.copytree(folder, tmp_path / "moved")
    simulation(tmp_path / "moved" / "second.toml", "result.h5@end").restore(here)
    with h5py.File(folder / RESULT_FILE, "r+") as file:
        file.attrs["remark"] = "changed"
    with pytest.raises(InputError, match=r"files .* have another content"):
        simulation(tmp_path / "second.toml", "first").restore(here)
