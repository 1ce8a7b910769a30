"""Bodies beside the net: free rigid bodies `[bodies.NAME]`, and point masses such as the chaser of a launch.

A rigid body is carried as its rotation matrix R, which turns the body's axes into the scene's, and its
angular momentum h about the centre of mass in the scene's axes (Goldstein, Classical Mechanics, ch. 5):

    h' = 0,  R' = [w]x R,  w = R J^-1 R^T h,

J the diagonal of principal moments.  No torque acts, so h stays what it was to the last bit.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from reference_impl.arrays import Floats, Ints, Vector
from reference_impl.table import Table, number, numbers

_NAME = re.compile(r"[A-Za-z0-9_-]+")
_PLATE = 1e-12  # round-off in the moments of a flat body, the greatest of which is the sum of the others


@dataclass(frozen=True)
class Body:
    """A body at time 0: mass [kg], principal moments [kg m2] (zero: a point mass), SI units throughout."""

    name: str
    mass: float
    inertia: Vector = (0.0, 0.0, 0.0)
    position: Vector = (0.0, 0.0, 0.0)  # of the centre of mass
    velocity: Vector = (0.0, 0.0, 0.0)
    attitude: tuple[float, ...] = (1.0, 0.0, 0.0, 0.0)  # quaternion [w, x, y, z], of any length but 0
    angular_velocity: Vector = (0.0, 0.0, 0.0)  # in the body's axes


@dataclass(frozen=True, eq=False)
class BodyStates:
    """States of b bodies, at one time or many (leading axes ...); a point mass has attitude I and no spin."""

    position: Floats  # (..., b, 3) [m]
    velocity: Floats  # (..., b, 3) [m/s]
    attitude: Floats  # (..., b, 3, 3): columns are the body's axes in the scene's
    angular_velocity: Floats  # (..., b, 3) [rad/s] in the body's axes


@dataclass(frozen=True, eq=False)
class Bodies:
    """What b bodies are; r of them are rigid bodies, the others point masses."""

    names: tuple[str, ...]
    mass: Floats  # (b,) [kg]
    inertia: Floats  # (b, 3) [kg m2], zero for point masses

    @cached_property
    def rigid(self) -> Ints:
        """Which bodies (r,) have an attitude."""
        return np.flatnonzero(np.all(self.inertia > 0.0, axis=1))

    @cached_property
    def moments(self) -> Floats:
        """Principal moments (r, 3) [kg m2] of the rigid ones."""
        return self.inertia[self.rigid]


def collect(bodies: tuple[Body, ...]) -> tuple[Bodies, BodyStates]:
    """The bodies of a case, and their states at time 0."""

    def rows(key: str, width: int) -> Floats:
        return np.array([getattr(body, key) for body in bodies], dtype=float).reshape(-1, width)

    kinds = Bodies(tuple(b.name for b in bodies), rows("mass", 1)[:, 0], rows("inertia", 3))
    attitude = np.array([rotation(body.attitude) for body in bodies]).reshape(-1, 3, 3)
    states = BodyStates(rows("position", 3), rows("velocity", 3), attitude, rows("angular_velocity", 3))
    return kinds, states


def rotation(quaternion: tuple[float, ...]) -> Floats:
    """Rotation matrix (3, 3) of a quaternion [w, x, y, z], by Rodrigues' formula about its axis.

    I + sin(a) K + (1 - cos(a)) K^2, K the cross product with the unit axis, a = 2 atan2(|(x, y, z)|, w).
    """
    largest = max(map(abs, quaternion))
    w, x, y, z = (component / largest for component in quaternion)
    length = math.hypot(x, y, z)
    if not length:
        return np.eye(3)
    half = math.atan2(length, w)
    cross = skew(np.array([x, y, z]) / length)
    return np.asarray(np.eye(3) + math.sin(2.0 * half) * cross + 2.0 * math.sin(half) ** 2 * cross @ cross)


def skew(a: Floats) -> Floats:
    """Matrices (..., 3, 3) of the cross product a x, of vectors a (..., 3)."""
    x, y, z = a[..., 0], a[..., 1], a[..., 2]
    zero = np.zeros_like(x)
    rows = ((zero, -z, y), (z, zero, -x), (-y, x, zero))
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def turning(attitude: Floats, spin: Floats, moments: Floats) -> Floats:
    """Angular velocities (r, 3) [rad/s] in the scene's axes, w = R J^-1 R^T h."""
    own = np.einsum("...ji,...j->...i", attitude, spin) / moments
    return np.asarray(np.einsum("...ij,...j->...i", attitude, own))


