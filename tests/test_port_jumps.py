"""What change of pose over a step is a jump: motions of consistent integrators pass, others are told."""

from __future__ import annotations

import math
from typing import Any

import exudyn as exu
import numpy as np
import pytest
from coupled import Scene
from test_couple_exudyn import Host

import exunet
from exunet import FrameState, InputError, NetSystem
from exunet.bodies.port import jump_of, quaternion_of, times
from exunet.coupling.ports import OWN, TOLD

H, SPEED = 0.01, 0.8  # s, m/s or rad/s: 8 mm, or 8 mrad, in a step


def along(place: float, speed: float, turns: bool) -> FrameState:
    """On the x axis, or about it."""
    if turns:
        return FrameState((0.0,) * 3, (0.0,) * 3, quaternion_of((place, 0.0, 0.0)), (speed, 0.0, 0.0))
    return FrameState((place, 0.0, 0.0), (speed, 0.0, 0.0))


def judged(way: float, begin: float, end: float, turns: bool, last: float = 0.0, part: float = OWN) -> bool:
    """True if a way over the step with velocities at both ends, and an acceleration before, is no jump."""
    states = along(0.3, begin, turns), along(0.3 + way, end, turns)
    kind, _, _ = jump_of(H, *states, last, last, part, 1.0)
    return bool(kind < 0)


@pytest.mark.parametrize("turns", [False, True])
@pytest.mark.parametrize(
    ("begin", "end"), [(SPEED, SPEED), (SPEED, 3.0 * SPEED), (SPEED, -SPEED), (0.0, SPEED), (SPEED, 0.0)]
)
def test_integrators_of_first_order_and_better_pass(begin: float, end: float, turns: bool) -> None:
    """By the first velocity, the last, the mean, and a bounce anywhere in the step; 3 steps off do not."""
    for place in np.linspace(0.0, 1.0, 11):
        way = H * (place * begin + (1.0 - place) * end)
        assert judged(way, begin, end, turns)
        off = 3.0 * H * max(abs(begin), abs(end))
        assert not judged(way + off, begin, end, turns)
        assert not judged(way - off, begin, end, turns)


@pytest.mark.parametrize("turns", [False, True])
def test_steady_motion_may_be_off_by_a_tenth_of_its_way(turns: bool) -> None:
    """In any direction, however fast: no more is explained without an acceleration."""
    for part, passes in ((0.09, True), (0.11, False), (1.0, False), (2.5, False)):
        for sign in (1.0, -1.0):
            assert judged((1.0 + sign * part) * H * SPEED, SPEED, SPEED, turns) == passes
    assert not judged(1e-6, 0.0, 0.0, turns)  # at rest


def test_a_side_step_is_a_jump() -> None:
    states = along(0.0, SPEED, False), along(H * SPEED, SPEED, False)._replace(position=(0.008, 0.008, 0.0))
    kind, off, _ = jump_of(H, *states, 0.0, 0.0, OWN, 1.0)
    assert (kind, off) == (0, pytest.approx(0.008))  # of the place, by 8 mm


@pytest.mark.parametrize("turns", [False, True])
def test_a_swing_of_a_radian_a_step_passes_in_any_phase(turns: bool) -> None:
    """Exact states, without a step before; of 2.4 rad, the most with repeats, with the one before."""
    for swing, known in ((1.0, False), (2.4, True)):
        rate = swing / H
        for phase in np.linspace(0.0, 2.0 * math.pi, 181):
            place = [1e-3 * math.sin(phase + k * swing) for k in range(3)]
            speed = [1e-3 * rate * math.cos(phase + k * swing) for k in range(3)]
            last = abs(speed[1] - speed[0]) / H if known else 0.0
            assert judged(place[2] - place[1], speed[1], speed[2], turns, last)


@pytest.mark.parametrize("turns", [False, True])
def test_states_that_were_predicted_may_be_put_right(turns: bool) -> None:
    """At constant velocity, of a symplectic Euler host that a force meets: off by 3/2 of what it changes."""
    before, after = SPEED, SPEED + 0.4
    told = H * before  # where the net was told the host would be
    now = H * after  # where it is
    way = now + H * after - told
    assert judged(way, before, after, turns, part=TOLD)
    assert not judged(way, before, after, turns, part=OWN)
    assert not judged(way + 0.2 * H * after, before, after, turns, part=TOLD)


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    return Scene(tmp_path_factory.mktemp("coupled"))


nets = pytest.mark.slow  # each compiles kernels of its own


class TestWithNets:
    pytestmark = nets

    @pytest.mark.slow
    def test_a_net_is_told_no_jump_in_any_direction(self, scene: Scene) -> None:
        """Off by parts of the way of a step; up to 2.5 of them passed before, backwards."""
        net = NetSystem(scene.net)
        for k in range(3):
            net.step((k + 1) * H, {"second": net.frame("second").after(H)})
        start, here = net.frame("second"), net.snapshot()
        speed = np.array(start.velocity)
        for part in (0.5, 1.0, 2.5, -0.5, -1.0, -2.5):
            end = start.after(H)
            place = tuple((np.array(end.position) - part * H * speed).tolist())
            with pytest.raises(InputError, match=r"port second jumps: .* its position is"):
                net.step(net.time + H, {"second": end._replace(position=place)})
        for angle in (0.01, 0.05, 0.08, -0.05):  # rad; the turn of the step is 0.02. The centre moves too
            turn = times(start.after(H).attitude, quaternion_of((0.0, -angle, 0.0)))
            with pytest.raises(InputError, match=r"port second jumps: .* its (attitude|position) is"):
                net.step(net.time + H, {"second": start.after(H)._replace(attitude=turn)})
        assert net.time == pytest.approx(3 * H)
        assert net.snapshot().as_bytes() == here.as_bytes()
        net.step(net.time + H, {"second": start.after(H)})
        net.restore(here)  # a step taken again, shorter
        net.step(net.time + 0.3 * H, {"second": start.after(0.3 * H)})

    @pytest.mark.slow
    @pytest.mark.parametrize("jump", [-0.02, -0.01, -0.003, 0.003, 0.01])
    def test_a_host_of_couple_that_is_moved_by_hand_is_told(self, scene: Scene, jump: float) -> None:
        """By -20 mm and 10 mm, of 6 mm a step; all but 1 m passed before."""
        host, net, moved = Host(scene), NetSystem(scene.net), []

        def hook(mbs: Any, t: float) -> bool:
            if t > 0.1 and not moved:
                coordinates = np.array(mbs.systemData.GetODE2Coordinates())
                coordinates[0] += jump
                mbs.systemData.SetODE2Coordinates(coordinates)
                moved.append(t)
            return True

        host.mbs.SetPreStepUserFunction(hook)
        exunet.couple(host.mbs, net, {"second": host.marker})
        with pytest.raises(exu.ModelError, match=r"host's body at port second jumps: .* its position is"):
            host.solve("RK44", 24)
        assert net.time == pytest.approx(moved[0] - H)
