"""The contract of a force: what it acts on, what it adds, what it stores or takes out, what it remembers.

Every force of a scene, the cable law and breaking among them, is a term of one of three kinds, all with the
face of `Term`: the cable elements (`exunet.forces.cable_term`), constant matrices and loads
(`exunet.forces.linear_term`), and nonlinear forces written once as a scalar loop (`KernelTerm`). Every form
of the engine reads these, so a force's physics is written once. A force that is absent leaves no term, and so
no engine item, array or call.

Forces, potentials and events are functions of flat arrays x, v over all blocks: points, rigid bodies,
first-order states. `exunet.forces.blocks` says in which order they stand there, and numbers them.

The text of a force is put into a compiled file without the module that it stands in, so a name of that module
is not there: `KernelCall` checks the names. Numba would report them only as the file is compiled.
"""

from __future__ import annotations

import builtins
import dis
import math
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cache
from operator import attrgetter
from types import CodeType
from typing import Any, NamedTuple, Protocol

import numpy as np

from exunet.base.arrays import Floats, Ints
from exunet.base.run_events import RunEvent

Function = Callable[..., Any]

ARGUMENTS = {
    "add": ("t", "x", "v", "data", "force"),
    "place": ("t", "x", "v", "data"),
    "potential": ("x", "data"),
    "power": ("t", "x", "v", "data"),
    "work": ("h", "begin", "end", "data"),
    "verlet_work": ("h", "data"),
    "remember": ("t", "x", "v", "data"),
    "event": ("t", "x", "v", "data"),
    "shorten": ("step", "least", "x", "v", "data"),
}
MODULES = ("math", "np")


def refuse_wrong(functions: Mapping[str, Function | None], helpers: Iterable[Function]) -> None:
    """Raise TypeError for a function of other arguments, or one that uses a name that is not there.

    functions : by their names in ARGUMENTS; None: absent
    helpers   : functions that these, and other helpers, call
    """
    for name, function in functions.items():
        arguments = ARGUMENTS[name]
        if function is not None and function.__code__.co_argcount != len(arguments):
            raise TypeError(f"{_label(function)}: its arguments must be ({', '.join(arguments)})")
    helpers = tuple(helpers)
    known = {*MODULES, *dir(builtins), *(helper.__name__ for helper in helpers)}
    for function in (*functions.values(), *helpers):
        if function is not None and (unknown := _globals_of(function.__code__) - known):
            raise TypeError(
                f"{_label(function)} uses {', '.join(sorted(unknown))}: a function of a kernel may use its "
                "arguments, math, np and its helpers only; make a number an entry of its data, and a "
                "function one of its helpers"
            )


def _label(function: Function) -> str:
    return f"{function.__module__}.{function.__qualname__}"


@cache
def _globals_of(code: CodeType) -> frozenset[str]:
    """The global names that a function reads."""
    return frozenset(
        instruction.argval
        for instruction in dis.get_instructions(code)
        if instruction.opname == "LOAD_GLOBAL"
    )


