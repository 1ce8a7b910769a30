"""Statistics of studies: coverage of intervals, and known answers."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from exunet.studies.estimates import (
    drivers,
    exceedance,
    paired_metrics,
    paired_outcomes,
    probability,
    quantiles,
    sobol_indices,
    wilks,
)

STUDIES = 1000


@pytest.mark.parametrize("p", [0.02, 0.5, 0.95])
def test_intervals_of_probabilities_cover(p: float) -> None:
    """1,000 synthetic studies of 50 runs: at least 94 % of the 95 % intervals hold the probability."""
    hits = np.random.default_rng(3).binomial(50, p, STUDIES)
    found = {count: probability(int(count), 50) for count in np.unique(hits)}
    assert np.mean([found[count].low <= p <= found[count].high for count in hits]) >= 0.94


def test_bound_of_wilks_covers() -> None:
    """1,000 synthetic studies of 100 runs of a skewed metric."""
    values = np.random.default_rng(4).lognormal(size=(STUDIES, 100))
    bounds = [quantiles(row).upper for row in values]
    truth = stats.lognorm(1.0).ppf(0.95)
    assert np.mean([bound >= truth for bound in bounds]) >= 0.94


def test_first_bounds_of_wilks() -> None:
    """Textbook values: 59 runs bound the 95 % quantile at 95 %, 93 by the second largest (Wilks 1941)."""
    assert wilks(58, 0.95) is None
    assert wilks(59, 0.95) == 58
    assert wilks(92, 0.95) == 91
    assert wilks(93, 0.95) == 91


def test_undetermined_runs_widen_the_interval_both_ways() -> None:
    """Neither dropped nor counted as misses; ends are those of 171 and 173 of 200."""
    found = probability(171, 200, 2)
    assert found.value == 171 / 200
    assert (found.low, found.high) == (probability(171, 200).low, probability(173, 200).high)
    with pytest.raises(ValueError, match="runs"):
        probability(200, 200, 1)


def test_limit_that_no_run_exceeds_has_a_bound() -> None:
    """0 of n: 1 - 0.05^(1/n); a run without a value counts as above."""
    values = np.linspace(0.0, 1.0, 200)
    assert exceedance(values, 2.0).bound == pytest.approx(1.0 - 0.05 ** (1.0 / 200.0), rel=1e-9)
    values[7] = np.nan
    assert exceedance(values, 2.0).hits == 0
    assert exceedance(values, 2.0).bound == pytest.approx(stats.beta.ppf(0.95, 2, 199), rel=1e-9)


def test_few_runs_have_only_their_extremes() -> None:
    found = quantiles(np.array([3.0, np.nan, 1.0, 2.0]))
    assert (found.runs, found.median, found.low, found.high, found.upper) == (3, None, 1.0, 3.0, None)
    assert quantiles(np.array([np.nan])) is None


def ishigami(x: np.ndarray) -> np.ndarray:
    """Sobol' indices 0.3139, 0.4424, 0 of first order, 0.5576, 0.4424, 0.2437 total."""
    return np.sin(x[0]) + 7.0 * np.sin(x[1]) ** 2 + 0.1 * x[2] ** 4 * np.sin(x[0])


FIRST, TOTAL = np.array([0.3139, 0.4424, 0.0]), np.array([0.5576, 0.4424, 0.2437])


def design(count: int, noise: float) -> np.ndarray:
    """Responses of a Saltelli design of three inputs with a dummy, with noise of a part of the variance."""
    points = stats.qmc.Sobol(6, rng=1).random(count).T * 2.0 * np.pi - np.pi
    a, b = points[:3], points[3:]
    mixed = [np.where(np.arange(3)[:, None] == i, b, a) for i in range(3)]
    values = np.array([ishigami(x) for x in (a, b, *mixed, a)])
    scale = np.sqrt(noise / (1.0 - noise)) * values[0].std()
    return values + scale * np.random.default_rng(2).normal(size=values.shape)


