"""Histograms and bands of an ensemble: what stands at their axes can be read, and is true."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from matplotlib.figure import Figure
from test_figures_print import drawn, words

import exunet
from exunet.figures.ensemble import _bins
from exunet.figures.powers import tell_power_of_ten
from exunet.figures.style import drawing
from exunet.results.ensemble_result import LEVELS, EnsembleResult

MIDDLES = {
    "largest_tension_N": (53.99269938, 1e-9),
    "time_of_largest_tension_s": (10.61823002, 4e-8),
    "largest_area_m2": (4.2, 0.3),
    "distance_m": (-18.677002, 2e-7),  # a negative one
    "bullet_speed_at_end_m_s": (3.0e-5, 2e-6),
    "margin_of_threads": (250.0, 1e-2),  # without a unit
    "bodies_chaser+target_time_of_least_distance_s": (0.987654321, 1e-8),
}


ONE_OF_MANY = "attachment_chaser_12_largest_force_N"
WORDS = (("velocity", "m_s"), ("angular_velocity", "rad_s"))


def ensemble(scale: float = 1.0) -> EnsembleResult:
    """Fifty runs, whose headlines differ by little or by much."""
    random = np.random.default_rng(1)
    time = np.linspace(0.0, 2.0, 11)
    curve = scale * np.quantile(1.0 + random.random((50, 11)), LEVELS, axis=0)
    values = {key: middle + size * random.normal(size=50) for key, (middle, size) in MIDDLES.items()}
    quantiles = {"area": curve, "kinetic": curve, "tension": curve}
    return EnsembleResult(values, np.zeros(50, dtype=np.int64), time, np.array(LEVELS), quantiles)


@pytest.mark.parametrize("name", ["histograms", "bands"])
@pytest.mark.parametrize("scale", [1.0, 1e-7])
def test_words_are_clear_of_each_other(name: str, scale: float) -> None:
    made = drawn(exunet.ensemble_figure(ensemble(scale), name))
    boxes = [(text.get_text(), text.get_window_extent()) for text in words(made)]
    for (one, a), (other, b) in itertools.combinations(boxes, 2):
        assert not a.padded(-1.0).overlaps(b.padded(-1.0)), (one, other)
    for word, box in boxes:
        assert min(box.x0, box.y0, made.bbox.x1 - box.x1, made.bbox.y1 - box.y1) >= 0, word


def test_histograms_of_values_that_differ_in_late_digits() -> None:
    """They stand at a round number that the label takes off, with the power of ten at the unit."""
    found = ensemble()
    made = exunet.ensemble_figure(found, "histograms")
    panels = dict(zip(found.headlines, made.axes, strict=True))
    labels = {key: axes.get_xlabel() for key, axes in panels.items()}
    assert labels["largest_tension_N"] == "largest tension \N{MINUS SIGN} 53.99269938 N [$10^{-9}$ N]"
    assert labels["distance_m"].startswith("distance travelled + 18.67700")
    assert labels["largest_area_m2"] == "largest area [m²]"
    assert labels["bullet_speed_at_end_m_s"] == "bullet speed at the end [$10^{-5}$ m/s]"
    assert labels["margin_of_threads"].endswith(" 250.0")
    folded = labels["bodies_chaser+target_time_of_least_distance_s"].split("\n")
    assert folded[0] == "time of least distance of chaser and target"
    assert folded[-1].endswith("[$10^{-8}$ s]")
    for key, start in (("largest_tension_N", 53.99269938), ("largest_area_m2", 0.0)):
        median = panels[key].get_lines()[0].get_xdata()[0]
        assert median + start == pytest.approx(np.median(found.headlines[key]), abs=1e-14, rel=1e-13)


def test_many_histograms_fit_on_a_page() -> None:
    """Fifteen of them, in three columns, with words in lines that have room; not of single attachments."""
    random = np.random.default_rng(2)
    keys = [f"body_target_{name}_{axis}_{unit}" for name, unit in WORDS for axis in "xyz"]
    keys += [f"body_{name}_attachment_largest_torque_N_m" for name in ("chaser", "target")]
    few = ensemble()
    values = {key: 0.12345 + 1e-8 * random.normal(size=50) for key in (*keys, ONE_OF_MANY)}
    many = EnsembleResult({**few.headlines, **values}, few.elements, few.time, few.levels, {})
    made = drawn(exunet.ensemble_figure(many, "histograms"))
    assert len(made.axes) == 7 + len(keys)
    assert made.get_figheight() * 25.4 <= 230.0
    boxes = [(text.get_text(), text.get_window_extent()) for text in words(made)]
    for (one, a), (other, b) in itertools.combinations(boxes, 2):
        assert not a.padded(-1.0).overlaps(b.padded(-1.0)), (one, other)
    for word, box in boxes:
        assert min(box.x0, made.bbox.x1 - box.x1) >= 0, word


@pytest.mark.parametrize(
    ("largest", "before", "after"),
    [
        (3.2e-7, "force [N]", "force [$10^{-7}$ N]"),
        (3.2e6, "force\nthere [N]", "force\nthere [$10^{6}$ N]"),
        (3.2e-7, "margin", "margin [$10^{-7}$]"),
        (0.032, "force [N]", "force [N]"),
        (0.0, "force [N]", "force [N]"),
    ],
)
def test_powers_of_ten_stand_with_the_unit(largest: float, before: str, after: str) -> None:
    with drawing():
        axes = Figure().subplots()
        axes.set(ylim=(-0.5 * largest, largest or 1.0), ylabel=before)
        tell_power_of_ten(axes.yaxis)
        drawn(axes.figure)
        assert axes.get_ylabel() == after
        assert not axes.yaxis.get_offset_text().get_visible() or not axes.yaxis.get_offset_text().get_text()
        numbers = [text.get_text().replace("\N{MINUS SIGN}", "-") for text in axes.get_yticklabels()]
        assert max(map(len, numbers)) <= 6


def test_bins_hold_whole_numbers_of_the_instants_at_which_a_time_is_seen() -> None:
    """Twelve times 5 ms apart, each as often as the others, in at most 7 bins: two in each."""
    times = np.repeat(1.9 + 0.005 * np.arange(12), 5)
    edges = _bins(times, 0.005)
    counts, _ = np.histogram(times, edges)
    assert counts.tolist() == [10] * 6
    assert edges[0] < times.min()
    assert len(_bins(times, 0.0)) == 7 + 1
