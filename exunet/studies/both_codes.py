"""A case in exunet and in the reference, each with its own reader, weave and integration.

The two codes share the case file and nothing else.
"""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import reference_impl as reference
from exunet.base.arrays import Floats, Ints
from exunet.base.errors import InputError
from exunet.base.run_events import ElementBreak, ScriptEvent
from exunet.bodies.kinematics import first_given
from exunet.bodies.rigid import RigidStates, in_frames
from exunet.bodies.rotations import rotation_matrix
from exunet.integrators import stepper_of
from exunet.integrators.exudyn.build import build
from exunet.integrators.exudyn.probe import Probe
from exunet.integrators.protocol import Stepper
from exunet.kernels.compile import numba_installed
from exunet.methods.method import Backend, Method, Plan
from exunet.model.effect_survey import without_choice
from exunet.model.initial import places_of_fold
from exunet.model.limits import relative_speed
from exunet.model.system import Moving, State, System
from exunet.net.closing import NAME as LINE
from exunet.results.comparison import ComparedRun, match_nodes
from exunet.scene.casefile import Case, load, located_faults
from exunet.scene.scene import Scene
from exunet.simulation.block import Observed
from exunet.simulation.integrate import Integration
from exunet.simulation.observers import Event, Observer, Observers
from exunet.simulation.preparation import Start, prepare
from reference_impl import closing
from reference_impl import forces as formulas
from reference_impl.state import Mode, layout


@dataclass(frozen=True)
class Break:
    """An element that broke, and when [s]."""

    element: int
    time: float


class RunObserver(Observer):
    """Observer of dissipated energy and broken elements.

    booked     : False if only breaks are recorded
    dissipated : energy [J] that has left the system until the last recorded state, and that prescribed bodies
                 and reels have given to it
    breaks     : broken elements in order of time
    """

    def __init__(self, system: System, state: State, *, booked: bool) -> None:
        self._booked = booked
        self.dissipated = self._at_start = system.lost_at_start + float(system.given_work(state.first_order))
        self.breaks: list[Break] = []

    def observe(self, steps: Observed) -> None:
        if steps.states.taken is not None:
            self.dissipated = self._at_start + float(steps.states.taken[-1])
        elif self._booked:
            self.dissipated += float(steps.states.work_taken().sum())

    def changed(self, event: Event) -> None:
        change = event.change
        self.dissipated += change.energy_lost or 0.0
        events = (item for item in change.events if isinstance(item, ElementBreak | ScriptEvent))
        self.breaks += [Break(item.element, event.time) for item in events if item.element is not None]


@dataclass(frozen=True, eq=False)
class Theirs:
    """States in the reference's numbering; leading axes are free.

    x, v   : (..., n, 3) of the nodes [m], [m/s]
    bodies : of its bodies
    """

    x: Floats
    v: Floats
    bodies: reference.BodyStates

    @property
    def particles(self) -> tuple[Floats, Floats]:
        """Positions and velocities (..., n + b, 3) of the nodes, then of the bodies' centres."""
        return (
            np.concatenate([self.x, self.bodies.position], axis=-2),
            np.concatenate([self.v, self.bodies.velocity], axis=-2),
        )


@dataclass(frozen=True)
class Trajectory:
    """A trajectory in exunet's numbering, by points that move with it.

    time       : (t,) [s]
    position   : (t, k, 3) [m] of the nodes, and four points of each rigid body: its centre, and the ends of
                 arms along its axes, as long as the net's size. So its attitude counts too
    velocity   : (t, k, 3) of these points [m/s]
    seen       : the same states as the reference has them, with the bodies
    steps      : number of steps
    reels      : (t, n_reels) of each, as the reference has them
    drawn      : (t, c) of the closing of the mouth, c = 0 or 1, as the reference has it
    dissipated : (t,) energy that has left the system since the start [J], less that put in by prescribed
                 bodies, reels and the closing of the mouth; None: not recorded
    breaks     : broken elements in order of time
    given      : (t, 6) impulse [N s] and angular impulse about the origin [N m s] that prescribed bodies gave
                 to all else; None: not recorded
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
    """Positions and velocities (t, k, 3) of points, and of four points of each rigid body; see `Trajectory`.

    bodies : positions and velocities (t, b, 3), attitudes (t, b, 3, 3), angular velocities in body axes
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


CLOSES = {closing.Line: ("wound_up", "work"), closing.Edge: ("part", "work")}  # names of its states here


