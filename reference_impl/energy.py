"""Energies and momenta of states x (..., n, 3) [m], v (..., n, 3) [m/s]; eqs. (18), (19).

The constants: gravity, orbit, j2 and sunlight have the potential zero for a node in the origin, bending for a
straight thread, springs and gas of a launch for a bullet that has left its barrel.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from reference_impl import body_forces, contact_forces
from reference_impl.arrays import Bools, Floats
from reference_impl.bodies import BodyStates
from reference_impl.closing import Drawn, Edge, Line
from reference_impl.effects.orbit import orbital_potential
from reference_impl.elements import energy_density, span, strain
from reference_impl.reels import Wound
from reference_impl.self_contact import stored as stored_between
from reference_impl.system import System


def kinetic(system: System, v: Floats, bodies: BodyStates | None = None) -> Floats:
    """K = 1/2 v^T M v (...) [J], eq. (18), and that of the `bodies`, 1/2 m v^2 + 1/2 w.J w, if given."""
    total = np.asarray(0.5 * np.einsum("n,...nc,...nc->...", system.net.own_mass, v, v))
    if bodies is None:
        return total
    free = system.bodies.free
    moving = np.einsum("b,...bc,...bc->...", free * system.bodies.mass, bodies.velocity, bodies.velocity)
    inertia, spin = free[:, None, None] * system.bodies.inertia, bodies.angular_velocity
    return np.asarray(total + 0.5 * (moving + np.einsum("bcd,...bc,...bd->...", inertia, spin, spin)))


def elastic(system: System, x: Floats, intact: Bools | None = None) -> Floats:
    """U_el = 1/2 sum S11 (E11 - e) A L (...) [J], eq. (19), of the elements `intact` (..., m); None: all."""
    e11 = strain(system, x)
    density = energy_density(system, e11)
    if intact is not None:
        density = np.where(intact, density, 0.0)
    return np.asarray(density @ (system.net.area * system.net.reference_length))


def at_outlets(system: System, x: Floats, wound: Wound) -> tuple[Bools | None, Floats]:
    """Which elements (..., m) are no outlets of reels (None: all), and U (...) [J] of the outlets."""
    if system.reels is None:
        return None, np.zeros(x.shape[:-2])
    lengths = system.reels.lengths(system.net, wound.wound_up, wound.held)
    outlet = np.zeros(lengths.shape, dtype=bool)
    np.put_along_axis(outlet, system.reels.outlets(wound.held), True, axis=-1)
    e11 = strain(system, x, lengths)
    density = np.where(outlet, energy_density(system, e11), 0.0)
    return ~outlet, np.asarray((density * lengths) @ system.net.area)


def of_closing(system: System, x: Floats, drawn: Drawn) -> tuple[Bools | None, Floats]:
    """Elements (m,) outside a shrinking edge (None: all), and what closes the mouth stores [J]."""
    closing = system.closing
    if closing is None:
        return None, np.zeros(x.shape[:-2])
    if isinstance(closing, Line):
        return None, closing.energy(x, drawn.amount, system.free_strain)
    others = np.ones(len(system.net.area), dtype=bool)
    others[closing.element] = False
    lengths = system.net.reference_length * np.where(others, 1.0, drawn.amount)
    e11 = strain(system, x, lengths)
    density = np.where(others, 0.0, energy_density(system, e11))
    return others, np.asarray((density * lengths) @ system.net.area)


def potential(
    system: System, x: Floats, bodies: BodyStates | None = None, gone: Bools | None = None
) -> Floats:
    """Potential (...) [J] of gravity, orbit, j2, sunlight, bending, self_contact and launch_force.

    Without that of `contact`, which depends on what bodies hold.

    With that of the `bodies`, if given.  Of bullets that are `gone` (..., k) launch_force holds none; without
    it the way of each decides.

    Raises ValueError where launch_force needs the states of the `bodies`.
    """
    mass, effects = system.net.own_mass, system.effects
    total = -np.einsum("n,...nc,c->...", mass, x, np.array(effects.gravity))
    if effects.orbit is not None:
        total = total + orbital_potential(effects.orbit, x) @ mass
    if effects.j2 is not None:
        total = total - 0.5 * np.einsum("n,...nc,cd,...nd->...", mass, x, system.oblate, x)
    if effects.solar_pressure is not None:
        total = total - np.einsum("nc,...nc->...", system.sunlight, x)
    if effects.bending is not None:
        total = total + system.hinges.energy(span(system, x))
    if system.meeting is not None:
        total = total + stored_between(system.meeting, x)
    if bodies is not None and body_forces.act(system):
        total = total + body_forces.potential(system, bodies.position, bodies.attitude)
    if effects.launch_force is not None:
        if bodies is None:
            raise ValueError(
                "launch_force stores energy: give the states of the bodies, the chaser among them"
            )
        particles = np.concatenate((x, bodies.position), axis=-2)
        s = system.ways(particles, bodies.attitude)
        stored = effects.launch_force.held(s)
        total = total + np.sum(stored if gone is None else np.where(gone, 0.0, stored), axis=-1)
    return np.asarray(total)


def momentum(system: System, v: Floats, bodies: BodyStates | None = None) -> Floats:
    """Linear momentum (..., 3) [kg m/s], of net and bodies."""
    total = np.asarray(np.einsum("n,...nc->...c", system.net.own_mass, v))
    if bodies is None:
        return total
    return np.asarray(
        total + np.einsum("b,...bc->...c", system.bodies.free * system.bodies.mass, bodies.velocity)
    )


def angular_momentum(system: System, x: Floats, v: Floats, bodies: BodyStates | None = None) -> Floats:
    """Angular momentum about the origin (..., 3) [kg m2/s], of net and bodies."""
    total = np.asarray(np.einsum("n,...nc->...c", system.net.own_mass, np.cross(x, v)))
    if bodies is None:
        return total
    free = system.bodies.free
    orbital = np.cross(bodies.position, bodies.velocity)
    own = np.einsum(
        "...bij,bjk,...bk->...bi",
        bodies.attitude,
        free[:, None, None] * system.bodies.inertia,
        bodies.angular_velocity,
    )
    return np.asarray(
        total + np.einsum("b,...bc->...c", free * system.bodies.mass, orbital) + np.sum(own, axis=-2)
    )


@dataclass(frozen=True, eq=False)
class Books:
    """Energies (nt,) [J], momentum (nt, 3) [kg m/s], angular momentum (nt, 3) [kg m2/s] of a run."""

    kinetic: Floats
    elastic: Floats
    potential: Floats
    dissipated: Floats  # what has left: to damping, drag, events, less what thrust, reels, drives put in
    momentum: Floats
    angular_momentum: Floats

    @property
    def total(self) -> Floats:
        """Their sum (nt,) [J], which is constant."""
        return self.kinetic + self.elastic + self.potential + self.dissipated


class Stored(Protocol):
    """What a run has stored (`run.Trajectory`)."""

    @property
    def t(self) -> Floats: ...
    @property
    def x(self) -> Floats: ...
    @property
    def v(self) -> Floats: ...
    @property
    def dissipated(self) -> Floats: ...
    @property
    def bodies(self) -> BodyStates: ...
    @property
    def intact(self) -> Bools: ...
    @property
    def reels(self) -> Wound: ...
    @property
    def gone(self) -> Bools: ...
    @property
    def drawn(self) -> Drawn: ...


def lengths(system: System, wound: Wound, drawn: Drawn) -> Floats | None:
    """Reference lengths (..., m) [m]; None where they are the net's."""
    changed = None
    if system.reels is not None:
        changed = system.reels.lengths(system.net, wound.wound_up, wound.held)
    if isinstance(edge := system.closing, Edge):
        part = np.ones((*drawn.amount.shape[:-1], len(system.net.area)))
        part[..., edge.element] = drawn.amount
        changed = part * (system.net.reference_length if changed is None else changed)
    return changed


