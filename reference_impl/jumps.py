"""Jumps of momentum: nodes on and off drums, an ejection, a net that is thrown at time 0.

A jump that keeps momentum and angular momentum.  A body and the point masses that it holds have, about the
body's centre of mass X, which does not jump,

    P = M V + sum m (V + w x l),  H = I w + sum m l x (V + w x l),

linear in V and w: with what the nodes have, six equations for V and w after the jump.  What the energy falls
by has left, negative where it rises.  A driven body does not jump: it gives the nodes their change of
momentum p and angular momentum h about X, and with these the work p.V + h.w.

The state at time 0 is the one after the throw.  The impulses P that the nodes get are given by points of the
body, which move as the nodes did before: they do the work sum of P.v on them.
"""

from __future__ import annotations

import numpy as np

from reference_impl import contact_forces, energy
from reference_impl.arrays import Floats, Ints, cross
from reference_impl.attachments import Levers
from reference_impl.bodies import collect, turning
from reference_impl.case import Case
from reference_impl.held import inertia, load, own_inertia
from reference_impl.start import before_throw, initial_bodies, initial_state, thrown_at_start
from reference_impl.state import Layout
from reference_impl.system import Begun, System


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
    after = y.copy()
    rows = layout.held(after)
    rows.x[node], rows.v[node] = place, velocity
    layout.wound(after).held[reel] += 1.0 if onto else -1.0
    return _kept(layout, y, after, int(system.drums.body[reel]), np.array([node]), onto)


def eject(layout: Layout, y: Floats) -> Floats:
    """The state after the packed net has left its body.

    Each node has what it gets beside the velocity that it had with the body before.
    """
    packed, whole = layout.system.packed, layout.whole(y)
    assert packed is not None
    after, node = y.copy(), packed.levers.node
    rows = layout.held(after)
    rows.x[node] = whole.x[node]
    rows.v[node] = whole.v[node] + packed.given @ whole.attitude[packed.body].T
    layout.packed(after)[:] = 0.0
    return _kept(layout, y, after, packed.body, node, onto=False)


def _kept(layout: Layout, y: Floats, after: Floats, body: int, node: Ints, onto: bool) -> Floats:
    """The state `after`, with the motion of a rigid body and the balances that follow from y.

    The nodes (q,) come to the body, `onto`, or leave it, to the places and velocities that they have after.
    """
    system, whole, rows = layout.system, layout.whole(y), layout.held(after)
    bodies, attitude, own = system.bodies, whole.attitude, layout.nodes + body
    mass = system.net.mass[node]
    if bodies.free[body]:
        centre = whole.x[own]
        if onto:
            gained = _momenta(mass, whole.x[node] - centre, whole.v[node])
        else:
            gained = -_momenta(mass, rows.x[node] - centre, rows.v[node])
        w = turning(attitude, whole.spin, bodies.mobility)[body]
        before, now = (inertia(system, _load(layout, state), attitude, body) for state in (y, after))
        motion = np.linalg.solve(now, before @ np.concatenate((whole.v[own], w)) + gained)
        rows.v[own] = motion[:3]
        rows.spin[body] = own_inertia(system, attitude, body) @ motion[3:]
    else:
        then = layout.whole(after)
        centre, w = whole.x[own], turning(attitude, whole.spin, bodies.mobility)[body]
        had = _momenta(mass, whole.x[node] - centre, whole.v[node])
        change = _momenta(mass, then.x[node] - centre, then.v[node]) - had
        row = np.flatnonzero(bodies.driven == body)[0]
        books = after[layout.booked : -1].reshape(-1, 7)[row]
        books[:6] += change
        books[3:6] += cross(centre, change[:3])
        books[6] += change @ np.concatenate((whole.v[own], w))
    after[-1] += _energy(layout, y) - _energy(layout, after)
    return after


def _load(layout: Layout, y: Floats) -> Levers:
    """What bodies hold in a state."""
    return load(layout.system, layout.wound(y).held, bool(np.any(layout.packed(y))))


def _momenta(mass: Floats, x: Floats, v: Floats) -> Floats:
    """Momentum and angular momentum about the origin (6,) of masses (q,) at (q, 3) with (q, 3)."""
    each = mass[:, None] * v
    return np.concatenate((each.sum(axis=0), cross(x, each).sum(axis=0)))


def _let_go(x: Floats, v: Floats, part: float) -> tuple[Floats, Floats]:
    """Place and velocity of a node at a part of the way from the drum to the next; x, v (2, 3) of both."""
    way, u = x[1] - x[0], v[1] - v[0]
    distance = float(np.linalg.norm(way))
    along = way / distance if distance else way
    return x[0] + part * way, v[0] + part * u + (1.0 - part) * (u @ along) * along


def _energy(layout: Layout, y: Floats) -> float:
    """Kinetic, elastic and potential energy [J]."""
    system, whole, bodies = layout.system, layout.whole(y), layout.body_states(y)
    x, v = whole.x[: layout.nodes], whole.v[: layout.nodes]
    inside, outlets = energy.at_outlets(system, x, layout.wound(y))
    others, closing = energy.of_closing(system, x, layout.drawn(y))
    if others is not None:
        inside = others if inside is None else inside & others
    kept = closing + energy.elastic(system, x, inside) + energy.potential(system, x, bodies) + outlets
    if system.contacts is not None:
        wound, packed = layout.wound(y), bool(np.any(layout.packed(y)))
        seen = contact_forces.view_of_states(
            system, x, v, bodies, wound.held if system.reels else None, packed
        )
        kept = kept + contact_forces.stored(system.contacts, seen)
    return float(energy.kinetic(system, v, bodies) + kept)


def begun(case: Case, system: System) -> Begun | None:
    """The balances at time 0; None where they are empty."""
    net, carrier = system.net, case.start.carrier
    throw = thrown_at_start(case, net)
    if throw is None or carrier is None:
        return None
    x, v, bodies = before_throw(case, net)
    impulse = net.mass[:, None] * throw
    given = (impulse.sum(axis=0), cross(x, impulse).sum(axis=0), [np.sum(impulse * v)])
    had = energy.kinetic(system, v, collect(bodies)[1])
    has = energy.kinetic(system, initial_state(case, net)[1], collect(initial_bodies(case, net))[1])
    return Begun(system.bodies.names.index(carrier.body), np.concatenate(given), float(had - has))
