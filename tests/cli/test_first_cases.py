"""`exunet cases`, names of shipped cases, and `exunet new`."""

from __future__ import annotations

from pathlib import Path

import pytest
from scenes import CASES

import exunet
from exunet.base.cases import first_lines
from exunet.base.cases import found as found_case
from exunet.base.errors import InputError
from exunet.cli.new import new_case
from exunet.results.observables import Observables
from exunet.results.outcome import Outcome, outcome
from exunet.scene.casefile import implausible
from exunet.simulation.preparation import prepare_case


def scaled(folder: Path, size: float) -> Path:
    """The satellite of a shipped case with this largest extent [m], off the origin by half of it."""
    import trimesh

    mesh = trimesh.load(CASES / "missions" / "sat.stl")
    mesh.apply_scale(size / mesh.extents.max())
    mesh.apply_translation([0.5 * size, 0.0, 0.0])
    mesh.export(folder / "target.stl")
    return folder / "target.stl"


def test_every_shipped_case_is_listed_and_found_by_its_name(tmp_path: Path) -> None:
    names = dict(first_lines())
    assert len(names) == len(list(CASES.rglob("*.toml")))
    assert all(names.values())
    assert found_case(Path("capture/box")) == CASES / "capture" / "box.toml"
    assert found_case(tmp_path / "box.toml") == tmp_path / "box.toml"


@pytest.mark.parametrize("size", [0.1, 1.0, 10.0])
def test_a_capture_fits_its_target(size: float, tmp_path: Path) -> None:
    """Valid and without warnings; in front of the target and wider than it, at any size."""
    case = exunet.load(new_case("capture", scaled(tmp_path, size), "m", tmp_path / "c.toml", overwrite=False))
    assert implausible(case) == []
    start = prepare_case(case).position
    assert 2.0 * size < case.scene.net.size < 4.0 * size
    assert start[:, 2].max() < case.scene.bodies["target"].position[2] - 0.2 * size


@pytest.mark.slow
@pytest.mark.ci_for("1.0")
@pytest.mark.parametrize("size", [0.1, 1.0, 10.0])
def test_a_capture_runs_to_its_end_and_captures_nothing(size: float, tmp_path: Path) -> None:
    case = exunet.load(new_case("capture", scaled(tmp_path, size), "m", tmp_path / "c.toml", overwrite=False))
    result = exunet.run(case)
    assert result.time[-1] == case.scene.time.end
    found = outcome(Observables(result))
    assert found is not None
    assert found.outcome != Outcome.CAPTURED


def test_a_deployment_opens(tmp_path: Path) -> None:
    case = exunet.load(new_case("deployment", None, "m", tmp_path / "d.toml", overwrite=False))
    assert implausible(case) == []
    result = exunet.run(case)
    assert exunet.mouth_area(result.net, result.position).max() > 0.9 * 25.0


@pytest.mark.parametrize(
    ("kind", "target", "unit"),
    [("capturing", None, "m"), ("deployment", "t.stl", "m"), ("capture", "t.stl", "m")],
)
def test_wrong_arguments(kind: str, target: str | None, unit: str, tmp_path: Path) -> None:
    with pytest.raises(InputError):
        new_case(kind, None if target is None else tmp_path / target, unit, tmp_path / "x", overwrite=False)
    (tmp_path / "x").touch()
    with pytest.raises(InputError):
        new_case("capture", None, unit, tmp_path / "x", overwrite=False)
