"""How long macro steps may be: the linear map from step to step, and couplings to Exudyn's methods.

A mass on a spring and a damper, which is a net between the port and something heavy. The map is written from
what the methods do, not from the coupling's code: states are the host's place and velocity, the velocity one
step before, the force that was handed over last, the method's own acceleration, what is owed, the mean force
of the step before, and place and velocity that the port was told last. m = H = 1, so that k is H^2 k / m and
the relaxation time of the damper is in macro steps.
"""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import exudyn as exu
import numpy as np
import pytest
from coupled import energy_of, spring, stiffness
from exudyn.itemInterface import MarkerBodyRigid, NodeRigidBodyRotVecLG, ObjectRigidBody

import exunet
from exunet.coupling.handover import Handover, weights_of
from exunet.coupling.prediction import CONTRACTING, MARGIN, STABLE, WEIGHING, longest_step


def step(state: np.ndarray, method: str, k: float, damping: float, *, lags: bool = False) -> np.ndarray:
    """One macro step; `lags`: methods that weigh are handed the mean force as it is."""
    x, v, before, given, own, owed, last, told, speed = state
    own, owed = own * (method[0] not in "RV"), owed * (method[0] != "R")  # which they do not have
    acceleration = v - before
    place, fast = x + v + 0.5 * acceleration, v + acceleration
    mean = -k * (0.5 * (told + place) + (speed - fast) / 12.0) - damping * k * (place - told)
    handed = mean
    if method[0] != "R" and not lags:
        expected = 1.5 * mean - 0.5 * last
        owed = owed + mean - 0.5 * (given + expected)
        handed = expected + owed
        owed = owed - 0.5 * (handed - expected)
    if method == "RK44":
        x, new = x + v + 0.5 * mean, v + mean
    elif method == "RK44 in parallel":
        x, new = x + v + 0.5 * given, v + given
    elif method == "VelocityVerlet":
        x, new = x + v + 0.5 * given, v + 0.5 * (given + handed)
    else:
        radius = 1.0 if method == "TrapezoidalIndex2" else float(method[16:])
        m, f = (2.0 * radius - 1.0) / (radius + 1.0), radius / (radius + 1.0)
        if method == "TrapezoidalIndex2":
            m = f = 0.0
        gamma = 0.5 + f - m
        beta = 0.25 * (gamma + 0.5) ** 2
        rate = ((1.0 - f) * handed + f * given - m * own) / (1.0 - m)
        x, new = x + v + (0.5 - beta) * own + beta * rate, v + (1.0 - gamma) * own + gamma * rate
        own = rate
    if method == "TrapezoidalIndex2":
        own = handed
    return np.array([x, new, v, handed, own, owed, mean, place, fast])


def growth(method: str, k: float, damping: float = 0.0, *, lags: bool = False) -> float:
    """Of amplitudes in a macro step: the spectral radius less 1."""
    columns = [step(unit, method, k, damping, lags=lags) for unit in np.eye(9)]
    return float(np.abs(np.linalg.eigvals(np.array(columns).T)).max() - 1.0)


METHODS = ("VelocityVerlet", "TrapezoidalIndex2", *(f"GeneralizedAlpha{r}" for r in (0.2, 0.5, 0.9, 1.0)))


@pytest.mark.parametrize("method", ["RK44", *METHODS])
@pytest.mark.parametrize("damping", [0.0, 0.1, 1.0, 10.0])
def test_amplitudes_do_not_grow_below_the_bound(method: str, damping: float) -> None:
    """k (1 + 2 tau) below the bound, tau the relaxation time in macro steps."""
    bound = STABLE if method == "RK44" else WEIGHING
    for part in (1e-4, 1e-2, 0.1, 0.3, 0.6, 0.99):
        k = part * bound.spring / (1.0 + bound.damper * damping)
        assert growth(method, k, damping) < 1e-12, (part, k)


def test_the_bounds_are_near_to_where_amplitudes_grow() -> None:
    """Within a hundredth for Runge-Kutta methods, and two for velocity Verlet, of those that weigh."""
    assert growth("RK44", 1.01 * STABLE.spring) > 0.0
    assert growth("VelocityVerlet", 1.02 * WEIGHING.spring) > 0.0


@pytest.mark.parametrize("method", METHODS)
def test_handed_the_mean_force_amplitudes_would_grow_at_any_step(method: str) -> None:
    """By H^2 k / (4 m) a step, which is a negative damping; this is why it is not handed over so."""
    for k in (1e-3, 1e-2):
        assert growth(method, k, lags=True) == pytest.approx(0.25 * k, rel=0.05)


