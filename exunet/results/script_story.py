"""What a script did in a run: its entries, each with its times and its cause, and those never reached."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

from exunet.model.script import HEADING
from exunet.results.provenance import SceneProvenance

THIS_RUN, THIS_RUN_ALONE = "this run", "this run only"  # whose a number without a spread is
_ALONE = "times that the case does not give are of this run only: other runs of it may have others"
_RANGES = "times that the case does not give are of this run only; those of moved starts are below"
_APART = 1e-6  # [s]: two instants that are nearer are told as one


def done(story: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """The events in which an entry did something, in order; none of a case without a script."""
    return [item for item in story.get(HEADING, []) if item["done"]]


def times_of_awaited(story: Mapping[str, Any]) -> dict[str, tuple[float, ...]]:
    """When entries happened [s], by name: of all whose times depend on the run, those never reached too."""
    entries = [item.entry for item in SceneProvenance.of(story).script_entries if item.awaited]
    return {
        name: tuple(entry["time_s"] for entry in done(story) if entry["entry"] == name) for name in entries
    }


def ending(story: Mapping[str, Any]) -> str:
    """The verdict of the entry that ended a run, or its name where that says nothing; "" if none did."""
    stop = next((item for item in done(story) if item.get("verdict") is not None), None)
    return "" if stop is None else stop["verdict"] or stop["entry"]


def told(story: Mapping[str, Any], whose: str = THIS_RUN_ALONE) -> dict[str, Any] | None:
    """For the summary: events, how often each entry came, those that never came, what ended the run.

    whose : THIS_RUN, or THIS_RUN_ALONE where the run goes beyond its horizon: so are its times then, but
            those that the case gives
    None of a case without a script.
    """
    entries = SceneProvenance.of(story).script_entries
    if not entries:
        return None
    events = story.get(HEADING, [])
    times: dict[str, list[float]] = {entry.entry: [] for entry in entries}
    for item in done(story):
        times[item["entry"]].append(item["time_s"])
    stop = next((element for element in done(story) if element.get("verdict") is not None), None)
    return {
        "of": whose if any("crossed_s" in one for one in events) else THIS_RUN,
        "events": [dict(event) for event in events],
        "entries": [{**asdict(one), "times_s": times[one.entry]} for one in entries],
        "used_up": [_used_up(one, events) for one in events if one.get("used_up")],
        "never": [one.entry for one in entries if not times[one.entry]],
        "stopped": None
        if stop is None
        else {"time_s": stop["time_s"], "entry": stop["entry"], "verdict": stop["verdict"]},
    }


def _used_up(last: Mapping[str, Any], events: Sequence[Mapping[str, Any]]) -> str:
    """That an entry happens no more, in words."""
    name = last["entry"]
    times = [event["time_s"] for event in events if event["done"] and event["entry"] == name]
    return (
        f"{name} happened {len(times)} times, from t = {times[0]:.6g} s to {times[-1]:.6g} s, and no more: "
        "what was asked last stays until the end; give it a longer rest, or a band between two conditions"
    )


def rows(found: Mapping[str, Any] | None, *, moved: bool = False) -> list[tuple[str, str]]:
    """Rows of the table that a run prints: each event with time and cause, and what never came.

    moved : the table goes on with headlines of moved starts
    """
    if found is None:
        return []
    table = [("script", f"t = {item['time_s']:.6g} s: {words_of(item)}") for item in found["events"]]
    if found["of"] == THIS_RUN_ALONE:
        table.append(("script", _RANGES if moved else _ALONE))
    table += [("script: NOTE", words) for words in found["used_up"]]
    if found["never"]:
        causes = {entry["entry"]: entry["cause"] for entry in found["entries"]}
        never = ", ".join(f"{name} ({causes[name]})" for name in found["never"])
        table.append(("script", f"never reached: {never}"))
    return table


def words_of(event: Mapping[str, Any]) -> str:
    """An event in words: entry, action, cause, and where it acted later than its condition came true."""
    words = f"{event['entry']}: {event['event']} ({event['cause']})"
    time = event["time_s"]
    if time - event.get("after_s", time) <= _APART:
        return words
    if event["crossed_s"] < time:
        at = f"at t = {event['crossed_s']:.6g} s, interpolated"
    else:
        at = f"in the step from t = {event['after_s']:.6g} s on, at whose end alone it is known"
    return f"{words}; came true {at}, and acted at the step's end"
