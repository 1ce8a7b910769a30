"""What is wrong with a script is told before the run, with file and line; what can never happen too."""

from __future__ import annotations

import re

import pytest
from test_script import SCENE, case_of, entry

from exunet.base.errors import CaseError
from exunet.case.timeline import timeline
from exunet.interfaces.commands.check import describe

BEGIN = SCENE.count("\n") + 1  # the line of the first [[script]]
LOCK = {"do": "lock", "on": "tow"}


def test_faults_name_their_line() -> None:
    """One of each kind; an entry begins with [[script]] and its name, then the keys as they are given."""
    broken = {
        ("at", "at"): ({"at": -1.0, **LOCK}, 2, "must be a number not less than 0, got -1.0"),
        ("when", "word"): (
            {"when": "rage < 3", **LOCK},
            2,
            "unknown condition 'rage < 3'; known are first_con",
        ),
        ("when", "code"): ({"when": "__import__('os')", **LOCK}, 2, "unknown condition"),
        ("when", "bound"): ({"when": "range", **LOCK}, 2, "range needs < or > and a number"),
        ("when", "none"): (
            {"when": "first_contact > 1", **LOCK},
            2,
            "first_contact is compared with nothing",
        ),
        ("when", "touch"): ({"when": "first_contact", **LOCK}, 2, "first_contact needs [effects.contact]"),
        ("when", "mouth"): ({"when": "area > 1", **LOCK}, 2, "area needs a net with a mouth"),
        ("when", "line"): ({"when": "closing_tension > 1", **LOCK}, 2, 'needs [closing] of kind = "line"'),
        ("after", "whom"): ({"after": "nobody", **LOCK}, 2, "there is no entry 'nobody' (entries: at, word,"),
        ("unless", "self"): ({"at": 1.0, "unless": "self", **LOCK}, 3, "names the entry itself"),
        ("delay", "early"): ({"at": 0.5, "delay": 1.0, **LOCK}, 3, "is a time after another entry"),
        ("after", "both"): ({"at": 0.5, "after": "whom", **LOCK}, 3, "give either at or after"),
        ("", "untold"): (LOCK, 0, "needs a trigger: at, after, or when"),
        ("do", "deed"): ({"at": 0.5, "do": "lok", "on": "tow"}, 3, "did you mean 'lock'?"),
        ("on", "thing"): ({"at": 0.5, "do": "lock", "on": "closing"}, 4, "'closing' has no reel or winch"),
        ("do", "close"): ({"at": 0.5, "do": "close", "force": 1.0}, 3, "'closing' has no reel or winch"),
        ("rate", "rate"): ({"at": 0.5, **LOCK, "rate": 1.0}, 5, 'do = "lock" has none'),
        ("", "rateless"): ({"at": 0.5, "do": "pay_out", "on": "tow"}, 0, 'do = "pay_out" needs rate'),
        ("", "mute"): ({"at": 0.5, "do": "stop"}, 0, 'do = "stop" needs verdict'),
        ("do", "eject"): ({"at": 0.5, "do": "eject"}, 3, "no body holds the net: [initial.frame] names one"),
        ("do", "push"): ({"at": 0.5, "do": "thrust"}, 3, "needs [effects.thrust]"),
        ("on", "set"): ({"at": 0.5, "do": "set", "on": "tow", "value": 2.0}, 4, "'tow' is no parameter"),
        ("on", "turn"): (
            {"at": 0.5, "do": "set", "on": "thrust.factor", "value": 2.0},
            4,
            "thrust.factor needs [effects.thrust]",
        ),
        ("", "unset"): ({"at": 0.6, "do": "set", "value": 1.0}, 0, "needs on: the name of a parameter"),
        ("on", "cut"): ({"at": 0.5, "do": "cut", "on": "tow"}, 4, "'tow' is no tether without a reel"),
        ("on", "stop"): ({"at": 0.5, "do": "stop", "verdict": "x", "on": "tow"}, 5, "acts on nothing"),
        ("repeat", "again"): ({"at": 0.5, **LOCK, "repeat": True}, 5, "needs when with a comparison"),
        ("fall", "fall"): ({"at": 0.5, **LOCK, "fall": 0.1}, 5, 'is for when = "largest_area"'),
    }
    script, expected, line = "", [], BEGIN
    for (key, name), (keys, down, words) in broken.items():
        text = entry(name, **keys)
        expected.append((line + (down and down), key, words))
        script += text
        line += text.count("\n")
    with pytest.raises(CaseError) as error:
        case_of(script)
    told = str(error.value).splitlines()
    for k, (at, key, words) in enumerate(expected):
        place = f"script.toml:{at}: script[{k}]" + (f".{key}: " if key else ": ")
        assert any(place in one and words in one for one in told), (place, words)
    assert len(told) == len(expected)


