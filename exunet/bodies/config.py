"""The keys of [bodies.NAME]: a rigid body's shape, mass and inertia, and its state at time 0."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import replace
from itertools import pairwise
from typing import Annotated, ClassVar, Literal

from pydantic import AfterValidator, Field, StringConstraints

from exunet.base.errors import Fault
from exunet.base.record import (
    FromArray,
    NonNegative,
    Positive,
    Record,
    Vector,
    distinct,
    increasing,
    shortened,
)
from exunet.bodies.shapes import ShapeName, Solid, SolidName
from exunet.methods.config import SHORTEST_STEP
from exunet.net.base import NodeConfig


def _of_some_length(attitude: tuple[float, float, float, float]) -> tuple[float, float, float, float]:
    if not any(attitude):
        raise ValueError("must not be zero: [1, 0, 0, 0] leaves the body's axes along the scene's")
    return attitude


def _of_some_direction(axis: tuple[float, float, float]) -> tuple[float, float, float]:
    if not any(axis):
        raise ValueError("must not be zero")
    return axis


def _of_some_distribution(moments: tuple[float, float, float]) -> tuple[float, float, float]:
    if words := impossible(*moments):
        raise ValueError(words)
    return moments


def unit_quaternion(attitude: tuple[float, float, float, float]) -> tuple[float, float, float, float]:
    """An attitude brought to length 1; raises ValueError if it is zero."""
    largest = max(map(abs, _of_some_length(attitude)))
    w, x, y, z = (part / largest for part in attitude)  # so that no square overflows or vanishes
    length = math.hypot(w, x, y, z)
    return (w / length, x / length, y / length, z / length)


Quaternion = Annotated[tuple[float, float, float, float], FromArray, AfterValidator(_of_some_length)]
Moments = Annotated[tuple[Positive, Positive, Positive], FromArray, AfterValidator(_of_some_distribution)]
Edges = Annotated[tuple[Positive, Positive, Positive], FromArray]
Radii = Annotated[tuple[NonNegative, NonNegative], FromArray]
Times = Annotated[tuple[float, ...], FromArray]
Places = Annotated[tuple[Vector, ...], FromArray]
Quaternions = Annotated[tuple[Quaternion, ...], FromArray]
Name = Annotated[str, StringConstraints(pattern=r"^[A-Za-z0-9_-]+$")]
HALF_TURN = 1e-6  # [rad] by which attitudes of neighbouring poses must be less than half a turn apart
ROUND_OFF = 1e-12  # by which a principal moment may exceed the sum of the others, relative to it

# The keys that a shape has, and no other shape.
DIMENSIONS: dict[str, tuple[str, ...]] = {
    "box": ("size",),
    "cylinder": ("radius", "length"),
    "sphere": ("radius",),
    "capsule": ("radius", "length"),
    "frustum": ("radii", "length"),
    "mesh": ("file", "unit"),
}
EDGED = ("box", "cylinder", "frustum", "mesh")  # the shapes with edges, which may be rounded

_POSES = ("pose_times", "pose_positions", "pose_attitudes")
_STARTS = ("position", "velocity", "angular_velocity")


class Placed(Record):
    """Where something is, and how it is turned."""

    position: Vector = Field((0.0, 0.0, 0.0), description="of its origin [m]")
    attitude: Quaternion = Field(
        (1.0, 0.0, 0.0, 0.0),
        description="quaternion [w, x, y, z] that turns its axes; brought to length 1",
    )
    axis: Annotated[Vector, AfterValidator(_of_some_direction)] | None = Field(
        None,
        description="instead of attitude, with angle: axis of rotation, not zero",
        examples=[[0.0, 0.0, 1.0]],
    )
    angle: float | None = Field(None, description="rotation about axis [rad]", examples=[0.5])

    def faults(self) -> Iterator[Fault]:
        """Require one way to give the attitude, and all of its keys."""
        if self.is_given("attitude") and self.axis is not None:
            yield Fault("axis", "excludes attitude: give either attitude, or axis and angle")
        for one, other in (("axis", "angle"), ("angle", "axis")):
            if self.is_given(one) and not self.is_given(other):
                yield Fault(one, f"requires {other}")

    @property
    def quaternion(self) -> tuple[float, float, float, float]:
        """Return the attitude as a unit quaternion, from `attitude` or from `axis` and `angle`."""
        if self.axis is None or self.angle is None:
            return unit_quaternion(self.attitude)
        _, *axis = unit_quaternion((0.0, *self.axis))
        x, y, z = (math.sin(0.5 * self.angle) * part for part in axis)
        return (math.cos(0.5 * self.angle), x, y, z)


class Dimensions(Record):
    """Dimensions of a solid; its shape determines which of them it has."""

    size: Edges | None = Field(None, description="box: edges along x, y, z [m]", examples=[[1.0, 1.0, 2.0]])
    radius: Positive | None = Field(
        None, description="cylinder, sphere, capsule: radius [m]; axis along z", examples=[0.5]
    )
    length: Positive | None = Field(
        None,
        description="cylinder, frustum: length along z; capsule: between the centres of its half-spheres [m]",
        examples=[2.0],
    )
    radii: Radii | None = Field(
        None,
        description="frustum: radii at z = -length/2 and length/2 [m], not both zero",
        examples=[[0.5, 0.3]],
    )

    @property
    def solid(self) -> Solid:
        """The solid of these dimensions about the origin."""
        shape = getattr(self, "shape", None)
        assert shape is not None
        assert shape != "mesh"
        if self.size is not None:
            return Solid(shape, self.size)
        if self.radii is not None and self.length is not None:
            return Solid(shape, (*self.radii, self.length))
        assert self.radius is not None
        return Solid(shape, (self.radius, self.length or 0.0, 0.0))

    def faults_of_dimensions(self, shape: str | None) -> Iterator[Fault]:
        """Require the dimensions of the shape, and no others."""
        own = DIMENSIONS[shape] if shape else ()
        for name in own:
            if not self.is_given(name):
                yield Fault(name, f"missing: {type(self).model_fields[name].description}")
        for name in sorted({name for names in DIMENSIONS.values() for name in names} - set(own)):
            if name in type(self).model_fields and self.is_given(name):
                yield Fault(name, f'is not for shape = "{shape}"' if shape else "requires a shape")
        if shape == "frustum" and self.radii == (0.0, 0.0):
            yield Fault("radii", "must not both be zero")


class Part(Placed, Dimensions):
    """A solid that is part of a body."""

    shape: SolidName = Field(description="shape of the part")
    position: Vector = Field((0.0, 0.0, 0.0), description="of the part's origin in the body's frame [m]")
    attitude: Quaternion = Field(
        (1.0, 0.0, 0.0, 0.0),
        description="quaternion [w, x, y, z] that turns the part's axes into the body's; brought to length 1",
    )

    def faults(self) -> Iterator[Fault]:
        """Require one attitude, and the dimensions of the shape."""
        yield from super().faults()
        yield from self.faults_of_dimensions(self.shape)

    @property
    def placed_solid(self) -> Solid:
        """The solid where it is in the body's frame."""
        return replace(self.solid, position=self.position, attitude=self.quaternion)


