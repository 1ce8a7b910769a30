"""Hosts of a net: the base class, and a case of exunet with the bodies of the ports."""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from exunet.base.arrays import Floats
from exunet.base.errors import InputError
from exunet.bodies.port import FrameOf, FrameState
from exunet.coupling.net_system import NetSystem, PortLoad
from exunet.forces.on_bodies import input_name
from exunet.scene.casefile import Case
from exunet.scene.scene import Scene
from exunet.simulation.preparation import start_of
from exunet.simulation.simulation import Simulation


class Host:
    """Base class of hosts: a model with the bodies that a net is tied to.

    A host defines `time`, `frames` and `step`. Repeated steps and snapshots require `snapshot` and `restore`
    as well. A `Coupler` compares `time` with the net's after each step and each restore, to a billionth of
    the macro step.
    """

    @property
    def time(self) -> float:
        """Time reached [s]: after `step` its end, after `restore` that of the snapshot."""
        raise NotImplementedError

    def frames(self) -> dict[str, FrameState]:
        """Return the present states of the frames of all ports, by name."""
        raise NotImplementedError

    def step(self, until: float, loads: Mapping[str, PortLoad]) -> None:
        """Advance to a time [s], and end there, under the mean force and torque of each load.

        A host with steps of its own shortens the last: a force that acts beyond `until`, or not until then,
        is not the net's impulse.
        """
        raise NotImplementedError

    def snapshot(self) -> Any:
        """Return all that the host depends on from now on; for files a `Snapshot`, or arrays by name."""
        raise InputError(f"{type(self).__name__}: has no snapshots: use iterations=1 without energy")

    def restore(self, snapshot: Any) -> None:
        """Restore a snapshot; the host then continues bitwise."""
        raise InputError(f"{type(self).__name__}: cannot restore snapshots")

    def shared(self) -> tuple[tuple[str, ...], ...]:
        """Return groups of ports that are one body; a port with a body of its own may be omitted."""
        return ()

    def finish(self) -> None:
        """Check all states by the host's own guards, if it has any."""


class BodiesHost(Host):
    """Case of exunet with a free body for each port: bodies alone, or another net with its bodies.

    ports : body by the name of its port; None: all free bodies, by their names. Several ports may be one body
    """

    def __init__(
        self,
        case: str | Path | Case | Scene,
        overrides: Sequence[str] = (),
        *,
        ports: Mapping[str, str] | None = None,
    ) -> None:
        if ports is not None and not isinstance(ports, Mapping):
            raise InputError(
                f"BodiesHost: ports: must be a body's name by the name of each port, got {ports!r}"
            )
        start = start_of(case, overrides)
        moves = zip(start.system.blocks.rigid, start.system.moves_freely, strict=True)
        free = [name for name, is_free in moves if is_free]
        self._bodies = dict(ports) if ports is not None else {name: name for name in free}
        if wrong := [name for name in self._bodies.values() if name not in free]:
            known = ", ".join(free) or "none"
            raise InputError(f"BodiesHost: unknown free body {', '.join(wrong)} (free bodies: {known})")
        self._sim = Simulation(start, wrenches=tuple(dict.fromkeys(self._bodies.values())))
        numbers = {name: start.system.blocks.rigid.index(body) for name, body in self._bodies.items()}
        self._frames = {name: (k, FrameOf.body(start.system.bodies[k])) for name, k in numbers.items()}

    @classmethod
    def of_ports(cls, net: NetSystem) -> BodiesHost:
        """Return a host of the bodies of a net's ports alone, free, each with the nodes that are fixed to it.

        The coupled scene is then that of the net's case with motion = "free" instead of "port".
        """
        if not isinstance(net, NetSystem):
            raise InputError(f"BodiesHost.of_ports: must be an exunet.NetSystem, got {type(net).__name__}")
        return cls(_ports_alone(net))

    @property
    def time(self) -> float:
        return self._sim.time

    @property
    def simulation(self) -> Simulation:
        """Simulation of the bodies, to read."""
        return self._sim

    def frames(self) -> dict[str, FrameState]:
        bodies = self._sim.view.bodies
        return {name: frame.frame_in(bodies, k) for name, (k, frame) in self._frames.items()}

    def step(self, until: float, loads: Mapping[str, PortLoad]) -> None:
        wrenches: dict[str, Floats] = {}
        for name, load in loads.items():
            wrench, body = np.concatenate([load.force, load.torque]), self._bodies[name]
            wrenches[body] = wrenches[body] + wrench if body in wrenches else wrench
        for body, wrench in wrenches.items():
            self._sim.set_input(input_name(body), wrench)
        self._sim.advance_to(until)

    def snapshot(self) -> Any:
        return self._sim.snapshot()

    def restore(self, snapshot: Any) -> None:
        self._sim.restore(snapshot)

    def shared(self) -> tuple[tuple[str, ...], ...]:
        return grouped_by_owner(self._bodies)

    def finish(self) -> None:
        self._sim.settle()


def grouped_by_owner(owners: Mapping[str, Hashable]) -> tuple[tuple[str, ...], ...]:
    """Return groups of ports that have the same owner."""
    groups: dict[Hashable, list[str]] = {}
    for port, owner in owners.items():
        groups.setdefault(owner, []).append(port)
    return tuple(map(tuple, groups.values()))


def _ports_alone(net: NetSystem) -> Scene:
    """Return a scene of the bodies of ports, free, and of the nodes that are fixed to them."""
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
    explicit = {
        "topology": "explicit",
        "nodes": start.position[points].tolist() or [[0.0, 0.0, 0.0]],
        "elements": [],
        "node_masses": woven.mass[points].tolist() or [1.0],
        "cable": scene.net.cable.model_dump(exclude_unset=True),
    }
    whole = scene.model_dump(include={"format", "title", "time", "solver", "engine"}, exclude_unset=True)
    on = {name for name, effect in scene.effects.on.items() if effect.ACCELERATES_ALL}
    fields = scene.effects.model_dump(include=on, exclude_unset=True)
    parts = {"net": explicit, "initial": {"packing": 1.0}, "bodies": bodies, "effects": fields}
    return Scene.model_validate(whole | parts)
