"""Errors that are put into a code are found by the verification, and values that are not finite fail it."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from exunet.base.cases import shipped
from exunet.base.errors import InputError
from exunet.forces import cable
from exunet.results import measures as metrics
from exunet.studies.both_codes import BothCodes, Trajectory, both_of_text, read_both
from exunet.studies.ensemble import PAPER_SIZE
from exunet.verification import horizon, random_states, trajectories
from exunet.verification.answers import bodies, motions, mouth
from exunet.verification.answers.bodies import FreeRotation
from exunet.verification.answers.motions import frequency
from exunet.verification.answers.orders import ErrorSeries
from exunet.verification.check import Check, Finding, difference, worst_of
from exunet.verification.cross_code import compared, measures, motion
from exunet.verification.horizon import ROUND_OFF, Growth, Statistics, growth, nearby, sensitivity
from exunet.verification.suite import RUNS, Item
from exunet.verification.tolerances import FORCES
from reference_impl import body_forces as fields
from reference_impl import forces as formulas
from reference_impl.attachments import Levers

PAPER = shipped()["planar_deployment"]
BODIES = shipped("bodies")
NAN = float("nan")


def failing(findings: Iterable[Finding]) -> list[Check]:
    return [found for found in findings if isinstance(found, Check) and not found.holds]


# Values that are not finite


@pytest.mark.parametrize("errors", [(NAN, 1.0), (1.0, NAN), (0.0, NAN, 2.0)])
def test_the_worst_of_some_checks_is_that_with_nan(errors: tuple[float, ...]) -> None:
    found = worst_of("all", [Check(f"{k}", value, FORCES) for k, value in enumerate(errors)])
    assert not found.holds
    assert found.part == math.inf


@pytest.mark.parametrize("wrong", [NAN, np.inf])
@pytest.mark.parametrize("both", [False, True])
def test_a_difference_with_an_entry_that_is_not_finite_fails(wrong: float, both: bool) -> None:
    a = np.arange(12.0).reshape(4, 3)
    b = a.copy()
    a[2, 1] = wrong
    b[2, 1] = wrong if both else b[2, 1]
    with np.errstate(invalid="ignore"):
        found = difference("name", a, b, FORCES, ("node", "xyz"), "m")
    assert not found.holds
    assert found.where == "node 2, y [m]"


@pytest.mark.parametrize("state", [0, 4, 9])
def test_one_state_of_many_without_accelerations_fails(state: int, monkeypatch: pytest.MonkeyPatch) -> None:
    right, seen = formulas.response, []

    def wrong(*state_of_motion: Any) -> Any:
        seen.append(1)
        found, factor = right(*state_of_motion), NAN if len(seen) == state + 1 else 1.0
        return dataclasses.replace(found, acceleration=factor * found.acceleration)

    monkeypatch.setattr(formulas, "response", wrong)
    (check,) = failing(compared(motion(read_both(PAPER), compiled=False), 10))
    assert f"packed: state {state}, " in check.where


def test_one_mass_that_is_nan_fails() -> None:
    case = read_both(PAPER)
    mass = case.start.net.mass.copy()
    mass[3] = NAN
    net = dataclasses.replace(case.start.net, mass=mass)
    blocks = dataclasses.replace(case.start.system.blocks, net=net)
    system = dataclasses.replace(case.start.system, blocks=blocks)
    start = dataclasses.replace(case.start, system=system)
    (check,) = failing(random_states.topology(dataclasses.replace(case, start=start)))
    assert check.where.startswith("mass: node 3")


@pytest.mark.parametrize(("first", "count"), [(101, 300), (0, 401), (400, 1)])
def test_a_growth_that_is_nan_fails(first: int, count: int) -> None:
    time = np.linspace(0.0, 2.0, 401)
    apart = ROUND_OFF * np.exp(20.0 * time)
    apart[first:] = NAN
    (check,) = sensitivity(read_both(PAPER), Growth(time, apart))
    assert isinstance(check, Check)
    assert not check.holds
    assert check.error == count


def runs(count: int, spoilt: int | None = None) -> Statistics:
    """Made-up runs of one code, scattered by 10 %; one of them may have a value that is NaN."""
    values = 1.0 + 0.1 * np.random.default_rng(count).normal(size=(count, 50))
    if spoilt is not None:
        values[spoilt, 40] = NAN
    return Statistics(f"code of {count}", np.linspace(0.0, 2.0, 50), values, values, values)


@pytest.mark.parametrize(("ours", "theirs", "code"), [(3, None, 48), (None, 3, 8), (0, 7, 48)])
def test_one_run_with_nan_fails_the_statistics(
    ours: int | None, theirs: int | None, code: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = {"exunet": runs(48, ours), "reference": runs(8, theirs)}
    monkeypatch.setattr(horizon, "statistics", lambda case, which: made[which])
    found = failing(horizon.beyond(read_both(PAPER)))
    assert len(found) == 3 * ((ours is not None) + (theirs is not None))
    assert f"(code of {code})" in found[0].name


def test_means_of_another_law_fail_and_a_net_without_area_does_not() -> None:
    """An offset of 2 standard deviations of the runs; without a mouth all areas are zero."""
    ours, theirs = runs(48), runs(8)
    assert horizon.same_mean("speed", ours, theirs).holds
    shifted = dataclasses.replace(theirs, speed=theirs.speed + 0.2)
    assert not horizon.same_mean("speed", ours, shifted).holds
    assert horizon.same_mean(
        "area", *(dataclasses.replace(s, area=0.0 * s.area) for s in (ours, theirs))
    ).skipped


INSTANTS = np.linspace(0.0, 0.3, 49)


def both_motions(own: np.ndarray, apart: Any = 0.0, end: float = 0.3) -> list[Check]:
    """Rows where own (codes, what, t) are the errors of the codes and `apart` (t,) separates them [sizes]."""
    case = read_both(PAPER)
    place = np.broadcast_to(case.start.position, (len(INSTANTS), *case.start.position.shape))
    shift = case.size * np.broadcast_to(apart, INSTANTS.shape)[:, None, None] * np.array([1.0, 0.0, 0.0])
    both: Any = [
        Trajectory(INSTANTS, where, np.zeros_like(place), None, 1, None, None)  # type: ignore[arg-type]
        for where in (place, place + shift)
    ]
    return list(trajectories.compared(case, own, *both, end))


@pytest.mark.parametrize("code", [0, 1])
@pytest.mark.parametrize("first", [0, 20, 48])
def test_an_own_error_that_is_nan_fails(code: int, first: int) -> None:
    own = np.zeros((2, 2, 49))
    own[code, :, first:] = NAN
    wrong = [row for row in both_motions(own) if not row.holds and np.isnan(row.error)]
    assert [row.where for row in wrong] == [f"t = {INSTANTS[first]:.4g} s"] * 2


def test_an_own_error_at_the_start_fails() -> None:
    assert [row.holds for row in both_motions(np.ones((2, 2, 49)))] == [False, False]


def own_errors() -> np.ndarray:
    """Both codes converge until 0.125 s, instant 20; then each changes by 5e-5 sizes with its tolerance."""
    own = np.zeros((2, 2, 49))
    own[:, 0, 20:] = 5e-5
    return own


def test_codes_that_do_not_converge_where_nothing_grows_are_not_compared() -> None:
    """0.6 of the time, but the codes differ by 8e-5 sizes, less than 5e-5 and 5e-5 together."""
    assert both_motions(own_errors(), np.where(INSTANTS > 0.2, 8e-5, 0.0), np.inf)[0].skipped


@pytest.mark.parametrize(("apart", "end"), [(1.2e-4, np.inf), (NAN, np.inf), (8e-5, 0.3)])
def test_codes_further_apart_than_their_errors_or_with_a_horizon_fail(apart: float, end: float) -> None:
    (check,) = failing(both_motions(own_errors(), np.where(INSTANTS > 0.2, apart, 0.0), end))
    assert check.error == pytest.approx(1.0 - 19 / 48)


# Errors of a code


def test_a_wrong_tension_is_found_at_its_element(monkeypatch: pytest.MonkeyPatch) -> None:
    right, seen = formulas.tension, []

    def wrong(*state: Any) -> Any:
        seen.append(1)
        pull = right(*state)
        if len(seen) == 4:
            pull[17] += 1.0  # [N]
        return pull

    monkeypatch.setattr(formulas, "tension", wrong)
    case = read_both(PAPER)
    (check,) = failing(compared(measures(case), 5))
    ours = int(np.flatnonzero(case.reference_elements == 17)[0])
    assert f"state 3, element {ours} [N]" in check.where
    assert check.expected - check.value == pytest.approx(1.0)


def test_a_wrong_torque_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    right = Levers.wrench
    monkeypatch.setattr(Levers, "wrench", lambda *given: (right(*given)[0], 1.001 * right(*given)[1]))
    found = failing(compared(motion(read_both(BODIES["snap"]), compiled=False), 3))
    assert [check.name for check in found] == ["angular acceleration, Exudyn"]


def test_a_weak_torque_shows_beside_strong_torques(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of the gravity gradient, 1e-6 rad/s2: in the states where tethers are slack."""
    right = fields.torques
    monkeypatch.setattr(fields, "torques", lambda *given: 0.999 * right(*given))
    case = read_both(shipped("verification/bodies")["librations"])
    assert failing(compared(motion(case, compiled=False), 3))


