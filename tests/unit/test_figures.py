"""Figures and animations: their numbers, what they apply to, files and errors."""

from __future__ import annotations

import re
import warnings
from collections.abc import Container, Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
import pytest
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.figure import Figure
from PIL import Image
from result_samples import net, result, square_net, unfolding
from scenes import CASES as SCENES
from typer.testing import CliRunner

import exunet
from exunet.base.errors import FigureError, InputError, MissingExtra
from exunet.base.run_events import NetEjected
from exunet.bodies.shapes import Shape, Solid, packed
from exunet.cli.animate import animate
from exunet.cli.main import app
from exunet.net.arrays import TetherNodes
from exunet.plots import animation
from exunet.plots.animation import save_animation, stored_times
from exunet.plots.curves import compared
from exunet.plots.nets import evenly_spaced
from exunet.plots.registry import FIGURES, figure, save_figures
from exunet.plots.scene_3d import TARGET, draw, hidden, scene_3d
from exunet.plots.style import drawing
from exunet.plots.time_axes import BINS, rows_with_extremes
from exunet.results import measures as metrics
from exunet.results.comparison import Agreement
from exunet.results.ensemble import LEVELS, Ensemble
from exunet.results.loads import broken_at
from exunet.results.metrics import Metric
from exunet.results.observables import Observables, TimeSeries
from exunet.results.penetration import contact_places
from exunet.results.result import BodyStates, Result, TermStates
from exunet.results.run_record import Peak, RunRecord, UnitSettings

CUBE = Shape((Solid("box", (1.0, 1.0, 1.0)),))


def drawn(made: Figure) -> Figure:
    """Lay out and draw a figure; warnings are errors."""
    with drawing(), warnings.catch_warnings():
        warnings.simplefilter("error")
        made.draw_without_rendering()
    return made


def labelled_lines(made: Figure) -> list[Any]:
    return [line for axes in made.axes for line in axes.get_lines() if not line.get_label().startswith("_")]


def curves(made: Figure) -> dict[str, Any]:
    return {str(line.get_label()): line for line in made.axes[0].get_lines()}


def texts(made: Figure) -> str:
    return " ".join(text.get_text() for text in made.findobj(matplotlib.text.Text))


def figures(of: Result, laid_out: Container[str] = FIGURES, **options: Any) -> dict[str, Figure]:
    """All figures that apply to a result; those named are laid out and drawn too."""
    found = {}
    for name in FIGURES:
        with suppress(InputError):
            made = figure(of, name, **options)
            found[name] = drawn(made) if name in laid_out else made
    return found


def agreement_with(of: Result, until: float | None = 0.5, factor: float = 1.0) -> Agreement:
    difference = factor * np.geomspace(1e-12, 1, len(of.time))
    return Agreement(of.time, difference, difference, 0.025, 1e-4, until, until, metrics.bullet_speeds(of))


def body(start: Any, velocity: Any, shape: Any = CUBE, nodes: Any = None) -> BodyStates:
    """A cube of 1 m, or a rigid body without a shape, that flies straight on for 1 s."""
    position = np.array(start) + np.linspace(0, 1, 7)[:, None] * np.array(velocity)
    upright, still = np.tile([1.0, 0, 0, 0], (7, 1)), np.zeros((7, 3))
    flying = np.broadcast_to(np.array(velocity, float), (7, 3))
    arrays = packed(shape, np.zeros(3))
    return BodyStates(5.0, np.eye(3), position, flying, upright, still, nodes=nodes, **arrays)


def towed(bodies: int = 2) -> Result:
    """A tether of four elements of 2 m between bodies 9 m apart, and a lone node beside; no net."""
    along = [(0.0, 0.0, -2.0 * k) for k in range(5)]
    of = replace(
        net([(0, 5, 0), *along], [(k, k + 1) for k in range(1, 5)]),
        tethers=(TetherNodes("tow", 1, (1, 2, 3, 4, 5)),),
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
OF_FULL |= {"rotation"}
THREAD = net([(0, 0, 0), (1, 0, 0)], [(0, 1)])
HANGING = net([(0, 0, 0), (1, 0, 0.5), (2, 0, 0)], [(0, 1), (1, 2)])
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
    "at rest": (STILL, NET | {"area"}),
    "one node": (result(net([(0, 0, 0)], [], bullets=(0,)), [0, 1], np.zeros((2, 1, 3))), {"snapshots"}),
    "far away": (replace(THROWN, position=THROWN.position + AWAY), NET | MOVING),
    "blown up": (
        replace(THROWN, position=BLOWN * THROWN.position, run=RunRecord(verdict="?")),
        NET | MOVING,
    ),
}


