"""Contact of threads, nodes and bullets with rigid bodies, and of these with each other.

Penalty with Hunt and Crossley's damping across the surface, Coulomb friction along it; see
`exunet.forces.contact`, and for the equations docs/explanation/theory_contact.md.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Iterator
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import Field

from exunet.base.errors import Fault
from exunet.base.record import FromArray, NonNegative, Positive, Record
from exunet.forces.blocks import Blocks, FirstOrder
from exunet.forces.contact.body_contact import BodyLaw, body_contact
from exunet.forces.contact.law import ImpactDampingConfig, hertz_of_line, hertz_of_sphere
from exunet.forces.contact.sphere_contact import SphereLaw, SphereNodes, bullets_of, nodes_of, sphere_contact
from exunet.forces.contact.thread_contact import Friction, thread_contact
from exunet.forces.effect import Effect, RestOfCase, existing_body
from exunet.forces.estimate import Estimate, EstimateBasis
from exunet.forces.terms import KernelTerm
from exunet.net.arrays import Net

_PRESSING = ("sphere", "box", "capsule")  # solids that press into other bodies


def named(keys: Any, rest: RestOfCase, key: str) -> Iterator[Fault]:
    """Yield the faults of the bodies that `key` names."""
    names = getattr(keys, key)
    for k, name in enumerate(names):
        place = f"{key}[{k}]"
        if name not in rest.bodies:
            yield from existing_body(place, name, rest)
        elif name in names[:k]:
            yield Fault(place, f"{name} is named twice")
        else:
            yield from _touchable(rest.scene.bodies[name], name, place)


def paired(keys: Any, rest: RestOfCase) -> Iterator[Fault]:
    """Yield the faults of the pairs of bodies."""
    seen = set()
    for k, pair in enumerate(keys.bodies):
        one, other = pair
        place = f"bodies[{k}]"
        missing = [name for name in dict.fromkeys(pair) if name not in rest.bodies]
        for name in missing:
            yield from existing_body(f"{place}[{pair.index(name)}]", name, rest)
        if one == other:
            yield Fault(place, f"{one} cannot touch itself: give two bodies")
        elif frozenset(pair) in seen:
            yield Fault(place, f"{one} and {other} are named twice")
        elif not missing:
            wrong = [
                fault
                for m, name in enumerate(pair)
                for fault in _touchable(rest.scene.bodies[name], name, f"{place}[{m}]")
            ]
            yield from wrong
            if not wrong:
                yield from _fit(rest, pair, place)
        seen.add(frozenset(pair))


def _fit(rest: RestOfCase, pair: tuple[str, str], place: str) -> Iterator[Fault]:
    """Round sides press on nothing but balls: there is no corner or edge that would meet them first.

    A mesh presses on nothing.
    """
    meshes = [name for name in pair if _shapes(rest.scene.bodies[name]) == ["mesh"]]
    if meshes:
        words = f"{meshes[0]} is a mesh, which touches no other body: build it of boxes, spheres and capsules"
        yield Fault(place, f"{words}, as parts")
        return
    for name, partner in (pair, pair[::-1]):
        curved = [shape for shape in _shapes(rest.scene.bodies[name]) if shape not in _PRESSING]
        if curved and any(shape != "sphere" for shape in _shapes(rest.scene.bodies[partner])):
            words = f"{name} has a {curved[0]}, which touches spheres only, and {partner} is no sphere"
            yield Fault(place, f"{words}: build both of boxes, spheres and capsules, as parts")
            return


def _shapes(body: Any) -> list[str]:
    """Return the shapes of a body, or of its parts."""
    return [body.shape] if body.is_given("shape") else [part.shape for part in body.parts.values()]


def _touchable(body: Any, name: str, place: str) -> Iterator[Fault]:
    shapes = _shapes(body)
    if not shapes:
        yield Fault(place, f"{name} has no shape that could be touched: give it shape or parts")
    sharp = [shape for shape in shapes if shape not in ("sphere", "capsule")]
    if sharp and not (body.is_given("edge_radius") and body.edge_radius > 0.0):
        yield Fault(
            place,
            f"{name} has sharp edges, over which the direction of a force would jump: give "
            f"bodies.{name}.edge_radius, at least what threads may press in",
        )


Names = Annotated[tuple[str, ...], FromArray]
NO_FRICTION = Friction(0.0, 0.0, 0.5, 0.1)
Pairs = Annotated[tuple[Annotated[tuple[str, str], FromArray], ...], FromArray]


class StickingFriction(Record):
    """Coulomb's friction with stick: it holds what rests."""

    law: Literal["sticking"] = Field(description="holds what rests")
    coefficient: NonNegative = Field(description="coefficient mu of Coulomb's friction [-]", examples=[0.3])
    tangential_ratio: float = Field(
        0.5, gt=0.0, le=1.0, description="kappa, stiffness along the surface over that across it"
    )
    tangential_damping: NonNegative = Field(
        0.1, description="zeta, fraction of critical damping along the surface"
    )

    @property
    def numbers(self) -> Friction:
        """Numbers of the law."""
        return Friction(self.coefficient, 0.0, self.tangential_ratio, self.tangential_damping)


