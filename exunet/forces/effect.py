"""Base class of the effects, with the checks of what they need of the rest of a case."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

from exunet.base.errors import Fault
from exunet.base.record import Record
from exunet.forces.blocks import Blocks, FirstOrder
from exunet.forces.estimate import Estimate, EstimateBasis
from exunet.forces.total import Contribution
from exunet.methods.method import METHODS, Method
from exunet.net.arrays import Floats, Net


class Effect(Record):
    """Table of an effect: keys, units and bounds; no default for a physical quantity.

    A subclass defines `terms` and `magnitude`, and overrides what differs from the defaults below. Its own
    keys are checked against each other in `faults`, against other tables in `cross_checks`. Its energy is
    that of its terms: a potential, or work that is integrated along the run.
    """

    EXCLUDES: ClassVar[Mapping[str, str]] = {}  # other effects that it contradicts, with the reasons
    REQUIRES: ClassVar[Mapping[str, str]] = {}  # other effects that it needs, with the reasons
    NOT_WITH: ClassVar[Mapping[str, str]] = {}  # why it excludes "reels", or a "perimeter" that shortens
    NEEDS_FRESH_STEPS: ClassVar[bool] = False  # no method that uses the acceleration of the step before
    NEEDS_BULLETS: ClassVar[bool] = False  # it acts on bullets only
    BULLET_KEYS: ClassVar[tuple[str, ...]] = ()  # keys that are given if and only if there are bullets
    REPLACES_LAUNCH: ClassVar[bool] = False  # it gives the bullets their speed, in place of [launch]
    ON_THE_NET_ALONE: ClassVar[bool] = False  # it would act on rigid bodies too, but does on the net only
    ACCELERATES_ALL: ClassVar[bool] = False  # it accelerates any mass alike
    INTERNAL: ClassVar[bool] = False  # no momentum from outside of the scene: no line in its balance
    COLLIDES: ClassVar[bool] = False  # things touch: costs and stiff forces only while they do
    ON_THE_GROUND: ClassVar[bool] = False  # it belongs to tests on the ground
    NUMERICAL: ClassVar[bool] = False  # it is numerical damping, which is never advised
    PUTS_IN: ClassVar[str] = ""  # source of the energy that forces without a potential may put in

    @abstractmethod
    def terms(self, blocks: Blocks) -> tuple[Contribution, ...]:
        """Return what it adds to the equations of motion; nothing where a coefficient is zero."""

    @abstractmethod
    def magnitude(self, basis: EstimateBasis) -> Estimate | None:
        """Estimate the order of magnitude of what leaving it out would change; None without an estimate."""

    @classmethod
    def nominal(cls, basis: EstimateBasis) -> tuple[Effect, str] | None:
        """Return what to assume if the case does not have it, in words too; None without an assumption."""
        return None

    def cross_checks(self, rest: RestOfCase) -> Iterator[Fault]:
        """Yield the contradictions with other tables of a valid scene; keys are relative to this table."""
        yield from ()

    def first_order_states(self) -> tuple[FirstOrder, ...]:
        """Return its first-order states."""
        return ()

    def touched_bodies(self) -> frozenset[str]:
        """Return the names of the rigid bodies whose surfaces its terms need (`Blocks.surfaces`)."""
        return frozenset()

    def touching_pairs(self) -> tuple[tuple[str, str], ...]:
        """Return the pairs of names of the bodies that touch each other."""
        return ()

    def largest_radius(self, net: Net) -> float:
        """Return the largest radius of threads, nodes and bullets that touch bodies [m]."""
        return 0.0

    def breaking_limits(self, net: Net, free_strain: float) -> Floats | None:
        """Return the axial force at which each element breaks, (n_elements,) [N]; None if none does."""
        return None

    @property
    def free_strain(self) -> float:
        """Green-Lagrange strain of the free length of all cables."""
        return 0.0

    def not_with(self) -> Mapping[str, str]:
        """Return the reasons why it excludes "reels" or a "perimeter", with these keys."""
        return self.NOT_WITH

    def contradictions(self, rest: RestOfCase) -> Iterator[Fault]:
        """Yield the faults of what the class declares, then those of `cross_checks`."""
        effects = rest.scene.effects
        for other, reason in self.EXCLUDES.items():
            if effects.is_given(other):
                yield Fault("", f"contradicts effects.{other}: {reason}")
        for other, reason in self.REQUIRES.items():
            if not effects.is_given(other):
                yield Fault("", f"needs [effects.{other}], {reason}")
        method = str(rest.scene.solver.method)
        remembers = method in METHODS and METHODS[Method(method)].remembers_acceleration
        if remembers and self.NEEDS_FRESH_STEPS:
            yield Fault("", f"needs an explicit Runge-Kutta method such as DOPRI5 or RK44, not {method}")
        if self.NEEDS_BULLETS and not rest.has_bullets:
            yield Fault("", "acts on bullets, and the net has none: add [net.bullets] or remove this table")
        if self.REPLACES_LAUNCH and rest.scene.is_given("launch"):
            yield Fault("", "contradicts [launch], which gives the bullets their speed already; keep one")
        for key in self.BULLET_KEYS:
            if rest.has_bullets and not self.is_given(key):
                yield Fault(key, "missing: required, since the net has bullets")
            if not rest.has_bullets and self.is_given(key):
                yield Fault(key, "there are no bullets: add [net.bullets] or remove this key")
        excluded, closing = self.not_with(), rest.scene.closing
        for tether, keys in rest.scene.tethers.items():
            if keys.reel is not None and "reels" in excluded:
                yield Fault("", f"excludes tethers.{tether}.reel: {excluded['reels']}")
        if closing is not None and closing.kind == "perimeter" and "perimeter" in excluded:
            yield Fault("", f'excludes closing.kind = "perimeter": {excluded["perimeter"]}')
        yield from self.cross_checks(rest)


@dataclass(frozen=True)
class RestOfCase:
    """Valid scene that the keys of an effect are checked against."""

    scene: Any

    @property
    def n_bullets(self) -> int:
        """Bullets of the net, one a corner; 0 without [net.bullets]."""
        net = self.scene.net
        return int(net.n_corners) if self.has_bullets else 0

    @property
    def has_bullets(self) -> bool:
        """The net has bullets."""
        return getattr(self.scene.net, "bullets", None) is not None

    @property
    def duration(self) -> float:
        """time.end [s]."""
        return float(self.scene.time.end)

    @property
    def bodies(self) -> tuple[str, ...]:
        """Names of the rigid bodies."""
        return tuple(self.scene.bodies)


def existing_bullets(bullets: Sequence[int], rest: RestOfCase) -> Iterator[Fault]:
    """Yield the numbers of a key `bullets` that the net does not have."""
    number = rest.n_bullets
    for k, bullet in enumerate(bullets):
        if number and bullet >= number:
            words = f"there is no bullet {bullet}: the {number} bullets are numbered from 0 to {number - 1}"
            yield Fault(f"bullets[{k}]", words)


def existing_body(key: str, name: str | None, rest: RestOfCase) -> Iterator[Fault]:
    """Require that the body a key names exists."""
    if name is not None and name not in rest.bodies:
        yield Fault(key, f'unknown body "{name}" (bodies: {", ".join(rest.bodies) or "none"})')
