"""The figures: there when they make sense, left out when not, never a warning, quick for big nets."""

from __future__ import annotations

import itertools
import warnings
from dataclasses import replace
from pathlib import Path

import matplotlib
import numpy as np
import pytest
from matplotlib.collections import LineCollection
from result_samples import net, result, square_net, unfolding
from small_nets import CABLE, thrown

import exunet
from exunet.base.errors import InputError
from exunet.figures import figures, save_figures
from exunet.figures.nets import snapshot_indices
from exunet.figures.page import shortened
from exunet.figures.style import drawing
from exunet.figures.thinning import BINS, thinned, thinned_band
from exunet.results import measures as metrics
from exunet.results.agreement import Agreement
from exunet.results.result import BodyStates, TermStates
from exunet.simulation.preparation import prepare

THROWN_NET = {
    "cable": CABLE,
    "strings": {**CABLE, "length": 1.4},
    "bullets": {"mass": 0.5},
}
ALWAYS = {"snapshots", "energies"}
WITH_ELEMENTS = {"reference_net"}
TENSIONS = {"tensions", "largest_tension"}  # of all nets with an element
THROWN = unfolding(square_net(cells=3, strings=True), lift=0.2)
SPEEDS = {"bullet_speeds"}
BOTH = {"bullet_speeds", "area"}
LINE = net([(0, 0, 0), (1, 0, 0)], [(0, 1)])
HANGING = net([(0, 0, 0), (1, 0, 0.5), (2, 0, 0)], [(0, 1), (1, 2)])
MANY = net(
    [(np.cos(a), np.sin(a), 0) for a in range(30)],
    [(k, (k + 1) % 30) for k in range(30)],
    bullets=tuple(range(30)),
)


def agreement_with(of, until=0.5, factor=1.0):
    difference = factor * np.geomspace(1e-12, 1, len(of.time))
    return Agreement(of.time, difference, difference, 0.025, 1e-4, until, until, metrics.bullet_speeds(of))


