"""Coupler of a net and a host: momentum, order, energy, and hosts that fail or are a user's own."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from coupled import CHAIN, LUMP, MOMENTUM, Scene, centre, energy_of, momenta, spring, sums

import exunet
from exunet import BodiesHost, Coupler, FrameState, Host, InputError, NetSystem, PortLoad
from exunet.bodies.rotations import rotation_matrix
from exunet.coupling.rollback import DOUBTFUL, NEGLIGIBLE, PortBalance
from exunet.coupling.stability import STABLE, LongestStep, longest_step

END = 0.3


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    return Scene(tmp_path_factory.mktemp("coupled"))


@pytest.mark.slow
@pytest.mark.parametrize("iterations", [1, 20])
def test_second_order_in_the_macro_step(scene: Scene, iterations: int) -> None:
    errors, known = [], scene.in_one(END).state.bodies.position[1]
    for step in (8e-3, 4e-3, 2e-3):
        net, host = scene.both()
        Coupler(net, host, step=step, iterations=iterations).advance_to(END)
        errors.append(float(np.linalg.norm(centre(host) - known)))
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert (orders > 1.7).all(), f"errors {errors}, orders {orders}"
    assert errors[-1] < 1e-5  # of a way of 0.2 m


@pytest.mark.ci_for("1")
@pytest.mark.slow
@pytest.mark.parametrize("iterations", [1, 20])
def test_momentum_is_kept_at_any_step_and_the_residual_is_the_drift_of_energy(
    scene: Scene, iterations: int
) -> None:
    net, host = scene.both()
    before, turned = sums(net, host), []
    for step in (0.02, 0.005):
        net, host = scene.both()
        coupler, worst = Coupler(net, host, step=step, iterations=iterations), 0.0
        for until in (0.1, 0.2, 0.3):
            coupler.advance_to(until)
            now = sums(net, host)
            assert np.abs(now[0] - before[0]).max() < 1e-12 * MOMENTUM
            worst = max(worst, float(np.abs(now[1] - before[1]).max()))
        turned.append(worst)
        drift = energy_of(net, host) - before[2]
        assert abs(drift) > 1e-8  # far above round-off of the 1.5 J that there are
        assert coupler.ledger.residual == pytest.approx(drift, rel=0.1)
    assert turned[1] < turned[0] / 3.0  # at least of the order log 3 / log 4 = 0.8; measured 2
    assert turned[0] < 1e-2 * np.abs(before[1]).max()
    assert "port second" in str(coupler.ledger)


def spinning(folder: Path, spin: float) -> Scene:
    """The second body, its frame in its centre and axes, turns about z [rad/s]."""
    plain = (
        ("products_of_inertia = [0.05, 0.02, 0.01]\n", ""),
        ("centre_of_mass = [0.1, 0.2, 0.3]\n", ""),
        ("= [0.1, 2.0, 0.0]", f"= [0.0, 0.0, {spin}]"),
    )
    return Scene(folder, *plain)


@pytest.mark.ci_for("90.0-1")
@pytest.mark.slow
@pytest.mark.parametrize("iterations", [1, 20])
@pytest.mark.parametrize("spin", [20.0, 90.0])  # rad/s
def test_the_residual_of_a_body_that_spins(tmp_path: Path, iterations: int, spin: float) -> None:
    """About an axis that moves: torque by the rotation vector would be wrong by a factor of 10 and more."""
    net, host = spinning(tmp_path, spin).both()
    start, coupler = energy_of(net, host), Coupler(net, host, step=0.5 / spin, iterations=iterations)
    coupler.advance_to(0.2)
    drift = energy_of(net, host) - start
    assert abs(drift) > 1e-5  # J, far above round-off of the 1.6 kJ that there are
    assert coupler.ledger.residual == pytest.approx(drift, rel=0.05)


@pytest.mark.ci
@pytest.mark.slow
def test_a_radian_in_a_step_is_the_limit(tmp_path: Path) -> None:
    """Steps are cut, and the motion is near to one system; refused where the host chooses the step."""
    scene = spinning(tmp_path, 90.0)
    net, host = scene.both()
    assert longest_step(net, STABLE) == pytest.approx(1.0 / 90.0, rel=1e-3)
    coupler = Coupler(net, host, step=0.05)
    assert "0.05 s cut to 0.01111 s" in coupler.ledger.note
    coupler.advance_to(0.2)
    assert 90.0 * coupler.ledger.longest < 1.0
    off = centre(host) - scene.in_one(0.2).state.bodies.position[1]
    assert np.linalg.norm(off) < 1e-4  # m, of a way of 0.1 m
    net.reset()
    frame = net.frame("second")
    for step in (0.02, 0.07):  # by 1.8 rad; by 6.3 rad, which looks like a small turn back
        with pytest.raises(InputError, match=f"port second turns too far.* {90.0 * step:.2g} rad"):
            net.step(step, {"second": frame.after(step)})
    assert net.time == 0.0


@pytest.mark.slow
def test_a_host_that_is_another_net(tmp_path: Path) -> None:
    """The second body has a second cable, to a mass of 1 kg; in one system it has both.

    It does not turn at the start, so that its velocity is that of its frame with any nodes on it.
    """
    still = "bodies.second.angular_velocity=[0.0, 0.0, 0.0]"
    state = NetSystem(Scene(tmp_path).net).frame("second")
    turn, place = rotation_matrix(np.array(state.attitude)), np.array(state.position)
    ends = [(place + turn @ point).tolist() for point in ([-0.1, 0.1, 0.2], [0.3, 0.0, 0.0])]
    far, zeros = np.add(ends[1], [0.0, 1.02, 0.0]).tolist(), [0.0, 0.0, 0.0]  # stretched by 2 %
    points = "{{x={{point=[-0.1, 0.1, 0.2], node={}}}, y={{point=[0.3, 0.0, 0.0], node={}}}}}"
    second = "bodies.second.attachments=" + points
    both = [
        still,
        f"initial.node_positions=[{zeros}, [1.05, 0.0, 0.0], {ends[0]}, {ends[1]}, {far}]",
        f"initial.node_velocities=[{zeros}, [0.5, 0.1, 0.0], {zeros}, {zeros}, {zeros}]",
        f"net.nodes=[{zeros}, [1.0, 0.0, 0.0], [2.0, 0.0, 0.0], [5.0, 0.0, 0.0], [5.0, 1.0, 0.0]]",
        "net.elements=[[0, 1], [1, 2], [3, 4]]",
        "net.node_masses=[0.1, 0.5, 0.1, 0.2, 1.0]",
        second.format(2, 3),
    ]
    alone = [
        still,
        f"initial.node_positions=[{ends[0]}, {ends[1]}, {far}]",
        f"initial.node_velocities=[{zeros}, {zeros}, {zeros}]",
        f"net.nodes=[{zeros}, [5.0, 0.0, 0.0], [5.0, 1.0, 0.0]]",
        "net.elements=[[1, 2]]",
        f"net.node_masses=[{0.1 + LUMP}, 0.2, 1.0]",
        "bodies.first=",
        second.format(0, 1),
    ]
    known = exunet.Simulation(tmp_path / "whole.toml", both)
    before = momenta(known)[0]
    known.advance_to(END)
    errors = []
    for step in (8e-3, 4e-3):
        net, host = NetSystem(tmp_path / "net.toml", [still]), BodiesHost(tmp_path / "whole.toml", alone)
        Coupler(net, host, step=step, iterations=20).advance_to(END)
        assert np.abs(sums(net, host)[0] - before).max() < 1e-12 * MOMENTUM
        errors.append(np.linalg.norm(centre(host) - known.state.bodies.position[1]))
    assert errors[0] / errors[1] > 0.8 * 4.0, errors


TWO_PORTS = CHAIN.split("[bodies.first]")[0].replace("1.05, 0.0, 0.0], [2.0", "1.05, 0.4, 0.0], [2.0")
ENDS = ("attachments.x = {{ point = [-1.0, 0.0, 0.0], node = {} }}\n",
        "attachments.y = {{ point = [1.0, 0.0, 0.0], node = {} }}\n")  # fmt: skip
BODY = """
[bodies.{}]
motion = "{}"
mass = 2.0
inertia = [0.2, 0.3, 0.4]
position = [1.0, 0.0, 0.0]
"""


@pytest.mark.slow
def test_two_ports_of_one_body(tmp_path: Path) -> None:
    """A mass on two cables to both ends of a body: both pull, and the sum of what pulls bounds the step."""
    ports = [BODY.format(name, "port") + end for name, end in zip("ab", ENDS, strict=True)]
    (tmp_path / "net.toml").write_text(TWO_PORTS + "".join(ports).format(0, 2))
    base = TWO_PORTS + BODY.format("base", "free")
    (tmp_path / "whole.toml").write_text(base + "".join(ENDS).format(0, 2))
    alone = base.replace("net.elements = [[0, 1], [1, 2]]", "net.elements = []")
    alone = alone.replace("[0.1, 0.5, 0.1]", f"[{0.1 + LUMP}, 0.5, {0.1 + LUMP}]")
    (tmp_path / "base.toml").write_text(alone + "".join(ENDS).format(0, 2))
    known = exunet.Simulation(tmp_path / "whole.toml")
    before = momenta(known)
    known.advance_to(END)
    errors = []
    for step in (8e-3, 4e-3):
        net = NetSystem(tmp_path / "net.toml")
        host = BodiesHost(tmp_path / "base.toml", ports={"a": "base", "b": "base"})
        coupler = Coupler(net, host, step=step)
        coupler.advance_to(END)
        given = sum(port.impulse for port in coupler.ledger.ports.values())
        errors.append(float(np.linalg.norm(centre(host) - known.state.bodies.position[0])))
        velocity = host.simulation.state.bodies.velocity[0]
        assert np.abs((2.0 + 0.2 + 2.0 * LUMP) * velocity - given).max() < 1e-12  # N s; it was at rest
        assert np.abs(momenta(net.simulation)[0] + given - before[0]).max() < 1e-12
    assert errors[0] / errors[1] > 0.8 * 4.0, errors
    # two cables alike, so twice the stiffness of one
    begin = NetSystem(tmp_path / "net.toml")
    springs = STABLE._replace(modes=STABLE.modes._replace(most=0.0))  # nothing is fed
    together = LongestStep(begin, springs, host.shared()).now
    assert together == pytest.approx(longest_step(begin, springs) / np.sqrt(2.0), rel=1e-12)
    assert coupler.longest < longest_step(begin, STABLE)  # by modes, of one cable's nodes and of both


@pytest.mark.parametrize(
    ("balance", "doubtful"),
    [
        (PortBalance(residual=2.5e-26, net_energy=1e-9), False),  # round-off, at a port that nothing moves
        (PortBalance(residual=2.0 * NEGLIGIBLE, net_energy=1.0), True),  # added, and nothing went through
        (PortBalance(residual=-2.0 * NEGLIGIBLE, net_energy=1.0), True),
        (PortBalance(residual=0.5 * NEGLIGIBLE, net_energy=1.0), False),
        (PortBalance(residual=1.0, max_work=0.5 / DOUBTFUL, net_energy=1.0), True),
        (PortBalance(residual=1.0, max_work=2.0 / DOUBTFUL, net_energy=1.0), False),
        (PortBalance(residual=1.0, max_work=0.5 / DOUBTFUL, net_energy=2.0 / NEGLIGIBLE), False),
    ],
)
def test_which_residuals_are_doubtful(balance: PortBalance, doubtful: bool) -> None:
    assert balance.is_doubtful == doubtful


@pytest.mark.slow
def test_steps_that_the_stretch_makes_too_long_are_cut_on_the_way(tmp_path: Path) -> None:
    """A body that swings at 8 m/s between two cables: the longest step is less where that is stretched."""
    net, host = spring(tmp_path, speed=8.0)
    coupler, begin = Coupler(net, host, step=1.0), energy_of(net, host)
    longest = coupler.longest
    for _ in range(60):
        coupler.advance_to(coupler.time + longest)
    assert coupler.ledger.shortest < 0.9 * longest
    assert "stretch" in coupler.ledger.note
    assert energy_of(net, host) < begin


@pytest.mark.slow
def test_the_ledger_notes_that_a_guard_stopped_the_net(tmp_path: Path) -> None:
    """The guards check many steps at once: the host has taken those since."""
    net, host = Scene(tmp_path, ("velocity = [0.5, 0.0", "velocity = [25.0, 0.0")).both()
    coupler = Coupler(net, host, step=0.002)
    with pytest.raises(exunet.RunStopped):
        coupler.advance_to(0.2)
    assert net.time < host.time
    assert f"to t = {host.time:.6g} s" in coupler.ledger.note


# Hosts of a user


class Puck(Host):
    """A body that does not rotate, as coupling.md shows it: the fewest methods that a host needs."""

    def __init__(self, mass: float, state: FrameState) -> None:
        self.mass, self.now, self.state = mass, 0.0, state

    @property
    def time(self) -> float:
        return self.now

    def frames(self) -> dict[str, FrameState]:
        return {"b": self.state}

    def step(self, until: float, loads: Mapping[str, PortLoad]) -> None:
        self.state = self.state.after(until - self.now, tuple(loads["b"].force / self.mass))
        self.now = until


@pytest.mark.ci
@pytest.mark.slow
def test_a_host_of_three_methods(tmp_path: Path) -> None:
    """The middle of a spring, as by the body of exunet; it has no snapshots."""
    net, known = spring(tmp_path)
    host = Puck(0.05 + net.carried_mass("b"), net.frame("b"))
    Coupler(net, host, step=1e-3).advance_to(0.1)
    net, _ = spring(tmp_path)
    coupler = Coupler(net, known, step=1e-3)
    coupler.advance_to(0.1)
    coupler.advance_to(float(np.nextafter(0.1, 0.0)))  # the same time
    assert coupler.time == 0.1
    np.testing.assert_allclose(host.state.position, known.frames()["b"].position, rtol=0.0, atol=1e-12)
    net, _ = spring(tmp_path)
    coupler = Coupler(net, Puck(0.05, net.frame("b")), step=1e-3, iterations=5)
    with pytest.raises(InputError, match="Puck"):
        coupler.advance_to(0.1)


class Faulty(BodiesHost):
    """A host that fails in the fourth step, until it is mended."""

    how = ""

    def step(self, until: float, loads: Any) -> None:
        self.fails = self.how if until > 0.035 else ""
        if self.fails == "raises":
            raise RuntimeError("the host failed")
        if self.fails == "back":
            self.simulation.reset()
        if self.fails != "still":
            times = {"late": until + 1e-3, "early": until - 1e-3, "back": 5e-3}
            super().step(times.get(self.fails, until), loads)

    def restore(self, snapshot: Any) -> None:
        self.fails = ""
        super().restore(snapshot)

    def frames(self) -> dict[str, FrameState]:
        found, fails = super().frames(), getattr(self, "fails", "")
        if fails == "lost":
            return {}
        wrong = {"NaN": (np.nan, 0.0, 0.0), "jumps": (9.0, 0.0, 0.0)}
        if fails not in wrong:
            return found
        return {name: state._replace(position=wrong[fails]) for name, state in found.items()}


@pytest.mark.ci_for("raises-1")
@pytest.mark.slow
@pytest.mark.parametrize("iterations", [1, 20])
@pytest.mark.parametrize(
    ("how", "words"),
    [
        ("raises", "the host failed"),
        ("NaN", r"port second at t = 0\.04 s: position"),
        ("jumps", "port second jumps"),
        ("lost", "port second is missing"),
        ("late", r"from t = 0\.03 s to 0\.041 s instead of 0\.04 s"),
        ("early", r"from t = 0\.03 s to 0\.039 s instead of 0\.04 s"),
        ("back", r"from t = 0\.03 s to 0\.005 s instead of 0\.04 s"),
        ("still", r"from t = 0\.03 s to 0\.03 s instead of 0\.04 s"),
    ],
)
def test_a_host_that_fails_in_a_step(scene: Scene, iterations: int, how: str, words: str) -> None:
    """The step does not count; both are where they were, or the coupling does not continue."""
    net = NetSystem(scene.net)
    host = Faulty(BodiesHost.of_ports(net).simulation.start.scene)
    coupler = Coupler(net, host, step=0.01, iterations=iterations)
    host.how = how
    with pytest.raises((RuntimeError, InputError), match=words):
        coupler.advance_to(0.1)
    assert coupler.ledger.steps == 3
    assert net.time == coupler.time == pytest.approx(0.03)
    assert np.isfinite(coupler.ledger.residual)
    host.how = host.fails = ""
    if iterations == 1 and how not in ("raises", "still"):  # the host has advanced
        with pytest.raises(InputError, match=r"the net at 0\.03 s"):
            coupler.advance_to(0.1)
        return
    assert host.time == net.time
    coupler.advance_to(0.1)
    assert scene.lost(net, host) < 1e-12 * MOMENTUM


@pytest.mark.ci_for("time")
@pytest.mark.slow
@pytest.mark.parametrize("what", ["time", "place"])
def test_a_host_that_is_not_restored(scene: Scene, what: str) -> None:
    """Repeats from where it had ended were taken for agreement: its load counted, and it had the first."""

    class Forgets(BodiesHost):
        clock = None

        def restore(self, snapshot: Any) -> None:
            self.clock = 0.0 if what == "place" else None

        @property
        def time(self) -> float:
            return super().time if self.clock is None else self.clock

    net = NetSystem(scene.net)
    host = Forgets(BodiesHost.of_ports(net).simulation.start.scene)
    coupler = Coupler(net, host, step=0.01, iterations=20)
    with pytest.raises(InputError, match=r"Forgets.*`restore`"):
        coupler.advance_to(0.1)
    assert (net.time, coupler.ledger.steps) == (0.0, 0)


@pytest.mark.slow
def test_times_that_are_sums_pass_and_ports_that_the_net_does_not_have(scene: Scene) -> None:
    """A host that adds its own steps is off by round-off only."""

    class Adds(BodiesHost):
        clock = 0.0

        @property
        def time(self) -> float:
            return self.clock

        def step(self, until: float, loads: Any) -> None:
            while self.clock < until - 1e-9:
                self.clock += 0.01 / 7.0
            super().step(until, loads)

        def shared(self) -> tuple[tuple[str, ...], ...]:
            return (("second", "elsewhere"),)

    net = NetSystem(scene.net)
    host = Adds(BodiesHost.of_ports(net).simulation.start.scene)
    coupler = Coupler(net, host, step=0.01)
    assert coupler.longest == Coupler(*scene.both(), step=0.01).longest
    coupler.advance_to(0.3)
    assert (coupler.ledger.steps, net.time) == (30, 0.3)


@pytest.mark.ci
@pytest.mark.slow
def test_invalid_arguments(scene: Scene) -> None:
    net, host = scene.both()

    class Wrong(BodiesHost):
        how = ""

        def frames(self) -> Any:
            return {"no frames": "x", "no body": {}}.get(self.how) or super().frames()

        def shared(self) -> Any:
            return {"no groups": 3.0, "names": ("second",)}.get(self.how, ())

        @property
        def time(self) -> Any:
            return None if self.how == "no time" else super().time

    own = host.simulation.start.scene
    for one, other, words in (
        (None, host, "net: .*NoneType"),
        (host, net, "host: .*NetSystem"),
        (net, None, "host: .*NoneType"),
        (NetSystem(scene.whole), host, "the net has no port"),
    ):
        with pytest.raises(InputError, match=f"Coupler: {words}"):
            Coupler(one, other, step=0.01)  # type: ignore[arg-type]
    for how, words in (
        ("no time", "None"),
        ("no frames", "`frames`"),
        ("no groups", r"3\.0"),
        ("names", "`shared`"),
    ):
        wrong = Wrong(own)
        wrong.how = how
        with pytest.raises(InputError, match=f"Wrong.*{words}"):
            Coupler(net, wrong, step=0.01)
    for arguments, words in (({"step": 0.0}, "step"), ({"step": 1e-3, "iterations": 0}, "iterations")):
        with pytest.raises(InputError, match=words):
            Coupler(*scene.both(), **arguments)
    for given in (None, host):
        with pytest.raises(InputError, match="of_ports"):
            BodiesHost.of_ports(given)  # type: ignore[arg-type]
    for ports in (["second"], {"second": "third"}):
        with pytest.raises(InputError, match="BodiesHost: "):
            BodiesHost(scene.whole, ports=ports)  # type: ignore[arg-type]
    host.step(0.01, {})
    with pytest.raises(InputError, match=r"the host is at t = 0\.01 s, the net at 0 s"):
        Coupler(net, host, step=0.01)
