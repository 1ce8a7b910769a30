"""A coupling restored, also in another process; commands to the net in repeated steps."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from coupled import ExudynBody, Scene, ahead, assert_same_bits, everything

import exunet
from exunet import BodiesHost, CoupledSnapshot, Coupler, InputError, NetSystem
from exunet.coupling.rollback import Predictor, StepHistory

HERE, END, STEP = 0.21, 0.24, 0.01  # s; the cable snaps taut at some 0.1 s
WRENCH, SHORT = "wrench/first", 0.005


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    return Scene(tmp_path_factory.mktemp("coupled"))


def made(scene: Scene, host: str = "bodies", **arguments: Any) -> tuple[NetSystem, Any, Coupler]:
    net: NetSystem = NetSystem(scene.net)
    own: Any = BodiesHost.of_ports(net)
    if host != "bodies":
        system = ExudynBody.second(scene)
        own = exunet.ExudynHost(system.mbs, {"second": system.marker}, step=1e-3, method=host)
        own.keeps = system  # alive
    return net, own, Coupler(net, own, step=STEP, **arguments)


@pytest.mark.ci_for("{}-RK44")
@pytest.mark.slow
@pytest.mark.parametrize("host", ["bodies", "RK44", "GeneralizedAlpha"])
@pytest.mark.parametrize("arguments", [{}, {"iterations": 20}], ids=str)
def test_a_coupler_continues_bitwise(
    scene: Scene, tmp_path: Path, host: str, arguments: dict[str, Any]
) -> None:
    """In the middle of a snap: restored, restored after a reset of all, and in new ones from a file."""
    net, own, coupler = made(scene, host, **arguments)
    coupler.advance_to(HERE)
    assert net.simulation.net.tension.max() > 1.0  # N: taut
    here = coupler.snapshot()
    assert here.time == HERE
    here.save(tmp_path / "here")
    coupler.advance_to(END)
    once = everything(net, coupler, own)
    coupler.restore(here)
    assert coupler.time == net.time == own.time == HERE
    coupler.advance_to(END)
    assert everything(net, coupler, own) == once
    net, own, coupler = made(scene, host, **arguments)
    coupler.restore(CoupledSnapshot.load(tmp_path / "here"))
    coupler.advance_to(END)
    assert everything(net, coupler, own) == once


@pytest.mark.ci_for("other steps-1")
@pytest.mark.slow
@pytest.mark.parametrize("iterations", [1, 20])
@pytest.mark.parametrize("back", ["both", "net", "reset", "other steps"])
def test_net_and_host_that_were_restored_separately_are_refused(
    scene: Scene, iterations: int, back: str
) -> None:
    """The motion before was that of a later time."""
    net, host, coupler = made(scene, iterations=iterations)
    coupler.advance_to(HERE - STEP)
    here, kept = coupler.snapshot(), (net.snapshot(), host.snapshot())
    coupler.advance_to(HERE)
    if back == "reset":
        net.reset()
        host.simulation.reset()
    else:
        net.restore(kept[0])
        if back == "other steps":  # to the time at which the coupling is, by another way
            net.step(HERE, {"second": net.frame("second").after(STEP)})
        elif back == "both":
            host.restore(kept[1])
    for attempt in (lambda: coupler.advance_to(END), coupler.snapshot):
        with pytest.raises(InputError, match="snapshot of the"):
            attempt()
    coupler.restore(here)
    coupler.advance_to(END)
    _, _, straight = made(scene, iterations=iterations)
    for until in (HERE - STEP, END):
        straight.advance_to(until)
    assert straight.ledger.as_array().tobytes() == coupler.ledger.as_array().tobytes()


@pytest.mark.ci
@pytest.mark.slow
def test_snapshots_of_another_net_host_coupling_or_arguments(scene: Scene, tmp_path: Path) -> None:
    """They are refused, and nothing has moved."""
    net, host, coupler = made(scene)
    coupler.advance_to(0.05)
    here, before = coupler.snapshot(), everything(net, coupler, host)
    others = [made(scene, "RK44"), made(scene, iterations=20)]
    for change in ("bodies.first.mass=2.5", "bodies.second.angular_velocity=[0.0, 110.0, 0.0]"):
        other = NetSystem(scene.net, [change])  # the second cuts the step
        others.append((other, None, Coupler(other, BodiesHost.of_ports(other), step=STEP)))
    given = [None, net.snapshot(), *(other.snapshot() for *_, other in others)]
    damaged = dict(here.discrete) | {"ledger": np.zeros(3)}
    given.append(CoupledSnapshot(here.ports, here.net, here.host, damaged))
    for snapshot in given:
        with pytest.raises(InputError):
            coupler.restore(snapshot)  # type: ignore[arg-type]
        assert everything(net, coupler, host) == before
    coupler.restore(here)
    with pytest.raises(InputError, match="tuple"):
        CoupledSnapshot(here.ports, here.net, (1.0,), here.discrete).save(tmp_path / "no")
    net.snapshot().save(tmp_path / "net")
    with pytest.raises(InputError, match="requires"):
        CoupledSnapshot.load(tmp_path / "net")


# Repeated steps of the net, and commands


def test_the_step_before_is_the_one_that_began_earlier() -> None:
    """A repeated step begins when the kept one did: none was before it."""
    predictor, (now, before) = Predictor(), np.random.default_rng(1).normal(size=(2, 2, 13))
    predictor.keep(1.0, before, recoils=False)
    for begin, since, states in ((1.25, 0.25, before), (1.0, 0.0, now), (0.5, 0.0, now)):
        found, of = predictor.earlier(begin, now)
        assert of == since
        np.testing.assert_array_equal(found, states)


def pushed(net: NetSystem, force: float) -> None:
    net.simulation.set_input(WRENCH, [force, 0.0, 0.0, 0.0, 0.0, 0.0])


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


def between(net: NetSystem, k: int) -> None:
    if k in (1, 2, 5):
        pushed(net, 10.0 * k)
    net.simulation.set_force(1, [0.0, float(k // 4), 0.0])


COMMANDS: dict[str, tuple[Callable[[NetSystem, int], None], Callable[[NetSystem], None], bool]] = {
    # before a step, after the one that is undone, with a controller
    "none": (lambda net, k: None, lambda net: None, False),
    "commands": (between, lambda net: pushed(net, 7.0), False),
    "controller": (lambda net, k: None, lambda net: net.simulation.set_force(1, [0.0, 1.0, 0.0]), True),
}


@pytest.mark.ci
@pytest.mark.slow
@pytest.mark.parametrize("what", COMMANDS)
def test_an_undone_step_is_as_if_it_had_not_been(scene: Scene, what: str) -> None:
    """Bitwise; commands between steps act in repeated ones, those after the undone step in the next.

    Commands of a controller within it are undone.
    """
    before, after, controlled = COMMANDS[what]
    net, plain = (NetSystem(scene.net, wrenches=("first",)) for _ in range(2))
    if controlled:
        for item in (net, plain):
            item.simulation.attach(Ramp())
    history = StepHistory(net)
    for k in range(8):  # beyond the first snapshots
        for item in (net, plain):
            before(item, k)
        history.step(net.time + 2.0 * SHORT, ahead(net, 2.0 * SHORT))
        if k == 3:
            after(net)
        assert history.begin == plain.time
        history.undo()
        if k == 3:
            after(plain)
        assert net.time == plain.time
        assert_same_bits(net, plain)
        history.step(net.time + SHORT, ahead(net, SHORT))
        plain.follow(plain.time + SHORT, ahead(plain, SHORT))
        assert_same_bits(net, plain)


@pytest.mark.ci
@pytest.mark.slow
def test_commands_change_attitudes_by_round_off_only(scene: Scene) -> None:
    """Commands compute ports anew: no reason to refuse; a change of 1e-9 is."""
    net = NetSystem(scene.net, wrenches=("first",))
    coupler, changed = Coupler(net, BodiesHost.of_ports(net), step=SHORT), 0
    for k in range(1, 25):
        before = net.simulation.view.bodies.attitude.copy()
        pushed(net, 5.0 * k)
        net.simulation.set_force(1, [1.0 * k, 0.0, 0.0])
        changed += not np.array_equal(before, net.simulation.view.bodies.attitude)
        coupler.advance_to(0.01 * k)
    assert changed > 0
    net.simulation.view.bodies.attitude[1] += 1e-9
    with pytest.raises(InputError, match="not where the coupling left it"):
        coupler.advance_to(0.3)
