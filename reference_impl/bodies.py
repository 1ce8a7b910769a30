"""Bodies beside the net: free ones, and those whose motion is prescribed.

Positions of the frame's origin are natural cubic splines (de Boor, A Practical Guide to Splines, ch. IV);
rotations between neighbouring attitudes are cubic rotation vectors with continuous angular velocity and
acceleration (SciPy's RotationSpline).  After the last pose the last piece goes on.

A rigid body is carried as its rotation matrix R, which turns the body's axes into the scene's, and its
angular momentum h about the centre of mass in the scene's axes (Goldstein, Classical Mechanics, ch. 5):

    h' = torque,  R' = [w]x R,  w = R J^-1 R^T h,

J the matrix of inertia about the centre of mass in the body's axes, which need not be principal ones.  Where
no torque acts, h stays what it was to the last bit.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation, RotationSpline

from reference_impl.arrays import Floats, Ints, Vector, cross, skew, turned
from reference_impl.solids import Block


@dataclass(frozen=True, eq=False)
class Guided:
    """A given motion at times (...): of the centre of mass, and of the body's axes; in the scene's axes."""

    position: Floats  # (..., 3) [m]
    velocity: Floats  # (..., 3) [m/s]
    acceleration: Floats  # (..., 3) [m/s2]
    attitude: Floats  # (..., 3, 3)
    turning: Floats  # (..., 3) [rad/s]
    angular: Floats  # (..., 3) [rad/s2]


@dataclass(frozen=True, eq=False)
class Steady:
    """Constant velocity of the centre of mass and constant angular velocity, both maybe zero."""

    position: Floats  # (3,) [m] of the centre of mass at time 0
    velocity: Floats  # (3,) [m/s]
    attitude: Floats  # (3, 3) at time 0
    turning: Floats  # (3,) [rad/s] in the scene's axes

    def at(self, t: Floats) -> Guided:
        """The motion at times (...) [s]."""
        time = np.asarray(t)[..., None]
        shape = (*np.shape(t), 3)
        attitude = turned(np.broadcast_to(self.attitude, (*shape, 3)), time * self.turning)
        return Guided(
            self.position + time * self.velocity,
            np.broadcast_to(self.velocity, shape),
            np.zeros(shape),
            attitude,
            np.broadcast_to(self.turning, shape),
            np.zeros(shape),
        )


@dataclass(frozen=True, eq=False)
class Poses:
    """Poses of the body's frame at q times."""

    times: tuple[float, ...]  # [s]
    positions: tuple[Vector, ...]  # [m] of the frame's origin
    attitudes: Floats  # (q, 3, 3)
    centre: Floats = field(default_factory=lambda: np.zeros(3))  # (3,) [m] of mass, in the body's frame

    @cached_property
    def _path(self) -> CubicSpline:
        return CubicSpline(self.times, np.array(self.positions), bc_type="natural")

    @cached_property
    def _turn(self) -> RotationSpline:
        return RotationSpline(np.array(self.times), Rotation.from_matrix(self.attitudes))

    @cached_property
    def _latest(self) -> dict[float, Guided]:
        """The motion at the time of the last call: a right-hand side needs it several times."""
        return {}

    def at(self, t: Floats) -> Guided:
        """The motion at times (...) [s]."""
        if np.ndim(t):
            return self._evaluated(t)
        if (time := float(t)) not in self._latest:
            self._latest.clear()
            self._latest[time] = self._evaluated(t)
        return self._latest[time]

    def _evaluated(self, t: Floats) -> Guided:
        shape, flat = np.shape(t), np.ravel(t)
        attitude = self._turn(flat).as_matrix()
        own, own_rate = (self._turn(flat, order) for order in (1, 2))  # in the body's axes
        w = np.einsum("tij,tj->ti", attitude, own)
        angular = np.einsum("tij,tj->ti", attitude, own_rate)
        lever = attitude @ self.centre
        position, velocity, acceleration = (self._path(flat, order) for order in (0, 1, 2))
        found = (
            position + lever,
            velocity + np.cross(w, lever),
            acceleration + np.cross(angular, lever) + np.cross(w, np.cross(w, lever)),
            attitude,
            w,
            angular,
        )
        return Guided(*(values.reshape(*shape, *values.shape[1:]) for values in found))


Drive = Steady | Poses