def checked(of, agreement=None):
    """The figures' names, after every one of them was drawn with warnings as errors."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        made = figures(of, agreement)
        with drawing():
            for figure in made.values():
                figure.canvas.draw()
    return made


def texts(figure):
    return " ".join(t.get_text() for t in figure.findobj(matplotlib.text.Text))


def curves(figure):
    return {line.get_label(): line for line in figure.axes[0].get_lines()}


AWAY = np.linspace(0, 50, 7)[:, None, None]  # m
BLOWN = np.geomspace(1, 1e25, 7)[:, None, None]

ODD = {
    "thrown": (THROWN, BOTH),
    "planar": (unfolding(square_net(cells=2, strings=True)), BOTH),
    "single time": (unfolding(square_net(strings=True), times=1), BOTH),
    "no bullets, no mouth": (unfolding(LINE), set()),
    "in the x-z plane": (unfolding(HANGING), set()),
    "many bullets": (unfolding(MANY), SPEEDS),
    "at rest": (result(square_net(), [0, 1], [square_net().reference_position] * 2), BOTH),
    "one node": (result(net([(0, 0, 0)], [], bullets=(0,)), [0, 1], np.zeros((2, 1, 3))), SPEEDS),
    "far away": (replace(THROWN, position=THROWN.position + AWAY), BOTH),
    "blown up": (replace(THROWN, position=BLOWN * THROWN.position, complete=False, verdict="?"), BOTH),
    "falling": (replace(unfolding(LINE), potential=-np.linspace(0, 9, 7)), set()),
    "odd verdict": (replace(THROWN, complete=False, verdict="$5_^{ 中文 \n" + 50 * "more "), BOTH),
}


def ends_drawn(axes):
    """(k, 2) end points of the elements that are drawn, in order; a bundle of them has NaN in between."""
    lines = [line for c in axes.collections if isinstance(c, LineCollection) for line in c.get_segments()]
    points = np.concatenate([np.empty((0, 2)), *lines])
    return points[np.isfinite(points).all(axis=1)]


def ends_of(of, position, plane):
    """The same of a configuration (n_nodes, 3): strings come last, and nothing is drawn beyond 1000 sizes."""
    ends = np.concatenate([of.element_nodes[~of.is_string], of.element_nodes[of.is_string]])
    farthest = 1e3 * (np.ptp(of.reference_position, axis=0).max() or 1.0)
    return np.clip(position[ends][..., plane].reshape(-1, 2), -farthest, farthest)


@pytest.mark.parametrize("name", ODD)
def test_figures_of_odd_results(name):
    """Each net where its states are, and within the axes; each curve with the result's numbers."""
    of, more = ODD[name]
    made = checked(of)
    assert set(made) == ALWAYS | more | (TENSIONS | WITH_ELEMENTS if of.net.n_elements else set())
    for figure in made.values():
        assert ("INCOMPLETE" in texts(figure)) != of.complete
        for axes in figure.axes:
            assert np.isfinite([axes.get_xlim(), axes.get_ylim()]).all()
            assert np.diff([axes.get_xlim(), axes.get_ylim()]).min() > 0.0

    plane = [0, 2 if name == "in the x-z plane" else 1]
    whole = ends_of(of.net, of.net.reference_position, plane)
    if of.net.n_elements:
        np.testing.assert_array_equal(ends_drawn(made["reference_net"].axes[0]), whole)
    panels = [axes for axes in made["snapshots"].axes if axes.get_title(loc="left")]
    for axes, k in zip(panels, snapshot_indices(of.time, 6), strict=True):
        follows = name in ("far away", "blown up")  # by more than half of the net's size
        assert ("$c$" in axes.get_title(loc="left")) == follows
        state = of.position[k] - (metrics.centre_of_mass(of)[k] if follows else 0.0)
        drawn = ends_drawn(axes)
        np.testing.assert_allclose(drawn[len(whole) :], ends_of(of.net, state, plane), rtol=0, atol=1e-12)
        if name != "blown up" and len(drawn):  # there, what is near stays readable
            assert (axes.get_xlim()[0] < drawn[:, 0].min()) & (drawn[:, 0].max() < axes.get_xlim()[1])
            assert (axes.get_ylim()[0] < drawn[:, 1].min()) & (drawn[:, 1].max() < axes.get_ylim()[1])

    energies, balance = made["energies"].axes
    assert energies.get_ylabel() == "energy change [J]"
    curve = curves(made["energies"])
    parts = {"kinetic": of.kinetic, "elastic": of.elastic, "dissipated": of.dissipated}
    if name == "falling":
        parts["potential"] = of.potential
    assert set(curve) == set(parts)
    for label, values in parts.items():
        change = values - values[0]
        np.testing.assert_array_equal(curve[label].get_xdata(), of.time)
        np.testing.assert_allclose(curve[label].get_ydata(), change, rtol=1e-15)
        low, high = energies.get_ylim()
        assert low <= change.min() <= change.max() <= high
    errors = sum(values - values[0] for values in parts.values())
    np.testing.assert_allclose(balance.get_lines()[0].get_ydata(), errors, rtol=1e-12, atol=1e-15)
    assert balance.get_ylim()[0] == -balance.get_ylim()[1]
    assert np.abs(errors).max() < balance.get_ylim()[1]
    assert len(balance.get_yticks()) == 3


@pytest.mark.parametrize("name", ["thrown", "single time", "no bullets, no mouth", "many bullets"])
def test_agreement_is_drawn_if_given(name):
    of, more = ODD[name]
    assert set(checked(of, agreement_with(of))) == ALWAYS | WITH_ELEMENTS | TENSIONS | more | {"agreement"}
    without = checked(of, agreement_with(of, until=None, factor=0.0))
    assert set(without) == ALWAYS | WITH_ELEMENTS | TENSIONS | more | {"agreement"}


def test_agreement_shows_threshold_horizon_and_the_other_speeds():
    made = checked(THROWN, agreement_with(THROWN))
    drawn = curves(made["agreement"])
    assert {"allowed 0.025 m/s", "allowed 0.0001 m", "agree until 0.5 s"} <= set(drawn)
    for limit, curve in (("allowed 0.025 m/s", "speed [m/s]"), ("allowed 0.0001 m", "position [m]")):
        assert drawn[limit].get_color() == drawn[curve].get_color()
    assert made["agreement"].axes[0].get_yscale() == "log"
    assert "reference" in curves(made["bullet_speeds"])


def test_the_reference_hides_no_curve():
    """Over the broad curves of a few bullets it is thinner, below the thin ones of many broader."""
    for name, below in (("thrown", False), ("many bullets", True)):
        of = ODD[name][0]
        lines = checked(of, agreement_with(of))["bullet_speeds"].axes[0].get_lines()
        at = next(k for k, line in enumerate(lines) if line.get_label() == "reference")
        count = len(of.net.bullet_nodes)
        own, theirs = lines[:count], lines[at : at + count]
        assert (max(line.get_zorder() for line in theirs) < min(line.get_zorder() for line in own)) == below
        assert (theirs[0].get_linewidth() > max(line.get_linewidth() for line in own)) == below


