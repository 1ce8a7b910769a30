"""Which bodies can be touched, by the keys of `[effects.contact]` that name them."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from exunet.base.errors import Fault
from exunet.forces.requirements import RestOfCase

_PRESSING = ("sphere", "box", "capsule")  # solids that press into other bodies


def named(keys: Any, rest: RestOfCase, key: str) -> Iterator[Fault]:
    """Of the bodies that `key` names."""
    names = getattr(keys, key)
    for k, name in enumerate(names):
        place = f"{key}[{k}]"
        if name not in rest.bodies:
            yield _not_there(name, rest, place)
        elif name in names[:k]:
            yield Fault(place, f"{name} is named twice")
        else:
            yield from _touchable(rest.scene.bodies[name], name, place)


def _not_there(name: str, rest: RestOfCase, place: str) -> Fault:
    there = ", ".join(rest.bodies) or "none"
    return Fault(place, f"unknown body {name!r} (bodies: {there})")


def paired(keys: Any, rest: RestOfCase) -> Iterator[Fault]:
    """Of the pairs of bodies."""
    seen = set()
    for k, pair in enumerate(keys.bodies):
        one, other = pair
        place = f"bodies[{k}]"
        missing = [name for name in dict.fromkeys(pair) if name not in rest.bodies]
        for name in missing:
            yield _not_there(name, rest, f"{place}[{pair.index(name)}]")
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
    """Of a body, or of its parts."""
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
