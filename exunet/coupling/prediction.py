"""Where a host's bodies will be at the end of a step, and how long a step may be.

The bodies are taken to go on at the mean acceleration that they had in the step before. For a mass m on a
spring k, which is a net between the port and something heavy, the coupling without repeats then takes out a
little energy as long as H^2 k / m is below a bound, and puts some in above; at constant velocity it would put
some in at every step. The bounds are where the spectral radius of the linear map from step to step passes 1;
`tests/test_macro_steps.py` has the maps. With a damper c beside the spring it is H^2 k / m + 2 H c / m that
must be below. Repeats contract by H^2 k / (6 m) + H c / (2 m).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import reduce
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from exunet.base.errors import InputError
from exunet.bodies.port import PER_FRAME
from exunet.coupling.net_system import NetSystem
from exunet.coupling.port_loops import port_loops
from exunet.coupling.ports import LARGEST_TURN, OWN, Earlier, refuse_jump
from exunet.coupling.stability import Feeding, PortModes, Ratios, ratios_of, slope_at, steepest_at_ports
from exunet.forces.cable import STRETCH_BOUND
from exunet.forces.on_bodies import held_by, mass_matrix
from exunet.forces.reel import memory_name

Floats = NDArray[np.float64]


class Bound(NamedTuple):
    """Macro steps H are stable while H^2 k / m + damper * H c / m is below `spring`, as far as what is light
    beside the port allows them, see `exunet.coupling.stability`."""

    spring: float
    damper: float
    beside: Feeding


# without repeats, hosts that apply each impulse in its step
STABLE = Bound(1.0, 2.0, Feeding(1.8, 0.11, 5.0))
# without repeats, hosts that weigh forces, see `exunet.coupling.exudyn_state`
WEIGHING = Bound(0.58, 2.0, Feeding(0.9, 0.28, 7.5))
CONTRACTING = Bound(6.0, 3.0, Feeding(9.0, 0.008, 3.5))  # with repeats
MARGIN = 0.95  # of the step at which amplitudes begin to grow, or repeats to part


class Predictor:
    """Remembers how the host's bodies moved at the beginning of the last step that counts.

    before : that time [s], and the states (n, 13) of the frames of all ports then; None: there was no step
    """

    def __init__(self, before: tuple[float, Floats] | None = None) -> None:
        self._before = before

    @property
    def before(self) -> tuple[float, Floats] | None:
        """All that it remembers."""
        return self._before

    def numbers(self) -> Floats:
        """All that it remembers, port by port after the time; empty if there was no step."""
        if self._before is None:
            return np.zeros(0)
        time, states = self._before
        return np.concatenate([[time], states.ravel()])

    @classmethod
    def of_numbers(cls, numbers: Floats) -> Predictor:
        """One that remembers what `numbers` gave."""
        if not len(numbers):
            return cls()
        return cls((float(numbers[0]), numbers[1:].reshape(-1, PER_FRAME).copy()))

    @staticmethod
    def takes(ports: Sequence[str], numbers: Floats) -> bool:
        """True if numbers may be what `numbers` gives for these ports."""
        return numbers.dtype == np.float64 and numbers.shape in ((0,), (1 + PER_FRAME * len(ports),))

    def told(self, begin: float, until: float, now: Floats) -> Floats:
        """(n, 13) states at `until` [s], by those at `begin` and at the beginning of the step before.

        A step that is taken again begins at the same time, and is predicted alike.
        """
        told = np.empty_like(now)
        port_loops().go_on(now, *self.earlier(begin, now), until - begin, told)
        return told

    def earlier(self, begin: float, now: Floats) -> Earlier:
        """The step before one that begins at a time [s] with states (n, 13)."""
        if self._before is None or not self._before[0] < begin:
            return Earlier(now, 0.0)
        return Earlier(self._before[1], begin - self._before[0])

    def refuse_jump(
        self,
        who: str,
        names: Sequence[str],
        times: tuple[float, float],
        states: tuple[Floats, Floats],
        size: float,
    ) -> None:
        """Raise InputError if a host's body gets elsewhere in a step than it moves, see that function."""
        refuse_jump(who, names, times, states, self.earlier(times[0], states[0]), OWN, size)

    def forget(self) -> None:
        """A jump of the velocity does not go on: the next step is predicted at constant velocity."""
        self._before = None

    def keep(self, begin: float, now: Floats) -> None:
        """The step that began so counts; now : (n, 13), which is kept as it is."""
        self._before = begin, now