def test_attached_nodes_at_other_positions_are_found(monkeypatch: pytest.MonkeyPatch) -> None:
    def places(self: Levers, centre: Any, lever: Any) -> Any:
        return centre[..., self.body, :] + 1.001 * lever

    monkeypatch.setattr(Levers, "places", places)
    found = failing(compared(motion(read_both(BODIES["snap"]), compiled=False), 2))
    assert "position of attached nodes, arrays" in [check.name for check in found]


def test_each_code_has_its_own_peak_force(monkeypatch: pytest.MonkeyPatch) -> None:
    case = read_both(shipped("verification")["snap"])
    for module, name, code in ((formulas, "tension", "reference"), (cable, "element_tension", "Exudyn")):
        with monkeypatch.context() as patch:
            right = getattr(module, name)
            patch.setattr(module, name, lambda *state, right=right: 2.0 * right(*state))
            assert [check.name for check in failing(motions.snap(case))] == [f"peak force, {code}"]


def test_a_mouth_twice_as_large_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    right = metrics.mouth_area
    monkeypatch.setattr(metrics, "mouth_area", lambda *state: 2.0 * right(*state))
    found = failing(mouth.areas(read_both(shipped("verification")["square_net"])))
    assert [check.error for check in found] == pytest.approx([1.0, 1.0])  # flat and folded: 2 - 1


