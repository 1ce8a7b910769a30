"""What is wrong with a script is told before the run, with file and line; what can never happen too."""

from __future__ import annotations

import re

import pytest
from test_script import SCENE, case_of, entry

from exunet.base.errors import CaseError
from exunet.case.foresight import Surroundings
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
        ("when", "never"): (
            {"when": "range < -3", **LOCK},
            2,
            "range is never below 0, so 'range < -3'",
        ),
        ("when", "none_less"): ({"when": "tether_tension < 0", **LOCK}, 2, "tether_tension is never below 0"),
        ("when", "always"): ({"when": "range > -1", **LOCK}, 2, "is always true: leave it out"),
        ("when", "infinite"): ({"when": "range < 1e999", **LOCK}, 2, "1e999 is beyond the largest number"),
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
        ("rest", "rest"): ({"when": "range < 2", **LOCK, "rest": 0.1}, 5, "of an entry with repeat = true"),
        ("repeat", "again"): ({"at": 0.5, **LOCK, "repeat": True}, 5, "needs when with a comparison"),
        ("fall", "fall"): ({"at": 0.5, **LOCK, "fall": 0.1}, 5, 'is for when = "largest_area"'),
        ("verdict", "no_words"): ({"at": 0.5, "do": "stop", "verdict": ""}, 4, "a string that is not empty"),
        ("name", "two words"): ({"at": 0.5, **LOCK}, 1, "a name has letters, digits, _ and - only"),
    }
    script, expected, line = "", [], BEGIN
    for (key, name), (keys, down, words) in broken.items():
        text = entry(name, **keys)
        expected.append((line + down, key, words))
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
        f"{BEGIN + 18}: script[3].do: contradicts out, which acts on tow at the same time: give another "
        "time, or leave one out",
        f"{BEGIN + 24}: script[4].do: contradicts in, which acts on tow at the same time: give another "
        "time, or leave one out",
        f"{BEGIN + 28}: script[5].name: entry 3 has this name already",
    ]


TOGETHER = {
    "one condition": ({"when": "range < 2"}, {"when": "range < 2.0"}, ""),
    "a time and a chain": ({"at": 0.25}, {"after": "x", "delay": 0.125}, entry("x", at=0.125, do="note")),
    "two chains": (
        {"after": "y", "delay": 0.1},
        {"after": "z", "delay": 0.2},
        entry("x", when="range < 2", do="note")
        + entry("y", after="x", delay=0.2, do="note")
        + entry("z", after="x", delay=0.1, do="note"),
    ),
    "after it at once": ({"when": "range < 2"}, {"after": "one"}, ""),
    "time as a condition": ({"when": "time > 0.3"}, {"at": 0.3}, ""),
    "round-off": ({"at": 0.3}, {"after": "x", "delay": 0.2}, entry("x", at=0.1, do="note")),
    "barred by one": (
        {"at": 0.3, "unless": "x"},
        {"at": 0.3, "unless": "x"},
        entry("x", when="range < 2", do="note"),
    ),
}


@pytest.mark.parametrize("name", TOGETHER)
def test_two_entries_that_contradict_each_other_at_one_time(name: str) -> None:
    """Both are told, each at its line."""
    one, other, before = TOGETHER[name]
    script = before + entry("one", **one, do="lock", on="tow")
    begin = BEGIN + script.count("\n")
    with pytest.raises(CaseError) as error:
        case_of(script + entry("other", **other, do="reel", on="tow", rate=0.1))
    told = str(error.value).splitlines()
    lines = [int(re.findall(r"script\.toml:(\d+)", one)[0]) for one in told]
    assert lines == [begin - 2, begin + 1 + len(other) + 1]
    assert "contradicts other, which acts on tow at the same time" in told[0]
    assert "contradicts one, which acts on tow at the same time" in told[1]


def test_one_run_has_one_end() -> None:
    stops = entry("won", at=0.3, do="stop", verdict="won") + entry("lost", at=0.3, do="stop", verdict="lost")
    with pytest.raises(CaseError, match="contradicts won, which acts on the run at the same time"):
        case_of(stops)


def test_what_does_not_contradict() -> None:
    """The same thing asked twice; other times; conditions that are looked at from other times on."""
    case_of(
        entry("close", at=0.3, do="lock", on="tow")
        + entry("again", at=0.3, do="lock", on="tow")
        + entry("later", at=0.31, do="reel", on="tow", rate=0.1)
        + entry("near", when="range < 2", do="brake", on="tow", force=1.0)
        + entry("nearer", at=0.2, when="range < 2", do="reel", on="tow", rate=0.1)
    )


def test_the_timeline_says_what_may_be_in_vain() -> None:
    """Two at one time of which one may be barred; two that switch to and fro; what was released before."""
    case = case_of(
        entry("near", when="range < 2", do="note")
        + entry("lock", at=0.3, do="lock", on="tow")
        + entry("reel", at=0.3, unless="near", do="reel", on="tow", rate=0.1)
        + entry("slack", when="tether_tension < 0.1", repeat=True, do="reel", on="tow", rate=0.2)
        + entry("taut", when="tether_tension > 0.1", repeat=True, do="brake", on="tow", force=0.05)
        + entry("free", at=0.5, do="release", on="tethers.tow.end")
        + entry("more", at=0.6, do="release", on="tethers.tow.end")
        + entry("pull", after="free", delay=0.2, do="reel", on="tow", rate=0.3)
    )
    notes = {one.entry.name: "; ".join(one.notes) for one in timeline(case.scene.script, Surroundings(1.0))}
    assert notes == {
        "near": "",
        "lock": "",
        "reel": "acts on tow at the same time as lock if both happen: then this one counts",
        "slack": "",
        "taut": "slack and taut switch tow to and fro, once in each rest, where tether_tension is near its "
        "bound: leave a band between their bounds",
        "free": "",
        "more": "in vain: free has released it before",
        "pull": "in vain: free has released the end of tow before",
    }
    assert any(words.endswith("; in vain: free has released it before") for _, words in describe(case))


