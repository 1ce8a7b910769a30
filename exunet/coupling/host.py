"""What a host is that a net can be coupled to again and again over the same step, and exunet's own host."""

from __future__ import annotations

import math
from collections.abc import Hashable, Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from exunet.base.arguments import finite_number
from exunet.base.errors import InputError
from exunet.bodies.port import FrameOf, FrameState, PrincipalState
from exunet.coupling.net_system import NetSystem, PortLoad
from exunet.forces.on_bodies import input_name
from exunet.scene.casefile import Case
from exunet.scene.scene import Scene
from exunet.simulation.preparation import start_of
from exunet.simulation.simulation import Simulation

Floats = NDArray[np.float64]


class Host(Protocol):
    """Bodies that a net is tied to, in a model that can be set back exactly.

    A host goes on by `step` alone, and back by `restore` alone: `Cosimulation` compares its `time` with the
    net's after each step, to round-off (a billionth of the macro step), and refuses any other.
    """

    @property
    def time(self) -> float:
        """Time reached [s]: after `step` the time that it was given, after `restore` that of the snapshot."""

    def frames(self) -> dict[str, FrameState]:
        """Where the frames of its ports are, and how they move."""

    def step(self, until: float, loads: Mapping[str, PortLoad]) -> None:
        """Go on to a time [s], and end there, under the mean force and torque of each load.

        A host with steps of its own makes the last one shorter: a force that acts beyond `until`, or not up
        to it, is not the net's impulse.
        """

    def snapshot(self) -> Any:
        """All that it depends on from now on; for files a `Snapshot` of exunet, or arrays by name."""

    def restore(self, snapshot: Any) -> None:
        """Go back to a snapshot; what follows is the same to the last bit."""

    def shared(self) -> tuple[tuple[str, ...], ...]:
        """Ports that are one body, together; a port that has a body of its own need not be named."""

    def finish(self) -> None:
        """Let its own guards, if it has any, look at all states."""


class BodiesHost:
    """A case of exunet whose free bodies a net is tied to: bodies alone, or another net with its bodies.

    case  : with a free body for each port
    ports : names of ports, each with the name of the body that it is; None: alike, all free bodies. Several
            ports may be one body
    """

    def __init__(
        self,
        case: str | Path | Case | Scene,
        overrides: Sequence[str] = (),
        *,
        ports: Mapping[str, str] | None = None,
    ) -> None:
        if ports is not None and not isinstance(ports, Mapping):
            raise InputError(f"BodiesHost: ports: a body's name by the name of each port, got {ports!r}")
        start = start_of(case, overrides)
        moves = zip(start.system.blocks.rigid, start.system.moves_freely, strict=True)
        free = [name for name, is_free in moves if is_free]
        self._bodies = dict(ports) if ports is not None else {name: name for name in free}
        if wrong := [name for name in self._bodies.values() if name not in free]:
            known = ", ".join(free) or "none"
            raise InputError(f"BodiesHost: there is no free body {', '.join(wrong)}: {known}")
        self._sim = Simulation(start, wrenches=tuple(dict.fromkeys(self._bodies.values())))
        numbers = {name: start.system.blocks.rigid.index(body) for name, body in self._bodies.items()}
        self._frames = {name: (k, FrameOf.body(start.system.bodies[k])) for name, k in numbers.items()}

    @classmethod
    def of_ports(cls, net: NetSystem) -> BodiesHost:
        """The bodies of a net's ports by themselves, free, each with the nodes that are fixed to it.

        With it the coupled scene is that of the net's case with motion = "free" in place of "port".
        """
        if not isinstance(net, NetSystem):
            raise InputError(f"BodiesHost.of_ports: an exunet.NetSystem, got {type(net).__name__}")
        return cls(_ports_alone(net))

    @property
    def time(self) -> float:
        """Time reached [s]."""
        return self._sim.time

    @property
    def simulation(self) -> Simulation:
        """The simulation of the bodies, to look at."""
        return self._sim

    def frames(self) -> dict[str, FrameState]:
        """See `Host`."""
        parts = self._sim.view.bodies.parts()
        return {
            name: frame.frame(PrincipalState(*(tuple(part[k].tolist()) for part in parts)))
            for name, (k, frame) in self._frames.items()
        }

    def step(self, until: float, loads: Mapping[str, PortLoad]) -> None:
        """See `Host`."""
        wrenches: dict[str, Floats] = {}
        for name, load in loads.items():
            wrench, body = np.concatenate([load.force, load.torque]), self._bodies[name]
            wrenches[body] = wrenches[body] + wrench if body in wrenches else wrench
        for body, wrench in wrenches.items():
            self._sim.set_input(input_name(body), wrench)
        self._sim.advance_to(until)

    def snapshot(self) -> Any:
        """See `Host`."""
        return self._sim.snapshot()

    def restore(self, snapshot: Any) -> None:
        """See `Host`."""
        self._sim.restore(snapshot)

    def shared(self) -> tuple[tuple[str, ...], ...]:
        """See `Host`."""
        return together(self._bodies)

    def finish(self) -> None:
        """See `Host`."""
        self._sim.settle()


def together(owners: Mapping[str, Hashable]) -> tuple[tuple[str, ...], ...]:
    """Ports by their owners."""
    groups: dict[Hashable, list[str]] = {}
    for port, owner in owners.items():
        groups.setdefault(owner, []).append(port)
    return tuple(map(tuple, groups.values()))


def _ports_alone(net: NetSystem) -> Scene:
    """A scene of free bodies, and of the nodes that are fixed to them."""
    start = net.simulation.start
    scene, system, woven = start.scene, start.system, start.net
    kinematics, rigid = system.kinematics, system.blocks.rigid
    bodies: dict[str, Any] = {}
    for number in kinematics.ports:
        keys = scene.bodies[rigid[number]].model_dump(exclude_unset=True)
        bodies[rigid[number]] = keys | {"motion": "free", "attachments": {}}
    nodes = [k for k, body in enumerate(kinematics.body.tolist()) if body in kinematics.ports]
    for own, k in enumerate(nodes):
        body = system.bodies[kinematics.body[k]]
        point = body.rotation @ kinematics.arm[k] + body.centre
        bodies[body.name]["attachments"][f"node_{own}"] = {"node": own, "point": point.tolist()}
    points = kinematics.point[nodes]
    cable = scene.net.cable.model_dump(exclude_unset=True)
    explicit = {
        "topology": "explicit",
        "nodes": start.position[points].tolist() or [[0.0, 0.0, 0.0]],
        "elements": [],
        "node_masses": woven.mass[points].tolist() or [1.0],
        "cable": cable,
    }
    whole = scene.model_dump(include={"format", "title", "time", "solver", "engine"}, exclude_unset=True)
    gravity = scene.effects.model_dump(include=set(_BY_THE_MASS), exclude_unset=True)
    parts = {"net": explicit, "initial": {"packing": 1.0}, "bodies": bodies, "effects": gravity}
    return Scene.model_validate(whole | parts)


_BY_THE_MASS = ("gravity", "orbit", "j2")  # what acts on bodies wherever they are


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
