"""A pendulum, and a pair of masses that the damping of eq. (13) brakes although nothing deforms."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from exunet.studies.both_codes import BothCodes
from exunet.system import energy
from exunet.verification.answers.both import against, best
from exunet.verification.answers.modes import frequency
from exunet.verification.check import Check
from exunet.verification.tolerances import BRAKING, PENDULUM


def pendulum(case: BothCodes) -> Iterator[Check]:
    """Frequency sqrt(g / l) (1 - a^2 / 16) of a pendulum of (stretched) length l and amplitude a."""
    place = case.start.position[1]
    length, amplitude = float(np.linalg.norm(place)), math.atan2(place[0], -place[2])
    gravity = float(np.linalg.norm(case.start.scene.effects.model_dump()["gravity"]["acceleration"]))
    known = math.sqrt(gravity / length) * (1.0 - amplitude**2 / 16.0)
    end = case.start.scene.time.end
    for code, motion in best(case, np.array([0.0, end])):
        (x, _, z), (vx, _, vz) = motion.position[1, 1], motion.velocity[1, 1]
        rate = (z * vx - x * vz) / -(x * x + z * z)
        found = frequency(math.atan2(x, -z), rate, amplitude, end, known)
        yield against(f"frequency, {code}", found, known, PENDULUM, "rad/s")


def braking(case: BothCodes) -> Iterator[Check]:
    """Angular momentum that beta T(reference) takes from a rigid rotation by the angle a.

    The cable lies along x at first, so eq. (13) damps the relative velocity along x for ever, with beta k,
    k = EA / L0. At the distance l the relative velocity along x is -w l sin(a), the torque
    -beta k w l^2 sin(a)^2, and over the angle the loss is beta k l^2 (a / 2 - sin(2 a) / 4). An
    objective damping would take nothing.
    """
    net = case.start.net
    stiffness = float(net.axial_stiffness[0] / net.reference_length[0])
    beta = case.start.scene.effects.model_dump()["rayleigh_damping"]["beta"]
    length = float(np.linalg.norm(case.start.position[1] - case.start.position[0]))
    times = np.linspace(0.0, case.start.scene.time.end, 61)
    for code, motion in best(case, times):
        span = motion.position[:, 1] - motion.position[:, 0]
        angle = float(np.unwrap(np.arctan2(span[:, 1], span[:, 0]))[-1])
        spin = energy.angular_momentum(net.mass, motion.position, motion.velocity)[:, 2]
        known = beta * stiffness * length**2 * (angle / 2 - math.sin(2 * angle) / 4)
        found = float(spin[0] - spin[-1])
        yield against(f"momentum taken by damping, {code}", found, known, BRAKING, "kg m2/s")
        words = (
            f"of {spin[0]:.6g} kg m2/s in {angle / (2 * math.pi):.3f} turns; an objective damping takes none"
        )
        yield Check(f"part of the rotation lost, {code}", found / float(spin[0]), None, words)
