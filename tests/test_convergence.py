"""The comparison of two samples that tells whether a headline is converged."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import mannwhitneyu

from exunet.results.convergence import is_shifted, rank_test


@pytest.mark.parametrize("digits", [0, 1, 6])
def test_ranks_are_those_of_mann_and_whitney(digits: int) -> None:
    """Against SciPy's; to no digit after the point most values are ties."""
    draw = np.random.default_rng(20261123)
    for shift in (0.0, 0.5, 2.0):
        one = np.round(draw.normal(size=24), digits)
        other = np.round(draw.normal(shift, size=8), digits)
        expected = mannwhitneyu(one, other, method="asymptotic").pvalue
        assert rank_test(one, other) == pytest.approx(expected, rel=1e-12)
    assert rank_test([1.0, 1.0], [1.0]) == 1.0


@pytest.mark.ci
@pytest.mark.slow
def test_samples_of_one_distribution_are_seldom_told_apart() -> None:
    """Level 1 %: 2000 pairs give 20 by their ranks, and a few by a long tail."""
    draw = np.random.default_rng(20261123)
    for sample in (draw.normal, draw.uniform, draw.exponential):
        found = [is_shifted(sample(size=24), sample(size=8), 0.0, 0.01) for _ in range(2000)]
        assert sum(found) <= 80


def test_a_shift_by_the_width_is_told() -> None:
    """Uniform from 0 to 1, and from 1 to 2: no rank in common."""
    draw = np.random.default_rng(20261123)
    pairs = ((draw.uniform(size=24), draw.uniform(1.0, 2.0, size=8)) for _ in range(100))
    assert all(is_shifted(coarse, finer, 0.0, 0.05 / 30) for coarse, finer in pairs)


def test_one_finer_run_far_outside_is_enough() -> None:
    """By more than the others are apart, and by more than is printed; few runs have no ranks to tell by."""
    coarse = [1.99 + 1e-4 * k for k in range(6)]
    assert is_shifted(coarse, [1.9901, 1.86], 1e-3, 0.01)
    assert not is_shifted(coarse, [1.9901, 1.9899], 1e-3, 0.01)
    assert not is_shifted(coarse, [1.9901, 1.9890], 1e-2, 0.01)
    assert not is_shifted(coarse, [], 1e-3, 0.01)