def test_entries_that_wait_for_each_other_or_contradict_each_other() -> None:
    script = (
        entry("one", after="three", **LOCK)
        + entry("two", after="one", **LOCK)
        + entry("three", after="two", **LOCK)
        + entry("in", at=0.5, do="reel", on="tow", rate=1.0)
        + entry("out", at=0.5, do="pay_out", on="tow", rate=1.0)
        + entry("in", at=0.6, **LOCK)
    )
    with pytest.raises(CaseError) as error:
        case_of(script)
    told = re.sub(r"\S*script\.toml:", "", str(error.value)).splitlines()
    assert told == [
        f"{BEGIN + 12}: script[2].after: waits for itself: one after three after two after one",
        f"{BEGIN + 24}: script[4].do: contradicts in, which acts on tow at the same time: give another "
        "time, or leave one out",
        f"{BEGIN + 28}: script[5].name: entry 3 has this name already",
    ]


def test_a_drive_with_commands_of_its_own_is_left_alone() -> None:
    commands = 'tethers.tow.reel.commands=[{at=0.2, mode="lock"}]'
    with pytest.raises(CaseError, match=r"script\[0\]\.on: 'tow' has commands of its own: remove these"):
        case_of(entry("hold", at=0.5, **LOCK), commands)
    with pytest.raises(CaseError, match=r"script\[0\]\.force: needs the damping of the drive"):
        case_of(entry("hold", at=0.5, do="brake", on="tow", force=1.0), "tethers.tow.reel.damping=")


def test_the_timeline_says_what_can_never_happen() -> None:
    script = (
        entry("near", when="range < 2", **LOCK)
        + entry("late", at=0.4, when="time > 0.7", do="reel", on="tow", rate=0.1)
        + entry("then", after="late", delay=0.2, do="brake", on="tow", force=1.0)
        + entry("beyond", after="then", delay=0.2, **LOCK)
        + entry("after_that", after="beyond", when="range < 1", **LOCK)
        + entry("early", at=0.3, when="time < 0.2", **LOCK)
        + entry("otherwise", at=0.8, unless="late", **LOCK)
        + entry("end", at=0.95, do="stop", verdict="over")
        + entry("missed", at=0.96, **LOCK)
    )
    case = case_of(script)
    found = {
        one.entry.name: (one.when, one.never) for one in timeline(case.scene.script, case.scene.time.end)
    }
    assert found == {
        "near": ("from t = 0 s on", ""),
        "late": ("t = 0.7 s", ""),
        "then": ("t = 0.9 s", ""),
        "end": ("t = 0.95 s", ""),
        "beyond": ("never", "t = 1.1 s is after the end, 1 s"),
        "after_that": ("never", "beyond, for which it waits, never happens"),
        "early": ("never", "time is never below 0.2 s from then on"),
        "otherwise": ("never", "late comes before"),
        "missed": ("never", "end ends the run at t = 0.95 s"),
    }
    told = [words for name, words in describe(case) if name == "script"]
    assert told[:2] == [
        "from t = 0 s on: near: lock tow (range < 2)",
        "t = 0.7 s: late: reel tow at 0.1 m/s",
    ]
    assert "never: missed: lock tow (end ends the run at t = 0.95 s)" in told
