"""summary.json against its table in docs/results.md: every key is there, with the unit that its name says."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from result_samples import square_net, unfolding
from scenes import pair_of_masses, thrown
from typer.testing import CliRunner

import exunet
from exunet.cli.main import app
from exunet.results.headlines import ANY, OF_A_NAME, ONES
from exunet.results.summary import summarise
from exunet.results.table import rows

ROOT = Path(__file__).parent.parent
CASES = ROOT / "cases"
SECTION = (
    (ROOT / "docs" / "results.md").read_text(encoding="utf-8").split("## summary.json")[1].split("\n## ")[0]
)
TABLE = [
    key for row in re.findall(r"^\| (`.*?) \| ", SECTION, re.MULTILINE) for key in re.findall("`(.*?)`", row)
]
GROUPS = (
    "attachments",
    "bodies",
    "capture.conditions",
    "capture.hold_at_end",
    "capture.moved_starts",
    "constant",
    "headlines",
    "largest_tensions",
    "margins",
    "method.items",
    "versions",
)
# Followed by names of the user's or of the engine's choice.
NAMED = ("check.bodies.", *(f"{group}." for group in GROUPS))
UNITS = ("_rad", "_s", "_m", "_m2", "_m_s", "_kg", "_N", "_J")
WITHOUT = {  # numbers that have no unit
    "nodes", "node", "elements", "element", "bullet", "times", "balance_error", "relative_area",
    "energy_excess", "tolerance", "steps", "rejected_steps",
    "right_hand_sides", "newton_iterations", "accuracy", "at_end", "nodes_at_end", "largest", "nodes_largest",
    "best",
    "sensitivity", "value", "in_both", "only_here", "only_in_reference", "runs", "finer_runs", "seed",
}  # fmt: skip

PARTS_INDICES_AND_COUNTS = {"capture_enclosed", "capture_cqi", "capture_mcqi", "elements_broken"}


def test_every_headline_has_a_row_of_its_own_and_no_row_is_of_none() -> None:
    """In metrics.md a row names the part x of a vector, and then `_y_`, `_z_`."""
    page = (ROOT / "docs" / "metrics.md").read_text(encoding="utf-8")
    section = page.split("## List of metrics")[1].split("\n## ")[0]
    listed = []
    for row in re.findall(r"^\| (`.*?) \| ", section, re.MULTILINE):
        for key in re.findall("`(.*?)`", row):
            any_one = re.sub("NAME|EFFECT|ONE.OTHER", ANY, key)
            parts = "xyz" if "`_y_`, `_z_`" in row and "_x_" in key else "x"
            listed += [any_one.replace("_x_", f"_{part}_") for part in parts if key not in ("_y_", "_z_")]
    known = [item.key for item in ONES] + [entry.key for made in OF_A_NAME for entry in made(ANY)]
    where = "the tables of docs/metrics.md"
    assert not (lacking := set(known) - set(listed)), f"{where} lack rows of {sorted(lacking)}"
    assert not (unknown := set(listed) - set(known)), f"{where} have rows of unknown {sorted(unknown)}"
    assert len(listed) == len(set(listed)), f"{where} name a headline twice"


def keys(value: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """Paths of all leaves, with names replaced by * and items of lists by []."""
    if isinstance(value, dict) and (value or path.rstrip(".") in ("", *GROUPS)):
        for name, part in value.items():
            yield from keys(part, f"{path}{'*' if path in NAMED else name}.")
    elif isinstance(value, list):
        for part in value:
            yield from keys(part, f"{path.rstrip('.')}[].")
    else:
        yield path.rstrip("."), value


@pytest.fixture(scope="module")
def summaries(tmp_path_factory) -> list[dict[str, Any]]:
    """Of runs that between them have everything a summary can have."""
    folder = tmp_path_factory.mktemp("runs")
    short = ["--set", "time.end=0.03", "--set", "engine.backend=compiled"]
    body = ["--set", "bodies.target={mass=7.0, inertia=[2, 3, 4], velocity=[1, 0, 0]}"]
    held = ["--set", 'bodies.wall={mass=7.0, inertia=[2, 3, 4], motion="fixed"}']
    ball = '{shape="sphere", radius=0.1, mass=7.0'  # two of them, one flies into the other
    through = ["--set", f"bodies={{a={ball}}}, b={ball}, position=[0.3, 0, 0], velocity=[-10, 0, 0]}}}}"]
    rule = ["--set", 'capture={target="a", duration=0.0, enclosed=0.1, relative_speed=1.0}']
    tether = (
        'diameter=1e-3, density=1e3, youngs_modulus=1e9, length=9.0, start={bullet=0}, end={body="target"}'
    )
    script = ["--set", f"tethers={{t={{{tether}}}}}", "--set"]
    cut, note = '{name="cut", when="time > 0.01", do="cut", on="t"}', '{name="note", after="cut", delay=1.0, '
    again = '{name="again", when="time > 0.005", repeat=true, do="note"}'
    forbidden, end = '{name="no", at=0.015, unless="cut", do="note"}', '{name="end", at=0.02, do="stop", '
    script.append(f'script=[{again}, {cut}, {note}do="note"}}, {forbidden}, {end}verdict="over"}}]')
    pull = "time=[0, 1], force=[[[0, 0, 1]], [[0, 0, 1]]]"
    unit = f'bullets=[0], kind="table", {pull}, period=0.01, largest_thrust=1, specific_impulse=60'
    control = ["--set", f"control={{{unit}}}"]
    commands = (
        [str(CASES / "planar_deployment.toml"), *short, *control],
        [str(CASES / "planar_deployment.toml"), "--check", "--estimate-error", *short],
        [str(CASES / "planar_deployment.toml"), "--check", *short, *body],
        [str(CASES / "effects" / "breaking.toml"), "--check"],
        [str(CASES / "planar_deployment.toml"), *short, *held],
        [str(CASES / "planar_deployment.toml"), *short, *through, *rule],
        [str(CASES / "bodies" / "snap.toml"), *short],
        [str(CASES / "bodies" / "frame.toml"), *short],
        [str(CASES / "planar_deployment.toml"), *short, *body, *script],
    )
    found = []
    for k, command in enumerate(commands):
        out = folder / str(k)
        many = ["--spread", "8"] if k else ["--spread", "0"]
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(
                "exunet.model.script.MAX_ACTIVATIONS", 1
            )  # so that an entry that repeats is used up
            done = CliRunner().invoke(app, ["run", *command, *many, "--out", str(out)])
        assert done.exception is None, done.output
        found.append(json.loads((out / "summary.json").read_text(encoding="utf-8")))
    found.append(summarise(exunet.load_result(folder / "0" / "result.h5"), "why there is no check"))
    # 0.9 of the stable step loses energy at each snap: the run is retried.
    retried = exunet.run(thrown({"method": "RK44", "step": 2.3e-4}, end=0.7))
    found.append(summarise(retried, None, "interrupted"))
    return found


@pytest.mark.slow
def test_every_key_is_in_the_table_and_every_row_in_a_file(summaries):
    seen = {path for summary in summaries for path, _ in keys(summary)}
    assert sorted(seen - set(TABLE)) == []
    # A group stands in the table for what is null in its place.
    assert sorted(set(TABLE) - seen) == []
    assert len(TABLE) == len(set(TABLE))


@pytest.mark.slow
def test_names_have_the_units_of_their_numbers(summaries):
    for summary in summaries:
        for name in summary["headlines"]:
            without = "margin" in name or name.endswith("_times") or name in PARTS_INDICES_AND_COUNTS
            assert name.endswith(UNITS) != without, name
        for path, value in keys(summary | {"headlines": {}}):
            name = path.split(".")[-1].removesuffix("[]")
            if isinstance(value, float | int) and not isinstance(value, bool) and name != "*":
                assert name.endswith(UNITS) != (name in WITHOUT), path


@pytest.mark.ci
@pytest.mark.slow
def test_nothing_is_said_twice():
    """Of a run with snaps and a common flight, in which no two quantities happen to be equal."""
    thrown_net = thrown({}, end=0.4, launch={"radial_speed": 5.0, "axial_speed": 2.0})
    damped = thrown_net.model_copy(
        update={"effects": exunet.load(CASES / "planar_deployment.toml").scene.effects}
    )
    values = [value for _, value in keys(summarise(exunet.run(damped))) if isinstance(value, float)]
    told = [value for value in values if len(repr(value)) > 10]
    assert len(told) > 8
    assert len(told) == len(set(told)), sorted(told)


def test_a_result_that_tells_no_peak_has_that_of_its_stored_times():
    of = unfolding(square_net(cells=2, strings=True), times=5)
    of.tension[3, 2] = 17.0
    found = summarise(of)
    assert found["largest_tension"] == {"element": 2, "of": "stored times"}
    assert found["headlines"]["largest_tension_N"]["this_run"] == 17.0
    assert found["headlines"]["time_of_largest_tension_s"]["this_run"] == 0.75
    slack = exunet.run(pair_of_masses(engine={"backend": "compiled"}, time={"end": 0.1, "output_step": 0.1}))
    found = summarise(slack)
    assert found["largest_tension"] == {"element": None, "of": "all steps"}
    assert "time_of_largest_tension_s" not in found["headlines"]
    assert ("largest tension", "0 N: no element was ever taut") in rows(found)


def test_the_table_names_the_area_that_80_percent_is_of():
    keys = {"method": "DOPRI5", "tolerance": 1e-6}
    summary = summarise(exunet.run(thrown(keys, end=0.05, engine={"backend": "compiled"})))
    table = dict(rows(summary))
    assert table["largest area"].endswith("(25.0% of the achievable 4.000 m2)")
    assert table["area above 80 %"].endswith("(3.200 m2)")
    assert np.isclose(summary["deployment"]["achievable_area_m2"], 4.0, rtol=1e-14)
