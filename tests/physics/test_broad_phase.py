"""The choice of threads near a body, as plain Python: none that touches is missed, none passes unseen."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scenes import BACKENDS, NET_ON_BOX, every_backend, of_text

from exunet.base.errors import RunStopped
from exunet.bodies.rotations import rotation_matrix
from exunet.forces.contact import broad_phase, segment_surface
from exunet.forces.contact.status import ContactKey, status_of
from exunet.forces.terms import KernelTerm, copied
from exunet.simulation.preparation import Start, prepare_case
from exunet.simulation.run import simulate

WINDOW = 2  # of `look`: how long the choice is right
CLOSER = -0.02  # [m] along z: 0.9 cm above the box, less than a tenth of its ball's radius of 17 cm


@pytest.fixture(scope="module")
def start() -> Start:
    return prepare_case(of_text(NET_ON_BOX))


def threads_of(start: Start) -> tuple[KernelTerm, Any]:
    term = next(kernel for kernel in start.system.forces.kernels if kernel.acts_on.startswith("threads"))
    return term, copied(term.data)


def looked_at(start: Start, term: KernelTerm, data: Any, time: float, shift: float) -> list[int]:
    """The pairs that are looked at, at a time [s] with the net shifted along z [m]."""
    x, v = start.system.layout.pack(start.state.moving)
    x = x.copy()
    x[2 : 3 * start.net.n_nodes : 3] += shift
    term.add(time, x, v, data, np.zeros(start.system.blocks.n_force))
    return data.near.pairs[: int(data.near.look[0])].tolist()


def test_a_step_that_is_tried_again_chooses_again(start: Start) -> None:
    """What a rejected attempt chose far away is not taken for the state nearby; later in time it lasts."""
    term, data = threads_of(start)
    near = looked_at(start, term, data, 0.0, CLOSER)
    assert near
    assert looked_at(start, term, data, 1.0, 1000.0) == []
    assert looked_at(start, term, data, 1.0 + 0.5 * data.near.look[WINDOW], 1000.0) == []
    assert looked_at(start, term, data, 0.5, CLOSER) == near


def test_the_depth_of_a_rejected_attempt_does_not_stop_a_run(start: Start) -> None:
    term, data = threads_of(start)
    assert term.discrete is not None
    assert term.discrete.wrong is not None
    assert term.remember is not None
    x, v = start.system.layout.pack(start.state.moving)
    nodes = slice(3 * start.net.n_nodes)
    deep = x.copy()
    places = deep[nodes].reshape(-1, 3)
    places += start.system.blocks.poses.centre[0] - places[0]  # a node in the middle of the body
    force = np.zeros(start.system.blocks.n_force)
    term.add(1e-3, deep, v, data, force)
    assert data.now[4] < 0.0
    for time, state, wrong in ((5e-4, x, False), (1.0, deep, True)):
        term.add(time, state, v, data, force)
        term.remember(time, state, v, data)
        assert bool(term.discrete.wrong(data.kept)) == wrong


@pytest.mark.parametrize(("what", "speeds"), [("element", "threads"), ("bullet", "bullets")])
def test_steps_that_may_pass_through_a_body_are_reported(what: str, speeds: str, start: Start) -> None:
    """The fastest of what is near, after a step in which it goes more than half of the box's thickness."""
    term = next(kernel for kernel in start.system.forces.kernels if kernel.acts_on.startswith(speeds))
    assert term.discrete is not None
    assert term.discrete.wrong is not None
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
        assert term.discrete.wrong(data.kept) == ""
        term.add(time, x, v, data, np.zeros(start.system.blocks.n_force))
        term.remember(time, x, v, data)
    found = status_of(data.kept)
    sharing = np.flatnonzero(np.isin(start.net.element_nodes, nodes).any(axis=1))
    assert found.wrong_pair in (sharing if what == "element" else [0])
    assert found.wrong_time == pytest.approx(1e-3 + 1.01 * 0.05 / 30.0)
    assert term.discrete.wrong(data.kept)


