"""Snap of two masses: energy conservation gives the largest strain, quadrature the contact time."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import quad

from exunet.forces import cable
from exunet.studies.both_codes import BothCodes
from exunet.verification.answers.both import CODES, against, best
from exunet.verification.check import Check
from exunet.verification.tolerances import SNAP
from reference_impl import forces as formulas

Floats = NDArray[np.float64]

REFERENCE = CODES[1]


@dataclass(frozen=True)
class Known:
    """Largest strain, peak force [N] and contact time [s] of a snap."""

    strain: float
    force: float
    contact_time: float


def known_snap(axial_stiffness: float, length: float, reduced_mass: float, speed: float) -> Known:
    """EA [N], L0 [m], mu [kg], closing speed v [m/s].

    Energy: mu v^2 / 2 = EA L0 E11^2 / 2. With E11 = E11max sin(s), the time is the integral of
    L0 E11max / (v lambda) over s from 0 to pi, lambda = sqrt(1 + 2 E11).
    """
    strain = speed * math.sqrt(reduced_mass / (axial_stiffness * length))
    quarter, _ = quad(
        lambda s: 1.0 / math.sqrt(1.0 + 2.0 * strain * math.sin(s)), 0.0, math.pi / 2, epsrel=1e-13
    )
    return Known(
        strain,
        axial_stiffness * strain * math.sqrt(1.0 + 2.0 * strain),
        2.0 * length * strain / speed * quarter,
    )


def snap(case: BothCodes) -> Iterator[Check]:
    """The peak at half the contact time; contact time and rebound from the slack flight afterwards."""
    net = case.start.net
    speed = float(np.linalg.norm(case.start.velocity[1] - case.start.velocity[0]))
    mass = float(1.0 / (1.0 / net.mass).sum())
    length = float(net.reference_length[0])
    known = known_snap(float(net.axial_stiffness[0]), length, mass, speed)
    end = case.start.scene.time.end
    for code, motion in best(case, np.array([0.0, known.contact_time / 2, end])):
        span, strain, force = _by_code(case, code, motion.position)
        rebound = float(np.linalg.norm(motion.velocity[2, 1] - motion.velocity[2, 0]))
        contact = end - (length - span[2]) / rebound
        yield against(f"largest strain, {code}", strain[1], known.strain, SNAP, "")
        yield against(f"peak force, {code}", force[1], known.force, SNAP, "N")
        yield against(f"contact time, {code}", contact, known.contact_time, SNAP, "s")
        yield against(f"rebound speed, {code}", rebound, speed, SNAP, "m/s")


def _by_code(case: BothCodes, code: str, position: Floats) -> tuple[Floats, Floats, Floats]:
    """Length [m], strain and tension [N] of the cable (t,), each code's motion by its own formulas."""
    if code == REFERENCE:
        system, x = case.theirs.system, case.to_reference(position)
        length, strain = formulas.length(system, x), formulas.strain(system, x)
        return length[:, 0], strain[:, 0], formulas.tension(system, x)[:, 0]
    net = case.start.net
    length = cable.lengths(net, position)
    strain = cable.green_lagrange_strain(length, net.reference_length)
    tension = cable.element_tension(
        net, case.start.system.forces.cable.law, position, np.zeros_like(position)
    )
    return length[:, 0], strain[:, 0], tension[:, 0]
