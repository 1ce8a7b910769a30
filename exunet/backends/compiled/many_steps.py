"""Many steps in compiled code: with equal steps, or with steps chosen from an error estimate.

The text of these functions is copied into a kernel's specialised module, after those of `schemes`. Common to
both, beside what is said there:

taken   : (1,) energy [J] that terms without a potential have taken out so far, summed by Simpson's rule on
          the cubic Hermite polynomial of each step
counts  : (2,) accepted and rejected steps so far
seen    : half the mass of each coordinate (n,) [kg]; what was seen of the accepted steps so far (7,): the
          largest elastic and the least kinetic energy [J], the elastic energy above which each step is kept,
          that above which a tension may be the largest, the largest tension [N], its time [s] and element;
          end nodes (m, 2), natural lengths (m,) [m], stiffnesses (m,) [N] and 2 tau (m,) [s] of the elements
kept    : time (k,), x (k, n), v (k, n), taken (k,) of one step in `every`, of the last, and of those of so
          much elastic energy that an element may be too long; for the guards, from `row` on
Both return the number of rows of `kept` that are filled; they return when those are full, when `limit` steps
have been tried, or at the end.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from exunet.backends.compiled.schemes import (
    accelerate,
    dormand_prince_step,
    largest,
    runge_kutta_4_step,
    verlet_step,
)

TINY_IN_A_ROW = 200.0  # steps of the least length, one after the other, that count as a collapse

if TYPE_CHECKING:  # the generated module holds these beside the functions below
    TAKES_ENERGY = False

    def power(t: float, x: Any, v: Any, data: Any, scratch: Any) -> float: ...
    def extra_work(h: float, x0: Any, v0: Any, x1: Any, v1: Any, x2: Any, v2: Any, data: Any) -> float: ...


def work_of_step(
    t: float, h: float, x: Any, v: Any, power_at_start: float, data: Any, work: Any, taken: Any
) -> float:
    """Add to `taken` what the step to (work[1], work[2]) took out; returns the power at its end [W]."""
    x1 = work[1]
    v1 = work[2]
    middle_x = work[13]
    middle_v = work[14]
    for c in range(x.size):
        middle_x[c] = 0.5 * (x[c] + x1[c]) + 0.125 * h * (v[c] - v1[c])
        middle_v[c] = 1.5 * (x1[c] - x[c]) / h - 0.25 * (v[c] + v1[c])
    middle = power(t + 0.5 * h, middle_x, middle_v, data, work[15])
    end = power(t + h, x1, v1, data, work[15])
    taken[0] += h / 6.0 * (power_at_start + 4.0 * middle + end)
    taken[0] += extra_work(h, x, v, middle_x, middle_v, x1, v1, data)
    return end


def accept(x: Any, v: Any, work: Any) -> None:
    """Make the step's result the state."""
    x1 = work[1]
    v1 = work[2]
    for c in range(x.size):
        x[c] = x1[c]
        v[c] = v1[c]


def see(t: float, elastic: float, x: Any, v: Any, seen: Any) -> None:
    """Take a step's end, whose elastic energy [J] is known, into `seen`."""
    half = seen[0]
    extremes = seen[1]
    a = 0.0  # four sums, which the processor can make side by side
    b = 0.0
    c = 0.0
    d = 0.0
    whole = v.size - v.size % 4
    for k in range(0, whole, 4):
        a += half[k] * v[k] * v[k]
        b += half[k + 1] * v[k + 1] * v[k + 1]
        c += half[k + 2] * v[k + 2] * v[k + 2]
        d += half[k + 3] * v[k + 3] * v[k + 3]
    for k in range(whole, v.size):
        a += half[k] * v[k] * v[k]
    kinetic = (a + b) + (c + d)
    if elastic > extremes[0]:
        extremes[0] = elastic
    if kinetic < extremes[1]:
        extremes[1] = kinetic
    if elastic > extremes[3]:
        see_tensions(t, x, v, seen)


