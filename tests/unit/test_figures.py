"""Figures: their numbers, what they apply to, files, errors; no text lies over another."""

from __future__ import annotations

import itertools
import os
import re
import subprocess
import sys
import warnings
from collections.abc import Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from result_samples import net, result, square_net, unfolding
from scenes import CASES as SCENES
from typer.testing import CliRunner

import exunet
from exunet.base.errors import FigureError, InputError
from exunet.cli.main import app
from exunet.net.arrays import Tether
from exunet.plots import registry
from exunet.plots.ensembles import MAX_PANELS
from exunet.plots.nets import evenly_spaced
from exunet.plots.registry import FIGURES, figure, save_figures
from exunet.plots.style import MAX_CURVES, curve_styles, drawing
from exunet.plots.tensions import tension_colors
from exunet.plots.time_axes import BINS, rows_with_extremes
from exunet.results import measures as metrics
from exunet.results.comparison import Agreement
from exunet.results.ensemble import LEVELS, Ensemble, Member, ensemble_of, member_of
from exunet.results.metrics import Metric
from exunet.results.result import BodyStates, Result, TermStates
from exunet.results.time_series import TimeSeries
from exunet.verification import figures as verification

NEAREST = 9.0  # CIE L*, 0 black to 100 white: of neighbouring greys that remain distinct in print
CUBE = np.array(
    [[a, b] for a, b in itertools.product(itertools.product((-0.5, 0.5), repeat=3), repeat=2)], float
)
CUBE = CUBE[np.isclose(np.abs(CUBE[:, 0] - CUBE[:, 1]).sum(axis=1), 1.0)]  # its twelve edges, each twice


def lightness(color: Any) -> float:
    """CIE L* of a colour, as a grey print shows it."""
    rgb = np.array(to_rgb(color))
    linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    y = float(linear @ (0.2126, 0.7152, 0.0722))
    return 116 * y ** (1 / 3) - 16 if y > 0.008856 else 903.3 * y


def drawn(made: Figure) -> Figure:
    """Lay out and draw a figure; warnings are errors."""
    with drawing(), warnings.catch_warnings():
        warnings.simplefilter("error")
        FigureCanvasAgg(made).draw()
    return made


def labelled_lines(made: Figure) -> list[Any]:
    return [line for axes in made.axes for line in axes.get_lines() if not line.get_label().startswith("_")]


def curves(made: Figure) -> dict[str, Any]:
    return {str(line.get_label()): line for line in made.axes[0].get_lines()}


def labels(made: Figure) -> list[str]:
    return [text.get_text() for legend in made.legends for text in legend.get_texts()]


def texts(made: Figure) -> str:
    return " ".join(text.get_text() for text in made.findobj(matplotlib.text.Text))


def figures(of: Result, **options: Any) -> dict[str, Figure]:
    """All figures that apply to a result."""
    table, arguments = registry._prepare(
        of, options.get("agreement"), options.get("ensemble"), options.get("width", 170.0)
    )
    made = {name: registry._draw(one, arguments) for name, one in table.items()}
    return {name: drawn(one) for name, one in made.items() if one is not None}


def agreement_with(of: Result, until: float | None = 0.5, factor: float = 1.0) -> Agreement:
    difference = factor * np.geomspace(1e-12, 1, len(of.time))
    return Agreement(of.time, difference, difference, 0.025, 1e-4, until, until, metrics.bullet_speeds(of))


def body(start: Any, velocity: Any, shape: Any = CUBE, nodes: Any = None) -> BodyStates:
    """A cube of 1 m, or a rigid body without a shape, that flies straight on for 1 s."""
    position = np.array(start) + np.linspace(0, 1, 7)[:, None] * np.array(velocity)
    upright, still = np.tile([1.0, 0, 0, 0], (7, 1)), np.zeros((7, 3))
    flying = np.broadcast_to(np.array(velocity, float), (7, 3))
    return BodyStates(5.0, np.eye(3), position, flying, upright, still, wireframe=shape, nodes=nodes)


def towed(bodies: int = 2) -> Result:
    """A tether of four elements of 2 m between bodies 9 m apart, and a lone node beside; no net."""
    along = [(0.0, 0.0, -2.0 * k) for k in range(5)]
    of = replace(
        net([(0, 5, 0), *along], [(k, k + 1) for k in range(1, 5)]),
        tethers=(Tether("tow", 1, (1, 2, 3, 4, 5)),),
    )
    places = np.array([(0, 5, 0), *((0, 0.1 * k, 0.5 + 2.0 * k) for k in range(5))])
    moved = places + np.linspace(0, 1, 7)[:, None, None] * np.array([0, 0, 0.3])
    names = ("chaser", "target", *(f"body_{k}" for k in range(2, bodies)))
    flying = {name: body((0, 0.2 * k, 9.0 * k), (0, 0, 0.3)) for k, name in enumerate(names[:bodies])}
    tension = np.outer(np.linspace(0, 1, 7), [1.0, 4.0, 2.0, 0.0])
    return replace(result(of, np.linspace(0, 1, 7), moved), bodies=flying, tension=tension)


def tension_of(of: Result) -> np.ndarray:
    return np.abs(np.sin(np.arange(of.tension.size))).reshape(of.tension.shape)


