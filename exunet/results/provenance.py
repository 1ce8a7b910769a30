"""Records in the provenance of a result: its scene, and what its script did; stored as JSON."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

from exunet.model.script import HEADING


@dataclass(frozen=True)
class Carried:
    """Body that holds the packed net.

    until_s  : time of the ejection [s]; None: by a script
    origin_m : origin of the net from the centre of mass, in the axes of the body's frame [m]
    nodes    : nodes of the packed net
    """

    body: str
    until_s: float | None
    origin_m: list[float]
    nodes: list[int]


@dataclass(frozen=True)
class Release:
    """Node that a script may release from a body.

    tie  : name of the attachment or end of a tether
    tied : attached at the start
    """

    tie: str
    node: int
    body: str
    tied: bool


@dataclass(frozen=True)
class ScriptEntry:
    """Entry of a script with its cause and its action; awaited : its time depends on the run."""

    entry: str
    cause: str
    action: str
    awaited: bool


@dataclass(frozen=True)
class RestartSource:
    """State of another run in which a case starts.

    result : file of that run
    sha256 : hash of the file
    broken : broken elements
    """

    result: str
    time_s: float
    sha256: str
    broken: list[int]


@dataclass(frozen=True)
class WinchLimits:
    """Limits of the winch of a closing line.

    windable_m : length that it can wind up
    force_N    : largest force of its commands and of the script; None: none has a force
    commands   : "pull", "lock" or "pay out", and the time of its own command [s], or the script's entry
    """

    windable_m: float
    force_N: float | None  # noqa: N815 - the unit
    commands: list[tuple[str, float | str]] = field(default_factory=list)


@dataclass(frozen=True)
class SceneProvenance:
    """Records of the scene of a run.

    edge_radii, grid_spacings : of bodies with rounded edges, and of meshes with a given spacing, by name [m]
    closing_path : nodes along a closing line, ends included
    drums : node at the drum of each reel, by the name of its tether
    up : unit vector against gravity, or along the radial of an orbit; empty without both
    """

    carried: Carried | None = None
    releases: list[Release] = field(default_factory=list)
    script_entries: list[ScriptEntry] = field(default_factory=list)
    restart: RestartSource | None = None
    winch: WinchLimits | None = None
    edge_radii: Mapping[str, float] = field(default_factory=dict)
    grid_spacings: Mapping[str, float] = field(default_factory=dict)
    closing_path: list[int] = field(default_factory=list)
    drums: Mapping[str, int] = field(default_factory=dict)
    up: list[float] = field(default_factory=list)

    def as_json(self) -> dict[str, Any]:
        """Return the records that are not empty, JSON-like."""
        return {name: value for name, value in asdict(self).items() if value}

    @classmethod
    def of(cls, provenance: Mapping[str, Any]) -> SceneProvenance:
        """Read the records of the provenance of a result."""
        carried, restart, winch = (provenance.get(name) for name in ("carried", "restart", "winch"))
        return cls(
            None if carried is None else Carried(**carried),
            [Release(**item) for item in provenance.get("releases", ())],
            [ScriptEntry(**item) for item in provenance.get("script_entries", ())],
            None if restart is None else RestartSource(**restart),
            None if winch is None else WinchLimits(**winch),
            provenance.get("edge_radii", {}),
            provenance.get("grid_spacings", {}),
            provenance.get("closing_path", []),
            provenance.get("drums", {}),
            provenance.get("up", []),
        )


def done(provenance: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """Return the events in which an entry did something, in order; none of a case without a script."""
    return [event for event in provenance.get(HEADING, []) if event["done"]]


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