def ends_drawn(axes: Any) -> np.ndarray:
    """(k, 2) end points of the elements that are drawn, in order; a bundle of them has NaN in between."""
    lines = [line for c in axes.collections if isinstance(c, LineCollection) for line in c.get_segments()]
    points = np.concatenate([np.empty((0, 2)), *lines])
    return points[np.isfinite(points).all(axis=1)]


def same_points(one: np.ndarray, other: np.ndarray) -> bool:
    """True if arrays (n, 2) and (m, 2) have the same points to round-off, in any order and number."""
    return {tuple(row) for row in one.round(9) + 0.0} == {tuple(row) for row in other.round(9) + 0.0}


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
    made = figures(of, FIGURES if name in ("thrown", "full") else NET)
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
    chosen = evenly_spaced(of.time, 6)
    scene = scene_3d(of, chosen)
    for axes, k in zip(panels, chosen, strict=True):
        points = (of.position[k] - scene.origin(k)) @ scene.camera.axes.T
        ends = points[of.net.element_nodes][..., :2].reshape(-1, 2)
        if name != "blown up":
            assert same_points(ends_drawn(axes), ends)
            assert (np.abs(points[:, :2]) < [axes.get_xlim()[1], axes.get_ylim()[1]]).all()
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
    of = replace(THROWN, largest_elastic=peak, least_kinetic=0.5 * THROWN.kinetic)
    axes = figure(of, "energies").axes[0]
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
    zeros = {item.name: [0.0] * 3 if "momentum" in item.name else 0.0 for item in fields(NetEjected)}
    event = NetEjected(**zeros | {"time_s": float(THROWN.time[2]), "energy_lost_J": -3.5, "body": "hand1"})
    of = replace(
        THROWN,
        kinetic=5.0 + sum(works.values()) + ejected,
        elastic=np.zeros(7),
        dissipated=-sum(works.values()) - ejected,
        bodies={name: BodyStates(2.0, np.eye(3), still, still, upright, still) for name in works},
        states={f"{name}/work": TermStates("J", work[:, None]) for name, work in works.items()},
        run=replace(THROWN.run, events=(event,)),
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
    speeds = curves(figure(THROWN, "bullet_speeds"))["bullet 0"].get_ydata()
    np.testing.assert_array_equal(speeds, metrics.bullet_speeds(THROWN)[:, 0])
    mouth = curves(figure(THROWN, "area"))["mouth / achievable area (1 m²)"].get_ydata()
    assert mouth[0] == pytest.approx(0.01)  # a tenth of the size, squared


def test_tensions_of_elements_are_the_largest_of_all_steps() -> None:
    """Those of all steps where they are known; elements without tension are apart."""
    peaks = np.arange(THROWN.net.n_elements, dtype=float)
    of = replace(FULL, run=replace(FULL.run, peak_tensions_N=peaks.tolist()))
    axes, bar = figure(of, "tensions").axes
    slack, taut = (collection for collection in axes.collections if isinstance(collection, LineCollection))
    assert len(slack.get_segments()) == 1
    np.testing.assert_array_equal(taut.get_array(), peaks[1:])
    first = of.net.reference_position[of.net.element_nodes[1], :2]
    np.testing.assert_array_equal(taut.get_segments()[0], first)
    assert bar.get_ylim() == (0.0, peaks.max())


def test_history_of_the_largest_tension_and_its_mark() -> None:
    of = replace(FULL, run=replace(FULL.run, largest_tensions={"net": Peak(7.0, 0.37, 4)}))
    curve, mark = labelled_lines(figure(of, "largest_tension"))[:2]
    np.testing.assert_array_equal(curve.get_ydata(), FULL.tension.max(axis=1))
    assert (mark.get_xdata()[0], mark.get_ydata()[0]) == (0.37, 7.0)


@pytest.mark.ci
def test_tensions_along_tethers() -> None:
    """Steps over the unstretched length; the net's figure leaves tethers out."""
    of = towed()
    line = figure(of, "tethers").axes[0].get_lines()[0]
    np.testing.assert_allclose(line.get_xdata(), [0, 2, 4, 6, 8])
    np.testing.assert_allclose(line.get_ydata(), [1, 4, 2, 0, 0])
    with pytest.raises(InputError, match="requires"):
        figure(of, "tensions")


def test_bodies_hide_what_is_behind_them() -> None:
    """Of threads across a cube, one in front of it, one behind: the view is along z, from the front."""
    threads = net([(-2, 0, 2), (2, 0, 2), (-2, 0.1, -2), (2, 0.1, -2)], [(0, 1), (2, 3)])
    of = replace(result(threads, [0.0], threads.reference_position[None]), bodies={})
    states = body((0, 0, 0), (0, 0, 0))
    arrays = {name: getattr(states, name)[:1] for name in ("position", "velocity", "attitude")}
    still = replace(states, angular_velocity=states.angular_velocity[:1], **arrays)
    scene = scene_3d(replace(of, bodies={"target": still}), [0])
    front = replace(scene, camera=replace(scene.camera, axes=np.eye(3), middle=np.zeros(3), follows=False))
    axes = Figure().subplots()
    draw(axes, front, 0)
    (faces,) = [item for item in axes.collections if isinstance(item, PolyCollection)]
    assert len(faces.get_paths()) == 2  # the face to the viewer, of two triangles
    assert set(np.concatenate([path.vertices for path in faces.get_paths()]).ravel()) == {-0.5, 0.5}
    assert faces.get_facecolor()[0, 0] < TARGET
    shown = ends_drawn(axes).reshape(-1, 2, 2)
    before = shown[shown[:, 0, 1] == 0.0]
    np.testing.assert_allclose(before, [[[-2.0, 0.0], [2.0, 0.0]]])
    behind = np.sort(shown[shown[:, 0, 1] != 0.0][:, :, 0].ravel())
    np.testing.assert_allclose(behind, [-2, -4 / 3, -4 / 3, -2 / 3, 2 / 3, 4 / 3, 4 / 3, 2])


def test_a_cut_element_is_not_drawn_from_the_cut_on() -> None:
    """The tether of a case, element 84, is cut when its tension passes 0.5 N, at 0.1041 s."""
    path = Path(__file__).resolve().parents[2] / "cases" / "missions" / "cut_tether.toml"
    of = exunet.run(exunet.load(path, ["time.end=0.12"]))
    (cut,) = broken_at(of).items()
    assert cut == (84, pytest.approx(0.1041, abs=1e-4))
    scene = scene_3d(replace(of, bodies={}), [0, len(of.time) - 1])
    drawn = []
    for k in (0, len(of.time) - 1):
        axes = Figure().subplots()
        draw(axes, scene, k)
        drawn.append(len(ends_drawn(axes)) // 2)
    assert drawn == [of.net.n_elements, of.net.n_elements - 1]


def test_a_point_is_hidden_by_a_face_in_front_of_it() -> None:
    face = np.array([[[0.0, 0.0, 1.0], [1.0, 0.0, 1.0], [0.0, 1.0, 1.0]]])
    points = np.array([[0.2, 0.2, 0.9], [0.2, 0.2, 1.1], [0.8, 0.8, 0.9], [0.2, 0.2, 0.99]])
    assert hidden(points, face, np.zeros(1)).tolist() == [True, False, False, True]
    assert hidden(points, face, np.array([0.05])).tolist() == [True, False, False, False]
    assert not hidden(points, np.zeros((0, 3, 3)), np.zeros(0)).any()


def test_views_of_a_large_scene_follow_the_net() -> None:
    """Of a tether of 8 m between bodies all is seen; of a body 30 m from a net of 2 m the net."""
    assert not scene_3d(towed(4), [0, 6]).camera.follows
    far = replace(unfolding(square_net(size=2.0)), bodies={"target": body((0, 30, 0), (0, 5, 0))})
    scene = scene_3d(far, [0, 6])
    assert scene.camera.follows
    np.testing.assert_allclose(scene.origin(6) - scene.camera.middle, metrics.centre_of_mass(far)[6])
    drawn(figure(far, "snapshots"))


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
    line = curves(figure(of, "bullet_speeds"))["bullet 0"].get_ydata()
    speeds = metrics.bullet_speeds(of)[:, 0]
    assert len(line) <= 4 * BINS
    assert (line.min(), line.max()) == (speeds.min(), speeds.max())


def test_events_of_a_script_are_lines_at_their_times() -> None:
    times = {"first": 0.300, "second": 0.304, "third": 0.308, "last": 0.9}
    entries = [f'{{name="{name}", at={time}, do="note"}}' for name, time in times.items()]
    case = exunet.load(SCENES / "planar_undamped.toml", ["time.end=1.0", f"script=[{', '.join(entries)}]"])
    top = figure(exunet.run(case), "energies").axes[0]
    lines = [line.get_xdata()[0] for line in top.get_lines() if len(set(line.get_xdata())) == 1]
    assert {0.3, 0.304, 0.308, 0.9} <= {round(time, 6) for time in lines}


@pytest.mark.slow
def test_figures_are_saved_in_several_threads(tmp_path: Path) -> None:
    """Four at a time, with the bytes of one alone."""
    with ThreadPoolExecutor(4) as pool:
        saved = list(pool.map(lambda k: save_figures(FULL, tmp_path / str(k), names=["area"]), range(4)))
    assert len({paths[0].read_bytes() for paths in saved}) == 1


def test_files_are_written_whole_and_alike(tmp_path: Path) -> None:
    """Of the widths of a column and of a page at 300 dots per inch; the same bytes each time."""
    paths = save_figures(STILL, tmp_path / "still")
    assert {path.stem for path in paths} == NET | {"area"}
    save_figures(FULL, tmp_path / "new" / "folder", names=["area"])
    for width in (85, 170):
        for path in save_figures(FULL, tmp_path / str(width), names=["area"], width=width):
            data = path.read_bytes()
            assert int.from_bytes(data[16:20], "big") * 25.4 / 300 == pytest.approx(width, abs=0.1)
            assert (width == 85) or data == (tmp_path / "new" / "folder" / path.name).read_bytes()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"name": "speeds"}, "'speeds' is not one of reference_net"),
        ({"name": "agreement"}, "'agreement' requires"),
        ({"name": "area", "width": 100}, "width: "),
    ],
)
def test_arguments_that_cannot_be_used(arguments: dict[str, Any], words: str) -> None:
    with pytest.raises(InputError, match=words):
        figure(FULL, **arguments)


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
    command = ["plot", str(tmp_path / "result.h5"), *options, "--figure", "area", "--figure", "rotation"]
    assert CliRunner().invoke(app, command).exit_code == 0
    assert sorted(path.name for path in (tmp_path / "new").iterdir()) == ["area.pdf", "rotation.pdf"]
    (box,) = re.findall(rb"/MediaBox \[ 0 0 (\S+) ", (tmp_path / "new" / "area.pdf").read_bytes())
    assert float(box) * 25.4 / 72 == pytest.approx(85.0, abs=0.1)


