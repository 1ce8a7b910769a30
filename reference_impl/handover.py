"""A node goes onto the drum of a reel, or comes off it: a jump that keeps momentum and angular momentum.

A body and the point masses that it holds have, about the body's centre of mass X, which does not jump,

    P = M V + sum m (V + w x l),  H = I w + sum m l x (V + w x l),

linear in V and w: with what the node has, six equations for V and w after the jump.  What the energy falls by
has left.  A fixed body's support gives the node its change of momentum.
"""

from __future__ import annotations

import numpy as np

from reference_impl import energy
from reference_impl.arrays import Floats, cross
from reference_impl.bodies import turning
from reference_impl.held import masses
from reference_impl.state import Layout
from reference_impl.turns import skew


def hand_over(layout: Layout, y: Floats, reel: int, onto: bool) -> Floats:
    """The state after the next node of a reel has gone onto its drum, or the last one there off it."""
    system, whole, wound = layout.system, layout.whole(y), layout.wound(y)
    reels = system.reels
    assert reels is not None
    k, drum = int(wound.held[reel]), reels.drum[reel]
    nodes = reels.nodes[reel]
    node = nodes[k if onto else k - 1]
    place, velocity = whole.x[drum], np.zeros(3)  # the row of a held node rests
    if not onto:
        i, j = system.net.element_nodes[reels.elements[reel][k]]
        pair = [drum, j if i == node else i]
        length = float(reels.outside(wound.wound_up, wound.held)[reel])
        part = (length - float(reels.piece[reel])) / length
        place, velocity = _let_go(whole.x[pair], whole.v[pair], part)
    after, total = y.copy(), _energy(layout, y)
    x, v = (part.reshape(-1, 3) for part in (after[: layout.half], after[layout.half : 2 * layout.half]))
    x[node], v[node] = place, velocity
    layout.wound(after).held[reel] += 1.0 if onto else -1.0
    mass, body = system.net.mass[node], system.drums.body[reel]
    particle = system.bodies.rigid[body]
    had, has = mass * _screw(whole.x[node], whole.v[node]), mass * _screw(place, velocity)
    if system.bodies.free[particle]:
        centre = whole.x[layout.nodes + particle]
        if onto:
            gained = mass * _screw(whole.x[node] - centre, whole.v[node])
        else:
            gained = -mass * _screw(place - centre, velocity)
        w = turning(whole.attitude, whole.spin, system.bodies.mobility)[body]
        motion = np.concatenate((whole.v[layout.nodes + particle], w))
        momenta = _inertia(layout, y, body) @ motion + gained
        motion = np.linalg.solve(_inertia(layout, after, body), momenta)
        v[layout.nodes + particle] = motion[:3]
        layout.held(after).spin[body] = _own_inertia(layout, y, body) @ motion[3:]
    else:
        row = np.flatnonzero(system.bodies.driven == particle)[0]
        after[layout.booked : -1].reshape(-1, 7)[row, :6] += has - had
    after[-1] += total - _energy(layout, after)
    return after


def _let_go(x: Floats, v: Floats, part: float) -> tuple[Floats, Floats]:
    """Place and velocity of a node at a part of the way from the drum to the next; x, v (2, 3) of both."""
    way, u = x[1] - x[0], v[1] - v[0]
    distance = float(np.linalg.norm(way))
    along = way / distance if distance else way
    return x[0] + part * way, v[0] + part * u + (1.0 - part) * (u @ along) * along


def _screw(x: Floats, v: Floats) -> Floats:
    """Velocity and its moment (6,) about the origin."""
    return np.concatenate((v, cross(x, v)))


def _own_inertia(layout: Layout, y: Floats, body: int) -> Floats:
    """I (3, 3) [kg m2] of a rigid body in the scene's axes."""
    attitude = layout.whole(y).attitude[body]
    return np.asarray(attitude @ layout.bodies.resistance[body] @ attitude.T)


def _inertia(layout: Layout, y: Floats, body: int) -> Floats:
    """Matrix (6, 6) that takes V and w of a rigid body to P and H of it and the masses that it holds."""
    drums, mu = layout.system.drums, masses(layout.system, layout.wound(y).held)
    matrix = np.zeros((6, 6))
    matrix[:3, :3] = layout.bodies.mass[layout.bodies.rigid[body]] * np.eye(3)
    matrix[3:, 3:] = _own_inertia(layout, y, body)
    lever = drums.turned(layout.whole(y).attitude)
    for reel in np.flatnonzero(drums.body == body):
        moved = np.hstack((np.eye(3), -skew(lever[reel])))  # the drum's velocity, of V and w
        matrix += mu[reel] * moved.T @ moved
    return matrix


def _energy(layout: Layout, y: Floats) -> float:
    """Kinetic, elastic and potential energy [J]."""
    system, whole, bodies = layout.system, layout.whole(y), layout.body_states(y)
    x, v = whole.x[: layout.nodes], whole.v[: layout.nodes]
    inside, outlets = energy.at_outlets(system, x, layout.wound(y))
    kept = energy.elastic(system, x, inside) + energy.potential(system, x, bodies) + outlets
    return float(energy.kinetic(system, v, bodies) + kept)