@dataclass(frozen=True, eq=False)
class KernelCall:
    """One call in a compiled kernel.

    add     : module-level function add(t, x, v, data, force) that adds its forces [N], torques [N m] and
              rates of first-order states to `force`; x, v, force are flat arrays over all blocks, in the
              subset of Python that Numba compiles. It may use `math`, `np` and its `helpers`, no other global
              name
    data    : a named tuple of arrays, floats and ints. They are data of the compiled function, not text in
              it: a kind of force is compiled once, for all scenes
    helpers : module-level functions that the others call
    jumps   : the force jumps where an element becomes taut (see `exunet.forces.cable_term`)
    elastic : `add` returns the elastic energy [J] that it finds on its way
    place   : function place(t, x, v, data) that puts what follows from time and other entries into x and v,
              before any force is added; that of a later call comes before that of an earlier one
    tells_power : `add` returns the power [W] that it takes out, which depends on velocities alone
    remember : function remember(t, x, v, data) that changes arrays of the data at the end of each accepted
              step, whose state `add` was called with last; see `DiscreteState.kept_in`
    event   : function event(t, x, v, data) -> float, the event function of the term's `Switch`, evaluated at
              the end of each accepted step; at or above 0, the switch finds what has crossed
    shorten : function shorten(step, least, x, v, data) -> step [s], as `Switch.step_within`
    held    : the data is large: compiled code gets a reference to it instead of all its words
    of_many : the functions are right for many runs at once too: x, v and force, and what is made of them,
              have a value in each run, with which arithmetic, max, min, abs and math.sqrt can be done. A
              condition on such values is true where it holds in one run, so what stands under it must change
              nothing in the others

    The energy that it stores or takes out comes from these; none means a force that does no work:
    potential : function potential(x, data) -> [J]
    power     : function power(t, x, v, data) -> [W] taken out
    work      : function work(h, begin, end, data) -> [J] taken out in a step of length h, from the states
                (x, v) at its start and end
    verlet_work : function verlet_work(h, data) -> [J], instead of `work` in a step of velocity Verlet, at
                whose end `add` was called last
    works     : the power taken out is -force . v
    """

    add: Function
    data: tuple[Any, ...] = ()
    potential: Function | None = None
    power: Function | None = None
    work: Function | None = None
    verlet_work: Function | None = None
    helpers: tuple[Function, ...] = ()
    works: bool = False
    jumps: bool = False
    elastic: bool = False
    place: Function | None = None
    tells_power: bool = False
    remember: Function | None = None
    event: Function | None = None
    shorten: Function | None = None
    held: bool = False
    of_many: bool = False

    @property
    def dissipates(self) -> bool:
        """True if it takes energy out, or puts some in, that is no potential energy."""
        return self.works or self.power is not None or self.work is not None

    def __post_init__(self) -> None:
        """Raise TypeError for a function that could not be compiled."""
        functions = {name: getattr(self, name) for name in ARGUMENTS}
        refuse_wrong(functions, self.helpers)


DiscreteStates = Mapping[str, Floats]


def copied(data: Any) -> Any:
    """Copy a named tuple of data with its arrays, but for those that a tuple names as `unchanged`."""
    shared: frozenset[str] = getattr(data, "unchanged", frozenset())
    values = (
        copied(value)
        if isinstance(value, tuple)
        else value.copy()
        if isinstance(value, np.ndarray) and name not in shared
        else value
        for name, value in zip(getattr(data, "_fields", ()), data, strict=True)
    )
    return type(data)(*values)


def leaves(data: Iterable[Any]) -> Iterator[Any]:
    """Yield the arrays and numbers of nested tuples of data."""
    for value in data:
        if isinstance(value, tuple):
            yield from leaves(value)
        else:
            yield value


def with_field(data: Any, path: str, value: Any) -> Any:
    """Return nested named tuples with another value of the field at a path."""
    name, _, rest = path.partition(".")
    return data._replace(**{name: with_field(getattr(data, name), rest, value) if rest else value})


@dataclass(frozen=True)
class Series:
    """Numbers of a discrete state that results have over the stored times.

    key   : "term/quantity", or the key of a contact, by which results know it
    units : "1" if it has none
    place : of the first among the values, from their end if negative
    size  : how many
    """

    key: Hashable
    units: str
    place: int
    size: int = 1


