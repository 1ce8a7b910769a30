"""Figures fit for print: files, sizes, titles, what is left of them in grey, and what can be read."""

from __future__ import annotations

import itertools
import os
import re
import subprocess
import sys
import warnings
from dataclasses import replace
from pathlib import Path

import matplotlib
import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.colors import to_rgb
from result_samples import net, square_net, unfolding
from test_plot import agreement_with
from typer.testing import CliRunner

import exunet
from exunet.base.errors import InputError
from exunet.figures import FIGURES, figure, figures, save_figures
from exunet.figures.page import Page, columns_that_fit, fitted, text_width
from exunet.figures.style import MOST_CURVES, curve_styles, drawing
from exunet.figures.tensions import tension_colors, tension_map
from exunet.interfaces.main import app
from exunet.results import measures as metrics
from exunet.results.headlines import headline
from exunet.results.judged import Judged
from exunet.results.result import BodyStates

TURNING = np.linspace(0.0, 1.0, 21).reshape(7, 3)
RIGID = BodyStates(2.0, np.eye(3), TURNING, TURNING, np.tile([1.0, 0, 0, 0], (7, 1)), TURNING)
WHOLE = replace(unfolding(square_net(cells=3, strings=True), lift=0.2), bodies={"target": RIGID})
STRETCHED = replace(WHOLE, tension=np.abs(np.sin(np.arange(WHOLE.tension.size))).reshape(WHOLE.tension.shape))
SIX = net(
    [(np.cos(a), np.sin(a), 0) for a in np.arange(6)],
    [(k, (k + 1) % 6) for k in range(6)],
    bullets=tuple(range(6)),
)
FULL = replace(
    WHOLE,
    potential=-np.linspace(0.0, 9.0, 7),
    largest_elastic=WHOLE.elastic + 1.0,
    least_kinetic=0.5 * WHOLE.kinetic,
)
SIZES = [(85.0, 60.0), (85.0, 85.0), (170.0, 80.0), (170.0, 120.0)]
NEAREST = 9.0  # CIE L*, 0 black to 100 white: of neighbouring greys that stay apart in print


def lightness(color) -> float:
    """CIE L* of a colour, as a grey print shows it."""
    rgb = np.array(to_rgb(color))
    linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    y = float(linear @ (0.2126, 0.7152, 0.0722))
    return 116 * y ** (1 / 3) - 16 if y > 0.008856 else 903.3 * y


def drawn(made):
    """The figure after its layout is done."""
    with drawing():
        FigureCanvasAgg(made).draw()
    return made


def labelled_lines(made):
    return [line for axes in made.axes for line in axes.get_lines() if not line.get_label().startswith("_")]


def words(made):
    """Texts that are drawn: of the figure, its legends, and its axes with their ticks within the limits."""
    found = [*made.texts, *(text for legend in made.legends for text in legend.get_texts())]
    found += [legend.get_title() for legend in made.legends]
    for axes in made.axes:
        found += [*axes.texts, axes.title, axes._left_title, axes.xaxis.label, axes.yaxis.label]
        for axis in (axes.xaxis, axes.yaxis):
            low, high = sorted(axis.get_view_interval())
            for tick in axis.get_major_ticks():
                if low <= tick.get_loc() <= high:
                    found += [label for label in (tick.label1, tick.label2) if label.get_visible()]
    return [text for text in found if text.get_visible() and text.get_text().strip()]


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["pdf", "svg", "png"])
def test_files_have_the_size_asked_for(kind, tmp_path):
    for path in save_figures(WHOLE, tmp_path, agreement_with(WHOLE), format=kind, size=(85, 60)):
        data = path.read_bytes()
        if kind == "pdf":
            box = re.search(rb"/MediaBox \[ 0 0 (\S+) (\S+) \]", data)
            assert box is not None
            sides = [float(side) * 25.4 / 72 for side in box.groups()]
        elif kind == "svg":
            words = re.findall(r'(?:width|height)="([0-9.]+)pt"', data.decode())[:2]
            sides = sorted((float(side) * 25.4 / 72 for side in words), reverse=True)
        else:
            sides = [int.from_bytes(data[at : at + 4], "big") * 25.4 / 300 for at in (16, 20)]
        assert sides == pytest.approx([85.0, 60.0], abs=0.1), path.name


