"""The state at time 0: rules of theory.md, and states of other runs that a case restarts from."""

from __future__ import annotations

import hashlib
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import cut_short
from pydantic import TypeAdapter
from scenes import CASES, case_in, restarted, stored
from scripts import SCENE

import exunet
from exunet.base.errors import CaseError
from exunet.base.run_events import ReelEvent
from exunet.forces.cable_term import INTACT
from exunet.model.initial import beyond_shortest, initial_state
from exunet.net import AnyNetConfig, weave
from exunet.results.run_folder import RESULT_FILE
from exunet.scene.casefile import Case, load
from exunet.scene.scene import Scene
from exunet.simulation.run import resume, run_into
from exunet.simulation.simulation import Simulation

CABLE = {"area": 1e-6, "density": 1000.0, "youngs_modulus": 1e9}
PAIR = {"topology": "explicit", "nodes": [[0, 0, 0], [2, 0, 0]], "elements": [[0, 1]]}


def state(net: dict[str, Any], initial: dict[str, Any], **others: Any) -> tuple[np.ndarray, np.ndarray]:
    time = {"end": 1.0, "output_step": 0.1}
    table = {"format": 1, "title": "", "time": time, "net": {"cable": CABLE, **net}, "initial": initial}
    scene = Scene.model_validate(table | others)
    return initial_state(scene, weave(scene.net))


def test_the_papers_state() -> None:
    """Sec. 3.3 of the paper: a tenth of the reference; 2.5 m/s outwards at the bullets, the rest at rest."""
    scene = load(CASES / "planar_deployment.toml").scene
    net = weave(scene.net)
    position, velocity = initial_state(scene, net)
    np.testing.assert_array_equal(position, 0.1 * net.reference_position)
    component = 2.5 / math.sqrt(2)
    expected = component * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    np.testing.assert_allclose(velocity[:4], expected, rtol=1e-14)
    np.testing.assert_array_equal(velocity[4:], 0.0)


def test_axial_launch_is_along_z_and_adds_to_the_common_velocity() -> None:
    net = {"topology": "square", "size": 1.0, "mesh": 1.0, "bullets": {"mass": 1.0}}
    launch = {"radial_speed": 0.0, "axial_speed": 3.0}
    _, velocity = state(net, {"packing": 1, "velocity": [1.0, 2.0, 4.0]}, launch=launch)
    np.testing.assert_array_equal(velocity, [[1.0, 2.0, 7.0]] * 4)


THROWN = {"topology": "square", "size": 1.0, "mesh": 1.0, "bullets": {"mass": 1.0}}


def test_speed_factors_and_tilts_are_of_each_bullet() -> None:
    """On a cone of 0.5 rad: a first tilt opens it; a second one leads to z x outward; factors scale."""
    tilts, factors = [[0.1, 0.0], [0.0, 0.2], [0.0, 0.0], [0.1, 0.2]], [1.0, 1.0, 0.0, 1.5]
    launch = {"speed": 2.0, "spread_angle": 0.5, "tilts": tilts, "speed_factors": factors}
    round_the_net = [0, 1, 3, 2]  # as bullets are numbered; nodes by rows
    position, velocity = (values[round_the_net] for values in state(THROWN, {"packing": 1}, launch=launch))
    outward = position / np.linalg.norm(position, axis=1, keepdims=True)
    along, up = np.einsum("na,na->n", velocity, outward), velocity[:, 2]
    aside = np.einsum("na,na->n", velocity, np.cross([0.0, 0.0, 1.0], outward))
    sizes, angles = 2.0 * np.array(factors), np.array([0.6, 0.5, 0.5, 0.6])
    level = sizes * np.cos(np.array(tilts)[:, 1])
    np.testing.assert_allclose(along, level * np.sin(angles), rtol=1e-14)
    np.testing.assert_allclose(up, level * np.cos(angles), rtol=1e-14)
    np.testing.assert_allclose(aside, sizes * np.sin(np.array(tilts)[:, 1]), rtol=1e-14, atol=1e-15)
    even = {"radial_speed": 2.5, "axial_speed": -1.0}
    ones = even | {"tilts": [[0.0, 0.0]] * 4, "speed_factors": [1.0] * 4}
    one, other = (state(THROWN, {"packing": 1}, launch=keys)[1] for keys in (even, ones))
    assert one.tobytes() == other.tobytes()


