"""Errors of scripts, each with file and line before the run; the timeline; what a setting changes."""

from __future__ import annotations

import re

import numpy as np
import pytest
from scripts import FALL, HANGS, LIFTS, SCENE, SLIDES, case_of, entry, happened

import exunet
from exunet.base.errors import CaseError
from exunet.forces.cable_term import INTACT
from exunet.forces.effects.thrust import STATE_NAME as THRUST
from exunet.model.script import changed
from exunet.net.drive import WITHOUT_LIMIT
from exunet.scene.script import timeline
from exunet.simulation.preparation import prepare_case

BEGIN = SCENE.count("\n") + 1  # the line of the first [[script]]
LOCK = {"do": "lock", "on": "tow"}
ERRORS = {  # name of an entry: its keys, the line of the error below [[script]], the key ("" for the entry)
    "at": ({"at": -1.0, **LOCK}, 2, "at"),
    "word": ({"when": "rage < 3", **LOCK}, 2, "when"),
    "code": ({"when": "__import__('os')", **LOCK}, 2, "when"),
    "bound": ({"when": "range", **LOCK}, 2, "when"),
    "none": ({"when": "first_contact > 1", **LOCK}, 2, "when"),
    "touch": ({"when": "first_contact", **LOCK}, 2, "when"),
    "mouth": ({"when": "area > 1", **LOCK}, 2, "when"),
    "line": ({"when": "closing_tension > 1", **LOCK}, 2, "when"),
    "never": ({"when": "range < -3", **LOCK}, 2, "when"),
    "none_less": ({"when": "tether_tension < 0", **LOCK}, 2, "when"),
    "always": ({"when": "range > -1", **LOCK}, 2, "when"),
    "infinite": ({"when": "range < 1e999", **LOCK}, 2, "when"),
    "whom": ({"after": "nobody", **LOCK}, 2, "after"),
    "self": ({"at": 1.0, "unless": "self", **LOCK}, 3, "unless"),
    "early": ({"at": 0.5, "delay": 1.0, **LOCK}, 3, "delay"),
    "both": ({"at": 0.5, "after": "whom", **LOCK}, 3, "after"),
    "untold": ({**LOCK}, 0, ""),
    "deed": ({"at": 0.5, "do": "lok", "on": "tow"}, 3, "do"),
    "thing": ({"at": 0.5, "do": "lock", "on": "closing"}, 4, "on"),
    "close": ({"at": 0.5, "do": "close", "force": 1.0}, 3, "do"),
    "rate": ({"at": 0.5, **LOCK, "rate": 1.0}, 5, "rate"),
    "rateless": ({"at": 0.5, "do": "pay_out", "on": "tow"}, 0, "rate"),
    "mute": ({"at": 0.5, "do": "stop"}, 0, "verdict"),
    "eject": ({"at": 0.5, "do": "eject"}, 3, "do"),
    "push": ({"at": 0.5, "do": "thrust"}, 3, "do"),
    "set": ({"at": 0.5, "do": "set", "on": "tow", "value": 2.0}, 4, "on"),
    "turn": ({"at": 0.5, "do": "set", "on": "thrust.factor", "value": 2.0}, 4, "on"),
    "unset": ({"at": 0.6, "do": "set", "value": 1.0}, 0, "on"),
    "cut": ({"at": 0.5, "do": "cut", "on": "tow"}, 4, "on"),
    "stop": ({"at": 0.5, "do": "stop", "verdict": "x", "on": "tow"}, 5, "on"),
    "rest": ({"when": "range < 2", **LOCK, "rest": 0.1}, 5, "rest"),
    "again": ({"at": 0.5, **LOCK, "repeat": True}, 5, "repeat"),
    "fall": ({"at": 0.5, **LOCK, "fall": 0.1}, 5, "fall"),
    "no_words": ({"at": 0.5, "do": "stop", "verdict": ""}, 4, "verdict"),
    "two words": ({"at": 0.5, **LOCK}, 1, "name"),
}  # fmt: skip