@dataclass(frozen=True)
class BothCodes:
    """A case in both codes, with their forces at a state and the runs of either.

    All states are in exunet's numbering unless a name says otherwise.

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
        """(n_bodies,) for each rigid body of exunet the reference's of this name."""
        ours, theirs = self.start.system.blocks.rigid, self.theirs.system.bodies.names
        if set(ours) != set(theirs):
            raise InputError(f"not the same bodies: {', '.join(ours)} and {', '.join(theirs)}")
        return np.array([theirs.index(name) for name in ours], dtype=np.int64)

    @cached_property
    def reference_particles(self) -> Ints:
        """(n_points + n_rigid,) for each point and each rigid body of exunet the reference's particle."""
        return np.concatenate([self.reference_nodes, self.start.net.n_nodes + self.reference_bodies])

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
        bodies, rigid = in_frames(self.start.system.bodies, moving.bodies), self.reference_bodies
        leading, count = moving.position.shape[:-2], len(rigid)
        place, speed = np.empty((*leading, count, 3)), np.empty((*leading, count, 3))
        attitude, turning = np.empty((*leading, count, 3, 3)), np.empty((*leading, count, 3))
        place[..., rigid, :], speed[..., rigid, :] = bodies.position, bodies.velocity
        attitude[..., rigid, :, :] = rotation_matrix(bodies.attitude)
        turning[..., rigid, :] = bodies.angular_velocity
        return Theirs(
            self.to_reference(moving.position),
            self.to_reference(moving.velocity),
            reference.BodyStates(place, speed, attitude, turning),
        )

    def intact_in_reference(self, state: State) -> NDArray[np.bool_] | None:
        """(n_elements,) False for what has broken, in the reference's order; None: nothing can break."""
        carrying = self.start.system.forces.cable.carrying(state.discrete)
        if carrying is None:
            return None
        intact = np.empty(len(carrying), dtype=bool)
        intact[self.reference_elements] = carrying > 0.0
        return intact

    def wound_in_reference(self, state: State) -> reference.Wound:
        """Reels at a state, in the reference's order."""
        system, reels = self.start.system, self.theirs.system.reels
        names = () if reels is None else reels.names
        first = system.blocks.n_x - system.blocks.n_states
        wound, work = (
            np.array([state.first_order[system.blocks.state(f"{name}/{what}") - first] for name in names])
            for what in ("wound_up", "work")
        )
        held = {winding.name: winding.on_drum(state.discrete) for winding in system.forces.cable.reels}
        return reference.Wound(wound, np.array([float(held[name]) for name in names]), work)

    def drawn_in_reference(self, first_order: Floats) -> reference.Drawn:
        """Closing of the mouth in first-order states (..., n_states), as the reference has it."""
        system, names = self.start.system, CLOSES.get(type(self.theirs.system.closing), ())
        first = system.blocks.n_x - system.blocks.n_states
        found = [first_order[..., [system.blocks.state(f"{LINE}/{name}") - first]] for name in names]
        return reference.Drawn(*(found or [first_order[..., :0]] * 2))

    def rigid_of(self, seen: Theirs | reference.Trajectory) -> tuple[Floats, Floats, Floats, Floats]:
        """Return the states of the rigid bodies as `reference.BodyStates` has them, in exunet's order.

        Places and velocities (..., b, 3) of the centres of mass, attitudes (..., b, 3, 3) of the frames, and
        angular velocities (..., b, 3) in their axes.
        """
        rigid, states = self.reference_bodies, seen.bodies
        return (
            states.position[..., rigid, :],
            states.velocity[..., rigid, :],
            states.attitude[..., rigid, :, :],
            states.angular_velocity[..., rigid, :],
        )

    def in_principal_axes(self, seen: Theirs | reference.Trajectory) -> RigidStates:
        """The same as states of exunet."""
        place, speed, frame, spin = self.rigid_of(seen)
        attitude, turning = np.empty((*place.shape[:2], 4)), np.empty_like(place)
        for k, body in enumerate(self.start.system.bodies):
            attitude[:, k] = Rotation.from_matrix(frame[:, k] @ body.rotation).as_quat(scalar_first=True)
            turning[:, k] = spin[:, k] @ body.rotation
        return RigidStates(place, speed, attitude, turning)

    @property
    def effects(self) -> set[str]:
        """Names of the active effects."""
        return set(self.start.scene.effects.on)

    @property
    def moves_bodies(self) -> bool:
        """True if forces act on rigid bodies, or points are fixed to them."""
        system = self.start.system
        return bool(system.driven.any()) or bool(system.kinematics)

    @property
    def closes(self) -> bool:
        """True if the mouth of the net can close."""
        return self.theirs.system.closing is not None

    @property
    def touches_itself(self) -> bool:
        """True if threads of the net touch each other."""
        return self.theirs.system.meeting is not None

    @property
    def in_contact(self) -> bool:
        """True if the net touches bodies."""
        return self.theirs.system.contacts is not None

    @property
    def speed(self) -> float:
        """See `relative_speed`."""
        return relative_speed(self.start.system, self.start.state)

    @property
    def size(self) -> float:
        """See `Net.size`."""
        return self.start.net.size

    def reference_motion(self, state: State) -> tuple[Floats, float]:
        """The reference's accelerations at a state [m/s2], and the power that its forces take out [W].

        (n_points + n_rigid, 3) of the points, then of the centres of rigid bodies. The power that prescribed
        bodies, drums and the closing of the mouth put in is not included.
        """
        response = self.reference_response(state)[1]
        parts = [response.power, float(response.given[:, 6].sum()), float(response.reeling[1].sum())]
        parts.append(float(response.drawing[1:].sum()))
        power = sum(parts)
        if abs(power) <= CANCELLED * max(map(abs, parts)):
            power = 0.0
        return response.acceleration[self.reference_particles], power

    def reference_response(self, state: State) -> tuple[formulas.Whole, formulas.Response]:
        """The reference's own state of all particles and bodies, and what its forces do to them.

        Points of bodies follow from the states of these, not from their own.
        """
        system, theirs = self.theirs.system, self.theirs_at(state.moving)
        lay = layout(system)
        packed = lay.pack(theirs.x, theirs.v, theirs.bodies, state.time)
        lay.drawn(packed).amount[:] = self.drawn_in_reference(state.first_order).amount
        whole = lay.whole(packed)
        return whole, formulas.response(system, state.time, whole, Mode(self.intact_in_reference(state)))

    def probe(self) -> Probe:
        """The engine's equations of motion."""
        return Probe(build(self.start.system, self.start.state, Plan(Method.RK44)))

    def on_backend(self, backend: Backend) -> BothCodes:
        """The same case on a backend; the compiled loop needs Numba to run."""
        start = replace(self.start, plan=replace(self.start.plan, backend=backend))
        return replace(self, name=f"{self.name}, {backend}", start=start)

    def fastest(self) -> BothCodes:
        """The case for many runs: on the compiled loop, or as it is where Numba is not installed."""
        return self.on_backend(Backend.COMPILED) if numba_installed() else self

    def from_state(self, position: Floats, velocity: Floats, bodies: RigidStates | None = None) -> BothCodes:
        """The same case started from another state of the free points, and of the rigid bodies if given.

        position, velocity : (n_points, 3); points of bodies are where these put them
        """
        fixed = self.start.net.fixed_nodes
        position, velocity = position.copy(), velocity.copy()
        position[fixed], velocity[fixed] = self.start.position[fixed], 0.0
        start = self.start
        if bodies is not None:
            start = replace(start, state=replace(start.state, bodies=bodies))
        return replace(self, start=start.moved(position, velocity))

    def run_exunet(self, times: Floats, plan: Plan | None = None, *, booked: bool = False) -> Trajectory:
        """exunet's trajectory at `times` (from 0 on), with the plan of the case or another.

        By Exudyn, or by the compiled loop in that form. booked: record the dissipated energy.
        Raises IntegrationFailed if the integrator fails.
        """
        start, backend = self.start, self.start.plan.backend
        start = start if plan is None else replace(start, plan=replace(plan, backend=backend))
        observer = RunObserver(start.system, start.state, booked=booked)

        def make(state: State, plan: Plan) -> Stepper:
            return stepper_of(start.system, state, plan)

        states, left, reels = (
            [start.state.moving],
            [observer.dissipated],
            [self.wound_in_reference(start.state)],
        )

        def keep() -> None:
            if booked:
                run.settle()
                left.append(observer.dissipated)
            state = run.stepper.state()
            states.append(state.moving)
            reels.append(self.wound_in_reference(state))

        observers = Observers(start.system, start.state, {"both": observer})
        run = Integration(start.plan, make, observers)
        run.go(times[1:].tolist(), keep)
        x, v, first_order = (
            np.array([getattr(state, name) for state in states])
            for name in ("position", "velocity", "first_order")
        )
        parts = zip(*(state.bodies.parts() for state in states), strict=True)
        bodies = RigidStates(*(np.array(part) for part in parts))
        seen = self.theirs_at(Moving(x, v, bodies, first_order))
        arms = with_arms((x, v), self.rigid_of(seen), self.size)
        energy = np.array(left) - start.system.given_work(first_order) if booked else None
        wound = reference.Wound(
            *(np.array([getattr(reel, name) for reel in reels]) for name in ("wound_up", "held", "work"))
        )
        steps, breaks = run.counts.steps, tuple(observer.breaks)
        given = self._given(first_order)
        drawn = self.drawn_in_reference(first_order)
        return Trajectory(np.asarray(times), *arms, seen, steps, wound, drawn, energy, breaks, given)

    def run_reference(self, times: Floats, **how: Any) -> Trajectory:
        """The reference's trajectory at `times` (from 0 on); `how` as in reference_impl.integration."""
        return self._seen(self.reference_trajectory(times, **how))

    def _seen(self, found: reference.Trajectory) -> Trajectory:
        """A trajectory of the reference in exunet's numbering."""
        seen = Theirs(found.x, found.v, found.bodies)
        nodes = self.from_reference(found.x), self.from_reference(found.v)
        arms = with_arms(nodes, self.rigid_of(seen), self.size)
        ours = np.argsort(self.reference_elements)  # exunet's element of each of the reference's
        breaks = tuple(Break(int(ours[item.element]), item.time) for item in found.breaks)
        given = np.concatenate([found.given.impulse, found.given.angular_impulse], axis=-1).sum(axis=1)
        wound, drawn, left, steps = found.reels, found.drawn, found.dissipated, found.n_steps
        return Trajectory(found.t, *arms, seen, steps, wound, drawn, left, breaks, given)

    def _given(self, first_order: Floats) -> Floats:
        """(t, 6) impulses and angular impulses of all prescribed bodies, from states (t, n_states)."""
        system = self.start.system
        first = system.blocks.n_x - system.blocks.n_states
        found = np.zeros((len(first_order), 6))
        for body, free in zip(system.bodies, system.moves_freely, strict=True):
            if not free:
                at = system.blocks.state(first_given(body.name)) - first
                found += first_order[:, at : at + 6]
        return found

    def reference_trajectory(self, times: Sequence[float] | Floats, **how: Any) -> reference.Trajectory:
        """The reference's trajectory in its own numbering, with its counts."""
        start = self.theirs_at(self.start.state.moving)
        return reference.integrate(self.theirs.system, start.x, start.v, times, **how, bodies=start.bodies)


