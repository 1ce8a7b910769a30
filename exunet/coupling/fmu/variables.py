"""Variables of an FMU: parameters from numbers of the case, inputs and outputs of its net.

Parameters are numbers and vectors of the case in the tables that `_STUDIED` names. None of them changes the
number of nodes, elements or bodies. A value that differs from the case's is an override.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal, get_args

import numpy as np
from annotated_types import Ge, Gt, Le, Lt
from pydantic.fields import FieldInfo

from exunet.base.arrays import Floats
from exunet.base.record import Record
from exunet.bodies.port import PER_FRAME, FrameOf, FrameState, frames_of
from exunet.coupling.net_system import NetSystem, PortLoad
from exunet.forces.on_bodies import input_name
from exunet.model.states import States
from exunet.net.areas import mouth_area
from exunet.results.measures import net_centre
from exunet.scene.scene import Scene

Causality = Literal["parameter", "input", "output"]
AXES = ("x", "y", "z")
QUATERNION = ("w", "x", "y", "z")
_ZERO = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Variable:
    """Scalar of the model description.

    start     : at time 0; of an output, with the unchanged case
    unit      : as in descriptions of keys; "" for a pure number
    low, high : bounds; None: none
    is_switch : boolean instead of a number
    """

    name: str
    causality: Causality
    description: str
    start: float
    unit: str = ""
    low: float | None = None
    high: float | None = None
    is_switch: bool = False


def structured(name: str) -> str:
    """Return a dotted name of the case as FMI writes it: parts that are not identifiers in quotes."""
    parts = (re.fullmatch(r"(.*?)((?:\[\d+\])?)", part) for part in name.split("."))
    return ".".join(
        (part[1] if re.fullmatch(r"[A-Za-z_]\w*", part[1], re.ASCII) else f"'{part[1]}'") + part[2]
        for part in parts
        if part is not None
    )


def vector(
    name: str,
    causality: Causality,
    description: str,
    start: Sequence[float] = _ZERO,
    unit: str = "",
    parts: Sequence[str] = AXES,
) -> list[Variable]:
    """Return a variable for each component."""
    return [
        Variable(f"{name}.{part}", causality, f"{description}, {part}", float(value), unit)
        for part, value in zip(parts, start, strict=True)
    ]


# Powers of the base units; units with an offset, such as degrees Celsius, do not occur in cases.
_KNOWN: Mapping[str, Mapping[str, int]] = {
    **{unit: {unit: 1} for unit in ("kg", "m", "s", "K", "rad")},
    "N": {"kg": 1, "m": 1, "s": -2},
    "J": {"kg": 1, "m": 2, "s": -2},
    "W": {"kg": 1, "m": 2, "s": -3},
    "Pa": {"kg": 1, "m": -1, "s": -2},
}
_FACTOR = re.compile(r"([A-Za-z]+)(-?\d+)?")


def powers(unit: str) -> dict[str, int]:
    """Return the powers of kg, m, s, K and rad; raise ValueError for an unknown unit.

    What stands after a slash, in parentheses if it is more than one factor, divides.
    """
    above, slash, below = unit.strip().partition("/")
    if not above or (slash and not below):
        raise ValueError(f"{unit!r} is not a unit")
    found: Counter[str] = Counter()
    for text, sign in ((above, 1), (below.strip().removeprefix("(").removesuffix(")"), -1)):
        for factor in text.split():
            if factor == "1":
                continue
            match = _FACTOR.fullmatch(factor)
            if match is None or match[1] not in _KNOWN:
                raise ValueError(f"{unit!r} is not a unit")
            for base, power in _KNOWN[match[1]].items():
                found[base] += sign * power * int(match[2] or 1)
    return {base: power for base, power in found.items() if power}


def unit_in(description: str) -> str:
    """Return the unit in brackets in the description of a key; "" for a pure number."""
    for text in re.findall(r"\[([^\[\]]+)\]", description):
        try:
            powers(text)
        except ValueError:
            continue
        return text.strip()
    return ""


_NAME = r"[^.]+"
_STUDIED = re.compile(
    "|".join(
        (
            rf"launch\.{_NAME}",
            rf"net\.(cable|strings|border)\.{_NAME}",
            r"net\.bullets\.mass",
            r"initial\.(packing|velocity|spin)",
            rf"bodies\.{_NAME}\.(mass|density|inertia|position|velocity|angular_velocity|angle)",
            rf"tethers\.{_NAME}\.{_NAME}",
            rf"tethers\.{_NAME}\.reel\.{_NAME}",
            rf"tethers\.{_NAME}\.reel\.commands\[\d+\]\.{_NAME}",
            rf"effects\.{_NAME}\.{_NAME}",
        )
    )
)
# A port starts where its inputs are.
_OF_PORTS = ("position", "velocity", "angular_velocity", "angle")
_STIFFNESS = Variable(
    "stiffness_factor", "parameter", "factor of every Young's modulus; greater than 0", 1.0, low=0.0
)


class Parameters:
    """Parameters of a scene.

    variables : in a fixed order, the stiffness factor last
    """

    def __init__(self, scene: Scene) -> None:
        self._keys: list[tuple[str, Any, int]] = []  # path, value and component of each
        variables = []
        for name, value, info in _numbers(scene):
            if not _STUDIED.fullmatch(name) or _is_of_port(name, scene):
                continue
            low, high, is_open = _bounds(info)
            words = info.description or name
            if is_open:
                words += f"; greater than {low:g}"
            many = isinstance(value, tuple)
            for k, number in enumerate(value if many else (value,)):
                self._keys.append((name, value, k))
                shown = f"case.{structured(name)}" + (f".{AXES[k]}" if many else "")
                text = words + (f", {AXES[k]}" if many else "")
                variables.append(Variable(shown, "parameter", text, number, unit_in(words), low, high))
        self.variables: tuple[Variable, ...] = (*variables, _STIFFNESS)

    def overrides(self, values: Sequence[float]) -> list[str]:
        """Return the overrides for values in the order of the variables."""
        *own, factor = values
        changed: dict[str, Any] = {}
        for (path, before, k), variable, value in zip(self._keys, self.variables, own, strict=False):
            if factor != 1.0 and path.endswith(".youngs_modulus"):
                value *= factor
            if value == variable.start:
                continue
            if isinstance(before, tuple):  # which the case may not state, so that it has no items to set
                changed.setdefault(path, list(before))[k] = value
            else:
                changed[path] = value
        return [f"{path}={value!r}" for path, value in changed.items()]


def _is_of_port(name: str, scene: Scene) -> bool:
    table, body, *rest = name.split(".")
    return table == "bodies" and scene.bodies[body].motion == "port" and rest[0] in _OF_PORTS


def _numbers(table: Record, above: str = "") -> Iterator[tuple[str, Any, FieldInfo]]:
    """Yield path, value and field of every number and vector of a table and its subtables."""
    for name, info in type(table).model_fields.items():
        value, full = getattr(table, name), f"{above}{name}"
        tables: dict[str, Any] = {}
        if isinstance(value, Record):
            tables[full] = value
        elif isinstance(value, Mapping):
            tables = {f"{full}.{own}": item for own, item in value.items()}
        elif isinstance(value, float) or (
            isinstance(value, tuple) and len(value) == 3 and all(isinstance(item, float) for item in value)
        ):
            yield full, value, info
        elif isinstance(value, tuple):
            tables = {f"{full}[{k}]": item for k, item in enumerate(value)}
        for path, item in tables.items():
            if isinstance(item, Record):
                yield from _numbers(item, f"{path}.")


def _bounds(info: FieldInfo) -> tuple[float | None, float | None, bool]:
    """Return the bounds of a field, of an optional one, or of components; True if the lower is excluded."""
    limits, waiting = list(info.metadata), [info.annotation]
    while waiting:
        for arg in get_args(waiting.pop()):
            if isinstance(arg, FieldInfo):
                limits += arg.metadata
            elif isinstance(arg, Ge | Gt | Le | Lt):
                limits.append(arg)
            else:
                waiting.append(arg)
    low = high = None
    for limit in limits:
        if isinstance(limit, Gt | Ge):
            low = float(limit.gt if isinstance(limit, Gt) else limit.ge)  # type: ignore[arg-type]
        elif isinstance(limit, Lt | Le):
            high = float(limit.lt if isinstance(limit, Lt) else limit.le)  # type: ignore[arg-type]
    return low, high, any(isinstance(limit, Gt) for limit in limits)


AT_END = Variable(
    "ports.inputs_at_end",
    "parameter",
    "true: inputs of ports are states at the end of a communication step; false: at its begin, from where "
    "they continue at the mean acceleration of the step before",
    0.0,
    is_switch=True,
)
LONGEST = Variable(
    "ports.longest_step",
    "parameter",
    "longest communication step; longer ones are discarded. 0: the largest stable one, by the ports' "
    "masses, inertias, stiffnesses and rotations, for masters that move the host by the wrench of the same "
    "step. Masters that take the wrench of the step before (Jacobi) gain energy at any step",
    0.0,
    "s",
    low=0.0,
)
PER_BODY = 6  # inputs of each


class NetInstant:
    """A net at one instant, evaluated once for all outputs.

    loads : of the step that ended here, by port; empty at the start
    """

    def __init__(self, net: NetSystem, loads: Mapping[str, PortLoad]) -> None:
        self.net, self.loads = net, loads
        self.bodies = net.simulation.view.bodies

    @cached_property
    def states(self) -> States:
        """All states as a batch of one."""
        return States.of(self.net.simulation.start.system, self.net.simulation.state)


Read = Callable[[NetInstant], Iterator[float]]


def ports_of(scene: Scene) -> tuple[str, ...]:
    """Return the bodies that the host moves."""
    return tuple(name for name, body in scene.bodies.items() if body.motion == "port")


def free_bodies_of(scene: Scene) -> tuple[str, ...]:
    """Return the free bodies, on which the host may apply a wrench."""
    return tuple(name for name, body in scene.bodies.items() if body.motion == "free")


class Signals:
    """Inputs and outputs of a net.

    inputs, outputs : variables in a fixed order; outputs start with the present values of the net
    """

    def __init__(self, net: NetSystem) -> None:
        start = net.simulation.start
        self.ports, self.bodies = ports_of(start.scene), free_bodies_of(start.scene)
        inputs: list[Variable] = []
        for name in self.ports:
            inputs += _motion(f"ports.{structured(name)}", "input", net.frame(name), f"of port {name}")
        for name in self.bodies:
            of, words = f"bodies.{structured(name)}", f"on body {name} from outside, in the scene's axes"
            inputs += vector(f"{of}.force", "input", f"force at the origin of its frame {words}", unit="N")
            inputs += vector(f"{of}.torque", "input", f"torque about that origin {words}", unit="N m")
        self.inputs = tuple(inputs)
        self._groups = [*map(_of_port, self.ports), *self._of_bodies(net), *_of_net(net)]
        instant = NetInstant(net, {})
        self.outputs = tuple(
            replace(variable, start=float(value))
            for variables, read in self._groups
            for variable, value in zip(variables, read(instant), strict=True)
        )

    def read(self, instant: NetInstant) -> list[float]:
        """Return the values of the outputs."""
        return [float(value) for _, read in self._groups for value in read(instant)]

    def frames(self, values: Floats) -> dict[str, FrameState]:
        """Return the states of the ports from the values of all inputs."""
        return frames_of(self.ports, values)

    def apply_wrenches(self, net: NetSystem, values: Sequence[float]) -> None:
        """Apply the forces and torques of all inputs to the free bodies."""
        first = PER_FRAME * len(self.ports)
        for name in self.bodies:
            net.simulation.set_input(input_name(name), values[first : first + PER_BODY])
            first += PER_BODY

    def _of_bodies(self, net: NetSystem) -> Iterator[tuple[list[Variable], Read]]:
        system = net.simulation.start.system
        at_origin = FrameState(_ZERO)  # the values follow
        for name in self.bodies:
            variables = _motion(f"bodies.{structured(name)}", "output", at_origin, f"of body {name}")
            number = system.blocks.rigid.index(name)
            yield variables, _reads_body(number, FrameOf.body(system.bodies[number]))


def _motion(of: str, causality: Causality, state: FrameState, whose: str) -> list[Variable]:
    place, speed = f"position of the frame's origin {whose}", f"velocity of the frame's origin {whose}"
    turn = f"unit quaternion from the axes of the frame {whose} to the scene's"
    spin = f"angular velocity in the axes of the frame {whose}"
    return [
        *vector(f"{of}.position", causality, place, state.position, "m"),
        *vector(f"{of}.velocity", causality, speed, state.velocity, "m/s"),
        *vector(f"{of}.attitude", causality, turn, state.attitude, parts=QUATERNION),
        *vector(f"{of}.angular_velocity", causality, spin, state.angular_velocity, "rad/s"),
    ]


def _of_port(name: str) -> tuple[list[Variable], Read]:
    of, words = f"ports.{structured(name)}", f"on the host's body at port {name}, in the scene's axes"
    variables = []
    for what, description, unit in (
        ("force", "mean force of the last step", "N"),
        ("torque", "mean torque of the last step about the origin of the port's frame", "N m"),
        ("impulse", "impulse since the start", "N s"),
        ("angular_impulse", "angular impulse since the start about the scene's origin", "N m s"),
    ):
        variables += vector(f"{of}.{what}", "output", f"{description} {words}", unit=unit)
    variables.append(Variable(f"{of}.work", "output", f"work since the start {words}", 0.0, "J"))

    def read(instant: NetInstant) -> Iterator[float]:
        load, total = instant.loads.get(name), instant.net.delivered(name)
        yield from np.zeros(6) if load is None else (*load.force, *load.torque)
        yield from (*total.impulse, *total.angular_impulse, total.work)

    return variables, read


def _reads_body(number: int, frame: FrameOf) -> Read:
    def read(instant: NetInstant) -> Iterator[float]:
        for part in frame.frame_in(instant.bodies, number):
            yield from part

    return read


def _of_net(net: NetSystem) -> Iterator[tuple[list[Variable], Read]]:
    own = net.simulation.start.net

    def output(name: str, description: str, unit: str) -> Variable:
        return Variable(f"net.{name}", "output", description, 0.0, unit)

    def energies(instant: NetInstant) -> Iterator[float]:
        states = instant.states
        for part in (states.kinetic, states.elastic, states.potential):
            yield part[0]
        yield instant.net.simulation.balance.dissipated

    if own.mouth:
        area = output("mouth_area", "area of the net's mouth", "m2")
        yield [area], lambda instant: iter(mouth_area(own, instant.states.position[:, : own.n_nodes]))
    tension = output("largest_tension", "largest tension of all steps so far", "N")
    yield [tension], lambda instant: iter([instant.net.simulation.largest_tension.tension])
    yield (
        [
            output("energy.kinetic", "kinetic energy of net and free bodies", "J"),
            output("energy.elastic", "elastic energy", "J"),
            output("energy.potential", "potential energy of the other forces", "J"),
            output("energy.dissipated", "dissipated since the start, less the work of inputs", "J"),
        ],
        energies,
    )
    yield (
        vector(
            "net.centre", "output", "centre of mass of net, strings and bullets, without tethers", unit="m"
        ),
        lambda instant: iter(net_centre(own, instant.states.position[:, : own.n_nodes])[0]),
    )
    for k, node in enumerate(own.bullet_nodes.tolist()):
        of = f"net.bullet{k}"
        variables = vector(f"{of}.position", "output", f"position of bullet {k}", unit="m")
        yield (
            variables + vector(f"{of}.velocity", "output", f"velocity of bullet {k}", unit="m/s"),
            _reads_node(node),
        )


def _reads_node(node: int) -> Read:
    def read(instant: NetInstant) -> Iterator[float]:
        yield from instant.states.position[0, node]
        yield from instant.states.velocity[0, node]

    return read
