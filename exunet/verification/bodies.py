"""Bodies, tethers and reels of both codes at random states."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from exunet.bodies.rigid import RigidStates
from exunet.bodies.rotations import rotation_matrix
from exunet.forces.from_outside import IMPULSE, OUTSIDE, effects_of
from exunet.integrators.compiled.loop import loop_kernel
from exunet.integrators.compiled.workspace import Stages, motion_of
from exunet.kernels.compile import numba_installed
from exunet.methods.method import Backend, Method, Plan
from exunet.model.ejection import HELD
from exunet.model.stability import largest_damping_rate, largest_frequency
from exunet.model.system import State, System
from exunet.studies.both_codes import BothCodes, Floats, read_both
from exunet.verification.balances import converged
from exunet.verification.check import Check, Evidence, difference, shipped, worst_of
from exunet.verification.horizon import growth, sensitivity
from exunet.verification.one_step import one_step_from
from exunet.verification.states import measures, random_instants
from exunet.verification.tolerances import BODY_FORCES, BODY_PLACES
from exunet.verification.topology import topology
from reference_impl.bodies import turning_rate

BODY_CASES = "verification/bodies"  # of the known answers, below cases/
# Ends [s] of whole runs, where the reference takes minutes for the rest: threads that chatter against viscous
# stress; a taut tether for 24 s, of which the known answers have each command of its reel.
ENDS = {"bodies_frame": 0.5, "bodies_tow": 4.0}


@dataclass(frozen=True)
class BodyScene:
    """A scene with bodies, which is read when it is first looked at.

    name  : of its rows and figures
    path  : of the case file
    whole : it is followed over whole runs, and not by its known answer alone
    given : the case, where it is read already
    """

    name: str
    path: Path
    whole: bool = True
    given: BothCodes | None = None

    @cached_property
    def case(self) -> BothCodes:
        """In both codes, under this name."""
        return replace(self.given or read_both(self.path), name=self.name)

    def at_states(self, states_of_a_kind: int) -> Iterator[Check]:
        """Masses and start; random states: accelerations, books, what is attached, energies, one step."""
        yield from topology(self.case)
        yield from motions(self.case, states_of_a_kind)
        yield from lines(self.case, states_of_a_kind)
        yield from placed(self.case, states_of_a_kind)
        yield from measures(self.case, states_of_a_kind)
        yield from one_step(self.case)

    def trajectories(self) -> Iterator[Evidence]:
        """Rungs 5 and 7 for this scene, with its balances until the horizon, or until its entry of `ENDS`."""
        grown = growth(self.case, ENDS.get(self.name))
        yield from sensitivity(self.case, grown)
        yield from converged(self.case, grown)


def body_scenes(named: Sequence[BothCodes]) -> list[BodyScene]:
    """The named cases, those of cases/bodies/ that are not among them, and those of the known answers."""
    there = {case.path.resolve() for case in named}
    found = [BodyScene(case.name, case.path, given=case) for case in named]
    for folder, whole in (("bodies", True), (BODY_CASES, False)):
        for name, path in shipped(folder).items():
            if path.resolve() not in there:
                found.append(BodyScene(f"bodies_{name}" if whole else name, path, whole))
    return found


SEED = 20210622
SHORT = 1e-3  # [rad] of the fastest rate in a step
STATES = 30  # of each kind
# How far from the origin bodies are, as parts of the scene's extent at the start. Close ones leave tethers
# between them slack, so that what is left are the effects and the gyroscopic torques.
KINDS = {"packed": 0.02, "slack": 0.2, "overstretched": 1.0, "crumpled": 0.5}
IMPLIED = {"place of attached nodes": "m", "velocity of attached nodes": "m/s"}
UNITS = {"acceleration of points": "m/s2", "acceleration of bodies": "m/s2", "angular acceleration": "rad/s2"}


@dataclass(frozen=True, eq=False)
class Changes:
    """How points and free bodies change at a state, in exunet's order and in the scene's axes.

    points  : (n_points, 3) accelerations [m/s2]; zero for those without a motion of their own
    centres : (n_bodies, 3) accelerations of the centres of mass [m/s2]
    angular : (n_bodies, 3) angular accelerations [rad/s2]
    """

    points: Floats
    centres: Floats
    angular: Floats

    def named(self) -> dict[str, Floats]:
        """In the order of `UNITS`."""
        return dict(zip(UNITS, (self.points, self.centres, self.angular), strict=True))


def random_bodies(case: BothCodes, kind: str, count: int, random: np.random.Generator) -> Iterator[State]:
    """`random_instants`, with the bodies as far apart as `KINDS` says, turning with up to some rad/s."""
    start = case.start
    everything = np.concatenate([start.position, start.state.bodies.position])
    reach = KINDS[kind] * float(np.ptp(everything, axis=0).max())
    for state in random_instants(start, kind, count, random):
        bodies = replace(state.bodies, position=reach * state.bodies.position)
        yield _with_packed_net(start.system, replace(state, bodies=bodies))


def _with_packed_net(system: System, state: State) -> State:
    """A net that a body holds is packed there: the engine's items within it see the distances as they are."""
    for held in system.kinematics.held:
        if held.memory == HELD and (nodes := held.points[: held.number(state.memory)]).size:
            moving = state.moving.completed(system.kinematics, state.time, state.memory)
            position, velocity = state.position.copy(), state.velocity.copy()
            position[nodes], velocity[nodes] = moving.position[nodes], moving.velocity[nodes]
            state = replace(state, position=position, velocity=velocity)
    return state