def ensemble() -> Ensemble:
    """Fifty runs, whose metrics differ by little or by much."""
    random = np.random.default_rng(1)
    values = {
        ("largest_tension", "N"): 53.99269938 + 1e-9 * random.normal(size=50),
        ("largest_area", "m2"): 4.2 + 0.3 * random.normal(size=50),
    }
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


@pytest.mark.ci_for("bands")
@pytest.mark.parametrize("name", ["histograms", "bands"])
def test_figures_of_an_ensemble(name: str) -> None:
    found = ensemble()
    made = drawn(exunet.figure(found, name))
    middle = made.axes[0].get_lines()[0]
    if name == "histograms":
        assert middle.get_xdata()[0] == np.median(found.metrics["largest_tension_N"])
        assert sum(patch.get_height() for patch in made.axes[0].patches) == 50
    else:
        np.testing.assert_array_equal(middle.get_ydata(), found.quantiles["area"][3])


# Bands of perturbed runs

CONTACTS = ("threads", "bullets")
LINE = ("tension_start", "tension_end", "way", "wound_up")


def shown(contacts: tuple[str, ...] = CONTACTS, bodies: int = 1, units: int = 2) -> Result:
    """A net that unfolds within 1 s beside bodies that turn, with a closing line and corner units."""
    rising = np.linspace(0.0, 1.0, 7)[:, None]
    names = ["box", *(f"body_{k}" for k in range(1, bodies))]
    spins = np.tile([0.1, 0.2, 0.3], (7, 1))
    turning = {item: replace(body((0, 0, 3), (0, 0, 0)), angular_velocity=spins) for item in names}
    turning["box"] = replace(turning["box"], nodes=np.array([0]), velocity=1e-3 * rising * [1.0, 0.0, 0.0])
    keys = (exunet.ContactKey("box", other, what) for other in contacts for what in ("touching", "force"))
    states = {f"closing/{entry}": rising for entry in LINE}
    states |= {"control/spent": rising * np.ones(units), "control/work": rising}
    stored = {name: TermStates("1", values) for name, values in states.items()}
    record = RunRecord(units=UnitSettings("table", tuple(range(units)), 1.0))
    taut = np.full((7, 4), 1e-3)
    touches = dict.fromkeys(keys, TermStates("1", rising))
    return unfolding(square_net(), bodies=turning, states=stored, contacts=touches, run=record, tension=taut)


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
    """Each in its axes and within the limits; means stand between instants."""
    runs = perturbed([quantity for axes in DRAWN[name] for quantity in axes], 1.0, 2.0, 6.0)
    made = figure(shown(), name, ensemble=runs)
    last = 1.75 if name == "control" else 2.0  # the middle of the last interval
    assert len(made.axes) == len(DRAWN[name])
    for axes, quantities, own in zip(made.axes, DRAWN[name], bands_of(made), strict=True):
        assert len(own) == len(quantities)
        for quantity, band in zip(quantities, own, strict=True):
            low, high = runs.band(quantity)
            assert ends_at(band, last) == pytest.approx((low[-1], high[-1])), quantity
            assert axes.get_ylim()[0] <= low.min()
            assert axes.get_ylim()[1] >= high.max()
    assert bands_of(figure(shown(), name)) == [[]] * len(made.axes)


