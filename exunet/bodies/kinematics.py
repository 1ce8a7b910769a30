"""What of a system has no equations of motion: bodies that guides move, points that are fixed to bodies."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
from itertools import islice
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from exunet.bodies import constraint_loops as loops
from exunet.bodies.guide import Guide
from exunet.bodies.port import Piece
from exunet.bodies.rigid import RigidStates, rotation_matrix
from exunet.forces.blocks import Blocks, FirstOrder
from exunet.forces.held import Held, held_by, mass_matrix
from exunet.forces.kernel_call import KernelCall
from exunet.forces.loops import Index
from exunet.forces.rotation_loops import in_body_axes, in_scene_axes
from exunet.forces.terms import Constraint, Memories

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

# What a guided body gives to all else, as first-order states of the system: name, size, units.
GIVEN = (("impulse", 3, "N s"), ("angular_impulse", 3, "N m s"), ("work", 1, "J"))


def first_given(name: str) -> str:
    """The first of the states that keep what the guided body of this name gives."""
    return f"{name}/{GIVEN[0][0]}"


def given_states(name: str, already: Sequence[float] = (0.0,) * 7) -> tuple[FirstOrder, ...]:
    """The states that keep what the guided body of this name gives; `already` at time 0."""
    left = iter(already)
    return tuple(
        FirstOrder(f"{name}/{quantity}", tuple(islice(left, size)), units, gives=float(quantity == "work"))
        for quantity, size, units in GIVEN
    )


class OnBodies(NamedTuple):
    """Points (n,), the number of each one's body (n,), its arm (n, 3) in principal axes [m]."""

    point: Ints
    body: Ints
    arm: Floats


