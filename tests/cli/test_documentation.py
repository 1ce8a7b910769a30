"""What the README, the pages and the examples show, done; generated pages and links."""

from __future__ import annotations

import importlib.util
import os
import re
import shlex
import subprocess
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from commands import CASES, PLANAR
from result_samples import square_net, unfolding
from scenes import SHIPPED_CASES

import exunet
import reference_impl as reference

ROOT = CASES.parent
README = ROOT / "README.md"
BUILT = {"_build", "gallery"}  # by docs/build_site.py, which has tests of its own
PAGES = sorted(page for page in (ROOT / "docs").rglob("*.md") if BUILT.isdisjoint(page.parts))


def script(path: str) -> ModuleType:
    """Import a script of the project."""
    spec = importlib.util.spec_from_file_location(f"script_{Path(path).stem}", ROOT / path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[module.__name__] = module  # where dataclasses look for their types
    spec.loader.exec_module(module)
    return module


def example(name: str) -> ModuleType:
    return script(f"examples/{name}.py")


def blocks(page: Path, language: str) -> list[str]:
    text = page.read_text(encoding="utf-8")
    return re.findall(rf"^```{language}\n(.*?)^```", text, flags=re.MULTILINE | re.DOTALL)


# Pages


@pytest.mark.parametrize("name", ["api", "keys", "commands"])
def test_generated_pages_are_up_to_date(name):
    """From the docstrings, the records of the case format, and the help of the commands."""
    builder = script(f"docs/build_{name}.py")
    written = {page.name: page.read_text(encoding="utf-8") for page in builder.FOLDER.iterdir()}
    assert written == builder.pages(), f"not up to date: python docs/build_{name}.py"


@pytest.mark.parametrize("page", [README, *PAGES], ids=lambda page: str(page.relative_to(ROOT)))
def test_pictures_and_links_exist(page):
    for target in re.findall(r"\]\((?!http)([^)#]+)", page.read_text(encoding="utf-8")):
        assert (page.parent / target).exists(), target


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_pages_and_cells_of_tables_are_short(page):
    """At most 400 lines, but of notebooks, and 200 characters in a cell."""
    text = page.read_text(encoding="utf-8")
    assert len(text.splitlines()) <= 400 or "{code-cell}" in text
    text = re.sub(r"^```.*?^```|\]\(.*?\)", "", text, flags=re.DOTALL | re.MULTILINE)
    rows = [line for line in text.splitlines() if line.startswith("|")]
    cells = (cell.strip() for row in rows for cell in re.split(r"(?<!\\)\|", row))
    assert not [cell for cell in cells if len(cell) > 200]


def test_names_in_a_text_that_exunet_does_not_have_are_errors():
    """Their table, group or command is the page of the others, by the case format and `exunet.API`."""
    pytest.importorskip("sphinx")
    from checked_names import Unknown, target

    known = {
        "[effects.contact]": ("reference/keys/contact", "effectscontact"),
        "bodies.sat.parts[2].radius": ("reference/keys/bodies", "bodiesnamepartsname"),
        "--set time.end=3": ("reference/keys/run", "time"),
        "exunet.save_view(result)": ("reference/python/figures", "exunetsave_view"),
        "exunet run CASE --check -o DIR": ("reference/commands/run", ""),
        "result.time": None,
    }
    assert {text: target(text) for text in known} == known
    for text in ("[effects.contacts]", "bodies.sat.sizes", "time.end.x", "exunet.saves", "exunet run --chek"):
        with pytest.raises(Unknown):
            target(text)


@pytest.fixture
def shown(tmp_path, monkeypatch, capsys):
    """What the Python blocks of a page print, run in their order in a folder that has the cases."""

    def run(page: str) -> str:
        (tmp_path / "cases").symlink_to(CASES)
        monkeypatch.chdir(tmp_path)
        names: dict[str, Any] = {}
        for code in blocks(ROOT / page, "python"):
            exec(compile(code, page, "exec"), names)
        return capsys.readouterr().out

    return run


@pytest.mark.ci
@pytest.mark.slow
def test_python_examples_of_the_readme_run(shown, tmp_path):
    assert "2.261" in shown("README.md")  # m/s at 1 s, damped: reference_impl/README.md
    assert (tmp_path / "deployment.h5").exists()
    assert len(list((tmp_path / "figures").glob("*.pdf"))) == 7


def test_python_examples_of_the_step_api_run(shown):
    printed = shown("docs/how_to/simulation.md")
    balance = re.search(r"energy balance: (\S+) J", printed)
    assert balance is not None
    assert abs(float(balance[1])) < 1e-10  # round-off: no cable is taut yet


def test_python_examples_of_checkpoints_run(shown):
    assert shown("docs/how_to/resume.md") == "ok 201\n"


def test_python_examples_of_scenes_run(shown):
    """169 knots, 4 bullets with strings of one element, and 6 nodes of a tether that ends at the net."""
    printed = shown("docs/how_to/scenes.md").splitlines()
    assert printed[0].startswith("Scene(title='Capture of a tumbling box'")
    assert printed[1] == "scene.toml 6 179"


@pytest.mark.slow
def test_python_examples_of_corner_units_run(shown):
    """Braked towards their mean, which rests, by exp(-0.5 t / m) of 0.512 kg, 2.5 m/s to 2.265 m/s."""
    part = (1.0 - 0.02 * 0.5 / 0.5123512) ** 5  # the mass to seven digits
    speed = float(shown("docs/how_to/control.md").split()[0].strip("["))
    assert speed == pytest.approx(2.5 * part, abs=1e-7)


@pytest.mark.slow
def test_python_examples_of_environments_run(shown):
    pytest.importorskip("gymnasium")
    assert shown("docs/how_to/environment.md").startswith("2.0 s, return -")


@pytest.mark.ci
@pytest.mark.slow
def test_outputs_of_a_tutorial_follow_its_case(tmp_path, monkeypatch):
    """Its first cells write and describe a case: 30 g more on each of 4 bullets are 0.12 kg."""
    read = pytest.importorskip("myst_nb.core.read").read_myst_markdown_notebook
    nbclient = pytest.importorskip("nbclient")
    monkeypatch.setenv("PATH", str(Path(sys.executable).parent), prepend=os.pathsep)
    text = (ROOT / "docs" / "tutorials" / "first_throw.md").read_text(encoding="utf-8")
    assert "```text" not in text  # outputs are of cells
    masses = []
    for bullet in ("mass = 0.05", "mass = 0.08"):
        notebook = read(text.replace("mass = 0.05", bullet))
        codes = [cell for cell in notebook.cells if cell.cell_type == "code"]
        notebook.cells = codes[:2]
        client = nbclient.NotebookClient(notebook, resources={"metadata": {"path": tmp_path}})
        outputs = client.execute().cells[1].outputs
        printed = "".join(output.text for output in outputs if output.name == "stdout")
        masses.append(float(re.search(r"^mass +(\S+) kg", printed, flags=re.MULTILINE)[1]))
    assert masses[1] - masses[0] == pytest.approx(0.12, abs=2e-6)


WALL_TIME = re.compile(r"\bin [0-9.e-]+ (s|min) \(")
SHOWN = re.compile(r"^```(sh|text)\n(.*?)^```", flags=re.MULTILINE | re.DOTALL)


def words(text: str) -> str:
    """Return a text without wall times, as words, since lines are folded to the width of the terminal."""
    return " ".join(WALL_TIME.sub("", text).split())


def printed(command: str, folder: Path) -> str:
    """Return the words that a command prints in a folder."""
    line = [sys.executable, "-m", "exunet", *shlex.split(command)[1:]]
    done = subprocess.run(line, cwd=folder, capture_output=True, text=True, check=False)
    return words(done.stdout + done.stderr)


@pytest.mark.ci
@pytest.mark.slow
def test_what_the_readme_shows_is_printed(tmp_path: Path) -> None:
    """Each row of a block after a command is in its output, wall times apart."""
    (tmp_path / "cases").symlink_to(CASES)
    output, compared = "", 0
    for kind, text in SHOWN.findall(README.read_text(encoding="utf-8")):
        if kind == "sh":
            commands = [line for line in text.splitlines() if line.startswith("exunet ")]
            output = " ".join(printed(command, tmp_path) for command in commands)
            continue
        for row in re.split(r"\n(?! {10})", text.rstrip()):
            assert words(row) in output
            compared += 1
    assert compared >= 8


def test_the_page_on_verification_lists_the_cases_that_the_reference_does_not_know():
    refused: dict[str, set[str]] = {}
    for path in SHIPPED_CASES:
        try:
            reference.read(path, {})
        except reference.Refused as error:
            if "effects.choose" not in str(error):  # exunet chooses, and gives the reference its choice
                refused.setdefault(path.parent.name, set()).add(path.stem)
    missions = {path.stem for path in (CASES / "missions").glob("*.toml")}
    known = missions - refused.pop("missions")
    page = (ROOT / "docs" / "explanation" / "verification.md").read_text("utf-8")
    (sentence,) = (part for part in page.split(". ") if "`cases/missions/`" in part and "`satellite`" in part)
    named = set(re.findall(r"`(\w+)`", sentence))
    assert named - known == set().union(*refused.values())
    assert known <= named
    assert set(re.findall(r"`cases/(\w+)/`", sentence)) == {*refused, "missions"}


# Examples


def test_example_push_a_bullet():
    """1 N on 0.5 kg for 0.1 s, then 0.05 s on: 1/2 a t^2 + a t s = 10 mm + 10 mm; the string is slack."""
    mass = exunet.prepare(exunet.load(PLANAR).scene).net.mass[0]
    assert example("push_a_bullet").main() == pytest.approx(0.01 / mass, rel=1e-3)


def test_example_own_force():
    """A force inside the system keeps momentum to round-off; what it stores and takes out is balanced."""
    compiled, exudyn = (example("own_force").main(backend) for backend in ("compiled", "exudyn"))
    for result in (compiled, exudyn):
        momentum = 80.0 * result.bodies["chaser"].velocity[:] + result.net.mass @ result.velocity[:]  # 80 kg
        assert np.abs(momentum - momentum[0]).max() < 1e-12
        assert np.diff(result.dissipated).min() > 0.0
        assert exunet.energy_balance(result) < 1e-9  # solver.accuracy = 1e-6
    assert np.abs(compiled.position[:] - exudyn.position[:]).max() < 1e-9


@pytest.mark.slow
def test_example_parameter_study(capsys):
    slow, fast = example("parameter_study").main(end="0.62", speeds=(2.0, 3.0))
    assert slow.metrics["largest_area_m2"].max() < fast.metrics["largest_area_m2"].min()
    assert len(capsys.readouterr().out.splitlines()) == 2


def test_example_compare_two_results():
    comparison = example("compare_two_results").main(end="0.3")
    assert comparison.agrees_until is None
    assert comparison.time[-1] == 0.3


@pytest.mark.slow
def test_example_figures_for_a_paper(tmp_path):
    exunet.save(unfolding(square_net(cells=2, strings=True)), tmp_path / "result.h5")
    runs = exunet.ensemble(exunet.load(PLANAR, ["time.end=0.1"]), runs=3)
    exunet.save_ensemble(runs, tmp_path / "ensemble.h5")
    main = example("figures_for_a_paper").main
    written, again = (main(str(tmp_path), str(tmp_path / "figures")) for _ in range(2))
    assert written == again  # it was refused
    assert {item.suffix for item in written} == {".pdf", ".svg"}
    assert all(item.stat().st_size > 5_000 for item in written)
    svg = next(item for item in written if item.suffix == ".svg").read_text()
    assert "<text" in svg  # not outlines
    assert "<dc:date>" not in svg


@pytest.mark.slow
def test_example_arm_throws_and_tows(tmp_path):
    """As one body all would go at 40 N * 8 s / 226 kg = 1.42 m/s; the tether throws the target ahead."""
    rows = example("arm_throws_and_tows").main("8.0", str(tmp_path / "arm.png"))
    assert (tmp_path / "arm.png").stat().st_size > 5_000
    assert max(row.unbalance for row in rows) < 1e-12 * 40.0 * 8.0
    assert max(abs(row.turned) for row in rows) < np.radians(5.0)
    assert max(row.tension for row in rows) > 40.0
    assert rows[-1].target < -1.42


@pytest.mark.slow
def test_example_controller():
    result = example("controller").main()
    assert result.restored
    assert result.reset
    assert result.forgotten > 1e-3
    assert result.at_end < 0.2 * result.farthest


@pytest.mark.slow
def test_example_reinforcement():
    pytest.importorskip("gymnasium")
    first, again = (example("reinforcement").main("2") for _ in range(2))
    assert first == again
    assert first[0] != first[1]


@pytest.mark.slow
def test_example_two_fmus():
    """As the same chaser in Exudyn, through the throw and the swing of the arm.

    The base turns by 0.016 rad, the wheel at 3 rad/s, the target goes 0.03 m/s; both differ by 6e-5 rad,
    0.02 rad/s and 2e-4 m/s, at steps of 4 ms.
    """
    pytest.importorskip("fmpy")
    known = {round(row.time, 3): row for row in example("arm_throws_and_tows").main("3.0")}
    rows = example("two_fmus").main("3.0")
    assert max(row.unbalance for row in rows) < 1e-12 * 40.0 * 3.0
    both = [(row, known[round(row.time, 3)]) for row in rows if round(row.time, 3) in known]
    assert len(both) == 150
    for name, off in (("turned", 2e-4), ("wheel", 0.06), ("target", 6e-4)):
        assert max(abs(getattr(row, name) - getattr(other, name)) for row, other in both) < off, name
