"""Forces for methods that weigh those of several steps, and implicit hosts that reject steps."""

from __future__ import annotations

import itertools
from types import SimpleNamespace
from typing import Any

import exudyn as exu
import numpy as np
import pytest
from coupled import MOMENTUM, POSITION, ExudynBody, Scene, settings

import exunet
from exunet import InputError, NetSystem
from exunet.coupling.exudyn_coupling import Attempt, Handover, Weights, weights_of

WEIGHTS = Weights(0.125, 0.375, 0.75)  # of generalised-alpha with the spectral radius 0.6
END, LONG = 0.24, 0.005  # [s]; longer steps fail


def method(name: str, **alpha: Any) -> SimpleNamespace:
    usual = {"spectralRadius": 0.6, "useNewmark": False, "newmarkGamma": 0.5}
    kind, of = SimpleNamespace(name=name), SimpleNamespace(**(usual | alpha))
    return SimpleNamespace(solverType=kind, generalizedAlpha=of)


def test_weights_of_methods() -> None:
    """Of spectral radius 0.6: m = 0.2 / 1.6, f = 0.6 / 1.6, g = 1/2 + f - m (Chung and Hulbert)."""
    found = weights_of(method("GeneralizedAlpha"))
    assert found is not None
    assert (found.mass, found.force, found.gamma) == pytest.approx((0.125, 0.375, 0.75), rel=1e-15)
    assert found.keeps_acceleration
    for name in ("VelocityVerlet", "TrapezoidalIndex2"):
        assert weights_of(method(name)) == Weights(0.0, 0.0, 0.5)
    assert weights_of(method("GeneralizedAlpha", useNewmark=True)) == Weights()
    assert not Weights().keeps_acceleration
    assert weights_of(method("ExplicitRK44")) is None
    with pytest.raises(InputError, match="ExplicitEuler"):
        weights_of(method("ExplicitEuler"))


def counted(over: Handover, force: float, step: float = 0.1) -> float:
    """Give and count a step with a mean force; return the given force."""
    mean = np.array([force])
    given = over.force_for(mean, step, recoils=False)
    over.count(mean, given, step, recoils=False)
    return float(given[0])


def test_the_given_forces_add_up_and_a_jump_is_corrected_in_a_step() -> None:
    """With the trapezoidal rule, by hand: forces 1, 1, 1, 1, and then 0.

    G = 7/4 F - F' + F''/4 of the last three forces, except for the first step, which has none before it: E =
    F there, and the rule has taken 1/2 of that.
    """
    over = Handover(np.zeros(1))
    over.begin(Weights())
    given = [counted(over, force) for force in (1.0, 1.0, 1.0, 1.0, 0.0, 0.0, 0.0, 0.0)]
    np.testing.assert_allclose(given, [1.5, 1.0, 1.0, 1.0, -0.75, 0.25, 0.0, 0.0], atol=1e-15)
    assert sum(given) == pytest.approx(4.0)
    assert over.in_transit[0] == pytest.approx(0.0, abs=1e-15)


def test_what_is_in_transit() -> None:
    """Of spectral radius 1, by hand, m = f = g = 1/2, forces 1, 0: a = 1, 0; applied 1/2, 1/2.

    Of the trapezoidal rule half of the last impulse is in transit, of RK44 nothing. A method that applies
    forces whole and begins with 0.3 N s in transit gets that in its first step, of 0.2 s.
    """
    alpha = Handover(np.zeros(1), Weights(0.5, 0.5, 0.5))
    for force, known in ((1.0, 0.5), (0.0, 0.0)):
        mean = np.array([force])
        assert alpha.count(mean, mean, 1.0, recoils=False) == pytest.approx([0.5], abs=1e-15)
        assert alpha.in_transit[0] == pytest.approx(known, abs=1e-15)
    rule = Handover(np.zeros(1), Weights())
    for force in (3.0, 1.0):
        mean = np.array([force])
        rule.count(mean, mean, 0.1, recoils=False)
        assert rule.in_transit[0] == pytest.approx(0.05 * force)
    whole, mean = Handover(np.zeros(2)), np.array([1.0, 2.0])
    assert (whole.force_for(mean, 0.1, recoils=False) == mean).all()
    assert (whole.count(mean, mean, 0.1, recoils=False) == mean).all()
    assert not whole.in_transit.any()
    over, mean = Handover(np.array([0.3])), np.array([2.0])
    over.begin(None)
    assert over.force_for(mean, 0.2, recoils=False) == pytest.approx([2.0 + 1.5])
    assert over.count(mean, np.array([2.6]), 0.2, recoils=False) == pytest.approx([2.6])  # not all of it
    assert over.in_transit == pytest.approx([0.3 - 0.2 * 0.6])
    assert over.force_for(mean, 0.2, recoils=False) == pytest.approx([2.0 + 0.18 / 0.2])


