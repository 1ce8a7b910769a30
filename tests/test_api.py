"""The public interface: its page, dir(), the examples, the table of a result, and compare."""

from __future__ import annotations

import importlib.util
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from result_samples import square_net, unfolding

import exunet
from exunet.base.errors import InputError, MissingExtra
from exunet.results import measures as metrics
from exunet.results.result import BodyStates

ROOT = Path(__file__).parent.parent
PLANAR = str(ROOT / "cases" / "planar_deployment.toml")
EXAMPLES = sorted((ROOT / "examples").glob("*.py"))


def script(path: Path) -> ModuleType:
    spec = importlib.util.spec_from_file_location(f"script_{path.stem}", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[module.__name__] = module  # where dataclasses look for their types
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("name", ["api", "keys"])
def test_generated_pages_are_up_to_date(name):
    """docs/api.md from the docstrings, docs/keys.md from the records of the case format."""
    generated = script(ROOT / "docs" / f"build_{name}.py").page()
    message = f"docs/{name}.md is not up to date: python docs/build_{name}.py"
    assert (ROOT / "docs" / f"{name}.md").read_text(encoding="utf-8") == generated, message


@pytest.mark.parametrize("of", ["name", "path", "case", "scene"])
def test_run_and_prepare_take_whatever_names_a_case(of, tmp_path):
    """A user's first line of Python is exunet.run("case.toml")."""
    path = tmp_path / "case.toml"
    path.write_text(Path(PLANAR).read_text(encoding="utf-8").replace("end = 2.0", "end = 0.001"))
    case = exunet.load(path)
    given = {"name": str(path), "path": path, "case": case, "scene": case.scene}[of]
    start = exunet.prepare(given)
    assert start.scene == case.scene
    result = exunet.run(given)
    assert result.time[-1] == 0.001
    assert np.array_equal(exunet.run(start).position, result.position)
    assert result.provenance.get("case") == (None if of == "scene" else "case.toml")


@pytest.mark.parametrize("what", ["run", "prepare"])
def test_what_names_no_case_is_told(what):
    with pytest.raises(InputError, match=f"{what}: needs the name of a file, got None"):
        getattr(exunet, what)(None)
    with pytest.raises(InputError, match=r"nowhere\.toml: no such file"):
        getattr(exunet, what)("nowhere.toml")


@pytest.mark.slow
def test_dir_lists_the_public_names_and_each_can_be_had():
    """In a process of its own: names that were imported before do not help, and nothing heavy is loaded."""
    program = """
import sys, exunet
names = dir(exunet)
assert not {"numpy", "matplotlib", "exudyn"} & set(sys.modules), "import exunet is not cheap"
assert names == sorted(exunet.__all__)
for name in names:
    assert getattr(exunet, name) is not None
assert dir(exunet) == names
try:
    exunet.no_such_name
except AttributeError as error:
    assert "no_such_name" in str(error)
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_every_public_function_and_class_is_described():
    for name in set(exunet.__all__) - {"__version__"}:
        text = getattr(exunet, name).__doc__
        assert text, name
        assert len(text) > 25, name


def test_every_example_is_tested_here():
    tested = {name.removeprefix("test_example_") for name in globals() if name.startswith("test_example_")}
    assert tested == {path.stem for path in EXAMPLES}


def test_example_push_a_bullet():
    """1 N on 0.5 kg for 0.1 s, then 0.05 s on: 1/2 a t^2 + a t s = 10 mm + 10 mm; the string is slack."""
    (path,) = [example for example in EXAMPLES if example.stem == "push_a_bullet"]
    mass = exunet.prepare(exunet.load(PLANAR).scene).net.mass[0]
    assert script(path).main() == pytest.approx(0.01 / mass, rel=1e-3)


@pytest.mark.ci
@pytest.mark.slow
def test_example_parameter_study(capsys):
    (path,) = [example for example in EXAMPLES if example.stem == "parameter_study"]
    slow, fast = script(path).main(end="0.62", speeds=(2.0, 3.0))
    assert slow.headlines["largest_area_m2"].max() < fast.headlines["largest_area_m2"].min()
    assert all(" to " in line and "16 runs" in line for line in capsys.readouterr().out.splitlines())


def test_example_compare_two_results():
    (path,) = [example for example in EXAMPLES if example.stem == "compare_two_results"]
    found = script(path).main(end="0.3")
    assert found.agrees_until is None
    assert found.time[-1] == 0.3


@pytest.mark.slow
def test_example_figures_for_a_paper(tmp_path):
    (path,) = [example for example in EXAMPLES if example.stem == "figures_for_a_paper"]
    exunet.save(unfolding(square_net(cells=2, strings=True)), tmp_path / "result.h5")
    runs = exunet.ensemble(exunet.load(PLANAR, ["time.end=0.1"]), runs=3)
    exunet.save_ensemble(runs, tmp_path / "spread.h5")
    written, again = (script(path).main(str(tmp_path), str(tmp_path / "figures")) for _ in range(2))
    assert written == again  # it was refused
    assert {item.suffix for item in written} == {".pdf", ".svg"}
    assert all(entry.stat().st_size > 5_000 for entry in written)
    svg = next(element for element in written if element.suffix == ".svg").read_text()
    assert "3 moved starts" in svg  # as text, no outlines
    assert "<dc:date>" not in svg


@pytest.mark.slow
def test_example_arm_throws_and_tows(tmp_path):
    """As one body all would go at 40 N * 8 s / 226 kg = 1.42 m/s; the tether throws the target ahead."""
    (path,) = [example for example in EXAMPLES if example.stem == "arm_throws_and_tows"]
    rows = script(path).main("8.0", str(tmp_path / "arm.png"))
    assert (tmp_path / "arm.png").stat().st_size > 5_000
    assert max(row.unbalance for row in rows) < 1e-12 * 40.0 * 8.0
    assert max(abs(row.turned) for row in rows) < np.radians(5.0)
    assert max(row.tension for row in rows) > 40.0
    assert rows[-1].target < -1.42


@pytest.mark.slow
def test_example_controller():
    (path,) = [example for example in EXAMPLES if example.stem == "controller"]
    found = script(path).main()
    assert found.restored
    assert found.reset
    assert found.forgotten > 1e-3
    assert found.at_end < 0.2 * found.farthest


@pytest.mark.slow
def test_example_reinforcement():
    pytest.importorskip("gymnasium")
    (path,) = [example for example in EXAMPLES if example.stem == "reinforcement"]
    one, other = (script(path).main("2") for _ in range(2))
    assert one == other
    assert one[0] != one[1]


@pytest.mark.slow
def test_example_two_fmus():
    """As the same chaser in Exudyn, through the throw and the swing of the arm.

    The base turns by 0.016 rad, the wheel at 3 rad/s, the target goes 0.03 m/s; both were apart by 6e-5 rad,
    0.02 rad/s and 2e-4 m/s, at steps of 4 ms.
    """
    pytest.importorskip("fmpy")
    arm, two = (
        [example for example in EXAMPLES if example.stem == name]
        for name in ("arm_throws_and_tows", "two_fmus")
    )
    known = {round(row.time, 3): row for row in script(arm[0]).main("3.0")}
    rows = script(two[0]).main("3.0")
    assert max(row.unbalance for row in rows) < 1e-12 * 40.0 * 3.0
    both = [(row, known[round(row.time, 3)]) for row in rows if round(row.time, 3) in known]
    assert len(both) == 150
    for name, off in (("turned", 2e-4), ("wheel", 0.06), ("target", 6e-4)):
        assert max(abs(getattr(one, name) - getattr(other, name)) for one, other in both) < off, name


def test_compare_takes_results_and_files(tmp_path):
    one = unfolding(square_net(cells=2))
    other = replace(one, position=one.position + 0.25)
    exunet.save(other, tmp_path / "other.h5")
    for found in (exunet.compare(one, other), exunet.compare(one, tmp_path / "other.h5")):
        np.testing.assert_allclose(found.position_difference, 0.25 * 3**0.5, rtol=1e-12)
        assert found.speed_difference.max() == 0.0
        assert found.agrees_until == 0.0
    with pytest.raises(InputError, match="not the same net"):
        exunet.compare(one, unfolding(square_net(cells=3)))
    with pytest.raises(InputError, match="cannot be read"):
        exunet.compare(tmp_path / "none.h5", one)


def test_a_table_needs_pandas(monkeypatch):
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(MissingExtra, match=r"pip install 'exunet\[pandas\]'"):
        unfolding(square_net()).to_frame()


def test_a_table_has_the_results_numbers():
    pytest.importorskip("pandas")
    of = unfolding(square_net(cells=2, strings=True), lift=0.3)
    turning, still = np.linspace(0.0, 1.0, 21).reshape(7, 3), np.zeros((7, 3))
    rigid = BodyStates(2.0, np.eye(3), still, still, np.tile([1.0, 0.0, 0.0, 0.0], (7, 1)), turning)
    of = replace(of, bodies={"target": rigid, "chaser": BodyStates(5.0, None, turning, still)})
    table = of.to_frame()
    assert table.index.name == "time [s]"
    np.testing.assert_array_equal(table.index, of.time)
    bullets = [f"speed of node {node} [m/s]" for node in of.net.bullet_nodes]
    known = {
        "kinetic energy [J]": of.kinetic,
        "elastic energy [J]": of.elastic,
        "mouth area [m2]": metrics.mouth_area(of.net, of.position),
        "largest tension [N]": of.tension.max(axis=1),
        "momentum z [kg m/s]": of.momentum[:, 2],
        "target angular velocity y [rad/s]": turning[:, 1],
        "chaser position x [m]": turning[:, 0],
        **dict(zip(bullets, metrics.bullet_speeds(of).T, strict=True)),
    }
    for name, values in known.items():
        np.testing.assert_allclose(table[name], values, rtol=1e-14)
    assert "chaser angular velocity x [rad/s]" not in table
    assert all(name.endswith("]") for name in table)