def test_threads_between_boxes_and_ball_are_not_near(start: Start) -> None:
    """The distance from the box around the solid: 1 cm beside a face, and none where boxes meet."""
    _, data = threads_of(start)
    box = data.cores.boxes[0]
    for gap, found in ((0.01, 0.01), (0.0, 0.0), (-0.005, 0.0)):
        for node in (data.threads.first[0], data.threads.second[0]):
            data.work.own[node : node + 3] = [0.0, 0.0, box[5] + data.threads.thick[0] + gap]
        assert broad_phase.clearance(data, 0) == pytest.approx(found, abs=1e-15)
    data.work.own[data.threads.first[0] : data.threads.first[0] + 3] = box[3:] + np.array(
        [0.03, 0.04, data.threads.thick[0]]
    )
    data.work.own[data.threads.second[0] : data.threads.second[0] + 3] = box[3:] + np.array(
        [0.06, 0.09, 0.12]
    )
    corner = np.hypot(0.03 - data.threads.thick[0], 0.04 - data.threads.thick[0])
    assert broad_phase.clearance(data, 0) == pytest.approx(corner, rel=1e-12)


@every_backend
def test_a_run_that_contact_stops_keeps_its_states(backend: str) -> None:
    """Until the last stored time before: threads that nearly nothing holds sink into the box."""
    soft = ("effects.contact.stiffness=1.0", BACKENDS[backend], "solver.step=1e-4")
    with pytest.raises(RunStopped) as stop:
        simulate(prepare_case(of_text(NET_ON_BOX, *soft)))
    result = stop.value.result
    touching = result.contacts[ContactKey("box", "threads", "touching")].values[:, 0]
    assert len(touching) == len(result.time)
    assert touching[0] == 0 < touching[-1]
    np.testing.assert_allclose(np.diff(result.time), 0.01, rtol=1e-9)


def alone(start: Start, clear: float = 1000.0) -> tuple[Any, Any, Any]:
    """Data, places and speeds: all far from the box, which turns, except what a test puts near it."""
    _, data = threads_of(start)
    x, v = start.system.layout.pack(start.state.moving)
    x, v = x.copy(), v.copy()
    x[2 : 3 * start.net.n_nodes : 3] += clear
    return data, x, v


def test_the_choice_follows_from_places_and_speeds(start: Start) -> None:
    """Nodes at random around the box, all moving; margins and times as `choose_near` states them."""
    data, x, v = alone(start)
    random, n = np.random.default_rng(6), start.net.n_nodes
    x[: 3 * n] = (start.system.blocks.poses.centre[0] + 0.35 * random.normal(size=(n, 3))).ravel()
    v[: 3 * n] = random.normal(size=3 * n)
    attitude = random.normal(size=4)
    x[data.body.attitude : data.body.attitude + 4] = attitude / np.linalg.norm(attitude)
    turn = rotation_matrix(x[data.body.attitude : data.body.attitude + 4])
    own = (x[: 3 * n].reshape(-1, 3) - x[data.body.centre : data.body.centre + 3]) @ turn
    against = (v[: 3 * n].reshape(-1, 3) - v[data.body.centre : data.body.centre + 3]) @ turn
    spin = v[data.body.spin : data.body.spin + 3]
    at_the_point = np.linalg.norm(against - np.cross(spin, own), axis=1)
    fastest, spin = np.linalg.norm(against, axis=1).max(), np.linalg.norm(spin)
    ends = np.stack([data.threads.first, data.threads.second], axis=1) // 3
    low, high = data.cores.boxes[0, :3], data.cores.boxes[0, 3:]
    gap = np.maximum(own[ends].min(axis=1) - high, low - own[ends].max(axis=1)) - data.threads.thick[:, None]
    apart = np.linalg.norm(np.maximum(gap, 0.0), axis=1)
    near = apart < 0.1 * data.body.radius
    assert 3 < near.sum() < len(near) - 3
    away = np.linalg.norm(own[ends], axis=2).max(axis=1)
    lasts = [0.1 * data.body.radius / (fastest + spin * data.body.radius + 5.0)]
    lasts += list((apart / (8.0 * (fastest + spin * away + 5.0)))[~near])
    data.near.wanted[:] = 7  # of a choice before
    broad_phase.choose_near(0.3, x, v, data)
    assert data.near.pairs[: int(data.near.look[0])].tolist() == np.flatnonzero(near).tolist()
    nodes = np.unique(ends[near])
    assert data.near.near_nodes[: int(data.near.look[4])].tolist() == (3 * nodes).tolist()
    assert data.near.listed.tolist() == near.astype(float).tolist()
    quickest = int(np.flatnonzero(near)[at_the_point[ends[near]].max(axis=1).argmax()])
    known = [near.sum(), 0.3, min(lasts), at_the_point[nodes].max(), len(nodes), quickest, 0.3]
    np.testing.assert_allclose(data.near.look, known, rtol=1e-12)
    np.testing.assert_allclose(
        data.work.own.reshape(-1, 3)[np.unique(ends)], own[np.unique(ends)], atol=1e-15
    )


