"""Net that a host steps: motion of its ports in, impulses on them out.

With velocities v0 and v1 at the ends of a step H, a velocity that goes from one to the other monotonically
leads away from H (v0 + v1) / 2 by at most H |v1 - v0| / 2; so do integrators of first order, which step by v0
or by v1. A velocity that reverses in between is bounded by the acceleration a of the step before, H a. What
is left, such as half a swing between two equal velocities, is within a tenth of the path at the larger speed
as long as a body swings by less than 1 rad in a step. A larger distance is a jump. Attitudes alike, by the
rotation vector and its rates at both ends.

The text of the loops and that of `exunet.bodies.port` form a generated module (see
`exunet.kernels.source.loops_source`), so they use no global name but each other's.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from functools import cache
from itertools import repeat
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from exunet.base.arguments import finite_number, whole_number
from exunet.base.arrays import Floats
from exunet.base.errors import CaseError, InputError, RunStopped
from exunet.bodies.kinematics import first_given
from exunet.bodies.port import (
    INSIDE,
    PER_FRAME,
    FrameOf,
    FrameState,
    Piece,
    after,
    apart,
    difference,
    frame_of,
    frames_of,
    jump_of,
    length,
    mean_place,
    principal_of,
    put_state,
    quaternion_of_matrix,
    rows_of,
    state_at,
    turning_between,
    way_between,
)
from exunet.kernels.compile import compiled_module, interpreted_module, numba_installed
from exunet.kernels.source import hold, loops_source
from exunet.model.states import States
from exunet.model.system import Moving, State, System
from exunet.scene.casefile import Case, case_of, located_faults
from exunet.scene.scene import Scene
from exunet.simulation.preparation import prepare_case, stops_of_script
from exunet.simulation.simulation import Simulation
from exunet.simulation.snapshot import Snapshot

if TYPE_CHECKING:
    from exunet.kernels.pointers import borrowed


class PortArrays(NamedTuple):
    """Arrays of a net that the loops over its ports read, and their work space.

    position, velocity, attitude, angular_velocity : of all bodies, (n, 3) or (n, 4) each
    first_order   : (m,) of the net
    number, entry : (n,) bodies of the ports; first entry of each port's impulse and work in `first_order`
    centre, axes  : (n, 3), (n, 4) centres of mass and principal axes in the frames
    frames, given : (n, 13) states of the frames at the begin of a step; (n, 7) impulse and work until then
    begin, end    : (n, 13) states of the centres of mass at both ends of a step
    """

    position: Floats
    velocity: Floats
    attitude: Floats
    angular_velocity: Floats
    first_order: Floats
    number: NDArray[np.int64]
    entry: NDArray[np.int64]
    centre: Floats
    axes: Floats
    frames: Floats
    given: Floats
    begin: Floats
    end: Floats


def read_markers(outputs: Any, frames: Any) -> int:
    """Convert outputs of markers to states of frames (n, 13).

    outputs : (n, 18) position, velocity, rotation matrix by rows, angular velocity in the frame's axes
    Returns the number of the first with NaN or infinity, or -1.
    """
    wrong = -1
    for p in range(len(outputs)):
        row = outputs[p]
        total = 0.0
        for k in range(18):
            total += row[k]
        if wrong < 0 and not math.isfinite(total):
            wrong = p
        place, speed, spin = (row[0], row[1], row[2]), (row[3], row[4], row[5]), (row[15], row[16], row[17])
        put_state(frames, p, (place, speed, quaternion_of_matrix(row[6:15]), spin))
    return wrong


def extrapolate(now: Any, before: Any, since: float, duration: float, ahead: Any) -> None:
    """Extrapolate states (n, 13) by a time [s], at the mean acceleration since `before`.

    since : from `before` to `now` [s]; 0: at constant velocity
    """
    for p in range(len(now)):
        state = state_at(now, p)
        acceleration = angular = (0.0, 0.0, 0.0)
        if since > 0.0:
            (a, b, c), (d, e, f) = state_at(before, p)[1], state[1]
            acceleration = ((d - a) / since, (e - b) / since, (f - c) / since)
            (a, b, c), (d, e, f) = state_at(before, p)[3], state[3]
            angular = ((d - a) / since, (e - b) / since, (f - c) / since)
        put_state(ahead, p, after(state, duration, acceleration, angular))


def find_jump(step: float, begin: Any, end: Any, before: Any, since: float, part: float, size: float) -> Any:
    """Return the first row that jumps in a step [s] with the values of `jump_of`, or -1.

    begin, end, before : (n, 13) states; since : from `before` to `begin` [s]; 0: there is no state before
    """
    for p in range(len(begin)):
        first, of_place, of_turning = state_at(begin, p), 0.0, 0.0
        if since > 0.0:
            earlier = state_at(before, p)
            of_place = apart(earlier[1], first[1]) / since
            of_turning = apart(earlier[3], first[3]) / since
        kind, off, allowed = jump_of(step, first, state_at(end, p), of_place, of_turning, part, size)
        if kind >= 0:
            return p, kind, off, allowed
    return -1, -1, 0.0, 0.0


def max_rotation(step: float, begin: Any, end: Any) -> Any:
    """Return the row that rotates most in a step [s] and its angle [rad], by the larger angular velocity."""
    number, most = 0, 0.0
    for p in range(len(begin)):
        turn = step * max(length(state_at(begin, p)[3]), length(state_at(end, p)[3]))
        if turn > most:
            number, most = p, turn
    return number, most


def plan_motion(step: float, target: Any, position: Any, attitude: Any, turning: Any, held: Any) -> Any:
    """Compute the motion of ports from their present states to target states after a step [s].

    target : (n, 13) states of the frames at the end
    position, attitude, turning : (n, 4, 3), (n, 4), (n, 4, 3) output: pieces of an
                                  `exunet.bodies.port.PrescribedMotion`
    held   : from `hold`, of `PortArrays`
    Returns `max_rotation`.
    """
    room = borrowed(held.value)
    begin, end = room.begin, room.end
    for p in range(len(target)):
        number, entry = room.number[p], room.entry[p]
        for k in range(3):
            begin[p, k] = room.position[number, k]
            begin[p, 3 + k] = room.velocity[number, k]
            begin[p, 10 + k] = room.angular_velocity[number, k]
        for k in range(4):
            begin[p, 6 + k] = room.attitude[number, k]
        for k in range(7):
            room.given[p, k] = room.first_order[entry + k]
        centre = (room.centre[p, 0], room.centre[p, 1], room.centre[p, 2])
        axes = (room.axes[p, 0], room.axes[p, 1], room.axes[p, 2], room.axes[p, 3])
        first = state_at(begin, p)
        last = principal_of(state_at(target, p), centre, axes)
        put_state(room.frames, p, frame_of(first, centre, axes))
        put_state(end, p, last)
        ways = way_between(step, first, last)
        for k in range(2):
            position[p, k, 0], position[p, k, 1], position[p, k, 2] = ways[0][k]
            turning[p, k, 0], turning[p, k, 1], turning[p, k, 2] = ways[1][k]
        position[p, 2, 0], position[p, 2, 1], position[p, 2, 2] = first[1]
        position[p, 3, 0], position[p, 3, 1], position[p, 3, 2] = first[0]
        turning[p, 2, 0], turning[p, 2, 1], turning[p, 2, 2] = first[3]
        turning[p, 3, 0], turning[p, 3, 1], turning[p, 3, 2] = (0.0, 0.0, 0.0)
        attitude[p, 0], attitude[p, 1], attitude[p, 2], attitude[p, 3] = first[2]
    return max_rotation(step, begin, end)


def collect_loads(step: float, target: Any, impulses: Any, wrenches: Any, held: Any) -> None:
    """Compute what the net has done to the bodies of its ports in a step [s] after `plan_motion`.

    impulses : (n, 7) output: impulse, angular impulse about the scene's origin, work
    wrenches : (n, 6) output: mean force, and mean torque about the frame's origin
    """
    room = borrowed(held.value)
    over = 1.0 / step
    for p in range(len(target)):
        row, wrench = impulses[p], wrenches[p]
        for k in range(7):
            row[k] = -(room.first_order[room.entry[p] + k] - room.given[p, k])
        x, y, z = mean_place(step, state_at(room.frames, p), state_at(target, p))
        wrench[0], wrench[1], wrench[2] = over * row[0], over * row[1], over * row[2]
        wrench[3] = over * (row[3] - y * row[2] + z * row[1])
        wrench[4] = over * (row[4] - z * row[0] + x * row[2])
        wrench[5] = over * (row[5] - x * row[1] + y * row[0])


def add_to_balances(
    steps: Any, recoils: Any, applied: Any, impulses: Any, begin: Any, end: Any, balances: Any
) -> None:
    """Add steps (k,) [s] to the balances of ports.

    recoils    : (k,) steps that contain the jump of an ejection
    applied    : (k, n, 6) forces and torques on the host's bodies
    impulses   : (k, n, 7) of `collect_loads`; begin, end : (k, n, 13) states of the frames at both ends
    balances   : (n, 13) as of `exunet.coupling.rollback.PortBalance`, without its last field
    """
    for s in range(len(steps)):
        for p in range(len(balances)):
            row, load, six = balances[p], impulses[s, p], applied[s, p]
            first, last = state_at(begin[s], p), state_at(end[s], p)
            turn = turning_between(steps[s], first, last)
            (a, b, c), (d, e, f) = first[0], last[0]
            work = six[0] * (d - a) + six[1] * (e - b) + six[2] * (f - c)
            work = work + six[3] * turn[0] + six[4] * turn[1] + six[5] * turn[2]
            error = work - load[6]
            for k in range(7):
                row[k] += load[k]
            row[9] += abs(load[6])
            row[11], row[12] = min(row[11], row[6]), max(row[12], row[6])
            if recoils[s]:
                row[10] += error  # the launcher supplies the energy
                continue
            row[7] += error
            row[8] = max(row[8], abs(error))


LOOPS = (
    read_markers,
    extrapolate,
    find_jump,
    max_rotation,
    plan_motion,
    collect_loads,
    add_to_balances,
)


@cache
def port_loops() -> ModuleType:
    """Return the module of the loops: compiled if Numba is installed, else plain Python."""
    source = loops_source((hold, *LOOPS), INSIDE)
    return compiled_module(source) if numba_installed() else interpreted_module(source)


# Fractions of the changes of velocity in this step and the one before that, times the step, explain a
# deviation of the path: for a host's own states, and for states given to a net, which may be predicted at
# constant velocity. The next step corrects such a prediction, by the change of velocity for a host of first
# order.
OWN, PREDICTED = 0.5, 1.5
# Largest rotation in a step [rad], at the larger angular velocity of both ends. Two attitudes do not
# determine a rotation beyond pi, and a force held over the step is far from one that rotates with the body.
LARGEST_TURN = 1.0


class Earlier(NamedTuple):
    """Step before, which determines accelerations.

    states : (n, 13) at its begin, of which the velocities are used
    since  : its length [s]; 0: no step before
    """

    states: Floats
    since: float


def validate_no_jump(
    who: str,
    names: Sequence[str],
    times: tuple[float, float],
    states: tuple[Floats, Floats],
    earlier: Earlier,
    part: float,
    size: float,
) -> None:
    """Raise InputError if a body's change of pose in a step does not follow from its velocities.

    who, names    : begin of the message; names of the bodies (n)
    times, states : begin and end of the step [s], (n, 13)
    part          : `OWN` or `PREDICTED`
    size          : scale of the round-off of positions [m]
    """
    number, kind, off, allowed = port_loops().find_jump(times[1] - times[0], *states, *earlier, part, size)
    if number < 0:
        return
    what, unit = ("attitude", "rad") if kind else ("position", "m")
    raise InputError(
        f"{who} {names[number]} jumps: in the step from {times[0]:.6g} s to {times[1]:.6g} s its {what} is "
        f"{off:.3g} {unit} from where its velocities lead, and accelerations explain {allowed:.3g} {unit}. "
        "Give the state at the end of the step, use shorter steps if it swings within one, or restore a "
        "snapshot"
    )


def validate_rotation(
    who: str, names: Sequence[str], times: tuple[float, float], largest: tuple[int, float]
) -> None:
    """Raise InputError if a body rotates too far in a step; largest : as of `max_rotation`."""
    number, turn = largest
    if turn <= LARGEST_TURN * (1.0 + 1e-6):
        return
    start, stop = times
    raise InputError(
        f"{who} {names[number]} turns too far: in the step from {start:.6g} s to {stop:.6g} s by {turn:.3g} "
        f"rad, at {turn / (stop - start):.3g} rad/s. The limit is {LARGEST_TURN:g} rad a step: use shorter "
        "steps"
    )


def validate_ports(who: str, given: object, names: Sequence[str], what: str) -> None:
    """Raise InputError unless a mapping has an entry, what, for each of these ports and no other."""
    if not isinstance(given, Mapping):
        raise InputError(f"{who}: requires {what} by the name of each port, got {given!r}")
    if unknown := [name for name in given if name not in names]:
        raise InputError(f"{who}: there is no port {unknown[0]!r}: {', '.join(names) or 'the case has none'}")
    if missing := [name for name in names if name not in given]:
        raise InputError(f"{who}: {what} is missing for port {', '.join(missing)}")


def validated_number(who: str, port: str, what: str, given: object, count: int) -> int:
    """Return the number of an item of a system of `count` items; raise InputError for another object."""
    number = whole_number(given)
    if number is None or not 0 <= number < count:
        raise InputError(f"{who}: port {port}: there is no {what} {given!r}: the system has {count}")
    return number


# Tolerance at the start, relative to the net's size, to the larger of 1 m/s or 1 rad/s and the speed, or in
# radians: round-off of numbers that were given with six digits.
_SAME = 1e-6
_MIN_SIZE = 1e-3  # [m], of a net of one node


def distance(one: FrameState, other: FrameState, size: float) -> float:
    """Return the larger distance: of two positions relative to a size [m], of two attitudes [rad]."""
    angle = math.hypot(*difference(one.attitude, other.attitude))
    return max(math.dist(one.position, other.position) / max(size, _MIN_SIZE), angle)


def validate_same_start(who: str, name: str, port: FrameState, host: FrameState, size: float) -> None:
    """Raise InputError if a port and its host's body differ at the start."""
    speed, spin = math.hypot(*port.velocity), math.hypot(*port.angular_velocity)
    turn = math.hypot(*difference(port.attitude, host.attitude))
    for what, off, unit, scale in (
        ("position", math.dist(port.position, host.position), "m", max(size, _MIN_SIZE)),
        ("attitude", turn, "rad", 1.0),
        ("velocity", math.dist(port.velocity, host.velocity), "m/s", max(1.0, speed)),
        (
            "angular_velocity",
            math.dist(port.angular_velocity, host.angular_velocity),
            "rad/s",
            max(1.0, spin),
        ),
    ):
        if off > _SAME * scale:
            values = " and ".join(_shown(getattr(state, what)) for state in (port, host))
            raise InputError(
                f"{who}: port {name}: its {what} at the start in the case and that in the host differ by "
                f"{off:.3g} {unit}: {values}. Give bodies.{name} the start that it has in the host"
            )