def test_curves_hold_the_results_numbers():
    made = checked(THROWN)
    np.testing.assert_array_equal(
        curves(made["bullet_speeds"])["node 16"].get_ydata(), metrics.bullet_speeds(THROWN)[:, 0]
    )
    kinetic = curves(made["energies"])["kinetic"].get_ydata()
    np.testing.assert_array_equal(kinetic, THROWN.kinetic - THROWN.kinetic[0])
    mouth = curves(made["area"])["mouth / achievable area (1 m²)"].get_ydata()
    assert mouth[0] == pytest.approx(0.01)  # a tenth of the size, squared


def test_bands_reach_to_the_extremes_between_stored_times():
    peak = THROWN.elastic + 0.25 * THROWN.kinetic[0]
    drawn = checked(replace(THROWN, largest_elastic=peak, least_kinetic=0.5 * THROWN.kinetic))["energies"]
    *bands, entry = drawn.axes[0].collections
    ends = np.concatenate([path.vertices[:, 1] for band in bands for path in band.get_paths()])
    assert ends.min() == pytest.approx((0.5 * THROWN.kinetic).min() - THROWN.kinetic[0])
    assert ends.max() == pytest.approx(peak.max() - THROWN.elastic[0])
    assert entry.get_label() == "extremes of all steps"
    older = checked(THROWN)["energies"]
    assert not older.axes[0].collections


def test_bands_cover_no_more_than_what_is_beyond_the_curve():
    """Of an energy that grows evenly the least of an interval is where it began: nothing is beyond."""
    growing = 1.0 + THROWN.time
    least = np.append(growing[:1], growing[:-1])
    of = replace(THROWN, kinetic=growing, least_kinetic=least, largest_elastic=THROWN.elastic)
    assert [len(c.get_paths()) for c in checked(of)["energies"].axes[0].collections[:2]] == [0, 0]
    deep = least.copy()
    deep[3] = 0.25
    band = checked(replace(of, least_kinetic=deep))["energies"].axes[0].collections[0]
    (path,) = band.get_paths()
    time, change = of.time, growing - growing[0]
    quad = [(time[2], change[2]), (time[2], -0.75), (time[3], -0.75), (time[3], change[3])]
    np.testing.assert_allclose(path.vertices[:4], quad)


def test_energies_show_small_changes_of_large_ones():
    """A net that flies fast and dissipates little: the change fills the axis, and the balance is below."""
    lost = np.linspace(0.0, 1e-3, 7)
    flying = replace(THROWN, kinetic=100.0 - lost, dissipated=lost * (1 + 1e-6), elastic=0 * lost)
    made = checked(flying)["energies"]
    low, high = made.axes[0].get_ylim()
    assert (high - low) < 3e-3
    assert made.axes[0].get_ylabel() == "energy change [$10^{-3}$ J]"
    assert made.axes[0].get_xlabel() == ""
    assert made.axes[1].get_title(loc="left") == "error of the energy balance [$10^{-9}$ J]"
    errors = made.axes[1].get_lines()[0].get_ydata()
    np.testing.assert_allclose(errors, 1e-6 * lost, atol=1e-13)
    assert metrics.energy_errors(flying)[-1] == errors[-1]


def test_work_that_is_put_in_is_a_curve_of_its_own():
    """Of a body whose motion is given: what is dissipated is without it, and the balance counts both."""
    taken, work = np.linspace(0.0, 0.5, 7), np.linspace(0.0, 2.0, 7)
    still, upright = np.zeros((7, 3)), np.tile([1.0, 0.0, 0.0, 0.0], (7, 1))
    of = replace(
        THROWN,
        kinetic=5.0 + work - taken,
        elastic=0 * work,
        dissipated=taken - work,
        bodies={"hand": BodyStates(2.0, np.eye(3), still, still, upright, still)},
        states={"hand/work": TermStates("J", work[:, None])},
    )
    made = checked(of)["energies"]
    drawn = curves(made)
    np.testing.assert_allclose(drawn["work of hand"].get_ydata(), work)
    np.testing.assert_allclose(drawn["dissipated"].get_ydata(), taken, atol=1e-15)
    np.testing.assert_allclose(made.axes[1].get_lines()[0].get_ydata(), 0.0, atol=1e-14)
    assert not [name for name in curves(checked(THROWN)["energies"]) if name.startswith("work")]