def _zeros() -> Floats:
    return np.zeros(3)


@dataclass(frozen=True, eq=False)
class Body:
    """A body at time 0, SI units throughout."""

    name: str
    mass: float
    inertia: Floats  # J [kg m2], in the body's axes
    centre_of_mass: Floats = field(default_factory=_zeros)  # c (3,) [m], in the body's frame
    position: Floats = field(default_factory=_zeros)  # (3,) [m] of the origin of the body's frame
    velocity: Floats = field(default_factory=_zeros)  # (3,) [m/s] of the centre of mass
    attitude: Floats = field(default_factory=lambda: np.eye(3))  # R (3, 3): columns are the body's axes
    angular_velocity: Floats = field(default_factory=_zeros)  # (3,) [rad/s] in the body's axes
    drive: Drive | None = None  # its motion, where that is given
    blocks: tuple[Block, ...] = ()  # its surface, in its frame
    edge_radius: float = 0.0  # [m]

    def at(self, point: Floats) -> tuple[Floats, Floats]:
        """Place [m] and velocity [m/s] (3,) in the scene of a point (3,) [m] of the body's frame."""
        lever = self.attitude @ (point - self.centre_of_mass)
        turning = self.attitude @ self.angular_velocity
        return self.position + self.attitude @ point, self.velocity + cross(turning, lever)


@dataclass(frozen=True, eq=False)
class BodyStates:
    """States of b bodies, at one time or many (leading axes ...)."""

    position: Floats  # (..., b, 3) [m] of the centres of mass
    velocity: Floats  # (..., b, 3) [m/s] of the centres of mass
    attitude: Floats  # (..., b, 3, 3): columns are the body's axes in the scene's
    angular_velocity: Floats  # (..., b, 3) [rad/s] in the body's axes


@dataclass(frozen=True, eq=False)
class Bodies:
    """What b bodies are."""

    names: tuple[str, ...]
    mass: Floats  # (b,) [kg]
    inertia: Floats  # J (b, 3, 3) [kg m2] about the centres of mass
    centre_of_mass: Floats  # c (b, 3) [m] in the bodies' frames
    drives: tuple[Drive | None, ...] = ()  # of each body, where its motion is given; (): all are free

    @cached_property
    def free(self) -> Floats:
        """1 for each body (b,) that forces move, 0 for those whose motion is given."""
        free = np.ones(len(self.names))
        free[self.driven] = 0.0
        return free

    @cached_property
    def driven(self) -> Ints:
        """Which bodies (d,) have a given motion."""
        return np.array([k for k, drive in enumerate(self.drives) if drive is not None], dtype=np.intp)

    def motions(self, t: Floats) -> list[tuple[int, Guided]]:
        """Driven bodies: number, motion at times (...) [s]."""
        return [(k, drive.at(t)) for k, drive in enumerate(self.drives) if drive is not None]

    def accelerations(self, t: float) -> tuple[Floats, Floats]:
        """A [m/s2], w' [rad/s2] (b, 3) of driven bodies at t [s], in the scene's axes; zero for free ones."""
        linear, angular = np.zeros((2, len(self.names), 3))
        for k, motion in self.motions(np.array(t)):
            linear[k], angular[k] = motion.acceleration, motion.angular
        return linear, angular

    @cached_property
    def mobility(self) -> Floats:
        """J^-1 (b, 3, 3) [1/(kg m2)]."""
        return np.asarray(np.linalg.inv(self.inertia))


def collect(bodies: tuple[Body, ...]) -> tuple[Bodies, BodyStates]:
    """The bodies of a case, and their states at time 0."""

    def rows(key: str, *shape: int) -> Floats:
        return np.array([getattr(body, key) for body in bodies], dtype=float).reshape(-1, *shape)

    centre, attitude = rows("centre_of_mass", 3), rows("attitude", 3, 3)
    names = tuple(body.name for body in bodies)
    kinds = Bodies(
        names, rows("mass", 1)[:, 0], rows("inertia", 3, 3), centre, tuple(body.drive for body in bodies)
    )
    position = rows("position", 3) + np.einsum("bij,bj->bi", attitude, centre)
    return kinds, BodyStates(position, rows("velocity", 3), attitude, rows("angular_velocity", 3))


