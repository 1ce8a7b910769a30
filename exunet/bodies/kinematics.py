"""Kinematic constraints: bodies with prescribed motion and nodes fixed to bodies, with their scalar loops.

Bodies whose motion is prescribed and points that are fixed to bodies have entries in x, v and force as all
others,
but no equations of motion: what they are is put into x and v before the forces are summed (`place`), and what
pulls at them goes on to what carries them afterwards (`add`). `exunet.bodies.kinematics` states the same on
whole arrays; the tests hold the two against each other. The text of these functions is copied into a scene's
module of a kind of force (see `exunet.kernels.kernel`), so they use no global name but each other's.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
from itertools import islice
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from exunet.base.arrays import Floats, Ints
from exunet.bodies.port import Piece, PrescribedMotion
from exunet.bodies.rigid import RigidStates
from exunet.bodies.rotations import rotation_matrix
from exunet.forces.blocks import Blocks, FirstOrder
from exunet.forces.loops import Index, in_body_axes, in_scene_axes
from exunet.forces.on_bodies import Held, entries, held_by, mass_matrix
from exunet.forces.terms import Constraint, DiscreteStates, KernelCall, unchanged

Indexes = NDArray[Index]


class Prescribed(NamedTuple):
    """Bodies whose motion is prescribed, as in `PrescribedMotion`; all pieces of all bodies in one list.

    first    : (n + 1,) where the pieces of each body begin in the list
    time, position, attitude, turning : (m,), (m, 4, 3), (m, 4), (m, 4, 3) of the pieces
    offset   : (n, 3) of the centre of mass from the prescribed point [m]
    centre, quaternion, spin, rate : (n,) where their entries begin, see `exunet.forces.blocks`: rate that of
               the impulse [N s], the angular impulse about the origin [N m s] and the work [J] that they give
    """

    first: NDArray[np.int64]
    time: Floats
    position: Floats
    attitude: Floats
    turning: Floats
    offset: Floats
    centre: Indexes
    quaternion: Indexes
    spin: Indexes
    rate: Indexes


class Attached(NamedTuple):
    """Points that are fixed to bodies.

    point : (n,) where the entries of the point begin
    centre, quaternion, spin : (n,) where those of its body begin
    arm   : (n, 3) from the centre of mass, in principal axes [m]
    """

    point: Indexes
    centre: Indexes
    quaternion: Indexes
    spin: Indexes
    arm: Floats


class HeldMasses(NamedTuple):
    """Bodies with masses that they hold for a while, beside those that are always fixed to them.

    centre, quaternion, spin : (n,) where the entries of each body begin
    mass, moments : (n,) [kg], (n, 3) [kg m2] of the body itself
    first         : (n, 3) sum of m p over the held masses, p from the centre of mass in principal axes [kg m]
    second        : (n, 3, 3) sum of m p p^T [kg m2]
    inverse       : (n, 6, 6) of the mass matrix of body and held masses, see `exunet.forces.on_bodies`
    """

    centre: Indexes
    quaternion: Indexes
    spin: Indexes
    mass: Floats
    moments: Floats
    first: Floats
    second: Floats
    inverse: Floats


class OnPrescribed(NamedTuple):
    """Masses that bodies with a prescribed motion hold for a while.

    first, time, position, turning, offset, centre, quaternion, spin : of these bodies, as in `Prescribed`
    mass   : (n,) of what each holds [kg]
    moment : (n, 3) sum of m p over it, p from the centre of mass in principal axes [kg m]
    second : (n, 3, 3) sum of m p p^T [kg m2]
    """

    first: NDArray[np.int64]
    time: Floats
    position: Floats
    turning: Floats
    offset: Floats
    centre: Indexes
    quaternion: Indexes
    spin: Indexes
    mass: Floats
    moment: Floats
    second: Floats


def piece_of_motion(t: float, prescribed: Any, b: int) -> Any:
    """Return the number of the piece of a body's motion at time t [s], and the time since it began [s]."""
    piece = prescribed.first[b]
    while piece + 1 < prescribed.first[b + 1] and t >= prescribed.time[piece + 1]:
        piece += 1
    return piece, t - prescribed.time[piece]