def test_in_parallel_amplitudes_grow_at_any_step() -> None:
    """By H^2 k / (2 m) a step: masters that step host and net at once (Jacobi) lag by a whole step."""
    for k in (1e-4, 1e-3, 1e-2):
        assert growth("RK44 in parallel", k) == pytest.approx(0.5 * k, rel=0.05)
    assert growth("RK44 in parallel", 0.5) > 0.1


def test_a_damper_makes_the_longest_step_shorter(tmp_path: Path) -> None:
    """H^2 k / m + 2 H tau k / m = 1, with the m / k of the spring; a margin is left."""
    plain, _ = spring(tmp_path)
    ratio = (0.05 + plain.carried_mass("b")) / stiffness()
    tau = 0.02
    damped = exunet.NetSystem(tmp_path / "spring.toml", [f"effects.material_damping.relaxation_time={tau}"])
    step = longest_step(damped, STABLE) / MARGIN
    assert step**2 + 2.0 * step * tau == pytest.approx(ratio, rel=1e-12)
    step = longest_step(damped, CONTRACTING) / MARGIN
    assert step**2 + 3.0 * step * tau == pytest.approx(6.0 * ratio, rel=1e-12)


# Hosts of Exudyn; each compiles a kernel.
coupled = pytest.mark.slow


class Mass:
    """The spring's mass in Exudyn, coupled to its net; a body that does not turn."""

    def __init__(self, folder: Path, longest: float | None = None) -> None:
        self.net, _ = spring(folder)
        self.mass = 0.05 + self.net.carried_mass("b")
        self.mbs = exu.SystemContainer().AddSystem()
        moves = {"initialCoordinates": [1.01, 0, 0, 0, 0, 0], "initialVelocities": [0.01, 0, 0, 0, 0, 0]}
        node = self.mbs.AddNode(NodeRigidBodyRotVecLG(referenceCoordinates=[0.0] * 6, **moves))
        self.body = self.mbs.AddObject(
            ObjectRigidBody(mass=self.mass, inertia=[1, 1, 1, 0, 0, 0], nodeNumber=node)
        )
        marker = self.mbs.AddMarker(MarkerBodyRigid(bodyNumber=self.body))
        self.coupling = exunet.couple(self.mbs, self.net, {"b": marker}, longest=longest)
        self.begin = self.energy

    @property
    def energy(self) -> float:
        """Of both [J]; before the solver, with the velocity of the start."""
        what, now = exu.OutputVariableType.Velocity, exu.ConfigurationType
        when = now.Initial if self.net.time == 0.0 else now.Current
        speed = self.mbs.GetObjectOutputBody(self.body, what, configuration=when)
        return energy_of(self.net) + 0.5 * self.mass * float(speed @ speed)

    def solve(self, method: str, step: float, steps: int) -> None:
        settings = exu.SimulationSettings()
        settings.solution.file.write = False
        settings.timeIntegration.numberOfSteps = steps
        settings.timeIntegration.endTime = steps * step
        settings.timeIntegration.explicit.useLieGroupIntegration = True
        if method.startswith("GeneralizedAlpha"):
            settings.timeIntegration.generalizedAlpha.spectralRadius = float(method[16:])
            method = "GeneralizedAlpha"
        self.mbs.SolveDynamic(settings, solverType=getattr(exu.DynamicSolverType, method))

    def gained(self) -> float:
        """Energy [J] since the start, in parts of the oscillation's at the start: m (1 cm/s)^2 / 2."""
        return (self.energy - self.begin) / (0.5 * self.mass * 1e-4)


HOSTS = ["RK44", "VelocityVerlet", "TrapezoidalIndex2", "GeneralizedAlpha0.9"]


