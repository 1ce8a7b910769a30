"""The keys of [bodies.NAME]: a rigid body's shape, mass and inertia, and its state at time 0."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Literal

from pydantic import AfterValidator, ConfigDict, Field, StringConstraints, field_validator

from exunet.base.table import FromArray, NonNegative, Positive, Table, Vector
from exunet.bodies.shapes import ShapeName, SolidName


def unit_quaternion(attitude: tuple[float, float, float, float]) -> tuple[float, float, float, float]:
    """An attitude brought to length 1; raises ValueError if it is zero."""
    largest = max(map(abs, attitude))
    if largest == 0.0:
        raise ValueError("must not be zero: [1, 0, 0, 0] leaves the body's axes along the scene's")
    w, x, y, z = (part / largest for part in attitude)  # so that no square overflows or vanishes
    length = math.hypot(w, x, y, z)
    return (w / length, x / length, y / length, z / length)


Quaternion = Annotated[tuple[float, float, float, float], FromArray, AfterValidator(unit_quaternion)]
Moments = Annotated[tuple[Positive, Positive, Positive], FromArray]
Edges = Annotated[tuple[Positive, Positive, Positive], FromArray]
Radii = Annotated[tuple[NonNegative, NonNegative], FromArray]
Times = Annotated[tuple[float, ...], FromArray]
Places = Annotated[tuple[Vector, ...], FromArray]
Quaternions = Annotated[tuple[Quaternion, ...], FromArray]
Name = Annotated[str, StringConstraints(pattern=r"^[A-Za-z0-9_-]+$")]
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


def _with_dimensions(*names: str) -> list[dict[str, Any]]:
    """JSON schema: the keys that go with each shape of a table that may have all of these keys."""
    return [
        {
            "if": {"properties": {"shape": {"const": shape}}, "required": ["shape"]},
            "then": {
                "required": list(own),
                "properties": dict.fromkeys(set(names) - set(own), False),
            },
        }
        for shape, own in DIMENSIONS.items()
    ]


_OF_SOLIDS = ("size", "radius", "length", "radii")
_ANGLES: list[Any] = [{"dependentRequired": {"axis": ["angle"], "angle": ["axis"]}}]
_ONE_ATTITUDE: list[Any] = [{"not": {"required": ["attitude", "axis"]}}]


_POSES = ("pose_times", "pose_positions", "pose_attitudes")
_STARTS = ("position", "velocity", "angular_velocity")


class Placed(Table):
    """Where something is, and how it is turned."""

    position: Vector = Field((0.0, 0.0, 0.0), description="of its origin [m]")
    attitude: Quaternion = Field(
        (1.0, 0.0, 0.0, 0.0),
        description="quaternion [w, x, y, z] that turns its axes; brought to length 1",
    )
    axis: Vector | None = Field(
        None, description="instead of attitude: axis about which it is turned", examples=[[0.0, 0.0, 1.0]]
    )
    angle: float | None = Field(None, description="by which it is turned about axis [rad]", examples=[0.5])

    @field_validator("axis")
    @classmethod
    def _of_some_direction(cls, axis: tuple[float, float, float] | None) -> tuple[float, float, float] | None:
        if axis is None:
            return None
        largest = max(map(abs, axis))
        if largest == 0.0:
            raise ValueError("must not be zero")
        x, y, z = (part / largest for part in axis)
        length = math.hypot(x, y, z)
        return (x / length, y / length, z / length)

    @property
    def quaternion(self) -> tuple[float, float, float, float]:
        """Of length 1, by whichever keys it is given."""
        if self.axis is None or self.angle is None:
            return self.attitude
        x, y, z = (math.sin(0.5 * self.angle) * part for part in self.axis)
        return (math.cos(0.5 * self.angle), x, y, z)


class Dimensions(Table):
    """Of solids; which of them a solid has follows from its shape."""

    size: Edges | None = Field(
        None, description="edges of a box along x, y, z [m]", examples=[[1.0, 1.0, 2.0]]
    )
    radius: Positive | None = Field(None, description="of cylinder, sphere, capsule [m]", examples=[0.5])
    length: Positive | None = Field(
        None,
        description="of cylinder and frustum, along z; of a capsule between the centres of its ends [m]",
        examples=[2.0],
    )
    radii: Radii | None = Field(
        None, description="of a frustum at -z and +z [m]; one may be zero", examples=[[0.5, 0.3]]
    )


class PartKeys(Placed, Dimensions):
    """A solid that is part of a body."""

    model_config = ConfigDict(
        json_schema_extra={"allOf": [*_with_dimensions(*_OF_SOLIDS), *_ANGLES, *_ONE_ATTITUDE]}
    )

    shape: SolidName = Field(description="of the part")
    position: Vector = Field((0.0, 0.0, 0.0), description="of the part's origin in the body's frame [m]")
    attitude: Quaternion = Field(
        (1.0, 0.0, 0.0, 0.0),
        description="quaternion [w, x, y, z] that turns the part's axes into the body's; brought to length 1",
    )


class AttachmentKeys(Table):
    """A node of the net that is fixed to a point of a body."""

    EXACTLY_ONE: ClassVar = ("node", "bullet")

    point: Vector = Field(description="of the body, in its frame [m]", examples=[[0.5, 0.0, 0.0]])
    node: Annotated[int, Field(ge=0)] | None = Field(
        None, description="number of the node, as in results and in lists of nodes", examples=[0]
    )
    bullet: Annotated[int, Field(ge=0)] | None = Field(
        None, description="number of the bullet, from 0, instead of node", examples=[0]
    )


class BodyKeys(Placed, Dimensions):
    """A rigid body: free but for the forces that act on it."""

    # Its frame is that in which its shape is drawn; without a shape its origin is the centre of mass.

    EXACTLY_ONE: ClassVar = ("mass", "density")
    model_config = ConfigDict(
        json_schema_extra={
            "allOf": [
                *_with_dimensions(*_OF_SOLIDS, "file", "unit"),
                *_ANGLES,
                *_ONE_ATTITUDE,
                {"if": {"required": ["shape"]}, "then": {"properties": {"parts": {"maxProperties": 0}}}},
                {
                    "if": {"not": {"required": ["shape"]}},
                    "then": {"properties": dict.fromkeys((*_OF_SOLIDS, "file", "unit"), False)},
                },
                {
                    "if": {"properties": {"shape": {"enum": ["sphere", "capsule"]}}, "required": ["shape"]},
                    "then": {"properties": {"edge_radius": False}},
                },
                {
                    "if": {"properties": {"shape": {"const": "mesh"}}, "required": ["shape"]},
                    "then": {"dependentRequired": {"grid_spacing": ["edge_radius"]}},
                    "else": {"properties": {"grid_spacing": False}},
                },
                {
                    "anyOf": [
                        {"required": ["shape"]},
                        {"required": ["parts"], "properties": {"parts": {"minProperties": 1}}},
                        {"required": ["inertia"], "properties": {"edge_radius": False}},
                    ]
                },
                {
                    "if": {"properties": {"motion": {"const": "prescribed"}}, "required": ["motion"]},
                    "else": {"properties": dict.fromkeys(_POSES, False)},
                },
                {
                    "if": {"properties": {"motion": {"const": "fixed"}}, "required": ["motion"]},
                    "then": {"properties": dict.fromkeys(("velocity", "angular_velocity"), False)},
                },
                {
                    "dependentRequired": {
                        "pose_times": ["pose_positions"],
                        "pose_positions": ["pose_times"],
                        "pose_attitudes": ["pose_times"],
                    },
                    "dependentSchemas": {
                        "pose_times": {"properties": dict.fromkeys(_STARTS, False)},
                        "pose_attitudes": {"properties": dict.fromkeys(("attitude", "axis"), False)},
                    },
                },
                {"if": {"required": ["density"]}, "then": {"properties": {"inertia": False}}},
                {
                    "if": {"not": {"required": ["inertia"]}},
                    "then": {"properties": dict.fromkeys(("products_of_inertia", "centre_of_mass"), False)},
                },
            ]
        }
    )

    mass: Positive | None = Field(None, description="mass of the body [kg]", examples=[500.0])
    density: Positive | None = Field(
        None,
        description="of the body, which its shape fills evenly, instead of mass [kg/m3]",
        examples=[100.0],
    )
    inertia: Moments | None = Field(
        None,
        description="moments of inertia Ixx, Iyy, Izz about the centre of mass, along the axes of the body's "
        "frame [kg m2]; without it a shape is filled evenly",
        examples=[[80.0, 100.0, 120.0]],
    )
    products_of_inertia: Vector | None = Field(
        None,
        description="elements Ixy, Ixz, Iyz of the matrix of inertia, such as Ixy = -(integral of x y dm), "
        "beside inertia [kg m2]",
        examples=[[1.0, 0.0, -2.0]],
    )
    centre_of_mass: Vector | None = Field(
        None,
        description="in the body's frame, beside inertia [m]; else that of the evenly filled shape, or the "
        "origin without a shape",
        examples=[[0.0, 0.0, 0.1]],
    )
    shape: ShapeName | None = Field(
        None, description="of the body: a solid about the origin of its frame, or a mesh"
    )
    file: str | None = Field(
        None, description="of a mesh: STL, OBJ or GLB, beside the case file", examples=["target.stl"]
    )
    unit: Literal["m", "cm", "mm", "inch"] | None = Field(
        None, description="of the lengths in the file of a mesh", examples=["mm"]
    )
    edge_radius: NonNegative | None = Field(
        None,
        description="by which edges and corners are rounded for contact, inside the shape [m]; "
        "mass and inertia are those of the sharp shape",
        examples=[0.01],
    )
    grid_spacing: Positive | None = Field(
        None,
        description="of a mesh: of the grid on which the distance from it is sampled for contact [m], at "
        "most half of edge_radius; without it a quarter of edge_radius",
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
        description="at time 0, in the axes that angular_velocity_frame names [rad/s]",
        examples=[[0.0, 0.0, 0.1]],
    )
    angular_velocity_frame: Literal["body", "scene"] = Field(
        "body", description="whose axes angular_velocity is given in"
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
        description="of a prescribed motion [s], increasing, from 0 or before to time.end or later",
        examples=[[0.0, 2.0]],
    )
    pose_positions: Places | None = Field(
        None,
        description="of the origin of the body's frame, one for each of pose_times [m]",
        examples=[[[0.0, 0.0, 0.0], [0.0, 0.0, 0.3]]],
    )
    pose_attitudes: Quaternions | None = Field(
        None,
        description="quaternions [w, x, y, z] like attitude, one for each of pose_times; without it the "
        "attitude stays",
        examples=[[[1.0, 0.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.3]]],
    )
    attachments: Mapping[Name, AttachmentKeys] = Field(
        {},
        description="nodes of the net that are fixed to the body, by any names",
        json_schema_extra={"additionalProperties": False},
    )
    parts: Mapping[Name, PartKeys] = Field(
        {},
        description="instead of shape: solids that together are the body, by any names; volumes that they "
        "share count once for each",
        json_schema_extra={"additionalProperties": False},
    )

    @field_validator("inertia")
    @classmethod
    def _of_some_mass_distribution(
        cls, moments: tuple[float, float, float] | None
    ) -> tuple[float, float, float] | None:
        if moments is not None and (words := impossible(*moments)):
            raise ValueError(words)
        return moments


Bodies = Mapping[Name, BodyKeys]


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
