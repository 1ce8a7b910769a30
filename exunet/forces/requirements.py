"""What effects need of the rest of a case, and which of them contradict each other."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from types import ModuleType
from typing import Any

from exunet.base.errors import Fault
from exunet.base.record import Record
from exunet.methods.method import METHODS, Method


@dataclass(frozen=True)
class RestOfCase:
    """The valid scene that keys of an effect are checked against."""

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

    @property
    def reels(self) -> tuple[str, ...]:
        """Names of the tethers that are on reels."""
        tethers = self.scene.tethers.items()
        return tuple(name for name, keys in tethers if keys.reel is not None)

    @property
    def has_perimeter(self) -> bool:
        """Threads of the net's edge become shorter."""
        closing = self.scene.closing
        return closing is not None and closing.kind == "perimeter"

    @property
    def method(self) -> str:
        """solver.method."""
        return str(self.scene.solver.method)

    def effect(self, name: str) -> Any:
        """The keys of another effect; None if it is off."""
        return getattr(self.scene.effects, name)


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


def declared(module: ModuleType, name: str, rest: RestOfCase) -> Iterator[Fault]:
    """Yield the faults of what the module of an effect declares as data (see `exunet.forces.effects`)."""
    keys, effects = rest.effect(name), rest.scene.effects
    for other, reason in getattr(module, "EXCLUDES", {}).items():
        if effects.is_given(other):
            yield Fault("", f"contradicts effects.{other}: {reason}")
    for other, reason in getattr(module, "REQUIRES", {}).items():
        if not effects.is_given(other):
            yield Fault("", f"needs [effects.{other}], {reason}")
    for other, reasons in getattr(module, "NEEDS_ZERO", {}).items():
        for key, reason in reasons.items():
            if rest.effect(other) is not None and getattr(rest.effect(other), key) != 0.0:
                yield Fault("", f"contradicts effects.{other}.{key}, {reason}")
    remembers = rest.method in METHODS and METHODS[Method(rest.method)].remembers_acceleration
    if remembers and getattr(module, "NEEDS_FRESH_STEPS", False):
        yield Fault("", f"needs an explicit Runge-Kutta method such as DOPRI5 or RK44, not {rest.method}")
    if getattr(module, "NEEDS_BULLETS", False) and not rest.has_bullets:
        yield Fault("", "acts on bullets, and the net has none: add [net.bullets] or remove this table")
    if replaces_launch(module) and rest.scene.is_given("launch"):
        yield Fault("", "contradicts [launch], which gives the bullets their speed already; keep one")
    for key in getattr(module, "BULLET_KEYS", ()):
        if rest.has_bullets and not keys.is_given(key):
            yield Fault(key, "missing: required, since the net has bullets")
        if not rest.has_bullets and keys.is_given(key):
            yield Fault(key, "there are no bullets: add [net.bullets] or remove this key")
    for key, reason in getattr(module, "NOT_CARRIED", {}).items():
        if keys.is_given(key) and bool(rest.scene.initial.is_given("frame")):
            words = f"excludes [initial.frame], by which a body carries the net, as it is {reason}"
            yield Fault(key, words)
    if rest.reels and (reason := why_not_with("reels", module, keys)):
        yield from (Fault("", f"excludes tethers.{tether}.reel: {reason}") for tether in rest.reels)
    if rest.has_perimeter and (reason := why_not_with("perimeter", module, keys)):
        yield Fault("", f'excludes closing.kind = "perimeter": {reason}')


def replaces_launch(module: ModuleType) -> bool:
    """Return True if the effect gives the bullets their speed, in place of [launch]."""
    return getattr(module, "REPLACES_LAUNCH", False)


def why_not_with(what: str, module: ModuleType, keys: Record) -> str:
    """Return why an effect excludes "reels" or a "perimeter"; "" if it does not."""
    return str(getattr(module, f"not_with_{what}", lambda _: "")(keys))
