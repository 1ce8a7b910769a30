"""Rigid bodies: construction from a case, constant properties, states in principal axes.

Two frames belong to a body. Its *frame* is that of the case, in which its shape is drawn and its points are
named. In its *principal axes*, whose origin is the centre of mass, it is integrated.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from exunet.base.arrays import Floats
from exunet.base.errors import LARGEST, CaseError, Fault, InputError
from exunet.bodies.config import Body, impossible
from exunet.bodies.mass_properties import MassDistribution, of_shape, principal, sum_of
from exunet.bodies.mesh import read_mesh
from exunet.bodies.rotations import product, rotation_matrix
from exunet.bodies.shapes import Shape

ROUND_OFF = 1e-14  # of the largest moment: an element of a matrix of inertia that is smaller is 0
ALONG = (1.0, 0.0, 0.0, 0.0)  # principal axes along those of the frame


@dataclass(frozen=True)
class RigidBody:
    """A rigid body.

    mass    : [kg]
    inertia : principal moments [kg m2]
    centre  : of mass, in the frame [m]
    axes    : unit quaternion (w, x, y, z) that turns the principal axes into those of the frame
    shape   : in the frame; None: a body without a surface
    """

    name: str
    mass: float
    inertia: tuple[float, float, float]
    centre: tuple[float, float, float] = (0.0, 0.0, 0.0)
    axes: tuple[float, float, float, float] = ALONG
    shape: Shape | None = None

    @property
    def is_along_frame(self) -> bool:
        """True if the principal axes are those of the frame."""
        return self.axes == ALONG

    @property
    def rotation(self) -> Floats:
        """(3, 3), from principal axes to those of the frame."""
        return rotation_matrix(np.array(self.axes))

    @property
    def inertia_in_frame(self) -> Floats:
        """(3, 3) about the centre of mass, in the axes of the frame [kg m2]; what is round-off in it is 0."""
        if self.is_along_frame:
            return np.diag(self.inertia)
        turned = self.rotation @ np.diag(self.inertia) @ self.rotation.T
        return np.where(np.abs(turned) > ROUND_OFF * max(self.inertia), turned, 0.0)

    def frame_poses(self, position: Floats, attitude: Floats) -> Floats:
        """(..., 7) place of the frame's origin [m] and its attitude, of states of the body.

        position, attitude : (..., 3) of the centre of mass [m], (..., 4) of the principal axes
        """
        frame = product(attitude, np.array(self.axes) * [1.0, -1.0, -1.0, -1.0])
        return np.concatenate([position - rotation_matrix(frame) @ np.array(self.centre), frame], axis=-1)

    def in_principal_axes(self, point: Sequence[float]) -> Floats:
        """A point (3,) of the frame, from the centre of mass and in principal axes [m]."""
        return np.asarray((np.array(point, dtype=float) - self.centre) @ self.rotation)


def in_frames(bodies: Sequence[RigidBody], states: RigidStates) -> RigidStates:
    """States with attitudes and angular velocities of the frames; places stay those of the centres."""
    if all(body.is_along_frame for body in bodies):
        return states
    axes = np.array([body.axes for body in bodies])
    back = axes * [1.0, -1.0, -1.0, -1.0]
    spin = np.einsum("nij,...nj->...ni", rotation_matrix(axes), states.angular_velocity)
    return replace(states, attitude=product(states.attitude, back), angular_velocity=spin)


@dataclass(frozen=True, eq=False)
class RigidStates:
    """States of n_bodies bodies; leading axes are free (none for one instant, (k,) for k of them).

    position         : (..., n_bodies, 3) of the centres of mass [m]
    velocity         : (..., n_bodies, 3) [m/s]
    attitude         : (..., n_bodies, 4) unit quaternions (w, x, y, z), from the body's axes to the scene's
    angular_velocity : (..., n_bodies, 3) [rad/s], in the body's axes
    """

    position: Floats
    velocity: Floats
    attitude: Floats
    angular_velocity: Floats

    @classmethod
    def none(cls, *leading: int) -> RigidStates:
        """Return the states of zero bodies, in arrays of leading shape `leading`."""
        return cls(*(np.zeros((*leading, 0, width)) for width in (3, 3, 4, 3)))

    def __getitem__(self, rows: slice | int | NDArray[np.int64]) -> RigidStates:
        """Those of some instants."""
        return RigidStates(
            self.position[rows], self.velocity[rows], self.attitude[rows], self.angular_velocity[rows]
        )

    def of_body(self, k: int) -> RigidStates:
        """Those of one body, as the only one."""
        return RigidStates(*(part[..., k : k + 1, :] for part in self.parts()))

    def parts(self) -> tuple[Floats, Floats, Floats, Floats]:
        """The four arrays, in the order of the fields."""
        return self.position, self.velocity, self.attitude, self.angular_velocity


def kinetic(mass: Floats, inertia: Floats, states: RigidStates) -> Floats:
    """Energy of translation and rotation of each body [J]; mass (n,), inertia (n, 3) -> (..., n)."""
    moving = mass * np.einsum("...na,...na->...n", states.velocity, states.velocity)
    spinning = np.einsum("...na,...na,na->...n", states.angular_velocity, states.angular_velocity, inertia)
    return 0.5 * (moving + spinning)


def angular_momentum(mass: Floats, inertia: Floats, states: RigidStates) -> Floats:
    """About the scene's origin [kg m2/s], (..., 3)."""
    orbital = np.einsum("n,...na->...a", mass, np.cross(states.position, states.velocity))
    own = inertia * states.angular_velocity
    return orbital + np.einsum("...nab,...nb->...a", rotation_matrix(states.attitude), own)


_TOO_LARGE = "its mass, centre of mass or inertia is outside the range of floating-point numbers"
_TOO_SMALL = (
    "its mass or least moment of inertia is round-off beside other numbers: the mass must be "
    f"{1.0 / LARGEST:g} kg or more, the least moment {ROUND_OFF:g} of the largest or more"
)


def make_body(name: str, keys: Body, carried: Sequence[MassDistribution] = ()) -> RigidBody:
    """A body of keys that are valid, and what is fixed to it, in its frame.

    Raises CaseError for an invalid mesh or inertia.
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


def shape_of(name: str, keys: Body) -> Shape | None:
    """The shape of a body; None without one. Reads the file of a mesh."""
    rounding = keys.edge_radius or 0.0
    if keys.parts:
        return Shape(tuple(part.placed_solid for part in keys.parts.values()), edge_radius=rounding)
    if keys.shape == "mesh":
        assert keys.file is not None
        assert keys.unit is not None
        try:
            mesh = read_mesh(Path(keys.file), keys.unit)
            return Shape(mesh=mesh, edge_radius=rounding, grid_spacing=keys.grid_spacing)
        except InputError as error:
            raise CaseError([Fault(f"bodies.{name}.file", str(error))]) from error
    return Shape((keys.solid,), edge_radius=rounding) if keys.shape else None


def distribution_of(name: str, keys: Body, shape: Shape | None) -> MassDistribution:
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
