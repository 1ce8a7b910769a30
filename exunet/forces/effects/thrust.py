"""Thrust: a given force over time on chosen bullets, as of small engines or of a test rig that pulls them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from typing import Annotated, Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from exunet.base.arrays import Floats, Ints
from exunet.base.errors import Fault
from exunet.base.record import FromArray, NonNegative, Number, Vector, increasing, once
from exunet.forces.blocks import Blocks
from exunet.forces.effect import Effect, RestOfCase, existing_bullets
from exunet.forces.estimate import Estimate, EstimateBasis
from exunet.forces.loops import Index
from exunet.forces.terms import Change, DiscreteState, DiscreteStates, KernelTerm, Switch

STATE_NAME = "thrust/knots_passed"
PASSED, SINCE, FACTOR = 0, 1, 2  # in it: how many knots, from when on they count [s], of all forces


class Thrust(Effect):
    """A given force over time on chosen bullets."""

    NEEDS_BULLETS: ClassVar = True
    PUTS_IN: ClassVar = "thrust"

    bullets: Annotated[tuple[Number, ...], FromArray] = Field(
        min_length=1,
        description="numbers of the bullets that it acts on, from 0, each once",
        examples=[[0, 1]],
    )
    time: Annotated[tuple[NonNegative, ...], FromArray] = Field(
        min_length=2,
        description="times [s], at least two, increasing; the force is zero before the first and after "
        "the last",
        examples=[[0.0, 0.5]],
    )
    force: Annotated[tuple[Vector, ...], FromArray] = Field(
        min_length=2,
        description="force on each of the bullets at these times [N], in the scene's axes; linear in between",
        examples=[[[0.0, 0.0, 1.0], [0.0, 0.0, 1.0]]],
    )

    def faults(self) -> Iterator[Fault]:
        """Require increasing times, and a force for each."""
        yield from once("bullets", self.bullets)
        yield from increasing("time", self.time)
        if len(self.force) != len(self.time):
            words = f"requires one vector for each of the {len(self.time)} times, got {len(self.force)}"
            yield Fault("force", words)

    def cross_checks(self, rest: RestOfCase) -> Iterator[Fault]:
        """Require bullets that the net has."""
        yield from existing_bullets(self.bullets, rest)

    def terms(self, blocks: Blocks) -> tuple[KernelTerm, ...]:
        """Return one term over the chosen bullets.

        Its discrete state is the number of the knots passed, so that no step sees a kink; the time from which
        on the knots count [s]; the factor of all forces, which a script may set. Before the first knot (0)
        and after the last (n) there is no force; between the knots k and k + 1 it is linear. Steps end at the
        knots.
        """
        nodes = (3 * blocks.net.bullet_nodes[list(self.bullets)]).astype(Index)
        times, force = np.array(self.time), np.array(self.force)
        initial = begun_at(0.0, times, 1.0)
        data = partial(_data_at, nodes, times, force)
        discrete = DiscreteState(STATE_NAME, initial, data)
        return (KernelTerm("bullets", add_thrust, data(initial), discrete=discrete, switch=Knots(self.time)),)

    def magnitude(self, basis: EstimateBasis) -> Estimate:
        """Estimate the bullets alone under the largest force, and their way under the given force."""
        bullets = basis.net.bullet_nodes[list(self.bullets)]
        mass = basis.net.mass[bullets]
        times = np.clip(np.array(self.time), 0.0, basis.duration)
        force = np.array(self.force)
        largest, way = np.zeros((basis.net.n_nodes, 3)), np.zeros((basis.net.n_nodes, 3))
        largest[bullets, 0] = np.linalg.norm(force, axis=1).max()
        # Each linear piece gives an impulse, and a way until the end, as if in the middle of its time.
        step, mean = np.diff(times)[:, None], 0.5 * (force[1:] + force[:-1])
        late = 0.5 * times[:-1] + 0.5 * times[1:]
        impulse = (step * mean).sum(axis=0)
        moved = (step * mean * (basis.duration - late)[:, None]).sum(axis=0)
        way[bullets] = moved / mass[:, None]
        return Estimate(
            basis.of_force(largest),
            basis.held(basis.rms(way)),
            f"impulse {np.linalg.norm(impulse):.3g} N s on each of {len(bullets)} bullets",
        )


def _data_at(nodes: NDArray[Index], times: Floats, force: Floats, discrete: Floats) -> ThrustTable:
    return ThrustTable(
        nodes, discrete[SINCE] + times, discrete[FACTOR] * force, discrete[[PASSED]].astype(np.int64)
    )


def begun_at(time: float, times: Floats, factor: float) -> Floats:
    """The discrete state of a thrust whose knots count from a time on [s], at that time."""
    return np.array([float(np.searchsorted(times, 0.0, side="right")), time, factor])


def waiting(term: KernelTerm) -> KernelTerm:
    """A thrust that a script lets begin: its switch knows no instant, and the script plans them."""
    assert term.discrete is not None
    assert term.discrete.data is not None
    assert isinstance(term.switch, Knots)
    never = np.array([0.0, np.inf, 1.0])
    discrete, switch = replace(term.discrete, initial=never), Knots(term.switch.knots, known=False)
    return replace(term, data=term.discrete.data(never), discrete=discrete, switch=switch)


class Knots(Switch):
    """The instants at which the thrust has a kink or a jump.

    knots : times [s] from when the thrust begins; known : it begins with the run
    """

    def __init__(self, knots: tuple[float, ...], *, known: bool = True) -> None:
        self.knots = knots
        self.times = knots if known else ()

    def _passed(self, time: float, discrete: Floats) -> float:
        return float(np.searchsorted(discrete[SINCE] + np.array(self.knots), time, side="right"))

    def crossed(self, time: float, x: Floats, v: Floats, discrete: Floats) -> Ints:
        """The only item, if a knot was passed since the discrete state was set."""
        return np.flatnonzero([self._passed(time, discrete) > discrete[PASSED]])

    def change(
        self, time: float, x: Floats, v: Floats, discrete: Floats, items: Ints, every: DiscreteStates
    ) -> Change:
        """Count the knots; nothing else changes."""
        return Change(np.array([self._passed(time, discrete), *discrete[SINCE:]]))


class ThrustTable(NamedTuple):
    """Forces over time.

    bullets : (n,) 3 x node of each bullet
    times   : (m,) the knots [s]
    forces  : (m, 3) on each bullet at the knots [N]
    passed  : (1,) number of knots passed
    """

    bullets: NDArray[Index]
    times: Floats
    forces: Floats
    passed: Ints


def add_thrust(t: float, x: Any, v: Any, thrust: Any, force: Any) -> None:
    """The force between the last knot that was passed and the next, linear in time."""
    bullets, times, forces, passed = thrust
    k = passed[0]
    if k > 0 and k < times.size:
        part = (t - times[k - 1]) / (times[k] - times[k - 1])
        for b in range(bullets.size):
            for axis in range(3):
                start = forces[k - 1, axis]
                force[bullets[b] + axis] += start + part * (forces[k, axis] - start)
