"""Rung 9 of threads that touch each other: both codes agree, and what is wrong with one is seen."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from exunet.studies.both_codes import BothCodes, read_both
from exunet.verification import together
from exunet.verification.check import shipped
from reference_impl import Refused, self_contact
from reference_impl.read import read


@pytest.fixture(scope="module")
def case() -> BothCodes:
    return read_both(shipped(together.TOGETHER_CASES)["together"])


@pytest.mark.ci
@pytest.mark.slow
def test_both_codes_agree_at_states(case: BothCodes) -> None:
    checks = list(together.at_states(case, 6))
    assert len(checks) == 4
    assert all(check.holds for check in checks), checks


def test_the_least_distance_is_that_of_many_points() -> None:
    """The reference's, of 200 pairs of lines, beside 101 points on each: less by at most a spacing."""
    random = np.random.default_rng(20261123)
    a, u, b, w = random.normal(size=(4, 200, 3))
    w[:50] = 0.7 * u[:50]  # parallel
    u[50:60] = 0.0  # points
    found = self_contact.closest(a, u, b, w)
    s = np.linspace(0.0, 1.0, 101)[:, None]
    one, other = a[:, None] + s * u[:, None], b[:, None] + s * w[:, None]
    points = np.linalg.norm(one[:, :, None] - other[:, None], axis=-1).min(axis=(1, 2))
    spacing = 0.005 * (np.linalg.norm(u, axis=1) + np.linalg.norm(w, axis=1))
    assert (found <= points + 1e-14).all()
    assert (points - found <= spacing).all()


def test_the_reference_refuses_friction_between_threads() -> None:
    path: Path = shipped(together.TOGETHER_CASES)["together"]
    with pytest.raises(Refused, match="friction"):
        read(path, {"effects.self_contact.friction": 0.3})