@dataclass(frozen=True, eq=False)
class Kinematics:
    """The constraints of a system.

    n_free : number of free bodies, which come before the others
    guides : of the bodies that guides move, in their order
    ports  : numbers of those among them whose guide a host gives piece by piece as the run goes; what is here
             is their motion at the start
    point  : (n,) points that are fixed to bodies
    body   : (n,) the number of the body of each
    arm    : (n, 3) of each from the centre of mass, in principal axes [m]
    held   : points that bodies hold for a while
    """

    n_free: int = 0
    guides: tuple[Guide, ...] = ()
    ports: tuple[int, ...] = ()
    point: Ints = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    body: Ints = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    arm: Floats = field(default_factory=lambda: np.zeros((0, 3)))
    held: tuple[Held, ...] = ()

    def __bool__(self) -> bool:
        return bool(self.guides or self.held) or len(self.point) > 0

    @cached_property
    def ties(self) -> dict[str, Held]:
        """The attachments and ends of tethers that a script may release, or has released, by name."""
        return {one.tie: one for one in self.held if one.tie}

    @cached_property
    def tied(self) -> Ints:
        """The points that are fixed to bodies, some of them until they are released."""
        return np.concatenate([self.point, *(one.points for one in self.ties.values())])

    @cached_property
    def tied_to(self) -> Ints:
        """The number of the body of each point in `tied`."""
        owners = (np.full(len(one.points), one.body) for one in self.ties.values())
        return np.concatenate([self.body, *owners])

    @cached_property
    def knots(self) -> tuple[float, ...]:
        """Instants [s] at which guides go from one piece to the next, where their motion is less smooth."""
        within = (guide.time[1:].tolist() for guide in self.guides)
        return tuple(sorted({time for times in within for time in times}))

    def on_bodies(self, memory: Memories) -> OnBodies:
        """The points that are fixed to bodies at these memories, held ones last."""
        fixed = OnBodies(self.point, self.body, self.arm)
        if not self.held:
            return fixed
        parts = [fixed]
        for one in self.held:
            n = one.number(memory)
            parts.append(OnBodies(one.points[:n], np.full(n, one.body), one.arm[:n]))
        return OnBodies(*(np.concatenate(values) for values in zip(*parts, strict=True)))

    def holds(self, memory: Memories) -> Ints:
        """The points that bodies hold for a while, at these memories."""
        every = [one.points[: one.number(memory)] for one in self.held]
        return np.concatenate(every) if every else np.zeros(0, dtype=np.int64)

    def completed(
        self, time: Floats, position: Floats, velocity: Floats, bodies: RigidStates, memory: Memories
    ) -> tuple[Floats, Floats, RigidStates]:
        """States at times (...) [s] with what has no equations of motion put in; copies.

        position, velocity : (..., n_points, 3); bodies : the free ones, or all; memory : of all the states
        """
        if not self:
            return position, velocity, bodies
        bodies = self.all_bodies(time, bodies)
        point, body, arm = self.on_bodies(memory)
        if len(point):
            turn = rotation_matrix(bodies.attitude[..., body, :])
            spin = bodies.angular_velocity[..., body, :]
            position, velocity = position.copy(), velocity.copy()
            lever = np.einsum("...nij,nj->...ni", turn, arm)
            swing = np.einsum("...nij,...nj->...ni", turn, np.cross(spin, arm))
            position[..., point, :] = bodies.position[..., body, :] + lever
            velocity[..., point, :] = bodies.velocity[..., body, :] + swing
        return position, velocity, bodies

    def all_bodies(self, time: Floats, bodies: RigidStates) -> RigidStates:
        """States at times (...) [s] of all bodies, by those of the free ones and of ports, or of all."""
        if not self.guides:
            return bodies
        moved = [guide.at(time.reshape(-1)).parts() for guide in self.guides]
        whole = []
        for own, guided in zip(bodies.parts(), zip(*moved, strict=True), strict=True):
            rows = [values.reshape(*time.shape, 1, -1) for values in guided]
            for number in self.ports:
                rows[number - self.n_free] = own[..., number : number + 1, :]
            whole.append(np.concatenate([own[..., : self.n_free, :], *rows], axis=-2))
        return RigidStates(*whole)

    def term(self, blocks: Blocks) -> Constraint | None:
        """The constraints as compiled functions take them; None without any."""
        if not self:
            return None
        calls: list[KernelCall] = []
        data: list[Callable[[Memories], tuple[Any, ...]]] = []

        def add(call: KernelCall, of: Callable[[Memories], tuple[Any, ...]]) -> None:
            calls.append(call)
            data.append(of)

        turns = (in_scene_axes, in_body_axes)
        if len(self.point) or self.held:
            place, helpers = loops.place_attached, (*turns, loops.add_arm)
            attached = partial(_attached, self, blocks)
            add(KernelCall(loops.carry_forces, attached({}), place=place, helpers=helpers), attached)
        if any(one.body < self.n_free for one in self.held):
            masses = partial(_held_masses, self, blocks)
            add(KernelCall(loops.share_with_held, masses({}), helpers=turns), masses)
        if self.guides:
            guided, own = _guided(self, blocks), (in_scene_axes, loops.add_arm, loops.piece_of_guide)
            if any(one.body in _moving(self) for one in self.held):
                borne, turned = partial(_on_guided, self, blocks), (*turns, *_OF_GUIDES)
                add(KernelCall(loops.bear_held, borne({}), helpers=turned), borne)
            call = KernelCall(loops.give_to_others, guided, place=loops.place_guided, helpers=own)
            add(call, lambda _: guided)
        owners = [*self.body.tolist(), *(one.body for one in self.held)]
        pulled = {blocks.rigid[k] for k in owners if k < self.n_free}
        return Constraint(tuple(calls), tuple(data), tuple(sorted(pulled)))


def _attached(kinematics: Kinematics, blocks: Blocks, memory: Memories) -> loops.Attached:
    point, body, arm = kinematics.on_bodies(memory)
    centre, quaternion, spin = _entries(blocks, [blocks.rigid[k] for k in body.tolist()])
    return loops.Attached((3 * point).astype(Index), centre, quaternion, spin, arm)


