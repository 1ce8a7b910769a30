"""Corner units: control laws from sensors to thrust, and thrusters as a force term.

What is demanded goes through three stages, in this order: the direction that the thrusters have, the largest
thrust, the minimum impulse.

Vectors of the units stand in lists, x, y, z of each unit after those of the one before: of the few numbers of
some units, between steps that have taken the processor's caches, arithmetic one by one takes a third of what
it takes with arrays.

At a sample, an instant at which a step ends, the controller looks at the units and sets the forces that act
until the next sample (zero-order hold). So the force in a period depends on the state at its beginning alone.
What each unit has spent, the integral of the magnitude of its force, and the work of all are first-order
states.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Annotated, Any, ClassVar, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field

from exunet.base.arrays import Floats, Ints
from exunet.base.errors import Fault, InputError
from exunet.base.record import FromArray, NonNegative, Number, Positive, Record, Vector, increasing, once
from exunet.base.times import reached
from exunet.forces.blocks import Blocks, FirstOrder
from exunet.forces.effect import RestOfCase, existing_body, existing_bullets
from exunet.forces.from_outside import count_force, rate_of_impulse
from exunet.forces.loops import Index
from exunet.forces.terms import Change, DiscreteState, DiscreteStates, KernelTerm, Switch

MOST_SAMPLES = 1_000_000
_SAME = 1e-9  # of the largest offset: a mean that counts as zero


class Noise(Record):
    """Errors of the units' sensors: normal, independent in each axis, of each unit, at each sample."""

    position: NonNegative = Field(description="standard deviation of a coordinate [m]", examples=[0.01])
    velocity: NonNegative = Field(
        description="standard deviation of a component of the velocity [m/s]", examples=[0.005]
    )
    seed: Annotated[int, Field(ge=0, lt=2**63)] = Field(description="seed of the noise", examples=[1])


class Control(Record):
    """Corner units, bullets with thrusters, commanded at a period; subclasses are the controllers."""

    TABLE: ClassVar = "control"
    kind: str
    bullets: Annotated[tuple[Number, ...], FromArray] = Field(
        min_length=1, description="numbers of the bullets that are units, from 0", examples=[[0, 1]]
    )
    period: Positive = Field(
        description="time between two samples [s]; the forces are constant in between; at most "
        "1,000,000 samples",
        examples=[0.1],
    )
    largest_thrust: Positive = Field(description="limit of the thrust of each unit [N]", examples=[1.0])
    minimum_impulse: NonNegative = Field(
        0.0, description="thrusts of less impulse in a period are not fired [N s]"
    )
    specific_impulse: Positive | None = Field(
        None,
        description="specific impulse, for the propellant spent [s]; the mass of the unit is constant",
        examples=[220.0],
    )
    direction: Literal["any", "flight", "outward"] = Field(
        "any",
        description="any; flight: along the unit's velocity, either way; outward: along the line from the "
        "units' mean to the unit, either way",
    )
    start: NonNegative = Field(
        0.0, description="time of the first sample [s]; not with a script that starts the control"
    )
    noise: Noise | None = Field(None, description="errors of the units' sensors")

    def faults(self) -> Iterator[Fault]:
        """Require each unit once, a mean of two units for `outward`, and thrusters that can fire."""
        yield from once("bullets", self.bullets)
        if self.direction == "outward" and len(self.bullets) < 2:
            yield Fault("direction", "outward is from the mean of the units: it requires at least two")
        most = self.largest_thrust * self.period
        if self.minimum_impulse > most:
            words = f"no thrust is ever fired: the largest gives {most:g} N s in a period"
            yield Fault("minimum_impulse", words, against=("largest_thrust", "period"))

    @property
    def target(self) -> str | None:
        """Name of the body that the units go to; None: no body."""
        return None