def errors(script: str, *overrides: str) -> list[tuple[int, str]]:
    """Line and key path of each error of a script, the line counted from the first [[script]]."""
    with pytest.raises(CaseError) as error:
        case_of(script, *overrides)
    found = re.findall(r"^script\.toml:(\d+): ([\w.\[\]]+)", str(error.value), re.MULTILINE)
    return [(int(line) - BEGIN, path) for line, path in found]


@pytest.mark.parametrize("name", ERRORS)
def test_errors_name_their_line(name: str) -> None:
    """An entry begins with [[script]] and its name, then its keys in order."""
    keys, down, key = ERRORS[name]
    other = entry("whom", at=0.4, do="note")
    expected = other.count("\n") + down, "script[1]" + (f".{key}" if key else "")
    assert errors(other + entry(name.replace("whom", "none"), **keys)) == [expected]


def test_cycles_and_names_given_twice() -> None:
    script = (
        entry("one", after="three", **LOCK)
        + entry("two", after="one", **LOCK)
        + entry("three", after="two", **LOCK)
        + entry("in", at=0.5, do="reel", on="tow", rate=1.0)
        + entry("in", at=0.6, **LOCK)
    )
    assert errors(script) == [(12, "script[2].after"), (22, "script[4].name")]


RIVALS = {  # two entries that command one drive differently at one time, and entries before them
    "one time": ({"at": 0.3}, {"at": 0.3}, ""),
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
    "round-off": ({"at": 0.3}, {"after": "x", "delay": 0.2}, entry("x", at=0.1, do="note")),
}


@pytest.mark.parametrize("name", RIVALS)
def test_two_commands_of_one_drive_at_one_time(name: str) -> None:
    """Both entries are reported, each at the line of its `do`."""
    one, other, before = RIVALS[name]
    first = before + entry("one", **one, do="lock", on="tow")
    k = first.count("[[script]]") - 1
    assert errors(first + entry("other", **other, do="reel", on="tow", rate=0.1)) == [
        (first.count("\n") - 2, f"script[{k}].do"),
        (first.count("\n") + 2 + len(other), f"script[{k + 1}].do"),
    ]


NUMBERS = {  # actions on one drive at one time
    "force": ({"do": "brake", "on": "tow", "force": 1.0}, {"do": "set", "on": "tow.force", "value": 2.0}),
    "rate": ({"do": "set", "on": "tow.rate", "value": 0.2}, {"do": "reel", "on": "tow", "rate": 0.1}),
    "none": (LOCK, {"do": "set", "on": "tow.rate", "value": 0.1}),
    "ends": ({"do": "stop", "verdict": "won"}, {"do": "stop", "verdict": "lost"}),
}


@pytest.mark.parametrize("name", NUMBERS)
def test_a_command_and_a_number_of_it_at_one_time(name: str) -> None:
    one, other = NUMBERS[name]
    found = errors(entry("one", at=0.1, **one) + entry("other", at=0.1, **other))
    assert [path for _, path in found] == ["script[0].do", "script[1].do"]


def test_commands_that_do_not_contradict_each_other() -> None:
    """Equal commands, other times, other conditions, an entry that another may prevent."""
    case_of(
        entry("close", at=0.3, do="lock", on="tow")
        + entry("again", at=0.3, do="lock", on="tow")
        + entry("later", at=0.31, do="reel", on="tow", rate=0.1)
        + entry("near", when="range < 2", do="brake", on="tow", force=1.0)
        + entry("nearer", at=0.2, when="range < 2", do="reel", on="tow", rate=0.1)
        + entry("unless", at=0.3, unless="near", do="reel", on="tow", rate=0.1)
        + entry("follows", after="unless", delay=0.01, do="lock", on="tow")
        + entry("reel", at=0.1, do="reel", on="tow", rate=0.1)
        + entry("same", at=0.1, do="set", on="tow.rate", value=0.1)
        + entry("force", at=0.2, do="set", on="tow.force", value=0.1)
        + entry("rate", at=0.2, do="set", on="tow.rate", value=0.2)
    )