class RegularisedFriction(Record):
    """Coulomb's friction that is smooth in the speed along the surface."""

    law: Literal["regularised"] = Field(description="smooth in the speed: it lets what rests creep")
    coefficient: NonNegative = Field(description="coefficient mu of Coulomb's friction [-]", examples=[0.3])
    slip_speed: Positive = Field(description="v_s, speed from which friction is full [m/s]", examples=[1e-3])

    @property
    def numbers(self) -> Friction:
        """Numbers of the law."""
        return Friction(self.coefficient, self.slip_speed)


class Contact(Effect, ImpactDampingConfig):
    """Threads, nodes and bullets touch bodies, and bodies each other."""

    INTERNAL: ClassVar = True
    COLLIDES: ClassVar = True
    NEEDS: ClassVar[dict[str, tuple[str, ...]]]  # of what touches, the keys that go with it

    law: str = Field(description="of the force across the surface")
    threads: Names = Field(
        (), description="names of the bodies that threads of net and tethers touch", examples=[["target"]]
    )
    nodes: Names = Field(
        (),
        description="names of the bodies that nodes of the net and its strings touch, without bullets, "
        "as spheres; not those of threads",
        examples=[["target"]],
    )
    bullets: Names = Field(
        (), description="names of the bodies that bullets touch, as spheres", examples=[["target"]]
    )
    bodies: Pairs = Field(
        (), description="pairs of names of bodies that touch each other", examples=[[["chaser", "target"]]]
    )
    node_radius: Positive | None = Field(
        None, description="radius of the nodes [m]; if and only if nodes are given", examples=[0.01]
    )
    bullet_radius: Positive | None = Field(
        None, description="radius of the bullets [m]; if and only if bullets are given", examples=[0.02]
    )
    friction: Annotated[StickingFriction | RegularisedFriction, Field(discriminator="law")] | None = Field(
        None, description="friction along the surface; absent: none"
    )

    def faults(self) -> Iterator[Fault]:
        """Require a pair that touches, and the keys of what touches and no others."""
        yield from super().faults()
        if not (self.threads or self.nodes or self.bullets or self.bodies):
            words = "names of bodies in threads, nodes or bullets, or pairs of names in bodies"
            yield Fault("", f"requires {words}: nothing touches otherwise")
        for k, name in enumerate(self.nodes):
            if name in self.threads:
                words = f"threads touch {name} along their whole length, ends included: name it once"
                yield Fault(f"nodes[{k}]", words)
        for what, keys in self.NEEDS.items():
            for key in keys:
                if getattr(self, what) and not self.is_given(key):
                    yield Fault(key, f"missing: required where {what} touch")
                if self.is_given(key) and not getattr(self, what):
                    yield Fault(key, f"requires {what}: none touch")

    @property
    def rubbing(self) -> Friction:
        """Friction as the loops take it."""
        return NO_FRICTION if self.friction is None else self.friction.numbers

    @property
    @abstractmethod
    def of_threads(self) -> float:
        """K [N/m2]."""

    @property
    def of_nodes(self) -> SphereLaw:
        """Law of spheres of the nodes' radius."""
        return self._of_spheres("node")

    @property
    def of_bullets(self) -> SphereLaw:
        """Law of spheres of the bullets' radius."""
        return self._of_spheres("bullet")

    @property
    @abstractmethod
    def of_bodies(self) -> BodyLaw:
        """Law of corners, balls and edges."""

    @abstractmethod
    def _of_spheres(self, what: str) -> SphereLaw: ...

    def cross_checks(self, rest: RestOfCase) -> Iterator[Fault]:
        """Require bodies that can be touched, and bullets where bullets touch."""
        for key in ("threads", "nodes", "bullets"):
            yield from named(self, rest, key)
        yield from paired(self, rest)
        if self.bullets and not rest.has_bullets:
            yield Fault("bullets", "the net has no bullets: add [net.bullets] or remove this key")

    def touched_bodies(self) -> frozenset[str]:
        """Return the names of the bodies that threads, nodes, bullets or other bodies touch."""
        of_pairs = (name for pair in self.bodies for name in pair)
        return frozenset((*self.threads, *self.nodes, *self.bullets, *of_pairs))

    def touching_pairs(self) -> tuple[tuple[str, str], ...]:
        return self.bodies

    def largest_radius(self, net: Net) -> float:
        threads = float(np.sqrt(net.area / math.pi).max(initial=0.0)) if self.threads else 0.0
        nodes = self.node_radius if self.nodes else None
        bullets = self.bullet_radius if self.bullets else None
        return max(threads, nodes or 0.0, bullets or 0.0)

    def first_order_states(self) -> tuple[FirstOrder, ...]:
        """Return the energy that damping and friction have taken [J]."""
        names = ("damping", "friction")
        return tuple(FirstOrder(f"contact/{name}", (0.0,), "J", gives=-1.0) for name in names)

    def terms(self, blocks: Blocks) -> tuple[KernelTerm, ...]:
        """Return a term for each body that threads, nodes and bullets touch, each; of pairs one or two."""
        found = []
        for body in self.threads:
            inside = np.arange(blocks.net.n_net_elements if body == blocks.carrier else 0)
            law = self.of_threads, self.a
            found.append(thread_contact(blocks, body, blocks.surfaces[body], law, self.rubbing, inside))
        nodes, bullets = nodes_of(blocks.net), bullets_of(blocks.net)
        found += [self._balls(blocks, nodes, body, self.node_radius, self.of_nodes) for body in self.nodes]
        found += [
            self._balls(blocks, bullets, body, self.bullet_radius, self.of_bullets) for body in self.bullets
        ]
        for pair in self.bodies:
            found += body_contact(blocks, pair, self.of_bodies, self.rubbing)
        return tuple(found)

    def _balls(
        self, blocks: Blocks, what: SphereNodes, body: str, radius: float | None, law: SphereLaw
    ) -> KernelTerm:
        assert radius is not None
        inside, surface = body == blocks.carrier, blocks.surfaces[body]
        return sphere_contact(blocks, what, body, surface, radius, law, self.rubbing, inside=inside)

    def magnitude(self, basis: EstimateBasis) -> Estimate | None:
        """Estimate a full stop of the net by a body at the start; None for bodies that touch each other."""
        if not (self.threads or self.nodes or self.bullets):
            return None
        mass, speed = float(basis.net.mass.sum()), basis.speed
        if self.threads:
            stiffness, exponent = self.of_threads * float(basis.net.reference_length.sum()), 1.0
        else:
            law = self.of_nodes if self.nodes else self.of_bullets
            stiffness, exponent = law.stiffness, law.exponent
        acceleration = _largest_force(stiffness, exponent, mass, speed) / mass
        return Estimate(acceleration, basis.held(speed * basis.duration), f"stopped from {speed:.3g} m/s")


