"""States and trajectories of a case in both codes, seen by the same points."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

import reference_impl as reference
from exunet.studies.books import Break

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Theirs:
    """States in the reference's numbering; leading axes are free.

    x, v   : (..., n, 3) of the nodes [m], [m/s]
    bodies : of its bodies: a chaser first, then the rigid ones
    """

    x: Floats
    v: Floats
    bodies: reference.BodyStates

    @property
    def particles(self) -> tuple[Floats, Floats]:
        """Places and velocities (..., n + b, 3) of the nodes, then of the bodies' centres."""
        return (
            np.concatenate([self.x, self.bodies.position], axis=-2),
            np.concatenate([self.v, self.bodies.velocity], axis=-2),
        )


@dataclass(frozen=True)
class Trajectory:
    """A trajectory in exunet's numbering, seen by points that it moves.

    time       : (t,) [s]
    position   : (t, k, 3) [m] of the nodes, the point masses, and four points of each rigid body: its centre,
                 and the ends of arms along its axes, as long as the net's size. So its attitude counts too
    velocity   : (t, k, 3) of these points [m/s]
    seen       : the same states as the reference has them, with the bodies
    steps      : how many were taken
    reels      : (t, n_reels) of each, as the reference has them
    drawn      : (t, c) of what closes the mouth, c = 0 or 1, as the reference has it
    dissipated : (t,) energy that has left the system since the start [J], less what bodies whose motion is
                 given, reels and what closes the mouth have put in; None: it was not booked
    breaks     : elements that broke, in order of time
    given      : (t, 6) impulse [N s] and angular impulse about the origin [N m s] that bodies whose motion is
                 given have given to all else; None: it was not asked for
    """

    time: Floats
    position: Floats
    velocity: Floats
    seen: Theirs
    steps: int
    reels: reference.Wound
    drawn: reference.Drawn
    dissipated: Floats | None = None
    breaks: tuple[Break, ...] = ()
    given: Floats | None = None


def with_arms(
    points: tuple[Floats, Floats], bodies: tuple[Floats, ...], length: float | Floats
) -> tuple[Floats, Floats]:
    """Places and velocities (t, k, 3) of points, and of four points of each rigid body; see `Trajectory`.

    bodies : places and velocities (t, b, 3), attitudes (t, b, 3, 3), angular velocities in body axes
    length : of the arms, or (b,) of those of each body [m]
    """
    place, speed, frame, turning = bodies
    if not place.shape[1]:
        return points
    arms = np.reshape(length, (-1, 1, 1)) * np.swapaxes(
        frame, -1, -2
    )  # (t, b, 3, 3): rows are the arms in the scene's axes
    turn = np.einsum("tbij,tbj->tbi", frame, turning)
    moved = np.cross(turn[:, :, None], arms)
    found = []
    for of_points, centre, arm in ((points[0], place, arms), (points[1], speed, moved)):
        ends = (centre[:, :, None] + arm).reshape(len(centre), -1, 3)
        found.append(np.concatenate([of_points, centre, ends], axis=1))
    return found[0], found[1]
