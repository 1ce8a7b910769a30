"""How long macro steps may be: the linear map from step to step, and couplings to Exudyn's methods.

A mass on a spring and a damper, a net between the port and something heavy; `macro_maps` has the map.
"""

from __future__ import annotations

import itertools
from pathlib import Path
from types import SimpleNamespace

import exudyn as exu
import numpy as np
import pytest
from coupled import energy_of, spring, stiffness
from exudyn.itemInterface import MarkerBodyRigid, NodeRigidBodyRotVecLG, ObjectRigidBody
from macro_maps import growth

import exunet
from exunet.coupling.exudyn_state import Attempt, Handover, Weights, begun, ended, weights_of
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

    @pytest.mark.slow
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

    @pytest.mark.slow
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

    @pytest.mark.slow
    def test_the_explicit_euler_method_is_refused(self, tmp_path: Path) -> None:
        with pytest.raises(exu.ModelError, match="ExplicitEuler moves the bodies by the velocities before"):
            Mass(tmp_path).solve("ExplicitEuler", 1e-3, 4)


def test_weights_of_the_generalised_alpha_method() -> None:
    """Of spectral radius 0.6: m = 0.2 / 1.6, f = 0.6 / 1.6, g = 1/2 + f - m (Chung and Hulbert)."""
    alpha = SimpleNamespace(spectralRadius=0.6, useNewmark=False, newmarkGamma=0.5)
    method = SimpleNamespace(solverType=SimpleNamespace(name="GeneralizedAlpha"), generalizedAlpha=alpha)
    found = weights_of(method)
    assert found is not None
    assert (found.mass, found.force, found.gamma) == pytest.approx((0.125, 0.375, 0.75), rel=1e-15)


def test_what_is_owed_to_a_method_that_applies_forces_whole() -> None:
    """A solver that begins with 0.3 N s in transit hands that over in its first step, of 0.2 s."""
    over, mean = Handover(np.array([0.3])), np.array([2.0])
    over.begin(None)
    handed = over.handed(mean, 0.2, jumps=False)
    assert handed == pytest.approx([2.0 + 1.5])
    assert over.take(mean, np.array([2.6]), 0.2, jumps=False) == pytest.approx([2.6])  # not all of it
    assert over.in_transit == pytest.approx([0.3 - 0.2 * 0.6])
    assert over.handed(mean, 0.2, jumps=False) == pytest.approx([2.0 + 0.18 / 0.2])


WEIGHTS = Weights(0.125, 0.375, 0.75)


def following(rate: float, forces: list[float], step: float) -> tuple[list[float], list[float]]:
    """Accelerations and impulses of the method, by its two lines, for forces that are handed over in turn."""
    rates, impulses = [rate], []
    for last, force in itertools.pairwise(forces):
        rates.append((0.625 * force + 0.375 * last - 0.125 * rates[-1]) / 0.875)
        impulses.append(step * (0.25 * rates[-2] + 0.75 * rates[-1]))
    return rates, impulses


def test_what_failures_fade_and_lose() -> None:
    """Each turns the acceleration once; what later steps do not show of the one before is handed over."""
    rate, given = np.array([0.9]), np.array([0.4])
    faded = rate
    for number in range(4):
        np.testing.assert_allclose(WEIGHTS.faded(rate, given, number), faded, rtol=1e-14)
        faded = (0.375 * given - 0.125 * faded) / 0.875
    over, mean = Handover(np.zeros(1)), np.array([1.3])
    over.begin(WEIGHTS)
    over.take(mean, over.handed(mean, 0.1, jumps=False), 0.1, jumps=False)
    before, rate, given = over.numbers(), over.numbers()["rate"], over.acting
    plain = over.handed(mean, 0.1, jumps=False)
    over.failures = 2
    sums = [
        sum(following(float(item[0]), [0.0] * 200, 0.1)[1]) for item in (rate, WEIGHTS.faded(rate, given, 2))
    ]
    lost = sums[0] - sums[1]
    assert over.handed(mean, 0.1, jumps=False) - plain == pytest.approx([lost / 0.1], rel=1e-12)
    over.take(mean, plain, 0.1, jumps=False)
    owed = before["owed"] + lost + 0.1 * (mean - 0.5 * (given + plain))
    np.testing.assert_allclose(over.numbers()["owed"], owed, rtol=1e-12)
    assert over.failures == 0


def test_what_is_in_transit_is_less_by_what_a_method_shows_when_it_is_let_go() -> None:
    """Through all later steps, for which nothing is handed over."""
    over = Handover(np.zeros(1))
    over.begin(WEIGHTS)
    for force in (1.0, 0.3, 0.8):
        mean = np.array([force])
        over.take(mean, over.handed(mean, 0.1, jumps=False), 0.1, jumps=False)
    before, numbers = over.in_transit, over.numbers()
    later = following(float(numbers["rate"][0]), [float(over.acting[0])] + [0.0] * 200, 0.1)[1]
    over.let_go()
    np.testing.assert_allclose(over.in_transit, before - sum(later), rtol=1e-12)
    assert over.acting == 0.0


def test_velocity_verlet_takes_means_and_a_runge_kutta_method_does_not() -> None:
    """See `Handover.weights`."""
    alpha = SimpleNamespace(useNewmark=False)
    for name, known in (("VelocityVerlet", Weights(0.0, 0.0, 0.5)), ("ExplicitRK44", None)):
        method = SimpleNamespace(solverType=SimpleNamespace(name=name), generalizedAlpha=alpha)
        assert weights_of(method) == known
    assert [item.keeps for item in (Weights(), Weights(mass=0.1), Weights(force=0.1))] == [False, True, True]


def test_where_an_attempt_begins_after_failures() -> None:
    """As often turned as there were failures; more than there were is unknown."""
    kept, given, begin = np.random.default_rng(21).normal(size=(3, 5))
    data = SimpleNamespace(
        GetODE2Coordinates_tt=lambda start: given, GetODE2Coordinates_t=lambda start: begin
    )
    for turned in range(4):
        now = WEIGHTS.faded(kept, given, turned) * (1.0 + 1e-12)
        solver = SimpleNamespace(
            GetStartOfStepStateAAlgorithmic=lambda: kept, GetAAlgorithmic=lambda found=now: found
        )
        mbs = SimpleNamespace(systemData=data)
        if turned < 3:
            number, *parts = begun(mbs, solver, WEIGHTS, 2)
            assert number == turned
            for found, known in zip(parts, (kept, now, begin), strict=True):
                np.testing.assert_array_equal(found, known)
        else:
            with pytest.raises(exunet.InputError):
                begun(mbs, solver, WEIGHTS, 2)


def test_with_which_acceleration_a_step_was_taken() -> None:
    """v1 = v0 + h ((1 - g) a + g b): a of the attempt, or the one that was kept before failures."""
    weights, step = WEIGHTS, 0.1
    kept, now, last, begin = np.random.default_rng(20).normal(size=(4, 5))
    attempt = Attempt(3, kept, now, begin)
    solver = SimpleNamespace(GetAAlgorithmic=lambda: last)
    for first, failures in ((now, 3), (kept, 0)):
        velocity = begin + step * (0.25 * first + 0.75 * last)
        data = SimpleNamespace(GetODE2Coordinates_t=lambda found=velocity: found)
        assert ended(SimpleNamespace(systemData=data), solver, weights, attempt, step) == failures
    data = SimpleNamespace(GetODE2Coordinates_t=lambda: begin)
    with pytest.raises(exunet.InputError):
        ended(SimpleNamespace(systemData=data), solver, weights, attempt, step)


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
