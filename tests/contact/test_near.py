"""Which threads are looked at, and what of rejected steps is forgotten, as plain Python."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from contact_scenes import THROWN

import exunet
from exunet.base.errors import RunStopped
from exunet.forces.contact import near_loops
from exunet.forces.terms import KernelTerm, copied
from exunet.simulation.preparation import Start, prepare_case
from exunet.simulation.run import simulate
from exunet.system.effect_survey import survey

WINDOW = 2  # of `look`: how long the choice is right
CLOSER = -0.02  # [m] along z: 0.9 cm above the box, less than a tenth of its ball's radius of 17 cm


@pytest.fixture
def start(tmp_path: Path) -> Start:
    path = tmp_path / "thrown.toml"
    path.write_text(THROWN)
    return prepare_case(exunet.load(path))


def threads_of(start: Start) -> tuple[KernelTerm, Any]:
    term = next(one for one in start.system.forces.kernels if one.acts_on.startswith("threads"))
    return term, copied(term.data)


def looked_at(start: Start, term: KernelTerm, data: Any, time: float, shift: float) -> list[int]:
    """The pairs that are looked at, at a time [s] with the net shifted along z [m]."""
    x, v = start.system.layout.pack(start.state.moving)
    x = x.copy()
    x[2 : 3 * start.net.n_nodes : 3] += shift
    term.add(time, x, v, data, np.zeros(start.system.blocks.n_force))
    return data.near[: int(data.look[0])].tolist()


def test_a_check_of_the_start_leaves_the_scene_as_it_is(start: Start) -> None:
    """Its work space is copied: what was chosen for the start would be taken for other states at its time."""
    term, data = threads_of(start)
    assert data.look[WINDOW] == -1.0
    assert not data.kept[-1]
    assert not data.near.any()
    assert term.data.look[WINDOW] == -1.0


def test_effects_are_surveyed_where_bodies_are(start: Start) -> None:
    found = {one.name: one for one in survey(start.scene)}["contact"]
    assert found.on
    assert found.estimate is not None
    assert found.cost > 0.0


def test_a_step_that_is_tried_again_chooses_again(start: Start) -> None:
    """What a rejected attempt chose far away is not taken for the state nearby; later in time it lasts."""
    term, data = threads_of(start)
    near = looked_at(start, term, data, 0.0, CLOSER)
    assert near
    assert looked_at(start, term, data, 1.0, 1000.0) == []
    assert looked_at(start, term, data, 1.0 + 0.5 * data.look[WINDOW], 1000.0) == []
    assert looked_at(start, term, data, 0.5, CLOSER) == near


def test_the_depth_of_a_rejected_attempt_does_not_stop_a_run(start: Start) -> None:
    term, data = threads_of(start)
    assert term.memory is not None
    assert term.memory.wrong is not None
    assert term.remember is not None
    x, v = start.system.layout.pack(start.state.moving)
    nodes = slice(3 * start.net.n_nodes)
    deep = x.copy()
    places = deep[nodes].reshape(-1, 3)
    places += start.system.blocks.poses.centre[0] - places[0]  # a node in the middle of the body
    force = np.zeros(start.system.blocks.n_force)
    term.add(1e-3, deep, v, data, force)
    assert data.now[4] < 0.0
    for time, state, words in ((5e-4, x, ""), (1.0, deep, "deeper")):
        term.add(time, state, v, data, force)
        term.remember(time, state, v, data)
        found = term.memory.wrong(data.kept)
        assert words in found
        assert bool(found) == bool(words)


@pytest.mark.parametrize(("what", "speeds"), [("element", "threads"), ("bullet", "bullets")])
def test_what_may_pass_through_unseen_is_named(what: str, speeds: str, start: Start) -> None:
    """The fastest of what is near, after a step in which it goes more than half of the box's thickness."""
    term = next(one for one in start.system.forces.kernels if one.acts_on.startswith(speeds))
    assert term.memory is not None
    assert term.memory.wrong is not None
    assert term.remember is not None
    x, v = start.system.layout.pack(start.state.moving)
    x, v = x.copy(), np.zeros_like(v)
    number = {"element": 5, "bullet": 0}[what]
    nodes = start.net.element_nodes[number] if what == "element" else start.net.bullet_nodes[:1]
    x[: 3 * start.net.n_nodes].reshape(-1, 3)[nodes] = [[0.25, 0.2, -0.015], [0.3, 0.2, -0.015]][: len(nodes)]
    v[: 3 * start.net.n_nodes].reshape(-1, 3)[nodes] = [0.0, 0.0, -30.0]  # 15 mm above the box's face
    others = np.setdiff1d(np.arange(start.net.n_nodes), nodes)
    v[: 3 * start.net.n_nodes].reshape(-1, 3)[others] = [0.0, 0.0, -1.0]
    data = copied(term.data)
    for time in (0.0, 1e-3, 1e-3 + 1.01 * 0.05 / 30.0):  # half of the box's 0.1 m at 30 m/s
        assert term.memory.wrong(data.kept) == ""
        term.add(time, x, v, data, np.zeros(start.system.blocks.n_force))
        term.remember(time, x, v, data)
    found = term.memory.wrong(data.kept)
    sharing = np.flatnonzero(np.isin(start.net.element_nodes, nodes).any(axis=1))
    names = [f"element {one}" for one in sharing] if what == "element" else ["bullet 0"]
    words = (
        " near box moves by more than 0.05 m, half of the body's least thickness, in the step that ends at "
    )
    assert found.partition(words)[0] in names
    assert found.partition(words)[2].startswith("t = 0.00268333 s")
    assert "solver.step" in found


