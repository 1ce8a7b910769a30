"""The page of a result: what it shows in a real browser equals the file; nothing in it becomes HTML."""

from __future__ import annotations

import base64
import gzip
import hashlib
import itertools
import re
import shutil
import subprocess
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browser import NEEDS_CHROMIUM, Page, chromium
from result_samples import RESULTANT, result, square_net, unfolding
from result_samples import around_a_box as scene
from scenes import SHIPPED_CASES

import exunet
from exunet.base.errors import InputError, RunStopped
from exunet.bodies.rotations import rotation_matrix
from exunet.net.arrays import TetherNodes
from exunet.plots.view import STEPS, page, save_view, write_page
from exunet.results.observables import Observables
from exunet.results.outcome import Outcome, outcome
from exunet.results.run_record import Peak
from exunet.results.summary import timeline
from exunet.results.table import ReportContent
from exunet.scene.capture import Capture

CASES = Path(__file__).resolve().parents[2] / "cases"
VIEWER = Path(exunet.__file__).parent / "plots" / "viewer"
HOSTILE = "</script><script>window.injected = true</script><img src=x onerror='window.injected = true'>"


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Page]:
    with chromium(tmp_path_factory.mktemp("profile")) as opened:
        yield opened


def shown(browser: Page, folder: Path, *runs: Any, **options: Any) -> Page:
    """Open the page of runs."""
    browser.problems.clear()
    browser.requests.clear()
    write_page(folder / "view.html", runs, **options)
    browser.open(folder / "view.html")
    return browser


def origin(of: Any) -> np.ndarray:
    """Return the point from which a page has the positions of a run [m]: its corner at the start."""
    return np.concatenate([of.position[0], *(body.position[:1] for body in of.bodies.values())]).min(axis=0)


def faultless(browser: Page) -> bool:
    """True if nothing went wrong in the page, and it requested nothing but itself."""
    strange = [url for url in browser.requests if not url.startswith(("file:", "data:", "blob:"))]
    assert browser.problems == []
    assert strange == []
    return True


def moved(of: Any, way: Any) -> Any:
    """Return a run elsewhere [m]."""
    bodies = {name: replace(body, position=body.position + way) for name, body in of.bodies.items()}
    return replace(of, position=of.position + way, bodies=bodies)


@NEEDS_CHROMIUM
@pytest.mark.parametrize("way", [[0.0, 0.0, 0.0], [7e6, -2e6, 1e6]], ids=["near", "in orbit"])
def test_page_shows_the_states_of_the_file(browser: Page, tmp_path: Path, way: list[float]) -> None:
    """Positions to half of 1/65000 of the scene, tensions to half a step of their scale of 16 bits."""
    of = moved(scene(), np.array(way))
    run = "viewer.runs[0]"
    seen = shown(browser, tmp_path, of)
    points = np.concatenate([of.position.reshape(-1, 3), of.bodies["box"].position])
    resolution = np.ptp(points, axis=0).max() / STEPS
    position = np.array(seen.evaluate(f"Array.from({run}.position)")).reshape(of.position.shape)
    np.testing.assert_allclose(position + origin(of), of.position, rtol=0, atol=0.51 * resolution)
    tension = np.array(seen.evaluate(f"Array.from({run}.tension)")).reshape(of.tension.shape)
    step = np.sqrt(of.tension / of.tension.max()) / 65535 + 1 / 65535**2
    assert (np.abs(tension - of.tension) <= (step + 1e-7) * of.tension.max()).all()
    np.testing.assert_array_equal(tension == 0.0, of.tension == 0.0)
    assert seen.evaluate(f"Array.from({run}.time)") == of.time.tolist()
    assert seen.evaluate(f"Array.from({run}.elements)") == of.net.element_nodes.ravel().tolist()
    body = f"{run}.bodies[0]"
    place = np.array(seen.evaluate(f"Array.from({body}.position)")).reshape(-1, 3)
    np.testing.assert_allclose(place + origin(of), of.bodies["box"].position, rtol=0, atol=resolution / 2)
    point, forced = np.array(seen.evaluate(f"Array.from({body}.point)")).reshape(-1, 3)[6], RESULTANT
    arm, across = point + origin(of) - of.bodies["box"].position[6], [0.05, -0.02, 0.01]
    torque = rotation_matrix(of.bodies["box"].attitude[[6]])[0] @ across
    torque -= (torque @ forced) / (forced @ forced) * forced
    np.testing.assert_allclose(np.cross(arm, forced), torque, rtol=0, atol=2 * resolution)
    corners = np.array(seen.evaluate(f"Array.from({body}.vertices)")).reshape(-1, 3)
    np.testing.assert_allclose(corners.max(axis=0), [0.1, 0.15, 0.2], rtol=1e-6)
    beyond = np.maximum(np.abs(corners) - [0.05, 0.1, 0.15], 0.0)  # the core of a box with round edges
    np.testing.assert_allclose(np.linalg.norm(beyond, axis=1), 0.05, rtol=1e-5)
    energy = f"{run}.series.find(item => item.name === 'kinetic').values"
    np.testing.assert_allclose(seen.evaluate(energy), of.kinetic, rtol=1e-6, atol=1e-30)
    assert faultless(seen)


