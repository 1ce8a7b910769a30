"""Build the model, initial state and integration plan of a case, perhaps from the state of another run."""

from __future__ import annotations

import hashlib
import math
import re
from collections.abc import Callable, Iterable, Iterator, Sequence, Set
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NoReturn

import numpy as np

from exunet.base.arguments import ShortRepr, shown
from exunet.base.arrays import Floats
from exunet.base.errors import CaseError, Fault, InputError, collected
from exunet.bodies.rigid import RigidStates
from exunet.bodies.touched import grooves
from exunet.forces.blocks import Blocks, FirstOrder
from exunet.forces.corner_units import STATE_NAME, Function, with_function
from exunet.forces.effects.contact import Contact
from exunet.forces.effects.rayleigh_damping import RayleighDamping
from exunet.forces.effects.self_contact import SelfContact
from exunet.forces.from_outside import SCRIPT, counted, effects_of
from exunet.forces.from_outside import states_of as impulses_of
from exunet.forces.on_bodies import wrench_on
from exunet.forces.terms import KernelTerm
from exunet.kernels.compile import require_numba
from exunet.methods.method import METHODS, Backend, Kind, Method, Plan
from exunet.model.build import system_of
from exunet.model.effect_survey import chosen
from exunet.model.initial import KEY, Restart, RestartBody
from exunet.model.limits import (
    body_faults,
    contact_faults,
    friction_warnings,
    method_faults,
    overflow_faults,
    start_faults,
    step_faults,
    within_floats,
)
from exunet.model.system import OF_BODY, State, System
from exunet.net.arrays import Net
from exunet.results.io import RESULT_FILE, load_result
from exunet.results.loads import broken_at, released_at
from exunet.results.result import Result
from exunet.results.run_record import RestartSource, RunRecord
from exunet.scene.casefile import Case, case_of, located_faults
from exunet.scene.plausibility import cord_notes, damping_note, place_notes
from exunet.scene.scene import Scene
from exunet.simulation.controller import function_named
from exunet.simulation.planning import make_plan, with_backend, with_pilots

_NAMED = re.compile(r"(.+?)(?:@(end|[-+0-9.eE]+))?", re.DOTALL)
_SAME = 1e-9  # [s], round-off of a stored time in decimals


@dataclass(frozen=True, eq=False)
class Source:
    """Restart with its origin.

    origin : file, stored time [s], hash of the file
    """

    restart: Restart
    origin: RestartSource


def load_restart(named: str) -> Source:
    """Read the state that "RESULT@TIME" names: a result file or the folder of a run, and a stored time.

    Without a time, or with "@end", the last state. Raises CaseError for an unknown state, or one from
    which a case cannot start.
    """
    parts = _NAMED.fullmatch(named)
    assert parts is not None
    path = Path(parts[1])
    try:
        if path.is_dir() and not (path / RESULT_FILE).is_file():
            _refuse(f"{path}: {RESULT_FILE} is missing: end the run with exunet resume")
        result = load_result(path)
        file = path / RESULT_FILE if path.is_dir() else path
        with file.open("rb") as content:  # which may be larger than memory
            digest = hashlib.file_digest(content, "sha256").hexdigest()
        row = _row(result, parts[2], path)
        restart = _state(result, row, path)
    except InputError as error:
        if isinstance(error, CaseError):
            raise
        _refuse(str(error))
    time = float(result.time[row])
    return Source(restart, RestartSource(str(file), time, digest, list(restart.broken)))


def _refuse(words: str) -> NoReturn:
    raise CaseError([Fault(KEY, words)])


def _row(result: Result, time_text: str | None, path: Path) -> int:
    """Return the number of a stored time."""
    if time_text is None or time_text == "end":
        return len(result.time) - 1
    try:
        time = float(time_text)
    except ValueError:
        time = math.inf
    if not math.isfinite(time):
        _refuse(f"{path}: after @ must be a stored time in seconds, or end, got {time_text!r}")
    row = int(np.argmin(np.abs(result.time - time)))
    if abs(result.time[row] - time) > _SAME * max(1.0, abs(time)):
        words = f"no stored state at {time:g} s, the nearest is at {result.time[row]:.9g} s"
        _refuse(f"{path}: {words}: use it, or store other times (time.output_times)")
    return row


