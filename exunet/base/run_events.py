"""Events of a run, as its record has them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True, kw_only=True)
class RunEvent:
    """Event of a run.

    time_s        : when [s]
    energy_lost_J : energy that the system lost with it [J], where that is measured
    """

    time_s: float
    energy_lost_J: float | None = None  # noqa: N815 - the unit

    def as_json(self) -> dict[str, Any]:
        """Return the values that are not None, by name."""
        return {name: value for name, value in vars(self).items() if value is not None}


@dataclass(frozen=True, kw_only=True)
class ElementBreak(RunEvent):
    """Element that broke.

    energy_J      : elastic energy that it held [J], which is lost
    energy_excess : its excess over the energy at the limit, as a part of that
    """

    element: int
    energy_J: float | None = None  # noqa: N815 - the unit
    energy_excess: float | None = None


@dataclass(frozen=True, kw_only=True)
class NetEjected(RunEvent):
    """Ejection of a packed net from a body; speeds of bullets, or of all nodes without bullets.

    nodes : number of nodes that are ejected
    launch_speed_added_m_s, launch_speed_relative_m_s : largest speeds before and after the recoil [m/s]
    """

    nodes: int
    body: str
    launch_speed_added_m_s: float
    launch_speed_relative_m_s: float
    net_momentum_gained_kg_m_s: list[float]
    net_angular_momentum_gained_kg_m2_s: list[float]
    net_kinetic_energy_gained_J: float  # noqa: N815 - the unit


@dataclass(frozen=True, kw_only=True)
class ReelEvent(RunEvent):
    """Command of a reel, or node that goes onto its drum or comes off it."""

    tether: str
    event: str
    node: int | None = None


@dataclass(frozen=True, kw_only=True)
class ClosingEvent(RunEvent):
    """Command of a closing line, or begin and end of an edge's shortening."""

    event: str


@dataclass(frozen=True, kw_only=True)
class ScriptEvent(RunEvent):
    """Entry of a script that was due.

    event     : what it did, in words
    done      : False if it did nothing
    verdict   : of an entry that ended the run; None: it did not
    used_up   : True: the entry is disabled from now on
    crossed_s, value, unit : when its condition came true, and the value of the quantity then
    element, tie, node : what it cut or released
    energy_taken_J : energy taken by friction of a line that slides at once [J]
    """

    entry: str
    cause: str
    event: str
    done: bool = False
    verdict: str | None = None
    used_up: bool | None = None
    crossed_s: float | None = None
    value: float | None = None
    unit: str | None = None
    element: int | None = None
    tie: str | None = None
    node: int | None = None
    energy_taken_J: float | None = None  # noqa: N815 - the unit


def tagged(event: RunEvent) -> dict[str, Any]:
    """Return an event with the name of its class, in JSON."""
    return {"class": type(event).__name__, **event.as_json()}


def untagged(stored: dict[str, Any]) -> RunEvent:
    """Return the event of what `tagged` gave; raises KeyError, TypeError or ValueError for anything else."""
    kinds: dict[str, type[RunEvent]] = {"RunEvent": RunEvent}
    kinds |= {kind.__name__: kind for kind in RunEvent.__subclasses__()}
    return kinds[stored["class"]](**{name: value for name, value in stored.items() if name != "class"})
