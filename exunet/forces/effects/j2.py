"""The Earth's oblateness as a difference along the net: the gradient of the J2 gravity at the scene's origin.

With s = k.r, k the Earth's axis, the J2 part of the gravitational potential is -c (3 s^2 / r^5 - 1 / r^3), c
= mu J2 Re^2 / 2 (Vallado, "Fundamentals of Astrodynamics and Applications", sec. 8.6.1); its second
derivatives times the distance from the origin are what nodes feel against each other. The part common to all
nodes moves the origin too and is left out. The gradient is that of one place of the orbit: the scene must be
short.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from exunet.base.errors import Fault
from exunet.forces.blocks import Blocks
from exunet.forces.effect import Effect, RestOfCase
from exunet.forces.effects.orbit import Orbit
from exunet.forces.environment import EARTH_MU, EARTH_RADIUS, NOMINAL, CircularOrbitConfig
from exunet.forces.estimate import Estimate, EstimateBasis
from exunet.forces.linear_term import LinearTerm, each_node
from exunet.forces.on_bodies import field_on_bodies
from exunet.forces.terms import KernelTerm

EARTH_J2 = 1.08262668e-3  # EGM-96, Vallado table D-1
LONGEST = 0.05  # of an orbit, during which the gradient is taken as constant


class J2(Effect, CircularOrbitConfig):
    """Difference of the J2 gravity along the net, linear and at one place of the orbit."""

    ACCELERATES_ALL: ClassVar = True
    REQUIRES: ClassVar = {"orbit": "of which it is a correction"}

    inclination: float = Field(
        ge=0.0, le=math.pi, description="inclination of the orbit [rad]", examples=[1.7]
    )
    argument_of_latitude: float = Field(
        description="angle along the orbit from the ascending node [rad]", examples=[0.8]
    )

    def gradient(self) -> NDArray[np.float64]:
        """Return (3, 3) second derivatives of the J2 potential at the origin, in the scene's axes [1/s2]."""
        radial, along = np.array(self.radial), np.array(self.along_track)
        tilt, angle = self.inclination, self.argument_of_latitude
        axis = math.sin(tilt) * (math.sin(angle) * radial + math.cos(angle) * along)
        axis += math.cos(tilt) * np.cross(radial, along)
        s = float(axis @ radial)
        kk, rr = np.outer(axis, axis), np.outer(radial, radial)
        kr = np.outer(axis, radial) + np.outer(radial, axis)
        shape = 6.0 * kk - 30.0 * s * kr + (105.0 * s * s - 15.0) * rr + (3.0 - 15.0 * s * s) * np.eye(3)
        return np.asarray(-0.5 * EARTH_MU * EARTH_J2 * EARTH_RADIUS**2 / self.radius**5 * shape)

    def terms(self, blocks: Blocks) -> tuple[LinearTerm | KernelTerm, ...]:
        """Return the constant stiffness -m G on each node; on bodies force at the centre, and torque."""
        stiffness = each_node(blocks.own_mass, -self.gradient())
        return LinearTerm(stiffness=stiffness), *field_on_bodies(blocks, self.gradient())

    def cross_checks(self, rest: RestOfCase) -> Iterator[Fault]:
        """Require the orbit of effects.orbit, and a scene that is short compared with it."""
        orbit = rest.scene.effects.get(Orbit)
        for key in ("altitude", "mean_motion", "radial", "along_track"):
            if orbit is not None and getattr(self, key) != getattr(orbit, key):
                yield Fault(key, f"differs from that of effects.orbit, {getattr(orbit, key)}")
        longest = LONGEST * 2.0 * math.pi / self.rate
        if rest.duration > longest:
            words = f"its gradient is taken as constant, which is valid for {longest:.0f} s of this orbit"
            yield Fault("", f"{words}; the scene lasts {rest.duration:g} s")

    @classmethod
    def nominal(cls, basis: EstimateBasis) -> tuple[J2, str]:
        """Assume the case's orbit, or 700 km: sun-synchronous, half-way from node to highest latitude."""
        orbit = NOMINAL if basis.orbit is None else basis.orbit
        given = {key: getattr(orbit, key) for key in CircularOrbitConfig.model_fields if orbit.is_given(key)}
        place = {"inclination": math.radians(98.2), "argument_of_latitude": math.radians(45.0)}
        keys = J2.model_validate(given | place)
        return keys, f"{orbit.words}, inclined 98 degrees, at latitude argument 45 degrees"

    def magnitude(self, basis: EstimateBasis) -> Estimate:
        """Estimate the gradient times the places of the nominal motion."""
        acceleration = basis.rms(basis.middle @ self.gradient())
        norm = float(np.linalg.norm(self.gradient(), 2))
        words = f"J2 gradient {norm:.2g} 1/s2 x distance"
        return Estimate(acceleration, basis.ballistic(acceleration), words)