def place_prescribed(t: float, x: Any, v: Any, prescribed: Any) -> None:
    """Put the poses at time t [s], and their rates, of the prescribed bodies into x and v."""
    angle = np.empty(3)
    rate = np.empty(3)
    for b in range(prescribed.centre.size):
        piece, s = piece_of_motion(t, prescribed, b)
        square = 0.0
        for axis in range(3):
            c = prescribed.turning[piece, :, axis]
            angle[axis] = ((c[0] * s + c[1]) * s + c[2]) * s + c[3]
            rate[axis] = (3.0 * c[0] * s + 2.0 * c[1]) * s + c[2]
            square += angle[axis] * angle[axis]
        size = math.sqrt(square)
        half = 0.5 * size
        if size < 1e-3:  # where the differences lose digits, two terms of their series are exact
            ratio = 0.5 - square / 48.0
            of_first = 0.5 - square / 24.0
            of_second = 1.0 / 6.0 - square / 120.0
        else:
            ratio = math.sin(half) / size
            of_first = 2.0 * ratio * ratio
            of_second = (size - math.sin(size)) / (square * size)
        q = prescribed.quaternion[b]
        w, i, j, k = prescribed.attitude[piece]
        real = math.cos(half)
        d, e, f = ratio * angle[0], ratio * angle[1], ratio * angle[2]
        x[q] = w * real - i * d - j * e - k * f
        x[q + 1] = w * d + i * real + j * f - k * e
        x[q + 2] = w * e - i * f + j * real + k * d
        x[q + 3] = w * f + i * e - j * d + k * real
        d = angle[1] * rate[2] - angle[2] * rate[1]
        e = angle[2] * rate[0] - angle[0] * rate[2]
        f = angle[0] * rate[1] - angle[1] * rate[0]
        n = prescribed.spin[b]
        v[n] = rate[0] - of_first * d + of_second * (angle[1] * f - angle[2] * e)
        v[n + 1] = rate[1] - of_first * e + of_second * (angle[2] * d - angle[0] * f)
        v[n + 2] = rate[2] - of_first * f + of_second * (angle[0] * e - angle[1] * d)
        n = prescribed.centre[b]
        for axis in range(3):
            c = prescribed.position[piece, :, axis]
            x[n + axis] = ((c[0] * s + c[1]) * s + c[2]) * s + c[3]
            v[n + axis] = (3.0 * c[0] * s + 2.0 * c[1]) * s + c[2]
        o = prescribed.offset[b]
        add_arm(x, v, n, n, q, prescribed.spin[b], (o[0], o[1], o[2]))


def add_arm(x: Any, v: Any, to: int, base: int, q: int, n: int, arm: Any) -> None:
    """The place and velocity of a point of a body at `to`, from those at `base` and an arm in its axes.

    q, n : where the body's attitude and its spin begin in x and v; arm : (3) [m]
    """
    a, b, c = arm
    d, e, f = in_scene_axes(x, q, a, b, c)
    x[to], x[to + 1], x[to + 2] = x[base] + d, x[base + 1] + e, x[base + 2] + f
    d, e, f = in_scene_axes(
        x, q, v[n + 1] * c - v[n + 2] * b, v[n + 2] * a - v[n] * c, v[n] * b - v[n + 1] * a
    )
    v[to], v[to + 1], v[to + 2] = v[base] + d, v[base + 1] + e, v[base + 2] + f


def place_attached(t: float, x: Any, v: Any, attached: Any) -> None:
    """Put the places and velocities of the attached points into x and v."""
    for p in range(attached.point.size):
        arm = attached.arm[p]
        base, q, n = attached.centre[p], attached.quaternion[p], attached.spin[p]
        add_arm(x, v, attached.point[p], base, q, n, (arm[0], arm[1], arm[2]))