@pytest.mark.slow
def test_a_chain_may_be_long() -> None:
    """1500 entries, each after the one before it, in reverse order in the file."""
    chain = [entry("e0", at=0.0, do="note")]
    chain += [entry(f"e{k}", after=f"e{k - 1}", delay=1e-3, do="note") for k in range(1, 1500)]
    ends = entry("lock", after="e1499", **LOCK) + entry("reel", after="e1499", do="reel", on="tow", rate=0.1)
    assert len(errors("".join(reversed(chain)) + ends)) == 2
    planned = timeline(case_of("".join(reversed(chain))).scene.script)
    assert [row.time for row in planned] == pytest.approx([1e-3 * k for k in range(1500)])


DRIVES = {  # override, action on the drive, key of the error
    "rate": ("tethers.tow.reel.largest_rate=0.5", {"do": "reel", "on": "tow", "rate": 100.0}, "rate"),
    "set": ("tethers.tow.reel.largest_rate=0.5", {"do": "set", "on": "tow.rate", "value": 0.6}, "value"),
    "commanded": ('tethers.tow.reel.commands=[{at=0.2, mode="lock"}]', LOCK, "on"),
    "undamped": ("tethers.tow.reel.damping=", {"do": "brake", "on": "tow", "force": 1.0}, "force"),
}


@pytest.mark.parametrize("name", DRIVES)
def test_limits_of_a_drive(name: str) -> None:
    override, keys, key = DRIVES[name]
    assert [path for _, path in errors(entry("act", at=0.5, **keys), override)] == [f"script[0].{key}"]


@pytest.mark.parametrize("backend", ["compiled", "exudyn"])
@pytest.mark.parametrize("end", [0.3, 0.35])
def test_entries_at_one_time_happen_as_they_are_written(backend: str, end: float) -> None:
    """0.1 + 0.2 s and 0.3 s are one time, that of the end too: p happens, and so q does not."""
    entries = (
        entry("x", at=0.1, do="note"),
        entry("p", after="x", delay=0.2, do="note"),
        entry("r", at=0.3, do="note"),
        entry("q", at=0.3, unless="p", do="stop", verdict="missed"),
    )
    case = case_of("".join(entries), f"time.end={end}", f"engine.backend={backend}", scene=FALL)
    assert happened(exunet.run(case)) == [("x", 0.1), ("p", 0.3), ("r", 0.3)]
    assert [row.entry.name for row in timeline(case.scene.script)] == ["x", "p", "r", "q"]


def test_the_timeline_has_known_times_first() -> None:
    case = case_of(
        entry("near", when="range < 2", do="note")
        + entry("late", at=0.4, do="reel", on="tow", rate=0.1)
        + entry("then", after="late", delay=0.2, do="brake", on="tow", force=1.0)
        + entry("soon", after="near", delay=0.1, do="note")
        + entry("early", at=0.1, do="note")
        + entry("missed", at=0.2, unless="early", do="note")
    )
    planned = [(row.entry.name, row.time) for row in timeline(case.scene.script)]
    known = [("early", 0.1), ("late", 0.4), ("then", pytest.approx(0.6))]
    assert planned == [*known, ("near", None), ("soon", None), ("missed", None)]


# Parameters that a script may set: a closed list with bounds


def setting(what: str, value: float = 1.0) -> str:
    return entry("set", at=0.1, do="set", on=what, value=value)