@NEEDS_CHROMIUM
def test_report_begins_with_the_answer(browser: Page, tmp_path: Path) -> None:
    """At 1366 x 768 the answer is above the plots; case and provenance are folded, and open to print."""
    report = ReportContent(
        [("NOT CAPTURED", "'box' missed"), ("Why", "it is slow")],
        [("a", "1 N   2 J")],
        "a = 1\n",
        [("seed", "0")],
    )
    write_page(tmp_path / "report.html", [scene()], report)
    browser.open(tmp_path / "report.html", width=1366, height=768)
    bottom, plots = browser.evaluate(
        "['#answer', '#plots'].map(name => document.querySelector(name).getBoundingClientRect())"
        ".map((box, k) => k ? box.top : box.bottom)"
    )
    assert 0.0 < bottom <= plots < 768.0
    assert browser.evaluate("[...document.querySelectorAll('#table td *')].map(c => c.textContent)") == [
        "1 N",
        "2 J",
    ]
    assert browser.evaluate("document.querySelector('.section pre').textContent") == "a = 1\n"
    opened = "[...document.querySelectorAll('.section')].map(section => section.open)"
    assert browser.evaluate(opened) == [False, False]
    assert browser.evaluate(f"(dispatchEvent(new Event('beforeprint')), {opened})") == [True, True]
    browser.evaluate("dispatchEvent(new Event('afterprint'))")


@NEEDS_CHROMIUM
@pytest.mark.parametrize("name", ["CAPTURED", "NOT CAPTURED", "UNDETERMINED"])
def test_narrow_page_shows_the_outcome_first_and_cuts_nothing(
    browser: Page, tmp_path: Path, name: str
) -> None:
    """At 400 x 800: the outcome is the topmost text, and each control is within the page."""
    write_page(tmp_path / "report.html", [scene()], ReportContent([(name, "'box'")], [], "", []))
    browser.open(tmp_path / "report.html", width=400, height=800)
    first = browser.evaluate("document.querySelector('header').firstElementChild.textContent")
    assert first.split(maxsplit=1)[1] == name
    assert not first[0].isalnum()  # a sign, not colour alone
    boxes = browser.evaluate(
        "[...document.querySelectorAll('header > *, nav > *, footer > *, #events button, .key, .key *')]"
        ".map(e => e.getBoundingClientRect()).filter(b => b.width).map(b => [b.left, b.right])"
    )
    assert len(boxes) > 20
    assert min(left for left, _ in boxes) >= 0.0
    assert max(right for _, right in boxes) <= 400.0
    inside = browser.evaluate(
        "[...document.querySelectorAll('select')].every(e => e.scrollWidth <= e.clientWidth + 1)"
    )
    assert inside


