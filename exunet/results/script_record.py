"""What a script did in a run: its entries, each with its times and its cause, and those never reached."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

from exunet.model.script import HEADING
from exunet.results.provenance import SceneProvenance


def done(provenance: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """Return the events in which an entry did something, in order; none of a case without a script."""
    return [event for event in provenance.get(HEADING, []) if event["done"]]


def times_of_awaited(provenance: Mapping[str, Any]) -> dict[str, list[float]]:
    """Return when entries happened [s], by name: of all whose times depend on the run."""
    names = [entry.entry for entry in SceneProvenance.of(provenance).script_entries if entry.awaited]
    events = done(provenance)
    return {name: [event["time_s"] for event in events if event["entry"] == name] for name in names}


def ending(provenance: Mapping[str, Any]) -> str:
    """Return the verdict of the entry that ended a run, or its name without a verdict; "" if none did."""
    stop = next((event for event in done(provenance) if event.get("verdict") is not None), None)
    return "" if stop is None else stop["verdict"] or stop["entry"]


def summary_of_script(provenance: Mapping[str, Any]) -> dict[str, Any] | None:
    """Return events, times of each entry, those never reached, what ended the run; None without a script."""
    entries = SceneProvenance.of(provenance).script_entries
    if not entries:
        return None
    events = provenance.get(HEADING, [])
    times: dict[str, list[float]] = {entry.entry: [] for entry in entries}
    for event in done(provenance):
        times[event["entry"]].append(event["time_s"])
    stop = next((event for event in done(provenance) if event.get("verdict") is not None), None)
    return {
        "events": [dict(event) for event in events],
        "entries": [{**asdict(entry), "times_s": times[entry.entry]} for entry in entries],
        "used_up": [_used_up(event, events) for event in events if event.get("used_up")],
        "never": [entry.entry for entry in entries if not times[entry.entry]],
        "stopped": None
        if stop is None
        else {"time_s": stop["time_s"], "entry": stop["entry"], "verdict": stop["verdict"]},
    }


def _used_up(last: Mapping[str, Any], events: Sequence[Mapping[str, Any]]) -> str:
    """Return the message of an entry that is disabled."""
    name = last["entry"]
    times = [event["time_s"] for event in events if event["done"] and event["entry"] == name]
    return (
        f"{name}: disabled after {len(times)} activations, from t = {times[0]:.6g} s to {times[-1]:.6g} s: "
        "its last action stays until the end; use a longer rest, or a band between two conditions"
    )
