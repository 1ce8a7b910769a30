"""Estimates of contact before a run: impact speed, rates of damping and of friction.

Damping of Hunt and Crossley grows with the depth: c = a F(p). An impact at the speed v on a stiffness with
the rate w = sqrt(k / m) is as deep as v / w at most, and where damping stops it, sqrt(2 v / a) / w. So the
damping rate c / m is w min(a v, sqrt(2 a v)) at most, times (n + 1) / 2 for forces that grow as p^n. Its
force is m v w at most without damping, whatever n >= 1 is.
"""

from __future__ import annotations

import math

import numpy as np

from exunet.forces.blocks import Blocks
from exunet.forces.contact.law import Friction


def damping_rate(damping: float, stiffness_rate: float, speed: float, exponent: float = 1.0) -> float:
    """Bound [1/s] of what the damping a [s/m] of impacts at a speed [m/s] adds to the eigenvalues.

    stiffness_rate : [1/s2] that the force across the surface adds, as of `KernelTerm`
    """
    hit = damping * speed
    return 0.5 * (exponent + 1.0) * math.sqrt(stiffness_rate) * min(hit, math.sqrt(2.0 * hit))


def friction_rate(rubbing: Friction, stiffness_rate: float, speed: float) -> float:
    """The steepest [1/s] of mu N u / (m sqrt(u^2 + v_s^2)) in an impact at a speed [m/s]: of N = m v w.

    0.0 of sticking friction, which is part of the stiffness rate.
    """
    if not rubbing.slip_speed > 0.0:
        return 0.0
    return rubbing.friction * speed * math.sqrt(stiffness_rate) / rubbing.slip_speed


def speed_of_net(blocks: Blocks, body: str, arm: float) -> float:
    """At which nodes of the net come to a body at most, as all move at the start [m/s].

    arm : from the body's centre of mass to what is touched [m]
    """
    number, net = blocks.rigid.index(body), blocks.net
    start = blocks.speeds
    if not len(start.points):
        return 0.0
    against = start.points[: net.n_nodes] - start.bodies[number]
    fastest = float(np.linalg.norm(against, axis=1).max(initial=0.0))
    return fastest + arm * float(np.linalg.norm(start.spins[number]))


def speed_of_bodies(blocks: Blocks, one: str, other: str, arms: tuple[float, float]) -> float:
    """At which two bodies come together at most, as they move at the start [m/s]."""
    start = blocks.speeds
    if not len(start.points):
        return 0.0
    numbers = [blocks.rigid.index(name) for name in (one, other)]
    turning = sum(
        arm * float(np.linalg.norm(start.spins[number])) for arm, number in zip(arms, numbers, strict=True)
    )
    return turning + float(np.linalg.norm(start.bodies[numbers[0]] - start.bodies[numbers[1]]))


def speed_of_threads(blocks: Blocks) -> float:
    """At which threads of the net come together at most, as it moves at the start [m/s].

    Once it has met a body, at which it comes to that.
    """
    start, nodes = blocks.speeds.points, slice(blocks.net.n_nodes)
    if not len(start):
        return 0.0
    own = start[nodes] - start[nodes].mean(axis=0)
    fastest = 2.0 * float(np.linalg.norm(own, axis=1).max(initial=0.0))
    met = [speed_of_net(blocks, body, 0.0) for body in blocks.surfaces]
    return max([fastest, *met])