@pytest.mark.slow
def test_text_stays_text(tmp_path):
    """In a PDF as an embedded TrueType font, in an SVG as text."""
    save_figures(WHOLE, tmp_path, format="pdf")
    save_figures(WHOLE, tmp_path, format="svg")
    for path in tmp_path.glob("*.pdf"):
        data = path.read_bytes()
        assert b"/Type0" in data or b"/TrueType" in data
        assert b"/FontFile2" in data
        assert b"/Type3" not in data.replace(b"/Type 3", b"/Type3")
        assert b"CreationDate" not in data
    svg = (tmp_path / "energies.svg").read_text(encoding="utf-8")
    assert ">time [s]</text>" in svg
    assert ">energy change [J]</text>" in svg
    assert "<dc:date>" not in svg


@pytest.mark.slow
def test_the_same_bytes_in_every_process(tmp_path):
    """Under different seeds of Python's hashes, and at another time."""
    exunet.save(WHOLE, tmp_path / "result.h5")
    program = "import sys, exunet; r = exunet.load_result(sys.argv[1])\n" + "\n".join(
        f"exunet.save_figures(r, sys.argv[2], format={kind!r}, size=(85, 60), title=True)"
        for kind in ("pdf", "svg")
    )
    for seed in ("1", "2"):
        command = [sys.executable, "-c", program, str(tmp_path / "result.h5"), str(tmp_path / seed)]
        environment = os.environ | {"PYTHONHASHSEED": seed, "SOURCE_DATE_EPOCH": f"{seed}00000000"}
        done = subprocess.run(command, capture_output=True, text=True, check=False, env=environment)
        assert done.returncode == 0, done.stderr
    files = sorted((tmp_path / "1").iterdir())
    assert len(files) == 2 * 9
    for path in files:
        assert path.read_bytes() == (tmp_path / "2" / path.name).read_bytes(), path.name


@pytest.mark.parametrize(
    ("size", "complete"), list(zip(SIZES, (True, False, True, False), strict=True)), ids=str
)
def test_pages_are_legible(size, complete):
    """At a column's width and at a page's: words inside the figure, clear of each other, large enough."""
    of = replace(
        STRETCHED, complete=complete, verdict="ok" if complete else "speed 1e9 m/s at node 3, and more"
    )
    for name, made in figures(of, agreement_with(of), size=size, title=not complete).items():
        shown = words(drawn(made))
        assert made.get_size_inches() * 25.4 == pytest.approx(size)
        assert min(text.get_fontsize() for text in shown) >= 7.0, name  # points
        boxes = [(text.get_text(), text.get_window_extent()) for text in shown]
        for word, box in boxes:
            inside = box.x0 >= 0 and box.y0 >= 0 and box.x1 <= made.bbox.x1 and box.y1 <= made.bbox.y1
            assert inside, (name, word)
        for (one, a), (other, b) in itertools.combinations(boxes, 2):
            assert not a.padded(-1.0).overlaps(b.padded(-1.0)), (name, one, other)
        if len(made.axes) == 1 and name not in ("reference_net", "tensions"):
            box = made.axes[0].get_position()
            assert box.width > 0.6, name
            assert box.height > 0.4, name


@pytest.mark.parametrize("size", [None, (85.0, 60.0)], ids=str)
def test_small_scenes_of_short_runs_are_legible(size):
    """0.2 m and 4 ms: numbers of many digits, which neither push labels off the page nor touch each other."""
    of = unfolding(net([(-0.1, 0, 0), (0, 0, 0), (0.1, 0, 0)], [(0, 1), (1, 2)]), lift=2.0)
    of = replace(of, time=4e-3 * of.time, position=of.position[..., [0, 2, 1]])
    for name, made in figures(of, size=size).items():
        boxes = [(text.get_text(), text.get_window_extent()) for text in words(drawn(made))]
        for word, box in boxes:
            inside = box.x0 >= 0 and box.y0 >= 0 and box.x1 <= made.bbox.x1 and box.y1 <= made.bbox.y1
            assert inside, (name, word)
        for (one, a), (other, b) in itertools.combinations(boxes, 2):
            assert not a.padded(-1.0).overlaps(b.padded(-1.0)), (name, one, other)
    assert figure(of, "energies").axes[1].get_xlabel() == "time [$10^{-3}$ s]"