def _shown(values: tuple[float, ...]) -> str:
    return "[" + ", ".join(f"{value:.9g}" for value in values) + "]"


class PortLoad(NamedTuple):
    """Load of the net on the body of a port in a step from `begin` to `end` [s]; in the scene's axes.

    impulse         : (3,) [N s]
    angular_impulse : (3,) about the scene's origin [N m s]
    work            : [J], along the prescribed motion of the port
    force, torque   : (3,) means: [N], and [N m] about the origin of the port's frame
    """

    begin: float
    end: float
    impulse: Floats
    angular_impulse: Floats
    work: float
    force: Floats
    torque: Floats


class PortLoads(NamedTuple):
    """Loads of a step from `begin` to `end` [s] on the bodies of all ports, in their order.

    impulses : (n, 7) impulse, angular impulse and work, as in `PortLoad`
    wrenches : (n, 6) mean forces [N] and torques [N m]
    """

    begin: float
    end: float
    impulses: Floats
    wrenches: Floats

    def of(self, ports: Iterable[str]) -> dict[str, PortLoad]:
        """Return the loads by the names of the ports."""
        rows = zip(ports, self.impulses, self.wrenches, strict=True)
        return {
            name: PortLoad(self.begin, self.end, seven[:3], seven[3:6], float(seven[6]), six[:3], six[3:])
            for name, seven, six in rows
        }