def test_a_choice_holds_from_its_time_until_it_expires(start: Start) -> None:
    data, x, v = alone(start)
    assert not broad_phase.is_near(0.0, data)
    broad_phase.choose_near(2.0, x, v, data)
    data.near.look[WINDOW] = 0.5
    seen = [broad_phase.is_near(time, data) for time in (1.999, 2.0, 2.25, 2.5, 2.501)]
    assert seen == [False, True, True, True, False]


# Choices at these times [s], near the box (True) or far away from it, and whether what is near at last has
# come unseen. The first choice of all is not judged, nor one from before the choice before the last.
CHOICES: dict[str, tuple[list[tuple[float, bool]], bool]] = {
    "at the start": ([(0.0, True)], False),
    "near, near": ([(0.0, True), (1.0, True)], False),
    "far, near": ([(0.0, False), (1.0, True)], True),
    "far, near in a step tried again": ([(0.0, False), (1.0, True), (0.5, True)], True),
    "near, far, near in a step tried again": ([(0.0, True), (1.0, False), (0.5, True)], False),
    "far, far, near in a step tried again": ([(0.0, False), (1.0, False), (0.5, True)], True),
    "far, far, near when the first was made": ([(0.0, False), (1.0, False), (0.0, True)], True),
    "far, far, near before both": ([(0.5, False), (1.0, False), (0.25, True)], False),
    "near, far, far, near in a step tried again": (
        [(0.0, True), (1.0, False), (2.0, False), (1.5, True)],
        True,
    ),
    "near, again, near": ([(0.0, False), (1.0, True), (0.5, False), (0.75, True)], True),
}


@pytest.mark.parametrize("name", CHOICES)
def test_a_thread_that_comes_unseen_is_reported(name: str, start: Start) -> None:
    """Thread 5 through the middle of the box; that it lies too deep follows from states, not from choices."""
    choices, unseen = CHOICES[name]
    data, far, v = alone(start)
    near = far.copy()
    near[data.threads.first[5] :][:3] = start.system.blocks.poses.centre[0] + [0.01, 0.0, 0.02]
    near[data.threads.second[5] :][:3] = start.system.blocks.poses.centre[0] - [0.0, 0.02, 0.01]
    for time, is_near in choices:
        data.now[4] = 0.0
        broad_phase.choose_near(time, near if is_near else far, v, data)
    ends = np.stack([data.threads.first, data.threads.second])
    first = int(np.flatnonzero(np.isin(ends, ends[:, 5]).any(axis=0))[0])  # of those that share its nodes
    assert data.now[4] == (1.0 + first if unseen else 0.0)


def test_a_thread_is_clear_until_an_end_has_moved_as_far_as_it_was(start: Start) -> None:
    """In any direction; what round-off may change is taken off."""
    data, _, _ = alone(start)
    a, b = np.array([0.3, -0.2, 0.5]), np.array([0.7, 0.4, -0.6])
    segment_surface.keep_clear(data, 2, tuple(a), tuple(b), 0.05)
    assert data.near.clear[2] == pytest.approx(0.05 - 1e-9 * data.body.radius, rel=1e-15)
    data.near.clear[2] = 0.0625  # exact, as what follows
    for end in (0, 1):
        for way in np.vstack([np.eye(3), -np.eye(3)]):
            for far, clear in ((0.06, True), (0.0626, False)):
                moved = [a, b]
                moved[end] = moved[end] + far * way
                assert segment_surface.is_clear(data, 2, tuple(moved[0]), tuple(moved[1])) == clear
    segment_surface.keep_clear(data, 2, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 0.0)
    data.near.clear[2] = 0.0625
    assert not segment_surface.is_clear(data, 2, (0.0625, 0.0, 0.0), (0.0, 0.0, 0.0))
    data.near.clear[2] = 0.0
    assert not segment_surface.is_clear(data, 2, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