def test_two_designs_are_drawn_over_each_other() -> None:
    """A run with perturbed runs, and an ensemble alone, whose median is its curve; neither has a mouth."""
    run, runs = Observables(THROWN), perturbed(("area", "tension"), 1.0, 2.0, 6.0)
    both = compared([("a", run, runs), ("b", runs, runs)])
    assert both is not None
    made = drawn(both)
    assert [axes.get_ylabel() for axes in made.axes] == ["mouth area [m²]", "largest tension [N]"]
    for axes, values, own in zip(made.axes, (run.area, run.tension), bands_of(made), strict=True):
        first, last = (curve.get_ydata() for curve in axes.get_lines())
        np.testing.assert_array_equal(first, values)
        np.testing.assert_allclose(last, 2.0 * runs.time)
        assert [ends_at(band, 2.0) for band in own] == [pytest.approx((2.0, 12.0))] * 2
    legend = [text.get_text() for text in made.legends[0].get_texts()]
    assert legend == ["A: a", "range of 3 perturbed runs", "B: b"]
    still = replace(runs, quantiles={name: 0.0 * band for name, band in runs.quantiles.items()})
    assert compared([("a", still, still), ("b", still, None)]) is None


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


# Animations

SMALL = unfolding(square_net(strings=True), lift=0.3, times=5)
EDGE = 0.1  # m
# Lines along z beside a box of 1 m: a centimetre in its side, a centimetre in the sharp corner, which is
# rounded away there (from the core's edge 0.09 sqrt(2) > 0.1), a centimetre off its side.
BESIDE = [(0.49, 0.0), (0.49, 0.49), (0.51, 0.0)]


