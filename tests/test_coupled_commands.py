"""Commands to a coupled net between steps stay in force when a step is taken back."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from coupled import Scene, momenta
from test_couple_exudyn import Host

import exunet
from exunet import BodiesHost, Cosimulation, InputError, NetSystem
from exunet.bodies.port import rows_of
from exunet.coupling.rollback import NetAsLeft, Undo

# Each compiles kernels of its own.
pytestmark = pytest.mark.slow

WRENCH, STEP = "wrench/first", 0.005


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    return Scene(tmp_path_factory.mktemp("coupled"))


def pushed(net: NetSystem, force: float) -> None:
    net.simulation.set_input(WRENCH, [force, 0.0, 0.0, 0.0, 0.0, 0.0])


def ahead(net: NetSystem, duration: float = STEP) -> np.ndarray:
    return rows_of([net.frame("second").after(duration)])


def arrays(net: NetSystem) -> dict[str, np.ndarray]:
    return {**net.simulation.state.arrays(), **net.simulation.inputs}


def assert_same_bits(one: NetSystem, other: NetSystem) -> None:
    for name, values in arrays(one).items():
        np.testing.assert_array_equal(arrays(other)[name], values, err_msg=name)


@pytest.mark.ci
@pytest.mark.slow
def test_commands_between_steps_act_in_steps_that_are_taken_again(scene: Scene) -> None:
    """As by a net that never took the longer steps, to the last bit; also a command that comes after one."""
    net, plain = (NetSystem(scene.net, wrenches=("first",)) for _ in range(2))
    undo = Undo(net)
    for k in range(8):
        for item in (net, plain):
            if k in (1, 2, 5):
                pushed(item, 10.0 * k)
            item.simulation.set_force(1, [0.0, float(k // 4), 0.0])
        undo.step(net.time + 2.0 * STEP, ahead(net, 2.0 * STEP))
        if k == 3:
            pushed(net, 7.0)  # for what comes
        undo.back()
        if k == 3:
            pushed(plain, 7.0)
        assert net.time == plain.time
        assert_same_bits(net, plain)
        undo.step(net.time + STEP, ahead(net))
        plain.follow(plain.time + STEP, ahead(plain))
        assert_same_bits(net, plain)


class Ramp:
    """Commands the net within its steps, 1 N more each 2 ms."""

    period = 0.002

    def __init__(self) -> None:
        self.force = 0.0

    def act(self, simulation: exunet.Simulation) -> None:
        self.force += 1.0
        simulation.set_input(WRENCH, [self.force, 0.0, 0.0, 0.0, 0.0, 0.0])

    def state(self) -> dict[str, float]:
        return {"force": self.force}

    def restore(self, state: Mapping[str, Any]) -> None:
        self.force = float(state["force"])


@pytest.mark.ci
@pytest.mark.slow
def test_what_a_controller_commands_in_a_step_is_taken_back_with_it(scene: Scene) -> None:
    net, plain = (NetSystem(scene.net, wrenches=("first",)) for _ in range(2))
    for item in (net, plain):
        item.simulation.attach(Ramp())
    undo = Undo(net)
    for k in range(4):
        undo.step(net.time + 2.0 * STEP, ahead(net, 2.0 * STEP))
        if k == 2:  # one force of its own, for what comes; the ramp's is taken back
            net.simulation.set_force(1, [0.0, 1.0, 0.0])
        undo.back()
        if k == 2:
            plain.simulation.set_force(1, [0.0, 1.0, 0.0])
        assert_same_bits(net, plain)
        undo.step(net.time + STEP, ahead(net))
        plain.follow(plain.time + STEP, ahead(plain))
        assert_same_bits(net, plain)


@pytest.mark.slow
def test_a_step_in_which_the_host_fails_takes_no_command_away(scene: Scene) -> None:
    net = NetSystem(scene.net, wrenches=("first",))

    class Failing(BodiesHost):
        fails = False

        def step(self, until: float, loads: Any) -> None:
            if self.fails:
                raise InputError("the host failed")
            super().step(until, loads)

    host = Failing(BodiesHost.of_ports(net).simulation.start.scene)
    both = Cosimulation(net, host, step=STEP)
    pushed(net, 50.0)
    both.advance_to(0.02)
    before, host.fails = arrays(net), True
    with pytest.raises(InputError, match="the host failed"):
        both.advance_to(0.025)
    for name, values in before.items():
        np.testing.assert_array_equal(arrays(net)[name], values, err_msg=name)
    host.fails = False
    both.advance_to(0.025)


@pytest.mark.ci
@pytest.mark.slow
def test_where_a_net_stands_is_all_that_it_has_with_what_a_wrench_needs(scene: Scene) -> None:
    """First-order states, then place, velocity and spin of each body, then attitudes, entry by entry."""
    plain, net = NetSystem(scene.net), NetSystem(scene.net, wrenches=("first",))
    loads = net.follow(STEP, ahead(net))
    _, _, bodies, first_order = net.simulation.moving
    motion = np.hstack([bodies.position, bodies.velocity, bodies.angular_velocity])
    known = np.concatenate([first_order, motion.ravel(), bodies.attitude.ravel()])
    np.testing.assert_array_equal(loads.stands, known)
    np.testing.assert_array_equal(net.stands(), known)
    assert len(plain.stands()) < len(known)


@pytest.mark.ci_for("19")
@pytest.mark.slow
@pytest.mark.parametrize("attempt", [16, 17, 18, 19])
def test_a_command_counts_in_the_steps_that_the_host_keeps(scene: Scene, attempt: int) -> None:
    """By the momentum that it gives: 30 N from the beginning of an attempt on, rejected or not."""
    host, net = Host(scene, spring=2e4), NetSystem(scene.net, wrenches=("first",))
    ends: list[float] = []

    def mine(mbs: Any, t: float) -> bool:
        if len(ends) == attempt:
            pushed(net, 30.0)
        ends.append(t)
        return True

    host.mbs.SetPreStepUserFunction(mine)
    coupling = exunet.couple(host.mbs, net, {"second": host.marker})
    before = momenta(net.simulation)[0]
    host.solve("DOPRI5", 10, relativeTolerance=0.0, absoluteTolerance=1e-7, initialStepSize=0.024)
    report = coupling.report()
    assert report.repeated > 3
    assert any(after <= time for time, after in pairwise(ends[attempt:]))  # rejected later, if not at once
    kept = [time for time, after in pairwise(ends[:attempt]) if after > time]
    begin = (kept if ends[attempt] <= ends[attempt - 1] else [*kept, ends[attempt - 1]])[-1]
    gained = momenta(net.simulation)[0] + report.ports["second"].impulse - before
    expected = [30.0 * (net.time - begin), 0.0, 0.0]
    np.testing.assert_allclose(gained, expected, atol=1e-11)  # N s, of 6


@pytest.mark.ci
@pytest.mark.slow
def test_a_controller_between_the_steps_of_a_coupling(scene: Scene) -> None:
    """Commands have ports computed anew, and attitudes change by round-off: no reason to refuse."""
    net = NetSystem(scene.net, wrenches=("first",))
    both = Cosimulation(net, BodiesHost.of_ports(net), step=STEP)
    changed = 0
    for k in range(1, 25):
        before = net.simulation.view.bodies.attitude.copy()
        pushed(net, 5.0 * k)
        net.simulation.set_force(1, [1.0 * k, 0.0, 0.0])
        changed += not np.array_equal(before, net.simulation.view.bodies.attitude)
        both.advance_to(0.01 * k)
    assert changed > 0
    host, net = Host(scene), NetSystem(scene.net, wrenches=("first",))
    exunet.couple(host.mbs, net, {"second": host.marker})
    for k in range(24):
        host.solve("RK44", 2, on=k > 0, startTime=0.01 * k, endTime=0.01 * k + 0.01)
        pushed(net, 1.0 * k)
    left = NetAsLeft.of(net)
    net.simulation.view.bodies.attitude[1] += 1e-9
    assert not left.is_of(net)