@dataclass(frozen=True, eq=False)
class DiscreteState:
    """Values of a term that change only when a step is accepted.

    name    : under which states and snapshots keep them
    initial : (m,) values at the start
    data    : of a `KernelTerm`: function (m,) -> its kernel data with these values in force; None: they are
              the same
    kept_in : field of the kernel data that has these values as an array, in which compiled code changes them
              itself (`KernelCall.remember`), or quiet events do (`Change.quiet`); "": they change with other
              events only
    wrong   : function (m,) -> why a run with these values must stop, and what to change; "": it need not
    series  : of one that is kept in the data: what of it is stored
    in_steps : its switch changes it at the end of accepted steps too, without an event (see `Watch`)
    """

    name: str
    initial: Floats
    data: Callable[[Floats], tuple[Any, ...]] | None = None
    kept_in: str = ""
    wrong: Callable[[Floats], str] | None = None
    series: tuple[Series, ...] = ()
    in_steps: bool = False


@dataclass(frozen=True, eq=False)
class Input:
    """Values that are given from outside and stay as they are until others are given.

    name    : under which `Simulation.set_input` and snapshots know them
    field   : of the term's data, which has them as an array, or the only one as a number
    initial : (m,) values at the start
    units   : of the values, "1" if they have none
    """

    name: str
    field: str
    initial: Floats
    units: str = "1"


class Switch:
    """The events of a term: when its discrete state changes, and how.

    times   : known instants [s], which steps end at
    sees_inputs : the discrete state is followed by the values of the term's inputs
    """

    times: tuple[float, ...] = ()
    sees_inputs: bool = False

    def instants(self, discrete: Floats) -> tuple[float, ...]:
        """Instants [s] that are planned with such a discrete state, which steps end at."""
        return ()

    def in_steps(self, discrete: Floats) -> bool:
        """True if it may cross at other instants too with such a state: `KernelCall.event` reports it."""
        return False

    def crossed(self, time: float, x: Floats, v: Floats, discrete: Floats) -> Ints:
        """Return the items that have crossed their event function at the end of an accepted step."""
        raise NotImplementedError

    def step_within(self, step: float, least: float, x: Floats, v: Floats, discrete: Floats) -> float:
        """A step [s], not above `step` nor below `least`, that ends near the next crossing, if any."""
        return step

    def change(
        self, time: float, x: Floats, v: Floats, discrete: Floats, items: Ints, every: DiscreteStates
    ) -> Change:
        """Return the changes by the crossing of `items`; every : all discrete states now."""
        raise NotImplementedError


class Watch(Switch):
    """A switch whose crossings are located within steps.

    Its discrete state is followed by those that it sees, and by the numbers that it records.
    sees  : names of these discrete states
    reports : numbers of discrete states that steps change, at the end of each: name of the discrete state,
              place
    of_x, of_v : entries of the states at the ends of steps that it looks at
    weights : (n,) of the first points, at whose mean place and velocity it looks; none: it does not
    """

    sees: tuple[str, ...]
    reports: tuple[tuple[str, int], ...]
    of_x: Ints
    of_v: Ints
    weights: Floats

    def comes_true(self, steps: Seen) -> int | None:
        """Return the first of these steps at whose end something is due, or None."""
        raise NotImplementedError

    def crossing(self, begin: Seen, end: Seen) -> float | None:
        """Return until when [s] a step is repeated to locate a crossing in it, or None.

        The step's own end where the crossing is as near to that as it is to be; when in the step it was, by
        interpolation, is noted for the report of the event.
        """
        raise NotImplementedError

    def remembered(self, steps: Seen) -> Floats | None:
        """Its own discrete state at the end of accepted steps, before events; None: as it was."""
        raise NotImplementedError

    def stops(self, discrete: Floats) -> bool:
        """True if the run ends with such a discrete state."""
        raise NotImplementedError


class Seen(NamedTuple):
    """States at the ends of steps: times (k,) [s], x (k, n_x), v (k, n_v), and what a switch reads.

    discrete : at the last of them
    reported : (k, n) numbers of `Watch.reports`
    mean   : (k, 6) mean place and velocity with `Watch.weights`; None: they follow from x and v
    """

    time: Floats
    x: Floats
    v: Floats
    discrete: Floats
    reported: Floats
    mean: Floats | None = None