def _state(result: Result, row: int, path: Path) -> Restart:
    time, run = float(result.time[row]), result.run
    if run.carried is not None and not any(event.time_s <= time for event in run.ejections):
        _refuse(
            f"{path}: at {time:g} s a body still holds the packed net: start from a state after its ejection"
        )
    bodies = {}
    for name, body in result.bodies.items():
        parts = (getattr(body, name)[row : row + 1][0] for name in OF_BODY)
        bodies[name] = RestartBody(body.mass, body.inertia, *(np.array(part) for part in parts))
    states = {name: np.array(state.values[row : row + 1][0]) for name, state in result.states.items()}
    where = f"{path} at {time:g} s"
    place, speed = (np.array(part[row : row + 1][0]) for part in (result.position, result.velocity))
    releases = _releases(run, time)
    broken = tuple(element for element, when in broken_at(result).items() if when <= time)
    return Restart(where, result.net, place, speed, bodies, states, broken, releases)


def _releases(run: RunRecord, time: float) -> dict[str, bool]:
    """Return the attachments that a script of that run releases; True if released."""
    return {item.tie: not item.tied or released_at(run, item.tie) <= time for item in run.releases}


NO_REACTION = "launch recoil is not modelled: set initial.frame.body to the launching body"

NO_FUNCTION = (
    'the units of [control] do not fire: kind = "given" requires a Python function, '
    "Simulation(case, controller=function)"
)


@dataclass(frozen=True, eq=False, repr=False)
class Start(ShortRepr):
    """Model, initial state and integration plan of a case: plain values to print or change.

    restart : state of another run in which the case starts
    """

    scene: Scene
    system: System
    state: State
    plan: Plan
    restart: RestartSource | None = None

    @property
    def net(self) -> Net:
        return self.system.net

    @property
    def position(self) -> Floats:
        """(n_points, 3) initial positions [m]; nodes of the net come first."""
        return self.state.position

    @property
    def velocity(self) -> Floats:
        """(n_points, 3) initial velocities [m/s]."""
        return self.state.velocity

    def moved(
        self, position: Floats, velocity: Floats | None = None, bodies: RigidStates | None = None
    ) -> Start:
        """Return the start with other positions, and velocities if given, of points, and states of bodies."""
        speeds = self.velocity if velocity is None else velocity
        state = self.state.at(position, speeds)
        state = state if bodies is None else replace(state, bodies=bodies)
        moving = state.moving.completed(self.system.kinematics, state.time, state.discrete)
        return replace(self, state=State.of(state.time, moving, state.discrete))

    def with_forces(
        self,
        make: Callable[[Blocks], Iterable[KernelTerm]],
        states: tuple[FirstOrder, ...] = (),
        active: Floats | None = None,
    ) -> Start:
        """Return the start with user-defined forces.

        Parameters
        ----------
        make : callable
            Returns force terms for the numbered blocks.
        states : tuple of FirstOrder, optional
            First-order states of the forces.
        active : array, optional
            See `Blocks.active`.

        Notes
        -----
        In scenes with bodies, the momentum balance has one entry for all these forces.
        """
        mine, line = self.system.blocks, tuple[FirstOrder, ...]()
        kept = self.system.bodies and METHODS[self.plan.method].kind != Kind.IMPLICIT
        if kept and SCRIPT not in effects_of(state.name for state in mine.states):
            line = impulses_of(SCRIPT)
        blocks = replace(mine, states=(*mine.states, *states, *line), active=active)
        made = counted(SCRIPT, make(blocks), blocks) if kept else make(blocks)
        forces = replace(self.system.forces, kernels=(*self.system.forces.kernels, *made))
        system = replace(self.system, blocks=blocks, forces=forces)
        state = replace(self.state, discrete=dict(system.discrete), first_order=blocks.initial_states)
        return replace(self, system=system, state=state)

    def with_controller(self, function: Function | str) -> Start:
        """Return the start with a Python control law of the corner units (control.kind = "given").

        Parameters
        ----------
        function : callable or str
            function(time, position, velocity): at each sample the time [s], positions and velocities of the
            units (n, 3) [m], [m/s] with sensor noise; returns the commanded forces (n, 3) [N]. Or its dotted
            path "package.module:function". Snapshots restart exactly if it depends on nothing else.

        Raises
        ------
        InputError
            For a case without control.kind = "given", or for something other than a function.
        """
        control = self.scene.control
        if control is None or control.kind != "given":
            has = "no [control]" if control is None else f'control.kind = "{control.kind}"'
            raise InputError(f'controller: requires control.kind = "given", the case has {has}')
        if isinstance(function, str):
            function = function_named(function)
        if not callable(function):
            raise InputError(
                f"controller: must be a function of time, positions, velocities, got {function!r}"
            )
        forces = self.system.forces
        kernels = tuple(
            with_function(term, function)
            if (term.discrete is not None and term.discrete.name == STATE_NAME)
            else term
            for term in forces.kernels
        )
        system = replace(self.system, forces=replace(forces, kernels=kernels))
        notes = tuple(note for note in self.plan.notes if note != NO_FUNCTION)
        return replace(self, system=system, plan=replace(self.plan, notes=notes))