@NEEDS_CHROMIUM
def test_page_opens_at_the_capture_or_the_largest_tension(browser: Page, tmp_path: Path) -> None:
    """Numbers beside plots are of the state that is drawn, as are those of contact."""
    of = scene()
    seen = shown(browser, tmp_path, of)
    assert seen.evaluate("viewer.now") == of.time[of.tension.max(axis=1).argmax()]
    number = "document.querySelector('#plots output').textContent"
    near = float(0.4 * of.time[4] + 0.6 * of.time[5])
    assert seen.evaluate(f"(viewer.set({near}), {number})") == seen.evaluate(
        f"(viewer.set({of.time[5]}), {number})"
    )
    rule = Capture(target="box", relative_speed=1e9, duration=0.1)
    captured = replace(of, run=replace(of.run, capture=rule))
    judged = outcome(Observables(captured))
    assert judged is not None
    assert judged.outcome is Outcome.CAPTURED
    write_page(tmp_path / "captured.html", [Observables(captured)])
    browser.open(tmp_path / "captured.html")
    assert browser.evaluate("viewer.now") == judged.since


@NEEDS_CHROMIUM
def test_threads_and_bodies_are_drawn_where_the_file_has_them(browser: Page, tmp_path: Path) -> None:
    """Ends of tubes, their colours on the scale of the legend, and poses of bodies, at stored times."""
    of = scene()
    seen = shown(browser, tmp_path, of)
    seen.evaluate("viewer.setTheme('dark')")
    table = np.array(seen.evaluate("Array.from(viewer.scenes[0].look.table)")).reshape(-1, 3)
    slack = seen.evaluate("viewer.scenes[0].look.slack")
    assert not (np.abs(table - slack).max(axis=1) < 1e-3).any()
    assert len(np.unique(table, axis=0)) == 256
    largest = of.tension.max()
    whole = np.arange(of.net.n_elements) != 5  # it breaks
    for k in (0, 3, 6):
        threads = "viewer.scenes[0].threads"
        before = seen.evaluate(f"[{threads}.instanceMatrix.version, {threads}.instanceColor.version]")
        seen.evaluate(f"viewer.set({of.time[k]}), viewer.render()")
        tubes = np.array(seen.evaluate(f"Array.from({threads}.instanceMatrix.array)")).reshape(-1, 4, 4)
        start, end = (of.position[k, of.net.element_nodes[:, side]] - origin(of) for side in (0, 1))
        np.testing.assert_allclose(tubes[:, 3, :3], start, atol=1e-4)
        np.testing.assert_allclose(tubes[:, 3, :3] + tubes[:, 2, :3], end, atol=1e-4)
        colors = np.array(seen.evaluate(f"Array.from({threads}.instanceColor.array)")).reshape(-1, 3)
        sent = seen.evaluate(f"[{threads}.instanceMatrix.version, {threads}.instanceColor.version]")
        assert min(np.subtract(sent, before)) > 0  # what is drawn is a copy, sent where the version grows
        taut = of.tension[k] > 0.0
        np.testing.assert_allclose(colors[~taut], np.broadcast_to(slack, (int((~taut).sum()), 3)), atol=1e-6)
        part = 255 * np.sqrt(of.tension[k] / largest)
        near = [table[[int(np.floor(p)), int(np.ceil(p))]] for p in part]  # rounded to one of these
        found = [np.abs(pair - color).max(axis=1).min() for pair, color in zip(near, colors, strict=True)]
        assert np.array(found)[taut & whole].max() < 1e-6
        pose = np.array(seen.evaluate("Array.from(viewer.scenes[0].bodies[0].group.matrixWorld.elements)"))
        turn = rotation_matrix(of.bodies["box"].attitude[[k]])[0]
        np.testing.assert_allclose(pose.reshape(4, 4)[:3, :3].T, turn, atol=1e-6)
        place = of.bodies["box"].position[k] - origin(of)
        np.testing.assert_allclose(pose.reshape(4, 4)[3, :3], place, atol=1e-6)
    assert faultless(seen)


