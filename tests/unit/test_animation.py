"""Animations of results: what they show, what is written, and errors that leave nothing behind."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.collections import LineCollection
from PIL import Image
from result_samples import net, result, square_net, unfolding

import exunet
from exunet.base.errors import InputError, MissingExtra
from exunet.bodies.shapes import Shape, Solid
from exunet.bodies.wireframe import packed, wireframe
from exunet.cli.animate import animate
from exunet.plots import animation
from exunet.plots.animation import save_animation, stored_times
from exunet.plots.style import drawing
from exunet.results.result import BodyStates, Result, TermStates
from exunet.results.touching import touching_threads

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
    box = BodyStates(
        1.0, np.eye(3), far, still, upright, still, wireframe(shape), **packed(shape, np.zeros(3))
    )
    series = {
        "threads_touching": [0.0, 1.0],
        "threads_first": [-1.0, 0.7],
        "bullets_touching": [0.0, 2.0],
        "bullets_first": [-1.0, 0.8],
    }
    states = {
        f"contact_box/{name}": TermStates("1", np.array(values)[:, None]) for name, values in series.items()
    }
    whole = result(of, [0.0, 1.0], np.stack([of.reference_position] * 2))
    story = whole.provenance | {"edge_radii": {"box": EDGE}}
    return replace(whole, bodies={"box": box}, states=states, provenance=story)


def test_threads_that_touch_are_found() -> None:
    scene = met()
    assert touching_threads(scene, 0).tolist() == [False, False, False]
    assert touching_threads(scene, 1).tolist() == [True, False, False]
    sharp = replace(scene, provenance={})
    assert touching_threads(sharp, 1).tolist() == [True, True, False]
    held = replace(scene.bodies["box"], nodes=np.array([0]))
    assert not touching_threads(replace(scene, bodies={"box": held}), 1).any()


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
    assert touching_threads(scene, 1).tolist() == [True, False, False]


def test_frames_show_time_contact_and_state() -> None:
    """One thread in contact at 1 s; artists of a frame do not remain in the next."""
    with drawing():
        frame = animation._Frame(met(), [0, 1])
        counts = []
        for k in (0, 1, 0):
            frame.draw(k)
            axes = frame.figure.axes[0]
            marks = [collection for collection in axes.collections if collection.get_alpha() == 0.5]
            counts.append((axes.get_title(loc="left"), len(marks), len(axes.get_children())))
    assert [title for title, *_ in counts] == ["t = 0.0 s", "t = 1.0 s, contact with box", "t = 0.0 s"]
    assert [number for _, number, _ in counts] == [0, 1, 0]
    assert counts[0] == counts[2]


def test_snapshots_mark_what_touches() -> None:
    """Of the later of both times, the one thread that touches, in each of its planes."""
    made = exunet.figure(met(), "snapshots")
    marked = [
        [
            collection
            for collection in axes.collections
            if isinstance(collection, LineCollection) and collection.get_alpha() == 0.5
        ]
        for axes in made.axes
    ]
    counts = [len(item[0].get_segments()) if item else 0 for item in marked]
    half = len(counts) // 2
    assert counts == [0] * half + [1] * half
    assert "in contact with a body" in [text.get_text() for text in made.legends[0].get_texts()]


def test_a_gif_has_a_frame_for_each_stored_time(tmp_path: Path) -> None:
    seen: list[tuple[int, int]] = []
    count = save_animation(SMALL, tmp_path / "a.gif", 25.0, 0.2, None, lambda *one: seen.append(one))
    assert count == 4
    assert seen == [(1, 4), (2, 4), (3, 4), (4, 4)]
    assert [path.name for path in tmp_path.iterdir()] == ["a.gif"]
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


def test_an_mp4_is_written(tmp_path: Path) -> None:
    if shutil.which("ffmpeg") is None:
        pytest.importorskip("imageio_ffmpeg")
    save_animation(SMALL, tmp_path / "a.mp4", 25.0)
    assert (tmp_path / "a.mp4").read_bytes()[4:8] == b"ftyp"  # ISO/IEC 14496-12
    assert [path.name for path in tmp_path.iterdir()] == ["a.mp4"]


def test_ffmpeg_that_fails_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    program = tmp_path / "ffmpeg"
    program.write_text("#!/bin/sh\ncat > /dev/null\necho 'no encoder\nof that name' >&2\nexit 7\n")
    program.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:/bin:/usr/bin")
    with pytest.raises(InputError, match="ffmpeg failed: no encoder of that name"):
        save_animation(SMALL, tmp_path / "a.mp4", 25.0)
    assert [path.name for path in tmp_path.iterdir()] == ["ffmpeg"]


def test_without_ffmpeg_the_extra_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setattr(animation, "find_spec", lambda name: None)
    with pytest.raises(MissingExtra, match=r"exunet\[movie\]"):
        save_animation(SMALL, tmp_path / "a.mp4", 25.0)
    assert list(tmp_path.iterdir()) == []


def test_ctrl_c_leaves_nothing(tmp_path: Path) -> None:
    def interrupted(done: int, total: int) -> None:
        if done == 2:
            raise KeyboardInterrupt

    (tmp_path / "a.gif").write_text("an older one")
    with pytest.raises(KeyboardInterrupt):
        save_animation(SMALL, tmp_path / "a.gif", 25.0, progress=interrupted)
    assert [(path.name, path.read_text()) for path in tmp_path.iterdir()] == [("a.gif", "an older one")]


@pytest.mark.parametrize(
    ("name", "fps", "begin", "end", "words"),
    [
        ("a.avi", 25.0, None, None, ".gif or .mp4"),
        ("a.gif", 0.0, None, None, "fps: must be above 0 and at most 50"),
        ("a.gif", 60.0, None, None, "fps: "),
        ("a.gif", float("nan"), None, None, "fps: "),
        ("a.gif", 25.0, 2.0, None, "from, until: "),
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


def test_a_file_that_is_there_stays_unless_asked(tmp_path: Path) -> None:
    exunet.save(SMALL, tmp_path / "result.h5")
    (tmp_path / "animation.gif").write_text("an older one")
    with pytest.raises(InputError, match="exists"):
        animate(tmp_path, None, 25.0, None, None, overwrite=False, quiet=True)
    assert (tmp_path / "animation.gif").read_text() == "an older one"
    assert animate(tmp_path, None, 25.0, None, None, overwrite=True, quiet=True) == tmp_path / "animation.gif"
    with Image.open(tmp_path / "animation.gif") as made:
        assert made.n_frames == 5


@pytest.mark.ci
@pytest.mark.slow
def test_the_same_result_gives_the_same_bytes(tmp_path: Path) -> None:
    for name in ("a.gif", "b.gif"):
        save_animation(SMALL, tmp_path / name, 25.0)
    assert (tmp_path / "a.gif").read_bytes() == (tmp_path / "b.gif").read_bytes()