class Attachment(NodeConfig):
    """A node of the net that is fixed to a point of a body."""

    point: Vector = Field(description="point of the body, in its frame [m]", examples=[[0.5, 0.0, 0.0]])


class BodyThrust(Record):
    """Force and torque on a body over time, such as of its engines."""

    times: Annotated[tuple[NonNegative, ...], FromArray] | None = Field(
        None,
        min_length=2,
        description="times [s], increasing; the thrust is zero before the first and after the last. Without "
        "them, entries of a script thrust alone",
        examples=[[0.0, 2.0]],
    )
    force: Places | None = Field(
        None,
        description="force at each of these times [N], linear in between",
        examples=[[[0.0, 0.0, 10.0], [0.0, 0.0, 10.0]]],
    )
    torque: Places | None = Field(
        None,
        description="torque beside that of the force at each of these times [N m], linear in between",
        examples=[[[0.0, 0.0, 0.1], [0.0, 0.0, 0.0]]],
    )
    axes: Literal["body", "scene"] = Field(
        "body", description="axes in which force and torque are given, also those of a script"
    )
    point: Vector = Field(
        (0.0, 0.0, 0.0), description="point of application of the force, in the body's frame [m]"
    )

    def faults(self) -> Iterator[Fault]:
        """Require times with a force or a torque, and a vector for each."""
        yield from increasing("times", self.times or ())
        if self.times is not None and self.force is None and self.torque is None:
            yield Fault("times", "requires force or torque")
        for name in ("force", "torque"):
            values = getattr(self, name)
            if values is not None and self.times is None:
                yield Fault(name, "requires times")
            elif values is not None and len(values) != len(self.times or ()):
                words = f"requires a vector for each of the {len(self.times or ())} times, got {len(values)}"
                yield Fault(name, words)


