"""Statistics of the runs of a study: probabilities, quantiles, drivers, Sobol' indices, paired differences.

All functions take arrays with an entry for each run. NaN marks a run without the value: a guard stopped it,
it ended undetermined, or it failed. Such runs are never dropped from a probability, which they would bias.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from exunet.base.arrays import Floats

LEVEL = 0.95  # of confidence
FEW = 20  # runs, below which only minimum and maximum are stated
PERMUTATIONS = 999
RESAMPLES = 999
LEFT_OUT = 0.05  # share of incomplete blocks of a Saltelli design, above which indices are refused


@dataclass(frozen=True)
class Probability:
    """Probability with its interval.

    value        : hits over runs
    low, high    : interval at `level`; undetermined runs count as misses for low, as hits for high
    runs         : all, undetermined ones too
    undetermined : runs without a known outcome
    method       : of the interval
    """

    value: float
    low: float
    high: float
    runs: int
    undetermined: int
    level: float
    method: str

    def __str__(self) -> str:
        either = ""
        if self.undetermined:
            runs = "run" if self.undetermined == 1 else f"{self.undetermined} runs"
            either = f", the undetermined {runs} counted either way"
        interval = f"{self.level * 100.0:g} %: {self.low:.3f} to {self.high:.3f}{either}"
        return f"{round(self.value * self.runs)} of {self.runs} = {self.value:.3f}   ({interval})"


def probability(
    hits: int, runs: int, undetermined: int = 0, level: float = LEVEL, *, stratified: bool = False
) -> Probability:
    """Estimate a probability from independent runs.

    Parameters
    ----------
    hits, runs, undetermined : int
        Runs with the outcome, all runs, and those of which the outcome is not known.
    level : float
        Confidence level of the two-sided interval.
    stratified : bool
        The runs are a Latin hypercube; the interval of independent runs is then conservative.

    Returns
    -------
    Estimate
        With the exact interval of Clopper and Pearson (1934, doi:10.1093/biomet/26.4.404).
    """
    if not 0 <= hits + undetermined <= runs or runs < 1:
        raise ValueError(
            f"hits and undetermined must not exceed runs >= 1, not {hits}, {undetermined} and {runs}"
        )
    low = stats.binomtest(hits, runs).proportion_ci(level, "exact").low
    high = stats.binomtest(hits + undetermined, runs).proportion_ci(level, "exact").high
    method = "Clopper-Pearson, conservative" if stratified else "Clopper-Pearson"
    return Probability(hits / runs, float(low), float(high), runs, undetermined, level, method)


@dataclass(frozen=True)
class Exceedance:
    """Runs in which a metric is above a limit.

    hits, runs : runs above the limit, runs with a value or without one
    bound      : one-sided upper bound of the probability; runs without a value count as above
    """

    limit: float
    hits: int
    runs: int
    bound: float

    def __str__(self) -> str:
        return f"above {self.limit:g}: {self.hits} of {self.runs} (below {self.bound * 100.0:.2g} %)"


def exceedance(values: Floats, limit: float) -> Exceedance:
    """Count the runs above a limit, with the one-sided exact bound of their probability."""
    known = values[~np.isnan(values)]
    hits, missing = int(np.sum(known > limit)), len(values) - len(known)
    exact = stats.binomtest(hits + missing, len(values), alternative="less").proportion_ci(LEVEL, "exact")
    return Exceedance(limit, hits, len(values), float(exact.high))


@dataclass(frozen=True)
class Quantiles:
    """Distribution of a metric over runs.

    runs         : with a value
    median       : None below `FEW` runs
    low, high    : 5 % and 95 % quantile; minimum and maximum below `FEW` runs
    upper, lower : one-sided bounds of the two quantiles at `LEVEL` by Wilks; None where the runs are too few
    """

    runs: int
    median: float | None
    low: float
    high: float
    lower: float | None
    upper: float | None


def wilks(count: int, part: float) -> int | None:
    """Return the rank (from 0) of the smallest order statistic that bounds a quantile from above.

    Parameters
    ----------
    count : int
        Number of independent runs.
    part : float
        Of the quantile, 0 to 1.

    Returns
    -------
    int or None
        None if the largest of the runs does not bound it: that of 0.95 below 59 runs.

    Notes
    -----
    The number of runs below the quantile is binomial (Wilks 1941, doi:10.1214/aoms/1177731788); the order
    statistic is at least the quantile with the probability `LEVEL`.
    """
    rank = int(stats.binom.ppf(LEVEL, count, part))
    return rank if rank < count else None


def quantiles(values: Floats) -> Quantiles | None:
    """Summarise a metric over runs; None without a value.

    Runs without a value are left out: state `Quantiles.runs` beside the numbers.
    """
    known = np.sort(values[~np.isnan(values)])
    count = len(known)
    if not count:
        return None
    if count < FEW:
        return Quantiles(count, None, float(known[0]), float(known[-1]), None, None)
    low, median, high = (float(value) for value in np.quantile(known, [0.05, 0.5, 0.95]))
    rank = wilks(count, 0.95)
    upper, lower = (None, None) if rank is None else (float(known[rank]), float(known[count - 1 - rank]))
    return Quantiles(count, median, low, high, lower, upper)


@dataclass(frozen=True)
class Driver:
    """First-order effect of an input on a response.

    index : share of the variance of the response that the mean over the input explains
    level : 95 % quantile of the index of a permuted input; an index below is as good as none
    sign  : of Spearman's rank correlation, -1, 0 or 1
    """

    name: str
    index: float
    level: float
    sign: int


def drivers(inputs: Mapping[str, NDArray[np.generic]], response: Floats, seed: int) -> list[Driver]:
    """Estimate first-order effects from given data, the largest first.

    Parameters
    ----------
    inputs : mapping of str to (runs,) array
        Numbers, or texts of a choice.
    response : (runs,) array
        Metric, or 1 and 0 of an outcome; NaN is left out.
    seed : int
        Of the permutations.

    Returns
    -------
    list of Driver
        Empty if the response does not vary.

    Notes
    -----
    The correlation ratio over classes of equal frequency, without its bias (Kelley 1935,
    doi:10.1073/pnas.21.9.554): 1 - (1 - eta^2) (n - 1) / (n - k) for k classes.
    """
    known = ~np.isnan(response)
    y = response[known]
    if len(y) < FEW or not np.ptp(y):
        return []
    rng, found = np.random.default_rng(seed), []
    orders = [rng.permutation(len(y)) for _ in range(PERMUTATIONS)]
    for name, column in inputs.items():
        classes, ranks = _classes(column[known])
        if classes.max() == 0:
            continue
        permuted = [_explained(classes, y[order]) for order in orders]
        sign = 0.0 if ranks is None else stats.spearmanr(ranks, y).statistic
        found.append(
            Driver(name, _explained(classes, y), float(np.quantile(permuted, LEVEL)), int(np.sign(sign)))
        )
    return sorted(found, key=lambda driver: -driver.index)


def _classes(column: NDArray[np.generic]) -> tuple[NDArray[np.int64], NDArray[np.int64] | None]:
    """Return the class of each run, of equal frequency, and ranks of numbers; few values are classes."""
    values, number = np.unique(column, return_inverse=True)
    count = max(2, round(len(column) ** (1.0 / 3.0)))
    ranks = None if column.dtype.kind in "OSU" else number.astype(np.int64)
    if ranks is None or len(values) <= count:
        return number.astype(np.int64), ranks
    order = np.empty(len(column), dtype=np.int64)
    order[np.argsort(column, kind="stable")] = np.arange(len(column))
    return order * count // len(column), ranks


def _explained(classes: NDArray[np.int64], y: Floats) -> float:
    """Return the share of the variance between classes, without its bias; it may be below 0."""
    count = np.bincount(classes)
    sums = np.bincount(classes, y - y.mean())
    between = float(np.sum(sums[count > 0] ** 2 / count[count > 0]))
    n, k = len(y), int(np.sum(count > 0))
    return 1.0 - (1.0 - between / float(np.sum((y - y.mean()) ** 2))) * (n - 1) / (n - k)


class Interval(NamedTuple):
    """Value with the ends of its interval."""

    value: float
    low: float
    high: float


@dataclass(frozen=True)
class SobolIndex:
    """Sobol' indices of an input with bootstrap intervals.

    excess : total index without that of the dummy, which is the numerical scatter
    """

    name: str
    first: Interval
    total: Interval
    excess: float


@dataclass(frozen=True)
class SobolIndices:
    """Sobol' indices of all inputs.

    scatter  : total index of the dummy input, a start that is perturbed: the share of numerical scatter
    blocks   : complete blocks of the design, of which the indices are
    left_out : share of blocks with a run without a value
    """

    inputs: list[SobolIndex]
    scatter: float
    blocks: int
    left_out: float


def sobol_indices(names: list[str], response: Floats, seed: int) -> SobolIndices | None:
    """Estimate first-order and total Sobol' indices from a Saltelli design with a dummy input.

    Parameters
    ----------
    names : list of str
        Of the d inputs.
    response : (d + 3, N) array
        Of A, B, A with column i of B for each input, and A again from a perturbed start.
    seed : int
        Of the bootstrap.

    Returns
    -------
    SobolIndices or None
        None if more than `LEFT_OUT` of the blocks have a run without a value, or the response does not vary.

    Notes
    -----
    Estimators of Saltelli et al. (2010, doi:10.1016/j.cpc.2009.09.018), table 2 (b) and (f), as in
    `scipy.stats.sobol_indices`, which does not take a design with blocks left out.
    """
    complete = ~np.isnan(response).any(axis=0)
    left_out = 1.0 - float(complete.mean())
    values = response[:, complete]
    if left_out > LEFT_OUT or values.shape[1] < 2 or not np.ptp(values[:2]):
        return None
    values = values - values[:2].mean()

    def both(a: Floats, b: Floats, *mixed: Floats, axis: int = -1) -> Floats:
        variance = np.concatenate([a, b], axis=axis).var(axis=axis)
        first = [np.mean(b * (c - a), axis=axis) / variance for c in mixed]
        total = [0.5 * np.mean((a - c) ** 2, axis=axis) / variance for c in mixed]
        return np.asarray([*first, *total])

    found = both(*values)
    resampled = stats.bootstrap(
        tuple(values), both, paired=True, n_resamples=RESAMPLES, confidence_level=LEVEL, method="percentile",
        vectorized=True, rng=np.random.default_rng(seed),
    ).confidence_interval  # fmt: skip
    d, scatter = len(names), float(found[-1])
    ends = (found, resampled.low, resampled.high)
    indices = []
    for i, name in enumerate(names):
        first, total = (Interval(*(float(part[row]) for part in ends)) for row in (i, d + 1 + i))
        indices.append(SobolIndex(name, first, total, total.value - scatter))
    return SobolIndices(indices, scatter, values.shape[1], left_out)


@dataclass(frozen=True)
class PairedOutcome:
    """Difference of the probabilities of an outcome between two designs with the same draws.

    difference     : of the second from the first
    low, high      : interval at `LEVEL`; undetermined runs counted for the end that they widen
    gained, lost   : pairs in which only the second, only the first has the outcome
    p              : exact McNemar test
    """

    difference: float
    low: float
    high: float
    gained: int
    lost: int
    pairs: int
    p: float

    def __str__(self) -> str:
        interval = f"({self.low:+.3f} to {self.high:+.3f})"
        return (
            f"difference {self.difference:+.3f} {interval}, {self.gained} gained, {self.lost} lost, "
            f"McNemar p = {self.p:.2g}"
        )


def paired_outcomes(first: Floats, second: Floats) -> PairedOutcome:
    """Compare an outcome between two designs with the same draws.

    Parameters
    ----------
    first, second : (pairs,) array
        1 with the outcome, 0 without, NaN undetermined.

    Notes
    -----
    The interval is that of Bonett and Price (2012, doi:10.3102/1076998611411915).
    """
    pairs, z = len(first), float(stats.norm.ppf(0.5 + 0.5 * LEVEL))

    def ends(a: Floats, b: Floats) -> tuple[float, float]:
        only_b, only_a = (
            (np.sum((b == 1) & (a == 0)) + 1) / (pairs + 2),
            (np.sum((a == 1) & (b == 0)) + 1) / (pairs + 2),
        )
        middle = only_b - only_a
        half = z * math.sqrt((only_b + only_a - middle**2) / (pairs + 2))
        return max(-1.0, float(middle - half)), min(1.0, float(middle + half))

    low, _ = ends(np.nan_to_num(first, nan=1.0), np.nan_to_num(second, nan=0.0))
    _, high = ends(np.nan_to_num(first, nan=0.0), np.nan_to_num(second, nan=1.0))
    gained, lost = int(np.sum((second == 1) & (first == 0))), int(np.sum((first == 1) & (second == 0)))
    p = 1.0 if not gained + lost else float(stats.binomtest(gained, gained + lost).pvalue)
    return PairedOutcome((gained - lost) / pairs, low, high, gained, lost, pairs, p)


@dataclass(frozen=True)
class PairedMetric:
    """Median of the differences of a metric between two designs with the same draws, with its interval."""

    median: float
    low: float
    high: float
    pairs: int

    def __str__(self) -> str:
        interval = f"({self.low:+.3g} to {self.high:+.3g})"
        return f"median of differences {self.median:+.3g} {interval}, {self.pairs} pairs"


def paired_metrics(first: Floats, second: Floats, seed: int) -> PairedMetric | None:
    """Compare a metric between two designs with the same draws; None for fewer than two complete pairs.

    Pairs in which a run does not have the metric are left out. The interval is a bootstrap of the median.
    """
    difference = second - first
    difference = difference[~np.isnan(difference)]
    if len(difference) < 2:
        return None
    median = float(np.median(difference))
    if not np.ptp(difference):
        return PairedMetric(median, median, median, len(difference))
    interval = stats.bootstrap(
        (difference,), np.median, n_resamples=RESAMPLES, confidence_level=LEVEL, method="percentile",
        rng=np.random.default_rng(seed),
    ).confidence_interval  # fmt: skip
    return PairedMetric(median, float(interval.low), float(interval.high), len(difference))