BARE = SLIDES.replace(', friction = { law = "sticking", coefficient = 0.3 }', "")
COMMANDS = 'tethers.tow.reel.commands=[{at=0.2, mode="lock"}]'
REFUSED = {  # script, key of the error, scene, overrides
    "twice": (
        setting("tow.rate", 0.1) + entry("other", at=0.1, do="set", on="tow.rate", value=0.2),
        "do",
        SCENE,
        (),
    ),
    "no parameter": (setting("tow"), "on", SCENE, ()),
    "contact": (setting("contact.friction"), "on", SCENE, ()),
    "closing": (setting("closing.friction"), "on", SCENE, ()),
    "rate of 0": (setting("tow.rate", 0.0), "value", SCENE, ()),
    "outlet": (setting("tow.youngs_modulus"), "on", SCENE, ()),
    "commanded": (setting("tow.force"), "on", SCENE, (COMMANDS,)),
    "undamped": (setting("tow.force"), "on", SCENE, ("tethers.tow.reel.damping=",)),
    "stiffer": (setting("tow.youngs_modulus", 2e9), "value", HANGS, ()),
    "rough line": (setting("closing.friction", 3.0), "value", LIFTS, ()),
    "smooth line": (setting("closing.friction", 0.1), "on", LIFTS, ("closing.friction=0.0",)),
    "without a law": (setting("contact.friction", 0.1), "on", BARE, ()),
    "breaking": (setting("tow.youngs_modulus", 1e3), "on", HANGS, ("effects.breaking={strain=0.5}",)),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_may_be_set_is_a_closed_list_with_bounds(name: str) -> None:
    script, key, scene, overrides = REFUSED[name]
    with pytest.raises(CaseError, match=rf"^script\.toml:\d+: script\[0\]\.{key}: "):
        case_of(script, *overrides, scene=scene)


def set_to(parameter: str, value: float, *command: float) -> list[float]:
    """The command of a drive after that; empty if nothing changes."""
    system = prepare_case(case_of("")).system
    every = dict(system.discrete) | {"reel/tow": np.array(command)}
    what, words = changed(system, parameter, value, (0.1, np.zeros(0), np.zeros(0)), every)
    if not what:
        assert words["event"]
        return []
    assert words == {}
    (after,) = what["others"].values()
    assert list(what["others"]) == ["reel/tow"]
    return [float(item) for item in after]


def test_a_rate_or_a_force_that_a_drive_has() -> None:
    """A rate keeps its direction; a rate without limit, or of 0, is not set; what holds hard has no force."""
    assert set_to("tow.rate", 0.5, 1.0, 0.2, 10.0, 0.05) == [1.0, 0.5, 10.0, 0.05]
    assert set_to("tow.rate", 0.5, 1.0, -0.2, 10.0, 0.05) == [1.0, -0.5, 10.0, 0.05]
    assert set_to("tow.force", 7.0, 1.0, -0.2, 10.0, 0.05) == [1.0, -0.2, 7.0, 0.05]
    assert set_to("tow.force", 7.0, 1.0, WITHOUT_LIMIT, 10.0, 0.05) == [1.0, WITHOUT_LIMIT, 7.0, 0.05]
    assert set_to("tow.rate", 0.5, 1.0, WITHOUT_LIMIT, 10.0, 0.05) == []
    assert set_to("tow.rate", 0.5, 1.0, 0.0, 10.0, 0.05) == []
    assert set_to("tow.rate", 0.5, 0.0, 0.2, 10.0, 0.05) == []
    assert set_to("tow.force", 7.0, 1.0, 0.2, 0.0, 0.0) == []
    assert set_to("tow.force", 7.0, 0.0, 0.2, 10.0, 0.05) == []


def test_other_parameters_that_are_set() -> None:
    """The factor of a thrust; the part of its modulus that a tether keeps, but for what has broken."""
    system = prepare_case(case_of("")).system
    now = 0.1, np.zeros(0), np.zeros(0)
    what, _ = changed(system, "thrust.factor", 0.25, now, {THRUST: np.array([2.0, 0.5, 1.0])})
    assert what["others"][THRUST].tolist() == [2.0, 0.5, 0.25]
    what, _ = changed(system, "tow.youngs_modulus", 0.25e9, now, {INTACT: np.array([0.5, 0.0])})
    assert what["others"][INTACT].tolist() == [0.25, 0.0]
    what, _ = changed(system, "contact.friction", 0.3, now, {})
    assert {name: values.tolist() for name, values in what["others"].items()} == {
        "set/contact.friction": [0.3]
    }
