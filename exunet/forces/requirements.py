"""What effects need of the rest of a case, and which of them contradict each other."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
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
    def is_carried(self) -> bool:
        """The net starts in axes that a body carries."""
        return bool(self.scene.initial.is_given("frame"))

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


# What the module of an effect may declare as data, for reader and JSON schema.


def excluded(module: ModuleType) -> Mapping[str, str]:
    """Names of effects that contradict this one, each with the reason."""
    return getattr(module, "EXCLUDES", {})


def required(module: ModuleType) -> Mapping[str, str]:
    """Names of effects that this one needs, each with the reason."""
    return getattr(module, "REQUIRES", {})


def zero_keys(module: ModuleType) -> Mapping[str, Mapping[str, str]]:
    """For names of other effects, keys that must be zero beside this one, each with the reason."""
    return getattr(module, "NEEDS_ZERO", {})


def needs_fresh_steps(module: ModuleType) -> bool:
    """True if no step may use the acceleration of the step before, which an event makes wrong."""
    return getattr(module, "NEEDS_FRESH_STEPS", False)


def bullet_keys(module: ModuleType) -> tuple[str, ...]:
    """Keys that are given if and only if the net has bullets."""
    return getattr(module, "BULLET_KEYS", ())


def needs_bullets(module: ModuleType) -> bool:
    """True if the effect acts on bullets only."""
    return getattr(module, "NEEDS_BULLETS", False)


def replaces_launch(module: ModuleType) -> bool:
    """True if the effect gives the bullets their speed, in place of [launch]."""
    return getattr(module, "REPLACES_LAUNCH", False)


def not_carried(module: ModuleType) -> Mapping[str, str]:
    """Keys that do not go with a net that a body carries, each with the reason."""
    return getattr(module, "NOT_CARRIED", {})


def why_not_with(what: str, module: ModuleType, keys: Record) -> str:
    """Why an effect cannot be where there are "reels", or a "perimeter"; "" if it can."""
    return str(getattr(module, f"not_with_{what}", lambda _: "")(keys))


def declared(module: ModuleType, name: str, rest: RestOfCase) -> Iterator[Fault]:
    """Faults of what the module of the effect `name` declares as data."""
    yield from _others(module, rest.scene.effects)
    for other, keys in zero_keys(module).items():
        for key, why in keys.items():
            yield from _zero(rest, other, key, why)
    yield from _fresh_steps(module, rest)
    yield from _bullets(module, rest)
    yield from _launch(module, rest)
    for key in bullet_keys(module):
        yield from _bullet_key(rest, name, key)
    for key, why in not_carried(module).items():
        yield from _carried(rest, name, key, why)
    yield from _reels(module, name, rest)
    yield from _perimeter(module, name, rest)


def _others(module: ModuleType, effects: Record) -> Iterator[Fault]:
    for other, reason in excluded(module).items():
        if effects.is_given(other):
            yield Fault("", f"contradicts effects.{other}: {reason}")
    for other, reason in required(module).items():
        if not effects.is_given(other):
            yield Fault("", f"needs [effects.{other}], {reason}")


def _zero(rest: RestOfCase, other: str, key: str, reason: str) -> Iterator[Fault]:
    keys = rest.effect(other)
    if keys is not None and getattr(keys, key) != 0.0:
        yield Fault("", f"contradicts effects.{other}.{key}, {reason}")


def _fresh_steps(module: ModuleType, rest: RestOfCase) -> Iterator[Fault]:
    method = rest.method
    if needs_fresh_steps(module) and method in METHODS and METHODS[Method(method)].remembers_acceleration:
        yield Fault("", f"needs an explicit Runge-Kutta method such as DOPRI5 or RK44, not {method}")


def _bullets(module: ModuleType, rest: RestOfCase) -> Iterator[Fault]:
    if needs_bullets(module) and not rest.has_bullets:
        yield Fault("", "acts on bullets, and the net has none: add [net.bullets] or remove this table")


def _launch(module: ModuleType, rest: RestOfCase) -> Iterator[Fault]:
    if replaces_launch(module) and rest.scene.is_given("launch"):
        yield Fault("", "contradicts [launch], which gives the bullets their speed already; keep one")


def _bullet_key(rest: RestOfCase, name: str, key: str) -> Iterator[Fault]:
    keys = rest.effect(name)
    if rest.has_bullets and not keys.is_given(key):
        yield Fault(key, "missing: required, since the net has bullets")
    if not rest.has_bullets and keys.is_given(key):
        yield Fault(key, "there are no bullets: add [net.bullets] or remove this key")


def _carried(rest: RestOfCase, name: str, key: str, reason: str) -> Iterator[Fault]:
    if rest.effect(name).is_given(key) and rest.is_carried:
        yield Fault(
            key, f"does not go with [initial.frame], by which a body carries the net, as it is {reason}"
        )


def _reels(module: ModuleType, name: str, rest: RestOfCase) -> Iterator[Fault]:
    if reason := why_not_with("reels", module, rest.effect(name)):
        yield from (Fault("", f"excludes tethers.{tether}.reel: {reason}") for tether in rest.reels)


def _perimeter(module: ModuleType, name: str, rest: RestOfCase) -> Iterator[Fault]:
    if (reason := why_not_with("perimeter", module, rest.effect(name))) and rest.has_perimeter:
        yield Fault("", f'excludes closing.kind = "perimeter": {reason}')
