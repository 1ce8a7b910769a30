"""The cable elements as a force term: their law, and breaking as its discrete state and its switch.

S11 = E (E11 + tau dE11/dt) where E11 > 0 begins with the force of the rate alone. No step across such a jump
is better than the jump times its length, however good the method is; so a step control that meets one goes
straight to it, and crosses it with a step that is short enough for the tolerance, or as short as round-off
allows. The compiled loop has the same rule (`exunet.integrators.compiled.steps.jump_ahead`).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from exunet.base.arrays import Floats, Ints
from exunet.base.run_events import ElementBreak
from exunet.forces import cable, loops
from exunet.forces.blocks import ACTIVE, Blocks
from exunet.forces.cable import AxialLaw
from exunet.forces.law import energy, factor_of, green_lagrange_strain, pull_of, row_of, weight_of
from exunet.forces.loops import Index
from exunet.forces.perimeter import Shortening
from exunet.forces.reel import Winding
from exunet.forces.terms import Change, DiscreteState, DiscreteStates, Function, KernelCall, Switch, Term
from exunet.net.arrays import Net

OVERSHOOT = 1e-9  # of the strain at the limit, by which a step may go beyond it, unless it is a least step
# Name of the discrete state: 1.0 for an element that carries, 0.0 for one that has broken; the part of its
# stiffness for one of a tether that a script has made softer.
INTACT = "cable/intact"


@dataclass(frozen=True, eq=False)
class ElementLaw:
    """Changes of the law of the elements by an effect; None: no change. Arrays of (n_elements,).

    free_strain     : Green-Lagrange strain at which an element is free of stress (a thermal strain)
    relaxation_time : [s] of the viscous stress along the current direction while taut
    breaking_strain : Green-Lagrange strain, free strain excluded, above which an element breaks
    breaking_force  : elastic axial force [N] above which an element breaks, instead of a strain
    """

    free_strain: Floats | None = None
    relaxation_time: Floats | None = None
    breaking_strain: Floats | None = None
    breaking_force: Floats | None = None

    def __add__(self, other: ElementLaw) -> ElementLaw:
        def total(a: Floats | None, b: Floats | None) -> Floats | None:
            return a if b is None else b if a is None else a + b

        return ElementLaw(
            total(self.free_strain, other.free_strain),
            total(self.relaxation_time, other.relaxation_time),
            total(self.breaking_strain, other.breaking_strain),
            total(self.breaking_force, other.breaking_force),
        )

    def numbers(self) -> Iterator[Any]:
        """Its arrays."""
        every = (self.free_strain, self.relaxation_time, self.breaking_strain, self.breaking_force)
        yield from (values for values in every if values is not None)


@dataclass(frozen=True, eq=False)
class CableTerm(Term):
    """All elements of a net under one law.

    But for those on drums and the outlets of reels, and threads of the edge that become shorter.
    may_be_cut : a script may cut some, or make them softer
    broken : those that carry nothing from the start on
    """

    net: Net
    changes: ElementLaw = field(default_factory=ElementLaw)
    reels: tuple[Winding, ...] = ()
    shortening: Shortening | None = None
    may_be_cut: bool = False
    broken: tuple[int, ...] = ()

    @cached_property
    def law(self) -> AxialLaw:
        """The law of the whole elements; `law.of_intact` is that of those left."""
        return AxialLaw.of(self.net, self.changes.free_strain, self.changes.relaxation_time)

    @property
    def viscous(self) -> bool:
        """True with viscous stress."""
        return self.changes.relaxation_time is not None

    @property
    def dissipates(self) -> bool:
        return self.viscous

    @property
    def breaks(self) -> bool:
        """True if elements may break."""
        return self.changes.breaking_strain is not None or self.changes.breaking_force is not None

    @property
    def calls(self) -> tuple[KernelCall, ...]:
        """One call over the elements of each law."""
        data = self.data_at({})
        helpers: tuple[Function, ...] = (row_of, pull_of, weight_of)
        if self.viscous:
            helpers += (loops.largest_change, loops.excess, loops.parting, loops.halfway, loops.stresses)
            whole = KernelCall(
                loops.add_viscous_tension,
                data[0],
                work=loops.viscous_work,
                verlet_work=loops.viscous_work_of_verlet,
                helpers=helpers,
                jumps=True,
                elastic=True,
            )
        else:
            whole = KernelCall(loops.add_tension_of_law, data[0], helpers=helpers, elastic=True)
        breaks, shorten = loops.beyond_limit, loops.step_to_limit
        n = len(self.law.kinds)
        limits = (KernelCall(loops.add_no_force, item, event=breaks, shorten=shorten) for item in data[n:])
        own = [replace(whole, data=item) for item in data[:n]]
        if not self.viscous and self.law.kinds[0][0] == 0:
            own[0] = KernelCall(loops.add_tension, data[0], elastic=True, of_many=True)
        return *own, *limits

    def data_at(self, discrete: DiscreteStates) -> tuple[Any, ...]:
        """The elements, without those between inactive points; then, of intact ones, when they break."""
        own = self.elements(discrete, self.moving(discrete))
        if self.switch is None:
            return own
        return *own, self.switch.limits(discrete.get(INTACT, np.ones(self.net.n_elements)))

    def elements(
        self, discrete: DiscreteStates, chosen: NDArray[np.bool_] | None
    ) -> tuple[loops.Elements | loops.ViscousElements, ...]:
        """The chosen ones (n_elements,) as kernels take them, law by law; None: all."""
        found = []
        for number, own in self.law.kinds:
            both = own if chosen is None else chosen if own is None else own & chosen
            found.append(self._elements(discrete, both, number))
        return tuple(found)

    def _elements(
        self, discrete: DiscreteStates, chosen: NDArray[np.bool_] | None, law: int
    ) -> loops.Elements | loops.ViscousElements:
        first, second = (3 * self.net.element_nodes.T).astype(Index)
        length, intact = self.law.natural_length, self.carrying(discrete)
        factor = factor_of(length, self.law.stiffness) * (1.0 if intact is None else intact)
        kept = slice(None) if chosen is None else chosen
        own = first[kept], second[kept], length[kept] ** 2, factor[kept]
        data = loops.Elements(*own, law, self.law.table)
        if (time := self.law.relaxation_time) is None:
            return data
        return loops.ViscousElements(*data, 2.0 * time[kept], np.zeros(len(data.factor)), np.zeros(2))

    def moving(self, discrete: DiscreteStates) -> NDArray[np.bool_] | None:
        """(n_elements,) False for elements with two inactive ends; None: all are active."""
        active = discrete.get(ACTIVE)
        return None if active is None else np.asarray(active[self.net.element_nodes].any(axis=1))

    @cached_property
    def discrete(self) -> DiscreteState | None:
        """Which elements are intact, where that may change, or some are not."""
        if not (self.breaks or self.may_be_cut or self.broken):
            return None
        intact = np.ones(self.net.n_elements)
        intact[list(self.broken)] = 0.0
        return DiscreteState(INTACT, intact)

    def carrying(self, discrete: DiscreteStates) -> Floats | None:
        """(n_elements,) part of the stiffness with which each carries at these discrete states; None: all."""
        intact = discrete.get(INTACT)
        if not self.leaves_some:
            return intact
        carrying = np.ones(self.net.n_elements) if intact is None else intact.copy()
        for winding in self.reels:
            carrying[list(winding.left_out(discrete))] = 0.0
        if self.shortening is not None:
            carrying[list(self.shortening.elements)] = 0.0
        return carrying

    @property
    def leaves_some(self) -> bool:
        """True if it leaves some elements to other terms."""
        return bool(self.reels) or self.shortening is not None

    def seen_elsewhere(
        self, discrete: DiscreteStates, x: Floats, v: Floats
    ) -> Iterator[tuple[Any, Floats, Floats]]:
        """Elements of other terms, their strain and tension [N] in k states with equal discrete states."""
        for winding in self.reels:
            yield winding.outlets(discrete, x, v)
        if self.shortening is not None:
            yield self.shortening.seen(discrete, x, v)

    @cached_property
    def switch(self) -> BreakingEvents | None:
        """Breaking, where it is on."""
        return BreakingEvents(self) if self.breaks else None

    def numbers(self) -> Iterator[Any]:
        yield from self.changes.numbers()


@dataclass(frozen=True, eq=False)
class SomeElements(Term):
    """Some of the elements as a term of their own, for forms that take the others in another way.

    chosen : (n_elements,) True for those
    Breaking, and all that books ask for, stays with the whole.
    """

    cable: CableTerm
    chosen: NDArray[np.bool_]

    @property
    def calls(self) -> tuple[KernelCall, ...]:
        return tuple(replace(self.cable.calls[0], data=data) for data in self.data_at({}))

    def data_at(self, discrete: DiscreteStates) -> tuple[loops.Elements | loops.ViscousElements, ...]:
        moving = self.cable.moving(discrete)
        return self.cable.elements(discrete, self.chosen if moving is None else self.chosen & moving)


class BreakingEvents(Switch):
    """An element whose strain or force exceeds its limit at the end of a step carries nothing any more.

    Methods that choose their step are made to end one near the limit.
    """

    def __init__(self, term: CableTerm) -> None:
        self._net, self._law = term.net, term.law
        self._limit = breaking_lengths(term)
        self._at_limit = self._law.strain(self._limit)
        at_limit = green_lagrange_strain(self._limit, self._law.natural_length)
        self._far = self._law.natural_length * np.sqrt(1.0 + 2.0 * (1.0 + OVERSHOOT) * at_limit)

    def in_steps(self, discrete: Floats) -> bool:
        """An element may break at any time."""
        return True

    def crossed(self, time: float, x: Floats, v: Floats, discrete: Floats) -> Ints:
        """Intact elements that are beyond their limit."""
        return np.flatnonzero((discrete > 0.0) & (cable.lengths(self._net, self._nodes(x)) > self._limit))

    def step_within(self, step: float, least: float, x: Floats, v: Floats, discrete: Floats) -> float:
        """A step [s] by which no element, at the velocity as it is, goes far beyond its limit.

        `step` halved as often as needed, but not below `least`. Forces slow down what stretches, so the
        straight way looks further than the true one goes.
        """
        apart, parting = cable.spans(self._net, self._nodes(x)), cable.spans(self._net, self._nodes(v))
        near = (discrete > 0.0) & (np.linalg.norm(apart, axis=1) <= self._limit)
        near &= np.linalg.norm(apart, axis=1) + step * np.linalg.norm(parting, axis=1) > self._far
        apart, parting, far = apart[near], parting[near], self._far[near]
        while step > least and (np.linalg.norm(apart + step * parting, axis=1) > far).any():
            step *= 0.5
        return step

    def limits(self, intact: Floats) -> loops.Limits:
        """The intact elements (intact > 0) as compiled code takes them."""
        first, second = (3 * self._net.element_nodes[intact > 0.0].T).astype(Index)
        limit, far = self._limit[intact > 0.0], self._far[intact > 0.0]
        # Less by more than round-off: `crossed` decides.
        return loops.Limits(first, second, (limit * (1.0 - 1e-14)) ** 2, limit, far)

    def _nodes(self, flat: Floats) -> Floats:
        """(n_nodes, 3) of the nodes."""
        return flat[: 3 * self._net.n_nodes].reshape(-1, 3)

    def change(
        self, time: float, x: Floats, v: Floats, discrete: Floats, items: Ints, every: DiscreteStates
    ) -> Change:
        """Take elements out; the elastic energy that they held is lost.

        Reported for each: element, time [s], that energy [J], and its excess over the energy at the limit,
        which is the error of finding the break at a step's end.
        """
        length = cable.lengths(self._net, self._nodes(x))
        strain = self._law.strain(length)
        stiffness = self._law.stiffness * discrete
        held = energy(strain) * stiffness * self._law.natural_length
        excess = (strain / self._at_limit) ** 2 - 1.0
        events = tuple(
            ElementBreak(time_s=time, element=int(e), energy_J=float(held[e]), energy_excess=float(excess[e]))
            for e in items
        )
        intact = discrete.copy()
        intact[items] = 0.0
        return Change(intact, float(held[items].sum()), events)


def breaking_lengths(term: CableTerm) -> Floats:
    """(n_elements,) the length [m] beyond which each element breaks."""
    changes, net = term.changes, term.net
    if changes.breaking_strain is not None:
        free = 0.0 if changes.free_strain is None else changes.free_strain
        return np.asarray(net.reference_length * np.sqrt(1.0 + 2.0 * (changes.breaking_strain + free)))
    assert changes.breaking_force is not None
    return term.law.length_with(changes.breaking_force)


ROUND_OFF = 64.0 * float(np.finfo(float).eps)  # of places and times, by which a crossing is surely one
NEARER = 1e-2  # of the time to a jump: how far before it a step towards it ends, since its path is a parabola


@dataclass(frozen=True)
class Jump:
    """A jump ahead: time until then [s], jump of the accelerations [m/s2], step that may cross it [s]."""

    after: float
    size: float
    step: float

    @property
    def to_it(self) -> float:
        """The step [s] that ends just before it."""
        return self.after - max(0.5 * self.step, NEARER * self.after)


@np.errstate(all="ignore")  # a state that is beyond floating-point numbers is for the guards to report
def jump_ahead(
    blocks: Blocks,
    law: AxialLaw,
    within: float,
    tolerance: float,
    time: float,
    state: tuple[Floats, Floats, Floats],
) -> Jump | None:
    """The next jump within a time [s] that would cost a step of that length more than the tolerance.

    law   : of the elements that are intact, with viscous stress
    state : position [m], velocity [m/s], acceleration [m/s2], (n_points, 3) each, at a time [s]; the way from
            there is taken as a parabola
    """
    net, length = blocks.net, law.natural_length
    assert law.relaxation_time is not None
    mobility = 1.0 / blocks.mass
    mobility[net.fixed_nodes] = 0.0
    gain = law.stiffness * law.relaxation_time / length * mobility[net.element_nodes].max(axis=1)  # [1/s]
    span, rate, bend = (cable.spans(net, nodal) for nodal in state)
    distance, speed = np.linalg.norm(span, axis=1), np.linalg.norm(rate, axis=1)
    reach = distance + within * (speed + 0.5 * within * np.linalg.norm(bend, axis=1))
    near = (gain > 0.0) & (distance <= length * (1.0 + 1e-15)) & (reach > length)
    if not near.any():
        return None
    length = length[near]
    after, parting = _crossing(span[near], rate[near], bend[near], length)
    size = gain[near] * parting
    matters = (after <= within) & (size * within > tolerance)
    if not matters.any():
        return None
    first = int(np.argmin(np.where(matters, after, np.inf)))
    places = np.abs(state[0][net.element_nodes[near][first]]).max() + length[first]
    surely = ROUND_OFF * max(time, places / parting[first])
    step = min(within, max(tolerance / size[first], surely))
    together = matters & (after <= after[first] + step)
    return Jump(float(after[first]), float(size[together].sum()), float(step))


def _crossing(span: Floats, rate: Floats, bend: Floats, length: Floats) -> tuple[Floats, Floats]:
    """Time [s] until elements no longer than `length` get so long, and dL/dt then [m/s]; inf where never.

    Newton's method on the squared length of span + t rate + t^2 bend / 2, started from the linear estimate.
    """
    distance = np.linalg.norm(span, axis=1)
    square = np.einsum("ea,ea->e", rate, rate)
    c0 = (distance - length) * (distance + length)
    c1 = 2.0 * np.einsum("ea,ea->e", span, rate)
    c2 = square + np.einsum("ea,ea->e", span, bend)
    c3, c4 = np.einsum("ea,ea->e", rate, bend), 0.25 * np.einsum("ea,ea->e", bend, bend)

    def slope(t: Floats) -> Floats:
        return np.asarray(c1 + t * (2.0 * c2 + t * (3.0 * c3 + t * 4.0 * c4)))

    below = np.minimum(c0, 0.0)
    root = np.sqrt(np.maximum(c1 * c1 - 4.0 * square * below, 0.0))
    straight = np.where(c1 > 0.0, -2.0 * below / (c1 + root), (root - c1) / (2.0 * square))
    t = straight
    for _ in range(6):
        t = t - (c0 + t * (c1 + t * (c2 + t * (c3 + t * c4)))) / slope(t)
    t = np.where(np.isfinite(t) & (t > 0.25 * straight) & (t < 4.0 * straight), t, straight)
    parting = slope(t) / (2.0 * length)
    good = np.isfinite(t) & (parting > 0.0)
    return np.where(good, t, np.inf), np.where(good, parting, 0.0)