@NEEDS_CHROMIUM
def test_page_is_scrubbed_played_and_measured(browser: Page, tmp_path: Path) -> None:
    of = scene()
    seen = shown(browser, tmp_path, of)
    pictures = []
    for time in (0.0, 0.5, 1.0):
        seen.evaluate(f"viewer.set({time})")
        assert seen.evaluate("document.getElementById('clock').textContent") == f"{time:.2f} s"
        pictures.append(seen.picture())
    seen.evaluate("viewer.setTheme('light')")
    pictures.append(seen.picture())
    seen.evaluate("viewer.setFollow('0\\0box'), viewer.fit([1, 0, 0])")
    pictures.append(seen.picture())
    assert len(set(pictures)) == len(pictures)
    # Between two stored times positions are interpolated.
    seen.evaluate(f"viewer.set({0.5 * (of.time[2] + of.time[3])})")
    between = np.array(seen.evaluate("Array.from(viewer.scenes[0].at)")).reshape(-1, 3)
    np.testing.assert_allclose(between + origin(of), 0.5 * (of.position[2] + of.position[3]), atol=1e-4)
    # The distance of two nodes that are clicked.
    seen.evaluate("viewer.set(1), viewer.setFollow(''), viewer.fit([0, 0, 1]), viewer.setMeasuring(true)")
    seen.picture()
    spots = seen.evaluate(
        "[0, 8].map(node => { const p = new viewer.camera.position.constructor().fromArray("
        "viewer.scenes[0].at, 3 * node).project(viewer.camera), box = viewer.renderer.domElement"
        ".getBoundingClientRect(); return [box.left + (0.5 + 0.5 * p.x) * box.width, "
        "box.top + (0.5 - 0.5 * p.y) * box.height]; })"
    )
    for (x, y), kind in itertools.product(spots, ("mousePressed", "mouseReleased")):
        seen.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", clickCount=1)
    seen.picture()
    distance = float(np.linalg.norm(of.position[-1, 0] - of.position[-1, 8]))
    assert seen.evaluate("document.querySelector('.pick').textContent").startswith(f"{distance:.4g} m")
    seen.call("Input.dispatchKeyEvent", type="keyDown", key="Home")
    assert seen.evaluate("viewer.now") == 0.0
    seen.call("Input.dispatchKeyEvent", type="keyDown", key="ArrowRight")
    assert seen.evaluate("viewer.now") == of.time[1]
    size = seen.evaluate("new Promise(done => viewer.save().toBlob(blob => done(blob.size)))")
    assert size > 1000
    assert faultless(seen)


@NEEDS_CHROMIUM
def test_contact_breaks_and_events_are_shown(browser: Page, tmp_path: Path) -> None:
    of = scene()
    seen = shown(browser, tmp_path, of)
    before, after = (f"(viewer.set({time}), viewer.scenes[0].contacts.count)" for time in (0.1, 1.0))
    assert seen.evaluate(before) == 0
    assert seen.evaluate(after) > 0
    assert "1.50 N" in seen.evaluate("document.getElementById('status').textContent")
    width = "Math.hypot(...viewer.scenes[0].threads.instanceMatrix.array.slice(80, 83))"
    color = "Array.from(viewer.scenes[0].threads.instanceColor.array.slice(15, 18))"
    held = seen.evaluate(f"(viewer.set({of.time[4]}), {color})")  # the last stored state before the break
    assert seen.evaluate(f"(viewer.set(0.799), {width})") > 0.0
    assert seen.evaluate(color) == held
    assert seen.evaluate(f"(viewer.set(0.8), {width})") == 0.0
    assert seen.evaluate(f"(viewer.set(0.9), {width})") == 0.0
    marks = [(time, words) for time, words, _ in seen.evaluate("viewer.runs[0].events")]
    assert seen.evaluate("document.querySelectorAll('#marks button').length") == len(marks)
    assert {(event.time, event.name) for event in timeline(Observables(of))} == {
        (0.5, "meets"),
        (0.6, "contact with box"),  # between two stored states
        (0.8, "first break"),
    }
    listed = [(item["time_s"], item["event"]) for item in exunet.summarise(of)["timeline"]]
    assert [(time, words.partition(":")[0]) for time, words in marks if "largest" not in words] == listed
    (of_line,) = (words for time, words in marks if time == 0.75)
    assert "closing line" in of_line
    assert "2.5 N" in of_line
    seen.evaluate(
        "[...document.querySelectorAll('#events button')].find(b => /meets$/.test(b.textContent)).click()"
    )
    assert seen.evaluate("viewer.now") == 0.5
    assert seen.evaluate("viewer.scenes[0].line.count") == 4
    assert faultless(seen)


