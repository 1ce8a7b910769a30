"""Contact of nodes or bullets, as spheres, with a rigid body."""

from __future__ import annotations

import math
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from exunet.base.arrays import Floats, Ints
from exunet.forces.blocks import Blocks
from exunet.forces.contact.broad_phase import (
    KEPT,
    RESULTANT,
    begin_resultant,
    end_resultant,
    keep_row,
    remember_status,
)
from exunet.forces.contact.estimate import damping_rate, friction_rate, speed_of_net
from exunet.forces.contact.law import (
    FRICTION,
    ContactLaw,
    Friction,
    friction,
    regularised_friction,
    shift_for,
    touched_body,
)
from exunet.forces.contact.signed_distance import (
    DISTANCES,
    FRAMES,
    SAMPLED_DISTANCES,
    any_core_gradient,
    apply_at_point,
    deeper,
    place_in_body,
    turn_into,
    velocity_against_body,
)
from exunet.forces.contact.status import discrete_state_of, trouble, untouched
from exunet.forces.contact.thread_contact import ROW
from exunet.forces.cores import Cores, Surface, TouchedBody
from exunet.forces.loops import Index
from exunet.forces.terms import KernelTerm
from exunet.net.arrays import Net


class SphereLaw(NamedTuple):
    """F = k p^n: k [N/m^n], n, damping a [s/m]; stiffness along the surface [N/m] over kappa."""

    stiffness: float
    exponent: float
    damping: float
    along: float


class SphereNodes(NamedTuple):
    """Nodes that touch as spheres: singular and plural name, nodes (m,), and the numbers reported (m,)."""

    one: str
    many: str
    nodes: Ints
    numbers: Ints


def bullets_of(net: Net) -> SphereNodes:
    """With the numbers that the case gives to them."""
    return SphereNodes("bullet", "bullets", net.bullet_nodes, np.arange(len(net.bullet_nodes)))


def nodes_of(net: Net) -> SphereNodes:
    """Nodes of the net and its strings that are no bullets; those of tethers may lie on a drum."""
    nodes = np.setdiff1d(np.arange(net.n_net_nodes), net.bullet_nodes)
    return SphereNodes("node", "nodes", nodes, nodes)


class Spheres(NamedTuple):
    """Spheres that may touch a body.

    node  : (m,) 3 x nodes of the spheres
    thick : their radius [m]
    spring, relaxation : (m,) k_t [N/m] and theta [s] of friction
    """

    node: NDArray[Index]
    thick: float
    spring: Floats
    relaxation: Floats


class SphereWorkspace(NamedTuple):
    """frame : (3, 3) the rotation of the body, work space."""

    frame: Floats


class SphereContact(NamedTuple):
    """Contact of spheres with a body; other fields as of `ThreadContact`.

    body : its `allowed` is the depth of a sphere less its radius, see `beyond_radius`
    """

    spheres: Spheres
    cores: Cores
    body: TouchedBody
    law: ContactLaw
    taken: int
    kept: Floats
    after: Floats
    now: Floats
    work: SphereWorkspace