def test_spin_turns_about_the_origin_by_the_initial_position() -> None:
    """omega x r with omega = 3 z, r = packing (2, 0, 0) = (1, 0, 0): (0, 3, 0) m/s."""
    position, velocity = state(PAIR, {"packing": 0.5, "spin": [0.0, 0.0, 3.0]})
    np.testing.assert_array_equal(position, [[0, 0, 0], [1, 0, 0]])
    np.testing.assert_array_equal(velocity, [[0, 0, 0], [0, 3, 0]])


def test_packing_zero_gathers_all_nodes_at_the_origin() -> None:
    position, _ = state({"topology": "square", "size": 1.0, "mesh": 0.5}, {"packing": 0})
    np.testing.assert_array_equal(position, np.zeros((9, 3)))


def test_listed_positions_and_velocities_are_interpolated_on_divided_elements() -> None:
    """Three inner nodes between (0, 0, 4) and (4, 0, 0), between (0, 8, 0) and 0 m/s; omega x r on top."""
    initial = {
        "packing": 1.0,
        "velocity": [1.0, 0.0, 0.0],
        "spin": [0.0, 1.0, 0.0],
        "node_positions": [[0, 0, 4], [4, 0, 0]],
        "node_velocities": [[0, 8, 0], [0, 0, 0]],
    }
    position, velocity = state({**PAIR, "divisions": 4}, initial)
    np.testing.assert_allclose(position, [[0, 0, 4], [4, 0, 0], [1, 0, 3], [2, 0, 2], [3, 0, 1]])
    # y x (x, 0, z) = (z, 0, -x)
    expected = [[1 + 4, 8, 0], [1, 0, -4], [1 + 3, 6, -1], [1 + 2, 4, -2], [1 + 1, 2, -3]]
    np.testing.assert_allclose(velocity, expected)


def test_fixed_nodes_are_at_rest() -> None:
    initial = {"packing": 1, "velocity": [1.0, 0, 0], "node_velocities": [[0, 1.0, 0], [0, 1.0, 0]]}
    _, velocity = state({**PAIR, "fixed": [0]}, initial)
    np.testing.assert_array_equal(velocity, [[0, 0, 0], [1, 1, 0]])


def test_strings_of_a_bridle_are_launched_radially() -> None:
    """Bullet k of a honeycomb flies at 60 k degrees."""
    strings = {**CABLE, "length": 1.0}
    net = {"topology": "hexagonal", "mesh": 0.5, "rings": 1, "strings": strings, "bullets": {"mass": 1.0}}
    _, velocity = state(net, {"packing": 0.2}, launch={"radial_speed": 2.0, "axial_speed": 0.5})
    angle = np.radians(60.0 * np.arange(6))
    expected = np.stack([2 * np.cos(angle), 2 * np.sin(angle), 0 * angle + 0.5], axis=1)
    np.testing.assert_allclose(velocity[:6], expected, atol=1e-13)
    assert not velocity[6:].any()


@pytest.mark.parametrize("divisions", [1, 3])
def test_a_turned_net_spins_as_a_rigid_body(divisions: int) -> None:
    """Rigid rotation: no element changes its length, (v_j - v_i) . (x_j - x_i) = 0."""
    net = {"topology": "radial", "radius": 2.0, "spokes": 6, "rings": 2, "divisions": divisions}
    position, velocity = state(net, {"packing": 0.7, "spin": [0.3, -0.2, 0.9]})
    woven = weave(TypeAdapter(AnyNetConfig).validate_python({"cable": CABLE, **net}))
    i, j = woven.element_nodes.T
    rate = np.einsum("ea,ea->e", velocity[j] - velocity[i], position[j] - position[i])
    assert np.abs(rate).max() < 1e-14
    assert np.abs(velocity).max() > 0.5


