"""Hosts that a user writes: their clock is compared with the net's, and what they lack is told."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from coupled import Scene, momenta

from exunet import BodiesHost, Cosimulation, InputError

# Each compiles kernels of its own.
pytestmark = pytest.mark.slow

STEP, GOOD = 0.01, 3  # s; steps before the fault


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    return Scene(tmp_path_factory.mktemp("coupled"))


class Own:
    """Steps another host, and tells a time of its own: wrong from the fourth step on, until it is mended.

    how : "late" or "early" by a tenth of a step, "back" to 5 ms, "still" at where the step began
    """

    def __init__(self, host: BodiesHost, how: str) -> None:
        self._host, self.how = host, how

    def __getattr__(self, name: str) -> Any:
        return getattr(self._host, name)

    def step(self, until: float, loads: dict[str, Any]) -> None:
        if until < (GOOD + 0.5) * STEP or not self.how:
            self._host.step(until, loads)
        elif self.how == "back":
            self._host.simulation.reset()
            self._host.step(0.5 * STEP, loads)
        elif self.how != "still":
            self._host.step(until + (0.1 if self.how == "late" else -0.1) * STEP, loads)


@pytest.mark.slow
@pytest.mark.parametrize("iterations", [1, 20])
@pytest.mark.parametrize(
    ("how", "words"),
    [
        ("late", r"is at 0\.041 s: it ended too late"),
        ("early", r"is at 0\.039 s: it ended too early"),
        ("back", r"is at 0\.005 s: it went back in time"),
        ("still", r"is at 0\.03 s: it has stood still"),
    ],
)
def test_a_host_that_ends_at_another_time_is_told(
    scene: Scene, iterations: int, how: str, words: str
) -> None:
    """In the step in which it does, with both times; it was booked, and 1.6 % of the momentum went astray."""
    net, host = scene.both()
    before = momenta(net.simulation)[0] + momenta(host.simulation)[0]
    own = Own(host, how)
    both = Cosimulation(net, own, step=STEP, iterations=iterations)
    asked = r"the host, a Own, was asked to step from t = 0\.03 s to 0\.04 s and "
    with pytest.raises(InputError, match=asked + words):
        both.advance_to(0.1)
    assert both.books.steps == GOOD
    assert net.time == both.time == pytest.approx(GOOD * STEP)
    own.how = ""
    if iterations == 1 and how != "still":  # the host went elsewhere, and cannot be set back
        with pytest.raises(InputError, match=r"the net at 0\.03 s: restore both by a snapshot"):
            both.advance_to(0.1)
        return
    assert host.time == net.time
    both.advance_to(0.1)
    now = momenta(net.simulation)[0] + momenta(host.simulation)[0]
    assert np.abs(now - before).max() < 1e-12 * 1.8  # N s, of the second body, as in test_coupling


class Adds(Own):
    """Adds its own steps up to the time that it is given: off by round-off only."""

    own_step, clock = STEP / 7.0, 0.0

    @property
    def time(self) -> float:
        return self.clock

    def step(self, until: float, loads: dict[str, Any]) -> None:
        while self.clock < until - 1e-9:
            self.clock += self.own_step
        self._host.step(until, loads)


@pytest.mark.slow
def test_times_that_are_added_up_pass(scene: Scene) -> None:
    net, host = scene.both()
    both = Cosimulation(net, Adds(host, ""), step=STEP)
    both.advance_to(0.3)
    assert (both.books.steps, net.time) == (30, 0.3)


@pytest.mark.ci_for("time")
@pytest.mark.slow
@pytest.mark.parametrize("what", ["time", "place"])
def test_a_host_that_is_not_restored_is_told(scene: Scene, what: str) -> None:
    """Repeats from where it had ended were taken for agreement: its load was booked, and it had the first."""

    class Forgets(Own):
        def restore(self, snapshot: Any) -> None:
            if what == "place":
                self.back = True

        def __getattr__(self, name: str) -> Any:
            return getattr(self._host, name)

        @property
        def time(self) -> float:
            return 0.0 if getattr(self, "back", False) else self._host.time

    net, host = scene.both()
    both = Cosimulation(net, Forgets(host, ""), step=STEP, iterations=20)
    words = (
        r"the host, a Forgets, was to go back to t = 0 s by its `restore`, and is at 0(\.01)? s; its bodies"
    )
    with pytest.raises(InputError, match=words):
        both.advance_to(0.1)
    assert (net.time, both.books.steps) == (0.0, 0)


@pytest.mark.ci
@pytest.mark.slow
def test_what_is_no_net_or_no_host_is_told(scene: Scene) -> None:
    net, host = scene.both()

    class Wrong(Own):
        def frames(self) -> Any:
            return self.how if self.how == "no frames" else self._host.frames()

        def shared(self) -> Any:
            return {"no groups": 3.0, "names": ("second",)}.get(self.how, ())

        @property
        def time(self) -> Any:
            return None if self.how == "no time" else self._host.time

    for one, other, words in (
        (None, host, "net: an exunet.NetSystem, got NoneType"),
        (host, net, "net: an exunet.NetSystem, got BodiesHost"),
        (net, None, "host: a NoneType has no time, frames, step"),
        (net, net, "host: a NetSystem has no frames, shared, .*BodiesHost.of_ports"),
        (net, Wrong(host, "no time"), "the host, a Wrong, tells no time: None"),
        (net, Wrong(host, "no frames"), "tells no bodies: its `frames` gave str"),
        (net, Wrong(host, "no groups"), r"its `shared` gave 3\.0, not groups of ports"),
        (net, Wrong(host, "names"), r"its `shared` gave \('second',\), not groups"),
    ):
        with pytest.raises(InputError, match=words):
            Cosimulation(one, other, step=STEP)
    for given in (None, host):
        with pytest.raises(InputError, match=r"BodiesHost.of_ports: an exunet\.NetSystem, got"):
            BodiesHost.of_ports(given)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="BodiesHost: ports: a body's name by the name of each port"):
        BodiesHost(scene.whole, ports=["second"])  # type: ignore[arg-type]


@pytest.mark.slow
def test_a_body_may_have_a_port_that_the_net_has_not(scene: Scene) -> None:
    class More(Own):
        def shared(self) -> tuple[tuple[str, ...], ...]:
            return (("second", "elsewhere"),)

    net, host = scene.both()
    both = Cosimulation(net, More(host, ""), step=STEP)
    assert both.longest == Cosimulation(*scene.both(), step=STEP).longest
    both.advance_to(0.05)
    assert both.books.steps == 5
