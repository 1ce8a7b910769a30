"""What is wrong with [control] is told before the run, with file and line."""

from __future__ import annotations

from pathlib import Path

import pytest

import exunet
from exunet.base.errors import CaseError
from exunet.scene.casefile import parse_case
from exunet.simulation.preparation import prepare_case

PLANAR = Path(__file__).parents[1] / "cases" / "planar_undamped.toml"  # four bullets, to 2 s
TEXT = PLANAR.read_text(encoding="utf-8")
LINE = TEXT.count("\n") + 2  # of the first key of the table
GOOD = {
    "bullets": "[0, 2]",
    "kind": '"point"',
    "period": "0.1",
    "largest_thrust": "2.0",
    "point": "[0.0, 0.0, 1.0]",
    "stiffness": "1.0",
    "damping": "1.0",
}
TABLE = {"kind": '"table"', "point": "", "stiffness": "", "damping": ""}
PUSHES = "[[[0.0, 0.0, 1.0], [0.0, 0.0, 1.0]], [[0.0, 0.0, 1.0], [0.0, 0.0, 1.0]]]"
FORMATION = {"kind": '"formation"', "point": "", "offsets": "[[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0]]"}
NEEDS_ALL = "the function from Python, as Simulation(case, controller=function)"


def text_of(**changes: str) -> str:
    keys = {name: value for name, value in (GOOD | changes).items() if value}
    return TEXT + "[control]\n" + "".join(f"{name} = {value}\n" for name, value in keys.items())


def faults_of(text: str) -> str:
    with pytest.raises(CaseError) as caught:
        parse_case(text, Path("case.toml"))
    return str(caught.value)


def test_a_good_case_has_none() -> None:
    for changes in ({}, FORMATION):
        assert parse_case(text_of(**changes), Path("case.toml")).scene.control is not None


@pytest.mark.parametrize(
    ("changes", "key", "down"),
    [
        ({"bullets": "[0, 7]"}, "bullets[1]", 0),
        ({"bullets": "[2, 2]"}, "bullets[1]", 0),
        ({"kind": '"orbit"'}, "kind", 1),
        ({"kind": '"mine.laws.steer"'}, "kind", 1),
        ({"kind": '"mine:steer"'}, "kind", 1),
        ({"period": "0.0"}, "period", 2),
        ({"period": "1e-7"}, "period", 2),
        ({"largest_thrust": "-1.0"}, "largest_thrust", 3),
        ({"minimum_impulse": "0.3"}, "minimum_impulse", 7),
        ({"start": "2.0"}, "start", 7),
        (FORMATION | {"body": '"target"'}, "body", 7),
        ({"body": '"target"'}, "body", 7),
        ({"offset": "[0.0, 0.0, 1.0]"}, "offset", 7),
        ({"point": ""}, "", -1),
        ({"stiffness": ""}, "stiffness", -1),
        ({"time": "[0.0, 1.0]"}, "time", 7),
        ({"bullets": "[0]", "direction": '"outward"'}, "direction", 7),
        ({"noise": "{ position = 0.1, velocity = 0.1 }"}, "noise.seed", 7),
        ({"function": '"mine.steer"'}, "function", 7),
        (TABLE | {"time": "[1.0, 0.5]", "force": PUSHES}, "time[1]", 4),
        (TABLE | {"time": "[0.0, 0.5]", "force": "[[[0,0,1.0],[0,0,1.0]],[[0,0,1.0]]]"}, "force[1]", 5),
        (TABLE | {"time": "[0.0, 0.5, 1.0]", "force": PUSHES}, "force", 5),
        (FORMATION | {"offsets": "[[1.0, 0.0, 0.0]]"}, "offsets", 6),
        (FORMATION | {"offsets": "[[1.0, 0.0, 0.0], [-0.5, 0.0, 0.0]]"}, "offsets", 6),
        ({"kind": '"given"', "stiffness": "", "damping": ""}, "point", 4),
    ],
)  # fmt: skip
def test_faults_name_their_line(changes: dict[str, str], key: str, down: int) -> None:
    """`down` : lines below the first key of the table; -1 is its header."""
    told = faults_of(text_of(**changes))
    place = f"case.toml:{LINE + down}: control{'.' if key else ''}{key}"
    assert any(line.startswith(f"{place}: ") for line in told.splitlines()), told


def test_a_net_without_bullets() -> None:
    table = 'control={bullets=[0],kind="given",period=0.1,largest_thrust=1.0}'
    with pytest.raises(CaseError, match=r"control: commands bullets, and the net has none"):
        exunet.load(PLANAR.parent / "verification" / "square_net.toml", [table])


def test_an_implicit_method() -> None:
    """It does not integrate what the units spend."""
    text = text_of().replace('method = "DOPRI5"', 'method = "GeneralizedAlpha"\nstep = 1e-4')
    case = parse_case(text.replace("accuracy =", "# accuracy ="), Path("case.toml"))
    with pytest.raises(CaseError, match=r"GeneralizedAlpha does not support .*use an explicit method"):
        prepare_case(case)


def test_entries_of_a_script() -> None:
    """Without units there is nothing to control; a start beside an entry that begins it is one too many."""
    entry = '\n[[script]]\nname = "on"\nat = 0.5\ndo = "control"\n'
    at = TEXT.count("\n") + 5
    assert f"case.toml:{at}: script[0].do: needs [control]" in faults_of(TEXT + entry)
    told = faults_of(text_of(start="0.1") + entry)
    assert f"case.toml:{LINE + 7}: control.start: an entry of the script begins the control" in told