class Delivered(NamedTuple):
    """Impulse and work of the net on the body of a port since the start; as in `PortLoad`."""

    impulse: Floats
    angular_impulse: Floats
    work: float


class _Ports:
    """Ports of a system, and the arrays of the compiled loops.

    names    : of the ports (n)
    bodies   : (n,) numbers of their bodies
    entries  : (n,) first entry of each port's impulse and work in the first-order states
    ejects   : True if a port ejects the net at the start
    ejection : (n, 7) impulse and work of that on the net, by port
    """

    def __init__(self, system: System) -> None:
        rigid, numbers = system.blocks.rigid, system.kinematics.ports
        self.names = tuple(rigid[k] for k in numbers)
        first = system.blocks.n_x - system.blocks.n_states
        entries = [system.blocks.state(first_given(name)) - first for name in self.names]
        self.frame_of = [FrameOf.body(system.bodies[k]) for k in numbers]
        self.bodies, self.entries = np.array(numbers, dtype=np.int64), np.array(entries, dtype=np.int64)
        n, throw = len(numbers), system.ejection
        self.ejection = np.zeros((n, 7))
        self.ejects = throw is not None and throw.body in numbers
        if throw is not None and self.ejects:
            self.ejection[numbers.index(throw.body)] = [*throw.impulse, *throw.angular_impulse, throw.work]
        self._of: Moving | None = None

    def follow(self, moving: Moving) -> None:
        """Make `arrays`, and `held` for the compiled loops, refer to a state, whose arrays are permanent."""
        if moving is self._of:
            return
        n = len(self.names)
        self.arrays = PortArrays(
            *moving.bodies.parts(),
            moving.first_order,
            self.bodies,
            self.entries,
            np.array([item.centre for item in self.frame_of], dtype=float),
            np.array([entry.axes for entry in self.frame_of], dtype=float),
            *(np.empty((n, width)) for width in (PER_FRAME, 7, PER_FRAME, PER_FRAME)),
        )
        self.held = port_loops().hold(self.arrays)
        self._of = moving