MISSIONS = CASES / "missions"
WINDS = '\ncommands = [{ at = 0.0, mode = "rate", rate = 0.9 }]\n\n[capture]'
REELED = SCENE.replace("\n\n[capture]", WINDS)


def refused(case: Case) -> set[str]:
    """The keys for which a case is refused once it is prepared."""
    with pytest.raises(CaseError) as caught:
        Simulation(case)
    return {fault.key for fault in caught.value.faults}


@pytest.mark.ci
@pytest.mark.slow
def test_a_run_from_the_middle_of_another_one_goes_on(tmp_path: Path) -> None:
    """The node falls past the target, and a reel winds up a node of its tether at 0.87 s.

    Steps are laid out alike; places and velocities differ by the round-off of times, lengths and angles.
    """
    first = stored(tmp_path, case_in(tmp_path, REELED, "time.end=1.5", "time.output_step=0.25"))
    case = restarted(tmp_path, REELED, "first@0.5", ["initial.node_velocities="])
    second = exunet.run(case)
    assert [entry.event for entry in second.run.events_of(ReelEvent)][-1].endswith("goes onto the drum")
    row = int(np.argmin(np.abs(first.time - 1.5)))
    assert np.abs(second.position[-1] - first.position[row]).max() < 1e-9
    assert np.abs(second.velocity[-1] - first.velocity[row]).max() < 1e-8
    wound = [item.states["tow/wound_up"].values for item in (first, second)]
    assert wound[1][0, 0] == wound[0][2, 0] > 0.0
    assert wound[1][-1, 0] == pytest.approx(wound[0][row, 0], abs=1e-12)
    assert second.states["tow/work"].values[0, 0] == 0.0
    bare = SCENE.replace("[tethers.tow.reel]\ndamping = 100.0\n", "")
    assert refused(restarted(tmp_path, bare, "first@0.5", ["initial.node_velocities="])) == {"tethers.tow"}
    early = ["initial.node_velocities=", "tethers.tow.reel.shortest=3.0"]  # 2.75 m are outside
    assert refused(restarted(tmp_path, REELED, "first@0.5", early)) == {"tethers.tow.reel.shortest"}
    content = (tmp_path / "first" / RESULT_FILE).read_bytes()
    restart = second.run.restart
    assert restart.sha256 == hashlib.sha256(content).hexdigest()
    assert restart.time_s == 0.5


def test_the_last_state_is_the_default(tmp_path: Path) -> None:
    first = stored(tmp_path, case_in(tmp_path, SCENE, "time.end=0.25"))
    drop = ["initial.node_velocities="]
    for named in ("first", "first@end", "first/result.h5", "first/result.h5@0.25"):
        start = Simulation(restarted(tmp_path, SCENE, named, drop))
        assert np.array_equal(start.state.position[: first.net.n_nodes], first.position[-1])
        assert np.array_equal(start.bodies["left"].attitude, first.bodies["left"].attitude[-1])
        assert np.array_equal(start.bodies["left"].velocity, first.bodies["left"].velocity[-1])