def motions(case: BothCodes, states_of_a_kind: int = STATES) -> Iterator[Check]:
    """Accelerations of points and of bodies, and angular ones, of each form of exunet and the reference.

    Points that are fixed to bodies are anywhere in these states; each code puts them where they belong. Of
    each quantity the kind of state that differs most is told; differences of angular accelerations are parts
    of the largest square of an angular velocity, if that is more.
    """
    for name, changes_at in _forms(case):
        found: dict[str, list[Check]] = {quantity: [] for quantity in UNITS}
        random = np.random.default_rng(SEED)
        for kind in KINDS:
            ours, theirs, spins = [], [], []
            for state in random_bodies(case, kind, states_of_a_kind, random):
                ours.append(changes_at(state).named())
                theirs.append(_of_reference(case, state).named())
                spins.append(state.bodies.angular_velocity)
            least = {"angular acceleration": float(np.square(spins).max(initial=0.0))}
            for quantity, unit in UNITS.items():
                a, b = (np.array([item[quantity] for item in side]) for side in (ours, theirs))
                what = "node" if quantity.endswith("points") else "body"
                axes, floor = ("state", what, "xyz"), least.get(quantity, 0.0)
                found[quantity].append(difference(kind, a, b, BODY_FORCES, axes, unit, floor))
        for quantity, checks in found.items():
            if quantity.endswith("points") or case.start.system.moves_freely.any():
                yield worst_of(f"{quantity}, {name}, {states_of_a_kind * len(KINDS)} random states", checks)


def placed(case: BothCodes, states_of_a_kind: int = STATES) -> Iterator[Check]:
    """Where points that are fixed to bodies are, and how they move; nothing for a case without."""
    if not len(case.start.system.kinematics.point):
        return
    found: dict[str, list[Check]] = {}
    random, by_kernel = np.random.default_rng(SEED), _by_kernel(case) if numba_installed() else None
    for kind in KINDS:
        states = list(random_bodies(case, kind, states_of_a_kind, random))
        known = [_by_levers(case, state) for state in states]
        ways = {"arrays": [_completed(case, state) for state in states]}
        if by_kernel is not None:
            ways["compiled"] = [by_kernel(state) for state in states]
        for way, ours in ways.items():
            for part, (name, unit) in enumerate(IMPLIED.items()):
                a, b = (np.array([item[part] for item in side]) for side in (ours, known))
                check = difference(kind, a, b, BODY_PLACES, ("state", "number", "xyz"), unit)
                found.setdefault(f"{name}, {way}", []).append(check)
    for name, checks in found.items():
        yield worst_of(f"{name}, {states_of_a_kind * len(KINDS)} random states", checks)


