"""Known answers (rung 6): the formulas against published digits, and every case in both codes."""

import math

import numpy as np
import pytest

from exunet.net.arrays import Net
from exunet.studies.both_codes import read_both
from exunet.verification.answers import ANSWERS
from exunet.verification.answers.linear import frequency
from exunet.verification.answers.motions import hanging_chain, known_snap
from exunet.verification.answers.orders import ErrorSeries
from exunet.verification.check import Check, shipped

PATHS = shipped("verification")
SLOW = {"free_net", "smooth", "snap_from_slack", "rotating"}


def test_snap_of_two_masses_has_the_known_digits():
    """E = 70 GPa, d = 1 mm, L0 = 1 m, mu = 0.25 kg, v = 2.5 m/s: the field's exact targets."""
    known = known_snap(70e9 * math.pi / 4 * 1e-6, 1.0, 0.25, 2.5)
    assert known.strain == pytest.approx(5.331090e-3, rel=1e-6)
    assert known.force == pytest.approx(294.65036, rel=1e-7)
    assert known.contact_time == pytest.approx(6.67665e-3, rel=1e-6)


def test_a_stiff_hanging_chain_is_a_catenary():
    """y = a cosh(x / a), 2 a sinh(span / 2a) = length (textbook); 400 chords err by about 1e-5."""
    count, span = 400, 0.8
    nothing = np.empty(0, dtype=np.int64)
    ones = np.ones(count)
    net = Net(
        np.zeros((count + 1, 3)),
        np.ones(count + 1),
        np.column_stack([np.arange(count), np.arange(1, count + 1)]),
        ones / count,
        ones,
        1e9 * ones,
        ones,
        ones > 1,
        nothing,
        nothing,
    )
    places = hanging_chain(net, np.full(count + 1, 1.0 / count), span)
    from scipy.optimize import brentq

    a = brentq(lambda a: 2 * a * math.sinh(span / (2 * a)) - 1.0, 0.05, 5.0)
    known = a * np.cosh((places[:, 0] - span / 2) / a) - a * math.cosh(span / (2 * a))
    assert np.abs(places[:, 1] - known).max() < 2e-5


def test_frequency_of_an_exact_cosine():
    w, t = 12.345, 40.0
    for start in (1e-6, -3.0):
        found = frequency(start * math.cos(w * t), -start * w * math.sin(w * t), start, t, 1.0005 * w)
        assert found == pytest.approx(w, rel=1e-6)


def test_observed_order_of_an_exact_power():
    steps = np.array([10.0, 20.0, 40.0, 80.0])
    series = ErrorSeries("x", 3, False, steps, 2.0 * steps**-3.0, [0] * 4)
    assert series.observed(3) == pytest.approx(3.0)
    assert math.isnan(ErrorSeries("x", 3, False, steps, 0.0 * steps, [0] * 4).observed(3))


def test_every_case_is_known_and_every_answer_has_its_case():
    assert {name for name, _ in ANSWERS} == set(PATHS)


@pytest.mark.ci_for("vibration")
@pytest.mark.slow_for(
    "waves", "free_net", "smooth", "braking", "hanging", "pendulum", "vibration", "with_kink"
)
@pytest.mark.parametrize(
    ("name", "answer"),
    [pytest.param(name, answer, marks=pytest.mark.slow if name in SLOW else ()) for name, answer in ANSWERS],
)
def test_both_codes_give_the_known_answer(name, answer):
    checks = [finding for finding in answer(read_both(PATHS[name])) if isinstance(finding, Check)]
    assert checks
    for check in checks:
        assert check.holds, f"{check.name}: {check.measured} ({check.worst})"


def test_each_code_tells_its_own_peak_force(monkeypatch):
    from exunet.forces import cable
    from exunet.verification.answers.motions import snap
    from reference_impl import forces as formulas

    case = read_both(PATHS["snap"])
    for module, name, code in ((formulas, "tension", "reference"), (cable, "element_tension", "Exudyn")):
        with monkeypatch.context() as patch:
            right = getattr(module, name)
            patch.setattr(module, name, lambda *state, right=right: 2.0 * right(*state))
            failed = [check.name for check in snap(case) if not check.holds]
            assert failed == [f"peak force, {code}: relative error"]


def test_a_mouth_twice_as_large_is_seen(monkeypatch):
    from exunet.results import measures as metrics
    from exunet.verification.answers.mouth import areas

    right = metrics.mouth_area
    monkeypatch.setattr(metrics, "mouth_area", lambda *state: 2.0 * right(*state))
    failed = [check for check in areas(read_both(PATHS["square_net"])) if not check.holds]
    assert [check.measured for check in failed] == pytest.approx([1.0, 1.0])  # flat and folded: 2 - 1