def _at_start(net: Any, position: Floats, velocity: Floats) -> ComparedRun:
    """position, velocity : of the nodes, and of whatever comes after them"""
    n = len(net.mass)
    return ComparedRun.of_net(net, np.zeros(1), position[None, :n], velocity[None, :n])


CANCELLED = 8.0 * float(np.finfo(float).eps)  # part of the largest of some powers that cancel to round-off


def coordinates(nodes: Ints) -> Ints:
    """(3n,) rows of the nodes (n,) in matrices that count three coordinates a node."""
    return np.asarray((3 * nodes[:, None] + np.arange(3)).ravel())


class NotCovered(InputError):
    """Case that the reference does not cover."""


def read_both(path: str | Path, overrides: Sequence[str] = ()) -> BothCodes:
    """The case at `path` in both codes.

    overrides : "key=value" as after `--set`
    Raises CaseError if exunet cannot read it, and NotCovered with what the reference does not cover: such
    a case is never compared in part.
    """
    case = load(path, overrides)
    with located_faults(case):
        return both_of(case)


def both_of(case: Case) -> BothCodes:
    """As `read_both`, of a case that exunet has read."""
    # Exudyn states the law element by element; see `BothCodes.on_backend` for the compiled loop.
    engine = case.scene.engine.model_copy(update={"backend": Backend.EXUDYN})
    start = prepare(case.scene.model_copy(update={"engine": engine}))
    try:
        read = _read_by_reference(case, start.scene)
        if places := places_of_fold(start.scene):
            read = reference.with_places(read, *places)
        theirs = reference.prepare(read)
    except reference.Refused as refused:
        message = f"{case.name}: the reference does not cover this case: {_reasons(refused)}"
        raise NotCovered(message) from refused
    return BothCodes(case.name, case.path, start, theirs)


def refusal(case: Case, scene: Scene) -> str:
    """Why the reference does not read a case; empty: it does.

    scene : of the case, with its choice of effects made
    """
    try:
        _read_by_reference(case, scene)
    except reference.Refused as refused:
        return _reasons(refused)
    return ""


def _read_by_reference(case: Case, scene: Scene) -> Any:
    overrides = (*case.overrides, *without_choice(case.scene, scene))
    return reference.read(case.path, dict(map(reference.parse_override, overrides)))


def _reasons(refused: reference.Refused) -> str:
    return "; ".join(fault.replace("\n", " ") for fault in refused.faults[:5])


def both_of_text(name: str, text: str) -> BothCodes:
    """As `read_both`, of a case without a file."""
    with tempfile.TemporaryDirectory(prefix="exunet-verify-") as folder:
        path = Path(folder) / f"{name}.toml"
        path.write_text(text, encoding="utf-8")
        return read_both(path)
