"""Cases that start from the state of another run: what goes on as it was, and what is refused."""

from __future__ import annotations

import hashlib
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scripts import SCENE

import exunet
from exunet.base.errors import CaseError, Interrupted
from exunet.forces.cable_term import INTACT
from exunet.model.initial import beyond_shortest
from exunet.results.run_folder import RESULT_FILE
from exunet.scene.casefile import Case, parse_case
from exunet.simulation import run as runs
from exunet.simulation.run import resume, run_into
from exunet.simulation.simulation import Simulation

MISSIONS = Path(__file__).parents[1] / "cases" / "missions"
WINDS = '\ncommands = [{ at = 0.0, mode = "rate", rate = 0.9 }]\n\n[capture]'
REELED = SCENE.replace("\n\n[capture]", WINDS)


def kept(folder: Path, case: Case) -> exunet.Result:
    """The result of a case, in folder/first."""
    (folder / "first").mkdir()
    return run_into(folder / "first", case)


def begun(folder: Path, text: str, named: str, overrides: Sequence[str] = ()) -> Case:
    """The case of a text in the folder, started from a state."""
    return parse_case(
        text, folder / "second.toml", ["initial.packing=", f"initial.restart={named!r}", *overrides]
    )


def simple(folder: Path, text: str, *overrides: str) -> Case:
    """The case of a text in the folder."""
    return parse_case(text, folder / "first.toml", overrides)


def refused(case: Case) -> str:
    """The words with which a case is refused once it is prepared."""
    with pytest.raises(CaseError) as caught:
        Simulation(case)
    return str(caught.value)


@pytest.mark.ci
@pytest.mark.slow
def test_a_run_from_the_middle_of_another_one_goes_on(tmp_path: Path) -> None:
    """The node falls past the target, and a reel winds up a node of its tether at 0.87 s.

    Steps are laid out alike; places and velocities differ by the round-off of times, lengths and angles.
    """
    first = kept(tmp_path, simple(tmp_path, REELED, "time.end=1.5", "time.output_step=0.25"))
    case = begun(tmp_path, REELED, "first@0.5", ["initial.node_velocities="])
    second = exunet.run(case)
    assert [entry["event"] for entry in second.provenance["reels"]][-1].endswith("goes onto the drum")
    row = int(np.argmin(np.abs(first.time - 1.5)))
    assert np.abs(second.position[-1] - first.position[row]).max() < 1e-9
    assert np.abs(second.velocity[-1] - first.velocity[row]).max() < 1e-8
    wound = [item.states["tow/wound_up"].values for item in (first, second)]
    assert wound[1][0, 0] == wound[0][2, 0] > 0.0
    assert wound[1][-1, 0] == pytest.approx(wound[0][row, 0], abs=1e-12)
    assert second.states["tow/work"].values[0, 0] == 0.0
    bare = SCENE.replace("[tethers.tow.reel]\ndamping = 100.0\n", "")
    words = refused(begun(tmp_path, bare, "first@0.5", ["initial.node_velocities="]))
    assert "tethers.tow: 0.45 m of it are on a reel in " in words
    assert "at 0.5 s: add its reel" in words
    early = ["initial.node_velocities=", "tethers.tow.reel.shortest=3.0"]
    words = refused(begun(tmp_path, REELED, "first@0.5", early))
    assert "tethers.tow.reel.shortest: is above the 2.75 m outside in " in words
    assert "at 0.5 s: reduce it" in words
    content = (tmp_path / "first" / RESULT_FILE).read_bytes()
    story = second.provenance["restart"]
    assert story["sha256"] == hashlib.sha256(content).hexdigest()
    assert story["time_s"] == 0.5


