"""Labels of axes above each other at small sizes: folded, apart from each other, and on the page."""

from __future__ import annotations

import warnings
from dataclasses import replace

import pytest
from matplotlib.figure import Figure
from matplotlib.text import Annotation
from test_bands import moved_starts, shown

from exunet.base.errors import InputError
from exunet.figures import figure
from exunet.figures.labels import LEAST_SIZE, fit_labels, fold, labels_overlap
from exunet.figures.style import drawing

SIZES = {"closing": (85, 80), "contacts": (85, 60), "loads": (85, 60), "momentum": (85, 60)}


def test_words_are_folded_into_lines_of_like_length() -> None:
    """Units and brackets stay whole; a word that is longer than a line is one."""
    assert fold("torque about the\ncentre of mass [N m]", 3) == "torque about\nthe centre of\nmass [N m]"
    assert fold("change [kg m2/s]", 2) == "change\n[kg m2/s]"
    assert fold("along (0, 0.6, 0.8) of", 3) == "along\n(0, 0.6, 0.8)\nof"
    assert fold("one", 4) == "one"


@pytest.mark.parametrize("name", SIZES)
def test_labels_of_small_pages_are_apart_and_complete(name: str) -> None:
    """As wide as a journal's column; the same words as on a page that has room, but for lines."""
    spread = moved_starts(1.0, 2.0, 6.0)
    small, large = (figure(shown(), name, spread=spread, size=size) for size in (SIZES[name], (170, 160)))
    assert not labels_overlap(small)
    for one, other in zip(small.axes, large.axes, strict=True):
        assert one.get_ylabel().split() == other.get_ylabel().split()
        assert one.get_title(loc="left").split() == other.get_title(loc="left").split()
        assert one.yaxis.label.get_fontsize() >= LEAST_SIZE
        right = max(text.get_window_extent().x1 for text in one.findobj() if text is one.yaxis.label)
        assert right < one.get_window_extent().x0


def stacked(words: str) -> Figure:
    """Two pairs of axes, 15 mm high each or less, with a label each."""
    with drawing():
        made = Figure(figsize=(3.0, 1.6), layout="constrained")
        for axes in made.subplots(2, 1, sharex=True):
            axes.set_ylabel(words)
        made.draw_without_rendering()
    return made


def test_labels_that_reach_over_each_other_are_seen() -> None:
    """Middles of the axes are some 45 points apart; 38 letters of 8 points are some 170 long."""
    made = stacked("a label that is too long for them [N]")
    assert labels_overlap(made)
    fit_labels(made)
    assert not labels_overlap(made)
    assert [axes.get_ylabel().count("\n") for axes in made.axes] == [2, 2]
    assert not labels_overlap(stacked("force [N]"))


def test_labels_without_room_refuse_a_page() -> None:
    with pytest.raises(InputError, match="leave closing no room beside its texts: give 85 mm x"):
        figure(shown(), "closing", size=(85, 41))


def test_a_page_without_room_for_a_legend_is_refused_without_warnings() -> None:
    """Matplotlib warned of it on the terminal while labels and events were laid out."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(InputError, match="leave rotation no room beside its texts: give 60 mm x"):
            figure(shown(bodies=5), "rotation", size=(60, 55))


def test_events_have_their_causes_where_there_is_room_for_them() -> None:
    """Else the name of the entry alone."""
    event = {"entry": "close", "cause": "mouth_diameter < 0.5", "done": True, "time_s": 0.5}
    result = shown()
    result = replace(result, provenance={**result.provenance, "script": [event]})
    for size, expected in (((85, 60), "close"), ((170, 160), "close: mouth_diameter < 0.5")):
        texts = [
            one for one in figure(result, "contacts", size=size).axes[0].texts if isinstance(one, Annotation)
        ]
        assert [one.get_text() for one in texts] == [expected]
