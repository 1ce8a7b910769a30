"""One case in both codes: read by each with its own reader, woven by each, and run by either.

Here, in `matched_codes` and in `both_trajectories` exunet imports reference_impl. The two share the case file
and nothing else.
"""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import reference_impl as reference
from exunet.backends import integrator
from exunet.backends.exudyn.build import build
from exunet.backends.exudyn.probe import Probe
from exunet.base.errors import InputError
from exunet.bodies.kinematics import first_given
from exunet.bodies.rigid import RigidStates
from exunet.case.casefile import Case, load, located_faults
from exunet.case.scene import Scene
from exunet.codegen.compile import numba_installed
from exunet.forces.effects import switched_on
from exunet.methods.method import Form, Method, NetForm
from exunet.methods.plan import Plan
from exunet.simulation.preparation import prepare
from exunet.studies.books import Break, RunBooks
from exunet.studies.both_trajectories import Theirs, Trajectory, with_arms
from exunet.studies.matched_codes import Matched
from exunet.studies.neighbours import launch_speed
from exunet.system.effect_survey import without_choice
from exunet.system.initial import places_of_fold
from exunet.system.system import Moving, State
from reference_impl import forces as formulas
from reference_impl.mode import Mode
from reference_impl.state import layout

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

CANCELLED = 8.0 * float(np.finfo(float).eps)  # part of the largest of some powers that cancel to round-off


@dataclass(frozen=True)
class BothCodes(Matched):
    """A case as both codes see it, to be run by either, and asked what its forces do; see `Matched`."""

    @property
    def effects(self) -> set[str]:
        """Names of the effects that the case switches on."""
        return set(switched_on(self.start.scene.effects))

    @property
    def moves_bodies(self) -> bool:
        """True if forces act on rigid bodies, or points are fixed to them."""
        system = self.start.system
        return bool(system.driven.any()) or bool(system.kinematics)

    @property
    def closes(self) -> bool:
        """True if something closes the mouth of the net."""
        return self.theirs.system.closing is not None

    @property
    def touches_itself(self) -> bool:
        """True if threads of the net touch each other."""
        return self.theirs.system.meeting is not None

    @property
    def speed(self) -> float:
        """See `launch_speed`."""
        return launch_speed(self.start.velocity)

    @property
    def breaks_at_once(self) -> bool:
        """True if an element is beyond its limit at the start.

        It breaks there in the reference, and at the end of the first step in exunet.
        """
        cable, state = self.start.system.forces.cable, self.start.state
        if cable.switch is None:
            return False
        x, v = self.start.system.layout.pack(state.moving)
        return len(cable.switch.crossed(0.0, x, v, np.ones(self.start.net.n_elements))) > 0

    @property
    def size(self) -> float:
        """See `Net.size`."""
        return self.start.net.size

    def reference_motion(self, state: State) -> tuple[Floats, float]:
        """The reference's accelerations at a state [m/s2], and the power that its forces take out [W].

        (n_points + n_rigid, 3) of the points, then of the centres of rigid bodies. What driven bodies and
        drums, or what closes the mouth, put in is no part of it.
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

        Points of bodies are where its levers put them, whatever the state says of them.
        """
        system, theirs = self.theirs.system, self.theirs_at(state.moving)
        lay = layout(system)
        packed = lay.pack(theirs.x, theirs.v, theirs.bodies, state.time)
        lay.drawn(packed).amount[:] = self.drawn_in_reference(state.first_order).amount
        whole = lay.whole(packed)
        return whole, formulas.response(system, state.time, whole, Mode(self.intact_in_reference(state)))

    def probe(self) -> Probe:
        """The engine's equations of motion, in the form that also has derivatives."""
        implicit = Plan(Method.GENERALIZED_ALPHA, step=1e-6)
        fused = self.start.scene.engine.net == NetForm.FUSED
        return Probe(build(self.start.system, self.start.state, implicit, fused=fused))

    def in_form(self, form: Form) -> BothCodes:
        """The same case with the engine's fused net, or by exunet's compiled loop; needs Numba to run."""
        start = replace(self.start, scene=_with_form(self.start.scene, form))
        return replace(self, name=f"{self.name}, {form.name.lower()}", start=start)

    def fastest(self) -> BothCodes:
        """The form of the case for many runs: compiled, or this one where Numba is not installed."""
        return self.in_form(Form.COMPILED) if numba_installed() else self

    def from_state(self, position: Floats, velocity: Floats, bodies: RigidStates | None = None) -> BothCodes:
        """The same case started from another state of the free points, and of the rigid bodies if given.

        position, velocity : (n_points, 3), or (n_nodes, 3): point masses then start as they do. Points of
        bodies are where these put them
        """
        fixed = self.start.net.fixed_nodes
        position = np.concatenate([position, self.start.position[len(position) :]])
        velocity = np.concatenate([velocity, self.start.velocity[len(velocity) :]])
        position[fixed], velocity[fixed] = self.start.position[fixed], 0.0
        start = self.start
        if bodies is not None:
            start = replace(start, state=replace(start.state, bodies=bodies))
        return replace(self, start=start.moved(position, velocity))

    def run_exunet(self, times: Floats, plan: Plan | None = None, *, booked: bool = False) -> Trajectory:
        """exunet's trajectory at `times` (from 0 on), with the plan of the case or another.

        By Exudyn, or by the compiled loop where the case is `compiled`. booked: with the dissipated energy.
        Raises IntegrationFailed where it gives up.
        """
        start = replace(self.start, plan=plan or self.start.plan)
        books = RunBooks(start.system, start.state, booked=booked)
        stepper = integrator(start.scene.engine, start.system, start.state, start.plan, books)
        states, left, reels = [start.state.moving], [books.dissipated], [self.wound_in_reference(start.state)]
        for until in times[1:].tolist():
            stepper.advance(until)
            if booked:
                stepper.hand_over()
                left.append(books.dissipated)
            state = stepper.state()
            states.append(state.moving)
            reels.append(self.wound_in_reference(state))
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
            *(np.array([getattr(one, name) for one in reels]) for name in ("wound_up", "held", "work"))
        )
        steps, breaks = stepper.counts.steps, tuple(books.breaks)
        given = self._given(first_order)
        drawn = self.drawn_in_reference(first_order)
        return Trajectory(np.asarray(times), *arms, seen, steps, wound, drawn, energy, breaks, given)

    def run_reference(self, times: Floats, **how: Any) -> Trajectory:
        """The reference's trajectory at `times` (from 0 on); `how` as in reference_impl.integration."""
        found = self.reference_trajectory(times, **how)
        seen = Theirs(found.x, found.v, found.bodies)
        arms = with_arms(self.points_of(found), self.rigid_of(seen), self.size)
        ours = np.argsort(self.reference_elements)  # exunet's element of each of the reference's
        breaks = tuple(Break(int(ours[one.element]), one.time) for one in found.breaks)
        given = np.concatenate([found.given.impulse, found.given.angular_impulse], axis=-1).sum(axis=1)
        wound, drawn, left, steps = found.reels, found.drawn, found.dissipated, found.n_steps
        return Trajectory(found.t, *arms, seen, steps, wound, drawn, left, breaks, given)

    def _given(self, first_order: Floats) -> Floats:
        """(t, 6) impulses and angular impulses of all guided bodies, from states (t, n_states)."""
        system = self.start.system
        first = system.blocks.n_x - system.blocks.n_states
        found = np.zeros((len(first_order), 6))
        for body, free in zip(system.bodies, system.moves_freely, strict=True):
            if not free:
                at = system.blocks.state(first_given(body.name)) - first
                found += first_order[:, at : at + 6]
        return found

    def reference_trajectory(self, times: Sequence[float] | Floats, **how: Any) -> reference.Trajectory:
        """The same as the reference gives it, in its own numbering and with its counts."""
        start = self.theirs_at(self.start.state.moving)
        return reference.integrate(self.theirs.system, start.x, start.v, times, **how, bodies=start.bodies)


