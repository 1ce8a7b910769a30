"""What of a system has no equations of motion: bodies that guides move, points that are fixed to bodies."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from exunet.bodies import constraint_loops as loops
from exunet.bodies.guide import Guide
from exunet.bodies.rigid import RigidStates, rotation_matrix
from exunet.forces.blocks import Blocks, FirstOrder
from exunet.forces.loops import Index
from exunet.forces.rotation_loops import in_body_axes, in_scene_axes
from exunet.forces.terms import Constraint, KernelCall

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

# What a guided body gives to all else, as first-order states of the system: name, size, units.
GIVEN = (("impulse", 3, "N s"), ("angular_impulse", 3, "N m s"), ("work", 1, "J"))


def given_states(name: str) -> tuple[FirstOrder, ...]:
    """The states that keep what the guided body of this name gives."""
    return tuple(FirstOrder(f"{name}/{quantity}", (0.0,) * size, units) for quantity, size, units in GIVEN)


@dataclass(frozen=True, eq=False)
class Kinematics:
    """The constraints of a system.

    n_free : number of free bodies, which come before the others
    guides : of the bodies that guides move, in their order
    point  : (n,) points that are fixed to bodies
    body   : (n,) the number of the body of each
    arm    : (n, 3) of each from the centre of mass, in principal axes [m]
    """

    n_free: int = 0
    guides: tuple[Guide, ...] = ()
    point: Ints = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    body: Ints = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    arm: Floats = field(default_factory=lambda: np.zeros((0, 3)))

    def __bool__(self) -> bool:
        return bool(self.guides) or len(self.point) > 0

    def completed(
        self, time: Floats, position: Floats, velocity: Floats, bodies: RigidStates
    ) -> tuple[Floats, Floats, RigidStates]:
        """States at times (...) [s] with what has no equations of motion put in; copies.

        position, velocity : (..., n_points, 3); bodies : the free ones, or all
        """
        if not self:
            return position, velocity, bodies
        bodies = self.all_bodies(time, bodies)
        if len(self.point):
            turn = rotation_matrix(bodies.attitude[..., self.body, :])
            spin = bodies.angular_velocity[..., self.body, :]
            position, velocity = position.copy(), velocity.copy()
            arm = np.einsum("...nij,nj->...ni", turn, self.arm)
            swing = np.einsum("...nij,...nj->...ni", turn, np.cross(spin, self.arm))
            position[..., self.point, :] = bodies.position[..., self.body, :] + arm
            velocity[..., self.point, :] = bodies.velocity[..., self.body, :] + swing
        return position, velocity, bodies

    def all_bodies(self, time: Floats, bodies: RigidStates) -> RigidStates:
        """States at times (...) [s] of all bodies, by those of the free ones, or of all."""
        if not self.guides:
            return bodies
        moved = [guide.at(time.reshape(-1)).parts() for guide in self.guides]
        whole = []
        for own, guided in zip(bodies.parts(), zip(*moved, strict=True), strict=True):
            rows = [values.reshape(*time.shape, 1, -1) for values in guided]
            whole.append(np.concatenate([own[..., : self.n_free, :], *rows], axis=-2))
        return RigidStates(*whole)

    def term(self, blocks: Blocks) -> Constraint | None:
        """The constraints as compiled functions take them; None without any."""
        if not self:
            return None
        calls = []
        if len(self.point):
            data, place = _attached(self, blocks), loops.place_attached
            helpers = (in_scene_axes, in_body_axes, loops.add_arm)
            calls.append(KernelCall(loops.carry_forces, data, place=place, helpers=helpers))
        if self.guides:
            guided = _guided(self, blocks)
            both = (in_scene_axes, loops.add_arm)
            calls.append(KernelCall(loops.give_to_others, guided, place=loops.place_guided, helpers=both))
        pulled = {blocks.rigid[k] for k in self.body.tolist() if k < self.n_free}
        return Constraint(tuple(calls), tuple(sorted(pulled)))


def _attached(kinematics: Kinematics, blocks: Blocks) -> loops.Attached:
    names = [blocks.rigid[k] for k in kinematics.body.tolist()]
    centre, quaternion, spin = _entries(blocks, names)
    point = (3 * kinematics.point).astype(Index)
    return loops.Attached(point, centre, quaternion, spin, kinematics.arm)


def _guided(kinematics: Kinematics, blocks: Blocks) -> loops.Guided:
    guides, names = kinematics.guides, blocks.rigid[kinematics.n_free :]
    centre, quaternion, spin = _entries(blocks, names)
    return loops.Guided(
        first=np.cumsum([0, *(len(guide.time) for guide in guides)]),
        time=np.concatenate([guide.time for guide in guides]),
        position=np.concatenate([guide.position for guide in guides]),
        attitude=np.concatenate([guide.attitude for guide in guides]),
        turning=np.concatenate([guide.turning for guide in guides]),
        offset=np.stack([guide.offset for guide in guides]),
        centre=centre,
        quaternion=quaternion,
        spin=spin,
        rate=np.array([blocks.rate(f"{name}/{GIVEN[0][0]}") for name in names], dtype=Index),
    )


def _entries(blocks: Blocks, names: Sequence[str]) -> Iterator[NDArray[Index]]:
    """Where the centres, attitudes and angular velocities of bodies begin, (n,) each."""
    for where in (blocks.centre, blocks.attitude, blocks.spin):
        yield np.array([where(name) for name in names], dtype=Index)