def carry_forces(t: float, x: Any, v: Any, attached: Any, force: Any) -> None:
    """Hand the forces on attached points over to their bodies, with their torque."""
    for p in range(attached.point.size):
        k, base, n = attached.point[p], attached.centre[p], attached.spin[p]
        a, b, c = force[k], force[k + 1], force[k + 2]
        force[base] += a
        force[base + 1] += b
        force[base + 2] += c
        a, b, c = in_body_axes(x, attached.quaternion[p], a, b, c)
        arm = attached.arm[p]
        force[n] += arm[1] * c - arm[2] * b
        force[n + 1] += arm[2] * a - arm[0] * c
        force[n + 2] += arm[0] * b - arm[1] * a
        force[k] = 0.0
        force[k + 1] = 0.0
        force[k + 2] = 0.0


def share_with_held(t: float, x: Any, v: Any, held: Any, force: Any) -> None:
    """Leave to a body the part of its force and torque that accelerates itself, not the masses it holds.

    In principal axes, f and c force and torque about the centre of mass, P = sum of m p p^T:

        A (a, alpha) = (f - w x (w x sum m p), c - w x J w + w x P w)

    with A of body and held masses. What is left is M a and J alpha + w x J w, by which the body alone moves
    so: Newton's and Euler's laws with the forces that hold the masses, m (a + alpha x p + w x (w x p)).
    """
    given = np.empty(6)
    for b in range(held.centre.size):
        base, q, n = held.centre[b], held.quaternion[b], held.spin[b]
        i, j, k = v[n], v[n + 1], v[n + 2]
        s, p, m = held.first[b], held.second[b], held.moments[b]
        f, g, h = in_body_axes(x, q, force[base], force[base + 1], force[base + 2])
        along, square = i * s[0] + j * s[1] + k * s[2], i * i + j * j + k * k
        given[0] = f - along * i + square * s[0]
        given[1] = g - along * j + square * s[1]
        given[2] = h - along * k + square * s[2]
        # J w - P w, which w x turns
        d = m[0] * i - (p[0, 0] * i + p[0, 1] * j + p[0, 2] * k)
        e = m[1] * j - (p[1, 0] * i + p[1, 1] * j + p[1, 2] * k)
        c = m[2] * k - (p[2, 0] * i + p[2, 1] * j + p[2, 2] * k)
        given[3] = force[n] - (j * c - k * e)
        given[4] = force[n + 1] - (k * d - i * c)
        given[5] = force[n + 2] - (i * e - j * d)
        own = held.inverse[b] @ given
        mass = held.mass[b]
        f, g, h = in_scene_axes(x, q, mass * own[0], mass * own[1], mass * own[2])
        force[base], force[base + 1], force[base + 2] = f, g, h
        force[n] = m[0] * own[3] + (m[2] - m[1]) * j * k
        force[n + 1] = m[1] * own[4] + (m[0] - m[2]) * k * i
        force[n + 2] = m[2] * own[5] + (m[1] - m[0]) * i * j


def angular_acceleration(angle: Any, rate: Any, bend: Any, out: Any) -> None:
    """Compute the angular acceleration of a rotation vector p with p', p'' (3,) into `out` (3,), body axes.

    The derivative of w = p' - f p x p' + g p x (p x p'), f = (1 - cos a)/a^2, g = (a - sin a)/a^3, a = |p|:

        p'' - f p x p'' + g (p x (p x p'') + p' x (p x p')) - f' p x p' + g' p x (p x p'),

    f' = p.p' (sin a/a - 2 f)/a^2, g' = p.p' (f - 3 g)/a^2.
    """
    square = angle[0] * angle[0] + angle[1] * angle[1] + angle[2] * angle[2]
    if square < 1e-4:  # where the differences lose digits, three terms of their series are exact
        f = 0.5 - square / 24.0 * (1.0 - square / 30.0)
        g = 1.0 / 6.0 - square / 120.0 * (1.0 - square / 42.0)
        of_f = -1.0 / 12.0 + square / 180.0 * (1.0 - square * 3.0 / 112.0)
        of_g = -1.0 / 60.0 + square / 1260.0 * (1.0 - square / 48.0)
    else:
        size = math.sqrt(square)
        ratio = math.sin(0.5 * size) / size
        f = 2.0 * ratio * ratio
        g = (size - math.sin(size)) / (square * size)
        of_f = (math.sin(size) / size - 2.0 * f) / square
        of_g = (f - 3.0 * g) / square
    along = angle[0] * rate[0] + angle[1] * rate[1] + angle[2] * rate[2]
    i, j, k = angle[0], angle[1], angle[2]
    a, b, c = j * rate[2] - k * rate[1], k * rate[0] - i * rate[2], i * rate[1] - j * rate[0]
    # what is turned once more by p, and what is not
    d, e, h = j * bend[2] - k * bend[1], k * bend[0] - i * bend[2], i * bend[1] - j * bend[0]
    once, twice = along * of_f, along * of_g
    m, n, o = g * d + twice * a, g * e + twice * b, g * h + twice * c
    out[0] = bend[0] - f * d - once * a + j * o - k * n + g * (rate[1] * c - rate[2] * b)
    out[1] = bend[1] - f * e - once * b + k * m - i * o + g * (rate[2] * a - rate[0] * c)
    out[2] = bend[2] - f * h - once * c + i * n - j * m + g * (rate[0] * b - rate[1] * a)