@pytest.mark.slow
def test_a_run_that_was_killed_goes_on_from_the_same_start(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The result is named relative to the working directory, which is another one later."""
    stored(tmp_path, case_in(tmp_path, SCENE, "time.end=0.25"))
    monkeypatch.chdir(tmp_path)
    case = restarted(Path(), SCENE, "first", ["initial.node_velocities="])
    cut_short(tmp_path / "second", case, 0.5, every=0.3)
    whole = exunet.run(case)
    monkeypatch.chdir(tmp_path / "first")
    assert np.array_equal(resume(tmp_path / "second").position[:], whole.position)


@pytest.mark.slow
def test_an_element_that_was_cut_carries_nothing(tmp_path: Path) -> None:
    """The tether is cut at 0.104 s; the second case knows of no cut and of no breaking. A third goes on."""
    path = MISSIONS / "cut_tether.toml"
    form = ["engine.backend=compiled", "time.end=0.2", "time.output_step=0.05"]
    first = stored(tmp_path, exunet.load(path, form))
    (cut,) = (item for item in first.run.script if item.entry == "cut")
    drop = ["initial.packing=", "initial.velocity=", "script=[]", *form]
    case = exunet.load(path, [*drop, f"initial.restart={str(tmp_path / 'first')!r}"])
    (tmp_path / "next").mkdir()
    second = run_into(tmp_path / "next", case)
    assert second.run.restart.broken == [cut.element]
    assert second.tension[:, cut.element].max() == 0.0
    third = Simulation(exunet.load(path, [*drop, f"initial.restart={str(tmp_path / 'next')!r}"]))
    assert np.flatnonzero(third.state.discrete[INTACT] == 0.0).tolist() == [cut.element]


@pytest.mark.slow
@pytest.mark.parametrize("friction", [0.0, 0.2])
def test_a_closed_net_stays_closed(tmp_path: Path, friction: float) -> None:
    """What the winch has wound up stays so, and holds the same elastic energy.

    With friction the line lies anew in its pieces, with one tension, which holds less than before.
    """
    path = MISSIONS / "closed_box.toml"
    form = ["engine.backend=compiled", "time.end=0.6", "time.output_step=0.1", f"closing.friction={friction}"]
    first = stored(tmp_path, exunet.load(path, form))
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
    for change, key in (
        (f"closing.length={float(wound)!r}", "closing.length"),
        (f"closing.length={float(wound) + 1.0!r}", "closing.length"),
        ("closing.winch.shortest=5.9", "closing.winch.shortest"),
    ):
        again = [*form, *drop, f"initial.restart={str(tmp_path / 'first')!r}", change]
        assert refused(exunet.load(path, again)) == {key}


def test_a_state_that_does_not_fit_is_refused(tmp_path: Path) -> None:
    stored(tmp_path, case_in(tmp_path, SCENE, "time.end=0.25", "time.output_step=0.05"))
    (tmp_path / "empty").mkdir()
    other = SCENE.replace("bodies.right", "bodies.other").replace('"right"', '"other"')
    for named, text, key in (
        ("nowhere", SCENE, "initial.restart"),
        ("first@0.11", SCENE, "initial.restart"),  # stored are 0.1 and 0.15 s
        ("first@1e400", SCENE, "initial.restart"),
        ("empty", SCENE, "initial.restart"),
        ("first", SCENE.replace("divisions = 2", "divisions = 3"), "initial.restart"),
        ("first", SCENE.replace("length = 3.2", "length = 3.3"), "initial.restart"),
        ("first", SCENE.replace("mass = 2.0", "mass = 2.5"), "bodies.left"),
        ("first", other, "bodies.other"),
    ):
        assert key in refused(restarted(tmp_path, text, named, ["initial.node_velocities="]))


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("initial.velocity", "[0, 0, 1]"),
        ("initial.spin", "[0, 0, 1]"),
        ("tethers.tow.reel.paid_out", "3.0"),
        ("launch", "{speed=1.0, spread_angle=0.5}"),
    ],
)
def test_keys_that_contradict_a_state_are_refused(tmp_path: Path, key: str, value: str) -> None:
    with pytest.raises(CaseError, match=rf"{key}.*initial\.restart"):
        restarted(tmp_path, SCENE, "first", ["initial.node_velocities=", f"{key}={value}"])


def test_less_outside_than_a_drive_stops_at_is_told_to_round_off() -> None:
    """A billionth of the length does not count."""
    assert not beyond_shortest(0.7, 0.7)
    assert not beyond_shortest(0.7 * (1.0 - 5e-10), 0.7)
    assert beyond_shortest(0.7 * (1.0 - 2e-9), 0.7)