def see_tensions(t: float, x: Any, v: Any, seen: Any) -> None:
    """Take the largest tension into `seen`, and the least elastic energy with which there may be a larger.

    N = EA E11 sqrt(1 + 2 E11) <= EA E11 (1 + E11), so an element that pulls by N has at least the energy of
    the strain that makes the latter N. Viscous stress needs no energy: there each taut state is looked at.
    """
    extremes = seen[1]
    ends = seen[2]
    largest_before = extremes[4]
    viscous = False
    for e in range(ends.shape[0]):
        i = 3 * ends[e, 0]
        j = 3 * ends[e, 1]
        square = 0.0
        along = 0.0
        for c in range(3):
            d = x[j + c] - x[i + c]
            square += d * d
            along += d * (v[j + c] - v[i + c])
        length = seen[3][e]
        excess = square - length * length
        if excess > 0.0:
            viscous = viscous or seen[5][e] > 0.0
            tension = seen[4][e] * (excess + seen[5][e] * along) * math.sqrt(square) / (2.0 * length**3)
            if tension > extremes[4]:
                extremes[4] = tension
                extremes[5] = t
                extremes[6] = e
    if extremes[4] > largest_before and not viscous:
        least = np.inf
        for e in range(ends.shape[0]):
            if seen[4][e] > 0.0:
                strain = 0.5 * (math.sqrt(1.0 + 4.0 * extremes[4] / seen[4][e]) - 1.0)
                least = min(least, 0.5 * seen[4][e] * seen[3][e] * strain * strain)
        extremes[3] = least


def keep(row: int, t: float, x: Any, v: Any, taken: Any, kept: Any) -> int:
    """Copy a state into a row of `kept`; returns the next row."""
    kept[0][row] = t
    kept[3][row] = taken[0]
    for c in range(x.size):
        kept[1][row, c] = x[c]
        kept[2][row, c] = v[c]
    return row + 1


def equal_steps(
    verlet: bool,
    start: float,
    until: float,
    number: int,
    first: int,
    limit: int,
    row: int,
    x: Any,
    v: Any,
    inverse: Any,
    data: Any,
    work: Any,
    taken: Any,
    counts: Any,
    seen: Any,
    every: int,
    kept: Any,
) -> int:
    """Steps number `first`, ... of the `number` equal steps from `start` to `until`, at most `limit`."""
    h = (until - start) / number
    watts = 0.0
    if TAKES_ENERGY:
        watts = power(start + first * h, x, v, data, work[15])
    for step in range(first, min(number, first + limit)):
        t = start + step * h
        end = until if step + 1 == number else start + (step + 1) * h  # to the last bit the next step's t
        if verlet:
            held = verlet_step(t, h, x, v, inverse, data, work)
        else:
            runge_kutta_4_step(t, h, x, v, inverse, data, work)
            held = accelerate(end, work[1], work[2], inverse, data, work[0])
        if TAKES_ENERGY:
            watts = work_of_step(t, h, x, v, watts, data, work, taken)
        accept(x, v, work)
        see(end, held, x, v, seen)
        counts[0] += 1
        if (step + 1) % every == 0 or step + 1 == number or held > seen[1][2]:
            row = keep(row, end, x, v, taken, kept)
            if row == kept[0].size:
                break
    return row