def prepare(scene: str | Path | Case | Scene, *, hosted: bool = False) -> Start:
    """Choose the effects, build the model, and plan the integration.

    Parameters
    ----------
    scene : Scene, Case, str or Path
        Scene, case, or name of a case file.
    hosted : bool, optional
        True if a host moves the ports of the scene.

    Raises
    ------
    CaseError
        With all faults of the model and the plan.
    InputError
        For an argument that is not a case.
    """
    if not isinstance(scene, Scene):
        return prepare_case(case_of(scene, "prepare"), hosted=hosted)
    with collected() as faults, np.errstate(all="ignore"):  # overflows are faults
        faults += stops_of_script(scene) if hosted and _ports(scene) else _ports(scene)
        scene, notes = chosen(scene, faults)
        named = scene.initial.restart
        source = None if named is None else load_restart(named)
        system, state = system_of(scene, faults, None if source is None else source.restart)
        faults += overflow_faults(system, state)
        of_start: list[Fault] = []
        if not any(fault.key.startswith("initial") for fault in faults):  # else these faults follow from it
            of_start = start_faults(scene, system, state)
        of_bodies = body_faults(scene, system, state, faults)
        if any(fault.beyond_floats for fault in of_bodies):  # attached nodes fly as far as their body
            of_start = [fault for fault in of_start if not fault.beyond_floats]
        faults += of_start + of_bodies
        if not faults:
            faults += contact_faults(system, state)
        overflows = any(fault.beyond_floats for fault in faults)
        try:
            with within_floats(system.net):
                plan, wrong_steps = make_plan(scene, system, state)
        except CaseError:  # names the element
            faults[:] = [fault for fault in faults if fault.key != "net"]
            raise
        wrong_steps += step_faults(scene, system, plan)
        faults += [fault for fault in wrong_steps if fault.key != "net" or not overflows]
        faults += method_faults(system, state, plan)
    alone = [name for name, effect in scene.effects.on.items() if effect.ON_THE_NET_ALONE]
    if scene.bodies and alone:
        notes += (f"act on net and tethers, not on bodies: {', '.join(alone)}",)
    if scene.launch is not None and "chaser" in scene.bodies and scene.initial.frame is None:
        notes += (NO_REACTION,)
    if scene.control is not None and scene.control.kind == "given":
        notes += (NO_FUNCTION,)
    notes += tuple(_effect_notes(scene, system))
    with np.errstate(all="ignore"):
        plan = with_pilots(scene, system, state, plan)
    notes += tuple(friction_warnings(system, plan))
    plan = with_backend(scene, system, plan)
    origin = None
    if source is not None:
        origin = source.origin
        notes += (f"starts from the state of {source.restart.source}",)
    return Start(scene, system, state, replace(plan, notes=plan.notes + notes), origin)