THROWN = unfolding(square_net(cells=3, strings=True), lift=0.2)
TURNING = np.linspace(0.0, 1.0, 21).reshape(7, 3)
RIGID = BodyStates(2.0, np.eye(3), TURNING, TURNING, np.tile([1.0, 0, 0, 0], (7, 1)), TURNING)
FULL = replace(
    THROWN,
    bodies={"target": RIGID},
    tension=tension_of(THROWN),
    potential=-np.linspace(0.0, 9.0, 7),
    largest_elastic=THROWN.elastic + 1.0,
    least_kinetic=0.5 * THROWN.kinetic,
)
OF_FULL = {"reference_net", "snapshots", "bullet_speeds", "energies", "area", "tensions", "largest_tension"}
OF_FULL |= {"momentum", "rotation"}
THREAD = net([(0, 0, 0), (1, 0, 0)], [(0, 1)])
HANGING = net([(0, 0, 0), (1, 0, 0.5), (2, 0, 0)], [(0, 1), (1, 2)])
MANY = net(
    [(np.cos(a), np.sin(a), 0) for a in range(30)],
    [(k, (k + 1) % 30) for k in range(30)],
    bullets=tuple(range(30)),
)
NET = {"reference_net", "snapshots"}
MOVING = {"bullet_speeds", "area"}
AWAY = np.linspace(0, 50, 7)[:, None, None]  # m
BLOWN = np.geomspace(1, 1e25, 7)[:, None, None]
STILL = result(square_net(), [0, 1], [square_net().reference_position] * 2)
CASES = {
    "thrown": (THROWN, NET | MOVING),
    "full": (FULL, OF_FULL),
    "planar": (unfolding(square_net(cells=2, strings=True)), NET | MOVING),
    "single time": (unfolding(square_net(strings=True), times=1), NET | MOVING),
    "no bullets, no mouth": (unfolding(THREAD), NET),
    "in the x-z plane": (unfolding(HANGING), NET),
    "many bullets": (unfolding(MANY), NET | {"bullet_speeds"}),
    "at rest": (STILL, NET | {"area"}),
    "one node": (result(net([(0, 0, 0)], [], bullets=(0,)), [0, 1], np.zeros((2, 1, 3))), {"snapshots"}),
    "far away": (replace(THROWN, position=THROWN.position + AWAY), NET | MOVING),
    "blown up": (
        replace(THROWN, position=BLOWN * THROWN.position, complete=False, verdict="?"),
        NET | MOVING,
    ),
    "falling": (replace(unfolding(THREAD), potential=-np.linspace(0, 9, 7)), NET),
    "long verdict": (replace(THROWN, complete=False, verdict="$5_^{ \n" + 50 * "more "), NET | MOVING),
}


def ends_drawn(axes: Any) -> np.ndarray:
    """(k, 2) end points of the elements that are drawn, in order; a bundle of them has NaN in between."""
    lines = [line for c in axes.collections if isinstance(c, LineCollection) for line in c.get_segments()]
    points = np.concatenate([np.empty((0, 2)), *lines])
    return points[np.isfinite(points).all(axis=1)]


def ends_of(of: Any, position: np.ndarray, plane: list[int]) -> np.ndarray:
    """The same of a configuration (n_nodes, 3): strings come last, and nothing is drawn beyond 1000 sizes."""
    ends = np.concatenate([of.element_nodes[~of.is_string], of.element_nodes[of.is_string]])
    farthest = 1e3 * (np.ptp(of.reference_position, axis=0).max() or 1.0)
    return np.clip(position[ends][..., plane].reshape(-1, 2), -farthest, farthest)


@pytest.mark.ci_for("full")
@pytest.mark.slow_for("full")
@pytest.mark.parametrize("name", CASES)
def test_figures_that_apply_show_the_numbers_of_the_result(name: str) -> None:
    """Nets where their states are, within the axes; changes of the energies, error of their balance."""
    of, expected = CASES[name]
    if any(np.ptp(energy) for energy in (of.kinetic, of.elastic, of.potential)):
        expected = expected | {"energies"}
    if np.any(of.tension):
        expected = expected | {"tensions", "largest_tension"}
    made = figures(of)
    assert set(made) == expected
    for item in made.values():
        assert ("INCOMPLETE" in texts(item)) != of.complete
        for axes in item.axes:
            limits = np.array([axes.get_xlim(), axes.get_ylim()])
            assert np.isfinite(limits).all()
            assert np.diff(limits).min() > 0.0
    plane = [0, 2 if name == "in the x-z plane" else 1]
    whole = ends_of(of.net, of.net.reference_position, plane)
    if of.net.n_elements:
        np.testing.assert_array_equal(ends_drawn(made["reference_net"].axes[0]), whole)
    panels = [axes for axes in made["snapshots"].axes if axes.get_title(loc="left")]
    for axes, k in zip(panels, evenly_spaced(of.time, 6), strict=True):
        follows = name in ("far away", "blown up")  # by more than half of the net's size
        state = of.position[k] - (metrics.centre_of_mass(of)[k] if follows else 0.0)
        points = ends_drawn(axes)
        np.testing.assert_allclose(points[len(whole) :], ends_of(of.net, state, plane), rtol=0, atol=1e-12)
        if name != "blown up" and len(points):
            assert (axes.get_xlim()[0] < points[:, 0].min()) & (points[:, 0].max() < axes.get_xlim()[1])
            assert (axes.get_ylim()[0] < points[:, 1].min()) & (points[:, 1].max() < axes.get_ylim()[1])
    if "energies" in made:
        parts = {"kinetic": of.kinetic, "elastic": of.elastic, "dissipated": of.dissipated}
        if np.any(of.potential):
            parts["potential"] = of.potential
        curve = curves(made["energies"])
        for label, values in parts.items():
            np.testing.assert_allclose(curve[label].get_ydata(), values - values[0], rtol=1e-15)
        errors = sum(values - values[0] for values in parts.values())
        balance = made["energies"].axes[1]
        np.testing.assert_allclose(balance.get_lines()[0].get_ydata(), errors, rtol=1e-12, atol=1e-15)
        assert balance.get_ylim()[0] == -balance.get_ylim()[1]


