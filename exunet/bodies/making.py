"""From the keys of a body to what it is: its shape, mass, inertia and principal axes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from exunet.base.errors import LARGEST, CaseError, Fault, InputError
from exunet.bodies.body import ROUND_OFF, RigidBody
from exunet.bodies.keys import BodyKeys, PartKeys, impossible
from exunet.bodies.mass_properties import MassDistribution, of_shape, principal, sum_of
from exunet.bodies.mesh import read_mesh
from exunet.bodies.shapes import Shape, Solid

Floats = NDArray[np.float64]

_TOO_LARGE = "its mass, centre of mass or inertia is outside the range of floating-point numbers"
_TOO_SMALL = (
    "its mass or least moment of inertia is round-off beside other numbers: the mass must be "
    f"{1.0 / LARGEST:g} kg or more, the least moment {ROUND_OFF:g} of the largest or more"
)


def make_body(name: str, keys: BodyKeys, carried: Sequence[MassDistribution] = ()) -> RigidBody:
    """A body of keys that are valid, and what is fixed to it, in its frame.

    Raises CaseError for a mesh or an inertia that is none of a body.
    """
    shape = shape_of(name, keys)
    try:
        with np.errstate(all="ignore"):  # numbers that overflow are a fault
            distribution = sum_of((distribution_of(name, keys, shape), *carried))
    except ArithmeticError:  # of Python's own floats
        raise _beyond_floats(name, _TOO_LARGE) from None
    numbers = distribution.mass, *distribution.centre, *distribution.inertia.ravel()
    if not np.abs(numbers).max() <= LARGEST:
        raise _beyond_floats(name, _TOO_LARGE)
    moments, axes = principal(distribution.inertia)
    if words := impossible(*moments):
        raise CaseError([Fault(f"bodies.{name}.products_of_inertia", f"{words} (principal moments)")])
    if min(distribution.mass, moments.min()) < 1.0 / LARGEST or moments.min() < ROUND_OFF * moments.max():
        raise _beyond_floats(name, _TOO_SMALL)
    return RigidBody(
        name,
        distribution.mass,
        tuple(moments.tolist()),
        tuple(distribution.centre.tolist()),
        tuple(axes.tolist()),
        shape,
    )


def _beyond_floats(name: str, words: str) -> CaseError:
    return CaseError([Fault(f"bodies.{name}", words, beyond_floats=True)])


def shape_of(name: str, keys: BodyKeys) -> Shape | None:
    """The shape of a body; None without one. Reads the file of a mesh."""
    rounding = keys.edge_radius or 0.0
    if keys.parts:
        return Shape(tuple(part_of(part) for part in keys.parts.values()), edge_radius=rounding)
    if keys.shape == "mesh":
        assert keys.file is not None
        assert keys.unit is not None
        try:
            mesh = read_mesh(Path(keys.file), keys.unit)
            return Shape(mesh=mesh, edge_radius=rounding, grid_spacing=keys.grid_spacing)
        except InputError as error:
            raise CaseError([Fault(f"bodies.{name}.file", str(error))]) from error
    return Shape((solid_of(keys),), edge_radius=rounding) if keys.shape else None


def part_of(keys: PartKeys) -> Solid:
    """A part, where it is in the body's frame."""
    return replace(solid_of(keys), position=keys.position, attitude=keys.quaternion)


def solid_of(keys: BodyKeys | PartKeys) -> Solid:
    """The solid of these dimensions about the origin."""
    assert keys.shape is not None
    assert keys.shape != "mesh"
    if keys.size is not None:
        return Solid(keys.shape, keys.size)
    if keys.radii is not None and keys.length is not None:
        return Solid(keys.shape, (*keys.radii, keys.length))
    assert keys.radius is not None
    return Solid(keys.shape, (keys.radius, keys.length or 0.0, 0.0))


def distribution_of(name: str, keys: BodyKeys, shape: Shape | None) -> MassDistribution:
    """Mass, centre of mass and inertia, in the axes of the body's frame."""
    even = None if shape is None else of_shape(shape)
    if keys.inertia is None:
        assert even is not None
        if keys.density is not None:
            return even.times(keys.density)
        assert keys.mass is not None
        return replace(even.times(float(np.divide(keys.mass, even.mass))), mass=keys.mass)
    assert keys.mass is not None
    centre = np.zeros(3) if even is None else even.centre
    if keys.centre_of_mass is not None:
        centre = np.array(keys.centre_of_mass)
    inertia = np.diag(keys.inertia)
    if keys.products_of_inertia is not None:
        rows = ([0, 0, 1], [1, 2, 2])
        inertia[rows] = inertia[rows[::-1]] = keys.products_of_inertia
    return MassDistribution(keys.mass, centre, inertia)