@NEEDS_CHROMIUM
def test_forces_of_contact_are_arrows_to_the_scale_of_the_legend(browser: Page, tmp_path: Path) -> None:
    """The length of each at a stored time times the scale is the force; they have its direction and line."""
    of = scene()
    seen = shown(browser, tmp_path, of)
    found = re.search(
        r"force on a body, (\S+) N per m", seen.evaluate("document.querySelector('.signs').textContent")
    )
    assert found
    arrow = "viewer.scenes[0].bodies[0].arrow"
    assert not seen.evaluate(f"(viewer.set(0), {arrow}.visible)")
    for k in (4, 5, 6):
        seen.evaluate(f"(viewer.set({of.time[k]}), {arrow}.updateMatrixWorld())")
        along = np.array(seen.evaluate(f"Array.from({arrow}.matrixWorld.elements)")).reshape(4, 4)[2:, :3]
        force = of.time[k] * RESULTANT
        np.testing.assert_allclose(along[0] * float(found[1]), force, rtol=1e-5)
        centre, turn = (
            of.bodies["box"].position[k] - origin(of),
            rotation_matrix(of.bodies["box"].attitude[[k]])[0],
        )
        arm = along[1] - centre
        assert abs(arm @ force) < 1e-6
        across = turn @ [0.05, -0.02, 0.01]
        across -= (across @ force) / (force @ force) * force
        np.testing.assert_allclose(np.cross(arm, force), across, atol=1e-6)
    assert "resultant 1.30 N" in seen.evaluate("document.getElementById('status').textContent")
    assert faultless(seen)


@NEEDS_CHROMIUM
def test_marks_of_peaks_have_value_element_and_nearest_state(browser: Page, tmp_path: Path) -> None:
    """Between two stored states, as a run reports it."""
    of = scene()
    run = replace(of.run, largest_tensions={"net": Peak(2.5, 0.6, 14)})
    seen = shown(browser, tmp_path, replace(of, run=run))
    mark = "[...document.querySelectorAll('#marks button')].find(b => /tension of the net/.test(b.title))"
    seen.evaluate(f"{mark}.click()")
    assert seen.evaluate("viewer.now") == 0.6
    title = seen.evaluate(f"{mark}.title")
    first, last = of.net.element_nodes[14]
    assert "2.5 N" in title
    assert f"element 14 (node {first} to bullet {of.net.bullet_nodes.tolist().index(last)})" in title
    assert title.endswith(f"{of.time[4]:.6g} s")
    assert faultless(seen)


@NEEDS_CHROMIUM
def test_measures_of_a_capture_are_plots(browser: Page, tmp_path: Path) -> None:
    of = scene()
    of = replace(of, run=replace(of.run, capture=Capture(target="box", enclosed=0.9, duration=0.1)))
    seen = shown(browser, tmp_path, of)
    series = "viewer.runs[0].series.find(item => item.name === '{}')"
    known = Observables(of).capture
    assert known is not None
    for name in ("enclosed", "cqi", "mcqi"):
        item = series.format(name)
        np.testing.assert_allclose(seen.evaluate(f"{item}.values"), getattr(known, name), rtol=1e-6)
        assert seen.evaluate(f"Array.from({item}.time)") == of.time.tolist()
    choices = seen.evaluate("document.getElementById('more').textContent")
    assert all(words in choices for words in ("capture", "diameter of the mouth"))
    assert faultless(seen)