def following(rate: float, forces: list[float], step: float) -> float:
    """Sum of the impulses of the method, by its two lines, for forces that are given in turn."""
    total = 0.0
    for last, force in itertools.pairwise(forces):
        after = (0.625 * force + 0.375 * last - 0.125 * rate) / 0.875
        total += step * (0.25 * rate + 0.75 * after)
        rate = after
    return total


def test_failures_and_the_end_of_forces() -> None:
    """Each failure turns the acceleration once; what later steps do not show of the one before is given
    again.

    What later steps show of the given forces leaves the transit when forces end.
    """
    rate, given = np.array([0.9]), np.array([0.4])
    faded = rate
    for number in range(4):
        np.testing.assert_allclose(WEIGHTS.faded(rate, given, number), faded, rtol=1e-14)
        faded = (0.375 * given - 0.125 * faded) / 0.875
    over, mean, none = Handover(np.zeros(1)), np.array([1.3]), [0.0] * 200
    over.begin(WEIGHTS)
    counted(over, 1.3)
    owed, rate, given = over.owed, over.rate, over.given
    plain = over.force_for(mean, 0.1, recoils=False)
    over.failures = 2
    lost = following(float(rate[0]), none, 0.1)
    lost -= following(float(WEIGHTS.faded(rate, given, 2)[0]), none, 0.1)
    assert over.force_for(mean, 0.1, recoils=False) - plain == pytest.approx([lost / 0.1], rel=1e-12)
    over.count(mean, plain, 0.1, recoils=False)
    np.testing.assert_allclose(over.owed, owed + lost + 0.1 * (mean - 0.5 * (given + plain)), rtol=1e-12)
    assert over.failures == 0
    over = Handover(np.zeros(1))
    over.begin(WEIGHTS)
    for force in (1.0, 0.3, 0.8):
        counted(over, force)
    before, later = over.in_transit, following(float(over.rate[0]), [float(over.given[0]), *none], 0.1)
    over.stop()
    np.testing.assert_allclose(over.in_transit, before - later, rtol=1e-12)
    assert over.given == 0.0


def test_the_acceleration_of_an_attempt() -> None:
    """As often turned as there were failures; v1 = v0 + h ((1 - g) a + g b) of the attempt, or of the kept "
    "a."""
    kept, given, begin, last = np.random.default_rng(21).normal(size=(4, 5))
    step, state = 0.1, {"v": begin}
    data = SimpleNamespace(
        GetODE2Coordinates_tt=lambda start: given, GetODE2Coordinates_t=lambda *start: state["v"]
    )
    mbs, now = SimpleNamespace(systemData=data), {"a": kept}
    solver = SimpleNamespace(GetStartOfStepStateAAlgorithmic=lambda: kept, GetAAlgorithmic=lambda: now["a"])
    for turned in range(4):
        state["v"], now["a"] = begin, WEIGHTS.faded(kept, given, turned) * (1.0 + 1e-12)
        if turned == 3:  # more than were rejected
            with pytest.raises(InputError, match="useNewmark"):
                Attempt.begin(mbs, solver, WEIGHTS, 2)
            continue
        attempt = Attempt.begin(mbs, solver, WEIGHTS, 2)
        assert attempt.failures == turned
        for first, failures in ((attempt.now, turned), (kept, 0)):
            now["a"], state["v"] = last, begin + step * (0.25 * first + 0.75 * last)
            assert attempt.end(mbs, solver, WEIGHTS, step) == failures
        state["v"] = begin + step * (0.25 * 1.1 * kept + 0.75 * last)
        with pytest.raises(InputError, match="useNewmark"):
            attempt.end(mbs, solver, WEIGHTS, step)


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    return Scene(tmp_path_factory.mktemp("rejecting"))


