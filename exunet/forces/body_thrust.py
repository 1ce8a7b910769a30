"""Thrust on rigid bodies: force and torque over time, by a table or an entry of a script.

Between two instants the force is linear in time, outside them zero; steps end at the instants. Impulse,
angular impulse about the scene's origin and work of all thrust on a body are first-order states.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from exunet.base.arrays import Floats, Ints
from exunet.forces.blocks import Blocks, FirstOrder
from exunet.forces.effects.thrust import PASSED, SINCE, Knots, begun_at
from exunet.forces.from_outside import OUTSIDE, count_force, rate_of_impulse
from exunet.forces.from_outside import states_of as impulses_of
from exunet.forces.loops import in_body_axes, in_scene_axes
from exunet.forces.terms import DiscreteState, KernelTerm

_BURN = 2  # in the discrete state of a scripted thrust: its duration [s], then force and torque (6,)


def source(body: str) -> str:
    """Return the name of the thrust on a body in the balances of momentum."""
    return f"thrust_{body}"


def discrete_name(body: str) -> str:
    """Return the name of the discrete state of a scripted thrust."""
    return f"{OUTSIDE}{source(body)}/scripted"


def states_of(body: str) -> tuple[FirstOrder, ...]:
    """Return impulse, angular impulse and work of all thrust on a body."""
    name = source(body)
    return (*impulses_of(name), FirstOrder(f"{OUTSIDE}{name}/work", (0.0,), "J", gives=1.0))


@dataclass(frozen=True, eq=False)
class Thruster:
    """Where thrust acts on a body.

    arm     : (3,) of the point from the centre of mass, in principal axes [m]
    turn    : (3, 3) from the axes in which loads are given to those of the computation
    in_body : these are the principal axes; else those of the scene
    """

    body: str
    arm: Floats
    turn: Floats
    in_body: bool

    def data(self, blocks: Blocks, times: Floats, loads: Floats, discrete: Floats) -> BodyThrustTable:
        """Return the data of the loop; loads (m, 6) of forces [N] and torques [N m] at times (m,) [s]."""
        where = blocks.centre(self.body), blocks.attitude(self.body), blocks.spin(self.body)
        turned = (loads.reshape(-1, 2, 3) @ self.turn.T).reshape(-1, 6)
        rate, passed = rate_of_impulse(source(self.body), blocks), discrete[[PASSED]].astype(np.int64)
        return BodyThrustTable(*where, self.arm, times, turned, passed, float(self.in_body), rate)

    def term(self, blocks: Blocks, times: Floats, loads: Floats) -> KernelTerm:
        """Return the thrust of a table; see `data`."""
        data = partial(self.data, blocks, times, loads)
        name = f"{OUTSIDE}{source(self.body)}/knots_passed"
        return self._term(DiscreteState(name, begun_at(0.0, times, 1.0), data), Knots(tuple(times.tolist())))

    def scripted(self, blocks: Blocks) -> KernelTerm:
        """Return the thrust that entries of a script set; zero until then."""

        def data(discrete: Floats) -> BodyThrustTable:
            return self.data(blocks, _burn(discrete), np.tile(discrete[_BURN + 1 :], (2, 1)), discrete)

        return self._term(DiscreteState(discrete_name(self.body), np.zeros(_BURN + 7), data), Burn(()))

    def _term(self, discrete: DiscreteState, switch: Knots) -> KernelTerm:
        assert discrete.data is not None
        return KernelTerm(
            "bodies",
            add_body_thrust,
            discrete.data(discrete.initial),
            helpers=(in_body_axes, in_scene_axes, count_force),
            bodies=(self.body,),
            discrete=discrete,
            switch=switch,
            work_kept=True,
        )


def burnt(time: float, duration: float, force: tuple[float, ...], torque: tuple[float, ...]) -> Floats:
    """Return the discrete state of a thrust that begins at a time [s], constant for a duration [s]."""
    return np.array([1.0, time, duration, *force, *torque])


def _burn(discrete: Floats) -> Floats:
    return discrete[SINCE] + np.array([0.0, discrete[_BURN]])


class Burn(Knots):
    """The end of a scripted thrust, which its discrete state gives."""

    def instants(self, discrete: Floats) -> tuple[float, ...]:
        """Return the end of the thrust while it acts."""
        end = float(_burn(discrete)[1])
        return (end,) if discrete[PASSED] == 1.0 and np.isfinite(end) else ()

    def _passed(self, time: float, discrete: Floats) -> float:
        """Two after the end."""
        over = discrete[PASSED] == 1.0 and any(end <= time for end in self.instants(discrete))
        return 2.0 if over else float(discrete[PASSED])


class BodyThrustTable(NamedTuple):
    """Force and torque on a body over time.

    centre, attitude, spin : where the entries of the body begin
    arm     : (3,) of the point from the centre of mass, in principal axes [m]
    times   : (m,) [s]
    loads   : (m, 6) forces [N] and torques [N m] at these times
    passed  : (1,) number of these times passed
    in_body : 1.0: loads are in principal axes; 0.0: in those of the scene
    rate    : where the rates of impulse (3,), angular impulse (3,) and work begin in force
    """

    centre: int
    attitude: int
    spin: int
    arm: Floats
    times: Floats
    loads: Floats
    passed: Ints
    in_body: float
    rate: int


def add_body_thrust(t: float, x: Any, v: Any, thrust: Any, force: Any) -> None:
    """Force at the centre, torque with that of the arm in the body's axes, and the rates of the states."""
    k, times, loads, arm = thrust.passed[0], thrust.times, thrust.loads, thrust.arm
    if k > 0 and k < times.size:
        part = (t - times[k - 1]) / (times[k] - times[k - 1])
        a, b, c = loads[k - 1, 0], loads[k - 1, 1], loads[k - 1, 2]
        a, b, c = a + part * (loads[k, 0] - a), b + part * (loads[k, 1] - b), c + part * (loads[k, 2] - c)
        p, q, r = loads[k - 1, 3], loads[k - 1, 4], loads[k - 1, 5]
        p, q, r = p + part * (loads[k, 3] - p), q + part * (loads[k, 4] - q), r + part * (loads[k, 5] - r)
        d, e, f = a, b, c  # force in the body's axes
        if thrust.in_body > 0.0:
            a, b, c = in_scene_axes(x, thrust.attitude, d, e, f)
        else:
            d, e, f = in_body_axes(x, thrust.attitude, a, b, c)
            p, q, r = in_body_axes(x, thrust.attitude, p, q, r)
        p, q, r = p + arm[1] * f - arm[2] * e, q + arm[2] * d - arm[0] * f, r + arm[0] * e - arm[1] * d
        i, s, rate = thrust.centre, thrust.spin, thrust.rate
        force[i] += a
        force[i + 1] += b
        force[i + 2] += c
        force[s] += p
        force[s + 1] += q
        force[s + 2] += r
        count_force(a, b, c, i, x, rate, force)
        g, h, j = in_scene_axes(x, thrust.attitude, p, q, r)
        force[rate + 3] += g
        force[rate + 4] += h
        force[rate + 5] += j
        force[rate + 6] += a * v[i] + b * v[i + 1] + c * v[i + 2] + p * v[s] + q * v[s + 1] + r * v[s + 2]