class Body(Placed, Dimensions):
    """A rigid body with its shape, mass and inertia, its state at time 0 and its motion."""

    # Its frame is that in which its shape is drawn; without a shape its origin is the centre of mass.

    EXACTLY_ONE: ClassVar = ("mass", "density")

    mass: Positive | None = Field(None, description="mass of the body [kg]", examples=[500.0])
    density: Positive | None = Field(
        None,
        description="density with which the shape, or all parts, are filled evenly, instead of mass [kg/m3]",
        examples=[100.0],
    )
    inertia: Moments | None = Field(
        None,
        description="moments of inertia Ixx, Iyy, Izz about the centre of mass, along the axes of the body's "
        "frame [kg m2], none above the sum of the others; without it shape or parts are filled evenly",
        examples=[[80.0, 100.0, 120.0]],
    )
    products_of_inertia: Vector | None = Field(
        None,
        description="elements Ixy, Ixz, Iyz of the matrix of inertia, such as Ixy = -(integral of x y dm), "
        "beside inertia [kg m2]; default 0",
        examples=[[1.0, 0.0, -2.0]],
    )
    centre_of_mass: Vector | None = Field(
        None,
        description="in the body's frame, beside inertia [m]; else that of the evenly filled shape, or the "
        "origin without a shape",
        examples=[[0.0, 0.0, 0.1]],
    )
    shape: ShapeName | None = Field(
        None, description="shape of the body: a solid centred at the origin of its frame, or a mesh"
    )
    file: str | None = Field(
        None,
        description="mesh: STL, OBJ or GLB file, relative to the folder of the case; a closed surface",
        examples=["target.stl"],
    )
    unit: Literal["m", "cm", "mm", "inch"] | None = Field(
        None, description="mesh: unit of the lengths in the file", examples=["mm"]
    )
    edge_radius: NonNegative | None = Field(
        None,
        description="by which edges and corners are rounded for contact, inside the shape [m]; "
        "at most half of the smallest dimension. Mass and inertia are those of the sharp shape",
        examples=[0.01],
    )
    grid_spacing: Positive | None = Field(
        None,
        description="mesh: length of the pieces of threads in contact, and spacing of the grid on which the "
        "distance is sampled where the mesh is not convex [m], at most half of edge_radius; default: a "
        "quarter of it",
        examples=[0.0025],
    )
    position: Vector = Field((0.0, 0.0, 0.0), description="of the origin of the body's frame at time 0 [m]")
    velocity: Vector = Field((0.0, 0.0, 0.0), description="of the centre of mass at time 0 [m/s]")
    attitude: Quaternion = Field(
        (1.0, 0.0, 0.0, 0.0),
        description="at time 0, quaternion [w, x, y, z] that turns the body's axes into the scene's; "
        "brought to length 1",
    )
    angular_velocity: Vector = Field(
        (0.0, 0.0, 0.0),
        description="at time 0, in the axes of angular_velocity_frame [rad/s]",
        examples=[[0.0, 0.0, 0.1]],
    )
    angular_velocity_frame: Literal["body", "scene"] = Field(
        "body", description="axes in which angular_velocity is given"
    )
    motion: Literal["free", "fixed", "prescribed", "port"] = Field(
        "free",
        description="free: forces move it; fixed: it rests; prescribed: it goes through the poses of a "
        "table, or without one keeps its velocity and angular velocity; port: a host that exunet is "
        "coupled to moves it",
    )
    pose_times: Times | None = Field(
        None,
        min_length=2,
        description="times of the poses of a prescribed motion [s]: at least two, increasing, from 0 "
        "or before to "
        "time.end or later",
        examples=[[0.0, 2.0]],
    )
    pose_positions: Places | None = Field(
        None,
        description="of the origin of the body's frame, one for each of pose_times [m]",
        examples=[[[0.0, 0.0, 0.0], [0.0, 0.0, 0.3]]],
    )
    pose_attitudes: Quaternions | None = Field(
        None,
        description="quaternions [w, x, y, z] like attitude, one for each of pose_times, neighbours "
        "less than "
        "half a turn apart (by 1e-6 rad); without it the attitude is constant",
        examples=[[[1.0, 0.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.3]]],
    )
    thrust: BodyThrust | None = Field(None, description="force and torque on the body over time")
    attachments: Mapping[Name, Attachment] = Field(
        {},
        description="nodes of the net that are fixed to the body",
        json_schema_extra={"additionalProperties": False},
    )
    parts: Mapping[Name, Part] = Field(
        {},
        description="instead of shape: solids that together are the body; volumes that they share count once "
        "for each",
        json_schema_extra={"additionalProperties": False},
    )

    def faults(self) -> Iterator[Fault]:
        """Require one shape, mass and inertia of it, and one motion."""
        yield from super().faults()
        yield from self._faults_of_mass()
        if self.shape is not None and self.parts:
            yield Fault("parts", "excludes shape: give either shape or parts")
        wrong = list(self.faults_of_dimensions(self.shape))
        yield from wrong
        if not wrong:
            yield from self._faults_of_edges()
        for name in ("velocity", "angular_velocity"):
            if self.motion == "fixed" and self.is_given(name):
                yield Fault(name, 'is not for motion = "fixed": the body rests')
        if self.thrust is not None and self.motion != "free":
            yield Fault("thrust", f'requires motion = "free", not "{self.motion}"')
        yield from self._faults_of_poses()
        yield from shortened(self._faults_of_pose_times())
        yield from shortened(self._half_turns())

    def _faults_of_mass(self) -> Iterator[Fault]:
        has_shape = self.shape is not None or bool(self.parts)
        if self.density is not None and not has_shape:
            yield Fault("density", "requires shape or parts: without them give mass and inertia")
        elif self.density is not None and self.inertia is not None:
            yield Fault("inertia", "follows from density and shape: give mass and inertia, or density")
        elif self.mass is not None and self.inertia is None and not has_shape:
            yield Fault("inertia", f"missing: {type(self).model_fields['inertia'].description}")
        for name in ("products_of_inertia", "centre_of_mass"):
            if self.is_given(name) and self.inertia is None:
                yield Fault(name, "requires inertia: else it follows from the evenly filled shape")

    def _faults_of_edges(self) -> Iterator[Fault]:
        rounding, spacing = self.edge_radius, self.grid_spacing
        if rounding is not None and not self.parts and self.shape not in EDGED:
            yield Fault("edge_radius", f"is for {', '.join(EDGED)}, and parts: what has edges")
        elif rounding is not None and self.shape != "mesh":
            solids = [part.solid for part in self.parts.values()] or [self.solid]
            least = min(solid.least for solid in solids)
            if rounding > 0.5 * least:
                yield Fault("edge_radius", f"must not be above half of the smallest dimension, {least:g} m")
        if spacing is None:
            return
        if self.shape != "mesh":
            words = 'is for shape = "mesh": distances from other shapes have a closed form'
            yield Fault("grid_spacing", words)
        elif rounding is None:
            yield Fault("grid_spacing", "requires edge_radius: it is for contact, which needs rounded edges")
        elif spacing > 0.5 * rounding:
            yield Fault("grid_spacing", f"must not be above half of edge_radius, {0.5 * rounding:g} m")

    def _faults_of_poses(self) -> Iterator[Fault]:
        given = [name for name in _POSES if self.is_given(name)]
        if given and self.motion != "prescribed":
            yield Fault(given[0], f'is for motion = "prescribed", not "{self.motion}"')
            return
        for name in _POSES[:2]:
            if given and name not in given:
                yield Fault(given[0], f"requires {name}")
        for name in given[1:] if self.pose_times is not None else ():
            times, values = self.pose_times, getattr(self, name)
            if len(values) != len(times or ()):
                yield Fault(name, f"has {len(values)} entries for {len(times or ())} times")
        if self.pose_times is None:
            return
        for name in (*_STARTS, *(("attitude", "axis") if self.pose_attitudes is not None else ())):
            if self.is_given(name):
                yield Fault(name, "follows from the poses: give either, not both")

    def _faults_of_pose_times(self) -> Iterator[Fault]:
        for k, (before, time) in enumerate(pairwise(self.pose_times or ()), start=1):
            if time <= before:
                reason = f"must be greater than the time before it, {before:g} s, got {time:g}"
                yield Fault(f"pose_times[{k}]", reason)
            elif time - before < SHORTEST_STEP:
                reason = f"is {time - before:.2g} s after the time before it: a run has steps of "
                yield Fault(f"pose_times[{k}]", f"{reason}{SHORTEST_STEP:g} s or more")
        if self.pose_times and self.pose_times[0] > 0.0:
            yield Fault("pose_times[0]", f"must not be after 0, got {self.pose_times[0]:g}")

    def _half_turns(self) -> Iterator[Fault]:
        attitudes = map(unit_quaternion, self.pose_attitudes or ())
        for k, (before, attitude) in enumerate(pairwise(attitudes), start=1):
            if 2.0 * abs(sum(a * b for a, b in zip(before, attitude, strict=True))) < HALF_TURN:
                reason = f"is half a turn from the attitude before it, to {HALF_TURN:g} rad"
                yield Fault(f"pose_attitudes[{k}]", f"{reason}: put a pose between them")


Bodies = Mapping[Name, Body]


def cross_checks(bodies: Bodies, end: float) -> Iterator[Fault]:
    """Require distinct names, and poses until the end of the run [s]."""
    yield from distinct(bodies)
    for name, body in bodies.items():
        if body.pose_times and (last := body.pose_times[-1]) < end:
            where = f"{name}.pose_times[{len(body.pose_times) - 1}]"
            yield Fault(where, f"must not be before time.end, {end:g} s, got {last:g}")


def impossible(*moments: float) -> str:
    """Why no body has these moments of inertia [kg m2], or ""."""
    largest = max(moments)
    others = sum(moments) - largest
    if largest <= others * (1 + ROUND_OFF):
        return ""
    return (
        f"no body has these moments: the largest, {largest:g}, must not exceed the sum of the "
        f"other two, {others:g} kg m2"
    )