def boxes_of(made: Figure) -> list[tuple[str, Any]]:
    """Extents of the texts of a figure, its legends and its axes; ticks within the limits."""
    found = [*made.texts, *(text for legend in made.legends for text in legend.get_texts())]
    for parent in made.axes:
        for axes in (parent, *parent.child_axes):
            found += [*axes.texts, axes.title, axes._left_title, axes.xaxis.label, axes.yaxis.label]
            for axis in (axes.xaxis, axes.yaxis):
                found.append(axis.get_offset_text())
                low, high = sorted(axis.get_view_interval())
                for tick in axis.get_major_ticks():
                    if low <= tick.get_loc() <= high and axis.get_visible():
                        found += [label for label in (tick.label1, tick.label2) if label.get_visible()]
    shown = [text for text in found if text.get_visible() and text.get_text().strip()]
    return [(text.get_text(), text.get_window_extent()) for text in shown if text.get_rotation() % 90 == 0]


@pytest.mark.ci_for("of0-170.0")
@pytest.mark.slow
@pytest.mark.parametrize("width", [85.0, 170.0])
@pytest.mark.parametrize("of", [FULL, towed(), replace(FULL, complete=False, verdict="speed 1e9 m/s")])
def test_no_text_lies_over_another_or_over_curves(of: Result, width: float) -> None:
    for name, made in figures(of, agreement=agreement_with(of), width=width).items():
        boxes = boxes_of(made)
        for (one, a), (other, b) in itertools.combinations(boxes, 2):
            assert not a.padded(-1.0).overlaps(b.padded(-1.0)), (name, one, other)
        for text, box in boxes:
            assert min(box.x0, box.y0, made.bbox.x1 - box.x1, made.bbox.y1 - box.y1) > -1.0, (name, text)
        for legend, axes in itertools.product(made.legends, made.axes):
            assert not legend.get_window_extent().padded(-1.0).overlaps(axes.get_window_extent()), name
        for axes in made.axes:
            for label in (axes.get_xlabel(), axes.get_ylabel()):
                assert not label or label.endswith("]"), (name, label)


def test_zeros_alone_are_not_drawn() -> None:
    still = {"a": replace(RIGID, angular_velocity=np.zeros((7, 3)), velocity=np.zeros((7, 3)))}
    states = {
        f"contact_a/threads_{what}": TermStates("1", np.zeros((7, 1))) for what in ("touching", "force")
    }
    states |= {
        "control/spent": TermStates("1", np.zeros((7, 4))),
        "control/work": TermStates("1", np.zeros((7, 1))),
    }
    rest = unfolding(
        square_net(), bodies=still, states=states, provenance={"control": {"bullets": [0, 1, 2]}}
    )
    rest = replace(rest, velocity=0.0 * rest.velocity)
    assert not set(figures(rest)) & {
        "contacts",
        "control",
        "rotation",
        "tensions",
        "largest_tension",
        "loads",
    }


@pytest.mark.slow
def test_agreement_shows_limits_horizon_and_the_other_speeds() -> None:
    made = figures(THROWN, agreement=agreement_with(THROWN))
    position, speed = made["agreement"].axes
    assert {position.get_yscale(), speed.get_yscale()} == {"log"}
    assert [axes.get_lines()[1].get_ydata()[0] for axes in (position, speed)] == [1e-4, 0.025]
    assert position.get_lines()[2].get_xdata()[0] == 0.5
    assert "reference" in curves(made["bullet_speeds"])
    speeds_alone = replace(agreement_with(THROWN, until=None), position_difference=np.zeros(7))
    assert "agreement" in figures(THROWN, agreement=speeds_alone)
    assert "agreement" not in figures(THROWN, agreement=agreement_with(THROWN, until=None, factor=0.0))


def test_bands_reach_to_the_extremes_between_stored_times() -> None:
    """Of an energy that grows evenly the smallest of an interval is at its start: nothing is beyond."""
    peak = THROWN.elastic + 0.25 * THROWN.kinetic[0]
    axes = figures(replace(THROWN, largest_elastic=peak, least_kinetic=0.5 * THROWN.kinetic))[
        "energies"
    ].axes[0]
    ends = np.concatenate([path.vertices[:, 1] for band in axes.collections for path in band.get_paths()])
    assert ends.min() == pytest.approx((0.5 * THROWN.kinetic).min() - THROWN.kinetic[0])
    assert ends.max() == pytest.approx(peak.max() - THROWN.elastic[0])
    growing = 1.0 + THROWN.time
    of = replace(THROWN, kinetic=growing, least_kinetic=np.append(growing[:1], growing[:-1]))
    assert not figure(of, "energies").axes[0].collections