def test_indices_of_ishigami() -> None:
    """Within 0.05 at N = 1,024, and to 0.01 those of SciPy, which estimates the variance in another way."""
    values = design(1024, 0.0)
    found = sobol_indices(["x", "y", "z"], values, seed=1)
    np.testing.assert_allclose([item.first.value for item in found.inputs], FIRST, atol=0.05)
    np.testing.assert_allclose([item.total.value for item in found.inputs], TOTAL, atol=0.05)
    assert found.scatter == pytest.approx(0.0, abs=1e-15)
    known = stats.sobol_indices(
        func={"f_A": values[:1], "f_B": values[1:2], "f_AB": values[2:5, None]}, n=1024
    )
    np.testing.assert_allclose([item.first.value for item in found.inputs], known.first_order, atol=1e-2)
    np.testing.assert_allclose([item.total.value for item in found.inputs], known.total_order, atol=1e-2)


def test_scatter_is_the_index_of_the_dummy() -> None:
    """30 % of the variance is noise: the dummy shows 0.30 +- 0.05, and total - dummy the rest."""
    found = sobol_indices(["x", "y", "z"], design(1024, 0.3), seed=1)
    assert found.scatter == pytest.approx(0.3, abs=0.05)
    np.testing.assert_allclose([item.excess for item in found.inputs], 0.7 * TOTAL, atol=0.06)
    assert all(item.total.low <= item.total.value <= item.total.high for item in found.inputs)


def test_blocks_with_a_missing_run_are_left_out_up_to_a_twentieth() -> None:
    values = design(64, 0.0)
    values[3, :3] = np.nan
    assert sobol_indices(["x", "y", "z"], values, seed=1).blocks == 61
    values[0, 3] = np.nan
    assert sobol_indices(["x", "y", "z"], values, seed=1) is None


def test_drivers_from_given_data() -> None:
    """First-order indices of Ishigami's function to 0.05 from 4,096 random runs; a dummy is below."""
    rng = np.random.default_rng(5)
    x = rng.uniform(-np.pi, np.pi, (3, 4096))
    inputs = {"x": x[0], "y": x[1], "z": x[2], "kind": rng.choice(["a", "b"], 4096)}
    found = {driver.name: driver for driver in drivers(inputs, ishigami(x), seed=1)}
    for name, index in zip("xyz", FIRST, strict=True):
        assert found[name].index == pytest.approx(index, abs=0.05)
    assert found["x"].sign == 1
    assert found["kind"].index < found["kind"].level
    assert drivers(inputs, np.ones(4096), seed=1) == []


def test_paired_outcomes_have_the_exact_test_and_cover() -> None:
    """18 gained, 5 lost of 200: p by the binomial test; 1,000 comparisons cover in at least 94 %."""
    first, second = np.zeros(200), np.zeros(200)
    second[:18], first[18:23] = 1.0, 1.0
    found = paired_outcomes(first, second)
    assert (found.gained, found.lost, found.difference) == (18, 5, 0.065)
    assert found.p == pytest.approx(2.0 * stats.binom.cdf(5, 23, 0.5), rel=1e-12)
    rng, held = np.random.default_rng(6), 0
    for _ in range(STUDIES):
        common = rng.uniform(size=50)
        a, b = (common < 0.8).astype(float), ((common + 0.2 * rng.uniform(size=50)) < 0.8).astype(float)
        pair = paired_outcomes(a, b)
        held += pair.low <= -0.1 <= pair.high  # the mean of 0.2 u
    assert held >= 0.94 * STUDIES


def test_undetermined_pairs_widen_the_interval() -> None:
    first, second = np.zeros(100), np.zeros(100)
    second[:9] = 1.0
    known = paired_outcomes(first, second)
    second[9] = np.nan
    found = paired_outcomes(first, second)
    assert found.low == known.low
    assert found.high > known.high


def test_median_of_paired_differences() -> None:
    """A shift of 2 beside a common scatter of 10 is found: its interval does not have the common scatter."""
    rng = np.random.default_rng(7)
    common = rng.normal(0.0, 10.0, 100)
    found = paired_metrics(common, common + 2.0 + 0.1 * rng.normal(size=100), seed=1)
    assert found.low <= 2.0 <= found.high
    assert found.high - found.low < 0.1