def attitude_rate(attitude: Floats, spin: Floats, moments: Floats) -> Floats:
    """R' (r, 3, 3) [1/s] of attitudes R and angular momenta h (r, 3) [kg m2/s]."""
    return np.asarray(skew(turning(attitude, spin, moments)) @ attitude)


def orthonormal(attitude: Floats) -> Floats:
    """The rotations nearest to matrices (..., 3, 3): their polar factors (Higham, doi:10.1137/0907079)."""
    left, _, right = np.linalg.svd(attitude)
    return np.asarray(left @ right)


def turned(attitude: Floats, angle: Floats) -> Floats:
    """exp([angle]x) R: attitudes turned about axes of the scene by rotation vectors (r, 3) [rad]."""
    size = np.linalg.norm(angle, axis=-1)[..., None, None]
    cross = skew(angle)
    first = np.sinc(size / np.pi)  # sin(a)/a
    second = 0.5 * np.sinc(0.5 * size / np.pi) ** 2  # (1 - cos(a))/a^2
    return np.asarray(attitude + first * cross @ attitude + second * cross @ cross @ attitude)


def conserving_turn(attitude: Floats, spin: Floats, moments: Floats, h: float) -> Floats | None:
    """Attitudes (r, 3, 3) after a step of h [s] that keeps each body's energy h.w/2; None: no root found.

    R1 = cay(h w) R0 with Cayley's transform and A w - h/2 (A w) x w = spin, A = R0 J R0^T: the mid-point rule
    on the rotation group (Lewis & Simo, J. Nonlinear Sci. 4 (1994), doi:10.1007/BF02430636).
    """
    inertia = np.einsum("bij,bj,bkj->bik", attitude, moments, attitude)
    w = turning(attitude, spin, moments)
    for _ in range(30):
        carried = np.einsum("bij,bj->bi", inertia, w)
        wrong = carried - 0.5 * h * np.cross(carried, w) - spin
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


def read_bodies(table: Table) -> tuple[Body, ...]:
    """Reads and closes the table `[bodies]`."""
    bodies = [_body(table.table(name, required=False), name) for name in table.values]
    table.close()
    return tuple(body for body in bodies if body is not None)


def _body(table: Table, name: str) -> Body | None:
    if not _NAME.fullmatch(name):
        table.faults.append(f"{table.path}: the name must be of letters, digits, _ and -")
    if not table:
        return None
    values: dict[str, Any] = {
        "mass": table.need("mass", number(above=0.0)),
        "inertia": table.need("inertia", numbers(3, above=0.0)),
    }
    for key, width in (("position", 3), ("velocity", 3), ("attitude", 4), ("angular_velocity", 3)):
        values[key] = table.get(key, numbers(width), getattr(Body, key))
    table.close()
    inertia = values["inertia"]
    if inertia is not None and 2.0 * max(inertia) > math.fsum(inertia) * (1.0 + _PLATE):
        table.faults.append(f"{table.name('inertia')}: no moment may be above the sum of the two others")
    if values["attitude"] is not None and not any(values["attitude"]):
        table.faults.append(f"{table.name('attitude')}: must not be zero")
    return None if None in values.values() else Body(name, **values)