@NEEDS_CHROMIUM
def test_up_strength_and_fit(browser: Page, tmp_path: Path) -> None:
    of = scene()
    strong = replace(of.net, strength=np.where(np.arange(of.net.n_elements) < 8, 4.0, 0.0))
    seen = shown(browser, tmp_path, replace(of, net=strong, run=replace(of.run, up=[0.0, 0.0, 1.0])))
    assert seen.evaluate("viewer.camera.up.toArray()") == [0.0, 0.0, 1.0]
    assert seen.evaluate("document.getElementById('end').value") == "strength"
    assert "strength" in seen.evaluate("document.querySelector('.key').firstChild.textContent")
    # One scale a colour bar: taut threads without a strength have a colour of their own.
    colors = "(viewer.set(1), Array.from(viewer.scenes[0].threads.instanceColor.array))"
    relative = np.array(seen.evaluate(colors)).reshape(-1, 3)
    seen.evaluate("(e => { e.value = 'largest'; e.onchange(); })(document.getElementById('end'))")
    largest = np.array(seen.evaluate(colors)).reshape(-1, 3)
    taut = of.tension[-1] > 0.0
    assert len(np.unique(relative[8:][taut[8:]], axis=0)) == 1
    np.testing.assert_array_equal((relative == largest).all(axis=1)[~taut], True)
    assert not (relative == largest).all(axis=1)[taut].any()
    assert "to the largest of the states shown" in seen.evaluate(
        "document.querySelector('.key').firstChild.textContent"
    )
    # Fit while following keeps the body in the middle, and brings it nearer than the whole scene.
    far = seen.evaluate("(viewer.fit(), viewer.camera.position.distanceTo(viewer.controls.target))")
    seen.evaluate("viewer.setFollow('0\\0box'), viewer.set(0.5), viewer.fit(), viewer.set(1)")
    target = seen.evaluate("viewer.controls.target.toArray()")
    np.testing.assert_allclose(target + origin(of), of.bodies["box"].position[-1], atol=1e-4)
    assert seen.evaluate("viewer.camera.position.distanceTo(viewer.controls.target)") < far
    assert faultless(seen)


@NEEDS_CHROMIUM
def test_space_presses_a_button_that_has_the_focus_and_plays_else(browser: Page, tmp_path: Path) -> None:
    seen = shown(browser, tmp_path, scene())
    theme = "document.documentElement.dataset.theme"
    before = seen.evaluate(theme)
    key: dict[str, Any] = {"key": " ", "code": "Space", "windowsVirtualKeyCode": 32, "text": " "}

    def press() -> tuple[bool, bool]:
        for kind in ("keyDown", "keyUp"):
            seen.call("Input.dispatchKeyEvent", type=kind, **key)
        playing = seen.evaluate("document.getElementById('play').textContent") != "\u25b6"
        return seen.evaluate(theme) != before, playing

    seen.evaluate("[...document.querySelectorAll('nav button')].at(-1).focus()")
    assert press() == (True, False)
    seen.evaluate("document.activeElement.blur()")
    assert press() == (True, True)
    assert faultless(seen)


@NEEDS_CHROMIUM
def test_titles_and_names_are_text(browser: Page, tmp_path: Path) -> None:
    seen = shown(
        browser,
        tmp_path,
        scene(HOSTILE, HOSTILE),
        report=ReportContent(*4 * [[(HOSTILE, HOSTILE)]])._replace(case=HOSTILE),
    )
    assert seen.evaluate("window.injected") is None
    assert seen.evaluate("document.querySelectorAll('img').length") == 0
    assert seen.evaluate("document.querySelector('h1').textContent") == HOSTILE
    assert seen.evaluate("document.title") == " ".join(HOSTILE.split())
    assert HOSTILE in seen.evaluate("document.getElementById('labels').textContent")
    assert faultless(seen)


@NEEDS_CHROMIUM
def test_two_results_are_beside_each_other(browser: Page, tmp_path: Path) -> None:
    first, last = scene("first"), replace(scene("last"), time=2.0 * scene().time)
    seen = shown(browser, tmp_path, first, last)
    seen.evaluate("viewer.set(1)")
    at = seen.evaluate("viewer.scenes.map(item => Array.from(item.at))")
    for run, row, points in ((first, 6, at[0]), (last, 3, at[1])):
        np.testing.assert_allclose(np.reshape(points, (-1, 3)) + origin(first), run.position[row], atol=1e-4)
    assert seen.evaluate("+document.getElementById('bar').max") == 2.0
    seen.evaluate("viewer.set(1.99), viewer.move(1)")  # after the end of the first
    assert seen.evaluate("viewer.now") == last.time[-1]
    assert "ended at 1.00 s" in seen.evaluate("document.getElementById('status').textContent")
    seen.evaluate("viewer.setFollow('1\\0box')")
    target = seen.evaluate("viewer.controls.target.toArray()")
    np.testing.assert_allclose(target + origin(first), last.bodies["box"].position[-1], atol=1e-4)
    keys = "Array.from(document.querySelectorAll('.values b'), key => key.style.borderTopColor)"
    assert all(seen.evaluate(keys))
    assert faultless(seen)