@pytest.mark.parametrize("number", [2, 4, 6])
def test_each_source_of_work_has_a_curve(number: int) -> None:
    """Bodies of given motion that put in 1, 2 ... J, an ejection of 3.5 J: what is beyond four is summed."""
    still, upright = np.zeros((7, 3)), np.tile([1.0, 0.0, 0.0, 0.0], (7, 1))
    works = {f"hand{k}": np.linspace(0.0, k, 7) for k in range(1, number)}
    thrown = 3.5 * (np.arange(7) >= 2)
    event = {"time_s": float(THROWN.time[2]), "energy_lost_J": -3.5}
    of = replace(
        THROWN,
        kinetic=5.0 + sum(works.values()) + thrown,
        elastic=np.zeros(7),
        dissipated=-sum(works.values()) - thrown,
        bodies={name: BodyStates(2.0, np.eye(3), still, still, upright, still) for name in works},
        states={f"{name}/work": TermStates("J", work[:, None]) for name, work in works.items()},
        provenance={**THROWN.provenance, "ejection": [event]},
    )
    drawn = {name: line for name, line in curves(checked(of)["energies"]).items() if name.startswith("work")}
    assert len(drawn) == min(number, 4)
    np.testing.assert_allclose(drawn["work of ejection"].get_ydata(), thrown)
    in_all = np.sum([line.get_ydata() for line in drawn.values()], axis=0)
    np.testing.assert_allclose(in_all, sum(works.values()) + thrown)
    if number == 6:
        others = works["hand1"] + works["hand2"] + works["hand3"]
        np.testing.assert_allclose(drawn["work of 3 others"].get_ydata(), others)


def test_reference_figure_names_sizes_and_nodes():
    figure = checked(unfolding(square_net(cells=5, size=5.0, strings=True)))["reference_net"]
    said = texts(figure)
    assert "$L$ = 5 m" in said  # Table 1 of the paper
    assert "$\\ell$ = 1 m" in said
    labels = {t.get_text() for t in figure.axes[0].texts}
    assert {
        "36",
        "37",
        "38",
        "39",
        "0",
        "5",
        "30",
        "35",
    } <= labels  # 36 knots first in this sample, then bullets


@pytest.mark.parametrize(
    "keys",
    [
        {"topology": "hexagonal", "mesh": 0.5, "rings": 3},
        {"topology": "radial", "radius": 2.5, "spokes": 8, "rings": 4},
    ],
    ids=lambda keys: keys["topology"],
)
def test_words_of_the_reference_figure_touch_neither_each_other_nor_a_cable(keys):
    start = prepare(thrown({}, net=THROWN_NET | keys))
    made = checked(result(start.net, [0.0], start.position[None]))["reference_net"]
    axes = made.axes[0]
    words = [text for text in axes.texts if text.get_text()]
    boxes = [text.get_window_extent() for text in words]
    pairs = itertools.combinations(range(len(boxes)), 2)
    assert not [(a, b) for a, b in pairs if boxes[a].overlaps(boxes[b])]
    ends = axes.transData.transform(start.net.reference_position[start.net.element_nodes, :2].reshape(-1, 2))
    for text, box in zip(words, boxes, strict=True):
        if text.get_text().endswith(" m"):  # a length; numbers have a white rim
            for line in ends.reshape(-1, 2, 2):
                along = line[0] + np.linspace(0, 1, 200)[:, None] * (line[1] - line[0])
                assert not any(box.contains(*point) for point in along), text.get_text()


@pytest.mark.parametrize("size", [(85.0, 60.0), (85.0, 85.0), None], ids=str)
@pytest.mark.parametrize(
    "keys",
    [
        {"topology": "hexagonal", "mesh": 0.5, "rings": 3},
        {"topology": "radial", "radius": 2.5, "spokes": 8, "rings": 4},
        {"topology": "square", "size": 5.0, "mesh": 0.5},
    ],
    ids=lambda keys: keys["topology"],
)
def test_the_reference_figure_is_legible_at_any_size(keys, size):
    """Words and numbers touch neither each other nor the frame nor a dimension's arrow."""
    start = prepare(thrown({}, net=THROWN_NET | keys))
    made = exunet.figure(result(start.net, [0.0], start.position[None]), "reference_net", size=size)
    with drawing():
        made.canvas.draw()
    axes = made.axes[0]
    boxes = [(text.get_text(), text.get_window_extent()) for text in axes.texts if text.get_text()]
    for (one, a), (other, b) in itertools.combinations(boxes, 2):
        assert not a.padded(-2.0).overlaps(b.padded(-2.0)), (one, other)
    frame = axes.get_window_extent()
    for word, box in boxes:
        assert frame.x0 <= box.x0, word
        assert box.x1 <= frame.x1, word
        assert frame.y0 <= box.y0, word
        assert box.y1 <= frame.y1, word
    for arrow in (text for text in axes.texts if not text.get_text()):
        ends = axes.transData.transform([arrow.xy, arrow.xyann])
        along = ends[0] + np.linspace(0, 1, 100)[:, None] * (ends[1] - ends[0])
        for word, box in boxes:
            if not word.endswith(" m"):
                assert not any(box.padded(-2.0).contains(*point) for point in along), word
    assert any(word.endswith(" m") for word, _ in boxes)
    assert sum(word.isdigit() for word, _ in boxes) >= 4