@dataclass(frozen=True)
class Change:
    """Changes by an event: discrete state, energy and state.

    discrete    : the new discrete state of the term
    energy_lost : [J] with the event; negative: put in. None: what the energy of the system changes by, less
                  the work that prescribed bodies do with it
    work_given  : this work [J], which `energy_lost` does not count
    events      : record of each item
    x, v        : the new state of all blocks, None: as it was
    active      : (n_points,) which points are active from now on (see `Blocks.active`), None: as before;
                  those that become inactive come to rest
    more        : True if the switch is to be asked at once whether something else is due at this instant
    others      : new values of discrete states and inputs of other terms, by name
    stops       : True if the run ends here
    quiet       : True if only forces are others from now on, by a discrete state that is kept in the data,
                  and their work is kept by states: those from before and after may be looked at together
    """

    discrete: Floats
    energy_lost: float | None = 0.0
    events: tuple[RunEvent, ...] = ()
    x: Floats | None = None
    v: Floats | None = None
    active: Floats | None = None
    work_given: float = 0.0
    more: bool = False
    others: DiscreteStates = field(default_factory=dict)
    stops: bool = False
    quiet: bool = False


class Term(Protocol):
    """Interface of a force to every backend and balance; by default it has nothing and does nothing."""

    @property
    def calls(self) -> tuple[KernelCall, ...]:
        """Its calls in a compiled kernel."""
        return ()

    def data_at(self, discrete: DiscreteStates) -> tuple[tuple[Any, ...], ...]:
        """The data of its calls with these discrete states and inputs; absent ones are as at the start."""
        return ()

    @property
    def discrete(self) -> DiscreteState | None:
        return None

    @property
    def switch(self) -> Switch | None:
        return None

    @property
    def inputs(self) -> tuple[Input, ...]:
        return ()

    @property
    def dissipates(self) -> bool:
        """True if its work must be integrated along the run for the energy balance to close."""
        return False

    @property
    def has_potential(self) -> bool:
        """True if it has potential energy beside the elastic energy of the elements."""
        return False

    @property
    def damping_rate(self) -> float:
        """Bound [1/s] of what it adds to the eigenvalues of M^-1 D beside its matrix, for the stable step."""
        return 0.0

    def numbers(self) -> Iterator[Any]:
        """Its numbers and arrays, none of which may be beyond floating point."""
        yield from ()


class ScriptTerm(Term, Protocol):
    """Mission script: changes inputs of other terms and does not exert forces; its switch is a `Watch`."""

    @property
    def acts_with(self) -> frozenset[str]:
        """The inputs that it gives, by name."""