def rejecting(scene: Scene, window: tuple[float, float], how: str = "nan") -> ExudynBody:
    """A body whose Newton method fails, or whose post-Newton function requests less, in long steps.

    window : times [s] in which that is so
    """
    host = ExudynBody.second(scene)

    def fails(t: float) -> bool:
        solver = host.mbs.sys.get("dynamicSolver")
        return window[0] < t < window[1] and solver is not None and solver.it.currentStepSize > LONG

    if how == "asked":
        host.mbs.SetPostNewtonUserFunction(lambda mbs, t: [10.0, 0.003] if fails(t) else [0.0, -1.0])
        return host
    return host.on_spring(0.0, lambda mbs, t, *_: float("nan") if fails(t) else 0.0)


def run(host: ExudynBody, method: str, steps: int, *, grows: bool, **options: Any) -> None:
    increase = 2.0 if grows else 1.0
    host.solve(method, steps, END, minimumStepSize=1e-6, adaptiveStepIncrease=increase, **options)


@pytest.mark.ci_for("GeneralizedAlpha-nan-options1")
@pytest.mark.slow
@pytest.mark.parametrize(
    ("method", "how", "options"),
    [
        ("GeneralizedAlpha", "nan", {}),
        ("GeneralizedAlpha", "nan", {"useModifiedNewton": True}),
        ("GeneralizedAlpha", "asked", {}),
        ("GeneralizedAlpha", "nan", {"spectralRadius": 0.5}),
        ("GeneralizedAlpha", "nan", {"spectralRadius": 0.0}),
        ("GeneralizedAlpha", "nan", {"spectralRadius": 1.0}),
        ("GeneralizedAlpha", "nan", {"useNewmark": True}),
        ("TrapezoidalIndex2", "nan", {}),
    ],
)
def test_momentum_is_kept_over_rejected_steps(
    scene: Scene, method: str, how: str, options: dict[str, Any]
) -> None:
    """At any step, with what is in transit: 1.9e-3 N s were lost where a is taken to be restored."""
    host, net = rejecting(scene, (0.1, 0.14), how), NetSystem(scene.net)
    off: list[float] = []

    def note(mbs: Any, t: float) -> bool:
        if t > net.time:
            off.append(scene.lost(net, host, coupling))
        return True

    host.mbs.SetPreStepUserFunction(note)
    coupling = exunet.couple(host.mbs, net, {"second": host.marker})
    run(host, method, 20, grows=True, **options)
    report = coupling.report()
    assert report.repeated > 1
    assert report.shortest < LONG < report.longest
    note(host.mbs, np.inf)
    assert max(off) < 1e-12 * MOMENTUM


@pytest.mark.slow
@pytest.mark.parametrize(
    ("method", "options"),
    [("GeneralizedAlpha", {}), ("GeneralizedAlpha", {"useNewmark": True}), ("TrapezoidalIndex2", {})],
)
def test_rejected_at_the_start_it_is_the_shorter_step(
    scene: Scene, method: str, options: dict[str, Any]
) -> None:
    """12 ms are rejected, and 6 ms; then 3 ms are kept, as by a host that takes them from the start."""
    ends = []
    for window, steps in (((0.0, END), 20), ((1.0, 1.0), 80)):
        host, net = rejecting(scene, window), NetSystem(scene.net)
        coupling = exunet.couple(host.mbs, net, {"second": host.marker})
        run(host, method, steps, grows=steps == 80, **options)
        ends.append(host.at_centre(POSITION))
        report = coupling.report()
        assert (report.steps, report.repeated) == (80, 2 if steps == 20 else 0)
    np.testing.assert_allclose(*ends, atol=1e-12)  # m


@pytest.mark.slow
def test_an_unknown_acceleration_leaves_the_net_where_the_ledger_ends(scene: Scene) -> None:
    """A post-Newton iteration that does not end leaves an acceleration that is not known."""
    host, net, coupling = scene.coupled()
    host.mbs.SetPostNewtonUserFunction(lambda mbs, t: [float(t > 0.011), 0.0])
    made = settings(0.0, END, 400)
    iteration = made.timeIntegration.discontinuous
    iteration.iterationTolerance, iteration.maxIterations, iteration.ignoreMaxIterations = 0.5, 1, False
    with pytest.raises(exu.ModelError, match="useNewmark"):
        host.mbs.SolveDynamic(made, solverType=exu.DynamicSolverType.GeneralizedAlpha)
    ledger = coupling.report()
    assert (ledger.steps * END / 400, ledger.repeated) == (pytest.approx(net.time), 1)
    assert ledger.note == ""  # it was taken for a stop of the net by a guard