def test_snapshots_have_equal_scales_and_show_both_configurations():
    figure = checked(unfolding(square_net(cells=2, strings=True), times=11))["snapshots"]
    assert [ax.get_title(loc="left") for ax in figure.axes] == [
        f"$t$ = {t} s" for t in ("0", "0.2", "0.4", "0.6", "0.8", "1")
    ]
    for ax in figure.axes:
        box, (x0, x1), (y0, y1) = ax.get_window_extent(), ax.get_xlim(), ax.get_ylim()
        assert box.width / (x1 - x0) == pytest.approx(box.height / (y1 - y0), rel=1e-6)
        assert (
            len([c for c in ax.collections if isinstance(c, LineCollection)]) == 4
        )  # cables and strings of each


def test_motion_out_of_the_plane_adds_a_side_view():
    assert len(checked(THROWN)["snapshots"].axes) == 12  # six front views and six side views
    assert {ax.get_xlabel() for ax in checked(THROWN)["snapshots"].axes} == {"", "$x$ [m]", "$z$ [m]"}


def test_snapshots_are_spread_over_the_stored_times():
    assert snapshot_indices(np.linspace(0, 2, 401), 6) == [0, 80, 160, 240, 320, 400]
    assert snapshot_indices(np.array([0.0]), 6) == [0]
    assert snapshot_indices(np.array([0.0, 1.9, 2.0]), 6) == [0, 1, 2]


def test_incomplete_result_is_named_so_on_every_figure():
    stopped = replace(THROWN, complete=False, verdict="speed 1e9 m/s at node 3")
    for name, figure in checked(stopped, agreement_with(stopped)).items():
        assert "INCOMPLETE: speed 1e9 m/s at node 3" in texts(figure), name
    assert "INCOMPLETE" not in texts(checked(THROWN)["energies"])


def test_long_verdicts_are_cut():
    assert shortened("a\n b", 10) == "a b"
    assert shortened("x" * 20, 10) == "xxxxxxx..."
    assert shortened("λ 中", 10) == "λ ?"  # Greek is in matplotlib's font, Chinese is not


@pytest.mark.slow
def test_files_are_written_whole_and_alike(tmp_path):
    first = save_figures(THROWN, tmp_path / "new" / "folder")
    assert [p.name for p in first] == [
        f"{n}.png"
        for n in (
            "reference_net",
            "snapshots",
            "bullet_speeds",
            "energies",
            "area",
            "tensions",
            "largest_tension",
        )
    ]
    assert sorted(p.name for p in (tmp_path / "new" / "folder").iterdir()) == sorted(p.name for p in first)
    second = save_figures(THROWN, tmp_path / "again")
    for a, b in zip(first, second, strict=True):
        assert a.read_bytes().startswith(b"\x89PNG")
        assert a.read_bytes() == b.read_bytes()


def test_folder_that_cannot_be_made(tmp_path):
    (tmp_path / "file").touch()
    for folder in (tmp_path / "file", tmp_path / "file" / "below"):
        with pytest.raises(InputError, match="cannot be written"):
            save_figures(THROWN, folder)


@pytest.mark.slow
def test_users_matplotlib_settings_are_neither_used_nor_changed(tmp_path):
    usual = save_figures(unfolding(LINE), tmp_path / "a")[0].read_bytes()
    with matplotlib.rc_context({"font.size": 30, "axes.grid": True}):
        before = dict(matplotlib.rcParams)
        assert save_figures(unfolding(LINE), tmp_path / "b")[0].read_bytes() == usual
        assert dict(matplotlib.rcParams) == before


