"""Hill's frame, which turns with a circular orbit: gravity gradient, centrifugal and Coriolis forces.

Linear: Clohessy and Wiltshire, "Terminal guidance system for satellite rendezvous", J. Aerospace Sci. 27
(1960) 653-658, doi 10.2514/8.8704. Two-body: the exact relative motion in the same frame, written after Encke
so that no difference of large numbers is taken (Battin, "An Introduction to the Mathematics and Methods of
Astrodynamics", sec. 8.3).
"""

from __future__ import annotations

import math
from typing import Any, ClassVar, Literal, NamedTuple

import numpy as np
from pydantic import Field

from exunet.base.arrays import Floats
from exunet.forces.blocks import Blocks
from exunet.forces.effect import Effect
from exunet.forces.environment import CircularOrbitConfig
from exunet.forces.estimate import Estimate, EstimateBasis
from exunet.forces.linear_term import LinearTerm, each_node
from exunet.forces.on_bodies import field_on_bodies
from exunet.forces.terms import KernelTerm


class Orbit(Effect, CircularOrbitConfig):
    """The scene's axes turn with a circular orbit round the Earth (Hill's frame)."""

    ACCELERATES_ALL: ClassVar = True

    model: Literal["linear", "two_body"] = Field(
        description="equations of Clohessy and Wiltshire, or the full relative two-body motion"
    )

    def terms(self, blocks: Blocks) -> tuple[LinearTerm | KernelTerm, ...]:
        """Return the Coriolis force as a matrix, the rest as a matrix (linear) or kernel term (two_body).

        On bodies both, and the torque of the gradient and of the turning frame; of the linear gradient in
        either model, whose error is the ratio of a body's size to the orbit's radius.
        """
        radial, normal = np.array(self.radial), np.cross(self.radial, self.along_track)
        rate = self.rate
        turning = 2.0 * rate * np.cross(normal, np.eye(3)).T  # turning @ v = 2 n h x v
        gyroscopic = each_node(blocks.own_mass, turning)
        gradient = rate**2 * (3.0 * np.outer(radial, radial) - np.outer(normal, normal))
        linear, spin = self.model == "linear", 2.0 * rate * normal
        bodies = field_on_bodies(blocks, gradient, spin, at_centre=linear)
        if linear:
            return LinearTerm(gyroscopic=gyroscopic, stiffness=each_node(blocks.own_mass, -gradient)), *bodies
        masses = np.concatenate([blocks.own_mass, blocks.inertia.mass])  # centres follow the points in x
        data = CircularOrbit(masses, rate, self.radius, radial, normal)
        two_body = KernelTerm("nodes", add_two_body, data, two_body_potential, bodies=blocks.free_bodies)
        return LinearTerm(gyroscopic=gyroscopic), two_body, *bodies

    @classmethod
    def nominal(cls, basis: EstimateBasis) -> tuple[Orbit, str]:
        """Assume an orbit at 700 km; the throw along the radial, the net's plane in the local horizon."""
        keys = Orbit.model_validate(
            {"altitude": 700e3, "radial": (0.0, 0.0, 1.0), "along_track": (1.0, 0.0, 0.0), "model": "linear"}
        )
        return keys, "an orbit at 700 km, the radial along z"

    def magnitude(self, basis: EstimateBasis) -> Estimate:
        """Estimate the accelerations of the linear model in the nominal motion."""
        rate, normal = self.rate, np.cross(self.radial, self.along_track)
        radial = basis.middle @ np.array(self.radial)
        across = basis.middle @ normal
        coriolis = -2.0 * rate * np.cross(normal, basis.motion)
        tidal = rate**2 * (3.0 * np.outer(radial, self.radial) - np.outer(across, normal))
        total = basis.rms(coriolis + tidal)

        def part(acceleration: float) -> str:
            moves = basis.ballistic(acceleration) / basis.size
            return f"{acceleration:.2g} m/s2 moves {moves:.1g} of the size"

        return Estimate(
            total,
            basis.ballistic(total),
            f"n = {rate:.3g} rad/s: Coriolis 2 n v = {part(basis.rms(coriolis))}, "
            f"gradient n^2 |3 r - h| = {part(basis.rms(tidal))}",
        )


class CircularOrbit(NamedTuple):
    """mass : (n,) of points, then centres [kg]; rate n [rad/s]; radius R [m]; radial r, normal h : (3,), of
    length 1."""

    mass: Floats
    rate: float
    radius: float
    radial: Floats
    normal: Floats


def add_two_body(t: float, x: Any, v: Any, orbit: Any, force: Any) -> None:
    """m n^2 [P x - x / c + (1 - 1 / c) R r], c = (|R r + x| / R)^3 = (1 + q)^(3/2), without cancellation."""
    mass, rate, radius, radial, normal = orbit
    for node in range(mass.size):
        k = 3 * node
        height = x[k] * radial[0] + x[k + 1] * radial[1] + x[k + 2] * radial[2]
        across = x[k] * normal[0] + x[k + 1] * normal[1] + x[k + 2] * normal[2]
        square = x[k] * x[k] + x[k + 1] * x[k + 1] + x[k + 2] * x[k + 2]
        q = (2.0 * height + square / radius) / radius
        c = (1.0 + q) * math.sqrt(1.0 + q)
        missing = q * (3.0 + q * (3.0 + q)) / ((1.0 + c) * c)  # 1 - 1 / c
        scale = mass[node] * rate * rate
        for axis in range(3):
            force[k + axis] += scale * (
                missing * (x[k + axis] + radius * radial[axis]) - across * normal[axis]
            )


def two_body_potential(x: Any, orbit: Any) -> float:
    """m n^2 [(x . h)^2 - R^2 q^2 (u + 2) / (u (1 + u)^2)] / 2, u^2 = 1 + q; zero at the origin."""
    mass, rate, radius, radial, normal = orbit
    total = 0.0
    for node in range(mass.size):
        k = 3 * node
        height = x[k] * radial[0] + x[k + 1] * radial[1] + x[k + 2] * radial[2]
        across = x[k] * normal[0] + x[k + 1] * normal[1] + x[k + 2] * normal[2]
        square = x[k] * x[k] + x[k + 1] * x[k + 1] + x[k + 2] * x[k + 2]
        q = (2.0 * height + square / radius) / radius
        u = math.sqrt(1.0 + q)
        inward = radius * radius * q * q * (u + 2.0) / (u * (1.0 + u) * (1.0 + u))
        total += 0.5 * mass[node] * rate * rate * (across * across - inward)
    return total