SINGLE = square_net()
ODD = {
    "a single state": unfolding(square_net(strings=True), times=1),
    "all slack, at rest": result(SINGLE, [0.0, 1.0], [SINGLE.reference_position] * 2),
    "nodes in one point": result(SINGLE, [0.0, 1.0], np.zeros((2, 4, 3))),
    "incomplete": replace(scene(), run=replace(scene().run, verdict="energy")),
    "tethers alone": replace(
        unfolding(square_net()), net=replace(square_net(), tethers=(TetherNodes("tow", 3, (2, 3)),))
    ),
}


@NEEDS_CHROMIUM
@pytest.mark.parametrize("name", ODD)
def test_odd_results_load(browser: Page, tmp_path: Path, name: str) -> None:
    seen = shown(browser, tmp_path, ODD[name])
    seen.picture()
    assert ("INCOMPLETE" in seen.evaluate("document.body.textContent")) == (not ODD[name].complete)
    assert faultless(seen)


def test_page_is_deterministic_and_whole_or_absent(tmp_path: Path) -> None:
    of = scene()
    assert page([of]) == page([of])
    with pytest.raises(InputError):
        save_view(of, tmp_path / "missing" / "a.html")
    with pytest.raises(InputError, match=r"\.html"):
        save_view(of, tmp_path / "a.png")
    assert list(tmp_path.iterdir()) == []


@NEEDS_CHROMIUM
def test_paper_and_saved_picture_have_title_legend_and_names(browser: Page, tmp_path: Path) -> None:
    """What is printed is the picture that is saved, in light colours, and of two runs it names both."""
    seen = shown(browser, tmp_path, scene("first"), scene("last"))
    seen.evaluate(
        "window.written = [], (text => CanvasRenderingContext2D.prototype.fillText = function (...all) {"
        " written.push(all[0]); text.apply(this, all); })(CanvasRenderingContext2D.prototype.fillText)"
    )
    seen.evaluate("viewer.set(0.5), dispatchEvent(new Event('beforeprint'))")
    assert seen.evaluate("document.documentElement.dataset.theme") == "light"
    written = seen.evaluate("written")
    assert {"first | last   t = 0.50 s", "A: first", "B: last", "box", "bullet", "path of a bullet"} <= {
        *written
    }
    assert {"slack thread", "contact", "closing line"} <= {*written}
    shades = (
        "new Set(new Uint32Array(document.getElementById('sheet').getContext('2d')"
        ".getImageData(0, 0, innerWidth / 2, 300).data.buffer)).size"
    )
    assert seen.evaluate(shades) > 20  # the scene is in it
    seen.evaluate("dispatchEvent(new Event('afterprint'))")
    assert seen.evaluate("document.getElementById('sheet')") is None
    assert seen.evaluate("document.documentElement.dataset.theme") == "dark"
    assert faultless(seen)


def shown_case(browser: Page, folder: Path, name: str, end: float) -> Page:
    """Run a shipped case to a time [s], open its page, and look at it; a run that stops is shown too."""
    try:
        of = exunet.run(exunet.load(CASES / f"{name}.toml", [f"time.end={end!r}"]))
    except RunStopped as error:
        of = error.result or pytest.fail(f"{name}: {error}")
    seen = shown(browser, folder, Observables(of))
    seen.evaluate(f"viewer.set({of.time[len(of.time) // 2]})")
    seen.picture()
    seen.evaluate(f"viewer.set({of.time[-1]})")
    seen.picture()
    assert seen.evaluate("viewer.measured.frames") > 1
    assert faultless(seen)
    return seen