class LinearContact(Contact):
    """A force in proportion to the penetration."""

    NEEDS: ClassVar = {
        "threads": ("stiffness",),
        "nodes": ("node_radius", "node_stiffness"),
        "bullets": ("bullet_radius", "bullet_stiffness"),
        "bodies": ("body_stiffness",),
    }

    law: Literal["linear"] = Field(description="a force in proportion to the penetration")
    stiffness: Positive | None = Field(
        None, description="K, force per length of thread and per depth [N/m2]; for threads", examples=[2e4]
    )
    node_stiffness: Positive | None = Field(
        None, description="k, force per depth [N/m]; for nodes", examples=[2e3]
    )
    bullet_stiffness: Positive | None = Field(
        None, description="k, force per depth [N/m]; for bullets", examples=[2e4]
    )
    body_stiffness: Positive | None = Field(
        None, description="k, force per depth of a ball or a corner [N/m]; for bodies", examples=[2e4]
    )

    @property
    def of_threads(self) -> float:
        """K [N/m2]."""
        assert self.stiffness is not None
        return self.stiffness

    @property
    def of_bodies(self) -> BodyLaw:
        """Law of corners, balls and edges."""
        assert self.body_stiffness is not None
        return BodyLaw(self.body_stiffness, 1.0, None, self.a)

    def _of_spheres(self, what: str) -> SphereLaw:
        stiffness: float = getattr(self, f"{what}_stiffness")
        return SphereLaw(stiffness, 1.0, self.a, stiffness)


class HertzContact(Contact):
    """Hertz's law."""

    NEEDS: ClassVar = {"nodes": ("node_radius",), "bullets": ("bullet_radius",)}

    law: Literal["hertz"] = Field(description="Hertz's law")
    modulus: Positive = Field(description="E*, effective modulus of both materials [Pa]", examples=[1e6])

    @property
    def of_threads(self) -> float:
        """K [N/m2]."""
        return hertz_of_line(self.modulus)

    @property
    def of_bodies(self) -> BodyLaw:
        """Law of corners, balls and edges."""
        return BodyLaw(hertz_of_sphere(self.modulus, 1.0), 1.5, hertz_of_line(self.modulus), self.a)

    def _of_spheres(self, what: str) -> SphereLaw:
        radius: float = getattr(self, f"{what}_radius")
        return SphereLaw(
            hertz_of_sphere(self.modulus, radius), 1.5, self.a, 4.0 / 3.0 * self.modulus * radius
        )


AnyContact = Annotated[LinearContact | HertzContact, Field(discriminator="law")]


def _largest_force(k: float, n: float, mass: float, speed: float) -> float:
    """Force k p^n [N] that stops a mass [kg] from a speed [m/s]: m v^2 / 2 = k p^(n + 1) / (n + 1)."""
    depth = (0.5 * (n + 1.0) * mass * speed**2 / k) ** (1.0 / (n + 1.0))
    return float(k * depth**n)
