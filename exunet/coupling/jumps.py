"""Whether a body's change of pose over a step agrees with how it moves at both ends of the step.

With velocities v0 and v1 at the ends of a step H, a velocity that goes from one to the other without turning
back leads away from H (v0 + v1) / 2 by at most H |v1 - v0| / 2; so do integrators of first order, which step
by v0 or by v1. A velocity that turns back in between is known by the acceleration a of the step before, H a.
What is left, such as half a swing between two equal velocities, is within a tenth of the way at the larger
speed as long as a body swings by less than 1 rad in a step. What is farther off is a jump. Attitudes alike,
by the rotation vector and its rates at both ends.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from exunet.base.errors import InputError
from exunet.bodies.port import FrameState, PrincipalState, Vector, rotation_between

_OF_WAY = 0.1
# Parts of the changes of velocity in this step and the one before, by which, times the step, a way may be
# off: of a host's own states; and of states that a net is told, which may be predicted at constant velocity.
# Such a one is put right in the next step, by as much as the velocity has changed for a host of first order.
OWN, TOLD = 0.5, 1.5
_ROUND_OFF = 1e-9  # of a turn [rad], and of the sizes in a way
# How far a body may turn in a step [rad], at the larger angular velocity of both ends. Two attitudes tell no
# turn beyond pi, and a force held over the step is far from one that turns with the body.
LARGEST_TURN = 1.0

BodyState = FrameState | PrincipalState


class Accelerations(NamedTuple):
    """Amounts of the mean ones in the step before: [m/s2], [rad/s2]; zero if there was none."""

    of_place: float = 0.0
    of_turning: float = 0.0

    @classmethod
    def between(cls, duration: float, begin: BodyState, end: BodyState) -> Accelerations:
        """From one state to another in a time [s]."""
        return cls(
            math.dist(begin.velocity, end.velocity) / duration,
            math.dist(begin.angular_velocity, end.angular_velocity) / duration,
        )


def refuse_jump(
    who: str,
    times: tuple[float, float],
    states: tuple[BodyState, BodyState],
    last: Accelerations,
    part: float,
    size: float,
) -> None:
    """Raise InputError if a body gets elsewhere in a step than it moves.

    who           : for the words of the error
    times, states : where the step begins and ends [s]
    last          : of the step before
    part          : `OWN` or `TOLD`
    size          : by which round-off of places goes [m]
    """
    (start, stop), (begin, end) = times, states
    step = stop - start
    (a, b, c), (d, e, f) = begin.position, end.position
    way, near = (d - a, e - b, f - c), _ROUND_OFF * max(size, abs(d), abs(e), abs(f))
    off, allowed = _off(step, way, (begin.velocity, end.velocity), last.of_place, part)
    what, unit = "position", "m"
    if off <= allowed + near:
        angle, rate = rotation_between(begin, end)
        off, allowed = _off(step, angle, (begin.angular_velocity, rate), last.of_turning, part)
        what, unit = "attitude", "rad"
        if off <= allowed + _ROUND_OFF:
            return
    raise InputError(
        f"{who} jumps: in the step from {start:.6g} s to {stop:.6g} s its {what} is {off:.3g} {unit} "
        f"from where its velocities lead, and accelerations explain {allowed:.3g} {unit}. Tell the state at "
        "the end of the step, use shorter steps if it swings within one, or restore a snapshot"
    )


def _off(
    step: float, way: Vector, rates: tuple[Vector, Vector], last: float, part: float
) -> tuple[float, float]:
    """How far a way is from that at the mean of the rates at both ends of a step [s], and may be."""
    (a, b, c), (d, e, f) = rates
    half = 0.5 * step
    off = math.hypot(way[0] - half * (a + d), way[1] - half * (b + e), way[2] - half * (c + f))
    change = math.hypot(d - a, e - b, f - c) + step * last
    fastest = max(math.hypot(a, b, c), math.hypot(d, e, f))
    return off, step * (part * change + _OF_WAY * fastest)


def refuse_turn(who: str, times: tuple[float, float], states: tuple[BodyState, BodyState]) -> None:
    """Raise InputError if a body turns too far in a step between two times [s]."""
    (start, stop), (begin, end) = times, states
    both = max(math.hypot(*begin.angular_velocity), math.hypot(*end.angular_velocity))
    turn = both * (stop - start)
    if turn > LARGEST_TURN * (1.0 + 1e-6):
        raise InputError(
            f"{who} turns too far: in the step from {start:.6g} s to {stop:.6g} s by {turn:.3g} rad, at "
            f"{both:.3g} rad/s. More than {LARGEST_TURN:g} rad in a step is not followed: use shorter steps"
        )