class PointControl(Control):
    """Units go to a point, or to a body."""

    EXACTLY_ONE: ClassVar = ("point", "body")

    kind: Literal["point"] = Field(description="to a point or a body", examples=["point"])
    point: Vector | None = Field(None, description="target position, at rest [m]", examples=[[0.0, 0.0, 5.0]])
    body: str | None = Field(
        None, description="name of the body whose centre of mass is the target", examples=["target"]
    )
    offset: Vector | None = Field(
        None,
        description="with body: added to its centre of mass, in the scene's axes [m]",
        examples=[[0.0, 0.0, 1.0]],
    )
    stiffness: NonNegative = Field(description="k, force per distance from the target [N/m]", examples=[1.0])
    damping: NonNegative = Field(
        description="c, force per velocity relative to the target [N s/m]", examples=[2.0]
    )

    def faults(self) -> Iterator[Fault]:
        """Require a body for an offset from its centre."""
        yield from super().faults()
        if self.offset is not None and self.body is None:
            yield Fault("offset", "is from the centre of a body: give body, or add it to point")

    @property
    def target(self) -> str | None:
        """Name of the body that the units go to; None: no body."""
        return self.body


class FormationControl(Control):
    """Units go to places about their mean, or about a body."""

    kind: Literal["formation"] = Field(description="to places about the units' mean, or about a body")
    offsets: Annotated[tuple[Vector, ...], FromArray] = Field(
        description="target position of each unit from the centre of mass of the body, or from the "
        "units' mean, in the scene's axes [m]; without a body their mean is zero",
        examples=[[[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0]]],
    )
    body: str | None = Field(
        None,
        description="name of the body that the formation surrounds; absent: the units' mean",
        examples=["target"],
    )
    stiffness: NonNegative = Field(description="k, force per distance from the target [N/m]", examples=[1.0])
    damping: NonNegative = Field(
        description="c, force per velocity relative to the target [N s/m]", examples=[2.0]
    )

    def faults(self) -> Iterator[Fault]:
        """Require an offset for each unit, of zero mean without a body."""
        yield from super().faults()
        if len(self.offsets) != len(self.bullets):
            words = f"requires a vector for each of the {len(self.bullets)} units, got {len(self.offsets)}"
            yield Fault("offsets", words)
        elif self.body is None:
            places = np.array(self.offsets)
            mean = places.mean(axis=0)
            if np.abs(mean).max() > _SAME * np.abs(places).max():
                words = "their mean must be zero without body, since they are from the units' mean"
                yield Fault("offsets", f"{words}; it is {mean}")

    @property
    def target(self) -> str | None:
        """Name of the body that the units go to; None: no body."""
        return self.body


class TableControl(Control):
    """Forces over time."""

    kind: Literal["table"] = Field(description="forces over time")
    time: Annotated[tuple[NonNegative, ...], FromArray] = Field(
        min_length=2,
        description="times [s], at least two, increasing; the force is zero before the first and "
        "after the last",
        examples=[[0.0, 0.5]],
    )
    force: Annotated[tuple[Annotated[tuple[Vector, ...], FromArray], ...], FromArray] = Field(
        min_length=2,
        description="at each of these times a force on each unit [N], linear in between",
        examples=[[[[0.0, 0.0, 1.0]], [[0.0, 0.0, 1.0]]]],
    )

    def faults(self) -> Iterator[Fault]:
        """Require increasing times, and a force on each unit at each time."""
        yield from super().faults()
        yield from increasing("time", self.time)
        if len(self.force) != len(self.time):
            words = f"requires forces for each of the {len(self.time)} times, got {len(self.force)}"
            yield Fault("force", words)
        for k, forces in enumerate(self.force):
            if len(forces) != len(self.bullets):
                words = f"requires a vector for each of the {len(self.bullets)} units, got {len(forces)}"
                yield Fault(f"force[{k}]", words)


class GivenControl(Control):
    """A function from Python."""

    kind: Literal["given"] = Field(description="a function, Simulation(case, controller=function)")