@pytest.mark.parametrize("number", [2, 4, 6])
def test_each_source_of_work_has_a_curve(number: int) -> None:
    """Bodies of prescribed motion put in 1, 2 ... J, an ejection 3.5 J: those beyond four are summed."""
    still, upright = np.zeros((7, 3)), np.tile([1.0, 0.0, 0.0, 0.0], (7, 1))
    works = {f"hand{k}": np.linspace(0.0, k, 7) for k in range(1, number)}
    ejected = 3.5 * (np.arange(7) >= 2)
    event = {"time_s": float(THROWN.time[2]), "energy_lost_J": -3.5}
    of = replace(
        THROWN,
        kinetic=5.0 + sum(works.values()) + ejected,
        elastic=np.zeros(7),
        dissipated=-sum(works.values()) - ejected,
        bodies={name: BodyStates(2.0, np.eye(3), still, still, upright, still) for name in works},
        states={f"{name}/work": TermStates("J", work[:, None]) for name, work in works.items()},
        provenance={**THROWN.provenance, "ejection": [event]},
    )
    made = figure(of, "energies")
    shown = {name: line for name, line in curves(made).items() if name.startswith("work")}
    assert len(shown) == min(number, 4)
    np.testing.assert_allclose(shown["work of ejection"].get_ydata(), ejected)
    np.testing.assert_allclose(
        np.sum([line.get_ydata() for line in shown.values()], axis=0), sum(works.values()) + ejected
    )
    np.testing.assert_allclose(curves(made)["dissipated"].get_ydata(), 0.0, atol=1e-14)
    np.testing.assert_allclose(made.axes[1].get_lines()[0].get_ydata(), 0.0, atol=1e-14)


def test_speeds_and_areas() -> None:
    made = figures(THROWN)
    speeds = curves(made["bullet_speeds"])["node 16"].get_ydata()
    np.testing.assert_array_equal(speeds, metrics.bullet_speeds(THROWN)[:, 0])
    mouth = curves(made["area"])["mouth / achievable area (1 m²)"].get_ydata()
    assert mouth[0] == pytest.approx(0.01)  # a tenth of the size, squared


def test_tensions_are_drawn_by_grey_and_by_width() -> None:
    """The larger, the darker and the broader; elements without tension are apart."""
    shades = [lightness(color) for color in tension_colors()(np.linspace(0, 1, 32))]
    assert np.all(np.diff(shades) < 0)
    assert (shades[0] < 90) & (shades[0] - shades[-1] > 60)
    peaks = np.arange(THROWN.net.n_elements, dtype=float)
    of = replace(FULL, provenance=FULL.provenance | {"peak_tensions_N": peaks.tolist()})
    axes, bar = figure(of, "tensions").axes
    slack, taut = (collection for collection in axes.collections if isinstance(collection, LineCollection))
    assert len(slack.get_segments()) == 1
    np.testing.assert_array_equal(taut.get_array(), peaks[1:])
    assert np.all(np.diff(taut.get_linewidths()) > 0)
    first = of.net.reference_position[of.net.element_nodes[1], :2]
    np.testing.assert_array_equal(taut.get_segments()[0], first)
    assert bar.get_ylim() == (0.0, peaks.max())
    assert "all steps" in bar.get_ylabel()
    assert "stored times" in figure(FULL, "tensions").axes[1].get_ylabel()


def test_history_of_the_largest_tension_and_its_mark() -> None:
    peak = {"tension_N": 7.0, "time_s": 0.37, "element": 4}
    of = replace(FULL, provenance=FULL.provenance | {"largest_tension": peak})
    curve, mark = labelled_lines(figure(of, "largest_tension"))[:2]
    np.testing.assert_array_equal(curve.get_ydata(), FULL.tension.max(axis=1))
    assert (mark.get_xdata()[0], mark.get_ydata()[0]) == (0.37, 7.0)


@pytest.mark.ci
def test_tensions_along_tethers() -> None:
    """Steps over the unstretched length, and both ends named; the net's figure leaves tethers out."""
    of = towed()
    made = figure(of, "tethers")
    line = made.axes[0].get_lines()[0]
    np.testing.assert_allclose(line.get_xdata(), [0, 2, 4, 6, 8])
    np.testing.assert_allclose(line.get_ydata(), [1, 4, 2, 0, 0])
    assert labels(made) == ["tow, from node 1 to node 5"]
    held = {
        "chaser": replace(of.bodies["chaser"], nodes=np.array([1])),
        "target": replace(of.bodies["target"], nodes=np.array([5])),
    }
    assert labels(figure(replace(of, bodies=held), "tethers")) == ["tow, from chaser to target"]
    with pytest.raises(InputError, match="requires"):
        figure(of, "tensions")


def test_rotations_are_those_of_the_four_fastest_bodies() -> None:
    of = towed(6)
    rotating = {
        name: replace(one, angular_velocity=np.full((7, 3), 0.1 * k))
        for k, (name, one) in enumerate(of.bodies.items())
    }
    lines = labelled_lines(figure(replace(of, bodies=rotating), "rotation"))
    assert [line.get_label() for line in lines] == [
        f"body_{k}, {axis}" for k in (2, 3, 4, 5) for axis in "xyz"
    ]
    assert len({(line.get_color(), line.get_linestyle()) for line in lines}) == 12
    np.testing.assert_allclose(lines[0].get_ydata(), 0.2)