def stored_until(name: str, states: int, least: float = 0.0) -> float:
    """Return when a shipped case has stored so many states, `least` at the earliest [s], or its end.

    Its end where it has output times instead of an output step.
    """
    time = exunet.load(CASES / f"{name}.toml").scene.time
    later = np.inf if time.output_step is None else states * time.output_step
    return float(min(time.end, max(least, later)))


QUICK = (
    "planar_deployment",
    "nets/cut",
    "effects/orbit",
    "bodies/tumbling",
    "hard/one_element",
    "missions/open_box",
)
WHOLE = ("planar_deployment", "capture/box", "missions/throw_close_tow", "effects/breaking", "bodies/tow")
SHIPPED = [str(path.relative_to(CASES).with_suffix("")) for path in SHIPPED_CASES]


@NEEDS_CHROMIUM
@pytest.mark.parametrize("name", QUICK)
def test_page_of_the_first_states_of_a_case_loads(browser: Page, tmp_path: Path, name: str) -> None:
    shown_case(browser, tmp_path, name, stored_until(name, 10))


@NEEDS_CHROMIUM
@pytest.mark.slow
@pytest.mark.ci_for("capture/l_shape", "missions/throw_close_tow", "bodies/tow")
@pytest.mark.parametrize("name", SHIPPED)
def test_page_of_a_shipped_case_loads(browser: Page, tmp_path: Path, name: str) -> None:
    """The first half second, or 30 stored states, of each, and some to their end."""
    end = stored_until(name, 10**9) if name in WHOLE else stored_until(name, 30, 0.5)
    shown_case(browser, tmp_path, name, end)


def test_program_has_the_hash_of_its_sources() -> None:
    sources = [VIEWER / "package.json", VIEWER / "package-lock.json", *sorted((VIEWER / "src").iterdir())]
    content = b"".join(path.read_bytes() for path in sources)
    first = (VIEWER / "viewer.min.js").read_text(encoding="utf-8").splitlines()[0]
    assert first.endswith(hashlib.sha256(content).hexdigest()), "npm ci && npm run build"


def test_shipped_page_is_small_and_has_the_program() -> None:
    shipped = CASES.parent / "docs" / "capture_box.html"
    assert shipped.stat().st_size < 2e6
    found = re.search(r'id="program">([^<]*)<', shipped.read_text(encoding="utf-8"))
    assert found
    assert gzip.decompress(base64.b64decode(found[1])) == (VIEWER / "viewer.min.js").read_bytes()


def test_page_of_840_elements_and_1000_states_is_small() -> None:
    """At most 3 MB, for a net that swings in many waves, all threads of which change their tension."""
    of, time = square_net(cells=20), np.linspace(0.0, 1.0, 1000)
    assert of.n_elements == 840
    rng = np.random.default_rng(1)
    phases = 2 * np.pi * rng.random((8, 1, of.n_nodes, 3))
    waves = sum(np.sin(2 * np.pi * (k + 1) * time[:, None, None] + phase) for k, phase in enumerate(phases))
    whole = result(of, time, of.reference_position + 0.01 * waves)
    assert (whole.tension > 0.0).mean() > 0.3
    assert len(page([whole])) <= 3e6


@pytest.mark.slow
@pytest.mark.ci
def test_program_is_what_its_sources_give(tmp_path: Path) -> None:
    if shutil.which("npm") is None:
        pytest.skip("npm is not installed")
    for name in ("package.json", "package-lock.json"):
        shutil.copy(VIEWER / name, tmp_path)
    shutil.copytree(VIEWER / "src", tmp_path / "src")
    options: dict[str, Any] = {"cwd": tmp_path, "capture_output": True, "text": True, "timeout": 300}
    installed = subprocess.run(["npm", "ci", "--no-audit", "--no-fund"], check=False, **options)
    if installed.returncode:
        pytest.skip(f"npm cannot install: {installed.stderr.strip()[-200:]}")
    subprocess.run(["npm", "run", "build"], check=True, **options)
    assert (tmp_path / "viewer.min.js").read_bytes() == (VIEWER / "viewer.min.js").read_bytes()
