"""What a script tells before the run: what is certain, what never happens, what would be done in vain."""

from __future__ import annotations

from pathlib import Path

import pytest
from test_script import case_of, entry, happened

import exunet
from exunet.case.casefile import Case, parse_case
from exunet.case.foresight import Surroundings
from exunet.case.timeline import timeline
from exunet.interfaces.commands.check import describe

CERTAIN = {  # entries, and of each when it happens, or why never
    "what bars it comes later": (
        entry("x", at=0.5, do="note")
        + entry("a", at=0.1, unless="x", do="note")
        + entry("b", at=0.2, unless="a", do="note")
        + entry("c", after="b", do="note"),
        ("t = 0.5 s", "t = 0.1 s", "a comes before", "b, for which it waits, never happens"),
    ),
    "so does what may bar a stop": (
        entry("s", at=0.3, unless="x", do="stop", verdict="v")
        + entry("x", at=0.5, do="note")
        + entry("y", when="range < 2", at=0.4, do="note"),
        ("t = 0.3 s", "s ends the run at t = 0.3 s", "s ends the run at t = 0.3 s"),
    ),
    "what may come true later": (
        entry("x", when="range < 2", at=0.5, do="note") + entry("a", at=0.1, unless="x", do="note"),
        ("from t = 0.5 s on", "t = 0.1 s"),
    ),
    "each bars the other": (
        entry("a", at=0.1, unless="b", do="note") + entry("b", at=0.2, unless="a", do="note"),
        ("t = 0.1 s", "a comes before"),
    ),
    "each bars the other at one time": (
        entry("a", at=0.1, unless="b", do="note") + entry("b", at=0.1, unless="a", do="note"),
        ("t = 0.1 s", "a comes before"),
    ),
    "one condition": (
        entry("a", when="range < 2", do="note") + entry("b", when="range < 2", unless="a", do="note"),
        ("from t = 0 s on", "a comes before"),
    ),
    "a condition that holds once the other does": (
        entry("a", when="range < 2", do="note") + entry("b", when="range < 1", unless="a", do="note"),
        ("from t = 0 s on", "a comes before"),
    ),
    "either may come first": (
        entry("b", when="range < 1", unless="a", do="note")
        + entry("a", when="range < 2", do="note")
        + entry("c", when="range < 2", at=0.1, unless="a", do="note"),
        ("from t = 0 s on", "from t = 0 s on", "a comes before"),
    ),
    "after one event": (
        entry("x", when="range < 2", do="note")
        + entry("a", after="x", delay=0.1, do="stop", verdict="v")
        + entry("b", after="x", delay=0.2, do="note")
        + entry("c", after="x", delay=0.05, unless="b", do="note")
        + entry("d", after="x", delay=0.06, unless="c", do="note"),
        (
            "from t = 0 s on",
            "from t = 0.1 s on",
            "a ends the run before",
            "from t = 0.05 s on",
            "c comes before",
        ),
    ),
    "one that repeats puts off what comes after it": (
        entry("x", when="range < 2", repeat=True, do="note")
        + entry("y", when="range < 2", do="note")
        + entry("a", after="x", delay=0.1, do="note")
        + entry("b", after="y", delay=0.2, unless="a", do="note"),
        ("from t = 0 s on", "from t = 0 s on", "from t = 0.1 s on", "from t = 0.2 s on"),
    ),
    "a time is crossed once it is over": (
        entry("a", when="time > 0.3", do="note")
        + entry("b", at=0.3, unless="a", do="note")
        + entry("s", at=0.4, do="stop", verdict="v")
        + entry("c", when="time > 0.4", do="note")
        + entry("d", after="a", delay=0.1, do="note"),
        ("t = 0.3 s", "t = 0.3 s", "t = 0.4 s", "s ends the run at t = 0.4 s", "s ends the run at t = 0.4 s"),
    ),
    "no time is later than the end": (
        entry("a", when="time > 1.0", do="note") + entry("b", at=1.0, do="note"),
        ("time is at most 1 s, the end", "t = 1 s"),
    ),
    "in the order in which a run takes them": (  # d, then c, which the run takes before what stands behind d
        entry("c", after="d", do="note")
        + entry("d", at=0.1, do="note")
        + entry("e", at=0.1, unless="c", do="note")
        + entry("f", at=0.1, unless="g", do="note")
        + entry("g", after="d", do="note"),
        ("t = 0.1 s", "t = 0.1 s", "c comes before", "t = 0.1 s", "t = 0.1 s"),
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", CERTAIN)
def test_what_follows_for_certain(name: str) -> None:
    """By hand, from the rules of docs/script.md."""
    script, expected = CERTAIN[name]
    case = case_of(script)
    found = {one.entry.name: one.never or one.when for one in timeline(case.scene.script, Surroundings(1.0))}
    assert tuple(found[one.name] for one in case.scene.script) == expected


@pytest.mark.parametrize("name", CERTAIN)
def test_a_run_bears_out_what_was_foreseen(name: str) -> None:
    """In the compiled loop: what is certain happens at its time, what is never to happen does not."""
    case = case_of(CERTAIN[name][0])
    result = exunet.run(case)
    times = dict(happened(result))
    for one in timeline(case.scene.script, Surroundings(1.0)):
        if one.never:
            assert one.entry.name not in times
        elif one.certain and one.earliest <= result.time[-1]:
            assert times[one.entry.name] == pytest.approx(one.earliest, abs=1e-6)


MISSION = Path(__file__).parents[1] / "cases" / "missions" / "throw_close_tow.toml"


def mission(*script: str, changes: tuple[str, ...] = ()) -> Case:
    """The mission's scene, whose tether has no reel, with another script."""
    text = MISSION.read_text(encoding="utf-8").split("[[script]]")[0]
    start, reel = text.index("[tethers.tow.reel]"), text.index("[", text.index("[tethers.tow.reel]") + 1)
    return parse_case(text[:start] + text[reel:] + "".join(script), MISSION, list(changes))


def planned(*script: str) -> list[str]:
    """What `exunet check` says of a script in the mission's scene."""
    return [words for name, words in describe(mission(*script)) if name == "script"]


def test_a_packed_net_waits_for_itself() -> None:
    """The mouth has 2.16 m2 as it is held; 84 threads, 4 elements of the tether and 4 bullets may touch."""
    assert planned(
        entry("seen", when="largest_area", do="note"),
        entry("wide", when="area > 2.2", do="note"),
        entry("small", when="area < 2.2", do="note"),
        entry("throw", after="seen", do="eject"),
        entry("touch", when="first_contact", do="note"),
        entry("all", when="touching > 92", do="note"),
    ) == [
        "from t = 0 s on: small: note (area < 2.2)",
        "from t = 0 s on: touch: note (first_contact); the net stays packed: only what is packed may touch",
        "never: seen: note (the net stays packed: throw, which ejects it, waits until it is out)",
        "never: wide: note (the net stays packed: throw, which ejects it, waits until it is out)",
        "never: throw: eject (seen, for which it waits, never happens)",
        "never: all: note (touching is at most 92 here)",
    ]


def test_a_packed_net_waits_for_a_contact() -> None:
    """Which its canister may have, so it is not certain that it never comes."""
    assert planned(
        entry("touch", when="first_contact", do="note"), entry("throw", after="touch", do="eject")
    ) == [
        "from t = 0 s on: touch: note (first_contact); the net is packed until throw, which waits for a "
        "contact: only what is packed may touch",
        "from t = 0 s on: throw: eject (after touch)",
    ]


def test_what_waits_for_a_net_that_is_thrown_later() -> None:
    """One of two entries throws it in any case."""
    assert planned(
        entry("seen", when="largest_area", do="note"),
        entry("throw", after="seen", do="eject"),
        entry("anyway", at=0.5, do="eject"),
        entry("touch", when="first_contact", do="note"),
    ) == [
        "from t = 0 s on: touch: note (first_contact)",
        "from t = 0.5 s on: seen: note (largest_area)",
        "from t = 0.5 s on: throw: eject (after seen)",
        "t = 0.5 s: anyway: eject",
    ]


def test_what_is_done_in_vain() -> None:
    """On what has been cut or ejected for certain."""
    assert planned(
        entry("throw", at=0.1, do="eject"),
        entry("again", at=0.2, do="eject"),
        entry("cut", at=0.3, do="cut", on="tow"),
        entry("twice", at=0.4, do="cut", on="tow"),
        entry("soften", after="cut", do="set", on="tow.youngs_modulus", value=1e6),
        entry("free", after="cut", do="release", on="tethers.tow.start"),
    ) == [
        "t = 0.1 s: throw: eject",
        "t = 0.2 s: again: eject; in vain: throw has ejected the net before",
        "t = 0.3 s: cut: cut tow",
        "t = 0.3 s: soften: set tow.youngs_modulus to 1e+06; in vain: cut has cut tow before",
        "t = 0.3 s: free: release tethers.tow.start; in vain: cut has cut tow before",
        "t = 0.4 s: twice: cut tow; in vain: cut has cut tow before",
    ]


@pytest.mark.slow
def test_a_run_tells_what_was_done_in_vain() -> None:
    """No element is told as cut again."""
    script = (
        entry("throw", at=0.05, do="eject"),
        entry("again", at=0.06, do="eject"),
        entry("cut", at=0.07, do="cut", on="tow"),
        entry("twice", at=0.08, do="cut", on="tow"),
    )
    case = mission(*script, changes=("engine.loop=compiled", "time.end=0.1"))
    told = exunet.run(case).provenance["script"]
    words = [one["event"].partition("; ")[2] for one in told]
    assert words == [
        *("", "in vain: the net has been ejected before", ""),
        "in vain: it has been cut before, or has broken there",
    ]
    assert ["element" in one for one in told] == [False, False, True, False]


def test_the_first_contact_is_when_something_touches() -> None:
    """One instant in a run that begins without a contact, so a note and no fault."""
    assert planned(
        entry("throw", at=0.1, do="eject"),
        entry("first", when="first_contact", do="lock", on="closing"),
        entry("touch", when="touching > 0", do="close", force=1.0),
        entry("more", when="touching > 1", do="close", force=2.0),
    ) == [
        "from t = 0 s on: first: lock closing (first_contact)",
        "from t = 0 s on: touch: close with 1 N (touching > 0); acts on closing at the same time as first "
        "if both happen: then this one counts",
        "from t = 0 s on: more: close with 2 N (touching > 1)",
        "t = 0.1 s: throw: eject",
    ]