AnyControl = Annotated[
    PointControl | FormationControl | TableControl | GivenControl, Field(discriminator="kind")
]


def cross_checks(keys: Control, rest: RestOfCase, *, scripted: bool) -> Iterator[Fault]:
    """Require units and bodies that exist, and samples within the run.

    scripted : an entry of the script begins the control
    """
    if not rest.has_bullets:
        yield Fault("", "commands bullets, and the net has none: add [net.bullets] or remove this table")
    yield from existing_bullets(keys.bullets, rest)
    yield from existing_body("body", keys.target, rest)
    if scripted and keys.is_given("start"):
        yield Fault("start", "an entry of the script begins the control: remove it, or this key")
    if reached(keys.start, rest.duration):
        yield Fault("start", f"must be before time.end, {rest.duration:g} s, got {keys.start:g} s")
    number = rest.duration / keys.period
    if number > MOST_SAMPLES:
        words = f"to {rest.duration:g} s these are {number:.3g} samples; at most {MOST_SAMPLES:,} are allowed"
        yield Fault("period", words)


Numbers = list[float]


@dataclass(frozen=True)
class Sensed:
    """Measurements of a controller at a sample.

    time               : [s]
    position, velocity : (3 n) of the units, with the errors of their sensors [m], [m/s]
    centre, drift      : (3) centre of mass of the body and its velocity, without errors [m], [m/s]; zeros of
                         a law that looks at none
    """

    time: float
    position: Numbers
    velocity: Numbers
    centre: Numbers
    drift: Numbers


def with_noise(
    noise: Noise | None, bullets: tuple[int, ...], sample: int, position: Numbers, velocity: Numbers
) -> tuple[Numbers, Numbers]:
    """Places and velocities (3 n) as measured by the sensors at the sample of a number.

    The errors depend on seed, sample and bullet alone, so no state of a generator is to be kept.
    """
    if noise is None:
        return position, velocity
    generator = np.random.Generator(np.random.Philox(key=noise.seed, counter=(0, 0, 0, sample)))
    errors = generator.standard_normal((max(bullets) + 1, 6))[list(bullets)]
    return (
        _wrong_by(position, noise.position, errors[:, :3].ravel().tolist()),
        _wrong_by(velocity, noise.velocity, errors[:, 3:].ravel().tolist()),
    )


def _wrong_by(values: Numbers, deviation: float, errors: Numbers) -> Numbers:
    return [value + deviation * error for value, error in zip(values, errors, strict=True)]


@dataclass(frozen=True, eq=False)
class UnitLaw:
    """The law of a case: what it asks for."""

    keys: Control

    def demanded(self, sensed: Sensed) -> Numbers:
        """(3 n) the force on each unit that it asks for [N]; none of kind "given"."""
        keys = self.keys
        if isinstance(keys, TableControl):
            return self._of_table(sensed.time)
        if not isinstance(keys, PointControl | FormationControl):
            return [0.0] * len(sensed.position)
        k, c = keys.stiffness, keys.damping
        places, speeds = self._goal(sensed)
        return [
            k * (place - x) + c * (speed - v)
            for place, x, speed, v in zip(places, sensed.position, speeds, sensed.velocity, strict=True)
        ]

    def _of_table(self, time: float) -> Numbers:
        """Linear between the times of the table, zero outside."""
        times, forces = self._table
        if not (reached(time, times[0]) and reached(times[-1], time)):
            return [0.0] * forces.shape[1]
        time = min(max(time, times[0]), times[-1])
        k = min(int(np.searchsorted(times, time, side="right")), len(times) - 1)
        part = (time - times[k - 1]) / (times[k] - times[k - 1])
        found: Numbers = (forces[k - 1] + part * (forces[k] - forces[k - 1])).tolist()
        return found

    def _goal(self, sensed: Sensed) -> tuple[Numbers, Numbers]:
        """Where each unit is to be [m], and with what velocity [m/s]; (3 n)."""
        units = len(self.keys.bullets)
        if isinstance(self.keys, PointControl) and self.keys.body is None:
            return self._places, [0.0] * (3 * units)
        centre, drift = sensed.centre, sensed.drift
        if self.keys.target is None:
            centre, drift = _mean(sensed.position), _mean(sensed.velocity)
        return [a + b for a, b in zip(centre * units, self._places, strict=True)], drift * units

    @cached_property
    def _table(self) -> tuple[Floats, Floats]:
        """Times (m,) [s], forces (m, 3 n) [N]."""
        keys = self.keys
        assert isinstance(keys, TableControl)
        return np.array(keys.time), np.array(keys.force).reshape(len(keys.time), -1)

    @cached_property
    def _places(self) -> Numbers:
        """(3 n) a point, or places from a centre [m]."""
        keys = self.keys
        if isinstance(keys, FormationControl):
            return [item for offset in keys.offsets for item in offset]
        assert isinstance(keys, PointControl)
        return [*(keys.point or keys.offset or (0.0, 0.0, 0.0))] * len(keys.bullets)