def lines(case: BothCodes, states_of_a_kind: int = STATES) -> Iterator[Check]:
    """The rates of all lines of the momentum books, and what the reference's accelerations change momenta by.

    Nothing for a case whose effects have no lines, or with points that a body holds for a while: their shares
    are not among the accelerations. Differences are parts of the sum of the shares' sizes.
    """
    system = case.start.system
    effects = effects_of(item.name for item in system.blocks.states)
    if not effects or system.kinematics.held or not numba_installed():
        return
    guided = [body.name for body, free in zip(system.bodies, system.moves_freely, strict=True) if not free]
    rates_at = _rates_of([*(OUTSIDE + name for name in effects), *guided], system)
    random = np.random.default_rng(SEED)
    found: list[list[Check]] = [[], []]
    for kind in KINDS:
        states = list(random_bodies(case, kind, states_of_a_kind, random))
        ours = np.array([rates_at(state) for state in states])
        shares = [_shares_of_reference(case, state) for state in states]
        for part, unit in enumerate(("N", "N m")):
            theirs = np.array([share[part].sum(axis=0) for share in shares])
            size = max(float(np.linalg.norm(entry[part], axis=1).sum()) for entry in shares)
            known = ours[:, 3 * part : 3 * part + 3]
            found[part].append(difference(kind, known, theirs, BODY_FORCES, ("state", "xyz"), unit, size))
    for name, checks in zip(("impulse", "angular impulse"), found, strict=True):
        yield worst_of(f"rate of {name}, {states_of_a_kind * len(KINDS)} random states", checks)


def _rates_of(names: list[str], system: System) -> Callable[[State], Floats]:
    """(6,) of impulse and angular impulse about the origin, of all together, in the compiled loop."""
    kernel, a1 = loop_kernel(system), Stages._fields.index("a1")
    first = [system.blocks.rate(f"{name}/{IMPULSE}") for name in names]

    def rates(state: State) -> Floats:
        motion = motion_of(system, state, kernel.table(state.memory))
        kernel.module.begin(state.time, False, motion)
        return np.sum([motion.work[a1, at : at + 6] for at in first], axis=0)

    return rates


def _shares_of_reference(case: BothCodes, state: State) -> tuple[Floats, Floats]:
    """Rates of momentum [N], and of angular momentum about the origin [N m], by nodes and free bodies."""
    system, bodies = case.theirs.system, case.theirs.system.bodies
    whole, response = case.reference_response(state)
    mass = np.append(system.net.own_mass, bodies.free * bodies.mass)
    force = mass[:, None] * response.acceleration
    torque = bodies.free[bodies.rigid][:, None] * response.torque
    return force, np.concatenate([np.cross(whole.x, force), torque])


def one_step(case: BothCodes) -> Iterator[Check]:
    """One step of RK44, and the same with the reference's forces, from random states in every form.

    The codes turn bodies by rotation vectors, quaternions and matrices, so the schemes are the same only but
    for terms of order h^5; the step is so short that these are below round-off. Bodies are turned at random:
    a rotation vector of the engine that begins near zero has an error of a last bit over its length.
    """
    random, system = np.random.default_rng(SEED), case.start.system
    states = {kind: next(random_bodies(case, kind, 1, random)) for kind in KINDS}
    forms = [case, *([case.on_backend(Backend.COMPILED)] if numba_installed() else [])]
    for kind, state in states.items():
        turned = np.abs(_of_reference(case, state).angular).max(initial=0.0)
        spin = np.abs(state.bodies.angular_velocity).max(initial=0.0)
        fastest = max(largest_frequency(system), largest_damping_rate(system), spin, math.sqrt(turned))
        starts = {
            f"{kind}, {form.name}": form.from_state(state.position, state.velocity, state.bodies)
            for form in forms
        }
        yield worst_of(f"one step, {kind}", one_step_from(starts, Plan(Method.RK44, step=SHORT / fastest)))


