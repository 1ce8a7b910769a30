"""Forces on rigid bodies: by mass, of points that a body holds, and external wrenches.

For dm at the place rho from the centre of mass, of a body with second moments J = int rho rho^T dm, which are
J_i = (I_x + I_y + I_z) / 2 - I_i along its principal axes:

- an acceleration G x, G symmetric, has the resultant m G x and the torque int rho x (G rho) dm, whose x
  part in the body's axes is (I_z - I_y) G_yz, and so on round (for the Earth's: Wie, "Space Vehicle Dynamics
  and Control", sec. 6.10); the potential is -(m x.Gx + trace(G J)) / 2;
- the Coriolis acceleration -w x (velocity), w = 2 n h, has the torque -int rho x (w x (omega x rho)) dm
  = omega x (J w), which does no work.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from exunet.base.arrays import Floats, Ints
from exunet.forces.blocks import Blocks
from exunet.forces.loops import Index, in_body_axes
from exunet.forces.terms import DiscreteStates, Input, KernelTerm

Indexes = NDArray[Index]


class WeightOfBodies(NamedTuple):
    """centre : (n,) where the places of the centres begin in x; load : (n, 3) [N]."""

    centre: Indexes
    load: Floats


class BodiesInField(NamedTuple):
    """Bodies in accelerations that are linear in place and velocity, in the scene's axes.

    centre, attitude, spin : (n,) where their entries begin in x and force
    mass, moments : (n,) [kg], (n, 3) principal moments [kg m2]
    gradient      : (3, 3) G [1/s2], symmetric
    at_centre     : 1.0: on the centres too; 0.0: their share is in another term
    turning       : (3,) w = 2 n h [1/s]
    """

    centre: Indexes
    attitude: Indexes
    spin: Indexes
    mass: Floats
    moments: Floats
    gradient: Floats
    at_centre: float
    turning: Floats


class BrakedBodies(NamedTuple):
    """factor : (n,) alpha m [kg/s]; turning : (n, 3) alpha I [kg m2/s]; centre, spin as above."""

    centre: Indexes
    spin: Indexes
    factor: Floats
    turning: Floats


def weight_on_bodies(blocks: Blocks, acceleration: ArrayLike) -> tuple[KernelTerm, ...]:
    """m g at each centre of mass, g (3,) [m/s2]."""
    if not len(blocks.inertia.mass):
        return ()
    names = blocks.free_bodies
    data = WeightOfBodies(entries(blocks, names)[0], np.outer(blocks.inertia.mass, np.array(acceleration)))
    return (KernelTerm("bodies", add_weight, data, weight_potential, bodies=names),)


def field_on_bodies(
    blocks: Blocks, gradient: Floats, turning: ArrayLike = (0.0, 0.0, 0.0), *, at_centre: bool = True
) -> tuple[KernelTerm, ...]:
    """An acceleration G x - w x v of every element of mass; see `BodiesInField`."""
    if not len(blocks.inertia.mass):
        return ()
    inertia, where = blocks.inertia, entries(blocks, blocks.free_bodies)
    turns, share = np.array(turning, dtype=float), 1.0 if at_centre else 0.0
    data = BodiesInField(*where, inertia.mass, inertia.moments, gradient, share, turns)
    fastest = float(np.linalg.norm(gradient, 2))
    return (
        KernelTerm(
            "bodies",
            add_field,
            data,
            field_potential,
            helpers=(in_body_axes, gradient_in_body_axes),
            bodies=blocks.free_bodies,
            stiffness_rate=fastest,
        ),
    )


def braking_on_bodies(blocks: Blocks, alpha: float) -> tuple[KernelTerm, ...]:
    """-alpha v on every element of mass: -alpha m v at the centre, and a torque -alpha I omega."""
    if not len(blocks.inertia.mass) or alpha == 0.0:
        return ()
    centre, _, spin = entries(blocks, blocks.free_bodies)
    data = BrakedBodies(centre, spin, alpha * blocks.inertia.mass, alpha * blocks.inertia.moments)
    return (KernelTerm("bodies", add_braking, data, bodies=blocks.free_bodies, damping_rate=alpha),)


def entries(blocks: Blocks, names: Iterable[str]) -> tuple[Indexes, Indexes, Indexes]:
    """Where the centres, attitudes and angular velocities of bodies begin, (n,) each."""
    found = np.array([(blocks.centre(name), blocks.attitude(name), blocks.spin(name)) for name in names])
    centre, attitude, spin = found.reshape(-1, 3).T.astype(Index, order="C")
    return centre, attitude, spin


def add_weight(t: float, x: Any, v: Any, weight: Any, force: Any) -> None:
    """m g at the centres."""
    for b in range(weight.centre.size):
        for axis in range(3):
            force[weight.centre[b] + axis] += weight.load[b, axis]


def weight_potential(x: Any, weight: Any) -> float:
    """-m g . x [J]."""
    total = 0.0
    for b in range(weight.centre.size):
        for axis in range(3):
            total -= weight.load[b, axis] * x[weight.centre[b] + axis]
    return total


def gradient_in_body_axes(x: Any, q: int, g: Any) -> Any:
    """The elements xx, yy, zz, yz, zx, xy of a symmetric matrix (3, 3) of the scene's axes in a body's."""
    a, b, c = in_body_axes(x, q, g[0, 0], g[1, 0], g[2, 0])
    d, e, f = in_body_axes(x, q, g[0, 1], g[1, 1], g[2, 1])
    h, i, j = in_body_axes(x, q, g[0, 2], g[1, 2], g[2, 2])
    xx, xy, _ = in_body_axes(x, q, a, d, h)
    _, yy, yz = in_body_axes(x, q, b, e, i)
    zx, _, zz = in_body_axes(x, q, c, f, j)
    return xx, yy, zz, yz, zx, xy


def add_field(t: float, x: Any, v: Any, field: Any, force: Any) -> None:
    """Resultants and torques of G x - w x v; see the module."""
    g, w = field.gradient, field.turning
    for b in range(field.centre.size):
        k, q, s, m = field.centre[b], field.attitude[b], field.spin[b], field.mass[b]
        for axis in range(3):
            pull = g[axis, 0] * x[k] + g[axis, 1] * x[k + 1] + g[axis, 2] * x[k + 2]
            force[k + axis] += field.at_centre * m * pull
        force[k] -= m * (w[1] * v[k + 2] - w[2] * v[k + 1])
        force[k + 1] -= m * (w[2] * v[k] - w[0] * v[k + 2])
        force[k + 2] -= m * (w[0] * v[k + 1] - w[1] * v[k])
        i = field.moments[b]
        _, _, _, yz, zx, xy = gradient_in_body_axes(x, q, g)
        half = 0.5 * (i[0] + i[1] + i[2])
        wx, wy, wz = in_body_axes(x, q, w[0], w[1], w[2])
        jx, jy, jz = (half - i[0]) * wx, (half - i[1]) * wy, (half - i[2]) * wz
        force[s] += (i[2] - i[1]) * yz + v[s + 1] * jz - v[s + 2] * jy
        force[s + 1] += (i[0] - i[2]) * zx + v[s + 2] * jx - v[s] * jz
        force[s + 2] += (i[1] - i[0]) * xy + v[s] * jy - v[s + 1] * jx


def field_potential(x: Any, field: Any) -> float:
    """-(m x.Gx + trace(G J)) / 2 [J]."""
    g = field.gradient
    total = 0.0
    for b in range(field.centre.size):
        k, i = field.centre[b], field.moments[b]
        for axis in range(3):
            pull = g[axis, 0] * x[k] + g[axis, 1] * x[k + 1] + g[axis, 2] * x[k + 2]
            total -= 0.5 * field.at_centre * field.mass[b] * x[k + axis] * pull
        xx, yy, zz, _, _, _ = gradient_in_body_axes(x, field.attitude[b], g)
        half = 0.5 * (i[0] + i[1] + i[2])
        total -= 0.5 * ((half - i[0]) * xx + (half - i[1]) * yy + (half - i[2]) * zz)
    return total


def add_braking(t: float, x: Any, v: Any, braked: Any, force: Any) -> None:
    """-alpha m v, and -alpha I omega."""
    for b in range(braked.centre.size):
        for axis in range(3):
            force[braked.centre[b] + axis] -= braked.factor[b] * v[braked.centre[b] + axis]
            force[braked.spin[b] + axis] -= braked.turning[b, axis] * v[braked.spin[b] + axis]


@dataclass(frozen=True, eq=False)
class Held:
    """Points that are fixed to a body as long as a discrete state says so.

    discrete : its name; the first of its values is the number of points that are held, the first of these
    start  : that number at time 0
    points : (n,)
    body   : number among the rigid bodies
    arm    : (n, 3) of each from the centre of mass, in principal axes [m]
    mass   : (n,) of each [kg], which stays its own
    tie    : the attachment or the end of a tether that holds the point, by which a script releases it; "": of
             another kind
    """

    discrete: str
    start: int
    points: Ints
    body: int
    arm: Floats
    mass: Floats
    tie: str = ""

    def number(self, discrete: DiscreteStates) -> int:
        """How many are held at these discrete states; at the start without any."""
        return int(discrete[self.discrete][0]) if self.discrete in discrete else self.start


def held_by(every: Iterable[Held], body: int, discrete: DiscreteStates) -> tuple[Floats, Floats]:
    """Masses (n,) [kg] and arms (n, 3) [m] of the points that a body holds at these discrete states."""
    own = [(item, item.number(discrete)) for item in every if item.body == body]
    masses = [one.mass[:n] for one, n in own]
    arms = [one.arm[:n] for one, n in own]
    return np.concatenate([np.zeros(0), *masses]), np.concatenate([np.zeros((0, 3)), *arms])


def mass_matrix(mass: float, moments: Floats, held: Floats, arm: Floats) -> Floats:
    """(6, 6) of a body with masses fixed to it, for the acceleration of its centre and its angular one.

    mass, moments (3,) : of the body itself [kg], [kg m2]; held (n,) [kg] at arm (n, 3) [m], in principal axes

    Of momentum and angular momentum about the body's own centre of mass: the rows of
    sum m (a + alpha x p) and J alpha + sum m p x (a + alpha x p).
    """
    first = held @ arm
    across = np.array([[0.0, -first[2], first[1]], [first[2], 0.0, -first[0]], [-first[1], first[0], 0.0]])
    second = (held[:, None] * arm).T @ arm
    matrix = np.zeros((6, 6))
    matrix[:3, :3] = (mass + held.sum()) * np.eye(3)
    matrix[:3, 3:] = -across
    matrix[3:, :3] = across
    matrix[3:, 3:] = np.diag(moments) + np.trace(second) * np.eye(3) - second
    return matrix


UNITS = "N, N m"


class Wrench(NamedTuple):
    """A force and a torque on a body, in the scene's axes.

    centre, attitude, spin : where the entries of the body begin
    arm  : (3,) where the force acts, from the centre of mass in principal axes [m]
    load : (6,) force [N], torque [N m]
    """

    centre: int
    attitude: int
    spin: int
    arm: Floats
    load: Floats


def input_name(body: str) -> str:
    """The name of the input that holds the wrench on a body."""
    return f"wrench/{body}"


def wrench_on(blocks: Blocks, body: str, arm: Floats) -> KernelTerm:
    """Force [N] at a point of a free body and torque [N m], in the scene's axes; zero until given.

    arm : (3,) of the point from the centre of mass, in principal axes [m]
    """
    where = blocks.centre(body), blocks.attitude(body), blocks.spin(body)
    given = Input(input_name(body), "load", np.zeros(6), UNITS)
    data = Wrench(*where, arm, np.zeros(6))
    return KernelTerm("bodies", add_wrench, data, helpers=(in_body_axes,), bodies=(body,), inputs=(given,))


def add_wrench(t: float, x: Any, v: Any, wrench: Any, force: Any) -> None:
    """The force in the scene's axes, the torque, and that of the force's arm, in those of the body."""
    load, arm = wrench.load, wrench.arm
    a, b, c = in_body_axes(x, wrench.attitude, load[3], load[4], load[5])
    d, e, f = in_body_axes(x, wrench.attitude, load[0], load[1], load[2])
    for axis in range(3):
        force[wrench.centre + axis] += load[axis]
    force[wrench.spin] += a + arm[1] * f - arm[2] * e
    force[wrench.spin + 1] += b + arm[2] * d - arm[0] * f
    force[wrench.spin + 2] += c + arm[0] * e - arm[1] * d