def sphere_contact(
    blocks: Blocks,
    what: SphereNodes,
    body: str,
    surface: Surface,
    radius: float,
    law: SphereLaw,
    rubbing: Friction,
    inside: bool,
) -> KernelTerm:
    """The term of the contact of nodes, or bullets, with a body.

    inside : they start inside it, in its canister
    """
    net = blocks.net
    touching = ~np.isin(what.nodes, surface.attached)
    nodes, numbers = what.nodes[touching], what.numbers[touching]
    spring = np.full(len(nodes), rubbing.ratio * law.along)
    rows = np.zeros((len(nodes), ROW))
    rows[:, 0] = -1.0 if inside else 0.0
    kept = untouched(rows)
    relaxation = 2.0 * rubbing.damping * np.sqrt(net.mass[nodes] / spring)
    data = SphereContact(
        spheres=Spheres((3 * nodes).astype(Index), radius, spring, relaxation),
        cores=surface.cores,
        body=touched_body(blocks, body, surface, beyond_radius(surface, radius)),
        law=ContactLaw(law.stiffness, law.damping, law.exponent, rubbing.friction, rubbing.slip_speed),
        taken=blocks.rate("contact/damping"),
        kept=kept,
        after=np.zeros((len(nodes), ROW)),
        now=np.zeros(14),
        work=SphereWorkspace(np.zeros((3, 3))),
    )
    shown: Any = {"surface": surface, "body": body, "what": what.one, "numbers": numbers}
    wrong = partial(trouble, **shown, beyond_radius=data.body.allowed)
    rate = _stiffness_rate(blocks, body, surface, data)
    speed = speed_of_net(blocks, body, float(np.linalg.norm(surface.middle)) + surface.radius)
    return KernelTerm(
        f"{what.many} and {body}",
        add_sphere_contact,
        data,
        sphere_contact_potential,
        (*FRAMES, *DISTANCES, *SAMPLED_DISTANCES, *KEPT, *RESULTANT, *FRICTION, *_OWN),
        bodies=(body,) if body in blocks.free_bodies else (),
        stiffness_rate=rate,
        damping_rate=damping_rate(data.law.damping, rate, speed, data.law.exponent),
        friction_rate=friction_rate(rubbing, rate, speed),
        discrete=discrete_state_of(what.many, body, kept, wrong),
        remember=remember_sphere_contact,
        internal=True,
    )


def beyond_radius(surface: Surface, radius: float) -> float:
    """How much deeper than by its radius a sphere may be [m]; below zero of one larger than a body is thick.

    Its centre may be as deep as a thread, and nothing of it may come out on the other side: a sphere that has
    the whole body inside is deeper than the body is thick.
    """
    return min(surface.allowed, 2.0 * surface.least - radius)


def steepest(data: SphereContact) -> float:
    """The largest stiffness [N/m] of a sphere, while it is not too deep."""
    law, depth = data.law, float(data.body.allowed + data.spheres.thick)
    return law.stiffness * law.exponent * depth ** (law.exponent - 1.0)