@pytest.mark.slow
def test_balances_fail_with_a_torque_that_is_not_that_of_the_forces(monkeypatch: pytest.MonkeyPatch) -> None:
    """Momentum is conserved, nothing else."""
    case = read_both(BODIES["snap"], ["time.end=1.3"])
    right = Levers.wrench
    monkeypatch.setattr(Levers, "wrench", lambda *given: (right(*given)[0], 1.001 * right(*given)[1]))
    times = np.linspace(0.0, 1.3, 27)
    wrong = case.run_reference(times, rtol=1e-9, atol=1e-11)
    kept = [
        *trajectories.momenta(case, wrong, bodies.tol.MOMENTUM, bodies.tol.ANGULAR),
        trajectories.energies(case, wrong, bodies.tol.ENERGY),
    ]
    found = failing(trajectories.changes(kept, times, "reference"))
    assert {check.name.partition(",")[0] for check in found} == {"angular momentum", "energy"}


def test_a_run_that_stops_fails_its_item() -> None:
    def stops() -> Iterable[Check]:
        raise InputError("no such thing")

    (check,) = Item(RUNS, "case", stops).run()
    assert isinstance(check, Check)
    assert not check.holds
    assert (check.where, check.section) == ("no such thing", RUNS)


# Horizon


JUMPS = {0.3: 1e3, 0.5: 1e5, 0.7: 1e2, 0.9: 1e4}  # growth at snaps; nothing grows between them


def test_horizon_of_a_growth_by_jumps_is_the_jump_that_reaches_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """1e-16 m times 1e3 1e5 1e2 1e4 passes 1e-3 m at the last jump, 0.9 s."""
    case = read_both(PAPER)
    case = dataclasses.replace(case, start=case.start.moved(np.zeros_like(case.start.position)))

    def flight(self: BothCodes, times: np.ndarray, plan: Any = None) -> Any:
        factor = np.prod([np.where(times >= t, by, 1.0) for t, by in JUMPS.items()], axis=0)
        place = factor[:, None, None] * self.start.position
        return Trajectory(times, place, np.zeros_like(place), None, 1, None, None)  # type: ignore[arg-type]

    monkeypatch.setattr(BothCodes, "run_exunet", flight)
    assert growth(case, 1.0).horizon == pytest.approx(0.9, abs=0.003)
    assert growth(case, 0.8).horizon == math.inf


def test_perturbed_starts_move_the_last_bit_and_keep_velocities() -> None:
    """Near 1e3 m neighbouring numbers are 1.1e-13 m apart, so 1e-16 m would vanish."""
    case = read_both(PAPER)
    far = dataclasses.replace(case, start=case.start.moved(case.start.position + 1e3))
    assert (nearby(far, ROUND_OFF).start.position != far.start.position).all()
    near = nearby(case, 1e-8 / PAPER_SIZE, seed=3)
    assert 0 < np.abs(near.start.position - case.start.position).max() <= 1e-8
    assert np.array_equal(near.start.velocity, case.start.velocity)
    assert np.array_equal(near.start.position, nearby(case, 1e-8 / PAPER_SIZE, seed=3).start.position)


