"""Impulse and angular impulse about the scene's origin that effects from outside give, as first-order states.

Each effect's forces f_k on points at x_k, and its forces and torques c_b on bodies at x_b, have the resultant
sum f and the moment sum x_k x f_k + sum (x_b x f_b + c_b) about the origin. Their integrals over time are
states of the system, so that every method integrates them with its own order: linear momentum, less impulses,
then stays to round-off, which every method keeps of a sum of states; angular momentum to its order.

Matrices and loads are summed over all effects where they act; here those of one effect are multiplied once
more. Other forces are what they add to the sum of all: that sum after them, less that before.

Forces that a script adds to a scene with bodies have such states too, all together, and so has what holds the
nodes of `net.fixed`: the opposite of all that acts on them.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from exunet.base.arrays import Floats
from exunet.forces.blocks import Blocks, FirstOrder
from exunet.forces.linear_term import LinearTerm, rows_of
from exunet.forces.loops import Index, in_scene_axes
from exunet.forces.terms import Constraint, KernelCall, KernelTerm, unchanged

OUTSIDE = "effect."  # before the name of an effect, in the names of its states; no body has a dot in its name
SCRIPT, FIXED_NODES = "script", "fixed_nodes"  # what gives beside effects, in place of the name of one
IMPULSE, ANGULAR_IMPULSE = "impulse", "angular_impulse"
QUANTITIES = ((IMPULSE, "N s"), (ANGULAR_IMPULSE, "N m s"))


def states_of(effect: str) -> tuple[FirstOrder, ...]:
    """Impulse and angular impulse about the origin that an effect, or another, has given since the start."""
    return tuple(FirstOrder(f"{OUTSIDE}{effect}/{name}", (0.0,) * 3, units) for name, units in QUANTITIES)


def rate_of_impulse(effect: str, blocks: Blocks) -> int:
    """Where the rates of these states begin in force."""
    return blocks.rate(f"{OUTSIDE}{effect}/{IMPULSE}")


def effects_of(states: Iterable[str]) -> tuple[str, ...]:
    """The effects, and others, that have such states, by the names of all states."""
    ending = f"/{IMPULSE}"
    return tuple(
        name[len(OUTSIDE) : -len(ending)]
        for name in states
        if name.startswith(OUTSIDE) and name.endswith(ending)
    )


class CountedRows(NamedTuple):
    """A sparse matrix by rows, as `exunet.forces.loops.SparseRows`; rate : where the rates begin in force."""

    start: NDArray[Index]
    column: NDArray[Index]
    value: Floats
    rate: int


class CountedLoad(NamedTuple):
    """value : (3 n_points,) [N]; rate : where the rates begin in force."""

    value: Floats
    rate: int


class Mark(NamedTuple):
    """Where forces are summed: what stands in force so far.

    particles : number of points and bodies, whose places come first in x
    bodies    : number of bodies
    rate      : where the rates of the effect begin in force
    sign      : 1.0 after its forces, -1.0 before them
    """

    particles: int
    bodies: int
    rate: int
    sign: float


class Reactions(NamedTuple):
    """node : (n,) where the entries of fixed nodes begin; rate : where the rates begin in force."""

    node: NDArray[Index]
    rate: int


def counted(effect: str, terms: Iterable[Any], blocks: Blocks) -> Iterator[Any]:
    """The terms of an effect, and those that keep what it gives; its states must be among the blocks'."""
    rate = rate_of_impulse(effect, blocks)
    kernels = []
    for term in terms:
        if isinstance(term, LinearTerm):
            yield term
            yield from _of_linear(term, rate)
        elif isinstance(term, KernelTerm):
            kernels.append(term)
        else:
            yield term
    if kernels:
        yield _mark(blocks, rate, -1.0)
        yield from kernels
        yield _mark(blocks, rate, 1.0)


def with_reactions(constraint: Constraint | None, blocks: Blocks) -> Constraint:
    """Constraints that also keep what holds nodes of `net.fixed`; its states must be among the blocks'."""
    nodes, rate = blocks.net.fixed_nodes, rate_of_impulse(FIXED_NODES, blocks)
    data = Reactions((3 * nodes).astype(Index), rate)
    before = Constraint() if constraint is None else constraint
    calls = (*before.calls, KernelCall(count_reactions, data, helpers=(count_force,)))
    return replace(before, calls=calls, data=(*before.data, partial(unchanged, data)))


