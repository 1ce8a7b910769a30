"""Reels: drums on bodies that wind a tether up and pay it out, element by element.

A tether of n elements of length l is wound up by s: its first k inner nodes lie on the drum, the element
between the drum and the next node, the *outlet*, has the reference length (k + 1) l - s, and the others have
l. Once the outlet is as short as a quarter of an element, its node goes onto the drum and it continues with
the next element; a node comes off the drum when the outlet is half an element longer than an element. So no
element ever shrinks to nothing.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Annotated, Literal

from pydantic import Field

from exunet.base.errors import Fault
from exunet.base.faults import each
from exunet.base.table import FromArray, NonNegative, Positive, Table

LEAST_OUTLET = 0.25  # of an element; next to a whole one it raises the highest frequency by 1/8
CLOSE = 1e-9  # of an element, within which the outlet counts as having reached that
LARGEST_OUTLET = 1.5  # with which a node comes off, and leaves an outlet of half an element
Mode = Literal["lock", "brake", "rate", "tension"]
_NEEDS = {"lock": (), "brake": ("force",), "rate": ("rate",), "tension": ("force",)}
_WITHOUT_LIMIT = 1e9  # [m/s]
_MAY_HAVE = {"rate": ("force",)}


class Command(Table):
    """What the drive of a reel does from a time on."""

    at: NonNegative = Field(description="from when on [s]", examples=[2.0])
    mode: Mode = Field(description="lock: holds; brake: pays out under more than force; rate: winds; tension")
    rate: float | None = Field(
        None, description="of winding up, negative: of paying out [m/s]; of mode rate", examples=[0.2]
    )
    force: NonNegative | None = Field(
        None, description="above which it gives way, or that it holds [N]; not of mode lock", examples=[20.0]
    )


class ReelKeys(Table):
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
    largest_rate: Positive | None = Field(
        None, description="limit of the rate either way [m/s]; absent: none", examples=[1.0]
    )
    damping: Positive | None = Field(
        None,
        description="force over that of the command, per rate at which the drive gives way [N s/m]",
        examples=[200.0],
    )
    commands: Annotated[tuple[Command, ...], FromArray] = Field(
        (),
        description="in the order of their times; before the first the reel is locked",
        examples=[[{"at": 0.0, "mode": "brake", "force": 20.0}]],
    )


@dataclass(frozen=True)
class Drive:
    """What a command asks for, as numbers of one law: see `exunet.forces.reel_loops.winding_rate`.

    rate      : of winding up without a pull, or up to `force` [m/s]
    force     : [N]
    gives_way : rate of paying out per force above `force` [m/(N s)]
    takes_up  : rate of winding up per force below it [m/(N s)]
    """

    rate: float = 0.0
    force: float = 0.0
    gives_way: float = 0.0
    takes_up: float = 0.0

    @property
    def is_locked(self) -> bool:
        """True if it does not turn, whatever pulls."""
        return self.rate == self.gives_way == 0.0


@dataclass(frozen=True)
class Reel:
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
        """The drive that gives way and takes up the most of all that a script may ask for."""
        give = 0.0 if self.damping is None or not self.is_commanded else 1.0 / self.damping
        return Drive(gives_way=give, takes_up=give)

    @property
    def length(self) -> float:
        """Of the whole tether [m]."""
        return self.element_length * len(self.elements)

    @property
    def winds_up(self) -> bool:
        """True if the tether may ever become shorter, by its drives or by a script."""
        return self.is_commanded or any(one.rate > 0.0 or one.takes_up > 0.0 for one in self.drives)

    @property
    def least_outlet(self) -> float:
        """The least reference length that the outlet may come to, at any time [m]."""
        now, part = self.outlet(self.on_drum, self.wound), self.element_length
        if not self.winds_up:  # a node that comes off the drum leaves an outlet of half an element
            stays = not self.on_drum or all(one.is_locked for one in self.drives)
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
    name: str, keys: ReelKeys, body: str, length: float, nodes: tuple[int, ...], elements: tuple[int, ...]
) -> Reel:
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
    rate = _WITHOUT_LIMIT if keys.largest_rate is None else keys.largest_rate
    drives = (Drive(), *(_drive(one, keys.damping) for one in keys.commands))
    times = tuple(one.at for one in keys.commands)
    return Reel(
        name, body, nodes, elements, part, wound, on_drum, shortest, rate, times, drives, keys.damping
    )


def asked_of(reel: Reel, mode: str, rate: float | None, force: float | None) -> Drive:
    """The drive of a command that a script gives, by the rules of those of a case; raises ValueError."""
    given = {"at": 0.0, "mode": mode, "rate": rate, "force": force}
    command = Command.model_validate({key: value for key, value in given.items() if value is not None})
    keys = ReelKeys.model_validate(
        {"commands": [command]} | ({"damping": reel.damping} if reel.damping else {})
    )
    if faults := list(_of_command(0, command, keys)):
        raise ValueError("; ".join(fault.reason for fault in faults))
    return _drive(command, reel.damping)


def _drive(command: Command, damping: float | None) -> Drive:
    rate, force = command.rate or 0.0, command.force or 0.0
    gives_way = 1.0 / damping if command.force is not None and damping is not None else 0.0
    takes_up = gives_way if command.mode == "tension" else 0.0
    return Drive(rate, force, gives_way, takes_up)


def cross_checks_of_reel(reel: ReelKeys, body: str | None, length: float, divisions: int) -> Iterator[Fault]:
    """What is wrong with a reel at an end that is tied to a body, or to none, of a tether of a length [m]."""
    if body is None:
        yield Fault("at", f"the {reel.at} of the tether is not tied to a body, which a drum needs")
    least = LEAST_OUTLET * length / divisions
    for key, value in (("paid_out", reel.paid_out), ("shortest", reel.shortest)):
        if value is not None and not least <= value <= length:
            words = f"must be between {least:.6g} m, a quarter of an element, and length = {length:g} m"
            yield Fault(key, f"{words}, got {value:g} m")
    outside = length if reel.paid_out is None else reel.paid_out
    if reel.shortest is not None and outside < reel.shortest <= length:
        yield Fault("shortest", f"is above the {outside:g} m outside at time 0: winding would never begin")
    every = (_of_command(k, one, reel) for k, one in enumerate(reel.commands) if one is not None)
    valid = ((k, one) for k, one in enumerate(reel.commands) if one is not None)
    yield from each(*every, *(_in_order(*pair) for pair in pairwise(valid)))


def _in_order(before: tuple[int, Command], after: tuple[int, Command]) -> Iterator[Fault]:
    (_, first), (k, second) = before, after
    if second.at <= first.at:
        words = f"must be greater than the time before it, {first.at:g} s, got {second.at:g}"
        yield Fault(f"commands[{k}].at", words)


def _of_command(number: int, command: Command, reel: ReelKeys) -> Iterator[Fault]:
    where = f"commands[{number}]"
    needs = _NEEDS[command.mode]
    may = (*needs, *_MAY_HAVE.get(command.mode, ()))
    for key in ("rate", "force"):
        value = getattr(command, key)
        if value is None and key in needs:
            yield Fault(where, f'mode "{command.mode}" needs {key}')
        if value is not None and key not in may:
            yield Fault(f"{where}.{key}", f'mode "{command.mode}" has none')
    if command.force is not None and reel.damping is None:
        yield Fault(f"{where}.force", "needs the damping of the reel's drive")