class TestHostsOfExudyn:
    pytestmark = coupled

    @pytest.mark.parametrize("method", HOSTS)
    def test_amplitudes_are_as_predicted(self, tmp_path: Path, method: str) -> None:
        """At a third of where RK44 begins to gain: by the map, within a tenth; and the residual tells it."""
        host = Mass(tmp_path)
        part, steps = 1.0 / 3.0, 100
        host.solve(method, part * longest_step(host.net, STABLE) / MARGIN, steps)
        predicted = (1.0 + growth(method, part**2)) ** (2 * steps) - 1.0
        assert -0.9 < predicted < -0.1  # a loss that can be seen
        assert host.gained() == pytest.approx(predicted, abs=0.1)
        residual = host.coupling.report().residual / (0.5 * host.mass * 1e-4)
        assert residual == pytest.approx(host.gained(), rel=0.2)

    @pytest.mark.parametrize("method", HOSTS)
    def test_beyond_the_bound_the_step_is_refused_and_if_it_is_not_energy_grows(
        self, tmp_path: Path, method: str
    ) -> None:
        host = Mass(tmp_path)
        bound = longest_step(host.net, STABLE if method == "RK44" else WEIGHING)
        with pytest.raises(exu.ModelError, match="is beyond the largest stable one of its method"):
            host.solve(method, 1.01 * bound, 4)
        host = Mass(tmp_path, longest=1.0)
        host.solve(method, 1.2 * bound / MARGIN, 16)
        assert growth(method, (1.2 * bound / longest_step(host.net, STABLE)) ** 2) > 0.0
        assert host.gained() > 0.0

    def test_the_explicit_euler_method_is_refused(self, tmp_path: Path) -> None:
        with pytest.raises(exu.ModelError, match="ExplicitEuler moves the bodies by the velocities before"):
            Mass(tmp_path).solve("ExplicitEuler", 1e-3, 4)


def test_what_is_handed_over_adds_up_and_a_jump_is_made_good_in_a_step() -> None:
    """With the trapezoidal rule, by hand: forces 1, 1, 1, 1, and then 0."""
    over = Handover(np.zeros(1))
    settings = SimpleNamespace(name="TrapezoidalIndex2")
    alpha = SimpleNamespace(newmarkGamma=0.5, useNewmark=True)
    over.begin(weights_of(SimpleNamespace(solverType=settings, generalizedAlpha=alpha)))
    seen = []
    for force in (1.0, 1.0, 1.0, 1.0, 0.0, 0.0, 0.0, 0.0):
        mean = np.array([force])
        handed = over.handed(mean, 0.1, jumps=False)
        over.take(mean, handed, 0.1, jumps=False)
        seen.append(float(handed[0]))
    # G = 7/4 F - F' + F''/4 of the last three forces, but for the first step, which has none before it:
    # E = F there, and the rule has taken 1/2 of that
    np.testing.assert_allclose(seen, [1.5, 1.0, 1.0, 1.0, -0.75, 0.25, 0.0, 0.0], atol=1e-15)
    assert sum(seen) == pytest.approx(4.0)
    assert over.in_transit[0] == pytest.approx(0.0, abs=1e-15)


def with_light_nodes(folder: Path, damping: str = "") -> exunet.NetSystem:
    """`spring` with a node of a fiftieth of the body's mass in the middle of each cable."""
    spring(folder)
    file = folder / "spring.toml"
    text = file.read_text()
    for old, new in (
        ("net.nodes = [[0.0, 0.0, 0.0], [1.0,", "net.nodes = [[0.0, 0.0, 0.0], [0.5, 0.0, 0.0], [1.0,"),
        (", [2.0, 0.0, 0.0]]\nnet.fixed = [0, 2]", ", [1.5, 0.0, 0.0], [2.0, 0.0, 0.0]]\nnet.fixed = [0, 4]"),
        ("[[0, 1], [1, 2]]", "[[0, 1], [1, 2], [2, 3], [3, 4]]"),
        ("[0.0, 1e-3, 0.0]", "[0.0, 1e-3, 1e-6, 1e-3, 0.0]"),
        ("positions = [[0.0, 0.0, 0.0], ", "positions = [[0.0, 0.0, 0.0], [0.505, 0.0, 0.0], "),
        (", [2.02, 0.0, 0.0]]", f", [1.515, 0.0, 0.0], [2.02, 0.0, 0.0]]\n{damping}"),
        ("node = 1", "node = 2"),
    ):
        assert old in text, old
        text = text.replace(old, new)
    file.write_text(text)
    return exunet.NetSystem(file)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("damping", "iterations", "part", "gains"),
    [
        ("", 1, 0.5, True),
        ("", 1, 0.3, False),
        ("", 20, 0.5, False),
        ("effects.material_damping.relaxation_time = 1e-3\n", 1, 0.5, False),
    ],
)
def test_light_nodes_that_nothing_damps_resonate_and_that_is_told(
    tmp_path: Path, damping: str, iterations: int, part: float, gains: bool
) -> None:
    """At half of the predicted step, 0.85 of the half period of these nodes; see docs/coupling.md."""
    net = with_light_nodes(tmp_path, damping)
    host = exunet.BodiesHost.of_ports(net)
    step = part * longest_step(net, STABLE)
    both, before = exunet.Cosimulation(net, host, step=step, iterations=iterations), energy_of(net, host)
    both.advance_to(100 * step)
    assert (energy_of(net, host) > before) == gains
    assert bool(both.books.doubts) == gains
