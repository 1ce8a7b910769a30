"""What a script did in a run: its entries, each with its times and its cause, and those never reached."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from exunet.system.script_events import HEADING

ENTRIES = "script_entries"  # in the story of a result: name, cause and action of each entry
_APART = 1e-6  # [s]: two instants that are nearer are told as one


def done(story: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """The events in which an entry did something, in order; none of a case without a script."""
    return [one for one in story.get(HEADING, []) if one["done"]]


def ending(story: Mapping[str, Any]) -> str:
    """The verdict of the entry that ended a run, or its name where that says nothing; "" if none did."""
    stop = next((one for one in done(story) if one.get("verdict") is not None), None)
    return "" if stop is None else stop["verdict"] or stop["entry"]


def told(story: Mapping[str, Any]) -> dict[str, Any] | None:
    """For the summary: events, how often each entry came, those that never came, what ended the run.

    None of a case without a script.
    """
    entries = story.get(ENTRIES)
    if entries is None:
        return None
    events = story.get(HEADING, [])
    times: dict[str, list[float]] = {one["entry"]: [] for one in entries}
    for one in done(story):
        times[one["entry"]].append(one["time_s"])
    stop = next((one for one in done(story) if one.get("verdict") is not None), None)
    return {
        "events": [dict(one) for one in events],
        "entries": [{**one, "times_s": times[one["entry"]]} for one in entries],
        "never": [one["entry"] for one in entries if not times[one["entry"]]],
        "stopped": None
        if stop is None
        else {"time_s": stop["time_s"], "entry": stop["entry"], "verdict": stop["verdict"]},
    }


def rows(found: Mapping[str, Any] | None) -> list[tuple[str, str]]:
    """Rows of the table that a run prints: each event with time and cause, and what never came."""
    if found is None:
        return []
    table = [("script", f"t = {one['time_s']:.6g} s: {words_of(one)}") for one in found["events"]]
    if found["never"]:
        causes = {one["entry"]: one["cause"] for one in found["entries"]}
        never = ", ".join(f"{name} ({causes[name]})" for name in found["never"])
        table.append(("script", f"never reached: {never}"))
    return table


def words_of(event: Mapping[str, Any]) -> str:
    """An event in words: entry, action, cause, and where it acted later than its condition came true."""
    words = f"{event['entry']}: {event['event']} ({event['cause']})"
    crossed = event.get("crossed_s")
    if crossed is not None and event["time_s"] - crossed > _APART:
        words += f"; came true at t = {crossed:.6g} s, interpolated, and acted at the step's end"
    return words