def test_bodies_in_snapshots() -> None:
    """A mark each, open on a shape, at the centre of mass; far bodies are inside the limits."""
    assert labels(figure(towed(), "snapshots")) == ["tether", "free node", "chaser", "target"]
    assert labels(figure(towed(9), "snapshots"))[-1] == "9 bodies"
    made = figure(towed(4), "snapshots")
    marks = [line for line in made.axes[0].get_lines() if line.get_marker() in "Ds^v"]
    assert len({line.get_marker() for line in marks}) == 4
    assert {line.get_markerfacecolor() for line in marks} == {"none"}
    side = next(line for line in made.axes[1].get_lines() if line.get_marker() == "s")  # at the start
    np.testing.assert_allclose([*side.get_xdata(), *side.get_ydata()], [9.0, 0.2])
    far = replace(unfolding(square_net(size=2.0)), bodies={"target": body((0, 30, 0), (0, 5, 0))})
    for axes in figure(far, "snapshots").axes:
        assert axes.get_ylim()[0] < axes.get_lines()[-1].get_ydata()[0] < axes.get_ylim()[1]


def test_snapshots_have_equal_scales_and_a_side_view_out_of_the_plane() -> None:
    made = drawn(figure(THROWN, "snapshots"))
    assert len(made.axes) == 12  # six front views and six side views
    assert len(figure(THROWN, "snapshots", width=85).axes) == 8
    for axes in made.axes:
        box, (x0, x1), (y0, y1) = axes.get_window_extent(), axes.get_xlim(), axes.get_ylim()
        assert box.width / (x1 - x0) == pytest.approx(box.height / (y1 - y0), rel=1e-6)
    assert evenly_spaced(np.linspace(0, 2, 401), 6) == [0, 80, 160, 240, 320, 400]
    assert evenly_spaced(np.array([0.0, 1.9, 2.0]), 6) == [0, 1, 2]


def test_a_large_net_is_drawn_in_bundles_of_elements() -> None:
    """20 x 20 cells, 844 elements: a stroke for each would make nets of 20 000 elements slow to draw."""
    of = unfolding(square_net(cells=20, size=5.0, strings=True), times=6, lift=0.1)
    for axes in figure(of, "snapshots").axes:
        strokes = [len(c.get_segments()) for c in axes.collections if isinstance(c, LineCollection)]
        assert sum(strokes) <= 844 / 20


def test_long_curves_are_thinned_without_losing_an_extreme() -> None:
    """100 000 points with two lone spikes, one of them inside an interval of 50 points, and a gap."""
    time = np.linspace(0.0, 3.0, 100_001)
    values = np.sin(time)
    values[77_321], values[12], values[5_000:5_400] = 9.0, -9.0, np.nan
    rows = rows_with_extremes(time, values)
    assert len(rows) <= 4 * BINS
    assert {0, 12, 77_321, 100_000} <= set(rows.tolist())
    assert np.isnan(values[rows]).any()
    assert len(rows_with_extremes(time[: 4 * BINS], time[: 4 * BINS])) == 4 * BINS
    of = unfolding(square_net(strings=True), times=9_001, largest_elastic=np.ones(9_001))
    line = curves(figure(of, "bullet_speeds"))[f"node {of.net.bullet_nodes[0]}"].get_ydata()
    speeds = metrics.bullet_speeds(of)[:, 0]
    assert len(line) <= 4 * BINS
    assert (line.min(), line.max()) == (speeds.min(), speeds.max())


@pytest.mark.parametrize("count", range(2, MAX_CURVES + 1))
def test_styles_differ_in_grey(count: int) -> None:
    styles = curve_styles(count)
    grey = [lightness(style["color"]) for style in styles]
    assert max(grey) < 90  # on white paper
    assert min(abs(a - b) for a, b in itertools.combinations(grey, 2)) >= NEAREST
    assert len({(str(style["linestyle"]), style["marker"]) for style in styles}) == count


@pytest.mark.parametrize("width", [85, 170])
def test_events_of_a_script_are_lines_with_names_above(width: float) -> None:
    """Six entries, one of them twice; names of entries that are nearer than a text is high are joined."""
    times = {"first": 0.300, "second": 0.304, "third": 0.308, "last": 0.9}
    entries = [f'{{name="{name}", at={time}, do="note"}}' for name, time in times.items()]
    entries.append('{name="often", when="time > 0.1", repeat=true, do="note"}')
    case = exunet.load(SCENES / "planar_undamped.toml", ["time.end=1.0", f"script=[{', '.join(entries)}]"])
    top = figure(exunet.run(case), "energies", width=width).axes[0]
    (above,) = top.child_axes
    assert [text.get_text() for text in above.get_xticklabels()] == ["often", "first, second, third", "last"]
    np.testing.assert_allclose(above.get_xticks(), [0.1, 0.3, 0.9], atol=2e-3)
    lines = [line.get_xdata()[0] for line in top.get_lines() if len(set(line.get_xdata())) == 1]
    assert {0.3, 0.304, 0.308, 0.9} <= {round(time, 6) for time in lines}


@pytest.mark.slow
def test_files_are_written_whole_and_alike(tmp_path: Path) -> None:
    """Of the widths of a column and of a page at 300 dots per inch; in notebooks too; the same bytes."""
    paths = save_figures(FULL, tmp_path / "new" / "folder")
    assert {path.stem for path in paths} == OF_FULL
    assert sorted(path.name for path in (tmp_path / "new" / "folder").iterdir()) == sorted(
        p.name for p in paths
    )
    names = ["area", "snapshots"]
    for width in (85, 170):
        for path in save_figures(FULL, tmp_path / str(width), names=names, width=width):
            data = path.read_bytes()
            assert data.startswith(b"\x89PNG")
            assert int.from_bytes(data[16:20], "big") * 25.4 / 300 == pytest.approx(width, abs=0.1)
            assert (width == 85) or data == (tmp_path / "new" / "folder" / path.name).read_bytes()
    assert figure(FULL, "area")._repr_png_().startswith(b"\x89PNG")


