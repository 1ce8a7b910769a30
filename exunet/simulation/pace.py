"""How long a run will take from here: learned from the pace at which it takes right-hand sides.

Steps concentrate late in a run, when the net is taut, so that simulated time says little. Where the number of
right-hand sides is known beforehand, from equal steps or a trial, what is left of it counts, until the end of
time comes near. Elsewhere two continuations bound it: as many per simulated second as lately, or a number
that goes on rising for as long again as it has risen since the start. benchmarks/estimates.md shows how far
that holds.
"""

from __future__ import annotations

import math

_LATELY = 0.2  # of the wall time so far
_KEPT = 200  # looks that are kept; of more, every other is dropped
_STEEPEST = 3.0  # largest power of time by which the number of right-hand sides is continued
_FEWER = 1.5  # by which the smaller continuation may be too large still
# By which the larger one may be too small: nets snap taut late, which no rate before foretells. In runs
# (tests/data/step_rates.json) it was by up to 4.3 after a quarter of the steps.
_MORE = 5.0
_KNOWN = 0.9  # of the expected number, from which on it says nothing more
_NEAR = 8.0  # power of the part of time that has passed, by which the pace then counts too


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

    def right_hand_sides_left(self) -> tuple[float, float] | None:
        """The least and the most that are to be expected from now on; None as long as nothing is known."""
        if len(self._looks) < 2:
            return None
        (_, begun, none), (_, now, done), (_, before, fewer) = self._looks[0], self._looks[-1], self._lately()
        if not now > before or done <= fewer:
            return None
        rate, rest, passed = (done - fewer) / (now - before), self._end - now, now - begun
        power = min(max(rate * passed / max(done - none, 1), 1.0), _STEEPEST)
        rising = min(rest, passed)
        risen = (done - none) * ((1.0 + rising / passed) ** power - 1.0)
        risen += rate * 2.0 ** (power - 1.0) * (rest - rising)
        if self._expected is not None and done < _KNOWN * self._expected and rest > 0.0:
            weight = (passed / (passed + rest)) ** _NEAR
            number = (self._expected - done) ** (1.0 - weight) * math.sqrt(rate * rest * risen) ** weight
            return number, number
        return min(rate * rest, risen) / _FEWER, max(rate * rest, risen) * _MORE

    def left(self) -> tuple[float, float] | None:
        """The least and the most wall time that is to be expected from now on [s]; None: not known yet."""
        number = self.right_hand_sides_left()
        if number is None:
            return None
        (wall, _, done), (before, _, fewer) = self._looks[-1], self._lately()
        each = (wall - before) / (done - fewer)
        return each * number[0], each * number[1]

    def _lately(self) -> tuple[float, float, int]:
        since = (1.0 - _LATELY) * self._looks[-1][0]
        return next((one for one in reversed(self._looks[:-1]) if one[0] <= since), self._looks[0])