def _effect_notes(scene: Scene, system: System) -> Iterator[str]:
    """Yield notes on damping, named nodes, tethers without contact, and grooves between parts of a body."""
    effects = scene.effects
    rayleigh = effects.get(RayleighDamping)
    if rayleigh is not None and rayleigh.beta:
        yield (
            "rayleigh_damping.beta also damps slack threads and rigid rotation (paper, eq. 13): "
            "effects.material_damping damps taut threads alone"
        )
    if (note := damping_note(scene, system.net)) is not None:
        yield note
    yield from place_notes(scene, system.net)
    yield from cord_notes(scene)
    if effects.get(SelfContact) is not None and scene.tethers:
        yield (
            "effects.self_contact acts between threads of the net and its strings: "
            f"tethers ({', '.join(scene.tethers)}) pass through each other and through the net"
        )
    contact = effects.get(Contact)
    for body in system.bodies:
        if contact is None or body.shape is None or body.name not in contact.touched_bodies():
            continue
        names = list(scene.bodies[body.name].parts)
        for k, m, depth in grooves(body.shape):
            yield (
                f"bodies.{body.name}: parts {names[k]} and {names[m]} abut, so rounding by edge_radius "
                f"leaves a groove up to {depth:.3g} m deep: let them overlap by edge_radius or more, "
                "or use one mesh"
            )


def _ports(scene: Scene) -> list[Fault]:
    words = 'motion = "port" requires a host (exunet.Coupler or an FMU): use motion = "free" without one'
    return [
        Fault(f"bodies.{name}.motion", words) for name, body in scene.bodies.items() if body.motion == "port"
    ]


def stops_of_script(scene: Scene) -> list[Fault]:
    """Return faults of script entries that end a run, which only the host may do."""
    words = "a host steps this net and ends the run: use another action"
    return [Fault(f"script[{k}].do", words) for k, entry in enumerate(scene.script) if entry.do == "stop"]


def prepare_case(case: Case, *, hosted: bool = False) -> Start:
    """Prepare the scene of a case; faults name the line of the file or the override."""
    with located_faults(case):
        return prepare(case.scene, hosted=hosted)


def with_wrenches(start: Start, bodies: Sequence[str]) -> Start:
    """Return the start with an input for a wrench on each of these free bodies."""
    listed = isinstance(bodies, Sequence | Set) and not isinstance(bodies, str)
    if not listed or not all(isinstance(name, str) for name in bodies):
        raise InputError(f"wrenches: must be a list of names of bodies, got {shown(bodies)}")
    if not bodies:
        return start
    system = start.system
    free = [name for name, moves in zip(system.blocks.rigid, system.moves_freely, strict=True) if moves]
    if wrong := [name for name in bodies if name not in free]:
        known = ", ".join(free) or "none"
        raise InputError(f"wrenches: {', '.join(map(repr, wrong))}: not a free body (free bodies: {known})")
    arms = {body.name: body.in_principal_axes((0.0, 0.0, 0.0)) for body in system.bodies}
    return start.with_forces(lambda blocks: [wrench_on(blocks, name, arms[name]) for name in bodies])


def start_of(case: str | Path | Case | Scene | Start, overrides: Sequence[str] = ()) -> Start:
    """Return the start of a case in any form; overrides do not apply to a start."""
    if isinstance(case, Start):
        # A script may have changed the forces.
        if faults := method_faults(case.system, case.state, case.plan):
            raise CaseError(faults)
        return case
    return prepare_case(case_of(case, "Simulation", overrides))


def in_the_compiled_loop(start: Start) -> Start:
    """Return a start that the compiled loop integrates, by DOPRI5 where it lacks the method.

    Forces and states that a script may have changed stay as they are. Raises MissingExtra without Numba,
    CaseError if the compiled loop cannot integrate the scene.
    """
    require_numba('engine.backend = "compiled"')
    scene, solver = start.scene, start.scene.solver
    engine = scene.engine.model_copy(update={"backend": Backend.COMPILED})
    if not METHODS[start.plan.method].compiled:
        solver = solver.model_copy(update={"method": Method.DOPRI5})
    effects = scene.effects.model_copy(update={"choose": None, "threshold": None})  # chosen already
    made = prepare(scene.model_copy(update={"engine": engine, "solver": solver, "effects": effects}))
    return replace(start, scene=made.scene, plan=made.plan)
