"""Thrust on a rigid body: force and torque over time, in its axes or the scene's, at a point of its frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from reference_impl.arrays import Floats, Vector, cross
from reference_impl.effects.thrust import Thrust
from reference_impl.table import Table, numbers, triple, triples


@dataclass(frozen=True)
class Thruster:
    """A `profile` of force [N] and torque [N m] together, and the point [m] of the frame where it acts."""

    profile: Thrust
    of_scene: bool
    point: Vector

    def wrench(
        self, t: float, segment: int | None, attitude: Floats, centre: Floats
    ) -> tuple[Floats, Floats]:
        """Force [N] and torque about the centre of mass [N m] (3,) in the scene's axes; see `Thrust.at`.

        `attitude` (3, 3) is the body's, `centre` (3,) [m] its centre of mass, in its frame.
        """
        load = self.profile.at(t, segment).reshape(2, 3)
        force, torque = load if self.of_scene else load @ attitude.T
        return force, torque + cross(attitude @ (np.array(self.point) - centre), force)


def read_thruster(table: Table) -> Thruster | None:
    """The thrust of a body; None where the table gives none, which is for scripts."""
    of_scene = "axes" in table and table.choice("axes", "body", "scene") == "scene"
    point = table.get("point", triple, (0.0, 0.0, 0.0))
    times = table.get("times", numbers, ())
    none = ((0.0, 0.0, 0.0),) * len(times)
    force, torque = (table.get(key, triples, none) for key in ("force", "torque"))
    table.close()
    rows = tuple((*one, *other) for one, other in zip(force, torque, strict=True))
    return Thruster(Thrust((), times, rows), of_scene, point) if times else None