class LongestStep:
    """The longest macro step [s], by the port that is lightest for its stiffness; infinite if none has any.

    m is what resists a force at the port's nodes or surface, by mass and inertia that the case states of the
    port's body; k and c are what elements and contact can put on it, see `exunet.coupling.stability`. The
    outlet of a reel counts with the least length that it may come to. A port that turns at the start turns by
    `LARGEST_TURN` in a step at most. The tangent of the elements' law grows with their stretch, so the
    longest step is by that of now: `now`, and in a step that begins `allows`. What is light beside a port
    makes it shorter, see `exunet.coupling.stability`. `MARGIN` of what springs allow is kept.

    shared : ports that are one body of the host's, together: what pulls at one adds to what pulls at another
    beside : by port, what else pulls at its body, such as another net
    Raises InputError for a port that holds masses, a packed net or what may come onto a drum, which resist
    its acceleration more than its body does: no step is short enough for them.
    """

    def __init__(
        self,
        net: NetSystem,
        bound: Bound,
        shared: Sequence[Sequence[str]] = (),
        beside: Mapping[str, Ratios] = MappingProxyType({}),
    ) -> None:
        for port in net.ports:
            _refuse_heavy(net, port)
        own = {port: ratios_of(net, port) for port in net.ports}
        self._net, self._bound, self._totals, self._turning = net, bound, {}, math.inf
        for port in net.ports:
            of_body = next((group for group in shared if port in group), (port,))
            of_all = reduce(Ratios.plus, [own[item] for item in of_body], beside.get(port, Ratios()))
            self._totals[port] = of_all, PortModes.of(net, port, len(of_body))
            spin = math.hypot(*net.frame(port).angular_velocity)
            if spin > 0.0:
                self._turning = min(self._turning, LARGEST_TURN / spin)
        self._always = self._at(slope_at(STRETCH_BOUND**2))

    def _at(self, slope: float) -> float:
        return min([self._turning, *(self._of_port(*total, slope) for total in self._totals.values())])

    def _of_port(self, ratios: Ratios, modes: PortModes, slope: float) -> float:
        bound, steep = self._bound, ratios.at(slope)
        of_modes = modes.longest(bound.beside, steep.spring / bound.spring, slope)
        return min(MARGIN * _longest_of(bound, steep), of_modes)

    @property
    def now(self) -> float:
        """With the stretch that there is."""
        return self._at(steepest_at_ports(self._net))

    def allows(self, step: float) -> bool:
        """True for a step [s] that is not longer, with the stretch that its elements are on the way to."""
        most = step * (1.0 - 1e-9)
        return most <= self._always or most <= self._at(steepest_at_ports(self._net, step))


def longest_step(net: NetSystem, bound: Bound) -> float:
    """See `LongestStep`."""
    return LongestStep(net, bound).now


def _longest_of(bound: Bound, ratios: Ratios) -> float:
    if not ratios.spring > 0.0:
        return math.inf
    half = 0.5 * bound.damper * ratios.damper
    # the root of spring H^2 + 2 half H = bound, in the form that loses no digits
    return bound.spring / (half + math.sqrt(half * half + ratios.spring * bound.spring))


def _refuse_heavy(net: NetSystem, port: str) -> None:
    """Predicted from the acceleration before, an inertia that is held must be smaller than the body's."""
    system = net.simulation.start.system
    number = system.blocks.rigid.index(port)
    body, nothing = system.bodies[number], (np.zeros(0), np.zeros((0, 3)))
    most = {memory_name(reel.reel): np.array([reel.reel.most_on_drum]) for reel in system.forces.cable.reels}
    mass, arm = held_by(system.kinematics.held, number, {**net.simulation.start.state.memory, **most})
    own = mass_matrix(body.mass, np.array(body.inertia), *nothing)
    held = mass_matrix(body.mass, np.array(body.inertia), mass, arm) - own
    if len(mass) and not np.abs(np.linalg.eigvals(np.linalg.solve(own, held))).max() < 1.0:
        raise InputError(
            f"port {port} holds {mass.sum():.4g} kg, too much for its body of {body.mass:.4g} kg: no macro "
            'step is stable. Give the body to the net\'s case (motion = "free", with a wrench from the host)'
        )
