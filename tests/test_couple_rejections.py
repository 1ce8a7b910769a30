"""Implicit hosts of Exudyn that reject steps: momentum at any step, and the motion of the shorter steps."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import exudyn as exu
import numpy as np
import pytest
from coupled import Scene, momenta
from exudyn.itemInterface import MarkerBodyPosition, ObjectConnectorSpringDamper, ObjectGround
from test_couple_exudyn import END, VELOCITY, Host

import exunet
from exunet import InputError, NetSystem
from exunet.coupling.exudyn_state import Weights, begun, ended

pytestmark = pytest.mark.slow

LONG = 0.005  # [s]: longer steps fail


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    return Scene(tmp_path_factory.mktemp("rejecting"))


class Rejecting(Host):
    """Its Newton method fails, or its post-Newton function asks for less, in steps that are long.

    window : times [s] in which that is so
    """

    def __init__(self, scene: Scene, window: tuple[float, float], how: str = "nan") -> None:
        super().__init__(scene)
        self.window = window
        if how == "asked":
            self.mbs.SetPostNewtonUserFunction(lambda mbs, t: [10.0, 0.003] if self.fails(t) else [0.0, -1.0])
            return
        ground = self.mbs.AddObject(ObjectGround())
        ends = [self.mbs.AddMarker(MarkerBodyPosition(bodyNumber=n)) for n in (ground, self.object)]

        def force(mbs: Any, t: float, *_: Any) -> float:
            return float("nan") if self.fails(t) else 0.0

        connector = ObjectConnectorSpringDamper(
            markerNumbers=ends, referenceLength=2.0, stiffness=0.0, springForceUserFunction=force
        )
        self.mbs.AddObject(connector)

    def fails(self, t: float) -> bool:
        solver = self.mbs.sys.get("dynamicSolver")
        return (
            self.window[0] < t < self.window[1]
            and solver is not None
            and float(solver.it.currentStepSize) > LONG
        )

    def run(self, method: str, steps: int, *, modified: bool = False, **alpha: Any) -> None:
        settings = exu.SimulationSettings()
        settings.solution.file.write = False
        integration = settings.timeIntegration
        integration.numberOfSteps, integration.endTime, integration.minimumStepSize = steps, END, 1e-6
        integration.newton.useModifiedNewton = modified
        integration.adaptiveStepIncrease = 2.0 if self.window[0] else 1.0
        for name, value in alpha.items():
            setattr(integration.generalizedAlpha, name, value)
        self.mbs.SolveDynamic(settings, solverType=getattr(exu.DynamicSolverType, method))


@pytest.mark.ci_for("options1")
@pytest.mark.slow
@pytest.mark.parametrize(
    ("method", "how", "options"),
    [
        ("GeneralizedAlpha", "nan", {}),
        ("GeneralizedAlpha", "nan", {"modified": True}),
        ("GeneralizedAlpha", "asked", {}),
        ("GeneralizedAlpha", "nan", {"spectralRadius": 0.5}),
        ("GeneralizedAlpha", "nan", {"spectralRadius": 0.0}),
        ("GeneralizedAlpha", "nan", {"spectralRadius": 1.0}),
        ("GeneralizedAlpha", "nan", {"useNewmark": True}),
        ("TrapezoidalIndex2", "nan", {}),
    ],
)
def test_momentum_is_kept_over_steps_that_the_host_rejects(
    scene: Scene, method: str, how: str, options: dict[str, Any]
) -> None:
    """At any step, with what is in transit: 1.9e-3 N s were lost where a is taken to be put back."""
    before = momenta(exunet.Simulation(scene.whole))[0]
    host, net = Rejecting(scene, (0.1, 0.14), how), NetSystem(scene.net)
    off: list[float] = []

    def tell(mbs: Any, t: float) -> bool:
        if t > net.time:
            momentum = momenta(net.simulation)[0] + host.body.mass * host.of_centre(VELOCITY)
            off.append(float(np.abs(momentum + coupling.in_transit["second"] - before).max()))
        return True

    host.mbs.SetPreStepUserFunction(tell)
    coupling = exunet.couple(host.mbs, net, {"second": host.marker})
    host.run(method, 20, **options)
    report = coupling.report()
    assert report.repeated > 1
    assert report.shortest < LONG < report.longest
    tell(host.mbs, np.inf)
    assert max(off) < 1e-12 * 1.8  # of the momentum of the second body [N s]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("method", "options"),
    [
        ("GeneralizedAlpha", {}),
        ("GeneralizedAlpha", {"useNewmark": True}),
        ("TrapezoidalIndex2", {}),
    ],
)
def test_rejected_at_the_start_it_is_the_shorter_step(
    scene: Scene, method: str, options: dict[str, Any]
) -> None:
    """12 ms are rejected, and 6 ms; then 3 ms are kept, as by a host that takes them from the start."""
    ends = []
    for window, steps in (((0.0, END), 20), ((1.0, 1.0), 80)):
        host, net = Rejecting(scene, window), NetSystem(scene.net)
        coupling = exunet.couple(host.mbs, net, {"second": host.marker})
        host.run(method, steps, **options)
        ends.append(host.of_centre(exu.OutputVariableType.Position))
        report = coupling.report()
        assert (report.steps, report.repeated) == (80, 2 if steps == 20 else 0)
    np.testing.assert_allclose(*ends, atol=1e-12)  # m


@pytest.mark.slow
def test_the_motion_is_nearer_than_by_long_steps_alone(scene: Scene) -> None:
    """What a failure has made generalised-alpha forget is handed over again: it was 1.76e-4 m, not 1.1e-4."""
    known, errors = scene.in_one(END).state.bodies.position[1], []
    for window in ((0.1, 0.14), (1.0, 1.0)):
        host, net = Rejecting(scene, window), NetSystem(scene.net)
        exunet.couple(host.mbs, net, {"second": host.marker})
        host.run("GeneralizedAlpha", 20)
        errors.append(np.linalg.norm(host.of_centre(exu.OutputVariableType.Position) - known))
    assert errors[0] < errors[1]


@pytest.mark.slow
def test_an_acceleration_that_is_not_known_is_refused() -> None:
    weights = Weights(mass=0.4, force=0.45, gamma=0.55)
    given, kept, speed = np.array([1.0, 2.0]), np.array([3.0, 5.0]), np.array([7.0, -9.0])
    state: dict[str, np.ndarray] = {"speed": speed}
    mbs = SimpleNamespace(
        systemData=SimpleNamespace(
            GetODE2Coordinates_tt=lambda _: given, GetODE2Coordinates_t=lambda *_: state["speed"]
        )
    )

    def solver(now: np.ndarray) -> SimpleNamespace:
        return SimpleNamespace(GetStartOfStepStateAAlgorithmic=lambda: kept, GetAAlgorithmic=lambda: now)

    once = (0.45 * given - 0.4 * kept) / 0.6
    twice = (0.45 * given - 0.4 * once) / 0.6
    for failures, now in enumerate((kept, once, twice)):
        state["speed"] = speed
        attempt = begun(mbs, solver(now), weights, 3)
        assert attempt.failures == failures
        last = np.array([4.0, -1.0])
        for used, number in ((now, failures), (kept, 0)):
            state["speed"] = speed + 0.01 * (0.45 * used + 0.55 * last)
            assert ended(mbs, solver(last), weights, attempt, 0.01) == number
        state["speed"] = speed + 0.01 * (0.45 * 1.1 * kept + 0.55 * last)
        with pytest.raises(InputError, match=r"useNewmark, or use TrapezoidalIndex2"):
            ended(mbs, solver(last), weights, attempt, 0.01)
    for now, most in ((twice, 1), (1.001 * kept, 3)):
        with pytest.raises(InputError, match=r"useNewmark, or use TrapezoidalIndex2"):
            begun(mbs, solver(now), weights, most)


@pytest.mark.slow
def test_a_refusal_after_a_rejection_leaves_the_net_where_the_books_end(scene: Scene) -> None:
    """A post-Newton iteration that does not end leaves an acceleration that is not known."""
    host, net = Host(scene), NetSystem(scene.net)
    coupling = exunet.couple(host.mbs, net, {"second": host.marker})
    host.mbs.SetPostNewtonUserFunction(lambda mbs, t: [float(t > 0.011), 0.0])
    settings = exu.SimulationSettings()
    settings.solution.file.write = False
    integration = settings.timeIntegration
    integration.numberOfSteps, integration.endTime, integration.newton.useModifiedNewton = 400, END, False
    iteration = integration.discontinuous
    iteration.iterationTolerance, iteration.maxIterations, iteration.ignoreMaxIterations = 0.5, 1, False
    with pytest.raises(exu.ModelError, match="what its generalised-alpha method goes on with is not known"):
        host.mbs.SolveDynamic(settings, solverType=exu.DynamicSolverType.GeneralizedAlpha)
    books = coupling.report()
    assert (books.steps * END / 400, books.repeated) == (pytest.approx(net.time), 1)
    assert books.cut == ""  # it was taken for a stop of the net by a guard
