"""Statistics of two samples of runs, with a setting and with a finer one."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from exunet.base.arrays import Floats
from exunet.results.metrics import Metric

CHANCE = 0.05  # that any metric is called not converged although the setting does nothing
SURE = 0.99  # probability of the interval outside of which one more value differs
PART = 1.0 / 3.0  # of the range of runs with the finest setting, up to which a shift does not matter


def around_one_more(same: Floats) -> Floats:
    """Half the width of the interval in which one more value lies with the probability SURE.

    same : (runs, ...) values that differ by errors only, of a normal distribution
    """
    runs = len(same)
    width = float(scipy.stats.t.ppf(0.5 + 0.5 * SURE, runs - 1)) * math.sqrt(1.0 + 1.0 / runs)
    return np.asarray(width * same.std(axis=0, ddof=1))


def is_shifted(coarse: Sequence[float], finer: Sequence[float], last_digit: float, level: float) -> bool:
    """True if runs with a finer setting show that its error is not small against the perturbations'.

    coarse, finer : of perturbed runs, with the setting and with a finer one, of one metric
    last_digit    : what is printed of it
    level         : chance of a false alarm
    One of two things shows it: the ranks of both samples (`rank_test`), or a finer run that lies outside of
    all others by more than these are apart: starts that still share their method's error lie close together.
    """
    if not len(coarse) or not len(finer):
        return False
    least, largest = min(coarse), max(coarse)
    outside = max(least - min(finer), max(finer) - largest)
    return outside > max(largest - least, last_digit) or rank_test(coarse, finer) < level


def rank_test(one: Sequence[float], other: Sequence[float]) -> float:
    """Chance that ranks of two samples of one distribution differ by more than these do.

    The test of Wilcoxon, Mann and Whitney (1947, doi:10.1214/aoms/1177730491), two-sided, by the normal
    distribution, with corrections for continuity and for ties.
    """
    x, y = np.asarray(one, dtype=float), np.asarray(other, dtype=float)
    n, m = len(x), len(y)
    _, ties = np.unique(np.concatenate([x, y]), return_counts=True)
    total = n + m
    variance = n * m / 12.0 * (total + 1.0 - float((ties**3 - ties).sum()) / (total * (total - 1.0)))
    if variance <= 0.0:
        return 1.0
    above = float((x[:, None] > y).sum() + 0.5 * (x[:, None] == y).sum())
    off = max(0.0, abs(above - 0.5 * n * m) - 0.5)
    return math.erfc(off / math.sqrt(2.0 * variance))


@dataclass(frozen=True)
class SettingComparison:
    """A quantity with a setting, compared with the finest.

    shift       : difference of the medians; nan of the finest itself
    allowed     : shift that matters: a third of the range of the finest runs, or the printed digits
    significant : the shift exceeds what perturbations of the start make
    """

    values: Floats
    shift: float = math.nan
    allowed: float = 0.0
    significant: bool = False

    @property
    def median(self) -> float:
        """Median of the values."""
        return float(np.median(self.values))

    @property
    def matters(self) -> bool:
        """True if the shift reaches what is allowed."""
        return abs(self.shift) >= self.allowed


def compare(
    quantity: Metric, values: Floats, finest: Floats, resolution: float = 0.0, level: float = CHANCE
) -> SettingComparison:
    """Compare the values of a setting with those of the finest; empty `finest`: it is the finest itself.

    resolution : of the values, by stored times or steps
    level      : probability of a significant shift without a shift
    """
    if not len(finest):
        return SettingComparison(values)
    median, center, width = float(np.median(values)), float(np.median(finest)), float(np.ptp(finest))
    shift, last = median - center, max(resolution, quantity.last_digit(center))
    allowed = max(PART * width, last)
    if len(values) == 1:  # tested as one more run of the finest
        around = float(around_one_more(finest)) if len(finest) > 1 else math.inf
        significant = abs(median - float(finest.mean())) > max(last, around)
        return SettingComparison(values, shift, allowed, significant)
    significant = abs(shift) > last and is_shifted(values.tolist(), finest.tolist(), last, level)
    return SettingComparison(values, shift, allowed, significant)
