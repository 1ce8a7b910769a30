"""How long macro steps may be: the linear map from step to step, and couplings to Exudyn's methods.

A mass on a spring and a damper, a net between the port and something heavy; `macro_maps` has the map.
"""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import exudyn as exu
import numpy as np
import pytest
from coupled import energy_of, spring, stiffness
from exudyn.itemInterface import MarkerBodyRigid, NodeRigidBodyRotVecLG, ObjectRigidBody
from macro_maps import growth

import exunet
from exunet.coupling.handover import Handover, weights_of
from exunet.coupling.prediction import CONTRACTING, MARGIN, STABLE, WEIGHING, longest_step

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