def loaded(body: Body, mass: Floats, point: Floats) -> Body:
    """The body with point masses (q,) [kg] at points (q, 3) [m] of its frame: one rigid body of both.

    One whose motion is given keeps its own centre of mass, and its inertia has no effect.

    By Steiner's theorem, J + m |d|^2 - m d d^T about the common centre of mass, written with [d]x^T [d]x.
    """
    if not len(mass):
        return body
    masses = np.concatenate(((body.mass,), mass))
    places = np.concatenate((body.centre_of_mass[None], point))
    total = math.fsum(masses)
    if body.drive is not None:
        return replace(body, mass=total)
    centre = np.array([math.fsum(column) for column in (masses[:, None] * places).T.tolist()]) / total
    arm = skew(places - centre)
    shifted = np.einsum("q,qji,qjk->ik", masses, arm, arm)
    return replace(body, mass=total, inertia=body.inertia + shifted, centre_of_mass=centre)


def own_turning(attitude: Floats, spin: Floats, mobility: Floats) -> Floats:
    """Angular velocities (..., b, 3) [rad/s] in the bodies' axes, J^-1 R^T h; J^-1 is (b, 3, 3)."""
    own = np.einsum("...rji,...rj->...ri", attitude, spin)
    return np.asarray(np.einsum("rij,...rj->...ri", mobility, own))


def turning(attitude: Floats, spin: Floats, mobility: Floats) -> Floats:
    """Angular velocities (..., b, 3) [rad/s] in the scene's axes, w = R J^-1 R^T h; J^-1 is (b, 3, 3)."""
    return np.asarray(np.einsum("...ij,...j->...i", attitude, own_turning(attitude, spin, mobility)))


def attitude_rate(attitude: Floats, spin: Floats, mobility: Floats) -> Floats:
    """R' (b, 3, 3) [1/s] of attitudes R and angular momenta h (b, 3) [kg m2/s]."""
    return np.asarray(skew(turning(attitude, spin, mobility)) @ attitude)


def turning_rate(attitude: Floats, spin: Floats, torque: Floats, bodies: Bodies) -> Floats:
    """w' (..., b, 3) [rad/s2] in the scene's axes, R J^-1 R^T (torque - w x h): Euler's equations."""
    left = torque - cross(turning(attitude, spin, bodies.mobility), spin)
    return turning(attitude, left, bodies.mobility)


def conserving_turn(attitude: Floats, spin: Floats, bodies: Bodies, h: float) -> Floats | None:
    """Attitudes (b, 3, 3) after a step of h [s] that keeps each body's energy h.w/2; None: no root found.

    R1 = cay(h w) R0 with Cayley's transform and A w - h/2 (A w) x w = spin, A = R0 J R0^T: the mid-point rule
    on the rotation group (Lewis & Simo, J. Nonlinear Sci. 4 (1994), doi:10.1007/BF02430636).
    """
    inertia = attitude @ bodies.inertia @ np.swapaxes(attitude, -1, -2)
    w = turning(attitude, spin, bodies.mobility)
    for _ in range(30):
        carried = np.einsum("bij,bj->bi", inertia, w)
        wrong = carried - 0.5 * h * cross(carried, w) - spin
        if np.all(np.linalg.norm(wrong, axis=1) <= 1e-15 * np.linalg.norm(spin, axis=1)):
            break
        slope = inertia + 0.5 * h * (skew(w) @ inertia - skew(carried))
        change = np.linalg.solve(slope, -wrong[..., None])[..., 0]
        w = w + change
        if np.all(np.abs(change) <= 1e-15 * np.abs(w).max()):
            break
    else:
        return None
    half = 0.5 * h * skew(w)
    return np.asarray(np.linalg.solve(np.eye(3) - half, (np.eye(3) + half) @ attitude))


def driven(body: Body, poses: Poses | None) -> Body:
    """The body with a given motion: through poses, or else with the velocities that it starts with."""
    if poses is None:
        centre = body.position + body.attitude @ body.centre_of_mass
        turning = body.attitude @ body.angular_velocity
        return replace(body, drive=Steady(centre, body.velocity, body.attitude, turning))
    drive = replace(poses, centre=body.centre_of_mass)
    start = drive.at(np.zeros(()))
    return replace(
        body,
        position=start.position - start.attitude @ body.centre_of_mass,
        velocity=start.velocity,
        attitude=start.attitude,
        angular_velocity=start.attitude.T @ start.turning,
        drive=drive,
    )