def test_never_goes_on_to_what_waits() -> None:
    """Whatever the reason: an entry that forbids it, or the end of the run."""
    script = (
        entry("a", at=0.1, do="note")
        + entry("b", at=0.2, unless="a", do="note")
        + entry("c", after="b", do="note")
        + entry("d", after="c", delay=0.1, when="range < 1", do="note")
        + entry("e", when="range < 2", do="note")
        + entry("f", after="e", delay=0.1, unless="e", do="note")
        + entry("g", at=0.3, unless="b", do="note")
        + entry("h", at=0.4, unless="g", do="note")
        + entry("end", at=0.5, do="stop", verdict="over")
        + entry("lock", at=0.5, **LOCK)
        + entry("on", after="lock", do="note")
    )
    found = {
        one.entry.name: (one.when, one.never)
        for one in timeline(case_of(script).scene.script, Surroundings(1.0))
    }
    assert found == {
        "a": ("t = 0.1 s", ""),
        "b": ("never", "a comes before"),
        "c": ("never", "b, for which it waits, never happens"),
        "d": ("never", "c, for which it waits, never happens"),
        "e": ("from t = 0 s on", ""),
        "f": ("never", "waits for e, after which it happens no more"),
        "g": ("t = 0.3 s", ""),
        "h": ("never", "g comes before"),
        "end": ("t = 0.5 s", ""),
        "lock": ("never", "end ends the run at t = 0.5 s"),
        "on": ("never", "lock, for which it waits, never happens"),
    }


def test_a_chain_may_be_long() -> None:
    """1500 entries, each after the one before it, from the last to the first; two at its end are at odds."""
    chain = [entry("e0", at=0.0, do="note")]
    chain += [entry(f"e{k}", after=f"e{k - 1}", when="range < 2", do="note") for k in range(1, 1500)]
    ends = entry("lock", after="e1499", **LOCK) + entry("reel", after="e1499", do="reel", on="tow", rate=0.1)
    with pytest.raises(CaseError, match="contradicts lock, which acts on tow at the same time"):
        case_of("".join(reversed(chain)) + ends)
    case = case_of("".join(reversed(chain)))
    assert {one.never for one in timeline(case.scene.script, Surroundings(1.0))} == {""}


def test_a_drive_turns_no_faster_than_it_can() -> None:
    limit = "tethers.tow.reel.largest_rate=0.5"
    with pytest.raises(CaseError, match=r"script\[0\]\.rate: is above 0\.5 m/s, the largest_rate of 'tow'"):
        case_of(entry("fast", at=0.5, do="reel", on="tow", rate=100.0), limit)
    with pytest.raises(CaseError, match=r"not above 0\.5 m/s, the largest_rate of the drive, got 0\.6"):
        case_of(entry("fast", at=0.5, do="set", on="tow.rate", value=0.6), limit)


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
        one.entry.name: (one.when, one.never)
        for one in timeline(case.scene.script, Surroundings(case.scene.time.end))
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


NUMBERS = {  # deeds of one drive at one time
    "force": ({"do": "brake", "on": "tow", "force": 1.0}, {"do": "set", "on": "tow.force", "value": 2.0}),
    "rate": ({"do": "set", "on": "tow.rate", "value": 0.2}, {"do": "reel", "on": "tow", "rate": 0.1}),
    "none": (LOCK, {"do": "set", "on": "tow.rate", "value": 0.1}),
}


@pytest.mark.parametrize("name", NUMBERS)
def test_a_command_and_a_number_of_it_at_one_time(name: str) -> None:
    """Of which the later one in the file would count; not if both say the same, or other numbers."""
    one, other = NUMBERS[name]
    with pytest.raises(CaseError) as error:
        case_of(entry("one", at=0.1, **one) + entry("other", at=0.1, **other))
    told = str(error.value).splitlines()
    assert len(told) == 2
    assert all(
        f"script[{k}].do: contradicts {name}, which acts on tow" in told[k]
        for k, name in ((0, "other"), (1, "one"))
    )
    case_of(
        entry("one", at=0.1, do="reel", on="tow", rate=0.1)
        + entry("same", at=0.1, do="set", on="tow.rate", value=0.1)
        + entry("force", at=0.2, do="set", on="tow.force", value=0.1)
        + entry("rate", at=0.2, do="set", on="tow.rate", value=0.2)
    )


def test_a_contradiction_of_what_certainly_happens() -> None:
    """The one happens unless x comes, which only comes later; not if the other one is barred for certain."""
    both = entry("a", at=0.1, unless="x", **LOCK) + entry("b", at=0.1, do="reel", on="tow", rate=0.5)
    with pytest.raises(CaseError) as error:
        case_of(entry("x", at=0.5, do="note") + both)
    assert re.findall(r"script\[(\d)\]\.do: contradicts (\w)", str(error.value)) == [("1", "b"), ("2", "a")]
    case_of(entry("x", at=0.05, do="note") + both)
