"""A case in two codes: which node, element, body and state of the one is which of the other."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import reference_impl as reference
from exunet.base.errors import InputError
from exunet.bodies.rigid import RigidStates, in_frames
from exunet.bodies.rotations import rotation_matrix
from exunet.net.closing import NAME as LINE
from exunet.results.comparison import ComparedRun, match_nodes
from exunet.simulation.preparation import Start
from exunet.studies.both_trajectories import Theirs
from exunet.system.system import Moving, State
from reference_impl import closing

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

CLOSES = {closing.Line: ("wound_up", "work"), closing.Edge: ("part", "work")}  # names of its states here


@dataclass(frozen=True)
class Matched:
    """A case as both codes have it; all states are in exunet's numbering unless a name says otherwise.

    name   : for tables
    path   : of the case file
    start  : exunet's
    theirs : the reference's case, net, equations of motion and start
    """

    name: str
    path: Path
    start: Start
    theirs: reference.Scene

    @cached_property
    def reference_nodes(self) -> Ints:
        """(n_nodes,) for each node of exunet the node of the reference at the same place."""
        start, theirs = self.start, self.theirs
        ours = _at_start(start.net, start.position, start.velocity)
        ours = replace(ours, n_of_tethers=start.net.n_nodes - start.net.n_net_nodes)
        return match_nodes(ours, _at_start(theirs.net, theirs.x0, theirs.v0))

    @cached_property
    def reference_elements(self) -> Ints:
        """(n_elements,) for each element of exunet the element of the reference between the same nodes."""
        ours = np.sort(self.reference_nodes[self.start.net.element_nodes], axis=1)
        theirs = np.sort(self.theirs.net.element_nodes, axis=1)
        match = np.empty(len(ours), dtype=np.int64)
        match[np.lexsort(ours.T)] = np.lexsort(theirs.T)
        return match

    @cached_property
    def reference_bodies(self) -> Ints:
        """(n_bodies,) for each point mass of exunet, then each rigid body, the reference's of this name."""
        blocks, theirs = self.start.system.blocks, self.theirs.system.bodies.names
        ours = (*blocks.body, *blocks.rigid)
        if set(ours) != set(theirs):
            raise InputError(f"not the same bodies: {', '.join(ours)} and {', '.join(theirs)}")
        return np.array([theirs.index(name) for name in ours], dtype=np.int64)

    @cached_property
    def reference_particles(self) -> Ints:
        """(n_points + n_rigid,) for each point and each rigid body of exunet the reference's particle."""
        return np.concatenate([self.reference_nodes, self.start.net.n_nodes + self.reference_bodies])

    @cached_property
    def _beside(self) -> tuple[Ints, Ints]:
        """Which of the reference's bodies are exunet's point masses, and which its rigid bodies."""
        points = len(self.start.system.blocks.body)
        return self.reference_bodies[:points], self.reference_bodies[points:]

    @property
    def reference_rigid(self) -> Ints:
        """(n_rigid,) for each rigid body of exunet its number among the rigid ones of the reference."""
        return np.searchsorted(self.theirs.system.bodies.rigid, self._beside[1])

    def to_reference(self, values: Floats) -> Floats:
        """Values (..., n, 3) of exunet's nodes in the order of the reference's."""
        result = np.empty_like(values)
        result[..., self.reference_nodes, :] = values
        return result

    def from_reference(self, values: Floats) -> Floats:
        """Values (..., n, 3) of the reference's nodes in the order of exunet's."""
        return values[..., self.reference_nodes, :]

    def theirs_at(self, moving: Moving) -> Theirs:
        """States of exunet as the reference has them."""
        n, bodies = self.start.net.n_nodes, in_frames(self.start.system.bodies, moving.bodies)
        mass_points, rigid = self._beside
        count = len(self.reference_bodies)
        leading = moving.position.shape[:-2]
        place, speed = np.empty((*leading, count, 3)), np.empty((*leading, count, 3))
        attitude = np.broadcast_to(np.eye(3), (*leading, count, 3, 3)).copy()
        turning = np.zeros((*leading, count, 3))
        place[..., mass_points, :], place[..., rigid, :] = moving.position[..., n:, :], bodies.position
        speed[..., mass_points, :], speed[..., rigid, :] = moving.velocity[..., n:, :], bodies.velocity
        attitude[..., rigid, :, :] = rotation_matrix(bodies.attitude)
        turning[..., rigid, :] = bodies.angular_velocity
        return Theirs(
            self.to_reference(moving.position[..., :n, :]),
            self.to_reference(moving.velocity[..., :n, :]),
            reference.BodyStates(place, speed, attitude, turning),
        )

    def intact_in_reference(self, state: State) -> NDArray[np.bool_] | None:
        """(n_elements,) False for what has broken, in the reference's order; None: nothing can break."""
        carrying = self.start.system.forces.cable.carrying(state.memory)
        if carrying is None:
            return None
        intact = np.empty(len(carrying), dtype=bool)
        intact[self.reference_elements] = carrying > 0.0
        return intact

    def wound_in_reference(self, state: State) -> reference.Wound:
        """The reels at a state, in the reference's order."""
        system, reels = self.start.system, self.theirs.system.reels
        names = () if reels is None else reels.names
        first = system.blocks.n_x - system.blocks.n_states
        wound, work = (
            np.array([state.first_order[system.blocks.state(f"{name}/{what}") - first] for name in names])
            for what in ("wound_up", "work")
        )
        held = {winding.name: winding.on_drum(state.memory) for winding in system.forces.cable.reels}
        return reference.Wound(wound, np.array([float(held[name]) for name in names]), work)

    def drawn_in_reference(self, first_order: Floats) -> reference.Drawn:
        """What closes the mouth in first-order states (..., n_states), as the reference has it."""
        system, names = self.start.system, CLOSES.get(type(self.theirs.system.closing), ())
        first = system.blocks.n_x - system.blocks.n_states
        found = [first_order[..., [system.blocks.state(f"{LINE}/{name}") - first]] for name in names]
        return reference.Drawn(*(found or [first_order[..., :0]] * 2))

    def rigid_of(self, seen: Theirs | reference.Trajectory) -> tuple[Floats, Floats, Floats, Floats]:
        """Of the rigid bodies, in exunet's order: what `reference.BodyStates` has of each.

        Places and velocities (..., b, 3) of the centres of mass, attitudes (..., b, 3, 3) of the frames, and
        angular velocities (..., b, 3) in their axes.
        """
        rigid, states = self._beside[1], seen.bodies
        return (
            states.position[..., rigid, :],
            states.velocity[..., rigid, :],
            states.attitude[..., rigid, :, :],
            states.angular_velocity[..., rigid, :],
        )

    def points_of(self, found: reference.Trajectory) -> tuple[Floats, Floats]:
        """Positions and velocities (t, n_points, 3) of exunet's points in a trajectory of the reference."""
        masses, bodies = self._beside[0], found.bodies
        return (
            np.concatenate([self.from_reference(found.x), bodies.position[:, masses]], axis=1),
            np.concatenate([self.from_reference(found.v), bodies.velocity[:, masses]], axis=1),
        )

    def in_principal_axes(self, seen: Theirs | reference.Trajectory) -> RigidStates:
        """The same as states of exunet."""
        place, speed, frame, spin = self.rigid_of(seen)
        attitude, turning = np.empty((*place.shape[:2], 4)), np.empty_like(place)
        for k, body in enumerate(self.start.system.bodies):
            attitude[:, k] = Rotation.from_matrix(frame[:, k] @ body.rotation).as_quat(scalar_first=True)
            turning[:, k] = spin[:, k] @ body.rotation
        return RigidStates(place, speed, attitude, turning)


def _at_start(net: Any, position: Floats, velocity: Floats) -> ComparedRun:
    """position, velocity : of the nodes, and of whatever comes after them"""
    n = len(net.mass)
    return ComparedRun.of_net(net, np.zeros(1), position[None, :n], velocity[None, :n])