def met() -> Result:
    """A box and three threads along it, at two times; the first 10 m away."""
    of = net([(x, y, z) for x, y in BESIDE for z in (-2.0, 2.0)], [(0, 1), (2, 3), (4, 5)], bullets=(0,))
    shape = Shape((Solid("box", (1.0, 1.0, 1.0)),), edge_radius=EDGE)
    far = np.array([[10.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
    upright, still = np.tile([1.0, 0.0, 0.0, 0.0], (2, 1)), np.zeros((2, 3))
    box = BodyStates(1.0, np.eye(3), far, still, upright, still, **packed(shape, np.zeros(3)))
    series = {
        ("threads", "touching"): [0.0, 1.0],
        ("threads", "first"): [-1.0, 0.7],
        ("bullets", "touching"): [0.0, 2.0],
        ("bullets", "first"): [-1.0, 0.8],
    }
    stored = (TermStates("1", np.array(values)[:, None]) for values in series.values())
    contacts = {exunet.ContactKey("box", *name): values for name, values in zip(series, stored, strict=True)}
    whole = result(of, [0.0, 1.0], np.stack([of.reference_position] * 2))
    return replace(whole, bodies={"box": box}, contacts=contacts, run=RunRecord(edge_radii={"box": EDGE}))


def touching(scene: Result, row: int) -> np.ndarray:
    return ~np.isnan(contact_places(scene, [row])[0])


def test_threads_that_touch_are_found() -> None:
    scene = met()
    assert touching(scene, 0).tolist() == [False, False, False]
    assert touching(scene, 1).tolist() == [True, False, False]
    sharp = replace(scene, run=RunRecord())
    assert touching(sharp, 1).tolist() == [True, True, False]
    held = replace(scene.bodies["box"], nodes=np.array([0]))
    assert not touching(replace(scene, bodies={"box": held}), 1).any()


@pytest.mark.parametrize(
    ("solid", "beside"),
    [
        (Solid("cylinder", (0.5, 1.0, 0.0)), (0.5, 0.0)),
        (Solid("sphere", (0.5, 0.0, 0.0)), (0.5, 0.0)),
        (Solid("capsule", (0.5, 1.0, 0.0)), (0.5, 0.0)),
        (Solid("frustum", (0.5, 0.5, 1.0)), (0.5, 0.0)),
        (Solid("cylinder", (0.5, 2.0 * EDGE, 0.0)), (0.5, 0.0)),  # whose core is flat
    ],
)
def test_a_thread_touches_within_its_radius(solid: Solid, beside: tuple[float, float]) -> None:
    """The radius of a thread of 1 mm2 is sqrt(1e-6 / pi) m; it is 1 % nearer, and 1 % farther."""
    scene, thick = met(), np.sqrt(1e-6 / np.pi)
    box = replace(scene.bodies["box"], **packed(Shape((solid,)), np.zeros(3)))
    near = np.array(beside)[:, None] + np.array([[0.99, 1.01, 3.0], [0.0, 0.0, 0.0]]) * thick
    position = np.repeat(near.T, 2, axis=0)
    position = np.column_stack([position, np.tile([-2.0, 2.0], 3)])
    scene = replace(scene, bodies={"box": box}, position=np.stack([position] * 2))
    assert touching(scene, 1).tolist() == [True, False, False]


def test_a_gif_has_a_frame_for_each_stored_time(tmp_path: Path) -> None:
    seen: list[tuple[int, int]] = []
    count = save_animation(SMALL, tmp_path / "a.gif", 25.0, 0.2, None, lambda *one: seen.append(one))
    assert count == 4
    assert seen == [(1, 4), (2, 4), (3, 4), (4, 4)]
    with Image.open(tmp_path / "a.gif") as made:
        assert (made.n_frames, made.info["loop"], made.info["duration"]) == (4, 0, 40)
        first = np.asarray(made.convert("RGB"))
        made.seek(3)
        assert (first != np.asarray(made.convert("RGB"))).any()


def test_many_times_are_thinned_evenly() -> None:
    time = np.linspace(0.0, 1.0, 10_001)
    chosen = stored_times(time, 0.5, None, 2000)
    assert len(chosen) == 2000
    assert (chosen[0], chosen[-1]) == (5000, 10_000)
    assert set(np.diff(chosen)) <= {2, 3}
    assert stored_times(time, 0.5, 0.5, 2000) == [5000]
    assert stored_times(0.1 * np.arange(10), 0.1 + 0.2, 0.3, 2000) == [3]  # 3 x 0.1 is after 0.3
    assert stored_times(np.array([0.2, 0.3]), 0.1 + 0.2, None, 2000) == [1]


def test_without_ffmpeg_the_extra_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setattr(animation, "find_spec", lambda name: None)
    with pytest.raises(MissingExtra, match=r"exunet\[movie\]"):
        save_animation(SMALL, tmp_path / "a.mp4", 25.0)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("name", "fps", "begin", "end", "words"),
    [
        ("a.avi", 25.0, None, None, ".gif or .mp4"),
        ("a.gif", 60.0, None, None, "fps: "),
        ("a.gif", 1e-12, None, None, "fps: "),
        ("a.gif", float("nan"), None, None, "fps: "),
        ("a.gif", 25.0, 0.6, 0.4, "from, until: "),
        ("none/a.gif", 25.0, None, None, "cannot be written"),
    ],
)
def test_wrong_arguments_write_nothing(
    tmp_path: Path, name: str, fps: float, begin: float | None, end: float | None, words: str
) -> None:
    exunet.save(SMALL, tmp_path / "result.h5")
    with pytest.raises(InputError) as refused:
        animate(tmp_path / "result.h5", tmp_path / name, fps, begin, end, overwrite=False, quiet=True)
    assert words in str(refused.value).replace("--", "")
    assert [path.name for path in tmp_path.iterdir()] == ["result.h5"]