def _forms(case: BothCodes) -> Iterator[tuple[str, Callable[[State], Changes]]]:
    """The forms of exunet that are installed, and how each changes a state."""
    yield "exudyn", _of_engine(case)
    if numba_installed():
        yield "compiled", _of_loop(case.start.system)


def _of_engine(case: BothCodes) -> Callable[[State], Changes]:
    probe, system = case.probe(), case.start.system

    def changes(state: State) -> Changes:
        if state.memory:
            probe.remember(system, state.memory)
        points, bodies = probe.motion(state.moving, state.time)
        return _changes(system, state.bodies, points, bodies[:, :3], bodies[:, 3:])

    return changes


def _of_loop(system: System) -> Callable[[State], Changes]:
    """The accelerations from which the compiled loop steps on."""
    kernel = loop_kernel(system)

    def changes(state: State) -> Changes:
        motion = motion_of(system, state, kernel.table(state.memory))
        kernel.module.begin(state.time, False, motion)
        rates = motion.work[Stages._fields.index("a1"), : system.blocks.n_v]
        points, centres, angular = np.split(rates, (3 * system.blocks.n_points, system.blocks.centres))
        return _changes(system, state.bodies, *(part.reshape(-1, 3) for part in (points, centres, angular)))

    return changes


def _changes(
    system: System, bodies: RigidStates, points: Floats, centres: Floats, angular: Floats
) -> Changes:
    """angular : (n_free_bodies, 3) or more, in principal axes; bodies whose motion is given are left out."""
    free = np.flatnonzero(system.moves_freely)
    points = points * system.free[:, None]
    turn = rotation_matrix(bodies.attitude[free])
    return Changes(points, centres[free], np.einsum("bij,bj->bi", turn, angular[free]))


def _of_reference(case: BothCodes, state: State) -> Changes:
    system, theirs = case.start.system, case.theirs.system
    whole, response = case.reference_response(state)
    moved = response.acceleration[case.reference_particles]
    angular = turning_rate(whole.attitude, whole.spin, response.torque, theirs.bodies)
    free, n = np.flatnonzero(system.moves_freely), system.blocks.n_points
    return Changes(moved[:n] * system.free[:, None], moved[n:][free], angular[case.reference_rigid][free])


def _completed(case: BothCodes, state: State) -> tuple[Floats, Floats]:
    """Places and velocities (n_attached, 3) by whole arrays, as the states of a result are made."""
    kinematics = case.start.system.kinematics
    moving = state.moving.completed(kinematics, state.time, state.memory)
    point = kinematics.point
    return moving.position[point], moving.velocity[point]


def _by_kernel(case: BothCodes) -> Callable[[State], tuple[Floats, Floats]]:
    """The same as the compiled loop has them."""
    system = case.start.system
    kernel, point = loop_kernel(system), system.kinematics.point

    def implied(state: State) -> tuple[Floats, Floats]:
        motion = motion_of(system, state, kernel.table(state.memory))
        kernel.module.begin(state.time, False, motion)
        moving = system.layout.unpack(motion.x, motion.v)
        return moving.position[point], moving.velocity[point]

    return implied


def _by_levers(case: BothCodes, state: State) -> tuple[Floats, Floats]:
    """The same by the reference."""
    whole, _ = case.reference_response(state)
    nodes = case.reference_nodes[case.start.system.kinematics.point]
    return whole.x[nodes], whole.v[nodes]