def chosen_steps(
    clock: Any,
    until: float,
    tolerance: float,
    longest: float,
    least: float,
    limit: int,
    row: int,
    x: Any,
    v: Any,
    inverse: Any,
    data: Any,
    work: Any,
    taken: Any,
    counts: Any,
    seen: Any,
    every: int,
    kept: Any,
) -> int:
    """Dormand-Prince steps to `until`, the largest error estimate of each not above `tolerance` [m, m/s].

    clock : (4,) time [s]; the step to try next [s]; 1 after a rejected step, else 0; number of steps in a row
            that were of the length `least`, at which no error is too large

    `until` is hit by shortened steps, the last two of a stretch made equal, and the length that the control
    had chosen goes on after it: so the stored states are of full order, which interpolated ones would not be.
    The control is that of Hairer, Norsett and Wanner, "Solving Ordinary Differential Equations I", eq.
    (II.4.13), with growth by 2 at most: a slack net snaps taut within a step, and larger jumps get rejected.
    """
    watts = 0.0
    if TAKES_ENERGY:
        watts = power(clock[0], x, v, data, work[15])
    for _ in range(limit):
        wanted = min(clock[1], longest)
        rest = until - clock[0]
        h = wanted
        if rest <= 1.0000001 * wanted:
            h = rest
        elif rest < 2.0 * wanted:
            h = 0.5 * rest
        error, held = dormand_prince_step(clock[0], h, x, v, inverse, data, work)
        error /= tolerance
        if not (error <= 1.0 or (h <= least and error < np.inf)):
            counts[1] += 1
            clock[2] = 1.0
            shrink = 0.2 if error == np.inf else max(0.2, 0.9 * error**-0.2)
            clock[1] = max(least, h * shrink)
            if h <= least:
                clock[3] = np.inf
                break
            continue
        clock[3] = clock[3] + 1.0 if error > 1.0 else 0.0
        if TAKES_ENERGY:
            watts = work_of_step(clock[0], h, x, v, watts, data, work, taken)
        accept(x, v, work)
        see(clock[0] + h, held, x, v, seen)
        for c in range(x.size):
            work[0, c] = work[9, c]
        counts[0] += 1
        clock[0] = until if h == rest else clock[0] + h
        change = max(0.2, min(1.0 if clock[2] == 1.0 else 2.0, 0.9 * max(error, 1e-10) ** -0.2))
        clock[2] = 0.0
        clock[1] = max(least, h * change, wanted if h < wanted and error <= 1.0 else 0.0)
        if counts[0] % every == 0 or clock[0] == until or held > seen[1][2]:
            row = keep(row, clock[0], x, v, taken, kept)
            if row == kept[0].size:
                break
        if clock[0] == until:
            break
    return row


def through_chosen(
    times: Any,
    tolerance: float,
    longest: float,
    least: float,
    most_tiny: float,
    clock: Any,
    x: Any,
    v: Any,
    inverse: Any,
    data: Any,
    work: Any,
    taken: Any,
    counts: Any,
    seen: Any,
    kept: Any,
) -> int:
    """`chosen_steps` from times[0] through all `times` [s], the state at each in its row of `kept`.

    most_tiny : steps of the length `least`, one after the other, before this gives up
    Returns the number of rows that were reached.
    """
    never = 2**62
    row = keep(0, times[0], x, v, taken, kept)
    for k in range(1, times.size):
        while clock[0] < times[k] and clock[3] <= most_tiny:
            row = chosen_steps(
                clock,
                times[k],
                tolerance,
                longest,
                least,
                1000,
                row,
                x,
                v,
                inverse,
                data,
                work,
                taken,
                counts,
                seen,
                never,
                kept,
            )
        if row == k:
            break
    return row


def through_equal(
    verlet: bool,
    times: Any,
    step: float,
    clock: Any,
    x: Any,
    v: Any,
    inverse: Any,
    data: Any,
    work: Any,
    taken: Any,
    counts: Any,
    seen: Any,
    kept: Any,
) -> int:
    """As `through_chosen`: `equal_steps`, none longer than `step` [s]."""
    never = 2**62
    row = keep(0, times[0], x, v, taken, kept)
    for k in range(1, times.size):
        number = max(1, math.ceil((times[k] - times[k - 1]) / step * (1.0 - 1e-9)))
        row = equal_steps(
            verlet,
            times[k - 1],
            times[k],
            number,
            0,
            number,
            row,
            x,
            v,
            inverse,
            data,
            work,
            taken,
            counts,
            seen,
            never,
            kept,
        )
        clock[0] = times[k]
    return row


LOOP = (
    accelerate,
    verlet_step,
    runge_kutta_4_step,
    largest,
    dormand_prince_step,
    work_of_step,
    accept,
    see_tensions,
    see,
    keep,
    equal_steps,
    chosen_steps,
    through_chosen,
    through_equal,
)
