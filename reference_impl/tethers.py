"""Ties a net to bodies: tethers become further nodes and elements of it, attached nodes points of bodies.

A tether is one more side, divided as the sides of the net are (`division`): its inner nodes lie between its
ends by their shares, in place and velocity.  Where it ends on a body it has a node of its own there, which is
a point of the body.  Its reference configuration is the straight line on which it starts.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from reference_impl.anchors import Anchors
from reference_impl.arrays import Floats, Ints
from reference_impl.case import BodyPoint, Case, NetNode, Refused
from reference_impl.division import divide, lump
from reference_impl.net import Net
from reference_impl.reels import chain, spread_outside
from reference_impl.shape import LARGEST_COUNT
from reference_impl.start import initial_state, net_axes

TAUT = 1e-9  # part of its length by which a tether may start stretched, and below which its ends coincide


def tie(case: Case, net: Net) -> Net:
    """The net with the case's attachments and tethers, its reference directions in the scene's axes."""
    if case.start.carrier is not None:
        net = replace(net, direction=net.direction @ net_axes(case).T)
    if not (case.attachments or case.tethers):
        return net
    held = [(_node(net, a.node), a.place) for a in case.attachments]
    ends: list[int] = []
    tied_to: list[int] = []
    for number, tether in enumerate(case.tethers):
        for end in (tether.start, tether.end):
            if isinstance(end, BodyPoint):
                ends.append(len(net.mass) + len(tied_to))
                held.append((ends[-1], end))
                tied_to.append(number)
            else:
                ends.append(_node(net, end))
    tied = replace(net, anchors=_anchors(case, held))
    if not case.tethers:
        return tied
    return _placed(case, _lengthened(case, tied, np.array(ends, dtype=np.intp).reshape(-1, 2), tied_to))


def _node(net: Net, place: NetNode) -> int:
    numbered = net.numbered_bullets if place.kind == "bullet" else net.numbered_nodes
    return int(numbered[place.number])


def _anchors(case: Case, held: list[tuple[int, BodyPoint]]) -> Anchors:
    names = [body.name for body in case.bodies]
    return Anchors(
        np.array([node for node, _ in held], dtype=np.intp),
        np.array([names.index(place.body) for _, place in held], dtype=np.intp),
        np.array([place.point for _, place in held], dtype=float).reshape(-1, 3),
    )


def _lengthened(case: Case, net: Net, ends: Ints, tied_to: list[int]) -> Net:
    """The net with tethers between the nodes `ends` (q, 2); not yet placed.

    These are nodes of the net, or beyond them ends on bodies: `tied_to`, the numbers of their tethers.
    """
    pieces = np.array([tether.divisions for tether in case.tethers])
    if pieces.sum() > LARGEST_COUNT:
        raise Refused([f"tethers: more than {LARGEST_COUNT} elements"])
    element_nodes, parents, shares = divide(len(net.mass) + len(tied_to), ends, pieces)
    order = _tether_by_tether(len(net.mass), tied_to, pieces)
    number = np.argsort(order)
    element_nodes, parents, shares = number[element_nodes], number[parents[order]], shares[order]
    net = replace(net, anchors=replace(net.anchors, node=number[net.anchors.node]))
    tether = np.repeat(np.arange(len(pieces)), pieces)
    _let_out(case, element_nodes, tether, shares)
    made = np.array([(t.cable.area, t.cable.youngs_modulus, t.cable.density) for t in case.tethers])[tether]
    reference_length = np.array([t.length / t.divisions for t in case.tethers])[tether]
    before, more = len(net.mass), len(parents) - len(net.mass)
    halves = lump(
        len(parents), element_nodes, made[:, 2] * made[:, 0] * reference_length, np.zeros(len(parents))
    )
    return replace(
        net,
        reference_position=np.concatenate((net.reference_position, np.zeros((more, 3)))),
        element_nodes=np.concatenate((net.element_nodes, element_nodes)),
        reference_length=np.concatenate((net.reference_length, reference_length)),
        area=np.concatenate((net.area, made[:, 0])),
        youngs_modulus=np.concatenate((net.youngs_modulus, made[:, 1])),
        density=np.concatenate((net.density, made[:, 2])),
        mass=np.concatenate((net.mass, np.zeros(more))) + halves,
        of_string=np.concatenate((net.of_string, np.zeros(len(tether), dtype=bool))),
        parents=np.concatenate((net.parents, parents[before:])),
        shares=np.concatenate((net.shares, shares[before:])),
        direction=np.concatenate((net.direction, np.zeros((len(tether), 3)))),
        tether=np.concatenate((net.tether, tether)),
    )


def _tether_by_tether(woven: int, tied_to: list[int], pieces: Ints) -> Ints:
    """The order of the nodes: the `woven` ones, then of each tether its ends on bodies and its inner nodes.

    They come with all ends on bodies, `tied_to` the tethers of these numbers, before all inner nodes.
    """
    inside = np.repeat(np.arange(len(pieces)), pieces - 1)
    owner = np.concatenate((np.full(woven, -1), np.array(tied_to, dtype=np.intp), inside))
    return np.argsort(owner, kind="stable")


def _let_out(case: Case, element_nodes: Ints, tether: Ints, shares: Floats) -> None:
    """Changes the shares (n, 2) of nodes of reeled tethers: on the drum, or between it and the other end."""
    for number, line in enumerate(case.tethers):
        if line.reel is None:
            continue
        nodes, _ = chain(element_nodes, tether, number, line.reel.at_start)
        way = spread_outside(line.length, line.divisions, line.reel.paid_out)
        drum, other = (0, 1) if line.reel.at_start else (1, 0)
        shares[nodes[1:-1], drum], shares[nodes[1:-1], other] = 1.0 - way, way


def _placed(case: Case, net: Net) -> Net:
    """Directions and reference positions of the tethers, from where the case starts."""
    place = initial_state(case, net)[0]
    direction, faults = net.direction.copy(), []
    for number, tether in enumerate(case.tethers):
        elements = np.flatnonzero(net.tether == number)
        way = place[net.element_nodes[elements[-1], 1]] - place[net.element_nodes[elements[0], 0]]
        distance = float(np.linalg.norm(way))
        key, most = ("length", tether.length)
        if tether.reel is not None:
            key, most = ("reel.paid_out", tether.reel.paid_out)
        if not distance <= most * (1.0 + TAUT):
            faults.append(
                f"tethers.{tether.name}.{key}: must not be below the distance between its ends at time 0,"
                f" {distance:.10g} m"
            )
        elif distance > TAUT * tether.length:
            direction[elements] = way / distance
        elif case.effects.beta:
            faults.append(
                f"tethers.{tether.name}: its ends coincide at time 0, so effects.rayleigh_damping.beta has"
                " no direction to damp along"
            )
    if faults:
        raise Refused(faults)
    reference = np.concatenate((net.reference_position[: net.woven], place[net.woven :]))
    return replace(net, reference_position=reference, direction=direction)
