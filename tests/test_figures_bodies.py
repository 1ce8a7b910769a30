"""Figures of scenes with bodies and tethers: what the scene has is named and readable."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.collections import LineCollection
from matplotlib.colors import to_rgba
from result_samples import net, result, square_net, unfolding
from test_figures_print import NEAREST, drawn, lightness, words

from exunet.base.errors import InputError
from exunet.figures import figure
from exunet.figures.style import BLACK, BLUE
from exunet.figures.ticks import MOST, ticks
from exunet.net.arrays import Tether
from exunet.results.ensemble_result import EnsembleResult
from exunet.results.result import BodyStates, Result
from exunet.results.spread import CONVERGED

SIZES = (None, (85.0, 60.0), (170.0, 120.0))
CUBE = np.array(
    [[a, b] for a, b in itertools.product(itertools.product((-0.5, 0.5), repeat=3), repeat=2)], float
)
CUBE = CUBE[np.isclose(np.abs(CUBE[:, 0] - CUBE[:, 1]).sum(axis=1), 1.0)]  # its twelve edges, each twice


def body(start, velocity, times=7, shape=CUBE, nodes=None) -> BodyStates:
    """A cube of 1 m that flies straight on for 1 s."""
    position = np.array(start) + np.linspace(0, 1, times)[:, None] * np.array(velocity)
    upright, still = np.tile([1.0, 0, 0, 0], (times, 1)), np.zeros((times, 3))
    flying = np.broadcast_to(np.array(velocity, float), (times, 3))
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
    return replace(result(of, np.linspace(0, 1, 7), moved), bodies=flying)


def test_the_mark_of_a_body_hides_no_shape() -> None:
    """It is open where the body has a shape, in the picture and in the legend."""
    scene = towed()
    bare = replace(scene, bodies={name: replace(one, wireframe=None) for name, one in scene.bodies.items()})
    for of, is_open in ((scene, True), (bare, False)):
        drawing = figure(of, "snapshots")
        marks = [line for axes in drawing.axes for line in axes.lines if line.get_marker() in ("D", "s")]
        (legend,) = drawing.legends or [drawing.axes[0].get_legend()]
        named = [one for one in legend.legend_handles if one.get_marker() in ("D", "s")]
        assert marks
        assert len(named) == 2
        assert all((one.get_markerfacecolor() == "none") == is_open for one in (*marks, *named))


def thrown_beside() -> Result:
    """A net on a tether beside two bodies; its centre of mass travels, so it is drawn relative to that."""
    of = square_net(cells=2, size=2.0, strings=True)
    end = of.n_nodes
    position = np.vstack([of.reference_position, [[0, 0, -3.0]]])
    elements = np.vstack([of.element_nodes, [[int(of.bullet_nodes[0]), end]]])
    more = net(
        position,
        elements,
        bullets=tuple(of.bullet_nodes),
        faces=of.faces,
        mouth=of.mouth,
        strings=tuple(np.flatnonzero(of.is_string)),
    )
    more = replace(more, tethers=(Tether("line", end, (int(of.bullet_nodes[0]), end)),))
    away = np.linspace(0, 4, 7)[:, None, None] * np.array([0, 0.2, 1.0])
    whole = unfolding(more, lift=0.2)
    bodies = {"chaser": body((0, 0, -3), (0, 0, 0)), "a satellite": body((0, 3, 2), (0, 1, 0))}
    return replace(whole, position=whole.position + away, bodies=bodies)


SCENES = {"towed": towed(), "thrown": thrown_beside()}


def labels(made) -> list[str]:
    (legend,) = made.legends
    return [text.get_text() for text in legend.get_texts()]


@pytest.mark.parametrize("size", SIZES, ids=str)
@pytest.mark.parametrize("name", SCENES)
def test_snapshots_are_legible(name, size):
    """No words on each other or outside, none inside the axes, and two numbers at the least at each axis."""
    made = drawn(figure(SCENES[name], "snapshots", size=size))
    boxes = [(text.get_text(), text.get_window_extent()) for text in words(made)]
    for (one, a), (other, b) in itertools.combinations(boxes, 2):
        assert not a.padded(-1.0).overlaps(b.padded(-1.0)), (one, other)
    for word, box in boxes:
        inside = box.x0 >= 0 and box.y0 >= 0 and box.x1 <= made.bbox.x1 and box.y1 <= made.bbox.y1
        assert inside, word
        for axes in made.axes:
            frame = axes.get_window_extent()
            assert not frame.padded(-1.0).overlaps(box), word
    for axes in made.axes:
        for at, limits in ((axes.get_xticks(), axes.get_xlim()), (axes.get_yticks(), axes.get_ylim())):
            assert np.count_nonzero((at >= limits[0]) & (at <= limits[1])) >= 2


def test_the_legend_names_what_the_scene_has():
    assert labels(figure(towed(), "snapshots")) == ["tether", "free node", "chaser", "target"]
    assert labels(figure(thrown_beside(), "snapshots")) == [
        *("net", "bullet", "tether", "reference configuration", "chaser", "a satellite")
    ]
    assert labels(figure(unfolding(net([(0, 0, 0), (1, 0, 0)], [(0, 1)])), "snapshots")) == [
        *("net", "reference configuration")
    ]
    assert labels(figure(towed(9), "snapshots"))[-1] == "9 bodies"


def test_bodies_are_told_apart_by_their_marks():
    made = figure(towed(4), "snapshots")
    marks = [line.get_marker() for line in made.axes[0].get_lines() if line.get_marker() != "None"]
    named = {handle.get_label(): handle.get_marker() for handle in made.legends[0].legend_handles}
    assert len(set(marks[-4:])) == 4
    assert [named[name] for name in ("chaser", "target", "body_2", "body_3")] == marks[-4:]
    place = made.axes[1].get_lines()[2]  # of the target, seen from the side: z and y at the start
    np.testing.assert_allclose([*place.get_xdata(), *place.get_ydata()], [9.0, 0.2])


def test_axes_of_a_body_without_a_shape_are_explained():
    plain = replace(towed(), bodies={"target": body((0, 0, 9), (0, 0, 0), shape=None)})
    assert labels(figure(plain, "snapshots"))[-1] == "body axes: $x$ broad, $y$ thin"


def test_tethers_differ_from_the_net_in_grey():
    assert abs(lightness(BLUE) - lightness(BLACK)) >= NEAREST
    drawn_lines = [
        one
        for one in figure(thrown_beside(), "snapshots").axes[0].collections
        if isinstance(one, LineCollection)
    ]
    colors = [tuple(one.get_colors()[0]) for one in drawn_lines]
    (at,) = [k for k, color in enumerate(colors) if color == to_rgba(BLACK)]
    (segment,) = drawn_lines[at].get_segments()
    assert np.isfinite(segment).all(axis=1).sum() == 2  # one element


def test_a_body_far_from_the_net_is_in_the_picture():
    """Farther than what a failed run would have thrown: 30 m beside a net of 2 m."""
    far = replace(unfolding(square_net(size=2.0)), bodies={"target": body((0, 30, 0), (0, 5, 0))})
    for axes in figure(far, "snapshots").axes:
        mark = axes.get_lines()[-1]
        assert axes.get_ylim()[0] < mark.get_ydata()[0] < axes.get_ylim()[1]


def test_small_pages_have_as_many_snapshots_as_can_be_read():
    whole, small = (figure(thrown_beside(), "snapshots", size=size) for size in (None, (85, 60)))
    times = [[axes.get_title(loc="left") for axes in made.axes[::2]] for made in (whole, small)]
    assert len(times[0]) == 6
    assert len(times[1]) < 6
    assert (times[1][0], times[1][-1]) == (times[0][0], times[0][-1])  # first and last


def test_tensions_leave_out_tethers():
    """They have no place in the reference configuration; a scene without a net has no such figure."""
    with pytest.raises(InputError, match="cannot have 'tensions'"):
        figure(towed(), "tensions")
    of = thrown_beside()
    made = figure(of, "tensions")
    axes = made.axes[0]
    segments = [one for c in axes.collections if isinstance(c, LineCollection) for one in c.get_segments()]
    assert len(segments) == of.net.n_net_elements
    assert len(made.axes) == 2  # one plane, in which the net is flat, and the colour bar
    told = labels(figure(replace(of, tension=0.0 * of.tension), "tensions"))
    assert told == ["bullet", "no tension at the stored times of this run"]


def test_figures_without_bands_say_that_they_show_one_run_beyond_the_horizon():
    """In the legend, where moved starts give a headline as a range; not where all are values."""
    empty = {"elements": np.zeros(2, dtype=np.int64), "time": np.zeros(1), "levels": np.zeros(0)}
    key, of = "bullet_speed_at_end_m_s", towed()
    runs = EnsembleResult(headlines={key: np.array([1.0, 2.0])}, quantiles={}, **empty)
    known = replace(runs, provenance={CONVERGED: {key: [1.5, 0.1]}})
    for name in ("momentum", "rotation"):
        told = ["one run of a chaotic net" in labels(figure(of, name, spread=one)) for one in (runs, known)]
        assert told == [True, False]
        assert "one run of a chaotic net" not in labels(figure(of, name))


def test_tensions_along_tethers():
    """Steps over the unstretched length, and both ends named; none without a tether."""
    of = towed()
    of = replace(of, tension=np.outer(np.linspace(0, 1, 7), [1.0, 4.0, 2.0, 0.0]))
    made = figure(of, "tethers")
    (line,) = made.axes[0].get_lines()
    np.testing.assert_allclose(line.get_xdata(), [0, 2, 4, 6, 8])
    np.testing.assert_allclose(line.get_ydata(), [1, 4, 2, 0, 0])
    assert line.get_drawstyle() == "steps-post"
    assert labels(made) == ["tow, from node 1 to node 5"]
    held = {
        "chaser": replace(of.bodies["chaser"], nodes=np.array([1])),
        "target": replace(of.bodies["target"], nodes=np.array([5])),
    }
    assert labels(figure(replace(of, bodies=held), "tethers")) == ["tow, from chaser to target"]
    assert labels(figure(thrown_beside(), "tethers")) == ["line, from bullet 9 to node 13"]
    with pytest.raises(InputError, match="cannot have 'tethers'"):
        figure(unfolding(square_net()), "tethers")
    for size in SIZES:
        for text in words(drawn(figure(of, "tethers", size=size))):
            box = text.get_window_extent()
            assert min(box.x0, box.y0) >= 0, text


def test_rotations_name_their_axes_and_repeat_no_line():
    """Of six bodies the four that turn fastest."""
    of = towed(6)
    turning = {
        name: replace(one, angular_velocity=np.full((7, 3), 0.1 * k))
        for k, (name, one) in enumerate(of.bodies.items())
    }
    made = figure(replace(of, bodies=turning), "rotation")
    assert made.axes[0].get_ylabel() == "angular velocity\nin body axes [rad/s]"
    lines = made.axes[0].get_lines()
    names = [f"body_{k}, {axis}" for k in (2, 3, 4, 5) for axis in "xyz"]
    assert [line.get_label() for line in lines] == [*names, "2 more, which turn more slowly"]
    assert len({(line.get_color(), line.get_linestyle()) for line in lines[:-1]}) == 12


@pytest.mark.parametrize("horizontal", [True, False])
def test_every_axis_has_at_least_two_round_numbers(horizontal):
    random = np.random.default_rng(0)
    for _ in range(300):
        low = random.normal() * 10 ** random.uniform(-2, 2)
        high = low + 10 ** random.uniform(-3, 3)
        at, room = ticks(low, high, float(random.uniform(0.2, 4.0)), horizontal, 0.04)
        step = np.diff(at).min()
        assert 2 <= len(at) <= MOST
        assert low - 1e-9 * step <= at[0] < at[-1] <= high + 1e-9 * step
        assert np.allclose(np.diff(at), step)
        assert room or len(at) == 2


def test_numbers_at_an_axis_have_room():
    at, room = ticks(-1.7, 1.7, 2.5, horizontal=True)
    assert at.tolist() == pytest.approx([-1.5, -1.0, -0.5, 0.0, 0.5, 1.0, 1.5])
    assert room
    narrow, room = ticks(-1.7, 1.7, 0.42, horizontal=True)
    assert narrow.tolist() == [-1.0, 1.0]
    assert room
    assert not ticks(-1.7, 1.7, 0.2, horizontal=True)[1]