def test_many_curves_are_dark_over_light():
    """Where all coincide the darkest shows."""
    angles = np.arange(10)
    many = net(
        [(np.cos(a), np.sin(a), 0) for a in angles], [(k, (k + 1) % 10) for k in range(10)], tuple(angles)
    )
    lines = figure(unfolding(many), "bullet_speeds").axes[0].get_lines()
    grey = [lightness(line.get_color()) for line in sorted(lines, key=lambda line: line.get_zorder())]
    assert len(grey) == 10
    assert np.all(np.diff(grey) < 0)


def test_curves_at_zero_stand_clear_of_the_axis():
    made = figure(replace(WHOLE, tension=0 * WHOLE.tension), "largest_tension")
    assert made.axes[0].get_ylim() == pytest.approx((-0.02, 1.05))


def test_axes_have_units():
    for name, made in figures(STRETCHED, agreement_with(STRETCHED)).items():
        outer = [label for axes in made.axes for label in (axes.get_xlabel(), axes.get_ylabel()) if label]
        assert outer, name
        for label in outer:
            assert label.endswith("]") or label == "relative area", (name, label)


def test_no_title_unless_asked():
    for name, made in figures(WHOLE, agreement_with(WHOLE)).items():
        titled = figure(WHOLE, name, agreement=agreement_with(WHOLE), title=True)
        words = {text.get_text() for text in made.findobj(matplotlib.text.Text)}
        more = {text.get_text() for text in titled.findobj(matplotlib.text.Text)} - words
        assert len(more) == 1, name  # the title, and nothing else
        assert made.get_suptitle() == ""


@pytest.mark.parametrize("count", range(2, MOST_CURVES + 1))
def test_styles_are_told_apart_in_grey(count):
    styles = curve_styles(count)
    grey = [lightness(style["color"]) for style in styles]
    assert max(grey) < 90  # on white paper
    assert min(abs(a - b) for a, b in itertools.combinations(grey, 2)) >= NEAREST
    assert len({style["marker"] for style in styles}) == count
    assert len({(str(style["linestyle"]), style["marker"]) for style in styles}) == count


def test_curves_of_each_figure_are_told_apart_in_grey():
    """By their grey; where that is near, by line or marker: and six bullets by all three."""
    six = unfolding(SIX)
    made = figures(STRETCHED, agreement_with(STRETCHED)) | {"six": figure(six, "bullet_speeds")}
    falling = replace(WHOLE, potential=-np.linspace(0, 9, 7))
    made["falling"] = figure(falling, "energies")
    for name, one in made.items():
        for a, b in itertools.combinations(labelled_lines(one), 2):
            apart = abs(lightness(a.get_color()) - lightness(b.get_color())) >= NEAREST
            styles = [(line.get_linestyle(), str(line._dash_pattern), line.get_marker()) for line in (a, b)]
            assert apart or styles[0] != styles[1], (name, a.get_label(), b.get_label())
    assert len(labelled_lines(made["six"])) == 6


def test_rendered_bullets_differ_in_grey_levels():
    """Six bullets that fly apart, as pixels: each curve's grey is there, and no two are the same."""
    of = unfolding(SIX)
    speeds = np.arange(1, 7)[:, None] * np.array([1.0, 0.0, 0.0])
    of = replace(of, velocity=np.broadcast_to(speeds, of.velocity.shape).copy())
    made = figure(of, "bullet_speeds", size=(85, 60))
    for line in made.axes[0].get_lines():
        line.set(marker="", linestyle="-", linewidth=3.0)
    drawn(made)
    pixels = np.asarray(made.canvas.buffer_rgba())[..., :3]
    seen = []
    for k in range(6):
        x, y = made.axes[0].transData.transform((0.5, k + 1.0))
        seen.append(lightness(pixels[pixels.shape[0] - 1 - round(y), round(x)] / 255))
    assert min(abs(a - b) for a, b in itertools.combinations(seen, 2)) >= NEAREST - 1