def contact(system: System, run: Stored) -> Floats:
    """Energy (nt,) [J] stored where threads, nodes and bullets press on bodies."""
    contacts = system.contacts
    if contacts is None:
        return np.zeros(len(run.x))
    return np.array([contact_forces.stored(contacts, seen) for seen in _views(system, run)])


def depth(system: System, run: Stored) -> Floats:
    """The greatest depth (nt,) [m] of threads, nodes and bullets in bodies, 0 where nothing touches."""
    if system.contacts is None:
        return np.zeros(len(run.x))
    return np.array([contact_forces.deepest(seen).depth for seen in _views(system, run)])


def _views(system: System, run: Stored) -> Iterator[list[contact_forces.View]]:
    """What may touch at each time."""
    for k in range(len(run.x)):
        bodies = BodyStates(*(getattr(run.bodies, key)[k] for key in run.bodies.__dataclass_fields__))
        held = None if system.reels is None else run.reels.held[k]
        packed = system.packs(float(run.t[k]))
        yield contact_forces.view_of_states(system, run.x[k], run.v[k], bodies, held, packed)


def books(system: System, run: Stored) -> Books:
    """The energy and momentum balance of a run, bodies, reels and broken elements included."""
    bodies = run.bodies
    inside, outlets = at_outlets(system, run.x, run.reels)
    others, closing = of_closing(system, run.x, run.drawn)
    intact = run.intact if inside is None else run.intact & inside
    intact = intact if others is None else intact & others
    return Books(
        kinetic(system, run.v, bodies),
        elastic(system, run.x, intact),
        potential(system, run.x, bodies, run.gone) + outlets + closing + contact(system, run),
        run.dissipated,
        momentum(system, run.v, bodies),
        angular_momentum(system, run.x, run.v, bodies),
    )