def test_the_last_state_is_the_default(tmp_path: Path) -> None:
    first = kept(tmp_path, simple(tmp_path, SCENE, "time.end=0.25"))
    drop = ["initial.node_velocities="]
    for named in ("first", "first@end", "first/result.h5", "first/result.h5@0.25"):
        start = Simulation(begun(tmp_path, SCENE, named, drop))
        assert np.array_equal(start.state.position[: first.net.n_nodes], first.position[-1])
        assert np.array_equal(start.bodies["left"].attitude, first.bodies["left"].attitude[-1])
        assert np.array_equal(start.bodies["left"].velocity, first.bodies["left"].velocity[-1])


@pytest.mark.slow
def test_a_run_that_was_killed_goes_on_from_the_same_start(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its case is read again from what it has stored, in which the result stands relative to a folder.

    It was named relative to the working directory, as in a shell, which is another one later.
    """
    kept(tmp_path, simple(tmp_path, SCENE, "time.end=0.25"))
    monkeypatch.chdir(tmp_path)
    case = begun(Path(), SCENE, "first", ["initial.node_velocities="])
    (tmp_path / "second").mkdir()
    real = runs.drive

    def drive(simulation: Simulation, recorder: Any, progress: Any, checkpoint: Any) -> None:
        def after_each_time() -> None:
            checkpoint()
            if simulation.time >= 0.5:
                shutil.copytree(tmp_path / "second", tmp_path / "killed")
                raise KeyboardInterrupt

        real(simulation, recorder, progress, after_each_time)

    monkeypatch.setattr(runs, "drive", drive)
    with pytest.raises(Interrupted):
        run_into(tmp_path / "second", case, checkpoint_every=0.3)
    monkeypatch.setattr(runs, "drive", real)
    whole = exunet.run(case)
    monkeypatch.chdir(tmp_path / "first")
    assert np.array_equal(resume(tmp_path / "killed").position[:], whole.position)


@pytest.mark.slow
def test_an_element_that_was_cut_carries_nothing(tmp_path: Path) -> None:
    """The tether is cut at 0.104 s; the second case knows of no cut and of no breaking. A third goes on."""
    path = MISSIONS / "cut_tether.toml"
    form = ["engine.backend=compiled", "time.end=0.2", "time.output_step=0.05"]
    first = kept(tmp_path, exunet.load(path, form))
    (cut,) = (item for item in first.provenance["script"] if item["entry"] == "cut")
    drop = ["initial.packing=", "initial.velocity=", "script=[]", *form]
    case = exunet.load(path, [*drop, f"initial.restart={str(tmp_path / 'first')!r}"])
    (tmp_path / "next").mkdir()
    second = run_into(tmp_path / "next", case)
    assert second.provenance["restart"]["broken"] == [cut["element"]]
    assert second.tension[:, cut["element"]].max() == 0.0
    third = Simulation(exunet.load(path, [*drop, f"initial.restart={str(tmp_path / 'next')!r}"]))
    assert np.flatnonzero(third.state.memory[INTACT] == 0.0).tolist() == [cut["element"]]


@pytest.mark.slow
@pytest.mark.parametrize("friction", [0.0, 0.2])
def test_a_closed_net_stays_closed(tmp_path: Path, friction: float) -> None:
    """What the winch has wound up stays so, and holds the same elastic energy.

    With friction the line lies anew in its pieces, with one tension, which holds less than before.
    """
    path = MISSIONS / "closed_box.toml"
    form = ["engine.backend=compiled", "time.end=0.6", "time.output_step=0.1", f"closing.friction={friction}"]
    first = kept(tmp_path, exunet.load(path, form))
    drop = ["initial.packing=", "initial.velocity=", "closing.winch.commands=[]"]
    second = Simulation(exunet.load(path, [*form, *drop, f"initial.restart={str(tmp_path / 'first')!r}"]))
    of = {one.name: k for k, one in enumerate(second.start.system.blocks.states)}
    wound = first.states["closing/wound_up"].values[-1, 0]
    assert wound > 1.5
    assert second.state.first_order[of["closing/wound_up"]] == wound
    now = second.energy
    if friction:
        assert 0.0 < now.potential < first.potential[-1]
    else:
        assert now.potential == pytest.approx(first.potential[-1], rel=1e-9)
    assert now.elastic == pytest.approx(first.elastic[-1], rel=1e-12)
    assert now.kinetic == pytest.approx(first.kinetic[-1], rel=1e-12)
    second.advance(0.1)
    assert second.state.first_order[of["closing/wound_up"]] == wound  # the winch is locked
    for change, words in (
        (f"closing.length={float(wound)!r}", "must be greater than the"),
        (f"closing.length={float(wound) + 1.0!r}", "m are wound up"),
        ("closing.winch.shortest=5.9", "winch.shortest: is above the .* m outside in the state"),
    ):
        with pytest.raises(CaseError, match=words):
            Simulation(
                exunet.load(path, [*form, *drop, f"initial.restart={str(tmp_path / 'first')!r}", change])
            )


def test_what_does_not_fit_is_refused_with_its_line(tmp_path: Path) -> None:
    kept(tmp_path, simple(tmp_path, SCENE, "time.end=0.25", "time.output_step=0.05"))
    drop = ["initial.node_velocities="]

    def words(named: str = "first", text: str = SCENE, *more: str) -> str:
        return refused(begun(tmp_path, text, named, [*drop, *more]))

    assert "no such file" in words("nowhere").lower()
    assert "the nearest is at 0.1 s: use it" in words("first@0.11")
    (tmp_path / "empty").mkdir()
    assert "empty: result.h5 is missing" in words("empty")
    assert "has 4 nodes and 2 elements, tethers included; this case has 5 and 3" in words(
        "first", SCENE.replace("divisions = 2", "divisions = 3")
    )
    assert "element 0 has a length of 1.6 m" in words("first", SCENE.replace("length = 3.2", "length = 3.3"))
    assert "bodies.left: mass 2.5" in words("first", SCENE.replace("mass = 2.0", "mass = 2.5"))
    other = SCENE.replace("bodies.right", "bodies.other").replace('"right"', '"other"')
    assert "does not have this body (bodies: left, right, target)" in words("first", other)


def test_a_node_is_fixed_where_it_was(tmp_path: Path) -> None:
    """To a free body too; there its place is in the inertia."""
    text = SCENE.replace("position = [3.0, 50.0, 0.0]", 'position = [3.0, 50.0, 0.0]\nmotion = "fixed"')
    kept(tmp_path, simple(tmp_path, text, "time.end=0.25"))
    moved = "tethers.tow.end.point=[0.1, 0.0, 0.0]"
    words = refused(begun(tmp_path, text, "first", ["initial.node_velocities=", moved]))
    assert "is attached 0.1 m from its position" in words


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("initial.velocity", "[0, 0, 1]"),
        ("initial.spin", "[0, 0, 1]"),
        ("tethers.tow.reel.paid_out", "3.0"),
        ("launch", "{speed=1.0, spread_angle=0.5}"),
    ],
)
def test_what_says_otherwise_where_things_are_is_refused(tmp_path: Path, key: str, value: str) -> None:
    with pytest.raises(CaseError, match=r"excludes initial\.restart"):
        begun(tmp_path, SCENE, "first", ["initial.node_velocities=", f"{key}={value}"])


def test_packing_and_a_state_are_not_both_given(tmp_path: Path) -> None:
    with pytest.raises(CaseError, match="exactly one of packing, fold or restart"):
        simple(tmp_path, SCENE, "initial.restart='first'")


def test_less_outside_than_a_drive_stops_at_is_told_to_round_off() -> None:
    """A billionth of the length does not count."""
    assert not beyond_shortest(0.7, 0.7)
    assert not beyond_shortest(0.7 * (1.0 - 5e-10), 0.7)
    assert beyond_shortest(0.7 * (1.0 - 2e-9), 0.7)