def test_a_body_far_away_is_not_asked_at_each_step(start: Start) -> None:
    """However it turns: for 1 km at 8 (0.62 rad/s 1 km + 6 m/s), less the sizes of both."""
    term, data = threads_of(start)
    looked_at(start, term, data, 0.0, 1000.0)
    spin, speed = np.linalg.norm([0.3, 0.2, 0.5]), np.linalg.norm([0.1, 0.05, 1.0])
    assert data.look[WINDOW] == pytest.approx(1000.0 / (8.0 * (spin * 1000.0 + speed + 5.0)), rel=1e-3)


def test_threads_between_boxes_and_ball_are_not_near(start: Start) -> None:
    """The distance from the box around the solid: 1 cm beside a face, and none where boxes meet."""
    _, data = threads_of(start)
    box = data.boxes[0]
    for gap, found in ((0.01, 0.01), (0.0, 0.0), (-0.005, 0.0)):
        for node in (data.first[0], data.second[0]):
            data.own[node : node + 3] = [0.0, 0.0, box[5] + data.thick[0] + gap]
        assert near_loops.clearance(data, 0) == pytest.approx(found, abs=1e-15)
    data.own[data.first[0] : data.first[0] + 3] = box[3:] + np.array([0.03, 0.04, data.thick[0]])
    data.own[data.second[0] : data.second[0] + 3] = box[3:] + np.array([0.06, 0.09, 0.12])
    corner = np.hypot(0.03 - data.thick[0], 0.04 - data.thick[0])
    assert near_loops.clearance(data, 0) == pytest.approx(corner, rel=1e-12)


@pytest.mark.parametrize("form", ['engine.loop="compiled"', 'engine={net="connectors", loop="exudyn"}'])
def test_a_run_that_contact_stops_keeps_its_states(form: str, tmp_path: Path) -> None:
    """Until the last stored time before: threads that nearly nothing holds sink into the box."""
    path = tmp_path / "thrown.toml"
    path.write_text(THROWN)
    soft = ["effects.contact.stiffness=1.0"]
    with pytest.raises(RunStopped, match="deeper") as stop:
        simulate(prepare_case(exunet.load(path, [*soft, form, "solver.step=1e-4"])))
    result = stop.value.result
    touching = result.states["contact_box/threads_touching"].values[:, 0]
    assert len(touching) == len(result.time)
    assert touching[-1] > 0
    assert touching[0] == 0
    np.testing.assert_allclose(np.diff(result.time), 0.01, rtol=1e-9)
    worst = float(str(stop.value).split("t = ")[1].split(" s")[0])
    assert result.time[-1] < worst < result.time[-1] + 0.0101
