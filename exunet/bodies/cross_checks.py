"""What the keys of a body demand of each other."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import pairwise

from exunet.base.errors import Fault
from exunet.base.faults import each, exactly_one, shortened, told_apart, within
from exunet.bodies.keys import DIMENSIONS, EDGED, BodyKeys, PartKeys, Placed
from exunet.bodies.rigid import part_of, solid_of
from exunet.forces.requirements import RestOfCase
from exunet.methods.keys import SHORTEST_STEP

HALF_TURN = 1e-6  # [rad] by which attitudes of neighbouring poses must be less than half a turn apart


def cross_checks(bodies: Mapping[str, BodyKeys], rest: RestOfCase) -> Iterator[Fault]:
    """Every fault between keys of a body, and between names."""
    yield from told_apart(bodies)
    for name, keys in bodies.items():
        yield from within(name, _of_body(keys, rest))


def _of_body(keys: BodyKeys, rest: RestOfCase) -> Iterator[Fault]:
    yield from each(
        exactly_one(keys),
        turned_once(keys),
        _mass_of_something(keys),
        _about_inertia(keys),
        _shape_or_parts(keys),
        _dimensions(keys),
        _edges(keys),
        _grid(keys),
        _rests(keys),
        _poses_are_whole(keys),
        _poses_in_place_of_a_start(keys),
        shortened(_times_increase(keys)),
        shortened(_ways_are_defined(keys)),
        _poses_last(keys, rest),
        _attachments(keys),
        _parts(keys),
    )


def _attachments(keys: BodyKeys) -> Iterator[Fault]:
    for name, attachment in keys.attachments.items():
        yield from within(f"attachments.{name}", exactly_one(attachment))


def _parts(keys: BodyKeys) -> Iterator[Fault]:
    for name, part in keys.parts.items():
        yield from within(f"parts.{name}", each(turned_once(part), _dimensions(part)))


def turned_once(keys: Placed) -> Iterator[Fault]:
    """An attitude given in one way, and whole."""
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
    tables: list[BodyKeys | PartKeys] = [keys, *keys.parts.values()]
    if keys.shape == "mesh" or any(fault for one in tables for fault in _dimensions(one)):
        return
    solids = [part_of(part) for part in keys.parts.values()] or [solid_of(keys)]
    least = min(solid.least for solid in solids)
    if keys.edge_radius > 0.5 * least:
        yield Fault("edge_radius", f"must not be more than half of the smallest dimension, {least:g} m")


def _grid(keys: BodyKeys) -> Iterator[Fault]:
    """A grid for a mesh, fine enough for its rounded edges."""
    if not keys.is_given("grid_spacing") or keys.grid_spacing is None:
        return
    if not keys.is_given("shape") or keys.shape != "mesh":
        yield Fault("grid_spacing", 'is for shape = "mesh": distances from other shapes have a closed form')
    elif not keys.is_given("edge_radius"):
        yield Fault("grid_spacing", "needs edge_radius: it is for contact, which asks for rounded edges")
    elif keys.edge_radius is not None and keys.grid_spacing > 0.5 * keys.edge_radius:
        words = f"must not be more than half of edge_radius, {0.5 * keys.edge_radius:g} m"
        yield Fault("grid_spacing", words)


def _rests(keys: BodyKeys) -> Iterator[Fault]:
    for name in ("velocity", "angular_velocity"):
        if keys.motion == "fixed" and keys.is_given(name):
            yield Fault(name, 'is not for motion = "fixed": the body rests')


_POSES = ("pose_times", "pose_positions", "pose_attitudes")


def _poses_are_whole(keys: BodyKeys) -> Iterator[Fault]:
    """A table of a prescribed motion, a place and perhaps an attitude for each time."""
    given = [name for name in _POSES if keys.is_given(name)]
    if given and keys.motion != "prescribed":
        yield Fault(given[0], f'is for motion = "prescribed", not "{keys.motion}"')
        return
    for name in _POSES[:2]:
        if given and name not in given:
            yield Fault(given[0], f"needs {name}")
    for name in given[1:] if "pose_times" in given else ():
        times, values = keys.pose_times, getattr(keys, name)
        if len(values) != len(times or ()):
            yield Fault(name, f"has {len(values)} entries for {len(times or ())} times")


def _poses_in_place_of_a_start(keys: BodyKeys) -> Iterator[Fault]:
    if not keys.is_given("pose_times"):
        return
    names = ["position", "velocity", "angular_velocity"]
    names += ["attitude", "axis"] if keys.is_given("pose_attitudes") else []
    for name in names:
        if keys.is_given(name):
            yield Fault(name, "follows from the poses: give either, not both")


def _times_increase(keys: BodyKeys) -> Iterator[Fault]:
    times = keys.pose_times or () if keys.is_given("pose_times") else ()
    for k, (before, time) in enumerate(pairwise(times), start=1):
        if before is None or time is None:
            continue
        if time <= before:
            reason = f"must be greater than the time before it, {before:g} s, got {time:g}"
            yield Fault(f"pose_times[{k}]", reason)
        elif time - before < SHORTEST_STEP:
            reason = (
                f"is {time - before:.2g} s after the time before it: a run has steps of {SHORTEST_STEP:g} s"
            )
            yield Fault(f"pose_times[{k}]", f"{reason} or more")


def _ways_are_defined(keys: BodyKeys) -> Iterator[Fault]:
    """No half turn from one attitude to the next: neither way round is the shorter one."""
    attitudes = keys.pose_attitudes or () if keys.is_given("pose_attitudes") else ()
    for k, (before, attitude) in enumerate(pairwise(attitudes), start=1):
        if before is None or attitude is None:
            continue
        if 2.0 * abs(sum(a * b for a, b in zip(before, attitude, strict=True))) < HALF_TURN:
            reason = (
                f"is half a turn from the attitude before it, to {HALF_TURN:g} rad: neither way round is the "
                "shorter one; put a pose between them"
            )
            yield Fault(f"pose_attitudes[{k}]", reason)


def _poses_last(keys: BodyKeys, rest: RestOfCase) -> Iterator[Fault]:
    """Poses from the start to the end."""
    if not keys.is_given("pose_times") or not keys.pose_times:
        return
    first, last = keys.pose_times[0], keys.pose_times[-1]
    if first is not None and first > 0.0:
        yield Fault("pose_times[0]", f"must not be after 0, got {first:g}")
    if last is not None and last < rest.duration:
        where = f"pose_times[{len(keys.pose_times) - 1}]"
        yield Fault(where, f"must not be before time.end, {rest.duration:g} s, got {last:g}")
