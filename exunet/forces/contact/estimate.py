"""Estimates of contact before a run: first touch, impact speed, rates of damping and of friction.

Damping of Hunt and Crossley grows with the depth: c = a F(p). An impact at the speed v on a stiffness with
the rate w = sqrt(k / m) is as deep as v / w at most, and where damping stops it, sqrt(2 v / a) / w. So the
damping rate c / m is w min(a v, sqrt(2 a v)) at most, times (n + 1) / 2 for forces that grow as p^n. Its
force is m v w at most without damping, whatever n >= 1 is.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
import scipy

from exunet.forces.blocks import Blocks
from exunet.forces.contact.law import Friction
from exunet.forces.estimate import Approach, EstimateBasis


def estimate_notes(keys: Any, basis: EstimateBasis) -> Iterator[str]:
    """Of each body in words; keys : of `[effects.contact]`."""
    for approach in basis.approaches:
        if math.isfinite(approach.time):
            yield from _of_a_meeting(keys, basis, approach)
        else:
            yield (
                f"{approach.what} come no nearer to {approach.body} than {approach.distance:.3g} m in the "
                f"{basis.duration:.3g} s of the nominal motion: they touch it only if they swing out"
            )


def _of_a_meeting(keys: Any, basis: EstimateBasis, one: Approach) -> Iterator[str]:
    v = one.speed
    yield f"{one.what} reach {one.body} at {one.time:.3g} s with {v:.3g} m/s"
    if keys.threads:
        net = basis.net
        heaviest = float((net.density * net.area)[: net.n_net_elements].max(initial=0.0))
        depth = v * math.sqrt(heaviest / keys.of_threads)
        yield f"a thread sinks in by {depth:.2g} m with {keys.of_threads * depth:.2g} N/m"
    for what, law, radius in _spheres(keys, basis):
        mass = _heaviest(basis, what)
        n = law.exponent
        depth = (0.5 * (n + 1.0) * mass * v * v / law.stiffness) ** (1.0 / (n + 1.0))
        force = law.stiffness * depth**n
        yield f"a {what} of {mass:.2g} kg and {radius:.2g} m by {depth:.2g} m with {force:.2g} N"
    yield f"restitution at that speed {restitution_at(keys.a, v):.2g}"
    mass = float(basis.net.mass.sum())
    reduced = mass if math.isinf(one.mass) else mass * one.mass / (mass + one.mass)
    gets = "" if math.isinf(one.mass) else f" and gives {one.body} {reduced * v / one.mass:.2g} m/s"
    yield f"stopping all of the net takes {reduced * v:.2g} N s{gets}"


def _spheres(keys: Any, basis: EstimateBasis) -> Iterator[tuple[str, Any, float]]:
    if keys.nodes:
        yield "node", keys.of_nodes, keys.node_radius
    if keys.bullets and len(basis.net.bullet_nodes):
        yield "bullet", keys.of_bullets, keys.bullet_radius


def _heaviest(basis: EstimateBasis, what: str) -> float:
    """Of bullets, or of the other nodes [kg]."""
    bullets = np.isin(np.arange(basis.net.n_nodes), basis.net.bullet_nodes)
    return float(basis.net.mass[bullets if what == "bullet" else ~bullets].max(initial=0.0))


def restitution_at(damping: float, speed: float) -> float:
    """e of an impact at a speed [m/s]: d (1 + e) = ln((1 + d) / (1 - e d)) with d = a v, see `law`."""
    d = damping * speed
    if d < 1e-6:
        return 1.0 - 2.0 / 3.0 * d
    # With y = -ln(1 - e d): y + ln(1 + d) = d + 1 - exp(-y), whose root y = -ln(1 + d) is left out.
    y = scipy.optimize.brentq(lambda y: y + math.log1p(d) - d + math.expm1(-y), 0.0, d + 1.0, xtol=1e-14)
    return -math.expm1(-y) / d


def damping_rate(damping: float, stiffness_rate: float, speed: float, exponent: float = 1.0) -> float:
    """Bound [1/s] of what the damping a [s/m] of impacts at a speed [m/s] adds to the eigenvalues.

    stiffness_rate : [1/s2] that the force across the surface adds, as of `KernelTerm`
    """
    hit = damping * speed
    return 0.5 * (exponent + 1.0) * math.sqrt(stiffness_rate) * min(hit, math.sqrt(2.0 * hit))


def friction_rate(rubbing: Friction, stiffness_rate: float, speed: float) -> float:
    """The steepest [1/s] of mu N u / (m sqrt(u^2 + v_s^2)) in an impact at a speed [m/s]: of N = m v w.

    0.0 of friction with memory, which is part of the stiffness rate.
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