def _mean(vectors: Numbers) -> Numbers:
    return [sum(vectors[axis + 3 :: 3], vectors[axis]) / (len(vectors) // 3) for axis in range(3)]


def fired(keys: Control, demand: Numbers, sensed: Sensed) -> Numbers:
    """(3 n) the force of each unit's thrusters until the next sample [N]."""
    if keys.direction != "any":
        demand = _along(keys.direction, demand, sensed)
    most = keys.largest_thrust
    found: Numbers = []
    for first in range(0, len(demand), 3):
        x, y, z = demand[first : first + 3]
        size = math.hypot(x, y, z)  # a square may overflow
        part = most / size if size > most else 1.0
        if min(size, most) * keys.period < keys.minimum_impulse:
            part = 0.0
        found += (x * part, y * part, z * part)
    return found


def _along(direction: str, demand: Numbers, sensed: Sensed) -> Numbers:
    """(3 n) what is left of a demand along the line that each unit's thrusters have; nothing without one."""
    position, velocity, wanted = (
        np.reshape(item, (-1, 3)) for item in (sensed.position, sensed.velocity, demand)
    )
    vectors = velocity if direction == "flight" else position - position.mean(axis=0)
    size = np.linalg.norm(vectors, axis=1, keepdims=True)
    along = np.divide(vectors, size, out=np.zeros_like(vectors), where=size > 0.0)
    found: Numbers = (np.einsum("na,na->n", wanted, along)[:, None] * along).ravel().tolist()
    return found


def growth_of_error(keys: Control, mass: float) -> float | None:
    """By which factor an error of a free unit changes from sample to sample; above 1 the loop is unstable.

    mass : of the unit [kg]. The spectral radius of x, v after a period under the force -k x - c v of its
    beginning. None of a law without gains.
    """
    if not isinstance(keys, PointControl | FormationControl):
        return None
    h = keys.period
    push = np.array([[0.5 * h * h], [h]]) @ np.array([[keys.stiffness, keys.damping]]) / mass
    free = np.array([[1.0, h], [0.0, 1.0]])
    return float(np.abs(np.linalg.eigvals(free - push)).max())


Function = Callable[[float, Floats, Floats], ArrayLike]
Completed = Callable[[float, Floats, Floats, DiscreteStates], tuple[Floats, Floats]]

NAME = "control"  # in the names of states and of the discrete state
SPENT, WORK = f"{NAME}/spent", f"{NAME}/work"
STATE_NAME = f"{NAME}/thrusters"


class Clock(NamedTuple):
    """The first values of the discrete state; after them stand the forces (3 n,) [N].

    on    : 1.0 while the units are controlled
    begin : when the control began [s]
    since : samples since then
    every : samples in all
    """

    on: float
    begin: float
    since: float
    every: float


_FORCES = len(Clock._fields)
_ITEM, _NONE = np.zeros(1, dtype=np.int64), np.zeros(0, dtype=np.int64)


def states_of(control: Control) -> tuple[FirstOrder, FirstOrder]:
    """Return the impulse that each unit has spent [N s], and the work of all [J]."""
    return FirstOrder(SPENT, (0.0,) * len(control.bullets), "N s"), FirstOrder(WORK, (0.0,), "J", gives=1.0)


def term_of(
    control: Control, blocks: Blocks, completed: Completed, *, waits: bool, counted: bool
) -> KernelTerm:
    """The units of a scene, whose states must be among the blocks'.

    completed : gives x and v (n_x,), (n_v,) with what has no equations of motion put in
    waits     : the control begins with an entry of the script
    counted   : the impulse that they give is kept, in states of `exunet.forces.from_outside`
    """
    nodes = (3 * blocks.net.bullet_nodes[list(control.bullets)]).astype(Index)
    clock = Clock(0.0 if waits else 1.0, control.start, 0.0, 0.0)
    initial = np.concatenate([clock, np.zeros(3 * len(nodes))])
    samples = SamplingSwitch(control, blocks, completed)
    discrete = DiscreteState(STATE_NAME, initial, kept_in="discrete")
    data = Thrusters(nodes, initial, _FORCES, blocks.rate(SPENT))
    if not counted:
        return KernelTerm("bullets", add_thrusters, data, discrete=discrete, switch=samples, work_kept=True)
    more = CountedThrusters(*data, rate_of_impulse(NAME, blocks))
    return KernelTerm(
        "bullets",
        add_counted_thrusters,
        more,
        discrete=discrete,
        switch=samples,
        work_kept=True,
        helpers=(add_thrusters, count_force),
    )


def with_function(term: KernelTerm, function: Function) -> KernelTerm:
    """The term of corner units with a law from Python in place of that of the case."""
    assert isinstance(term.switch, SamplingSwitch)
    return replace(term, switch=replace(term.switch, function=function))


def started(discrete: Floats, time: float) -> Floats:
    """The discrete state once the control has started at a time [s], at which the first sample is due."""
    every = Clock(*discrete[:_FORCES]).every
    return np.concatenate([Clock(1.0, time, 0.0, every), discrete[_FORCES:]])


def released(discrete: Floats) -> Floats:
    """The discrete state once the control has ended: no thruster fires."""
    clock = Clock(*discrete[:_FORCES])._replace(on=0.0)
    return np.concatenate([clock, np.zeros(len(discrete) - _FORCES)])


@dataclass(frozen=True, eq=False)
class SamplingSwitch(Switch):
    """The samples of a controller, as a switch; function : in place of the law of the case."""

    control: Control
    blocks: Blocks
    completed: Completed
    function: Function | None = None

    def instants(self, discrete: Floats) -> tuple[float, ...]:
        """The next sample; none while the units are not controlled."""
        on, begin, since, _ = discrete[:_FORCES].tolist()
        return (begin + since * self.control.period,) if on else ()

    def crossed(self, time: float, x: Floats, v: Floats, discrete: Floats) -> Ints:
        """The only item, if a sample is due."""
        return _ITEM if any(due <= time for due in self.instants(discrete)) else _NONE

    def change(
        self, time: float, x: Floats, v: Floats, discrete: Floats, items: Ints, every: DiscreteStates
    ) -> Change:
        """Other forces from now on."""
        on, begin, since, every_sample = discrete[:_FORCES].tolist()
        sensed = self._sensed(time, *self.completed(time, x, v, every), int(every_sample))
        demand = self._law.demanded(sensed) if self.function is None else self._given(sensed)
        forces = fired(self.control, demand, sensed)
        return Change(np.array([on, begin, since + 1.0, every_sample + 1.0, *forces]), quiet=True)

    @cached_property
    def _law(self) -> UnitLaw:
        return UnitLaw(self.control)

    @cached_property
    def _places(self) -> Ints:
        """(3 n,) where the units stand in x and v."""
        nodes = self.blocks.net.bullet_nodes[list(self.control.bullets)]
        return (3 * nodes[:, None] + np.arange(3)).ravel()

    @cached_property
    def _centre(self) -> slice | None:
        """Where the body that the law looks at stands in x and v; None: it looks at none."""
        if self.control.target is None:
            return None
        first = self.blocks.centre(self.control.target)
        return slice(first, first + 3)

    def _sensed(self, time: float, x: Floats, v: Floats, sample: int) -> Sensed:
        keys, places, centre = self.control, self._places, self._centre
        seen = with_noise(keys.noise, keys.bullets, sample, x[places].tolist(), v[places].tolist())
        if centre is None:
            return Sensed(time, *seen, [0.0] * 3, [0.0] * 3)
        return Sensed(time, *seen, x[centre].tolist(), v[centre].tolist())

    def _given(self, sensed: Sensed) -> list[float]:
        """Call the function; raise InputError for anything but a finite force on each unit."""
        assert self.function is not None
        seen = (np.reshape(item, (-1, 3)) for item in (sensed.position, sensed.velocity))
        found, units = self.function(sensed.time, *seen), len(self.control.bullets)
        try:
            values = np.array(found)
            forces = np.zeros(0) if np.iscomplexobj(values) else values.astype(float)
        except (TypeError, ValueError):
            forces = np.zeros(0)
        if forces.shape != (units, 3) or not np.isfinite(forces).all():
            words = f"must return {units} x 3 finite real numbers [N], a force on each unit"
            raise InputError(f"controller: at t = {sensed.time:g} s, the function {words}; got {found!r}")
        asked: list[float] = forces.ravel().tolist()
        return asked


class Thrusters(NamedTuple):
    """Forces that are constant until the next sample.

    bullets : (n,) 3 x node of each unit
    discrete : with the forces on the units (3 n,) [N] at its end
    first   : where these begin
    rate    : where the rates of what they have spent begin in force, before that of the work
    """

    bullets: NDArray[Index]
    discrete: Floats
    first: int
    rate: int


class CountedThrusters(NamedTuple):
    """The same with given : where the rates of the impulse that they give, and of its moment, begin in force.

    These few forces are summed by themselves: as differences of the sums of all forces before and after them
    (`exunet.forces.from_outside.counted`) they would take half as long again as the rest of a step.
    """

    bullets: NDArray[Index]
    discrete: Floats
    first: int
    rate: int
    given: int


def add_thrusters(t: float, x: Any, v: Any, thrusters: Any, force: Any) -> None:
    """The force on each unit, its magnitude as the rate of what it has spent, and its power."""
    bullets, discrete, first, rate = thrusters.bullets, thrusters.discrete, thrusters.first, thrusters.rate
    for k in range(bullets.size):
        square = 0.0
        for axis in range(3):
            value = discrete[first + 3 * k + axis]
            force[bullets[k] + axis] += value
            force[rate + bullets.size] += value * v[bullets[k] + axis]
            square += value * value
        force[rate + k] += math.sqrt(square)


def add_counted_thrusters(t: float, x: Any, v: Any, thrusters: Any, force: Any) -> None:
    """As `add_thrusters`, with the rates of impulse and angular impulse about the origin."""
    add_thrusters(t, x, v, thrusters, force)
    bullets, discrete, rate = thrusters.bullets, thrusters.discrete, thrusters.given
    for k in range(bullets.size):
        i = bullets[k]
        first = thrusters.first + 3 * k
        a, b, c = discrete[first], discrete[first + 1], discrete[first + 2]
        count_force(a, b, c, i, x, rate, force)