def test_tensions_are_drawn_by_grey_and_by_width():
    """The larger, the darker and the broader; elements that no tension reached are dotted."""
    shades = [lightness(color) for color in tension_colors()(np.linspace(0, 1, 32))]
    assert np.all(np.diff(shades) < 0)
    assert shades[0] < 90
    assert shades[0] - shades[-1] > 60
    peaks = np.arange(STRETCHED.net.n_elements, dtype=float)
    made = tension_map(STRETCHED, Page(), peaks)
    slack, taut = (one for one in made.axes[0].collections if isinstance(one, LineCollection))
    assert len(slack.get_segments()) == 1
    np.testing.assert_array_equal(taut.get_array(), peaks[1:])
    assert np.all(np.diff(taut.get_linewidths()) > 0)
    first = STRETCHED.net.reference_position[STRETCHED.net.element_nodes[1], :2]
    np.testing.assert_array_equal(taut.get_segments()[0], first)
    assert made.axes[-1].get_xlim() == (0.0, peaks.max())


def test_the_figure_of_tensions_says_which_they_are():
    made = figure(STRETCHED, "tensions")
    assert made.axes[-1].get_xlabel() == "largest tension at the stored times of this run [N]"
    lines = [one for one in made.axes[0].collections if isinstance(one, LineCollection)][-1]
    np.testing.assert_array_equal(np.sort(lines.get_array()), np.sort(STRETCHED.tension.max(axis=0)))
    np.testing.assert_array_equal(metrics.peak_tensions(STRETCHED), STRETCHED.tension.max(axis=0))
    peaks = np.arange(1.0, STRETCHED.net.n_elements + 1.0)
    run = replace(STRETCHED, provenance=STRETCHED.provenance | {"peak_tensions_N": peaks.tolist()})
    made = figure(run, "tensions")
    assert made.axes[-1].get_xlabel() == "largest tension of all steps of this run [N]"
    assert made.axes[-1].get_xlim() == (0.0, peaks[: STRETCHED.net.n_net_elements].max())
    slack = figure(replace(WHOLE, tension=0 * WHOLE.tension), "tensions")
    assert len(slack.axes) == len(made.axes) - 1  # no colour bar


def test_tensions_beyond_the_horizon_are_told_as_those_of_this_run():
    """The range of the largest stands on the colour bar; only a known value is told without `of this run`."""
    peaks = np.arange(STRETCHED.net.n_elements, dtype=float)
    ranged = Judged(headline("largest_tension_N"), 8, 9.0, 5.0, 1.5 * peaks.max())
    bar = tension_map(STRETCHED, Page(), peaks, ranged).axes[-1]
    assert bar.get_xlabel() == "largest tension at the stored times of this run [N]"
    assert bar.get_xlim() == (0.0, ranged.largest)
    (line,) = bar.get_lines()
    np.testing.assert_array_equal(line.get_xdata(), [5.0, ranged.largest])
    known = replace(ranged, value=peaks.max(), error=1e-3)
    bar = tension_map(STRETCHED, Page(), peaks, known).axes[-1]
    assert bar.get_xlabel() == "largest tension at the stored times [N]"
    assert not bar.get_lines()
    assert bar.get_xlim() == (0.0, peaks.max())


def test_history_of_the_largest_tension_and_its_mark():
    peak = {"tension_N": 7.0, "time_s": 0.37, "element": 4}
    told = replace(STRETCHED, provenance=STRETCHED.provenance | {"largest_tension": peak})
    curve, mark = labelled_lines(figure(told, "largest_tension"))
    np.testing.assert_array_equal(curve.get_ydata(), STRETCHED.tension.max(axis=1))
    assert (mark.get_xdata()[0], mark.get_ydata()[0]) == (0.37, 7.0)
    assert mark.get_label() == "largest of all steps of this run"
    assert len(labelled_lines(figure(STRETCHED, "largest_tension"))) == 1  # older results do not tell it


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"name": "speeds"}, "'speeds' is not one of reference_net"),
        ({"name": "agreement"}, "cannot have 'agreement'"),
        ({"name": "area", "size": (10, 60)}, "from 40 mm to 1000 mm, got 10 mm x 60 mm"),
        ({"name": "area", "size": (85, float("nan"))}, "from 40 mm"),
        ({"name": "area", "size": (85,)}, "must be .width, height. in millimetres"),
        ({"name": "area", "size": "a4"}, "must be .width, height. in millimetres"),
    ],
)
def test_arguments_that_cannot_be_used(arguments, words):
    with pytest.raises(InputError, match=words):
        figure(WHOLE, **arguments)


