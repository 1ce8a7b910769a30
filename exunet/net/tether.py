"""Tethers, from the net or from a body to a body, as further elements of the net; reels that wind them up.

A tether's own nodes follow those of the net, its elements those of the net. Where it ends at a point of a
body it has a separate node, which the model fixes there (see `exunet.model.initial`).

A tether of n elements of length l is wound up by s: its first k inner nodes lie on the drum, the element
between the drum and the next node, the *outlet*, has the reference length (k + 1) l - s, and the others have
l. Once the outlet is as short as a quarter of an element, its node goes onto the drum and it continues with
the next element; a node comes off the drum when the outlet is half an element longer than an element. So no
element ever shrinks to nothing.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import Field, StringConstraints

from exunet.base.errors import CaseError, Fault, within
from exunet.base.record import Count, Positive, Vector, distinct
from exunet.net.arrays import Floats, Net, TetherNodes
from exunet.net.base import MAX_ELEMENTS, Cable, NodeConfig, NodeName, laws_of
from exunet.net.drive import Drive, DriveConfig, softest

LEAST_OUTLET = 0.25  # of an element; next to a whole one it raises the highest frequency by 1/8
CLOSE = 1e-9  # of an element, within which the outlet counts as having reached that
LARGEST_OUTLET = 1.5  # with which a node comes off, and leaves an outlet of half an element


class Reel(DriveConfig):
    """A drum at an end of the tether that is tied to a body."""

    at: Literal["start", "end"] = Field("start", description="at which end of the tether, one on a body")
    paid_out: Positive | None = Field(
        None, description="length outside at time 0 [m]; absent: all of it", examples=[5.0]
    )
    shortest: Positive | None = Field(
        None,
        description="length outside at which winding stops [m]; absent: a quarter of an element",
        examples=[1.0],
    )

    def faults_on(self, length: float, divisions: int) -> Iterator[Fault]:
        """Yield lengths outside that a tether of a length [m] does not have."""
        least = LEAST_OUTLET * length / divisions
        for key, value in (("paid_out", self.paid_out), ("shortest", self.shortest)):
            if value is not None and not least <= value <= length:
                words = f"must be between {least:.6g} m, a quarter of an element, and length = {length:g} m"
                yield Fault(key, f"{words}, got {value:g} m")
        outside = length if self.paid_out is None else self.paid_out
        if self.shortest is not None and outside < self.shortest <= length:
            yield Fault("shortest", f"is above the {outside:g} m outside at time 0: nothing is wound up")


@dataclass(frozen=True)
class ReeledTether:
    """A reel and the tether on it.

    name     : of the tether
    body     : that has the drum
    nodes    : along the tether, from the node at the drum on
    elements : along the tether, from the drum on
    element_length : reference length of one [m]
    wound    : at time 0 [m]
    on_drum  : number of inner nodes on the drum at time 0
    shortest : length outside at which winding stops [m]
    largest_rate : [m/s]
    times    : of the commands [s]
    drives   : before the first command, and of each
    damping  : of the drive [N s/m]; None: it has no force
    """

    name: str
    body: str
    nodes: tuple[int, ...]
    elements: tuple[int, ...]
    element_length: float
    wound: float
    on_drum: int
    shortest: float
    largest_rate: float
    times: tuple[float, ...]
    drives: tuple[Drive, ...]
    damping: float | None = None

    @property
    def is_commanded(self) -> bool:
        """True if the case has no command for it, so that a script may command it."""
        return not self.times

    @property
    def softest(self) -> Drive:
        """Return the softest drive that a script may request."""
        return softest(self.damping if self.is_commanded else None)

    @property
    def length(self) -> float:
        """Return the length of the whole tether [m]."""
        return self.element_length * len(self.elements)

    @property
    def winds_up(self) -> bool:
        """True if the tether may ever become shorter, by its drives or by a script."""
        return self.is_commanded or any(drive.rate > 0.0 for drive in self.drives)

    @property
    def least_outlet(self) -> float:
        """The least reference length that the outlet may come to, at any time [m]."""
        now, part = self.outlet(self.on_drum, self.wound), self.element_length
        if not self.winds_up:  # a node that comes off the drum leaves an outlet of half an element
            stays = not self.on_drum or all(drive.is_locked for drive in self.drives)
            return now if stays else min(now, (LARGEST_OUTLET - 1.0) * part)
        return LEAST_OUTLET * part if len(self.elements) > 1 else self.shortest

    @property
    def most_on_drum(self) -> int:
        """The largest number of inner nodes that may come to be on the drum, at any time."""
        return len(self.elements) - 1 if self.winds_up else self.on_drum

    def outlet(self, on_drum: int, wound: float) -> float:
        """Reference length of the outlet [m]."""
        return (on_drum + 1) * self.element_length - wound


def reel_of(
    name: str, keys: Reel, body: str, length: float, nodes: tuple[int, ...], elements: tuple[int, ...]
) -> ReeledTether:
    """The reel of a tether of a length [m], whose nodes and elements are listed from its start on."""
    if keys.at == "end":
        nodes, elements = nodes[::-1], elements[::-1]
    number = len(elements)
    part = length / number
    wound = 0.0 if keys.paid_out is None else max(0.0, length - keys.paid_out)
    on_drum = min(number - 1, int(wound / part))
    if (on_drum + 1) * part - wound <= (LEAST_OUTLET + CLOSE) * part and on_drum < number - 1:
        on_drum += 1
    shortest = max(keys.shortest or 0.0, LEAST_OUTLET * part)
    return ReeledTether(
        name,
        body,
        nodes,
        elements,
        part,
        wound,
        on_drum,
        shortest,
        keys.rate_limit,
        keys.times,
        keys.drives,
        keys.damping,
    )


Name = Annotated[str, StringConstraints(pattern=r"^[A-Za-z0-9_-]+$")]


class TetherEnd(NodeConfig):
    """Attachment of an end of a tether."""

    EXACTLY_ONE: ClassVar = ("body", "node", "bullet")

    body: str | None = Field(None, description="name of a body, instead of node", examples=["chaser"])
    point: Vector | None = Field(
        None, description="with body: point in its frame [m]; default: its origin", examples=[[0.5, 0.0, 0.0]]
    )

    def faults(self) -> Iterator[Fault]:
        """Require a body for a point in its frame."""
        if self.point is not None and self.body is None:
            yield Fault("point", "requires body: it is a point in the frame of a body")


class OtherTetherEnd(TetherEnd):
    """The same, with an example of its own."""

    EXACTLY_ONE: ClassVar = ("node", "bullet", "body")

    node: NodeName | None = Field(None, description=NodeConfig.model_fields["node"].description, examples=[1])


class Tether(Cable):
    """A cable between two points: straight at time 0, and slack if they are nearer than its length."""

    length: Positive = Field(
        description="reference length [m], not below the distance between the ends at time 0", examples=[20.0]
    )
    divisions: Count = Field(1, description="elements on the tether")
    start: TetherEnd = Field(description="what its start is tied to")
    end: OtherTetherEnd = Field(description="what its end is tied to, not the same as the start")
    reel: Reel | None = Field(None, description="drum that winds it up and pays it out")

    def faults(self) -> Iterator[Fault]:
        """Require two different ends, and a reel on a body that fits the length."""
        yield from super().faults()
        one, other = self.start, self.end
        if one.__dict__ == other.__dict__ or (one.body is not None and one.body == other.body):
            yield Fault("end", "is tied to the same thing as start: a tether joins two")
        if self.reel is not None:
            if self.law == "table":
                words = "excludes a reel, whose outlet has a law by formula: use another law"
                yield Fault("table", words)
            if getattr(self, self.reel.at).body is None:
                words = f"the {self.reel.at} of the tether is not tied to a body, which a drum requires"
                yield Fault("reel.at", words)
            yield from within("reel", self.reel.faults_on(self.length, self.divisions))


Tethers = Mapping[Name, Tether]


def cross_checks(tethers: Tethers, bodies: Mapping[str, object]) -> Iterator[Fault]:
    """Require distinct names, and bodies that exist."""
    yield from distinct(tethers)
    for name, keys in tethers.items():
        for label, end in (("start", keys.start), ("end", keys.end)):
            if end.body is not None and end.body not in bodies:
                known = ", ".join(bodies) or "none"
                yield Fault(f"{name}.{label}.body", f'unknown body "{end.body}" (bodies: {known})')


@dataclass(frozen=True)
class TiedPoint:
    """A node that is fixed to a point of a body, in its frame [m], and the key that says so."""

    node: int
    body: str
    point: tuple[float, float, float]
    key: str

    @property
    def tie(self) -> str:
        """By which a script knows it: `bodies.NAME.attachments.LABEL`, `tethers.NAME.end`."""
        return self.key.removesuffix(".body") if self.key.startswith("tethers.") else self.key


def with_tethers(net: Net, tethers: Tethers) -> tuple[Net, tuple[TiedPoint, ...]]:
    """The net with the elements of its tethers, and which of their nodes are fixed to bodies.

    Raises CaseError for an end at a node or bullet that is not there, and for too many elements.
    """
    if not tethers:
        return net, ()
    number = net.n_elements + sum(keys.divisions for keys in tethers.values())
    if number > MAX_ELEMENTS:
        words = (
            f"with its tethers the net would have {number:,} elements; at most {MAX_ELEMENTS:,} are allowed"
        )
        most = max(tethers, key=lambda name: tethers[name].divisions)
        raise CaseError([Fault(f"tethers.{most}.divisions", words)])
    for check in (_missing, _one_node):
        if faults := [fault for name, keys in tethers.items() for fault in check(name, keys, net)]:
            raise CaseError(faults)
    tied: list[TiedPoint] = []
    for name, keys in tethers.items():
        net = _with_one(net, name, keys, tied)
    return net, tuple(tied)


def reels_of(net: Net, tethers: Tethers) -> tuple[ReeledTether, ...]:
    """The reels of the tethers that `net` has."""
    found = []
    for tether in net.tethers:
        keys = tethers[tether.name]
        if keys.reel is not None:
            end = keys.start if keys.reel.at == "start" else keys.end
            elements = tuple(net.tether_elements[tether.name])
            assert end.body is not None
            found.append(reel_of(tether.name, keys.reel, end.body, keys.length, tether.nodes, elements))
    return tuple(found)


def _missing(name: str, keys: Tether, net: Net) -> Iterator[Fault]:
    for label, end in (("start", keys.start), ("end", keys.end)):
        if end.body is None:
            try:
                end.node_of(net)
            except ValueError as error:
                yield Fault(f"tethers.{name}.{label}.{end.key}", str(error))


def _one_node(name: str, keys: Tether, net: Net) -> Iterator[Fault]:
    """A bullet without a string is a node of the net too."""
    start, end = keys.start, keys.end
    if start.body is None and end.body is None and (node := end.node_of(net)) == start.node_of(net):
        words = f"is tied to the same node of the net, {node}, as start: a tether joins two"
        yield Fault(f"tethers.{name}.end", words)


def _with_one(net: Net, name: str, keys: Tether, tied: list[TiedPoint]) -> Net:
    new = net.n_nodes
    ends = []
    for label, end in (("start", keys.start), ("end", keys.end)):
        if end.body is not None:
            key = f"tethers.{name}.{label}.body"
            tied.append(TiedPoint(new, end.body, end.point or (0.0, 0.0, 0.0), key))
            ends.append(new)
            new += 1
        else:
            ends.append(end.node_of(net))
    chain = np.array([ends[0], *range(new, new + keys.divisions - 1), ends[1]], dtype=np.int64)
    number = int(np.count_nonzero(chain >= net.n_nodes))
    length = keys.length / keys.divisions
    mass = np.concatenate([net.mass, np.zeros(number)])
    half = 0.5 * keys.density * keys.cross_section * length
    for item in (chain[:-1], chain[1:]):
        np.add.at(mass, item, half)
    # Drawn below what it begins at; no force depends on it, see `exunet.forces.cable.reference_spans`.
    begin = net.reference_position[chain[0]] if chain[0] < net.n_nodes else np.zeros(3)
    along = np.flatnonzero(chain >= net.n_nodes)
    places = begin - np.outer(along * length, [0.0, 0.0, 1.0])
    order = np.argsort(chain[along])
    return _extended(
        net,
        TetherNodes(name, net.n_nodes, tuple(chain.tolist())),
        mass=mass,
        reference_position=np.concatenate([net.reference_position, places[order]]),
        element_nodes=np.concatenate([net.element_nodes, np.stack([chain[:-1], chain[1:]], axis=1)]),
        reference_length=_appended(net.reference_length, length, keys.divisions),
        area=_appended(net.area, keys.cross_section, keys.divisions),
        youngs_modulus=_appended(net.youngs_modulus, keys.modulus, keys.divisions),
        density=_appended(net.density, keys.density, keys.divisions),
        is_string=np.concatenate([net.is_string, np.zeros(keys.divisions, dtype=bool)]),
        **_strength(net, keys),
        **_law(net, name, keys),
    )


def _strength(net: Net, keys: Tether) -> dict[str, Floats]:
    """That of all elements, if any is known."""
    if net.strength is None and keys.allowable is None:
        return {}
    before = np.zeros(net.n_elements) if net.strength is None else net.strength
    return {"strength": _appended(before, keys.allowable or 0.0, keys.divisions)}


def _law(net: Net, name: str, keys: Tether) -> dict[str, Any]:
    """Laws of all elements, if any is not the default."""
    (number,), table = laws_of([keys], net.law_table)
    if net.law_number is None and not number:
        return {}
    before = np.zeros(net.n_elements, dtype=np.int64) if net.law_number is None else net.law_number
    numbers = np.append(before, np.full(keys.divisions, number))
    table_keys = dict(net.table_keys) | ({number: f"tethers.{name}.table"} if number > 1 else {})
    return {"law_number": numbers, "law_table": table, "table_keys": table_keys}


def _appended(values: Floats, value: float, times: int) -> Floats:
    return np.concatenate([values, np.full(times, value)])


def _extended(net: Net, tether: TetherNodes, **arrays: Any) -> Net:
    for array in (value for value in arrays.values() if isinstance(value, np.ndarray)):
        array.flags.writeable = False
    return replace(net, tethers=(*net.tethers, tether), **arrays)