def test_a_big_net_is_drawn_in_bundles_of_elements(tmp_path):
    """20 x 20 cells, 844 elements: a stroke for each would make nets of 20 000 elements slow to draw."""
    of = unfolding(square_net(cells=20, size=5.0, strings=True), times=6, lift=0.1)
    for axes in checked(of)["snapshots"].axes:
        strokes = [len(c.get_segments()) for c in axes.collections if isinstance(c, LineCollection)]
        assert len(axes.get_lines()) == 0
        assert len(strokes) == 4  # cables and strings of the reference and of the state
        assert sum(strokes) <= 844 / 20


def test_long_curves_are_thinned_without_losing_an_extreme():
    """100 000 points with two lone spikes, one of them inside a span of time of 50 points, and a gap."""
    time = np.linspace(0.0, 3.0, 100_001)
    values = np.sin(time)
    values[77_321], values[12], values[5_000:5_400] = 9.0, -9.0, np.nan
    thin_time, thin = thinned(time, values)
    assert len(thin) <= 4 * BINS
    assert (thin_time[0], thin_time[-1]) == (0.0, 3.0)
    assert np.all(np.diff(thin_time) > 0)
    assert thin_time[np.nanargmax(thin)] == time[77_321]
    assert thin_time[np.nanargmin(thin)] == time[12]
    assert np.isnan(thin).any()
    # Within a span of 1.5 ms a sine changes by as much at most: no more than that is lost anywhere.
    there = np.interp(time, thin_time[~np.isnan(thin)], np.sin(thin_time[~np.isnan(thin)]))
    assert np.abs(there - np.sin(time)).max() < 1.5e-3


def test_long_bands_cover_what_they_covered():
    time = np.linspace(0.0, 1.0, 50_001)
    lower, upper = np.sin(9 * time), np.sin(9 * time) + 0.1
    upper[30_007] = 7.0
    ends, low, high = thinned_band(time, lower, upper)
    assert len(ends) <= BINS
    assert (ends[-1], high.max(), low.min()) == (1.0, 7.0, lower.min())
    assert np.all(np.diff(ends) > 0)


def test_short_curves_are_drawn_as_they_are():
    time = np.linspace(0.0, 1.0, 4 * BINS)
    assert thinned(time, time)[1] is time
    assert thinned_band(time, time, time)[2] is time


def test_figures_of_a_long_run_are_drawn_without_warnings():
    of = unfolding(square_net(strings=True), times=9_001, largest_elastic=np.ones(9_001))
    made = checked(of, agreement_with(of))
    drawn = curves(made["bullet_speeds"])
    speeds = metrics.bullet_speeds(of)
    for k, node in enumerate(of.net.bullet_nodes):
        curve = drawn[f"node {node}"].get_ydata()
        assert len(curve) <= 4 * BINS
        assert (curve.min(), curve.max()) == (speeds[:, k].min(), speeds[:, k].max())


def test_rotation_is_drawn_for_rigid_bodies():
    """A point mass has none; of two rigid bodies each component of both is a curve."""
    turning = np.linspace(0.0, 1.0, 21).reshape(7, 3)
    still, upright = np.zeros((7, 3)), np.tile([1.0, 0.0, 0.0, 0.0], (7, 1))
    rigid = BodyStates(2.0, np.eye(3), still, still, upright, turning)
    alone = replace(THROWN, bodies={"chaser": BodyStates(500.0, None, still, still)})
    assert "rotation" not in checked(alone)
    drawn = curves(checked(replace(THROWN, bodies={"a": rigid, "b": rigid}))["rotation"])
    assert list(drawn) == [f"{name}, {axis}" for name in "ab" for axis in "xyz"]
    np.testing.assert_array_equal(drawn["b, y"].get_ydata(), turning[:, 1])


@pytest.mark.slow
def test_snapshots_show_the_bodies_where_they_are(tmp_path):
    case = exunet.load(
        Path(__file__).parents[1] / "cases" / "verification" / "snap.toml",
        [
            "engine.backend=compiled",
            "bodies.target={mass=7.0, inertia=[2, 3, 4], position=[0.2, 0.3, 0], velocity=[1, 0, 0]}",
        ],
    )
    result = exunet.run(case)
    axes = figures(result)["snapshots"].axes[-1]
    (mark,) = [line for line in axes.lines if line.get_marker() == "D"]
    np.testing.assert_allclose(
        [*mark.get_xdata(), *mark.get_ydata()], [0.2 + result.time[-1], 0.3], rtol=1e-12
    )
    assert "target" in texts(figures(result)["snapshots"])