def test_a_size_without_room_for_the_figure_is_refused_before_anything_is_written(tmp_path):
    """Legends alone are higher than 40 mm; what is said to be enough for a figure is."""
    for name in ("area.png", "energies.png"):
        (tmp_path / name).write_text("of before")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(InputError, match="no room beside its texts: give 40 mm x ") as refused:
            save_figures(FULL, tmp_path, size=(40.0, 40.0), overwrite=True)
        name, least = re.search(
            r"leave (\w+) no room .* 40 mm x (\d+) mm or more", str(refused.value)
        ).groups()
        enough = float(least)
        assert enough > 40.0
        assert {path.read_text() for path in tmp_path.iterdir()} == {"of before"}
        made = figure(FULL, name, size=(40.0, enough))
        drawn(made)
    assert made.axes[0].get_position().height * enough > 5.0


def test_figures_that_are_there_are_replaced_only_when_asked(tmp_path):
    """Of whatever result, as by `exunet.save` and `exunet plot`; those of another format are left alone."""
    (tmp_path / "area.svg").write_text("of before")
    (tmp_path / "area.png").write_text("of before")
    with pytest.raises(InputError, match=r"such as area\.png: give another, or overwrite=True"):
        save_figures(WHOLE, tmp_path)
    assert {path.read_text() for path in tmp_path.iterdir()} == {"of before"}


def test_a_format_that_is_not_known_makes_no_folder(tmp_path):
    with pytest.raises(InputError, match="format: must be one of pdf, svg, png, got 'gif'"):
        save_figures(WHOLE, tmp_path / "new", format="gif")
    assert not (tmp_path / "new").exists()


@pytest.mark.slow
def test_the_command_draws_what_is_asked(tmp_path):
    exunet.save(WHOLE, tmp_path / "result.h5")
    options = ["--format", "pdf", "--size", "90x60", "--title", "--out", str(tmp_path / "new")]
    done = CliRunner().invoke(app, ["plot", str(tmp_path / "result.h5"), *options])
    assert done.exit_code == 0, done.output
    made = sorted((tmp_path / "new").iterdir())
    no_bodies = {"loads.pdf", "distances.pdf", "tethers.pdf"}
    no_contact = {"contacts.pdf", "capture.pdf", "closing.pdf", "control.pdf"}
    drawn = {f"{name}.pdf" for name in FIGURES} - {"agreement.pdf", *no_bodies, *no_contact}
    assert {path.name for path in made} == drawn
    save_figures(WHOLE, tmp_path / "api", format="pdf", size=(90, 60), title=True)
    assert all(path.read_bytes() == (tmp_path / "api" / path.name).read_bytes() for path in made)
    for size in ("90", "90x", "axb", "1x2x3"):
        done = CliRunner().invoke(app, ["plot", str(tmp_path / "result.h5"), "--size", size])
        assert isinstance(done.exception, InputError)
        assert "--size: give width x height" in str(done.exception)


def test_legends_have_as_many_columns_as_fit():
    assert columns_that_fit(["a"] * 4, 1000.0) == 4
    assert columns_that_fit(["a"] * 4, 90.0) == 2
    assert columns_that_fit(["a long label that fills the line"], 20.0) == 1


def test_words_are_cut_to_a_width():
    assert fitted("short", 200.0, 8.0) == "short"
    cut = fitted("wide words " * 50, 200.0, 8.0)
    assert cut.endswith("...")
    assert 180.0 < text_width(cut, 8.0) <= 200.0


def test_every_figure_has_words_and_the_page_lists_them():
    page = (Path(__file__).parent.parent / "docs" / "results.md").read_text(encoding="utf-8")
    for name in FIGURES:
        assert f"`{name}`" in page, name
