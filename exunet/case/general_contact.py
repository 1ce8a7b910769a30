"""What of a case the engine's own GeneralContact cannot do, or does otherwise than exunet's contact."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from exunet.base.errors import Fault
from exunet.base.faults import each, within
from exunet.methods.method import ContactForm, TimeLoop

_ADVICE = 'or give engine.contact = "own"'


def cross_checks(scene: Any) -> Iterator[Fault]:
    """Faults of a scene with `engine.contact = "general"`, each at the key that is to be changed."""
    if scene.engine.contact != ContactForm.GENERAL:
        return
    if not scene.effects.is_given("contact"):
        words = f'needs [effects.contact]: nothing touches here. Remove "general", {_ADVICE}'
        yield Fault("engine.contact", words)
        return
    yield from each(_loop(scene), _frame(scene))
    contact = scene.effects.contact
    if contact is not None:
        own = (_law(contact), _what(contact), _pairs(contact), _rubs(contact))
        yield from within("effects.contact", each(*own))
        yield from each(
            *(_touched(scene, name) for name in dict.fromkeys((*contact.nodes, *contact.bullets)))
        )


def _loop(scene: Any) -> Iterator[Fault]:
    if scene.engine.loop != TimeLoop.EXUDYN:
        words = f'"general" is Exudyn\'s own contact: it needs engine.loop = "exudyn", {_ADVICE}'
        yield Fault("engine.contact", words, against=("engine.loop",))


def _frame(scene: Any) -> Iterator[Fault]:
    if scene.initial.is_given("frame"):
        words = f'"general" does not know a net that a body carries: remove [initial.frame], {_ADVICE}'
        yield Fault("engine.contact", words, against=("initial.frame",))


def _law(contact: Any) -> Iterator[Fault]:
    if contact.law != "linear":
        words = 'engine.contact = "general" has a force in proportion to the depth: give law = "linear"'
        yield Fault("law", f"{words}, {_ADVICE}")
    damped = contact.is_given("damping") and contact.damping
    bounces = (
        contact.is_given("restitution") and contact.restitution is not None and contact.restitution < 1.0
    )
    if damped or bounces:
        words = (
            'engine.contact = "general" has a dashpot that pulls back what leaves, not the law of Hunt and '
            f"Crossley, and tells no work: give damping = 0.0, {_ADVICE}"
        )
        yield Fault("damping" if damped else "restitution", words)


def _what(contact: Any) -> Iterator[Fault]:
    if contact.threads:
        words = 'engine.contact = "general" knows spheres, no threads: name the bodies in nodes, with '
        yield Fault("threads", f"{words}node_radius and node_stiffness, {_ADVICE}")


def _pairs(contact: Any) -> Iterator[Fault]:
    if contact.bodies:
        words = 'engine.contact = "general" lets points touch bodies, not bodies each other: remove this key'
        yield Fault("bodies", f"{words}, {_ADVICE}")


def _rubs(contact: Any) -> Iterator[Fault]:
    if contact.friction > 0.0:
        words = 'engine.contact = "general" has no friction that holds or tells its work: give friction = 0.0'
        yield Fault("friction", f"{words}, {_ADVICE}")


def _touched(scene: Any, name: str) -> Iterator[Fault]:
    body = scene.bodies.get(name)
    if body is None:
        return
    if not body.is_given("shape") or body.shape != "sphere":
        words = (
            f'engine.contact = "general" touches spheres only, as it counts what is near an edge twice: '
            f'give {name} shape = "sphere", {_ADVICE}'
        )
        yield Fault(f"bodies.{name}.shape" if body.is_given("shape") else f"bodies.{name}", words)
    if body.motion != "free":
        words = (
            'engine.contact = "general" does not tell what it gives to a body whose motion is given: '
            f'give motion = "free", {_ADVICE}'
        )
        yield Fault(f"bodies.{name}.motion", words)
