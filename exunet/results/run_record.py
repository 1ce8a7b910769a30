"""Record of a run: what a result has beside its states."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict, dataclass, field
from functools import cache
from typing import Annotated, Any, Self, TypeVar

from pydantic import PlainSerializer, PlainValidator, TypeAdapter

from exunet.base.run_events import ElementBreak, NetEjected, RunEvent, ScriptEvent, tagged, untagged
from exunet.methods.method import Plan
from exunet.scene.capture import Capture

ALL_STEPS, STORED_TIMES = "all steps", "stored times"  # of which a largest tension is


@dataclass(frozen=True)
class CaseText:
    """Case of a run; folder: where it lies, if it names files."""

    name: str | None = None
    text: str = ""
    overrides: tuple[str, ...] = ()
    folder: str = ""


@dataclass(frozen=True)
class Cost:
    """Counts of a run over all attempts, and wall times of construction and integration [s]."""

    steps: int = 0
    rejected_steps: int = 0
    right_hand_sides: int = 0
    newton_iterations: int = 0
    build_seconds: float = 0.0
    integration_seconds: float = 0.0


@dataclass(frozen=True)
class Retry:
    """Continuation from an earlier state; tolerance or step of the finer plan."""

    stopped: str
    from_time_s: float
    tolerance: float | None = None
    step_s: float | None = None


@dataclass(frozen=True)
class Peak:
    """Largest tension of a group [N], when [s], and in which element (-1: none was ever taut).

    of : "all steps", or "stored times": a peak between two of these is not in it
    """

    tension: float
    time: float
    element: int
    of: str = ALL_STEPS


@dataclass(frozen=True)
class UnitSettings:
    """Control of corner units: kind of controller, numbers of bullets, period and specific impulse [s]."""

    kind: str
    bullets: tuple[int, ...]
    period: float
    specific_impulse: float | None = None


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
class EntryRecord:
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


_Event = TypeVar("_Event", bound=RunEvent)


@dataclass(frozen=True)
class RunRecord:
    """Record of a run.

    verdict  : "ok", or why the run stopped
    case     : text of the case
    plan     : plan of the integration, after the last retry; None: not a run of exunet
    end      : end time of the case [s]
    effects  : names of the effects that are switched on
    capture  : criterion of the capture; None: the case has none
    units    : corner units, if there are any
    items    : number of items of Exudyn, by type
    cost     : counts and wall times
    largest_tensions : largest tension of all steps of each of `Net.spans`, by name
    peak_tensions_N  : largest tension of all steps of each element; None: not a run that came to its end
    energy_scale_J   : energy that could deform the net (see `exunet.simulation.guards`)
    events   : what happened, in order
    observed : numbers that observers of one's own report, by name; None: it was no finite number
    can_break : True if elements break beyond a limit
    edge_radii, grid_spacings : of bodies with rounded edges, and of meshes with a given spacing, by name [m]
    closing_path : nodes along a closing line, ends included
    drums    : node at the drum of each reel, by the name of its tether
    up       : unit vector against gravity, or along the radial of an orbit; empty without both
    """

    title: str = ""
    verdict: str = "ok"
    case: CaseText = CaseText()
    versions: Mapping[str, str] = field(default_factory=dict)
    platform: str | None = None
    plan: Annotated[Plan, PlainValidator(Plan.from_json), PlainSerializer(Plan.as_json)] | None = None
    end: float | None = None
    effects: tuple[str, ...] = ()
    capture: Capture | None = None
    units: UnitSettings | None = None
    items: Mapping[str, int] = field(default_factory=dict)
    cost: Cost = Cost()
    retries: tuple[Retry, ...] = ()
    largest_tensions: Mapping[str, Peak] = field(default_factory=dict)
    peak_tensions_N: list[float] | None = None  # noqa: N815 - the unit
    energy_scale_J: float | None = None  # noqa: N815 - the unit
    events: tuple[Annotated[RunEvent, PlainValidator(untagged), PlainSerializer(tagged)], ...] = ()
    observed: Mapping[str, float | None] = field(default_factory=dict)
    can_break: bool = False
    carried: Carried | None = None
    releases: list[Release] = field(default_factory=list)
    script_entries: list[EntryRecord] = field(default_factory=list)
    restart: RestartSource | None = None
    winch: WinchLimits | None = None
    edge_radii: Mapping[str, float] = field(default_factory=dict)
    grid_spacings: Mapping[str, float] = field(default_factory=dict)
    closing_path: list[int] = field(default_factory=list)
    drums: Mapping[str, int] = field(default_factory=dict)
    up: list[float] = field(default_factory=list)

    def to_json(self) -> str:
        """Return the record as JSON text; raises ValueError for NaN or infinity."""
        values = _adapter(type(self)).dump_python(self, mode="json")
        return json.dumps(values, ensure_ascii=False, sort_keys=True, allow_nan=False)

    @classmethod
    def from_json(cls, text: str | bytes) -> Self:
        """Return the record of what `to_json` gave; raises ValueError for anything else."""
        return _adapter(cls).validate_json(text)

    def events_of(self, kind: type[_Event]) -> list[_Event]:
        """Return the events of a class, in order."""
        return [event for event in self.events if isinstance(event, kind)]

    @property
    def breaks(self) -> list[ElementBreak]:
        """Elements that broke."""
        return self.events_of(ElementBreak)

    @property
    def ejections(self) -> list[NetEjected]:
        """Ejections of the net."""
        return self.events_of(NetEjected)

    @property
    def script(self) -> list[ScriptEvent]:
        """Events of the script."""
        return self.events_of(ScriptEvent)

    @property
    def done(self) -> list[ScriptEvent]:
        """Events in which an entry of the script did something."""
        return [event for event in self.script if event.done]

    @property
    def stop(self) -> ScriptEvent | None:
        """Event in which an entry of the script ended the run, if one did."""
        return next((event for event in self.done if event.verdict is not None), None)

    @property
    def largest_tension(self) -> Peak | None:
        """Largest tension of all elements and steps, the first of equal ones."""
        return largest_of(self.largest_tensions.values())


class Recorded:
    """Result of a run or of an ensemble, with its record."""

    run: RunRecord

    @property
    def verdict(self) -> str:
        """Return "ok", or why the run or the ensemble stopped."""
        return self.run.verdict

    @property
    def complete(self) -> bool:
        """False if it stopped before its end."""
        return self.verdict == "ok"


def largest_of(peaks: Iterable[Peak]) -> Peak | None:
    """Return the largest tension, the first of equal ones; None without any."""
    return max(peaks, key=lambda peak: (peak.tension, -peak.time), default=None)


@dataclass(frozen=True)
class Ending:
    """How runs of an ensemble ended: verdict of the script or None, number of runs, from when to when [s]."""

    verdict: str | None
    runs: int
    earliest_s: float
    latest_s: float


@dataclass(frozen=True)
class EnsembleRecord(RunRecord):
    """Record of an ensemble, with that of its unperturbed start.

    seed, move_m : of the perturbations, and the largest of them [m]
    runs_requested, seconds : number of runs requested, and wall time [s]
    notes    : what limits the ranges
    outcomes : number of runs by capture outcome
    endings  : how runs ended, if a script ended some
    """

    seed: int | None = None
    move_m: float | None = None
    runs_requested: int | None = None
    seconds: float | None = None
    notes: tuple[str, ...] = ()
    outcomes: Mapping[str, int] = field(default_factory=dict)
    endings: tuple[Ending, ...] = ()


_adapter: Callable[[Any], TypeAdapter[Any]] = cache(TypeAdapter)


def summary_of_script(run: RunRecord) -> dict[str, Any] | None:
    """Return events, times of each entry, those never reached, what ended the run; None without a script."""
    if not run.script_entries:
        return None
    times: dict[str, list[float]] = {entry.entry: [] for entry in run.script_entries}
    for event in run.done:
        times[event.entry].append(event.time_s)
    stop = run.stop
    return {
        "events": [event.as_json() for event in run.script],
        "entries": [{**asdict(entry), "times_s": times[entry.entry]} for entry in run.script_entries],
        "used_up": [_used_up(event.entry, times[event.entry]) for event in run.script if event.used_up],
        "never": [entry.entry for entry in run.script_entries if not times[entry.entry]],
        "stopped": None
        if stop is None
        else {"time_s": stop.time_s, "entry": stop.entry, "verdict": stop.verdict},
    }


def _used_up(name: str, times: list[float]) -> str:
    """Return the message of an entry that is disabled."""
    return (
        f"{name}: disabled after {len(times)} activations, from t = {times[0]:.6g} s to {times[-1]:.6g} s: "
        "its last action stays until the end; use a longer rest, or a band between two conditions"
    )