@pytest.mark.slow
def test_figures_are_saved_in_several_threads(tmp_path: Path) -> None:
    """Four at a time, with the bytes of one alone."""
    with ThreadPoolExecutor(4) as pool:
        saved = list(pool.map(lambda k: save_figures(FULL, tmp_path / str(k), names=["area"]), range(4)))
    assert len({paths[0].read_bytes() for paths in saved}) == 1


def test_text_remains_text_and_bytes_do_not_depend_on_the_process(tmp_path: Path) -> None:
    exunet.save(FULL, tmp_path / "result.h5")
    program = "import sys, exunet; r = exunet.load_result(sys.argv[1])\n" + "\n".join(
        f"exunet.save_figures(r, sys.argv[2], format={kind!r}, width=85, names=['energies', 'tensions'])"
        for kind in ("pdf", "svg")
    )
    for seed in ("1", "2"):
        command = [sys.executable, "-c", program, str(tmp_path / "result.h5"), str(tmp_path / seed)]
        environment = os.environ | {"PYTHONHASHSEED": seed, "SOURCE_DATE_EPOCH": f"{seed}00000000"}
        subprocess.run(command, capture_output=True, text=True, check=True, env=environment)
    files = sorted((tmp_path / "1").iterdir())
    assert len(files) == 4
    for path in files:
        assert path.read_bytes() == (tmp_path / "2" / path.name).read_bytes(), path.name
    pdf = (tmp_path / "1" / "energies.pdf").read_bytes()
    assert b"/FontFile2" in pdf
    assert b"CreationDate" not in pdf
    svg = (tmp_path / "1" / "energies.svg").read_text(encoding="utf-8")
    assert ">energy change [J]</text>" in svg
    assert "<dc:date>" not in svg


def test_users_matplotlib_settings_are_neither_used_nor_changed(tmp_path: Path) -> None:
    usual = save_figures(FULL, tmp_path / "a", names=["area"])[0].read_bytes()
    with matplotlib.rc_context({"font.size": 30, "axes.grid": True}):
        before = dict(matplotlib.rcParams)
        assert save_figures(FULL, tmp_path / "b", names=["area"])[0].read_bytes() == usual
        assert dict(matplotlib.rcParams) == before


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"name": "speeds"}, "'speeds' is not one of reference_net"),
        ({"name": "bands"}, "'bands' is not one of"),
        ({"name": "agreement"}, "'agreement' requires"),
        ({"name": "area", "width": 100}, "width: "),
    ],
)
def test_arguments_that_cannot_be_used(arguments: dict[str, Any], words: str) -> None:
    with pytest.raises(InputError, match=words):
        figure(FULL, **arguments)


@pytest.mark.parametrize("options", [{"format": "gif"}, {"width": 3}, {"names": ["speeds"]}])
def test_wrong_options_make_no_folder(tmp_path: Path, options: dict[str, Any]) -> None:
    with pytest.raises(InputError):
        save_figures(FULL, tmp_path / "new", **options)
    assert not (tmp_path / "new").exists()


def test_existing_files_are_replaced_only_on_request(tmp_path: Path) -> None:
    (tmp_path / "area.svg").write_text("of before")
    (tmp_path / "area.png").write_text("of before")
    with pytest.raises(InputError, match=r"area\.png"):
        save_figures(FULL, tmp_path)
    assert {path.read_text() for path in tmp_path.iterdir()} == {"of before"}
    for folder in (tmp_path / "area.png", tmp_path / "area.png" / "below"):
        with pytest.raises(InputError, match="cannot be written"):
            save_figures(FULL, folder)