def add_swing(turns: Any, i: float, j: float, k: float, arm: Any, out: Any) -> None:
    """Add u x r + w x (w x r) to `out`, u angular acceleration (3,), w = (i, j, k), r arm (3,)."""
    a, b, c = arm[0], arm[1], arm[2]
    along, square = i * a + j * b + k * c, i * i + j * j + k * k
    out[0] += turns[1] * c - turns[2] * b + along * i - square * a
    out[1] += turns[2] * a - turns[0] * c + along * j - square * b
    out[2] += turns[0] * b - turns[1] * a + along * k - square * c


def bear_held(t: float, x: Any, v: Any, held: Any, force: Any) -> None:
    """Take from force and torque on a prescribed body what the masses that it holds need to move with it.

    In principal axes, with a acceleration of the centre of mass, u angular acceleration, P = sum of m p p^T:

        force   sum m (a + u x p + w x (w x p))
        torque  sum m p x a + (tr P - P) u - w x P w
    """
    angle, rate, bend, line = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    turns, a, own = np.empty(3), np.empty(3), np.empty(3)
    for b in range(held.centre.size):
        base, q, n = held.centre[b], held.quaternion[b], held.spin[b]
        i, j, k, mass = v[n], v[n + 1], v[n + 2], held.mass[b]
        piece, s = piece_of_motion(t, held, b)
        for axis in range(3):
            c = held.turning[piece, :, axis]
            angle[axis] = ((c[0] * s + c[1]) * s + c[2]) * s + c[3]
            rate[axis] = (3.0 * c[0] * s + 2.0 * c[1]) * s + c[2]
            bend[axis] = 6.0 * c[0] * s + 2.0 * c[1]
            c = held.position[piece, :, axis]
            line[axis] = 6.0 * c[0] * s + 2.0 * c[1]
        angular_acceleration(angle, rate, bend, turns)
        a[0], a[1], a[2] = in_body_axes(x, q, line[0], line[1], line[2])
        add_swing(turns, i, j, k, held.offset[b], a)
        for axis in range(3):
            own[axis] = mass * a[axis]
        first, p = held.moment[b], held.second[b]
        add_swing(turns, i, j, k, first, own)
        d, e, f = in_scene_axes(x, q, own[0], own[1], own[2])
        force[base] -= d
        force[base + 1] -= e
        force[base + 2] -= f
        trace = p[0, 0] + p[1, 1] + p[2, 2]
        for axis in range(3):
            own[axis] = p[axis, 0] * i + p[axis, 1] * j + p[axis, 2] * k
            force[n + axis] -= trace * turns[axis] - (
                p[axis, 0] * turns[0] + p[axis, 1] * turns[1] + p[axis, 2] * turns[2]
            )
        force[n] -= first[1] * a[2] - first[2] * a[1] - (j * own[2] - k * own[1])
        force[n + 1] -= first[2] * a[0] - first[0] * a[2] - (k * own[0] - i * own[2])
        force[n + 2] -= first[0] * a[1] - first[1] * a[0] - (i * own[1] - j * own[0])


