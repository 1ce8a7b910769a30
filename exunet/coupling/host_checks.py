"""What a coupling asks of a host before it believes it: methods, time, bodies, and what they share."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from exunet.base.arguments import finite_number
from exunet.base.errors import InputError
from exunet.bodies.port import FrameState
from exunet.coupling.host import Host
from exunet.coupling.net_system import NetSystem

# By which the times of net and host may differ: of the macro step, and of round-off at a late time.
_OF_STEP, _ULPS = 1e-9, 4.0
_ASKED = ("time", "frames", "step", "snapshot", "restore", "shared", "finish")  # what `Host` has


def refuse_no_host(net: object, host: object) -> None:
    """Raise InputError for what is no net, or lacks what a host has."""
    if not isinstance(net, NetSystem):
        raise InputError(f"Cosimulation: net: an exunet.NetSystem, got {type(net).__name__}")
    if missing := [name for name in _ASKED if not hasattr(host, name)]:
        raise InputError(
            f"Cosimulation: host: a {type(host).__name__} has no {', '.join(missing)}, which "
            "exunet.coupling.host.Host says what they are; for an Exudyn system exunet.ExudynHost, for the "
            "bodies of the net's own ports exunet.BodiesHost.of_ports(net)"
        )


def time_of(host: Host) -> float:
    """Time that a host has reached [s]; raises InputError if it tells none."""
    time = finite_number(host.time)
    if time is None:
        raise InputError(f"Cosimulation: {_named(host)} tells no time: {host.time!r}")
    return time


def same_time(one: float, other: float, step: float) -> bool:
    """True if two times [s] differ by no more than round-off beside a macro step [s]."""
    return abs(one - other) <= _OF_STEP * step + _ULPS * math.ulp(other)


def refuse_other_end(host: Host, begin: float, until: float, step: float) -> None:
    """Raise InputError if a host's step from a time to another [s] has led to a third.

    step : macro step [s] that was asked for, of which round-off is a part
    """
    time = time_of(host)
    if same_time(time, until, step):
        return
    if same_time(time, begin, step):
        how = "it has stood still"
    elif time < begin:
        how = "it went back in time"
    else:
        how = "it ended too " + ("early" if time < until else "late")
    raise InputError(
        f"Cosimulation: {_named(host)} was asked to step from t = {begin:.9g} s to {until:.9g} s and is at "
        f"{time:.9g} s: {how}. Its `step` has to end at the time that it is given, with a shorter last "
        "step of its own where it needs one: the net's impulse is for that time"
    )


def refuse_not_back(host: Host, time: float, step: float, *, moved: bool) -> None:
    """Raise InputError if a host was to go back to a time [s] by its `restore`, and did not.

    step  : as in `refuse_other_end`
    moved : its bodies are not where they were then
    """
    found = time_of(host)
    if moved or not same_time(found, time, step):
        where = "; its bodies are not where they were" if moved else ""
        raise InputError(
            f"Cosimulation: {_named(host)} was to go back to t = {time:.9g} s by its `restore`, and is at "
            f"{found:.9g} s{where}: a step can be repeated only from where it began"
        )


def told_frames(host: Host) -> Mapping[str, FrameState]:
    """What a host tells of its bodies; raises InputError if that is nothing by name."""
    found: Any = host.frames()
    if not isinstance(found, Mapping):
        raise InputError(
            f"Cosimulation: {_named(host)} tells no bodies: its `frames` gave {type(found).__name__}, not "
            "a FrameState by the name of each port"
        )
    return found


def shared_by(host: Host, ports: Sequence[str]) -> tuple[tuple[str, ...], ...]:
    """Which of these ports are one body of the host's, together; raises InputError if it does not tell."""
    told: Any = host.shared()
    groups: list[Any] = list(told) if isinstance(told, Sequence) else [None]
    if any(isinstance(group, str) or not isinstance(group, Sequence) for group in groups):
        raise InputError(
            f"Cosimulation: {_named(host)}: its `shared` gave {told!r}, not groups of ports that are one "
            "body each; () if there are none"
        )
    return tuple(tuple(name for name in group if name in ports) for group in groups)


def _named(host: Host) -> str:
    return f"the host, a {type(host).__name__},"
