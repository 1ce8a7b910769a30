"""A net whose axes a body carries, in reference_impl: places, velocities, recoil of the launch, bad input."""

from __future__ import annotations

import math

import numpy as np
import pytest

from reference_impl import Refused, energy, read_document

BODY = {
    "mass": 40.0,
    "inertia": [8.0, 10.0, 12.0],
    "products_of_inertia": [0.5, -0.3, 0.2],
    "centre_of_mass": [0.1, -0.2, 0.3],
    "position": [5.0, 6.0, 7.0],
    "velocity": [0.3, -0.2, 0.1],
    "attitude": [1.0, 0.5, -0.2, 0.3],
    "angular_velocity": [0.05, 0.1, -0.2],
}
FRAME = {"body": "chief", "position": [0.2, 0.4, 0.8], "axis": [1.0, 2.0, 0.5], "angle": 0.7}


@pytest.fixture(scope="module")
def carried(document):
    """carried(topology): a net carried by a body."""

    def make(topology="square", **initial):
        case = document(topology)
        case["launch"]["axial_speed"] = 1.5
        return {**case, "initial": {"packing": 0.1, "frame": FRAME, **initial}, "bodies": {"chief": BODY}}

    return make


def books_at_start(made):
    bodies = made.bodies0
    return np.concatenate(
        (
            energy.momentum(made.system, made.v0, bodies),
            energy.angular_momentum(made.system, made.x0, made.v0, bodies),
        )
    )


@pytest.mark.parametrize("topology", ["square", "hexagonal", "radial"])
def test_launch_keeps_momentum_and_angular_momentum(carried, scene, topology):
    case = carried(topology)
    thrown = scene(case)
    del case["launch"]
    held = scene(case)
    assert books_at_start(thrown) == pytest.approx(books_at_start(held), abs=1e-12, rel=1e-13)
    assert np.abs(thrown.bodies0.velocity - held.bodies0.velocity).max() > 0.01
    assert np.abs(thrown.bodies0.angular_velocity - held.bodies0.angular_velocity).max() > 0.01


def test_a_throw_leaves_the_inner_nodes_of_tethers_as_they_are(carried, scene):
    """An impulse between bullets and body: both ends of a tether jump, its inner nodes do not.

    The momentum of all, tether included, is then kept although the tether is heavy.
    """
    case = carried()
    line = {"area": 1e-4, "density": 5000.0, "youngs_modulus": 1e9, "length": 9.0, "divisions": 4}
    case["tethers"] = {"line": {**line, "start": {"bullet": 2}, "end": {"body": "chief"}}}
    for launch in ({"radial_speed": 2.5, "axial_speed": 1.5}, {"speed": 3.0, "spread_angle": 0.4}):
        thrown = scene({**case, "launch": launch})
        held = scene({key: value for key, value in case.items() if key != "launch"})
        inner = slice(thrown.net.woven + 1, None)  # after the end on the body
        assert len(thrown.v0[inner]) == 3
        assert np.array_equal(thrown.v0[inner], held.v0[inner])
        assert (
            np.abs(thrown.v0[thrown.net.numbered_bullets[2]] - held.v0[thrown.net.numbered_bullets[2]]).max()
            > 1.0
        )
        assert np.abs(thrown.v0[thrown.net.woven] - held.v0[thrown.net.woven]).max() > 0.01
        assert books_at_start(thrown) == pytest.approx(books_at_start(held), abs=1e-12, rel=1e-13)


def test_all_is_one_rigid_motion_before_the_launch(carried, scene):
    """Distances are those of the net's axes; velocities those of the body at the nodes' places."""
    case = carried()
    del case["launch"], case["initial"]["frame"]
    own = scene(case)
    made = scene({**case, "initial": {"packing": 0.1, "frame": FRAME}})
    (body,) = made.case.bodies
    origin, _ = body.at(np.array(FRAME["position"]))
    axes = np.linalg.lstsq(own.x0, made.x0 - origin, rcond=None)[0]
    assert made.x0 == pytest.approx(origin + own.x0 @ axes, abs=1e-14)
    own_frame = (made.x0 - body.position) @ body.attitude
    assert made.v0 == pytest.approx(np.array([body.at(place)[1] for place in own_frame]), abs=1e-14)
    assert body.at(body.centre_of_mass)[1] == pytest.approx(BODY["velocity"], abs=1e-15)


def test_the_throw_is_along_the_carried_axis(carried, scene):
    """A quarter turn of the frame about x brings +z to -y; the body is not turned."""
    case = carried(frame={"body": "chief", "axis": [1.0, 0, 0], "angle": math.pi / 2.0}, velocity=[0, 0, 2.0])
    case["initial"]["spin"] = [0.0, 0.0, 1.0]
    case["bodies"] = {"chief": {"mass": 1e12, "inertia": [1e12] * 3}}
    case["launch"]["radial_speed"] = 0.0
    made = scene(case)
    mean = made.v0[made.net.bullet_nodes].mean(axis=0)
    assert mean == pytest.approx([0.0, -3.5, 0.0], abs=1e-11)
    assert made.x0[:, 1] == pytest.approx(0.0, abs=1e-15)
    spin = np.cross([0.0, -1.0, 0.0], made.x0)
    assert made.v0[:, [0, 2]] == pytest.approx(spin[:, [0, 2]], abs=1e-11)


@pytest.mark.parametrize(
    ("frame", "words"),
    [
        ({"body": "none"}, "initial.frame.body: there is no body none"),
        ({}, "initial.frame.body: missing"),
        ({**FRAME, "attitude": [1.0, 0, 0, 0]}, "give either initial.frame.attitude or"),
        ({**FRAME, "velocity": [1.0, 0, 0]}, "reference_impl does not know initial.frame.velocity"),
    ],
)
def test_bad_frames_are_refused(carried, frame, words):
    with pytest.raises(Refused) as refused:
        read_document(carried(frame=frame))
    assert any(words in fault for fault in refused.value.faults), refused.value.faults


def test_a_point_mass_throws_no_carried_net(carried):
    case = carried()
    del case["launch"]
    force = {"kind": "spring", "force": 1.0, "stroke": 0.1, "spread_angle": 0.1, "chaser_mass": 1.0}
    with pytest.raises(Refused, match=r"effects\.launch_force\.chaser_mass: a point mass .* initial\.frame"):
        read_document({**case, "effects": {"launch_force": force}})
