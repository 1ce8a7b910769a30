"""Barrels that are fixed to a rigid body: a push along an axis that moves and turns with it.

Bullet b, at x_b, has gone the way s = a . R^T (x_b - x_c) - s_0 along its barrel: R turns the body's
principal axes into the scene's, a is the barrel's axis in the former, x_c the centre of mass, and s_0 makes
s zero at the start. What pushes has the potential U(s), F = -dU/ds. With r = x_b - x_c and n = R a, a virtual
displacement that turns the body by dtheta changes n by dtheta x n, and so the way by

    ds = n . (dx_b - dx_c) + dtheta . (n x r).

The virtual work F ds (Goldstein, Poole, Safko, "Classical Mechanics", 3rd ed., sec. 1.4; Lanczos, "The
Variational Principles of Mechanics", ch. III) is that of

    the force F n on the bullet, the force -F n on the body, and on it the torque F n x r = r x (-F n):

the reaction acts on the body at the bullet's place. Both forces lie on one line, so energy, momentum and
angular momentum are kept, wherever the bullet is beside its barrel and however the body turns. Barrels do not
hold bullets sideways: nothing pushes across the axis.

A bullet whose way has reached the stroke has left its barrel, and is not pushed again, wherever the barrel
turns to. U is zero from there on, so leaving costs no energy.

law : data with F0 `force` [N], `stroke` [m], and of gas its `dead_length` V [m], the volume behind the bullet
      over the bore's area, and `exponent` gamma of the adiabatic expansion
In the subset of Python that Numba compiles.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from exunet.forces.blocks import Blocks
from exunet.forces.loops import Index, in_body_axes, in_scene_axes
from exunet.forces.terms import Change, KernelTerm, Memories, Memory

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


class BarrelLaw(NamedTuple):
    """What pushes; see `exunet.forces.barrels`. Springs have the dead length and the exponent zero."""

    force: float
    stroke: float
    dead_length: float = 0.0
    exponent: float = 0.0


class Barrels(NamedTuple):
    """Barrels on a body, and what pushes in them.

    bullets  : (n,) 3 x node of each bullet
    inside   : (n,) 1.0 for bullets in their barrels, 0.0 for those that have left
    axes     : (n, 3) unit vectors of the barrels, in principal axes
    start    : (n,) where along its barrel each bullet starts, from the centre of mass [m]
    centre, attitude, spin : where the entries of the body begin, see `exunet.forces.blocks`
    force, stroke, dead_length, exponent : as of `BarrelLaw`
    """

    bullets: NDArray[Index]
    inside: Floats
    axes: Floats
    start: Floats
    centre: int
    attitude: int
    spin: int
    force: float
    stroke: float
    dead_length: float
    exponent: float


def push_term(blocks: Blocks, body: str, axes: Floats, law: BarrelLaw) -> KernelTerm:
    """The term of what pushes all bullets out of barrels on a body.

    axes : (n, 3) unit vectors of the barrels at the start, in the net's axes
    """
    number, bullets = blocks.rigid.index(body), blocks.net.bullet_nodes
    turn = blocks.poses.turn[number]
    own = axes @ blocks.poses.net.T @ turn
    arms = (blocks.position[bullets] - blocks.poses.centre[number]) @ turn
    inside, start = np.ones(len(bullets)), np.einsum("ba,ba->b", arms, own)
    places = blocks.centre(body), blocks.attitude(body), blocks.spin(body)
    data = Barrels((3 * bullets).astype(Index), inside, own, start, *places, *law)

    def of_inside(inside: Floats) -> Barrels:
        return data._replace(inside=inside)

    return KernelTerm(
        f"bullets and {body}",
        add_push_of_body,
        data,
        push_of_body_potential,
        (in_body_axes, in_scene_axes, way_in_barrel, push_from_body, *_LAWS),
        bodies=(body,) if body in blocks.free_bodies else (),
        memory=Memory("launch_force/inside", inside, of_inside),
        switch=Muzzles(data),
        internal=True,
    )


def spring_force(s: float, law: Any) -> float:
    """F0 (1 - s / stroke) [N]."""
    return law.force * (1.0 - s / law.stroke)


def spring_energy(s: float, law: Any) -> float:
    """F0 (stroke - s)^2 / (2 stroke) [J]: the work that a spring has still to do."""
    left = law.stroke - s
    return law.force * left * left / (2.0 * law.stroke)


def gas_force(s: float, law: Any) -> float:
    """F0 (V / (V + s))^gamma [N]; F0 behind the start."""
    ratio = law.dead_length / (law.dead_length + max(s, 0.0))
    return law.force * ratio**law.exponent


def gas_energy(s: float, law: Any) -> float:
    """The work that the gas in a barrel has still to do [J]."""
    dead, less = law.dead_length, law.exponent - 1.0
    inside = (dead / (dead + max(s, 0.0))) ** less - (dead / (dead + law.stroke)) ** less
    return law.force * (dead / less * inside - min(s, 0.0))


_LAWS = (spring_force, spring_energy, gas_force, gas_energy)


@dataclass(frozen=True, eq=False)
class Muzzles:
    """Bullets leave their barrels."""

    barrels: Barrels
    heading = ""
    times: tuple[float, ...] = ()

    def in_steps(self, memory: Floats) -> bool:
        """Until all have left."""
        return bool(memory.any())

    def crossed(self, time: float, x: Floats, v: Floats, memory: Floats) -> Ints:
        """Bullets in their barrels whose way is not below the stroke."""
        inside = np.flatnonzero(memory).tolist()
        out = [b for b in inside if way_in_barrel(x, b, self.barrels) >= self.barrels.stroke]
        return np.array(out, dtype=np.int64)

    def step_within(self, step: float, least: float, x: Floats, v: Floats, memory: Floats) -> float:
        """The same step: past the muzzle there is no force, whether a bullet counts as inside or not."""
        return step

    def change(
        self, time: float, x: Floats, v: Floats, memory: Floats, items: Ints, every: Memories
    ) -> Change:
        """They are not pushed again."""
        inside = memory.copy()
        inside[items] = 0.0
        return Change(inside)


# Scalar loops, in the subset of Python that Numba compiles.


def way_in_barrel(x: Any, b: int, barrels: Any) -> float:
    """Way s [m] of bullet b along its barrel since the start."""
    k, c = barrels.bullets[b], barrels.centre
    d, e, f = in_body_axes(x, barrels.attitude, x[k] - x[c], x[k + 1] - x[c + 1], x[k + 2] - x[c + 2])
    return barrels.axes[b, 0] * d + barrels.axes[b, 1] * e + barrels.axes[b, 2] * f - barrels.start[b]


def push_from_body(x: Any, b: int, push: float, barrels: Any, force: Any) -> None:
    """A force [N] on bullet b along its barrel, and the reaction on the body at the bullet's place."""
    k, c, n, q = barrels.bullets[b], barrels.centre, barrels.spin, barrels.attitude
    i, j, m = push * barrels.axes[b, 0], push * barrels.axes[b, 1], push * barrels.axes[b, 2]
    d, e, f = in_body_axes(x, q, x[k] - x[c], x[k + 1] - x[c + 1], x[k + 2] - x[c + 2])
    force[n] += j * f - m * e
    force[n + 1] += m * d - i * f
    force[n + 2] += i * e - j * d
    d, e, f = in_scene_axes(x, q, i, j, m)
    force[k] += d
    force[k + 1] += e
    force[k + 2] += f
    force[c] -= d
    force[c + 1] -= e
    force[c + 2] -= f


def add_push_of_body(t: float, x: Any, v: Any, barrels: Any, force: Any) -> None:
    """F(s) along each barrel while its bullet has not left it."""
    for b in range(barrels.bullets.size):
        if barrels.inside[b] > 0.0:
            s = way_in_barrel(x, b, barrels)
            if s < barrels.stroke:
                gas = barrels.exponent > 0.0
                push_from_body(
                    x, b, gas_force(s, barrels) if gas else spring_force(s, barrels), barrels, force
                )


def push_of_body_potential(x: Any, barrels: Any) -> float:
    """U(s) of each bullet in its barrel."""
    total = 0.0
    for b in range(barrels.bullets.size):
        if barrels.inside[b] > 0.0:
            s = way_in_barrel(x, b, barrels)
            if s < barrels.stroke:
                total += gas_energy(s, barrels) if barrels.exponent > 0.0 else spring_energy(s, barrels)
    return total