@pytest.mark.slow
def test_a_figure_that_fails_does_not_prevent_the_others(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fails(_source: object) -> Figure:
        raise ValueError("no room")

    monkeypatch.setitem(FIGURES, "energies", FIGURES["energies"]._replace(draw=fails))
    with pytest.raises(FigureError, match="energies: no room"):
        save_figures(FULL, tmp_path)
    assert {path.stem for path in tmp_path.iterdir()} == OF_FULL - {"energies"}


@pytest.mark.slow
def test_the_command_draws_the_named_figures(tmp_path: Path) -> None:
    exunet.save(FULL, tmp_path / "result.h5")
    options = ["--format", "pdf", "--width", "85", "--out", str(tmp_path / "new")]
    command = ["plot", str(tmp_path / "result.h5"), *options, "--figure", "area", "--figure", "momentum"]
    assert CliRunner().invoke(app, command).exit_code == 0
    assert sorted(path.name for path in (tmp_path / "new").iterdir()) == ["area.pdf", "momentum.pdf"]
    (box,) = re.findall(rb"/MediaBox \[ 0 0 (\S+) ", (tmp_path / "new" / "area.pdf").read_bytes())
    assert float(box) * 25.4 / 72 == pytest.approx(85.0, abs=0.1)


def ensemble(more: int = 0) -> Ensemble:
    """Fifty runs, whose metrics differ by little or by much."""
    random = np.random.default_rng(1)
    values = {
        ("largest_tension", "N"): 53.99269938 + 1e-9 * random.normal(size=50),
        ("largest_area", "m2"): 4.2 + 0.3 * random.normal(size=50),
        ("distance", "m"): -18.677002 + 2e-7 * random.normal(size=50),
        ("bullet_speed_at_end", "m/s"): 3.0e-5 + 2e-6 * random.normal(size=50),
        ("time_of_least_distance", "s"): 0.987654321 + 1e-8 * random.normal(size=50),
    }
    values |= {(f"velocity {k}", "m/s"): 0.3 + 0.01 * random.normal(size=50) for k in range(more)}
    about = [Metric(name, name.replace("_", " "), unit, 0.0) for name, unit in values]
    curve = np.quantile(1.0 + random.random((50, 11)), LEVELS, axis=0)
    series = {name: TimeSeries(name, name, unit, np.zeros(0), general=True)
              for name, unit in (("area", "m2"), ("kinetic", "J"), ("tension", "N"))}  # fmt: skip
    return Ensemble(
        {metric.key: of_runs for metric, of_runs in zip(about, values.values(), strict=True)},
        {metric.key: metric for metric in about},
        np.linspace(0.0, 2.0, 11),
        np.array(LEVELS),
        {"area": curve, "kinetic": 1e-7 * curve, "tension": curve},
        series,
    )


@pytest.mark.ci_for("bands-170")
@pytest.mark.parametrize("width", [85, 170])
@pytest.mark.parametrize("name", ["histograms", "bands"])
def test_figures_of_an_ensemble(name: str, width: float) -> None:
    found = ensemble()
    made = drawn(exunet.figure(found, name, width=width))
    assert len(made.axes) == {"histograms": len(found.metrics), "bands": 3}[name]
    for (one, a), (other, b) in itertools.combinations(boxes_of(made), 2):
        assert not a.padded(-1.0).overlaps(b.padded(-1.0)), (one, other)
    middle = made.axes[0].get_lines()[0]
    if name == "histograms":
        assert middle.get_xdata()[0] == np.median(found.metrics["largest_tension_N"])
        assert sum(patch.get_height() for patch in made.axes[0].patches) == 50
    else:
        np.testing.assert_array_equal(middle.get_ydata(), found.quantiles["area"][3])


@pytest.mark.slow
@pytest.mark.parametrize("width", [85, 170])
def test_histograms_fit_on_a_page(width: float) -> None:
    made = drawn(exunet.figure(ensemble(20), "histograms", width=width))
    assert made.get_size_inches()[0] * 25.4 == pytest.approx(width)
    assert made.get_size_inches()[1] * 25.4 < 230.0
    assert len(made.axes) <= MAX_PANELS
    assert "largest area [m²]" in [axes.get_title(loc="left") for axes in made.axes]


# Bands of perturbed runs

CONTACTS = ("contact_box/threads", "contact_box/bullets")
LINE = ("tension_start", "tension_end", "way", "wound_up")


def shown(contacts: tuple[str, ...] = CONTACTS, bodies: int = 1, units: int = 2) -> Result:
    """A net that unfolds within 1 s beside bodies that turn, with a closing line and corner units."""
    rising = np.linspace(0.0, 1.0, 7)[:, None]
    names = ["box", *(f"body_{k}" for k in range(1, bodies))]
    spins = np.tile([0.1, 0.2, 0.3], (7, 1))
    turning = {item: replace(body((0, 0, 3), (0, 0, 0)), angular_velocity=spins) for item in names}
    turning["box"] = replace(turning["box"], nodes=np.array([0]), velocity=1e-3 * rising * [1.0, 0.0, 0.0])
    states = {f"{contact}_{what}": rising for contact in contacts for what in ("touching", "force")}
    states |= {f"closing/{entry}": rising for entry in LINE}
    states |= {"control/spent": rising * np.ones(units), "control/work": rising}
    stored = {name: TermStates("1", values) for name, values in states.items()}
    story = {"control": {"bullets": list(range(units))}}
    taut = np.full((7, 4), 1e-3)
    return unfolding(square_net(), bodies=turning, states=stored, provenance=story, tension=taut)


def bands_of(made: Figure) -> list[list[PolyCollection]]:
    """Of each pair of axes those that are drawn, not only named in the legend."""
    every = [
        [collection for collection in axes.collections if isinstance(collection, PolyCollection)]
        for axes in made.axes
    ]
    return [[item for item in own if item.get_paths()] for own in every]


def ends_at(band: PolyCollection, time: float) -> tuple[float, float]:
    """Least and largest of a band at one of its times."""
    at = [y for path in band.get_paths() for x, y in path.vertices if abs(x - time) < 1e-12]
    return min(at), max(at)


# Of each pair of axes: the quantities, and what is seen of them at their last time.
DRAWN: Mapping[str, tuple[tuple[str, ...], ...]] = {
    "contacts": (
        ("contact_box/threads_touching", "contact_box/bullets_touching"),
        ("contact_box/threads_force", "contact_box/bullets_force"),
    ),
    "closing": (("closing/tension_start",), ("closing/way", "closing/wound_up"), ("mouth",)),
    "loads": (("attachment_box_0/force",), ("attachment_box_0/torque",)),
    "rotation": (tuple(f"body_box/angular_velocity_{axis}" for axis in "xyz"),),
    "control": (("control/thrust_0", "control/thrust_1"),),
    "momentum": (
        ("momentum/box", "momentum/net"),
        ("angular_momentum/box", "angular_momentum/net"),
    ),
}


def perturbed(names: Iterable[str], *sizes: float) -> Ensemble:
    """Runs of sizes in which each quantity is its size times the time, to 2 s."""
    time = np.linspace(0.0, 2.0, 5)
    band = np.quantile(np.multiply.outer(sizes, time), LEVELS, axis=0)
    series = {name: TimeSeries(name, name, "", np.zeros(0)) for name in names}
    about = Metric("any", "any", "", 0.0)
    quantiles = dict.fromkeys(series, band)
    return Ensemble({"any": np.array(sizes)}, {"any": about}, time, np.array(LEVELS), quantiles, series)


@pytest.mark.parametrize("name", DRAWN)
def test_bands_reach_from_minimum_to_maximum(name: str) -> None:
    """Each in its axes, in the colour of its curve and within the limits; means stand between instants."""
    runs = perturbed([quantity for axes in DRAWN[name] for quantity in axes], 1.0, 2.0, 6.0)
    made = figure(shown(), name, ensemble=runs)
    last = 1.75 if name == "control" else 2.0  # the middle of the last interval
    assert len(made.axes) == len(DRAWN[name])
    for axes, quantities, own in zip(made.axes, DRAWN[name], bands_of(made), strict=True):
        assert len(own) == len(quantities)
        for quantity, band, line in zip(quantities, own, axes.get_lines(), strict=False):
            low, high = runs.band(quantity)
            assert ends_at(band, last) == pytest.approx((low[-1], high[-1])), quantity
            assert to_rgb(band.get_facecolor()[0]) == to_rgb(line.get_color()), quantity
            assert axes.get_ylim()[0] <= low.min()
            assert axes.get_ylim()[1] >= high.max()
    assert labels(made).count("range of 3 perturbed runs") == 1
    assert not any("along" in label for label in labels(made))
    assert bands_of(figure(shown(), name)) == [[]] * len(made.axes)


def test_many_curves_have_one_band() -> None:
    """Of five units and of nine angular velocities, from the minimum to the maximum of all."""
    spins = [f"body_{body}/angular_velocity_{axis}" for body in ("box", "body_1", "body_2") for axis in "xyz"]
    units = [f"control/thrust_{k}" for k in range(5)]
    runs, of = perturbed([*spins, *units], 1.0, 6.0), shown(bodies=3, units=5)
    runs.quantiles[spins[4]][-1] = 20.0  # type: ignore[index]
    runs = replace(runs, quantiles={**runs.quantiles, spins[4]: runs.quantiles[spins[4]] + 3.0})
    for name, last, ends in (("rotation", 2.0, (2.0, 23.0)), ("control", 1.75, (2.0, 20.0))):
        (band,) = bands_of(figure(of, name, ensemble=runs))[0]
        assert ends_at(band, last) == pytest.approx(ends), name
    once = {name: values[:, :1] for name, values in runs.quantiles.items()}
    at_once = replace(runs, time=np.zeros(1), quantiles=once)
    assert not any(bands_of(figure(shown(), "control", ensemble=at_once)))


def test_marks_have_their_range() -> None:
    """The largest area of 0.8 to 1.1 m2 of a mouth of 1 m2, and of one that is known."""
    time = np.array([0.0, 1.0])
    own = member_of(THROWN).metrics["largest_area_m2"]
    for values, words in (([0.8, 1.0, 1.1], "1.000 (0.800 to 1.100)"), ([1.0, 1.0, 1.0], "largest: 1")):
        members = [Member(time, {own.key: replace(own, value=value)}, {}, {}) for value in values]
        made = figure(THROWN, "area", ensemble=ensemble_of(members, provenance={}))
        assert any(words in label for label in labels(made)), labels(made)
    assert not any(re.search(r"largest[^;]*\d", label) for label in labels(figure(THROWN, "area")))


def test_momenta_are_along_the_direction_of_the_ensemble() -> None:
    runs = replace(perturbed([], 1.0), provenance={"momenta_along": {"linear": [0.0, 0.6, 0.8]}})
    made = figure(shown(), "momentum", ensemble=runs)
    assert "along (0, 0.6, 0.8)" in made.axes[0].get_ylabel()
    assert "along (1, 0, 0)" in figure(shown(), "momentum").axes[0].get_ylabel()
    lines = [line.get_ydata() for line in made.axes[0].get_lines()[:2]]
    np.testing.assert_allclose(lines[0], 0.0, atol=1e-15)  # the box moves along x


# Figures of the verification

TIME = np.linspace(0.0, 1.0, 5)


def test_zeros_do_not_stretch_the_scale_of_differences() -> None:
    with drawing():
        made = drawn(verification.curves("two codes", TIME, {"a": 1e-9 * TIME, "b": 0 * TIME}, {}))
    seen, nothing = labelled_lines(made)
    np.testing.assert_allclose(seen.get_ydata(), [np.nan, *(1e-9 * TIME[1:])])
    assert (nothing.get_ydata() > 0.0).all()  # which a logarithmic scale can show


def test_no_curve_of_a_convergence_is_too_pale() -> None:
    lines = {f"method {k}": (np.array([10.0, 100.0]), np.array([1e-3, 1e-5])) for k in range(8)}
    with drawing():
        made = verification.convergence("orders", lines, {"all": list(lines)})
    assert max(lightness(line.get_color()) for line in labelled_lines(made)) < 90
