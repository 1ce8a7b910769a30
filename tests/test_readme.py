"""What the README and the documentation show, done."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest

import exunet
import reference_impl as reference

ROOT = Path(__file__).parent.parent
README = ROOT / "README.md"
PAGES = sorted((ROOT / "docs").glob("*.md"))


def blocks(page: Path, language: str) -> list[str]:
    text = page.read_text(encoding="utf-8")
    return re.findall(rf"^```{language}\n(.*?)^```", text, flags=re.MULTILINE | re.DOTALL)


def done(page: Path, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The Python blocks of a page in their order, in a folder that has the cases."""
    (folder / "cases").symlink_to(ROOT / "cases")
    monkeypatch.chdir(folder)
    names: dict[str, Any] = {}
    for code in blocks(page, "python"):
        exec(compile(code, page.name, "exec"), names)


@pytest.mark.ci
@pytest.mark.slow
def test_python_examples_of_the_readme_run(tmp_path, monkeypatch, capsys):
    done(README, tmp_path, monkeypatch)
    shown = capsys.readouterr().out
    assert "2.261" in shown  # m/s at 1 s, damped: reference_impl/README.md
    assert (tmp_path / "deployment.h5").exists()
    assert len(list((tmp_path / "figures").glob("*.pdf"))) == 7


def test_python_examples_of_the_step_api_run(tmp_path, monkeypatch, capsys):
    done(ROOT / "docs" / "simulation.md", tmp_path, monkeypatch)
    shown = capsys.readouterr().out
    balance = re.search(r"energy balance: (\S+) J", shown)
    assert balance is not None
    assert abs(float(balance[1])) < 1e-10  # round-off: no cable is taut yet
    assert shown.endswith("ok 201\n")


@pytest.mark.slow
def test_python_examples_of_corner_units_run(tmp_path, monkeypatch, capsys):
    """Braked towards their mean, which rests, by exp(-0.5 t / m) of 0.512 kg, 2.5 m/s to 2.265 m/s."""
    done(ROOT / "docs" / "control.md", tmp_path, monkeypatch)
    part = (1.0 - 0.02 * 0.5 / 0.5123512) ** 5  # the mass to seven digits
    shown = float(capsys.readouterr().out.split()[0].strip("["))
    assert shown == pytest.approx(2.5 * part, abs=1e-7)


@pytest.mark.slow
def test_python_examples_of_environments_run(tmp_path, monkeypatch, capsys):
    pytest.importorskip("gymnasium")
    done(ROOT / "docs" / "environment.md", tmp_path, monkeypatch)
    assert capsys.readouterr().out.startswith("2.0 s, return -")


def test_the_cases_of_the_tutorial_are_valid(tmp_path):
    """Its first block is a case, with its second block a capture."""
    net, capture = blocks(ROOT / "docs" / "tutorial.md", "toml")
    (tmp_path / "net.toml").write_text(net)
    (tmp_path / "capture.toml").write_text(net + capture)
    assert exunet.load(tmp_path / "net.toml").scene.capture is None
    assert exunet.load(tmp_path / "capture.toml", ["time.end=2.5"]).scene.capture.target == "box"


def test_the_readme_is_short():
    assert len(README.read_text(encoding="utf-8").splitlines()) <= 100


@pytest.mark.parametrize("page", [README, *PAGES], ids=lambda page: page.name)
def test_pictures_and_links_exist(page):
    for target in re.findall(r"\]\((?!http)([^)#]+)\)", page.read_text(encoding="utf-8")):
        assert (page.parent / target).exists(), target


def test_the_index_lists_every_page():
    index = (ROOT / "docs" / "README.md").read_text(encoding="utf-8")
    for page in PAGES:
        assert page.name == "README.md" or f"({page.name})" in index, page.name


def test_first_blocks_are_the_newcomers_commands():
    first, second, *_ = blocks(README, "sh")
    assert "exunet run cases/planar_deployment.toml --check" in first
    assert "pytest" in second


def test_the_page_on_verification_lists_the_cases_that_the_reference_does_not_know():
    refused: dict[str, set[str]] = {}
    for path in (ROOT / "cases").rglob("*.toml"):
        try:
            reference.read(path, {})
        except reference.Refused as error:
            if "effects.choose" not in str(error):  # exunet chooses, and tells the reference what
                refused.setdefault(path.parent.name, set()).add(path.stem)
    words = re.search(
        r"works on every shipped case but(.*?)\. The reference",
        (ROOT / "docs" / "verification.md").read_text("utf-8"),
    )
    assert words is not None
    missions = {path.stem for path in (ROOT / "cases" / "missions").glob("*.toml")}
    assert missions - refused.pop("missions") == {"closed_box", "throw_10m"}
    assert "those of `cases/missions/` but `closed_box` and `throw_10m`" in words[1]
    told = set(re.findall(r"`(\w+)`", words[1])) - {"closed_box", "throw_10m"}
    assert told == set().union(*refused.values())
    assert set(re.findall(r"`cases/(\w+)/`", words[1])) == {*refused, "missions"}
