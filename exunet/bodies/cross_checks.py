"""What the keys of a body demand of each other."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from exunet.base.errors import Fault
from exunet.base.faults import each, exactly_one, within
from exunet.bodies.keys import DIMENSIONS, EDGED, BodyKeys, PartKeys, Placed
from exunet.bodies.making import part_of, solid_of


def cross_checks(bodies: Mapping[str, BodyKeys]) -> Iterator[Fault]:
    """Every fault between keys of a body."""
    for name, keys in bodies.items():
        yield from within(name, _of_body(keys))


def _of_body(keys: BodyKeys) -> Iterator[Fault]:
    yield from each(
        exactly_one(keys),
        _turned_once(keys),
        _mass_of_something(keys),
        _about_inertia(keys),
        _shape_or_parts(keys),
        _dimensions(keys),
        _edges(keys),
    )
    for name, part in keys.parts.items():
        yield from within(f"parts.{name}", each(_turned_once(part), _dimensions(part)))


def _turned_once(keys: Placed) -> Iterator[Fault]:
    if keys.is_given("attitude") and keys.is_given("axis"):
        yield Fault("axis", "give either attitude, or axis and angle")
    for one, other in (("axis", "angle"), ("angle", "axis")):
        if keys.is_given(one) and not keys.is_given(other):
            yield Fault(one, f"needs {other}")


def _mass_of_something(keys: BodyKeys) -> Iterator[Fault]:
    has_shape = keys.is_given("shape") or bool(keys.parts)
    if keys.is_given("density") and not has_shape:
        yield Fault("density", "needs a shape, or parts: without them give mass and inertia")
    elif keys.is_given("density") and keys.is_given("inertia"):
        yield Fault("inertia", "follows from density and shape: give mass and inertia, or density")
    elif keys.is_given("mass") and not keys.is_given("inertia") and not has_shape:
        words = type(keys).model_fields["inertia"].description
        yield Fault("", f"missing inertia: {words}")


def _about_inertia(keys: BodyKeys) -> Iterator[Fault]:
    for name in ("products_of_inertia", "centre_of_mass"):
        if keys.is_given(name) and not keys.is_given("inertia"):
            yield Fault(name, "needs inertia: else it follows from the evenly filled shape")


def _shape_or_parts(keys: BodyKeys) -> Iterator[Fault]:
    if keys.is_given("shape") and keys.parts:
        yield Fault("parts", "give either shape or parts")


def _dimensions(keys: BodyKeys | PartKeys) -> Iterator[Fault]:
    """The dimensions of the shape and no others."""
    shape = keys.shape if keys.is_given("shape") else None
    own = DIMENSIONS[shape] if shape else ()
    for name in own:
        if not keys.is_given(name):
            yield Fault("", f"missing {name}: {type(keys).model_fields[name].description}")
    for name in sorted({name for names in DIMENSIONS.values() for name in names} - set(own)):
        if keys.is_given(name):
            yield Fault(name, f'is not for shape = "{shape}"' if shape else "needs a shape")
    if shape == "frustum" and keys.is_given("radii") and keys.radii == (0.0, 0.0):
        yield Fault("radii", "must not both be zero")


def _edges(keys: BodyKeys) -> Iterator[Fault]:
    """A rounding that the shape has edges for, and room."""
    if not keys.is_given("edge_radius") or keys.edge_radius is None:
        return
    if not keys.parts and (not keys.is_given("shape") or keys.shape not in EDGED):
        yield Fault("edge_radius", f"is for {', '.join(EDGED)}, and parts: what has edges")
        return
    if keys.shape == "mesh":
        return
    solids = [part_of(part) for part in keys.parts.values()] or [solid_of(keys)]
    least = min(solid.least for solid in solids)
    if keys.edge_radius > 0.5 * least:
        yield Fault("edge_radius", f"must not be more than half of the smallest dimension, {least:g} m")