def _stiffness_rate(blocks: Blocks, body: str, surface: Surface, data: SphereContact) -> float:
    """Bound [1/s2] of what contact adds to the eigenvalues, while nothing is too deep; as of threads."""
    slope = steepest(data) * (1.0 + surface.bends * float(data.body.allowed + data.spheres.thick))
    mass = blocks.net.mass[data.spheres.node.astype(np.int64) // 3]
    if not len(mass):
        return 0.0
    rate = slope / float(mass.min())
    if body in blocks.free_bodies:
        number = blocks.free_bodies.index(body)
        arm = float(np.linalg.norm(surface.middle)) + surface.radius
        mobility = 1.0 / blocks.inertia.mass[number] + arm**2 / blocks.inertia.moments[number].min()
        rate += slope * len(mass) * mobility
    return rate


# Scalar loops, in the subset of Python that Numba compiles.


def add_sphere_contact(t: float, x: Any, v: Any, c: Any, force: Any) -> None:
    """Forces of all spheres that touch the body, and what they would leave in the discrete state."""
    now = c.now
    for m in range(now.size):
        now[m] = 0.0
    now[1] = -1.0
    begin_resultant(c, force)
    reach = c.body.radius + c.spheres.thick
    turned = False
    for k in range(c.spheres.node.size):
        c.after[k, 0] = 0.0
        i = c.spheres.node[k]
        d = 0.0
        for axis in range(3):
            apart = x[i + axis] - x[c.body.centre + axis]
            d += apart * apart
        far = reach + math.sqrt(c.body.middle[0] ** 2 + c.body.middle[1] ** 2 + c.body.middle[2] ** 2)
        if d < far * far:
            if not turned:
                turn_into(x, c.body.attitude, c.work.frame)
                turned = True
            add_sphere(x, v, c, k, force)
    end_resultant(c, force)


def add_sphere(x: Any, v: Any, c: Any, k: int, force: Any) -> None:
    """Forces of sphere k."""
    row = c.after[k]
    kept = c.kept
    first = 5 * k
    i = c.spheres.node[k]
    p = place_in_body(x, i, c.body.centre, c.work.frame)
    w = velocity_against_body(v, i, c.body.centre, c.body.spin, c.work.frame, p)
    speed = math.sqrt(w[0] * w[0] + w[1] * w[1] + w[2] * w[2])
    if speed > c.now[3]:
        c.now[3] = speed
        c.now[6] = k
    depth, d, e, f = depth_of_ball(c, p)
    if depth <= 0.0:
        return
    row[0] = min(kept[first], 0.0)
    if kept[first] < 0.0:
        return
    c.now[2] += 1.0
    if depth > c.now[0]:
        c.now[0] = depth
        c.now[1] = k
    if depth > c.body.allowed + c.spheres.thick:
        c.now[4] = -1.0 - k
    rate = -(d * w[0] + e * w[1] + f * w[2])
    elastic = c.law.stiffness * depth**c.law.exponent
    across = elastic * max(1.0 + c.law.damping * rate, 0.0)
    c.now[5] += across
    c.now[7] += elastic * depth / (c.law.exponent + 1.0)
    force[c.taken] += (across - elastic) * rate
    on = (across * d, across * e, across * f)
    if c.law.friction > 0.0:
        size = math.sqrt(d * d + e * e + f * f)
        n = (d / size, e / size, f / size) if size > 0.0 else (0.0, 0.0, 1.0)
        rub = (0.0, 0.0, 0.0)
        if c.law.slip_speed > 0.0:
            rub = regularised_friction(across, n, w, c.law)
        else:
            spring, time = c.spheres.spring[k], c.spheres.relaxation[k]
            u = (0.0, 0.0, 0.0)
            if kept[first] == 1.0:
                u = (p[0] - kept[first + 2], p[1] - kept[first + 3], p[2] - kept[first + 4])
            rub, slides = friction(across, n, u, w, spring, time, c.law)
            if slides:
                u = shift_for(rub, n, w, spring, time)
            row[0] = 1.0
            row[2] = p[0] - u[0]
            row[3] = p[1] - u[1]
            row[4] = p[2] - u[2]
        force[c.taken + 1] -= rub[0] * w[0] + rub[1] * w[1] + rub[2] * w[2]
        on = (on[0] + rub[0], on[1] + rub[1], on[2] + rub[2])
    apply_at_point(force, i, c.body.centre, c.body.spin, c.work.frame, p, on)


def depth_of_ball(c: Any, p: Any) -> Any:
    """Depth [m] of a sphere at p (3), and the direction (3) of the force; of several solids as `deeper`."""
    found = (0.0, 0.0, 0.0, 0.0)
    for n in range(c.cores.kind.size):
        distance, d, e, f = any_core_gradient(c.cores, n, p[0], p[1], p[2])
        found = deeper(found, c.cores.rounding[n] + c.spheres.thick - distance, (d, e, f))
    return found


def sphere_contact_potential(x: Any, c: Any) -> float:
    """Energy [J] stored across the surface."""
    turn_into(x, c.body.attitude, c.work.frame)
    total = 0.0
    for k in range(c.spheres.node.size):
        if c.kept[5 * k] >= 0.0:
            p = place_in_body(x, c.spheres.node[k], c.body.centre, c.work.frame)
            depth, _, _, _ = depth_of_ball(c, p)
            if depth > 0.0:
                total += c.law.stiffness * depth ** (c.law.exponent + 1.0) / (c.law.exponent + 1.0)
    return total


def remember_sphere_contact(t: float, x: Any, v: Any, c: Any) -> None:
    """Store the discrete state of the spheres; `add_sphere_contact` has evaluated this state last."""
    kept = c.kept
    for k in range(c.spheres.node.size):
        keep_row(kept, k, c.after[k])
    last = 5 * c.spheres.node.size
    remember_status(t, c, kept[last:])


_OWN = (add_sphere, depth_of_ball, deeper)
