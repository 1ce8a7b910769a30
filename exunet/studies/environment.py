"""A case as an environment of Gymnasium: inputs of its forces are the action, read-outs the observation."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from functools import cached_property, partial
from operator import attrgetter
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from exunet.base.arguments import finite_number, finite_vector
from exunet.base.arrays import Floats
from exunet.base.errors import InputError, Interrupted, MissingExtra, RunStopped
from exunet.base.times import next_multiple, reached
from exunet.bodies.rigid import RigidStates, in_frames
from exunet.forces.on_bodies import input_name
from exunet.methods.method import Backend
from exunet.model.states import States
from exunet.model.system import State, System
from exunet.scene.casefile import Case
from exunet.scene.scene import Scene
from exunet.simulation.controller import LEAST_PERIOD
from exunet.simulation.preparation import Start, in_the_compiled_loop, start_of, with_wrenches
from exunet.simulation.simulation import Simulation
from exunet.studies.ensemble import perturbed, perturbed_bodies

try:
    from gymnasium import Env
    from gymnasium.spaces import Box
except ImportError:  # an optional extra: making an environment says so
    Env, Box = object, None

Bounds = tuple[ArrayLike, ArrayLike]
Read = Callable[["_Seen"], ArrayLike]

_WRENCH = input_name("")
_OF_BODY = ("position", "velocity", "attitude", "angular_velocity")


class _Seen:
    """States at an instant, computed on request."""

    def __init__(self, system: System, state: State) -> None:
        self._system, self._state = system, state
        self.time = state.time

    @cached_property
    def bodies(self) -> RigidStates:
        """Places of centres of mass, attitudes of frames."""
        return in_frames(self._system.bodies, self._state.bodies)

    @cached_property
    def points(self) -> States:
        """With nodes that bodies carry as they are now."""
        state, system = self._state, self._system
        moving = state.moving.completed(system.kinematics, state.time, state.discrete)
        return States.of(system, State.of(state.time, moving, state.discrete))


class NetEnvironment(Env):
    """A case to be controlled by an agent, as Gymnasium defines it; needs the extra "gym".

        environment = exunet.NetEnvironment(
            "case.toml",
            actions={"wrench/chaser": (-20.0, 20.0)},
            observations=["position/chaser", "velocity/chaser", "tension/tether tow"],
            period=0.05,
            reward=lambda simulation, observation, action: -np.linalg.norm(observation[:3]),
        )
        observation, info = environment.reset(seed=1)
        observation, reward, terminated, truncated, info = environment.step(action)

    case, overrides : as of `Simulation`; in the compiled loop
    actions      : the inputs that an action sets, each with its least and largest values: numbers, or one for
                   each value. "wrench/BODY" is force and torque on a free body, see `Simulation`. An action
                   is their values, one after the other; what is beyond its bounds is cut to them
    observations : what an observation has, one after the other: "time"; "position/OF" and "velocity/OF" of a
                   body or a node (number or name); "attitude/BODY", "angular_velocity/BODY";
                   all as `Simulation.bodies` has them; "tension/net", "tension/tether NAME": the largest now
    period       : time between two actions [s]; each acts until the next
    end          : of an episode, which is truncated there [s]; None: time.end of the case
    reward       : called with simulation, observation and action (as it acted) after each step; None: minus
                   the mean of the squares of the action, in parts of its bounds
    over         : called with simulation and observation after each step; True terminates the episode
    moved        : each reset moves the start by so much, seeded: places of free nodes and bodies [m], and by
                   as many radians and rad/s the attitudes and angular velocities of bodies

    A step that a guard stops truncates the episode at the last good state; info["stopped"] says why. A reset
    neither reads the case nor compiles anything again. Seed and actions determine the result to the last bit.
    Pickled and copied environments continue to the last bit, if `reward` and `over` can be pickled.
    Raises MissingExtra without Gymnasium, CaseError and InputError for what cannot be used.
    """

    metadata: ClassVar[dict[str, Any]] = {"render_modes": []}

    def __init__(
        self,
        case: str | Path | Case | Scene | Start,
        overrides: Sequence[str] = (),
        *,
        actions: Mapping[str, tuple[ArrayLike, ArrayLike]],
        observations: Sequence[str],
        period: float,
        end: float | None = None,
        reward: Callable[[Simulation, Floats, Floats], float] | None = None,
        over: Callable[[Simulation, Floats], bool] | None = None,
        moved: float = 0.0,
    ) -> None:
        if Box is None:
            raise MissingExtra("an environment needs Gymnasium: pip install 'exunet[gym]'")
        if not isinstance(actions, Mapping):
            raise InputError(f"NetEnvironment: actions: bounds by the name of each input, got {actions!r}")
        if isinstance(observations, str) or not isinstance(observations, Sequence):
            raise InputError(f"NetEnvironment: observations: a list of names, got {observations!r}")
        wrenches = [name.removeprefix(_WRENCH) for name in actions if name.startswith(_WRENCH)]
        start = start_of(case, overrides)
        if start.plan.backend != Backend.COMPILED:  # which alone restarts at once
            start = in_the_compiled_loop(start)
        self._start = with_wrenches(start, wrenches)
        self._period = _positive("period", period)
        if self._period < LEAST_PERIOD:
            raise InputError(f"NetEnvironment: period: {LEAST_PERIOD:g} s or more, got {period!r}")
        self._end = _positive("end", self._start.scene.time.end if end is None else end)
        amplitude = finite_number(moved)
        if amplitude is None or amplitude < 0.0:
            raise InputError(f"NetEnvironment: moved: a finite number, 0 or more, got {moved!r}")
        self._moved = amplitude
        self._reward, self._over = reward, over
        self._readers = [_reader(self._start.system, name) for name in observations]
        if not self._readers:
            raise InputError("NetEnvironment: observations: at least one, such as 'time'")
        self._inputs, least, largest = _inputs(self._start.system, actions)
        self._sim = Simulation(self._start)
        self._over_at: float | None = None  # when the episode ended before its time
        self.action_space = Box(least, largest, dtype=np.float64)
        size = len(self._observation())
        self.observation_space = Box(-np.inf, np.inf, (size,), dtype=np.float64)

    @property
    def simulation(self) -> Simulation:
        """The simulation, to look at, or to set back by a snapshot of it; another one after a moved reset."""
        return self._sim

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Floats, dict[str, Any]]:
        """Begin an episode: the observation at its start, and an empty dictionary.

        seed : of the moves of the start from now on; None: the moves go on
        """
        super().reset(seed=seed)
        self._over_at = None
        if self._moved:
            drawn = int(self.np_random.integers(2**63))
            place = perturbed(self._start.net, self._start.position, self._moved, (drawn, 0))
            bodies = perturbed_bodies(self._start, self._moved, (drawn, 1))
            anew = Simulation(self._start.moved(place, None, bodies))
            anew.controlled_as(self._sim)
            self._sim = anew
        else:
            self._sim.reset()
        return self._observation(), {}

    def step(self, action: ArrayLike) -> tuple[Floats, float, bool, bool, dict[str, Any]]:
        """Let an action act for a period: observation, reward, terminated, truncated, info.

        Raises InputError for an action of another size or with NaN, and after the end of an episode.
        """
        space, sim = self.action_space, self._sim
        given = finite_vector(action, space.shape[0])
        if given is None:
            raise InputError(f"step: an action is {space.shape[0]} finite numbers, got {action!r}")
        if reached(sim.time, self._end) or sim.time == self._over_at:
            raise InputError(f"step: the episode is over at t = {sim.time:g} s: call reset")
        acting = np.clip(given, space.low, space.high)
        info: dict[str, Any] = {}
        try:
            for name, part in self._inputs.items():
                sim.set_input(name, acting[part])
            sim.advance_to(min(self._end, next_multiple(sim.time, self._period)))
            sim.settle()
        except Interrupted:
            raise
        except RunStopped as stop:
            info["stopped"] = str(stop)
        seen = self._observation()
        terminated = bool(self._over and self._over(sim, seen))
        truncated = "stopped" in info or reached(sim.time, self._end)
        self._over_at = sim.time if terminated or truncated else None
        reward = self._effort(acting) if self._reward is None else float(self._reward(sim, seen, acting))
        return seen, reward, terminated, truncated, info

    def _effort(self, action: Floats) -> float:
        largest = np.maximum(abs(self.action_space.low), abs(self.action_space.high))
        return -float(np.mean((action / largest) ** 2))

    def _observation(self) -> Floats:
        seen = _Seen(self._start.system, self._sim.view)
        return np.concatenate([np.atleast_1d(read(seen)) for read in self._readers], dtype=np.float64)


def _positive(name: str, given: object) -> float:
    number = finite_number(given)
    if number is None or not number > 0.0:
        raise InputError(f"NetEnvironment: {name}: a finite number above 0, got {given!r}")
    return number


def _inputs(system: System, actions: Mapping[str, Bounds]) -> tuple[dict[str, slice], Floats, Floats]:
    """Which part of an action is which input; the least and the largest action."""
    where, least, largest = {}, [], []
    first = 0
    for name, bounds in actions.items():
        if name not in system.inputs:
            known = ", ".join(system.inputs) or "none in this scene"
            raise InputError(f"NetEnvironment: actions: there is no input {name!r}: {known}")
        size = len(system.inputs[name].initial)
        try:
            low, high = (np.broadcast_to(np.asarray(bound, dtype=float), (size,)) for bound in bounds)
        except (TypeError, ValueError):
            low = high = np.full(size, np.nan)
        if not (np.isfinite(low).all() and np.isfinite(high).all() and (low < high).all()):
            raise InputError(
                f"NetEnvironment: actions: {name}: a pair of least and largest values, each a finite "
                f"number or {size} of them, the least below the largest; got {bounds!r}"
            )
        where[name] = slice(first, first + size)
        first += size
        least.append(low)
        largest.append(high)
    if not where:
        raise InputError("NetEnvironment: actions: at least one input")
    return where, np.concatenate(least), np.concatenate(largest)


def _largest_tension(elements: slice, seen: _Seen) -> ArrayLike:
    return seen.points.tension[0, elements].max(initial=0.0)


def _of_body(what: str, row: int, seen: _Seen) -> ArrayLike:
    return getattr(seen.bodies, what)[row]


def _of_point(what: str, point: int, seen: _Seen) -> ArrayLike:
    return getattr(seen.points, what)[0, point]


def _reader(system: System, name: str) -> Read:
    """Takes the numbers of a read-out from what is seen, as views where it can."""
    what, _, whom = str(name).partition("/")
    blocks, groups = system.blocks, system.net.groups
    points = {str(node): node for node in range(system.net.n_nodes)}
    with suppress(ValueError):
        points.setdefault(whom, system.net.node(whom))
    if name == "time":
        return attrgetter("time")
    if what == "tension" and whom in groups:
        own = slice(groups[whom].start, groups[whom].stop)
        return partial(_largest_tension, own)
    if what in _OF_BODY and whom in blocks.rigid:
        row = blocks.rigid.index(whom)
        return partial(_of_body, what, row)
    if what in _OF_BODY[:2] and whom in points:
        point = points[whom]
        return partial(_of_point, what, point)
    nodes = ", ".join(filter(None, (f"0 to {system.net.n_nodes - 1}", system.net.node_names)))
    placed = ", ".join((*blocks.rigid, f"nodes ({nodes})"))
    raise InputError(
        f"NetEnvironment: observations: there is no {name!r}: time; position/ and velocity/ with {placed}; "
        f"attitude/ and angular_velocity/ with {', '.join(blocks.rigid) or 'bodies: none in this scene'}; "
        f"tension/ with {', '.join(groups)}"
    )