def give_to_others(t: float, x: Any, v: Any, prescribed: Any, force: Any) -> None:
    """The rates of what prescribed bodies give: impulse, angular impulse about the origin, work."""
    for b in range(prescribed.centre.size):
        n, k, to = prescribed.centre[b], prescribed.spin[b], prescribed.rate[b]
        d, e, f = force[n], force[n + 1], force[n + 2]
        i, j, m = in_scene_axes(x, prescribed.quaternion[b], force[k], force[k + 1], force[k + 2])
        force[to] -= d
        force[to + 1] -= e
        force[to + 2] -= f
        force[to + 3] -= i + x[n + 1] * f - x[n + 2] * e
        force[to + 4] -= j + x[n + 2] * d - x[n] * f
        force[to + 5] -= m + x[n] * e - x[n + 1] * d
        power = d * v[n] + e * v[n + 1] + f * v[n + 2]
        force[to + 6] -= power + force[k] * v[k] + force[k + 1] * v[k + 1] + force[k + 2] * v[k + 2]


# What a prescribed body gives to all else, as first-order states of the system: name, size, units.
GIVEN = (("impulse", 3, "N s"), ("angular_impulse", 3, "N m s"), ("work", 1, "J"))


def first_given(name: str) -> str:
    """The first of the states that keep what the prescribed body of this name gives."""
    return f"{name}/{GIVEN[0][0]}"


def given_states(name: str, already: Sequence[float] = (0.0,) * 7) -> tuple[FirstOrder, ...]:
    """The states that keep what the prescribed body of this name gives; `already` at time 0."""
    left = iter(already)
    return tuple(
        FirstOrder(f"{name}/{quantity}", tuple(islice(left, size)), units, gives=float(quantity == "work"))
        for quantity, size, units in GIVEN
    )


class OnBodies(NamedTuple):
    """Points (n,), the number of each one's body (n,), its arm (n, 3) in principal axes [m]."""

    point: Ints
    body: Ints
    arm: Floats