@dataclass(frozen=True, eq=False)
class KernelTerm:
    """A nonlinear force, written once as a scalar loop.

    acts_on    : in words
    add, data, potential, helpers : as in `KernelCall`; without a potential the work of force . v is
                 integrated
    couples    : (m, c) points; the force on each point of a row depends on the state of the others in it.
                 None: on no other point's. For the Jacobian of implicit methods
    bodies     : names of the rigid bodies that it acts on
    stiffness_rate : bound [1/s2] of what it adds to the eigenvalues of M^-1 K, for the stable step
    damping_rate : bound [1/s] of what it adds to the eigenvalues of M^-1 D, for the stable step
    friction_rate : the same of friction that is smooth in the speed, where it is slow [1/s]; its force has a
                 bound, so that no step makes it grow: not in the stable step, see `exunet.model.limits`
    discrete, switch, inputs : see `DiscreteState`, `Switch`, `Input`
    power      : as in `KernelCall`, of a force that takes out energy beside its potential
    remember   : as in `KernelCall`; the discrete state says in which field of the data its values are kept
    event, shorten : as in `KernelCall`, of a switch that may cross at the end of any step
    internal   : the potential depends only on where things are relative to each other
    only_states : it adds no force, only rates of first-order states, and does no work
    work_kept  : first-order states keep the work that it does (`FirstOrder.gives`)
    """

    acts_on: str
    add: Function
    data: tuple[Any, ...] = ()
    potential: Function | None = None
    helpers: tuple[Function, ...] = ()
    couples: Ints | None = None
    bodies: tuple[str, ...] = ()
    stiffness_rate: float = 0.0
    damping_rate: float = 0.0
    friction_rate: float = 0.0
    discrete: DiscreteState | None = None
    switch: Switch | None = None
    inputs: tuple[Input, ...] = ()
    power: Function | None = None
    remember: Function | None = None
    event: Function | None = None
    shorten: Function | None = None
    internal: bool = False
    only_states: bool = False
    work_kept: bool = False

    def __post_init__(self) -> None:
        """Raise TypeError for events in steps that compiled code could not see."""
        of_switch = type(self.switch or Switch())
        if self.event is None and of_switch.in_steps is not Switch.in_steps:
            raise TypeError(f"{of_switch.__name__} has events in steps: give the term an event function")

    @property
    def _works(self) -> bool:
        """True if the work of the force is integrated beside the states."""
        return self.potential is None and not self.only_states and not self.work_kept

    @property
    def calls(self) -> tuple[KernelCall, ...]:
        """One call; a force without a potential does work that is integrated, unless states keep it."""
        call = KernelCall(
            self.add,
            self.data,
            self.potential,
            self.power,
            helpers=self.helpers,
            works=self._works,
            remember=self.remember,
            event=self.event,
            shorten=self.shorten,
            held=self.remember is not None,
        )
        return (call,)

    def data_at(self, discrete: DiscreteStates) -> tuple[tuple[Any, ...], ...]:
        data: Any = self.data
        if self.discrete is not None and self.discrete.name in discrete:
            values = discrete[self.discrete.name]
            if self.discrete.data is not None:
                data = self.discrete.data(values)
            elif self.discrete.kept_in:
                data = data._replace(**{self.discrete.kept_in: values})
        for item in self.inputs:
            values = discrete.get(item.name, item.initial)
            number = isinstance(attrgetter(item.field)(data), float)
            data = with_field(data, item.field, float(values[0]) if number else values)
        return (data,)

    @property
    def dissipates(self) -> bool:
        return self._works or self.power is not None

    @property
    def has_potential(self) -> bool:
        return self.potential is not None

    def numbers(self) -> Iterator[Any]:
        yield from (*leaves(self.data), self.damping_rate, self.stiffness_rate)


def unchanged(data: tuple[Any, ...], discrete: DiscreteStates) -> tuple[Any, ...]:
    """Return data of a call that do not depend on discrete states."""
    return data


@dataclass(frozen=True, eq=False)
class Constraint(Term):
    """Entries of x and v without equations of motion: placed before the forces, relieved of them after all.

    calls     : its calls in a kernel
    data      : of each call, by the discrete states in force
    bodies    : names of the free bodies that it hands forces on to
    discrete, switch : see `DiscreteState`, `Switch`
    Energy that it gives is kept by first-order states of the system.
    """

    calls: tuple[KernelCall, ...] = ()
    data: tuple[Callable[[DiscreteStates], tuple[Any, ...]], ...] = ()
    bodies: tuple[str, ...] = ()
    discrete: DiscreteState | None = None
    switch: Switch | None = None

    def data_at(self, discrete: DiscreteStates) -> tuple[tuple[Any, ...], ...]:
        return tuple(of(discrete) for of in self.data)

    def numbers(self) -> Iterator[Any]:
        for call in self.calls:
            yield from call.data


def largest_number(numbers: Iterable[Any]) -> float:
    """The largest magnitude in arrays and numbers; NaN if one is not a number."""
    return max(
        (float(np.max(np.abs(number), initial=0.0)) for number in numbers),
        key=lambda number: math.inf if math.isnan(number) else number,
        default=0.0,
    )
