"""How long a run will take from here: learned from the pace at which it takes right-hand sides.

Steps concentrate late in a run, when the net is taut, so that simulated time says little. Where the number of
right-hand sides is known beforehand, from equal steps or a trial, what is left of it counts, until the end of
time comes near. Elsewhere two continuations show it: as many per simulated second as lately, or a number that
goes on rising for as long again as it has risen since the start. But folded nets snap taut in bursts, or
start taut and slacken: then the rate falls again, to a tenth of what it was. So the least is a part of the
rate lately or of that since the start, whichever is less. benchmarks/estimates.md shows how far that holds.
"""

from __future__ import annotations

import math
from typing import NamedTuple

_LATELY = 0.2  # of the wall time so far
_KEPT = 200  # looks that are kept; of more, every other is dropped
_STEEPEST = 3.0  # largest power of time by which the number of right-hand sides is continued
# By which as many as lately, or as since the start, may be too many: in runs of folded nets (step_rates.json)
# it was by up to 9.9, where a net that starts taut slackens, and by 4.5 after a burst of snaps.
_FEWER = 10.0
# By which the larger one may be too small: nets snap taut late, which no rate before foretells. In runs
# (tests/data/step_rates.json) it was by up to 4.3 after a quarter of the steps.
_MORE = 5.0
_LIKELY = 1.8  # times the middle of both continuations
_KNOWN = 0.9  # of the expected number, from which on it says nothing more
_NEAR = 8.0  # power of the part of time that has passed, by which the pace then counts too


class Remaining(NamedTuple):
    """What is to be expected from now on: the least, what is likely, the most."""

    least: float
    likely: float
    most: float


class Pace:
    """Looks at a run now and then.

    end      : simulated time at which the run ends [s]
    expected : right-hand sides that the whole run is to take; None: not known
    """

    def __init__(self, end: float, expected: float | None = None) -> None:
        self._end, self._expected = end, expected
        self._looks: list[tuple[float, float, int]] = []

    def look(self, wall: float, time: float, right_hand_sides: int) -> None:
        """At a wall time since the start [s] the run is at a simulated time [s], after so many."""
        self._looks.append((wall, time, right_hand_sides))
        if len(self._looks) > _KEPT:
            del self._looks[1:-1:2]

    def right_hand_sides_left(self) -> Remaining | None:
        """How many are to be expected from now on; None as long as nothing is known."""
        if len(self._looks) < 2:
            return None
        (_, begun, none), (_, now, done), (_, before, fewer) = self._looks[0], self._looks[-1], self._lately()
        if not now > before or done <= fewer:
            return None
        rate, rest, passed = (done - fewer) / (now - before), self._end - now, now - begun
        mean = (done - none) / passed
        power = min(max(rate / mean, 1.0), _STEEPEST)
        rising = min(rest, passed)
        risen = (done - none) * ((1.0 + rising / passed) ** power - 1.0)
        risen += rate * 2.0 ** (power - 1.0) * (rest - rising)
        middle = math.sqrt(rate * rest * risen)
        if self._expected is not None and done < _KNOWN * self._expected and rest > 0.0:
            weight = (passed / (passed + rest)) ** _NEAR
            number = (self._expected - done) ** (1.0 - weight) * middle**weight
            return Remaining(number, number, number)
        return Remaining(min(rate, mean) * rest / _FEWER, _LIKELY * middle, max(rate * rest, risen) * _MORE)

    def left(self) -> Remaining | None:
        """How much wall time is to be expected from now on [s]; None: not known yet."""
        number = self.right_hand_sides_left()
        if number is None:
            return None
        (wall, _, done), (before, _, fewer) = self._looks[-1], self._lately()
        each = (wall - before) / (done - fewer)
        return Remaining(*(each * one for one in number))

    def _lately(self) -> tuple[float, float, int]:
        since = (1.0 - _LATELY) * self._looks[-1][0]
        return next((one for one in reversed(self._looks[:-1]) if one[0] <= since), self._looks[0])
