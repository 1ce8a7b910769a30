"""What goes into the net and comes out of it at each communication point."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from exunet.bodies.port import PER_FRAME, FrameOf, FrameState, PrincipalState, frames_of
from exunet.coupling.fmu.variables import QUATERNION, Causality, Variable, structured, vector
from exunet.coupling.net_system import NetSystem, PortLoad
from exunet.forces.on_bodies import input_name
from exunet.model.states import States
from exunet.net.areas import mouth_area
from exunet.results.measures import net_centre
from exunet.scene.scene import Scene

Floats = NDArray[np.float64]
AT_END = Variable(
    "ports.inputs_at_end",
    "parameter",
    "true: the inputs of ports tell their states at the end of a communication step; false: at its "
    "beginning, from where they go on at the mean acceleration of the step before",
    0.0,
    is_switch=True,
)
LONGEST = Variable(
    "ports.longest_step",
    "parameter",
    "longest communication step; longer ones are discarded. 0: the largest stable one, by the ports' masses, "
    "inertias, stiffnesses and turns, for masters that move the host by the wrench of the same step. Masters "
    "that take the wrench of the step before (Jacobi) gain energy at any step",
    0.0,
    "s",
    low=0.0,
)
PER_BODY = 6  # inputs of each


class NetInstant:
    """A net at one instant, looked at once for all outputs.

    loads : of the step that ended here, by port; empty at the start
    """

    def __init__(self, net: NetSystem, loads: Mapping[str, PortLoad]) -> None:
        self.net, self.loads = net, loads
        self.system = net.simulation.start.system
        self.bodies = net.simulation.view.bodies

    @cached_property
    def states(self) -> States:
        """All states as a batch of one."""
        return States.of(self.system, self.net.simulation.state)


Read = Callable[[NetInstant], Iterator[float]]


def ports_of(scene: Scene) -> tuple[str, ...]:
    """The bodies that the host moves."""
    return tuple(name for name, body in scene.bodies.items() if body.motion == "port")


def free_bodies_of(scene: Scene) -> tuple[str, ...]:
    """The bodies that move by the forces on them, on which the host may let a wrench act."""
    return tuple(name for name, body in scene.bodies.items() if body.motion == "free")


class Signals:
    """The inputs and outputs of a net.

    inputs, outputs : their variables, in a fixed order; the values of outputs are those of `net` as it is
    """

    def __init__(self, net: NetSystem) -> None:
        start = net.simulation.start
        self.ports, self.bodies = ports_of(start.scene), free_bodies_of(start.scene)
        self._frames = {
            name: (k, FrameOf.body(start.system.bodies[k]))
            for k, name in enumerate(start.system.blocks.rigid)
        }
        inputs: list[Variable] = []
        for name in self.ports:
            inputs += _motion(f"ports.{structured(name)}", "input", net.frame(name), f"of port {name}")
        for name in self.bodies:
            of = f"bodies.{structured(name)}"
            words = f"on body {name} from outside, in the scene's axes"
            inputs += vector(
                f"{of}.force", "input", f"force at the origin of its frame {words}", (0,) * 3, "N"
            )
            inputs += vector(f"{of}.torque", "input", f"torque about that origin {words}", (0,) * 3, "N m")
        self.inputs = tuple(inputs)
        self._groups = [*self._of_ports(), *self._of_bodies(), *_of_net(net)]
        look = NetInstant(net, {})
        self.outputs = tuple(
            item for variables, read in self._groups for item in _started(variables, read(look))
        )

    def read(self, look: NetInstant) -> list[float]:
        """The values of the outputs."""
        return [float(value) for _, read in self._groups for value in read(look)]

    def frames(self, values: Floats) -> dict[str, FrameState]:
        """The states of the ports that the inputs tell; `values` are those of all inputs."""
        return frames_of(self.ports, values)

    def let_wrenches_act(self, net: NetSystem, values: Sequence[float]) -> None:
        """Give the forces and torques of the inputs to the free bodies."""
        first, sim = PER_FRAME * len(self.ports), net.simulation
        for name in self.bodies:
            sim.set_input(input_name(name), values[first : first + PER_BODY])
            first += PER_BODY

    def _of_ports(self) -> Iterator[tuple[list[Variable], Read]]:
        for name in self.ports:
            of, words = f"ports.{structured(name)}", f"on the host's body at port {name}, in the scene's axes"
            zeros = (0.0,) * 3
            yield (
                [
                    *vector(f"{of}.force", "output", f"mean force of the last step {words}", zeros, "N"),
                    *vector(
                        f"{of}.torque",
                        "output",
                        f"mean torque of the last step about the origin of the port's frame {words}",
                        zeros,
                        "N m",
                    ),
                    *vector(f"{of}.impulse", "output", f"impulse since the start {words}", zeros, "N s"),
                    *vector(
                        f"{of}.angular_impulse",
                        "output",
                        f"angular impulse since the start about the scene's origin {words}",
                        zeros,
                        "N m s",
                    ),
                    Variable(f"{of}.work", "output", f"work since the start {words}", 0.0, "J"),
                ],
                _reads_port(name),
            )

    def _of_bodies(self) -> Iterator[tuple[list[Variable], Read]]:
        for name in self.bodies:
            at_origin = FrameState((0.0,) * 3)  # the values come with `_started`
            variables = _motion(f"bodies.{structured(name)}", "output", at_origin, f"of body {name}")
            yield variables, _reads_body(*self._frames[name])


def _started(variables: Sequence[Variable], values: Iterator[float]) -> Iterator[Variable]:
    for variable, value in zip(variables, values, strict=True):
        yield replace(variable, start=float(value))


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


def _reads_port(name: str) -> Read:
    def read(look: NetInstant) -> Iterator[float]:
        load, given = look.loads.get(name), look.net.given(name)
        yield from np.zeros(3) if load is None else load.force
        yield from np.zeros(3) if load is None else load.torque
        yield from given.impulse
        yield from given.angular_impulse
        yield given.work

    return read


def _reads_body(number: int, frame: FrameOf) -> Read:
    def read(look: NetInstant) -> Iterator[float]:
        parts = look.bodies.parts()
        state = frame.frame(PrincipalState(*(tuple(part[number].tolist()) for part in parts)))
        for part in state:
            yield from part

    return read


def _of_net(net: NetSystem) -> Iterator[tuple[list[Variable], Read]]:
    own = net.simulation.start.net

    def output(name: str, description: str, unit: str) -> Variable:
        return Variable(f"net.{name}", "output", description, 0.0, unit)

    def energies(look: NetInstant) -> Iterator[float]:
        states = look.states
        for part in (states.kinetic, states.elastic, states.potential):
            yield part[0]
        yield look.net.simulation.monitor.dissipated

    if own.mouth:
        area = output("mouth_area", "area of the net's mouth", "m2")
        yield [area], lambda look: iter(mouth_area(own, look.states.position[:, : own.n_nodes]))
    tension = output("largest_tension", "largest tension of all steps so far", "N")
    yield [tension], lambda look: iter([look.net.simulation.largest_tension["tension_N"]])
    yield (
        [
            output("energy.kinetic", "kinetic energy of net and free bodies", "J"),
            output("energy.elastic", "elastic energy", "J"),
            output("energy.potential", "potential energy of the other forces", "J"),
            output("energy.dissipated", "dissipated since the start, less what inputs have put in", "J"),
        ],
        energies,
    )
    words = "centre of mass of net, strings and bullets, without tethers"
    yield (
        vector("net.centre", "output", words, (0.0,) * 3, "m"),
        lambda look: iter(net_centre(own, look.states.position[:, : own.n_nodes])[0]),
    )
    for k, node in enumerate(own.bullet_nodes.tolist()):
        yield (
            [
                *vector(f"net.bullet{k}.position", "output", f"position of bullet {k}", (0.0,) * 3, "m"),
                *vector(f"net.bullet{k}.velocity", "output", f"velocity of bullet {k}", (0.0,) * 3, "m/s"),
            ],
            _reads_node(node),
        )


def _reads_node(node: int) -> Read:
    def read(look: NetInstant) -> Iterator[float]:
        yield from look.states.position[0, node]
        yield from look.states.velocity[0, node]

    return read