def coordinates(nodes: Ints) -> Ints:
    """(3n,) rows of the nodes (n,) in matrices that count three coordinates a node."""
    return np.asarray((3 * nodes[:, None] + np.arange(3)).ravel())


def _with_form(scene: Scene, form: Form) -> Scene:
    return scene.model_copy(update={"engine": scene.engine.model_copy(update=form.engine)})


class NotCovered(InputError):
    """There is nothing to compare a case with."""


def read_both(path: str | Path, overrides: Sequence[str] = ()) -> BothCodes:
    """The case at `path` in both codes.

    overrides : "key=value" as after `--set`
    Raises CaseError if exunet cannot read it, and InputError naming what the reference does not know: such
    a case is never compared in part.
    """
    case = load(path, overrides)
    with located_faults(case):
        return both_of(case)


def both_of(case: Case) -> BothCodes:
    """As `read_both`, of a case that exunet has read."""
    # The form that states the law element by element; see `BothCodes.in_form` for the others.
    start = prepare(_with_form(case.scene, Form.CONNECTORS))
    try:
        read = _read_by_reference(case, start.scene)
        if places := places_of_fold(start.scene):
            read = reference.with_places(read, *places)
        theirs = reference.prepare(read)
    except reference.Refused as refused:
        words = f"the reference does not cover this case, so nothing is compared: {_reasons(refused)}"
        raise NotCovered(f"{case.name}: {words}") from refused
    return BothCodes(case.name, case.path, start, theirs)


def refusal(case: Case, scene: Scene) -> str:
    """Why the reference does not read a case, before it prepares anything; empty: it does.

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
    """As `read_both`, of a case that is not a file."""
    with tempfile.TemporaryDirectory(prefix="exunet-verify-") as folder:
        path = Path(folder) / f"{name}.toml"
        path.write_text(text, encoding="utf-8")
        return read_both(path)