def _held_masses(kinematics: Kinematics, blocks: Blocks, memory: Memories) -> loops.HeldMasses:
    """Of the free bodies that may hold points."""
    numbers = sorted({one.body for one in kinematics.held if one.body < kinematics.n_free})
    first, second, inverse = [], [], []
    for number in numbers:
        mass, arm = held_by(kinematics.held, number, memory)
        first.append(mass @ arm)
        second.append((mass[:, None] * arm).T @ arm)
        own = blocks.inertia.mass[number], blocks.inertia.moments[number]
        inverse.append(np.linalg.inv(mass_matrix(*own, mass, arm)))
    centre, quaternion, spin = _entries(blocks, [blocks.rigid[k] for k in numbers])
    return loops.HeldMasses(
        centre,
        quaternion,
        spin,
        mass=blocks.inertia.mass[numbers],
        moments=blocks.inertia.moments[numbers],
        first=np.array(first),
        second=np.array(second),
        inverse=np.array(inverse),
    )


_OF_GUIDES = (loops.piece_of_guide, loops.angular_acceleration, loops.add_swing)


def _moving(kinematics: Kinematics) -> dict[int, Guide]:
    """The bodies that guides move, by number, but for those that rest."""
    guides = enumerate(kinematics.guides, kinematics.n_free)
    return {number: guide for number, guide in guides if number in kinematics.ports or not guide.rests}


def _on_guided(kinematics: Kinematics, blocks: Blocks, memory: Memories) -> loops.OnGuided:
    """Of the guided bodies in motion that may hold points."""
    moving = _moving(kinematics)
    numbers = sorted({one.body for one in kinematics.held if one.body in moving})
    masses, first, second = [], [], []
    for number in numbers:
        mass, arm = held_by(kinematics.held, number, memory)
        masses.append(mass.sum())
        first.append(mass @ arm)
        second.append((mass[:, None] * arm).T @ arm)
    centre, quaternion, spin = _entries(blocks, [blocks.rigid[k] for k in numbers])
    return loops.OnGuided(
        **_pieces([moving[number] for number in numbers]),
        centre=centre,
        quaternion=quaternion,
        spin=spin,
        mass=np.array(masses),
        moment=np.array(first),
        second=np.array(second),
    )


def _pieces(guides: Sequence[Guide]) -> dict[str, Any]:
    """Of guides, one after the other, by their names in the loops."""
    return {
        "first": np.cumsum([0, *(len(guide.time) for guide in guides)]),
        "time": np.concatenate([guide.time for guide in guides]),
        "position": np.concatenate([guide.position for guide in guides]),
        "turning": np.concatenate([guide.turning for guide in guides]),
        "offset": np.stack([guide.offset for guide in guides]),
    }


def _guided(kinematics: Kinematics, blocks: Blocks) -> loops.Guided:
    guides, names = kinematics.guides, blocks.rigid[kinematics.n_free :]
    centre, quaternion, spin = _entries(blocks, names)
    return loops.Guided(
        **_pieces(guides),
        attitude=np.concatenate([guide.attitude for guide in guides]),
        centre=centre,
        quaternion=quaternion,
        spin=spin,
        rate=np.array([blocks.rate(first_given(name)) for name in names], dtype=Index),
    )


def sites_of(data: Iterable[Any], centre: int) -> tuple[tuple[Any, int], ...]:
    """Where a kernel's data have the piece of a port whose centre begins at `centre`: parts, and rows."""
    guided = [part for part in data if isinstance(part, loops.Guided | loops.OnGuided)]
    return tuple(
        (part, int(part.first[b])) for part in guided for b in np.flatnonzero(part.centre == centre).tolist()
    )


def steer(sites: Iterable[tuple[Any, int]], piece: Piece) -> None:
    """Let a port go along a piece: in place, in the data of a kernel."""
    for part, row in sites:
        part.time[row], part.position[row], part.turning[row] = piece.time, piece.position, piece.turning
        if isinstance(part, loops.Guided):
            part.attitude[row] = piece.attitude


def _entries(blocks: Blocks, names: Sequence[str]) -> Iterator[NDArray[Index]]:
    """Where the centres, attitudes and angular velocities of bodies begin, (n,) each."""
    for where in (blocks.centre, blocks.attitude, blocks.spin):
        yield np.array([where(name) for name in names], dtype=Index)