@dataclass(frozen=True, eq=False)
class Kinematics:
    """The constraints of a system.

    n_free : number of free bodies, which come before the others
    motions : prescribed ones of bodies, in their order
    ports  : numbers of those among them whose prescribed motion a host gives piece by piece as the run goes;
             what is here is their motion at the start
    point  : (n,) points that are fixed to bodies
    body   : (n,) the number of the body of each
    arm    : (n, 3) of each from the centre of mass, in principal axes [m]
    held   : points that bodies hold for a while
    """

    n_free: int = 0
    motions: tuple[PrescribedMotion, ...] = ()
    ports: tuple[int, ...] = ()
    point: Ints = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    body: Ints = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    arm: Floats = field(default_factory=lambda: np.zeros((0, 3)))
    held: tuple[Held, ...] = ()

    def __bool__(self) -> bool:
        return bool(self.motions or self.held) or len(self.point) > 0

    @cached_property
    def ties(self) -> dict[str, Held]:
        """The attachments and ends of tethers that a script may release, or has released, by name."""
        return {item.tie: item for item in self.held if item.tie}

    @cached_property
    def tied(self) -> Ints:
        """The points that are fixed to bodies, some of them until they are released."""
        return np.concatenate([self.point, *(tie.points for tie in self.ties.values())])

    @cached_property
    def tied_to(self) -> Ints:
        """The number of the body of each point in `tied`."""
        owners = (np.full(len(tie.points), tie.body) for tie in self.ties.values())
        return np.concatenate([self.body, *owners])

    @cached_property
    def knots(self) -> tuple[float, ...]:
        """Instants [s] at which prescribed motions go to their next piece, where they are less smooth."""
        within = (motion.time[1:].tolist() for motion in self.motions)
        return tuple(sorted({time for times in within for time in times}))

    def on_bodies(self, discrete: DiscreteStates) -> OnBodies:
        """The points that are fixed to bodies at these discrete states, held ones last."""
        fixed = OnBodies(self.point, self.body, self.arm)
        if not self.held:
            return fixed
        parts = [fixed]
        for item in self.held:
            n = item.number(discrete)
            parts.append(OnBodies(item.points[:n], np.full(n, item.body), item.arm[:n]))
        return OnBodies(*(np.concatenate(values) for values in zip(*parts, strict=True)))

    def holds(self, discrete: DiscreteStates) -> Ints:
        """The points that bodies hold for a while, at these discrete states."""
        every = [item.points[: item.number(discrete)] for item in self.held]
        return np.concatenate(every) if every else np.zeros(0, dtype=np.int64)

    def completed(
        self, time: Floats, position: Floats, velocity: Floats, bodies: RigidStates, discrete: DiscreteStates
    ) -> tuple[Floats, Floats, RigidStates]:
        """States at times (...) [s] with what has no equations of motion put in; copies.

        position, velocity : (..., n_points, 3); bodies : the free ones, or all; discrete : of all the
                             states
        """
        if not self:
            return position, velocity, bodies
        bodies = self.all_bodies(time, bodies)
        point, body, arm = self.on_bodies(discrete)
        if len(point):
            turn = rotation_matrix(bodies.attitude[..., body, :])
            spin = bodies.angular_velocity[..., body, :]
            position, velocity = position.copy(), velocity.copy()
            lever = np.einsum("...nij,nj->...ni", turn, arm)
            swing = np.einsum("...nij,...nj->...ni", turn, np.cross(spin, arm))
            position[..., point, :] = bodies.position[..., body, :] + lever
            velocity[..., point, :] = bodies.velocity[..., body, :] + swing
        return position, velocity, bodies

    def all_bodies(self, time: Floats, bodies: RigidStates) -> RigidStates:
        """States at times (...) [s] of all bodies, by those of the free ones and of ports, or of all."""
        if not self.motions:
            return bodies
        moved = [motion.at(time.reshape(-1)).parts() for motion in self.motions]
        whole = []
        for own, prescribed in zip(bodies.parts(), zip(*moved, strict=True), strict=True):
            rows = [values.reshape(*time.shape, 1, -1) for values in prescribed]
            for number in self.ports:
                rows[number - self.n_free] = own[..., number : number + 1, :]
            whole.append(np.concatenate([own[..., : self.n_free, :], *rows], axis=-2))
        return RigidStates(*whole)

    def term(self, blocks: Blocks) -> Constraint | None:
        """The constraints as compiled functions take them; None without any."""
        if not self:
            return None
        calls: list[KernelCall] = []
        data: list[Callable[[DiscreteStates], tuple[Any, ...]]] = []

        def add(call: KernelCall, of: Callable[[DiscreteStates], tuple[Any, ...]]) -> None:
            calls.append(call)
            data.append(of)

        turns = (in_scene_axes, in_body_axes)
        if len(self.point) or self.held:
            place, helpers = place_attached, (*turns, add_arm)
            attached = partial(_attached, self, blocks)
            add(KernelCall(carry_forces, attached({}), place=place, helpers=helpers), attached)
        if any(item.body < self.n_free for item in self.held):
            masses = partial(_held_masses, self, blocks)
            add(KernelCall(share_with_held, masses({}), helpers=turns), masses)
        if self.motions:
            prescribed, own = _prescribed(self, blocks), (in_scene_axes, add_arm, piece_of_motion)
            if any(entry.body in _moving(self) for entry in self.held):
                borne, turned = partial(_on_prescribed, self, blocks), (*turns, *_OF_PRESCRIBED)
                add(KernelCall(bear_held, borne({}), helpers=turned), borne)
            call = KernelCall(give_to_others, prescribed, place=place_prescribed, helpers=own)
            add(call, partial(unchanged, prescribed))
        owners = [*self.body.tolist(), *(element.body for element in self.held)]
        pulled = {blocks.rigid[k] for k in owners if k < self.n_free}
        return Constraint(tuple(calls), tuple(data), tuple(sorted(pulled)))


def _attached(kinematics: Kinematics, blocks: Blocks, discrete: DiscreteStates) -> Attached:
    point, body, arm = kinematics.on_bodies(discrete)
    centre, quaternion, spin = entries(blocks, [blocks.rigid[k] for k in body.tolist()])
    return Attached((3 * point).astype(Index), centre, quaternion, spin, arm)


