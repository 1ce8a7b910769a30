"""Many steps in compiled code: with equal steps, or with steps chosen from an error estimate.

The text of these functions is copied into a kernel's module, after those of `schemes`. Their
arguments are those of `arrays`: a `Motion` m, or a whole `Run` with the room for the states that the guards
look at, which is filled from `row` on: one step in `every`, the last, and those of so much elastic energy
that an element may be too long. `equal_steps` and `chosen_steps` return the number of rows that are filled;
they return when those are full, when `limit` steps have been tried, or at the end.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from exunet.backends.compiled import schemes, work
from exunet.backends.compiled.schemes import (
    accelerate,
    accelerate_without_spin,
    dormand_prince_step,
    runge_kutta_4_step,
    stages_of,
    unit_attitudes,
    verlet_step,
    verlet_step_in_place,
)
from exunet.backends.compiled.seeing import SEEING, keep, look, see
from exunet.backends.compiled.work import book_push, work_of_step
from exunet.backends.compiled.work_space import EqualSteps
from exunet.codegen.force_table import Takes
from exunet.codegen.generate import in_any_order

TINY_IN_A_ROW = 200.0  # steps of the least length, one after the other, that count as a collapse

if TYPE_CHECKING:  # the generated module holds these beside the functions below
    from exunet.codegen.borrowing import borrowed
    from exunet.codegen.sums import power, remember

    BODIES = True
    FIRST_ORDER = True


def begin(t: float, verlet: bool, m: Any) -> None:
    """Compute the acceleration at the state, where a step before has not left it."""
    own = borrowed(m)
    a1 = stages_of(own.work).a1
    if BODIES and verlet:
        accelerate_without_spin(t, own.x, own.v, own, a1)
    else:
        accelerate(t, own.x, own.v, own, a1)


@in_any_order
def accept(m: Any, half: Any) -> float:
    """Make the step's result the state; returns its kinetic energy [J].

    half : (n_v,) half of the masses and inertias, as `SeenOfSteps.half`
    """
    s = stages_of(m.work)
    total = 0.0
    for c in range(m.x.size):
        m.x[c] = s.x1[c]
    for c in range(m.v.size):
        speed = s.v1[c]
        m.v[c] = speed
        total += half[c] * speed * speed
    if BODIES:
        unit_attitudes(m)
    return total


@in_any_order
def kinetic_energy(v: Any, half: Any) -> float:
    """Kinetic energy [J]; half as that of `accept`."""
    total = 0.0
    for c in range(v.size):
        total += half[c] * v[c] * v[c]
    return total


def jump_ahead(within: float, tolerance: float, t: float, m: Any, seen: Any) -> Any:
    """Return the time until the next jump of the forces and the step across it [s] (see `cable_term`).

    Both infinite without a jump within a time [s] that matters.
    """
    x = m.x
    v = m.v
    a = stages_of(m.work).a1
    after = np.inf
    across = np.inf
    for e in range(seen.first.size):
        if seen.jumps[e] <= 0.0 or seen.stiffness[e] <= 0.0:
            continue
        i = seen.first[e]
        j = seen.second[e]
        dd = 0.0
        dw = 0.0
        ww = 0.0
        db = 0.0
        wb = 0.0
        bb = 0.0
        place = 0.0
        for c in range(3):
            d = x[j + c] - x[i + c]
            w = v[j + c] - v[i + c]
            b = a[j + c] - a[i + c]
            dd += d * d
            dw += d * w
            ww += w * w
            db += d * b
            wb += w * b
            bb += b * b
            place = max(place, abs(x[i + c]), abs(x[j + c]))
        length = seen.length[e]
        distance = math.sqrt(dd)
        reach = distance + within * (math.sqrt(ww) + 0.5 * within * math.sqrt(bb))
        if distance > length * (1.0 + 1e-15) or reach <= length or ww == 0.0:
            continue
        c0 = (distance - length) * (distance + length)
        below = min(c0, 0.0)
        root = math.sqrt(4.0 * dw * dw - 4.0 * ww * below)
        straight = -2.0 * below / (2.0 * dw + root) if dw > 0.0 else (root - 2.0 * dw) / (2.0 * ww)
        time = straight
        for _ in range(6):
            slope = 2.0 * dw + time * (2.0 * (ww + db) + time * (3.0 * wb + time * bb))
            if slope == 0.0:
                break
            time -= (c0 + time * (2.0 * dw + time * (ww + db + time * (wb + time * 0.25 * bb)))) / slope
        if not (0.25 * straight < time < 4.0 * straight):
            time = straight
        parting = (2.0 * dw + time * (2.0 * (ww + db) + time * (3.0 * wb + time * bb))) / (2.0 * length)
        mobility = max(m.inverse[i], m.inverse[j])
        size = 0.5 * seen.jumps[e] * seen.stiffness[e] / length * mobility * parting
        if parting > 0.0 and time <= within and size * within > tolerance and time < after:
            after = time
            surely = 64.0 * 2.220446049250313e-16 * max(t, (place + length) / parting)
            across = min(within, max(tolerance / size, surely))
    return after, across


def equal_steps(verlet: bool, steps: Any, row: int, every: int, run: Any) -> int:
    """Take the steps that an `EqualSteps` names."""
    m, clock, seen, kept, looks = borrowed(run)
    now = clock[0]
    start, until, number, first, limit = steps
    s = stages_of(m.work)
    h = (until - start) / number
    watts = 0.0
    pushed = m.pushed[0] > 0.0
    simpson = m.takes == Takes.INTEGRATED or (m.takes == Takes.TOLD and not verlet)
    if simpson:
        watts = power(start + first * h, m.x, m.v, m.data, s.scratch)
    in_place = verlet and not (simpson or pushed or FIRST_ORDER)
    for step in range(first, min(number, first + limit)):
        t = start + step * h
        end = until if step + 1 == number else start + (step + 1) * h  # to the last bit the next step's t
        if in_place:
            held = verlet_step_in_place(t, h, m)
            kinetic = kinetic_energy(m.v, seen.half)
        else:
            if verlet:
                held = verlet_step(t, h, m)
            else:
                runge_kutta_4_step(t, h, m)
                held, _ = accelerate(end, s.x1, s.v1, m, s.a1)
            if simpson:
                watts = work_of_step(t, h, watts, s.a1, m)
            if pushed:
                book_push(m)
            kinetic = accept(m, seen.half)
        remember(end, m.x, m.v, m.data)
        see(end, held, kinetic, m.x, m.v, seen)
        now["steps"] += 1
        now["time"] = end
        if (step + 1) % every == 0 or step + 1 == number or held > seen.peaks[0]["keep_above"]:
            row = keep(row, end, m, kept)
        ends = looks.at[1] > 0 and look(end, m, looks)
        if ends or row == kept.time.size:
            break
    return row


def chosen_steps(control: Any, until: float, limit: int, row: int, every: int, run: Any) -> int:
    """Dormand-Prince steps to `until`, the largest error estimate of each not above the tolerance.

    `until` is hit by shortened steps, the last two of a stretch made equal, and the length that the control
    had chosen continues after it: the stored states are of full order, which interpolated ones would not be.
    The control is that of Hairer, Norsett and Wanner, "Solving Ordinary Differential Equations I", eq.
    (II.4.13), with growth by 2 at most: a slack net snaps taut within a step, and larger jumps get rejected.
    Where a rejected step had a jump of the forces in its way, steps go to just before it, one goes across it
    whatever its error estimate, and the control continues with the step that it had chosen before. If the way
    to the jump is itself too long a step, the control goes on by itself until it rejects another step.
    """
    m, clock, seen, kept, looks = borrowed(run)
    now = clock[0]
    s = stages_of(m.work)
    least = control.least
    pushed = m.pushed[0] > 0.0
    watts = 0.0
    if m.takes != Takes.NOTHING:
        watts = power(now["time"], m.x, m.v, m.data, s.scratch)
    for _ in range(limit):
        wanted = min(now["step"], control.longest)
        across = False
        if now["beyond"] > 0.0:
            after, over = jump_ahead(now["beyond"], control.tolerance, now["time"], m, seen)
            if after == np.inf:
                if now["rejected"] == 0.0:
                    wanted = now["beyond"]
                now["beyond"] = 0.0
                now["towards"] = 0.0
            elif now["rejected"] == 1.0 and now["towards"] == 1.0:
                now["beyond"] = now["towards"] = 0.0
            else:
                across = after <= over
                wanted = after + over if across else after - max(0.5 * over, 0.01 * after)
                now["towards"] = 1.0
        rest = until - now["time"]
        h = wanted
        if rest <= 1.0000001 * wanted:
            h = rest
        elif rest < 2.0 * wanted:
            h = 0.5 * rest
        error, held = dormand_prince_step(now["time"], h, m)
        error /= control.tolerance
        if not (error <= 1.0 or ((h <= least or across) and error < np.inf)):
            now["rejections"] += 1
            if now["beyond"] == 0.0:
                after, over = jump_ahead(h, control.tolerance, now["time"], m, seen)
                now["beyond"] = h if after < np.inf else 0.0
            now["rejected"] = 1.0
            shrink = 0.2 if error == np.inf else max(0.2, 0.9 * error**-0.2)
            now["step"] = max(least, h * shrink)
            if h <= least:
                now["tiny"] = np.inf
                break
            continue
        now["tiny"] = now["tiny"] + 1.0 if h <= 4.0 * least and not across else 0.0
        if m.takes != Takes.NOTHING:
            watts = work_of_step(now["time"], h, watts, s.a7, m)
        if pushed:
            book_push(m)
        kinetic = accept(m, seen.half)
        remember(until if h == rest else now["time"] + h, m.x, m.v, m.data)
        see(now["time"] + h, held, kinetic, m.x, m.v, seen)
        for c in range(m.push.size):
            s.a1[c] = s.a7[c]
        now["steps"] += 1
        now["time"] = until if h == rest else now["time"] + h
        change = max(0.2, min(1.0 if now["rejected"] == 1.0 else 2.0, 0.9 * max(error, 1e-10) ** -0.2))
        now["rejected"] = 0.0
        now["step"] = max(least, h * change, wanted if h < wanted and error <= 1.0 else 0.0)
        if now["steps"] % every == 0 or now["time"] == until or held > seen.peaks[0]["keep_above"]:
            row = keep(row, now["time"], m, kept)
        ends = looks.at[1] > 0 and look(now["time"], m, looks)
        if ends or row == kept.time.size or now["time"] == until:
            break
    return row


def equal_stretch(verlet: bool, steps: Any, row: int, every: int, held: Any) -> int:
    """`equal_steps` of a `Run` that is a `HeldTuple`: for many short calls from Python."""
    return equal_steps(verlet, steps, row, every, borrowed(held.value))


def chosen_stretch(control: Any, until: float, limit: int, row: int, every: int, held: Any) -> int:
    """`chosen_steps` of a `Run` that is a `HeldTuple`."""
    return chosen_steps(control, until, limit, row, every, borrowed(held.value))


def through_chosen(times: Any, control: Any, most_tiny: float, most: int, run: Any) -> int:
    """`chosen_steps` from times[0] through all `times` [s], the state at each in its row of `kept`.

    most_tiny : steps of the least length, one after the other, before this gives up
    most      : attempted steps, about, before this gives up
    Returns the number of rows that were reached.
    """
    own = borrowed(run)
    m, clock, _, kept, _ = own
    # Not literals, for each of which the called functions would be compiled anew.
    first: Any = np.int64(0)
    never: Any = np.int64(2**62)
    limit: Any = np.int64(1000)
    row = keep(first, times[0], m, kept)
    for k in range(1, times.size):
        while clock[0]["time"] < times[k] and clock[0]["tiny"] <= most_tiny:
            if clock[0]["steps"] + clock[0]["rejections"] > most:
                break
            row = chosen_steps(control, times[k], limit, row, never, own)
        if row == k:
            break
    return row


def through_equal(verlet: bool, times: Any, step: float, run: Any) -> int:
    """As `through_chosen`: `equal_steps`, none longer than `step` [s]."""
    own = borrowed(run)
    m, clock, _, kept, _ = own
    first: Any = np.int64(0)  # not literals, as above
    never: Any = np.int64(2**62)
    row = keep(first, times[0], m, kept)
    for k in range(1, times.size):
        begins, ends = times[k - 1], times[k]
        number = max(1, math.ceil((ends - begins) / step * (1.0 - 1e-9)))
        steps = EqualSteps(begins, ends, number, first, number)
        row = equal_steps(verlet, steps, row, never, own)
        clock[0]["time"] = ends
    return row


IMPORTS = (
    "from exunet.backends.compiled.work_space import EqualSteps, Stages",
    "from exunet.codegen.force_table import Takes",
)
STEPS = (
    schemes.stages_of,
    schemes.add_gyroscopic,
    schemes.accelerate,
    schemes.accelerate_without_spin,
    schemes.turn,
    schemes.first_order_rates,
    schemes.advance_first_order,
    schemes.stage,
    schemes.unit_attitudes,
    schemes.rotate_freely,
    schemes.verlet_step,
    schemes.verlet_step_in_place,
    schemes.runge_kutta_4_step,
    schemes.largest,
    schemes.largest_of_first_order,
    schemes.dormand_prince_step,
    work.middle_of_first_order,
    work.work_of_step,
    work.book_push,
    accept,
    kinetic_energy,
    *SEEING,
    jump_ahead,
    equal_steps,
    chosen_steps,
)
LOOP = (begin, keep, equal_stretch, chosen_stretch, through_chosen, through_equal)
