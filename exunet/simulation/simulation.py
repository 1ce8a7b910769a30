"""A simulation that is stepped by its caller: advance, read, act, go back."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from pkgutil import resolve_name
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from exunet.base.arguments import finite_number, shown
from exunet.base.arrays import Floats
from exunet.base.errors import InputError
from exunet.base.files import group_of, grouped
from exunet.base.times import reached
from exunet.bodies.port import Piece
from exunet.bodies.rigid import in_frames
from exunet.bodies.rotations import rotation_matrix
from exunet.forces.corner_units import Function
from exunet.forces.reel import command_name
from exunet.integrators import stepper_of
from exunet.integrators.protocol import StepCounts, Stepper
from exunet.methods.method import Method, Plan
from exunet.model.states import States
from exunet.model.system import OF_BODY, Moving, State
from exunet.net.closing import NAME, LineThroughRings
from exunet.net.drive import command_of, too_fast
from exunet.net.tether import ReeledTether
from exunet.results.run_record import Peak, RunRecord, largest_of
from exunet.scene.casefile import Case
from exunet.scene.scene import Scene
from exunet.simulation.controller import ActiveController, Controller
from exunet.simulation.integrate import Integration
from exunet.simulation.observers import EnergyBalance, EventLog, Observer, Observers, RunningExtremes
from exunet.simulation.preparation import Start, start_of, with_wrenches
from exunet.simulation.recorder import Recorder
from exunet.simulation.snapshot import Snapshot, identity, validate_snapshot


class Energies(NamedTuple):
    """Energies at one instant [J]; dissipated: since the start, less the work of external forces."""

    kinetic: float
    elastic: float
    potential: float
    dissipated: float

    @property
    def total(self) -> float:
        """Sum of the energies, which is conserved."""
        return sum(self)


@dataclass(frozen=True, eq=False)
class NetState:
    """Net at one instant (copies).

    bullets            : (n_bullets,) nodes that carry a bullet
    position, velocity : (n_nodes, 3) [m], [m/s]
    strain, tension    : (n_elements,) Green-Lagrange strain, axial force [N]
    """

    bullets: NDArray[np.int64]
    position: Floats
    velocity: Floats
    strain: Floats
    tension: Floats


@dataclass(frozen=True, eq=False)
class BodyState:
    """Body at one instant.

    position, velocity : (3,) of the centre of mass [m], [m/s]
    attitude           : (4,) unit quaternion (w, x, y, z), from the body's axes to the scene's
    rotation           : (3, 3) the same as a matrix
    angular_velocity   : (3,) [rad/s], in the body's axes
    """

    position: Floats
    velocity: Floats
    attitude: Floats
    angular_velocity: Floats

    @property
    def rotation(self) -> Floats:
        return rotation_matrix(self.attitude)


# Observers of each simulation: "package.module:Class", made with the system and its first state, by name.
OBSERVERS: dict[str, str] = {
    # as in docs/how_to/extending.md
}


class Simulation:
    """Simulation of one case, stepped by its caller.

        sim = Simulation("case.toml")
        while sim.time < 1.0:
            sim.advance(0.01)

    Parameters
    ----------
    case : str, Path, Case, Scene or Start
        Name of a case file, or the result of `exunet.load` or `prepare`.
    overrides : sequence of str, optional
        "key.path=value", as after --set.
    wrenches : sequence of str, optional
        Free bodies with an input "wrench/BODY": force (3,) [N] at the origin of the body's frame and torque
        (3,) [N m], in the scene's axes.
    controller : callable or str, optional
        Control law of the corner units for control.kind = "given"; see `Start.with_controller`.
    recorder : Recorder, optional
        Stores states at its times.

    Raises
    ------
    RunStopped
        If a state exceeds a bound of the guards after `solver.retry` attempts from the last safe state with
        finer steps, through the same times. The guards check many states at once, and all before one is read.
    Interrupted
        On Ctrl-C.
    """

    def __init__(
        self,
        case: str | Path | Case | Scene | Start,
        overrides: Sequence[str] = (),
        *,
        wrenches: Sequence[str] = (),
        controller: Function | str | None = None,
        recorder: Recorder | None = None,
    ) -> None:
        start = with_wrenches(start_of(case, overrides), wrenches)
        if not isinstance(recorder, Recorder | None):
            raise InputError(f"recorder: must be a Recorder or None, got {shown(recorder)}")
        self._start = start = start if controller is None else start.with_controller(controller)
        self._recorder = recorder
        self.balance, self.log, self.extremes = (
            (EnergyBalance(start.system, start.state), EventLog(start.system), RunningExtremes(start.system))
            if recorder is None
            else (recorder.balance, recorder.log, recorder.extremes)
        )
        own: dict[str, Observer] = {"balance": self.balance, "log": self.log, "extremes": self.extremes}
        for name, path in OBSERVERS.items():
            if name in (*own, "record"):
                raise InputError(f"OBSERVERS: {name!r} is the name of an observer that each run has")
            own[name] = resolve_name(path)(start.system, start.state)
        own |= {} if recorder is None else {"record": recorder}
        observers = Observers(start.system, start.state, own)
        shows = {"elements": recorder is not None, "every_step": observers.every_step}

        def make(state: State, plan: Plan) -> Stepper:
            return stepper_of(start.system, state, plan, **shows)

        retries = start.scene.solver.retry
        self.run = Integration(start.plan, make, observers, retries=retries)
        self._control: ActiveController | None = None
        if recorder is not None and not len(recorder):
            observers.start()
        self._first = self.snapshot() if recorder is None and self.can_restart else None

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle and copy the model, the recorder, the controller and a snapshot."""
        return _continued, (self._start, self._recorder, self._control, self.snapshot())

    @property
    def time(self) -> float:
        """Present time [s]."""
        return self.run.stepper.time

    @property
    def plan(self) -> Plan:
        """Plan of integration; finer after a retry."""
        return self.run.plan

    @property
    def counts(self) -> StepCounts:
        """Steps and force evaluations so far, of all attempts."""
        return self.run.counts

    def settle(self) -> None:
        """Check all states; if steps failed, return to this time with finer steps."""
        self.run.settle()

    @property
    def stopped(self) -> bool:
        """True once the script of the case has ended the run."""
        return self.run.events.stopped

    @property
    def start(self) -> Start:
        """Model, initial state and plan of the simulation."""
        return self._start

    @property
    def state(self) -> State:
        """Whole state (copies)."""
        self.settle()
        return self.run.stepper.state()

    @property
    def view(self) -> State:
        """Whole state without copies, not checked by the guards; the next step may change its arrays.

        Bodies by principal axes and centres of mass, as integrated; velocities of attached nodes may be those
        of a stage (`state` has the present ones).
        """
        return self.run.stepper.view()

    @property
    def moving(self) -> Moving:
        """Continuous part of `view`."""
        return self.run.stepper.view().moving

    @property
    def energy(self) -> Energies:
        """Present energies."""
        now = States.of(self._start.system, self.state)
        kinetic, elastic, potential = (float(part[0]) for part in (now.kinetic, now.elastic, now.potential))
        return Energies(kinetic, elastic, potential, self.balance.dissipated)

    @property
    def net(self) -> NetState:
        """Present state of the net."""
        net, now = self._start.net, States.of(self._start.system, self.state)
        place, speed = now.position[0, : net.n_nodes], now.velocity[0, : net.n_nodes]
        return NetState(net.bullet_nodes, place, speed, now.strain[0], now.tension[0])

    @property
    def bodies(self) -> dict[str, BodyState]:
        """Present states of the bodies, by name."""
        now, system = self.state, self._start.system
        framed = in_frames(system.bodies, now.bodies)
        return {
            body.name: BodyState(*(getattr(framed, name)[k] for name in OF_BODY))
            for k, body in enumerate(system.bodies)
        }

    @property
    def largest_tension(self) -> Peak:
        """Largest tension of all steps so far; its element is -1 if none was taut."""
        self.settle()
        peak = largest_of(self.extremes.of_groups().values())
        assert peak is not None
        return peak

    def advance(self, duration: float) -> None:
        """Advance by a duration [s]."""
        self._refuse_within_act("advance")
        seconds = finite_number(duration)
        if seconds is None or not seconds > 0.0:
            raise InputError(f"advance: duration must be positive and finite, got {duration!r} s")
        if not self.time < self.time + seconds < np.inf:
            words = f"duration {seconds:g} s is below the round-off of the time {self.time:g} s, or too large"
            raise InputError(f"advance: {words}")
        self._go_to(self.time + seconds)

    def advance_to(self, until: float) -> None:
        """Advance to a time [s]; the present time, within round-off, changes nothing."""
        self._refuse_within_act("advance_to")
        time = finite_number(until)
        if time is None or not reached(time, self.time):
            raise InputError(
                f"advance_to: time must not be before the present {self.time:g} s, got {until!r}"
            )
        self._go_to(time)

    def attach(self, controller: Controller) -> None:
        """Attach a controller, which acts at the beginning of each of its periods; it replaces another.

        Snapshots contain its state, and `reset` restores its present state; both require `state` and
        `restore`.
        """
        self._refuse_within_act("attach")
        self._control = ActiveController(controller, self.time)

    def _refuse_within_act(self, what: str) -> None:
        if self._control is not None:
            self._control.validate_outside_act(what)

    def controlled_as(self, other: Simulation) -> None:
        """Attach the controller of another simulation, if any, in its state at attachment."""
        if not isinstance(other, Simulation):
            raise InputError(f"controlled_as: must be a Simulation, got {shown(other)}")
        control = other._control
        if control is not None:
            control.validate_restorable()
            control.reset(self.time)
        self._control = control

    def _go_to(self, time: float) -> None:
        if self.stopped:
            words = f"the script of the case has ended the run at t = {self.time:.6g} s"
            raise InputError(f"advance: {words}: restore an earlier snapshot, or reset")
        control = self._control
        while control is not None and not reached(control.due, time) and not self.stopped:
            if not reached(self.time, control.due):
                self.run.go([control.due])
            control.act(self)
        if time > self.time and not self.stopped:
            self.run.go([time])

    def set_force(self, on: int | str, force: ArrayLike) -> None:
        """Set the force (3,) [N] on a node by number or name ("centre").

        Its work counts in the energy balance as input.
        """
        self._act(self.run.external.with_force(self.run.acting, on, force))

    @property
    def inputs(self) -> dict[str, Floats]:
        """Present values of the inputs, by name (copies)."""
        return {name: values.copy() for name, values in self.run.external.inputs(self.run.acting).items()}

    def set_input(self, name: str, values: ArrayLike) -> None:
        """Set the values of an input of the forces.

        Its work counts in the energy balance, by the power of the force that reads it.
        """
        self._act(self.run.external.with_input(self.run.acting, name, values))

    def command(self, tether: str, mode: str, rate: float | None = None, force: float | None = None) -> None:
        """Command the reel of a tether, or the winch of a closing line ("closing"), as in a case.

        Parameters
        ----------
        tether : str
            Name of the tether, or "closing".
        mode : str
            "lock", "brake", "rate" or "tension".
        rate, force : float, optional
            [m/s], [N].

        Raises
        ------
        InputError
            For an unknown reel, a reel with commands in the case, values that the mode does not take, or a
            rate above the largest rate of the drive.
        """
        tether, system = _name(tether, "command: a tether"), self._start.system
        reels: dict[str, ReeledTether | LineThroughRings]
        reels = {winding.reel.name: winding.reel for winding in system.forces.cable.reels}
        reels |= {} if system.line is None or not system.line.has_winch else {NAME: system.line}
        mine = {name: reel for name, reel in reels.items() if reel.is_commanded}
        if tether not in mine:
            words = "its reel has commands in the case" if tether in reels else "unknown reel"
            raise InputError(f"command: tether {tether!r}: {words} (reels to command: {_listed(mine)})")
        if command_name(tether) in system.scripted:
            raise InputError(f"command: tether {tether!r}: commanded by the script of the case")
        try:
            drive = command_of(mine[tether].damping, mode=mode, rate=rate, force=force)
        except ValueError as error:
            raise InputError(f"command: tether {tether!r}: {error}") from error
        if rate is not None and (words := too_fast(rate, mine[tether].largest_rate)):
            raise InputError(f"command: rate {words}")
        values = [1.0, drive.rate, drive.force, drive.gives]
        self.set_input(command_name(tether), values)

    def steer(self, port: str, piece: Piece) -> None:
        """Move a body of motion = "port" along a piece that begins at the present time and position.

        Raises InputError for an unknown body, or another object than a piece.
        """
        if not isinstance(piece, Piece):
            raise InputError(f"steer: piece must be a Piece (of exunet.bodies.port), got {shown(piece)}")
        self.run.stepper.steer(port, piece)

    def steered(self, port: str) -> Piece:
        """Return the present or last piece of a port; raise InputError as `steer`."""
        return self.run.stepper.steered(port)

    @property
    def acting(self) -> Floats:
        """External forces and inputs in one array; each change makes a new array."""
        return self.run.acting

    def repeat_changes(self, then: Floats, now: Floats) -> None:
        """Set each force and input that differs between two arrays of `acting` to the value of the second."""
        self._act(self.run.external.with_changes(self.run.acting, then, now))

    def _act(self, acting: Floats) -> None:
        self.settle()
        self.run.act(acting)

    @property
    def can_restart(self) -> bool:
        """True if runs continue exactly from snapshots with this method."""
        return self.run.stepper.can_restart

    def snapshot(self) -> Snapshot:
        """Return a snapshot; raise InputError for a method without exact restart (see `can_restart`)."""
        self._refuse_within_act("snapshot")
        if not self.can_restart:
            raise InputError(f"snapshot: {cannot_restart(self.plan.method)}")
        header = {
            "time": self.time,
            "plan": self.plan.as_json(),
            "retries": self.run.retries,
            "spent": asdict(self.run.spent),
        }
        if self._recorder is not None:
            self._recorder.flush()
            header |= {"rows": len(self._recorder), "record": self._recorder.record.to_json()}
        arrays = self.run.save()
        if self._control is not None:
            arrays |= grouped("control", self._control.arrays())
        return Snapshot(identity(self._start), header, arrays)

    def restore(self, snapshot: Snapshot) -> None:
        """Restore a snapshot of the same case; the simulation continues exactly.

        Raises InputError for a snapshot of another case, backend or version.
        """
        self._refuse_within_act("restore")
        if not isinstance(snapshot, Snapshot):
            words = f"needs what `snapshot` or `Snapshot.load` gave, got {shown(snapshot)}"
            raise InputError(f"restore: {words}")
        validate_snapshot(snapshot, self._start, self.snapshot())
        header, arrays, restored = snapshot.header, snapshot.arrays, Plan.from_json(snapshot.header["plan"])
        if restored.method != self.plan.method:
            raise InputError(f"the snapshot of t = {snapshot.time:g} s is of {restored.method}")
        if self._recorder is not None and header["rows"] > len(self._recorder):
            raise InputError(f"the snapshot of t = {snapshot.time:g} s has rows that are not stored")
        if self._control is not None:
            self._control.restore(group_of("control", arrays))
        self.run.load(arrays, restored, header["retries"], StepCounts(**header["spent"]))
        if self._recorder is not None:
            self._recorder.restore(RunRecord.from_json(header["record"]))

    def reset(self) -> None:
        """Go back to the start, without a new build."""
        self._refuse_within_act("reset")
        if self._first is None:
            raise InputError(f"reset: {cannot_restart(self.plan.method)}, or make a new Simulation")
        control = self._control
        if control is not None:
            control.validate_restorable()
        self._control = None
        try:
            self.restore(self._first)
        finally:
            self._control = control
        if control is not None:
            control.reset(self.time)


def _continued(
    start: Start, recorder: Recorder | None, control: ActiveController | None, snapshot: Snapshot
) -> Simulation:
    """Return a simulation that continues from a snapshot."""
    simulation = Simulation(start, recorder=recorder)
    simulation._control = control
    simulation.restore(snapshot)
    return simulation


def _name(given: object, of: str) -> str:
    if not isinstance(given, str):
        raise InputError(f"{of}: needs its name, got {shown(given)}")
    return given


def _listed(names: Iterable[str]) -> str:
    return ", ".join(names) or "none"


def cannot_restart(method: Method) -> str:
    """Explain that implicit methods of Exudyn do not have snapshots."""
    return (
        f"{method} of Exudyn cannot restart exactly from a stored state; "
        "use an explicit method such as DOPRI5, RK44 or VelocityVerlet"
    )