def _held_masses(kinematics: Kinematics, blocks: Blocks, discrete: DiscreteStates) -> HeldMasses:
    """Build the mass data of the free bodies that may hold points."""
    numbers = sorted({item.body for item in kinematics.held if item.body < kinematics.n_free})
    first, second, inverse = [], [], []
    for number in numbers:
        mass, arm = held_by(kinematics.held, number, discrete)
        first.append(mass @ arm)
        second.append((mass[:, None] * arm).T @ arm)
        own = blocks.inertia.mass[number], blocks.inertia.moments[number]
        inverse.append(np.linalg.inv(mass_matrix(*own, mass, arm)))
    centre, quaternion, spin = entries(blocks, [blocks.rigid[k] for k in numbers])
    return HeldMasses(
        centre,
        quaternion,
        spin,
        mass=blocks.inertia.mass[numbers],
        moments=blocks.inertia.moments[numbers],
        first=np.array(first),
        second=np.array(second),
        inverse=np.array(inverse),
    )


_OF_PRESCRIBED = (piece_of_motion, angular_acceleration, add_swing)


def _moving(kinematics: Kinematics) -> dict[int, PrescribedMotion]:
    """The bodies whose motion is prescribed, by number, but for those that rest."""
    motions = enumerate(kinematics.motions, kinematics.n_free)
    return {number: motion for number, motion in motions if number in kinematics.ports or not motion.rests}


def _on_prescribed(kinematics: Kinematics, blocks: Blocks, discrete: DiscreteStates) -> OnPrescribed:
    """Build the data of the prescribed bodies in motion that may hold points."""
    moving = _moving(kinematics)
    numbers = sorted({item.body for item in kinematics.held if item.body in moving})
    masses, first, second = [], [], []
    for number in numbers:
        mass, arm = held_by(kinematics.held, number, discrete)
        masses.append(mass.sum())
        first.append(mass @ arm)
        second.append((mass[:, None] * arm).T @ arm)
    centre, quaternion, spin = entries(blocks, [blocks.rigid[k] for k in numbers])
    return OnPrescribed(
        **_pieces([moving[number] for number in numbers]),
        centre=centre,
        quaternion=quaternion,
        spin=spin,
        mass=np.array(masses),
        moment=np.array(first),
        second=np.array(second),
    )


def _pieces(motions: Sequence[PrescribedMotion]) -> dict[str, Any]:
    """Concatenate the pieces of motions, by the field names that `Prescribed` and `OnPrescribed` share."""
    return {
        "first": np.cumsum([0, *(len(motion.time) for motion in motions)]),
        "time": np.concatenate([motion.time for motion in motions]),
        "position": np.concatenate([motion.position for motion in motions]),
        "turning": np.concatenate([motion.turning for motion in motions]),
        "offset": np.stack([motion.offset for motion in motions]),
    }


def _prescribed(kinematics: Kinematics, blocks: Blocks) -> Prescribed:
    motions, names = kinematics.motions, blocks.rigid[kinematics.n_free :]
    centre, quaternion, spin = entries(blocks, names)
    return Prescribed(
        **_pieces(motions),
        attitude=np.concatenate([motion.attitude for motion in motions]),
        centre=centre,
        quaternion=quaternion,
        spin=spin,
        rate=np.array([blocks.rate(first_given(name)) for name in names], dtype=Index),
    )


def sites_of(data: Iterable[Any], centre: int) -> tuple[tuple[Any, int], ...]:
    """Where a kernel's data have the piece of a port whose centre begins at `centre`: parts, and rows."""
    prescribed = [part for part in data if isinstance(part, Prescribed | OnPrescribed)]
    return tuple(
        (part, int(part.first[b]))
        for part in prescribed
        for b in np.flatnonzero(part.centre == centre).tolist()
    )


def steer(sites: Iterable[tuple[Any, int]], piece: Piece) -> None:
    """Let a port go along a piece: in place, in the data of a kernel."""
    for part, row in sites:
        part.time[row], part.position[row], part.turning[row] = piece.time, piece.position, piece.turning
        if isinstance(part, Prescribed):
            part.attitude[row] = piece.attitude