class NetSystem:
    """Case whose bodies of motion = "port" are moved by a host.

        net = NetSystem("net.toml")
        loads = net.step(0.01, {"chaser": FrameState(position, velocity, attitude, angular_velocity)})

    The host gives the states of its bodies at the end of a step. The net takes its own small steps until
    there, while the ports move smoothly from their present states (see `exunet.bodies.port`). Nodes that are
    fixed to a port do not have mass in the net: the host's body includes it (`carried_mass`). The recoil of
    an ejection at the start is in the loads of the first step.

    Parameters
    ----------
    case : str, Path, Case or Scene
        Name of a case file, the result of `exunet.load`, or a scene.
    overrides : sequence of str, optional
        "key.path=value", as after --set.
    wrenches : sequence of str, optional
        Free bodies of the net's case with an input "wrench/BODY", as of `Simulation`.

    Raises
    ------
    CaseError
        For a case that cannot be simulated.
    RunStopped
        In a step that a guard stops. The net is then at its last good state, at its `time`. It does not retry
        with finer steps (solver.retry), since the steps of the host cannot be repeated.
    """

    def __init__(
        self, case: str | Path | Case | Scene, overrides: Sequence[str] = (), *, wrenches: Sequence[str] = ()
    ) -> None:
        found = case_of(case, "NetSystem", overrides)
        start = prepare_case(found, hosted=True)
        with located_faults(found):
            if stops := stops_of_script(start.scene):
                raise CaseError(stops)
        solver = start.scene.solver.model_copy(update={"retry": 0})
        scene = start.scene.model_copy(update={"solver": solver})
        self._sim = Simulation(replace(start, scene=scene), wrenches=wrenches)
        self._size = self._sim.start.net.size  # as expensive as the rest of a step here
        self._ports = _Ports(self._sim.start.system)  # with the states that wrenches add
        self._ejections = _ejections(start.system)

    @property
    def size(self) -> float:
        """Size of the net at rest [m], the scale of positions."""
        return self._size

    @property
    def ports(self) -> tuple[str, ...]:
        """Names of the ports."""
        return self._ports.names

    @property
    def time(self) -> float:
        """Time reached [s]."""
        return self._sim.time

    @property
    def simulation(self) -> Simulation:
        """Simulation of the net, to read; `step` advances it."""
        return self._sim

    def frame(self, port: str) -> FrameState:
        """Return the present state of the frame of a port in the net."""
        number = self._number(port)
        body = int(self._ports.bodies[number])
        return self._ports.frame_of[number].frame_in(self._sim.moving.bodies, body)

    def delivered(self, port: str) -> Delivered:
        """Return what the net has done to the body of a port since the start, with an ejection there."""
        entry = int(self._ports.entries[self._number(port)])
        total = 0.0 - self._sim.moving.first_order[entry : entry + 7]
        return Delivered(total[:3], total[3:6], float(total[6]))

    def carried_mass(self, port: str) -> float:
        """Return the mass [kg] of the nodes that are fixed to a port; the host's body must include it."""
        kinematics = self._sim.start.system.kinematics
        nodes = kinematics.point[kinematics.body == self._ports.bodies[self._number(port)]]
        return float(self._sim.start.net.mass[nodes].sum())

    @property
    def momentum(self) -> Floats:
        """(3,) present momentum of the net and its free bodies [N s]; nodes on ports belong to the host."""
        return np.asarray(self._states().momentum[0])

    def energy_seen_from(self, port: str) -> float:
        """Return the elastic energy and the kinetic energy relative to a port of net and free bodies [J]."""
        system, now, velocity = self._sim.start.system, self._states(), np.array(self.frame(port).velocity)
        mass = float(system.mass.sum() + (system.body_mass * system.moves_freely).sum())
        beside = velocity @ (0.5 * mass * velocity - now.momentum[0])
        return float(now.kinetic[0] + beside + now.elastic[0])

    def _states(self) -> States:
        """Return the present state with the nodes that ports carry."""
        system, seen = self._sim.start.system, self._sim.view
        moving = seen.moving.completed(system.kinematics, seen.time, seen.discrete)
        return States.of(system, State.of(seen.time, moving, seen.discrete))

    def step(self, until: float, frames: Mapping[str, FrameState]) -> dict[str, PortLoad]:
        """Advance to a time [s] while each port moves to its state of `frames` at that time.

        Raises InputError for a time that is not later, for missing or unknown ports, for a state with NaN or
        infinity, for a pose that does not follow from the velocities (see this module), and for a
        rotation of more than 1 rad.
        """
        time, end = self.time, finite_number(until)
        if end is None or not end > time:
            raise InputError(
                f"step: must end later than the time reached, {time:g} s, got {until!r}: a host that goes "
                "back restores a snapshot first"
            )
        validate_ports("step", frames, self.ports, "the state")
        target = self.rows("step", frames)
        if not self.ports:
            self._advance_to(end)
            return {}
        pieces = self._pieces(time, end, target)
        states = self._ports.arrays.begin, self._ports.arrays.end
        earlier = self._earlier(time)
        validate_no_jump("step: port", self.ports, (time, end), states, earlier, PREDICTED, self.size)
        return self._go((time, end), target, pieces).of(self.ports)

    def follow(self, until: float, states: Floats) -> PortLoads:
        """Advance as `step`, to states (n, 13) of the ports that a coupling has predicted, without checks.

        A row has the numbers of a `FrameState`, one part after the other.
        """
        time, shape = self.time, (len(self.ports), PER_FRAME)
        if not (isinstance(states, np.ndarray) and states.shape == shape and until > time):
            raise InputError(
                f"follow: requires an array {shape} and a time later than {time:g} s; use `step`"
            )
        return self._go((time, until), states, self._pieces(time, until, states))

    def _pieces(self, time: float, end: float, target: Floats) -> list[Piece]:
        """Return the paths of the ports between two times [s] to states (n, 13) of their frames."""
        ports, n = self._ports, len(target)
        ports.follow(self._sim.moving)
        path = np.empty((n, 4, 3)), np.empty((n, 4)), np.empty((n, 4, 3))
        largest = port_loops().plan_motion(end - time, target, *path, ports.held)
        validate_rotation("step: port", ports.names, (time, end), largest)
        return list(map(Piece, repeat(time), *path))

    def _go(self, times: tuple[float, float], target: Floats, pieces: Sequence[Piece]) -> PortLoads:
        """Advance between two times [s] while the ports move along pieces to states (n, 13) of frames."""
        (time, end), ports, sim = times, self._ports, self._sim
        if time == sim.start.state.time:
            ports.arrays.given[:] -= ports.ejection  # part of the first step's load
        for name, piece in zip(ports.names, pieces, strict=True):
            sim.steer(name, piece)
        self._advance_to(end)
        impulses, wrenches = np.empty((len(target), 7)), np.empty((len(target), 6))
        port_loops().collect_loads(end - time, target, impulses, wrenches, ports.held)
        return PortLoads(time, end, impulses, wrenches)

    def _advance_to(self, end: float) -> None:
        """Advance to a time [s]; raise RunStopped with the time of the state at which the net is then."""
        try:
            self._sim.advance_to(end)
        except RunStopped as stop:
            stop.args = (f"{stop}; the net is at its last good state, t = {self.time:.6g} s",)
            raise

    def state_vector(self) -> Floats:
        """Return first-order states and states of all bodies in one array (m + 13 n,), attitudes last."""
        moving = self._sim.moving
        position, velocity, attitude, spin = moving.bodies.parts()
        return np.concatenate(
            [moving.first_order, position.ravel(), velocity.ravel(), spin.ravel(), attitude.ravel()]
        )

    def snapshot(self) -> Snapshot:
        """Return a snapshot of the net; in memory, or in a file by its `save`."""
        return self._sim.snapshot()

    def restore(self, snapshot: Snapshot) -> None:
        """Restore a snapshot of the same case; the net continues bitwise."""
        self._sim.restore(snapshot)

    def reset(self) -> None:
        """Go back to the start, without a new build."""
        self._sim.reset()

    def finish(self) -> None:
        """Check all states by the guards; raises RunStopped as `step` does.

        Guards check many states at once, so that a step may raise for an earlier one.
        """
        self._sim.settle()

    def _number(self, port: str) -> int:
        if port not in self.ports:
            raise InputError(f"there is no port {port!r}: {', '.join(self.ports)}")
        return self.ports.index(port)

    def rows(self, who: str, frames: Mapping[str, FrameState]) -> Floats:
        """Return states (n, 13) of all ports; raises InputError for an invalid state, see `FrameState.of`."""
        return rows_of(FrameState.of(frames[name], f"{who}: port {name}") for name in self.ports)

    def recoils(self, begin: float, end: float) -> bool:
        """Return True if the loads of a step between two times [s] contain the jump of an ejection."""
        at_start = self._ports.ejects and begin == self._sim.start.state.time
        return at_start or any(begin < time <= end for time in self._ejections)

    @property
    def ejections(self) -> tuple[float, ...]:
        """Times after the start at which ports eject the net that they hold [s]."""
        return self._ejections

    def validate_motion(self, times: tuple[float, float], states: tuple[Floats, Floats]) -> None:
        """Raise InputError if states (n, 13) of the ports at two times [s] are a jump."""
        frames = self._ports.frame_of
        pairs = (zip(frames, frames_of(self.ports, rows).values(), strict=True) for rows in states)
        begin, end = (rows_of(of.principal(state) for of, state in pair) for pair in pairs)
        earlier = self._earlier(times[0])
        validate_no_jump("step: port", self.ports, times, (begin, end), earlier, PREDICTED, self.size)

    def _earlier(self, time: float) -> Earlier:
        """Return the previous step of the ports, which has ended at a time [s]."""
        pieces = [self._sim.steered(name) for name in self.ports]
        states = np.zeros((len(pieces), PER_FRAME))
        states[:, 3:6] = [piece.position[2] for piece in pieces]
        states[:, 10:] = [piece.turning[2] for piece in pieces]
        return Earlier(states, max(0.0, time - pieces[0].time))


def _ejections(system: System) -> tuple[float, ...]:
    constraint, ports = system.forces.constraint, system.kinematics.ports
    if constraint is None or constraint.switch is None or constraint.discrete is None:
        return ()
    name = constraint.discrete.name
    held = [item for item in system.kinematics.held if item.discrete == name and item.body in ports]
    return constraint.switch.times if held else ()