@pytest.mark.slow
@pytest.mark.parametrize("scale", [1e-3, 1e3])
def test_growth_scales_with_the_size(scale: float) -> None:
    """The paper's net at 5 mm and 5 km, with equal speeds, moduli and densities: its horizon is at 1.38 s."""
    powers = {"end": 1, "output_step": 1, "size": 1, "mesh": 1, "diameter": 1, "length": 1, "mass": 3}
    powers |= {"alpha": -1, "beta": 1}
    lines = []
    for line in PAPER.read_text().splitlines():
        key, _, rest = line.partition(" = ")
        if key in powers:
            line = f"{key} = {float(rest.split('#')[0]) * scale ** powers[key]!r}"
        lines.append(line)
    grown = growth(both_of_text("scaled", "\n".join(lines)), 1.6 * scale)
    assert grown.horizon / scale == pytest.approx(1.38, rel=0.03)


# What the checks are made with


def test_kinds_of_states_are_what_they_are_called() -> None:
    net, random = read_both(PAPER).start.net, np.random.default_rng(1)
    i, j = net.element_nodes.T

    def stretches(kind: str) -> np.ndarray:
        drawn = random_states.random_states(net, kind, 20, random)
        return np.array([np.linalg.norm(x[j] - x[i], axis=1) / net.reference_length for x, _ in drawn])

    assert stretches("packed").max() < 1
    assert stretches("taut").min() > 1
    assert stretches("overstretched").min() > 1.05
    assert (stretches("coincident") == 0).any(axis=1).all()
    crumpled = stretches("crumpled")
    assert ((crumpled < 1).any(axis=1) & (crumpled > 1).any(axis=1)).all()


def test_snap_of_two_masses_has_the_known_digits() -> None:
    """E = 70 GPa, d = 1 mm, L0 = 1 m, mu = 0.25 kg, v = 2.5 m/s: the field's exact targets."""
    known = motions.known_snap(70e9 * math.pi / 4 * 1e-6, 1.0, 0.25, 2.5)
    assert known == pytest.approx((5.331090e-3, 294.65036, 6.67665e-3), rel=1e-6)


def test_frequency_of_an_exact_cosine_and_order_of_an_exact_power() -> None:
    w, t = 12.345, 40.0
    for start in (1e-6, -3.0):
        found = frequency(start * math.cos(w * t), -start * w * math.sin(w * t), start, t, 1.0005 * w)
        assert found == pytest.approx(w, rel=1e-6)
    steps = np.array([10.0, 20.0, 40.0, 80.0])
    assert ErrorSeries("x", 3, False, steps, 2.0 * steps**-3.0).observed == pytest.approx(3.0)
    assert math.isnan(ErrorSeries("x", 3, False, steps, 0.0 * steps).observed)


INERTIA = np.array([[2.1, 0.3, -0.1], [0.3, 3.0, 0.2], [-0.1, 0.2, 4.2]])


@pytest.mark.parametrize("spin", [[0.1, 1.0, 1.5], [-0.2, -1.0, -1.4], [0.4, -0.1, 2.0]])
def test_the_closed_form_is_the_solution_of_eulers_equations(spin: list[float]) -> None:
    """DOP853 on the rotation matrix and the angular momentum in the scene; flips are zeros of a rate."""
    c, s = math.cos(0.4), math.sin(0.4)
    turn = np.array([[1, 0, 0], [0, c, -s], [0, s, c]])
    known = FreeRotation(INERTIA, np.array(spin), turn)
    momentum = turn @ INERTIA @ spin

    def rate(_t: float, y: np.ndarray) -> np.ndarray:
        now = y.reshape(3, 3)
        omega = now @ np.linalg.solve(INERTIA, now.T @ momentum)
        return np.cross(omega, now.T).T.ravel()

    times = np.linspace(0.0, 12.0, 13)
    found = solve_ivp(rate, (0.0, 12.0), turn.ravel(), "DOP853", times, rtol=1e-12, atol=1e-13)
    turned = found.y.T.reshape(-1, 3, 3)
    np.testing.assert_allclose(known.attitudes(times), turned, atol=1e-9)
    omega = np.linalg.solve(INERTIA, (np.swapaxes(turned, 1, 2) @ momentum).T).T
    np.testing.assert_allclose(known.rates(times), omega @ known.axes, atol=1e-9)
    assert np.abs(known.rates(known.flips(100.0))[:, 1]).max() < 1e-9


def test_the_reference_gets_the_effects_that_exunet_has_chosen() -> None:
    """All but mass damping are below the threshold of the case."""
    case = read_both(shipped("effects")["auto"])
    assert case.effects == {"mass_damping"}
    theirs = case.theirs.case.effects
    assert theirs.mass_damping == 0.2
    assert (theirs.orbit, theirs.bending, theirs.solar_pressure) == (None, None, None)
