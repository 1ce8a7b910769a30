"""Consistency of a port's pose and motion with those of its host's body.

With velocities v0 and v1 at the ends of a step H, a velocity that goes from one to the other without turning
back leads away from H (v0 + v1) / 2 by at most H |v1 - v0| / 2; so do integrators of first order, which step
by v0 or by v1. A velocity that turns back in between is known by the acceleration a of the step before, H a.
What is left, such as half a swing between two equal velocities, is within a tenth of the way at the larger
speed as long as a body swings by less than 1 rad in a step. What is farther off is a jump. Attitudes alike,
by the rotation vector and its rates at both ends.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from exunet.base.errors import InputError
from exunet.bodies.port import FrameState, difference
from exunet.coupling.port_loops import port_loops

Floats = NDArray[np.float64]

# Parts of the changes of velocity in this step and the one before, by which, times the step, a way may be
# off: of a host's own states; and of states that a net is told, which may be predicted at constant velocity.
# Such a one is put right in the next step, by as much as the velocity has changed for a host of first order.
OWN, TOLD = 0.5, 1.5
# How far a body may turn in a step [rad], at the larger angular velocity of both ends. Two attitudes tell no
# turn beyond pi, and a force held over the step is far from one that turns with the body.
LARGEST_TURN = 1.0


class Earlier(NamedTuple):
    """A step before, by which accelerations are known.

    states : (n, 13) at its beginning, of which the velocities count
    since  : its length [s]; 0: there was none
    """

    states: Floats
    since: float


# What `exunet.coupling.port_loops.see_ended` asks of a step, and tells of a jump in it.
HostStep = tuple[float, Floats, Floats, float, float, float]
Jump = tuple[int, int, float, float]


def step_of(begin: float, end: float, states: Floats, earlier: Earlier, size: float) -> HostStep:
    """Of a host's own step between two times [s], which begins with states (n, 13); see `refuse_jump`."""
    return end - begin, states, earlier[0], earlier[1], OWN, size


def refuse_jump(
    who: str,
    names: Sequence[str],
    times: tuple[float, float],
    states: tuple[Floats, Floats],
    earlier: Earlier,
    part: float,
    size: float,
) -> None:
    """Raise InputError if a body gets elsewhere in a step than it moves.

    who, names    : for the words of the error, the latter of the bodies (n)
    times, states : where the step begins and ends [s], (n, 13)
    earlier       : the step before
    part          : `OWN` or `TOLD`
    size          : by which round-off of places goes [m]
    """
    jump = port_loops().find_jump(times[1] - times[0], *states, *earlier, part, size)
    refuse_found(who, names, times, jump)


def refuse_found(who: str, names: Sequence[str], times: tuple[float, float], jump: Jump) -> None:
    """As `refuse_jump`, of a jump that was looked for already."""
    number, kind, off, allowed = jump
    if number < 0:
        return
    start, stop = times
    what, unit = ("attitude", "rad") if kind else ("position", "m")
    raise InputError(
        f"{who} {names[number]} jumps: in the step from {start:.6g} s to {stop:.6g} s its {what} is "
        f"{off:.3g} {unit} from where its velocities lead, and accelerations explain {allowed:.3g} {unit}. "
        "Tell the state at the end of the step, use shorter steps if it swings within one, or restore a "
        "snapshot"
    )


def most_turned(times: tuple[float, float], states: tuple[Floats, Floats]) -> tuple[int, float]:
    """The number of the body that turns most in a step, and by how much [rad].

    times, states : as in `refuse_jump`; the larger angular velocity of both counts
    """
    number, turn = port_loops().most_turned(times[1] - times[0], *states)
    return number, turn


def refuse_turn(who: str, names: Sequence[str], times: tuple[float, float], most: tuple[int, float]) -> None:
    """Raise InputError if a body turns too far in a step between two times [s].

    most : as of `most_turned`
    """
    number, turn = most
    if turn <= LARGEST_TURN * (1.0 + 1e-6):
        return
    start, stop = times
    raise InputError(
        f"{who} {names[number]} turns too far: in the step from {start:.6g} s to {stop:.6g} s by "
        f"{turn:.3g} rad, at {turn / (stop - start):.3g} rad/s. More than {LARGEST_TURN:g} rad in a step is "
        "not followed: use shorter steps"
    )


# At the start, in parts of the net's size, of the larger of 1 m/s or 1 rad/s and the speed, or in radians:
# what is left of numbers that were given with six digits.
_SAME = 1e-6
_LEAST_SIZE = 1e-3  # [m], of a net of one node


def apart(one: FrameState, other: FrameState, size: float) -> float:
    """How far apart two places are, in parts of a size [m], or two attitudes [rad]: the larger."""
    angle = math.hypot(*difference(one.attitude, other.attitude))
    return max(math.dist(one.position, other.position) / max(size, _LEAST_SIZE), angle)


def refuse_apart(who: str, name: str, port: FrameState, host: FrameState, size: float) -> None:
    """Raise InputError if a port and its host's body do not start alike."""
    for what, off, unit, scale in (
        ("position", math.dist(port.position, host.position), "m", max(size, _LEAST_SIZE)),
        ("attitude", math.hypot(*difference(port.attitude, host.attitude)), "rad", 1.0),
        ("velocity", math.dist(port.velocity, host.velocity), "m/s", max(1.0, math.hypot(*port.velocity))),
        (
            "angular_velocity",
            math.dist(port.angular_velocity, host.angular_velocity),
            "rad/s",
            max(1.0, math.hypot(*port.angular_velocity)),
        ),
    ):
        if off > _SAME * scale:
            values = " and ".join(_shown(getattr(state, what)) for state in (port, host))
            raise InputError(
                f"{who}: port {name}: its {what} at the start in the case and that in the host differ by "
                f"{off:.3g} {unit}: {values}. Give bodies.{name} the start that it has in the host"
            )


def refuse_elsewhere(
    who: str, time: float, left: Mapping[str, FrameState], found: Mapping[str, FrameState], size: float
) -> None:
    """Raise InputError if a run of the host does not begin where the coupling left its bodies at a time [s].

    size : as in `apart`
    """
    for name, state in left.items():
        if (off := apart(state, found[name], size)) > _SAME:
            raise InputError(
                f"{who}: the run of the host that begins at t = {time:.6g} s has its body at port {name} at "
                f"{_shown(found[name].position)} m, and the one before left it at {_shown(state.position)} m "
                f"({off:.3g} of the net's size or rad): {GOES_ON}"
            )


GOES_ON = (
    "a run goes on from another only if that was by mbs.SolveDynamic(..., updateInitialValues=True), else "
    "Exudyn begins from its first start; or restore a snapshot of the coupling"
)


def _shown(values: tuple[float, ...]) -> str:
    return "[" + ", ".join(f"{value:.9g}" for value in values) + "]"