def _of_linear(term: LinearTerm, rate: int) -> Iterator[KernelTerm]:
    for matrix, count in (
        (term.on_velocity, count_velocity_product),
        (term.stiffness, count_position_product),
    ):
        if matrix is not None:
            data = CountedRows(*rows_of(matrix), rate)
            yield KernelTerm("states", count, data, helpers=(count_force, count_product), only_states=True)
    if term.load is not None:
        load = CountedLoad(np.asarray(term.load, dtype=float), rate)
        yield KernelTerm("states", count_load, load, helpers=(count_force,), only_states=True)


def _mark(blocks: Blocks, rate: int, sign: float) -> KernelTerm:
    data = Mark(blocks.centres // 3, len(blocks.rigid), rate, sign)
    return KernelTerm("states", add_mark, data, helpers=(in_scene_axes,), only_states=True)


def count_force(a: float, b: float, c: float, first: int, x: Any, rate: int, force: Any) -> None:
    """Add a force (a, b, c) at the point whose place begins at x[first], and its moment, to the rates."""
    force[rate] += a
    force[rate + 1] += b
    force[rate + 2] += c
    force[rate + 3] += x[first + 1] * c - x[first + 2] * b
    force[rate + 4] += x[first + 2] * a - x[first] * c
    force[rate + 5] += x[first] * b - x[first + 1] * a


def count_product(x: Any, values: Any, rows: Any, force: Any) -> None:
    """Resultant and moment of minus a matrix times values (n_v,)."""
    start, column, value, rate = rows
    for first in range(0, start.size - 1, 3):
        a, b, c = 0.0, 0.0, 0.0
        for k in range(start[first], start[first + 1]):
            a -= value[k] * values[column[k]]
        for k in range(start[first + 1], start[first + 2]):
            b -= value[k] * values[column[k]]
        for k in range(start[first + 2], start[first + 3]):
            c -= value[k] * values[column[k]]
        count_force(a, b, c, first, x, rate, force)


def count_velocity_product(t: float, x: Any, v: Any, rows: Any, force: Any) -> None:
    """Resultant and moment of -D v."""
    count_product(x, v, rows, force)


def count_position_product(t: float, x: Any, v: Any, rows: Any, force: Any) -> None:
    """Resultant and moment of -K x."""
    count_product(x, x, rows, force)


def count_load(t: float, x: Any, v: Any, load: Any, force: Any) -> None:
    """Resultant and moment of a constant force."""
    value, rate = load
    for first in range(0, value.size, 3):
        a, b, c = value[first], value[first + 1], value[first + 2]
        count_force(a, b, c, first, x, rate, force)


def count_reactions(t: float, x: Any, v: Any, held: Any, force: Any) -> None:
    """Resultant and moment of what balances all forces on some nodes."""
    node, rate = held
    for k in range(node.size):
        first = node[k]
        a, b, c = -force[first], -force[first + 1], -force[first + 2]
        count_force(a, b, c, first, x, rate, force)


def add_mark(t: float, x: Any, v: Any, mark: Any, force: Any) -> None:
    """Resultant and moment of all that stands in force, times the sign."""
    particles, bodies, rate, sign = mark
    fx, fy, fz = force[rate], force[rate + 1], force[rate + 2]
    mx, my, mz = force[rate + 3], force[rate + 4], force[rate + 5]
    for k in range(particles):  # sums in local names: in memory they would take three times as long
        first = 3 * k
        a, b, c = sign * force[first], sign * force[first + 1], sign * force[first + 2]
        fx += a
        fy += b
        fz += c
        mx += x[first + 1] * c - x[first + 2] * b
        my += x[first + 2] * a - x[first] * c
        mz += x[first] * b - x[first + 1] * a
    for k in range(bodies):
        torque = 3 * (particles + k)
        a, b, c = in_scene_axes(x, 3 * particles + 4 * k, force[torque], force[torque + 1], force[torque + 2])
        mx += sign * a
        my += sign * b
        mz += sign * c
    force[rate], force[rate + 1], force[rate + 2] = fx, fy, fz
    force[rate + 3], force[rate + 4], force[rate + 5] = mx, my, mz
