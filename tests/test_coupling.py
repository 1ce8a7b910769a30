"""A net with ports and a host: momentum, order, energy, going back, and what is refused."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from coupled import CHAIN, LUMP, SECOND, Scene, energy_of, momenta, spring, stiffness

import exunet
from exunet import Cosimulation, FrameState, InputError, NetSystem, Snapshot
from exunet.bodies.port import frames_of, rows_of
from exunet.bodies.rotations import rotation_matrix
from exunet.coupling.prediction import CONTRACTING, MARGIN, STABLE, LongestStep, Predictor, longest_step
from exunet.coupling.rollback import Undo

# Each compiles kernels of its own.
pytestmark = pytest.mark.slow

END = 0.3


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    return Scene(tmp_path_factory.mktemp("coupled"))


def coupled(scene: Scene, step: float, iterations: int = 1, until: float = END) -> tuple[float, Cosimulation]:
    """Distance [m] of the host's body from where it is in one system, and the coupling."""
    net, host = scene.both()
    both = Cosimulation(net, host, step=step, iterations=iterations)
    both.advance_to(until)
    known = scene.in_one(until).state.bodies.position[1]
    return float(np.linalg.norm(host.simulation.state.bodies.position[0] - known)), both


@pytest.mark.ci
@pytest.mark.slow
def test_the_mass_of_a_ports_nodes_is_the_hosts(scene: Scene) -> None:
    net, _ = scene.both()
    assert net.carried_mass("second") == pytest.approx(0.1 + LUMP, rel=1e-15)
    sim = net.simulation  # energy beside the port: of the node and of the free body, and of the cable
    first, beside = sim.bodies["first"], np.array(net.frame("second").velocity)
    body, node = sim.start.system.bodies[0], sim.net.velocity[1] - beside
    known = sim.energy.elastic + 0.5 * (0.5 + 2.0 * LUMP) * node @ node
    known += 0.5 * body.mass * np.sum((np.array(first.velocity) - beside) ** 2)
    known += 0.5 * np.array(body.inertia) @ sim.state.bodies.angular_velocity[0] ** 2
    assert net.energy_seen_from("second") == pytest.approx(known, rel=1e-12)
    with pytest.raises(InputError, match="there is no port 'first': second"):
        net.carried_mass("first")
    with pytest.raises(InputError, match=r"follow: an array .* and a time later than 0 s"):
        net.follow(0.0, np.zeros((1, 13)))


@pytest.mark.slow
@pytest.mark.parametrize("iterations", [1, 20])
def test_second_order_in_the_macro_step(scene: Scene, iterations: int) -> None:
    errors = [coupled(scene, step, iterations)[0] for step in (8e-3, 4e-3, 2e-3)]
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert (orders > 1.7).all(), f"errors {errors}, orders {orders}"
    assert errors[-1] < 1e-5  # of a way of 0.2 m


@pytest.mark.slow
def test_a_macro_step_costs_the_net_no_evaluation_more(scene: Scene) -> None:
    """Steered at constant velocity it takes as many as by itself through the same times."""
    counts = []
    for steers in (True, False):
        net = NetSystem(scene.net)
        for k in range(200):
            until = (k + 1) * 1e-3
            if steers:
                net.step(until, {"second": net.frame("second").after(until - net.time)})
            else:
                net.simulation.advance_to(until)
        net.finish()
        counts.append(net.simulation.counts.right_hand_sides)
    assert counts[0] == counts[1] > 200 * 6  # of a step of DOPRI5


@pytest.mark.slow
@pytest.mark.parametrize("iterations", [1, 20])
def test_momentum_is_kept_at_any_step(scene: Scene, iterations: int) -> None:
    net, host = scene.both()
    before = [np.add(a, b) for a, b in zip(momenta(net.simulation), momenta(host.simulation), strict=True)]
    drift = []
    for step in (0.02, 0.005):
        net, host = scene.both()
        both = Cosimulation(net, host, step=step, iterations=iterations)
        worst = 0.0
        for until in (0.1, 0.2, 0.3):
            both.advance_to(until)
            now = [
                np.add(a, b) for a, b in zip(momenta(net.simulation), momenta(host.simulation), strict=True)
            ]
            # of the largest momentum of a part, that of the second body, 3 kg at 0.6 m/s
            assert np.abs(now[0] - before[0]).max() < 1e-12 * 1.8
            worst = max(worst, float(np.abs(now[1] - before[1]).max()))
        drift.append(worst)
    assert drift[1] < drift[0] / 3.0  # at least of the order log 3 / log 4 = 0.8; measured 2
    assert drift[0] < 1e-2 * np.abs(before[1]).max()


@pytest.mark.ci_for("90.0-1")
@pytest.mark.slow
@pytest.mark.parametrize("iterations", [1, 20])
@pytest.mark.parametrize("spin", [20.0, 90.0])  # rad/s
def test_the_books_tell_the_drift_of_a_body_that_spins(tmp_path: Path, iterations: int, spin: float) -> None:
    """About an axis that moves: torque by the rotation vector would be wrong by a factor of 10 and more."""
    net = spinning(tmp_path, spin)
    host = exunet.BodiesHost.of_ports(net)
    start, both = energy_of(net, host), Cosimulation(net, host, step=0.5 / spin, iterations=iterations)
    both.advance_to(0.2)
    drift = energy_of(net, host) - start
    assert abs(drift) > 1e-5  # J, far above round-off of the 1.6 kJ that there are
    assert both.books.residual == pytest.approx(drift, rel=0.05)


def spinning(folder: Path, spin: float) -> NetSystem:
    """The second body, its frame in its centre and axes, turns about z [rad/s]."""
    text = (CHAIN + SECOND).replace("products_of_inertia = [0.05, 0.02, 0.01]\n", "")
    text = text.replace("centre_of_mass = [0.1, 0.2, 0.3]\n", "").replace(
        "mass = 3.0", 'mass = 3.0\nmotion = "port"'
    )
    file = folder / "spinning.toml"
    file.write_text(text.replace("= [0.1, 2.0, 0.0]", f"= [0.0, 0.0, {spin}]"))
    return NetSystem(file)


@pytest.mark.ci
@pytest.mark.slow
def test_no_more_than_a_radian_in_a_step(tmp_path: Path) -> None:
    """Cut by `Cosimulation`, which is then near to one system; refused where the host chooses the step."""
    net = spinning(tmp_path, 90.0)
    assert longest_step(net, STABLE) == pytest.approx(1.0 / 90.0, rel=1e-3)
    host = exunet.BodiesHost.of_ports(net)
    both = Cosimulation(net, host, step=0.05)
    assert "macro steps of 0.05 s cut to 0.01111 s" in str(both.books)
    both.advance_to(0.2)
    assert 90.0 * both.books.longest < 1.0
    text = (tmp_path / "spinning.toml").read_text().replace('motion = "port"\n', "")
    (tmp_path / "whole.toml").write_text(text)
    whole = exunet.Simulation(tmp_path / "whole.toml")
    whole.advance_to(0.2)
    off = host.simulation.state.bodies.position[0] - whole.state.bodies.position[1]
    assert np.linalg.norm(off) < 1e-4  # m, of a way of 0.1 m
    net.reset()
    frame = net.frame("second")
    with pytest.raises(InputError, match=r"port second turns too far: .* by 1\.8 rad, at 90 rad/s"):
        net.step(0.02, {"second": frame.after(0.02)})
    with pytest.raises(InputError, match=r"port second turns too far: .* by 6\.3 rad"):
        net.step(0.07, {"second": frame.after(0.07)})  # which looks like a small turn back
    assert net.time == 0.0


@pytest.mark.slow
def test_a_host_that_is_another_net(tmp_path: Path) -> None:
    """The second body with a cable of its own, to a mass of 1 kg; in one system it has both cables.

    It does not turn at the start, so that its velocity is that of its frame with any nodes on it.
    """
    still = "bodies.second.angular_velocity=[0.0, 0.0, 0.0]"
    state = NetSystem(Scene(tmp_path).net).frame("second")
    turn, place = rotation_matrix(np.array(state.attitude)), np.array(state.position)
    ends = [(place + turn @ point).tolist() for point in ([-0.1, 0.1, 0.2], [0.3, 0.0, 0.0])]
    far = np.add(ends[1], [0.0, 1.02, 0.0]).tolist()  # stretched by 2 %
    cable = (tmp_path / "whole.toml").read_text()
    second = "attachments.y = { point = [0.3, 0.0, 0.0], node = %d }\n"
    whole = cable.replace(
        "[2.0, 0.0, 0.0]]\nnet.el", "[2.0, 0.0, 0.0], [5.0, 0.0, 0.0], [5.0, 1.0, 0.0]]\nnet.el"
    )
    whole = whole.replace("[2.0, 0.0, 0.0]]\ninitial.node_v", f"{ends[0]}, {ends[1]}, {far}]\ninitial.node_v")
    whole = whole.replace(
        "[0.0, 0.0, 0.0]]\nnet.top", "[0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]]\nnet.top"
    )
    whole = whole.replace("[1, 2]]", "[1, 2], [3, 4]]").replace("0.5, 0.1]", "0.5, 0.1, 0.2, 1.0]")
    (tmp_path / "both.toml").write_text(whole + second % 3)
    alone = [
        still,
        f"initial.node_positions=[{ends[0]}, {ends[1]}, {far}]",
        "initial.node_velocities=[[0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]]",
        "net.nodes=[[0.0, 0.0, 0.0], [5.0, 0.0, 0.0], [5.0, 1.0, 0.0]]",
        "net.elements=[[1, 2]]",
        f"net.node_masses=[{0.1 + LUMP}, 0.2, 1.0]",
        "bodies.first=",
        "bodies.second.attachments={x={point=[-0.1, 0.1, 0.2], node=0}, y={point=[0.3, 0.0, 0.0], node=1}}",
    ]
    known = exunet.Simulation(tmp_path / "both.toml", [still])
    before = momenta(known)[0]
    known.advance_to(END)
    errors = []
    for step in (8e-3, 4e-3):
        net, host = (
            NetSystem(tmp_path / "net.toml", [still]),
            exunet.BodiesHost(tmp_path / "whole.toml", alone),
        )
        Cosimulation(net, host, step=step, iterations=20).advance_to(END)
        now = momenta(net.simulation)[0] + momenta(host.simulation)[0]
        assert np.abs(now - before).max() < 1e-12 * 1.8
        errors.append(
            np.linalg.norm(host.simulation.state.bodies.position[0] - known.state.bodies.position[1])
        )
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
        host = exunet.BodiesHost(tmp_path / "base.toml", ports={"a": "base", "b": "base"})
        both = Cosimulation(net, host, step=step)
        both.advance_to(END)
        given = sum(port.impulse for port in both.books.ports.values())
        errors.append(
            float(np.linalg.norm(host.simulation.state.bodies.position[0] - known.state.bodies.position[0]))
        )
        velocity = host.simulation.state.bodies.velocity[0]
        assert np.abs((2.0 + 0.2 + 2.0 * LUMP) * velocity - given).max() < 1e-12  # N s; it was at rest
        assert np.abs(momenta(net.simulation)[0] + given - before[0]).max() < 1e-12
    assert errors[0] / errors[1] > 0.8 * 4.0, errors
    # two cables alike, so twice the stiffness of one
    begin = NetSystem(tmp_path / "net.toml")
    springs = STABLE._replace(beside=STABLE.beside._replace(most=0.0))  # nothing is fed
    together = LongestStep(begin, springs, host.shared()).now
    assert together == pytest.approx(longest_step(begin, springs) / np.sqrt(2.0), rel=1e-12)
    assert both.longest < longest_step(begin, STABLE)  # by modes, of one cable's nodes and of both


class Faulty:
    """A host that fails once, in the third call of `step`, in some way."""

    def __init__(self, host: exunet.BodiesHost, how: str) -> None:
        self._host, self._how, self._calls, self._fails = host, how, 0, False

    def __getattr__(self, name: str) -> Any:
        return getattr(self._host, name)

    def step(self, until: float, loads: dict[str, Any]) -> None:
        self._calls += 1
        self._fails = self._calls == 3
        if self._fails and self._how == "raises":
            raise RuntimeError("the host has failed")
        self._host.step(until, loads)

    def restore(self, snapshot: Any) -> None:
        self._fails = False
        self._host.restore(snapshot)

    def frames(self) -> dict[str, FrameState]:
        found = self._host.frames()
        if not self._fails or self._how == "raises":
            return found
        if self._how == "loses the body":
            return {}
        wrong = (np.nan, 0.0, 0.0) if self._how == "tells NaN" else (9.0, 0.0, 0.0)
        return {name: state._replace(position=wrong) for name, state in found.items()}


@pytest.mark.ci_for("the host has failed-1")
@pytest.mark.slow
@pytest.mark.parametrize("iterations", [1, 20])
@pytest.mark.parametrize(
    ("how", "words"),
    [
        ("raises", "the host has failed"),
        ("tells NaN", "host's body at port second at t = .*: position contains NaN or infinity"),
        ("jumps", "host's body at port second jumps: in the step from .* its position is"),
        ("loses the body", "host's body at port second is not there at t ="),
    ],
)
def test_a_host_that_fails_once(scene: Scene, iterations: int, how: str, words: str) -> None:
    """Nothing of the step is booked; both are where they were, or the coupling does not go on."""
    net, host = scene.both()
    before = momenta(net.simulation)[0] + momenta(host.simulation)[0]
    both = Cosimulation(net, Faulty(host, how), step=0.01, iterations=iterations)
    with pytest.raises((RuntimeError, InputError), match=words):
        both.advance_to(0.1)
    assert net.time == pytest.approx(0.01 * both.books.steps)
    assert np.isfinite(both.books.residual)
    if how != "raises" and iterations == 1:  # the host went on, and cannot be set back
        with pytest.raises(InputError, match=r"the host is at t = 0\.03 s, the net at 0\.02 s: restore both"):
            both.advance_to(0.2)
        return
    assert host.time == net.time
    both.advance_to(0.2)
    now = momenta(net.simulation)[0] + momenta(host.simulation)[0]
    assert np.abs(now - before).max() < 1e-12 * 1.8


@pytest.mark.slow
def test_a_step_that_is_refused_changes_none_of_several_ports(tmp_path: Path) -> None:
    text = (CHAIN + SECOND).replace("mass = 3.0", 'mass = 3.0\nmotion = "port"')
    (tmp_path / "two.toml").write_text(text.replace("mass = 2.0", 'mass = 2.0\nmotion = "port"'))
    net = NetSystem(tmp_path / "two.toml")
    net.step(0.01, {name: net.frame(name).after(0.01) for name in net.ports})
    here = net.snapshot().as_bytes()
    told = {name: net.frame(name).after(0.01) for name in net.ports}
    told["second"] = told["second"]._replace(position=(9.0, 9.0, 9.0))
    with pytest.raises(InputError, match="port second jumps"):
        net.step(0.02, told)
    assert net.snapshot().as_bytes() == here


@pytest.mark.ci_for("1")
@pytest.mark.slow
@pytest.mark.parametrize("iterations", [1, 20])
def test_the_books_tell_the_drift_of_the_energy(scene: Scene, iterations: int) -> None:
    net, host = scene.both()
    start = momenta(net.simulation)[2] + momenta(host.simulation)[2]
    both = Cosimulation(net, host, step=0.01, iterations=iterations)
    both.advance_to(END)
    drift = momenta(net.simulation)[2] + momenta(host.simulation)[2] - start
    assert abs(drift) > 1e-6  # far above round-off of the 1.5 J that there are
    assert both.books.residual == pytest.approx(drift, rel=0.05)
    assert "energy added by the coupling" in str(both.books)
    assert "port second" in str(both.books)


@pytest.mark.ci
@pytest.mark.slow
def test_the_step_follows_the_energy(scene: Scene) -> None:
    open_energy = []
    for allowed in (1e-4, 1e-6):
        net, host = scene.both()
        both = Cosimulation(net, host, step=0.02, energy=allowed)
        both.advance_to(END)
        assert both.time == END
        open_energy.append((both.books.steps, abs(both.books.residual)))
        assert both.books.shortest < both.books.longest <= 0.02
    assert open_energy[1][0] > open_energy[0][0]
    assert open_energy[1][1] < open_energy[0][1]


@pytest.mark.ci
@pytest.mark.slow
def test_restored_in_the_middle_of_a_snap_it_repeats(scene: Scene, tmp_path: Path) -> None:
    """In the same net, and in a new one from a file; a snapshot of another case is refused."""

    def on(net: NetSystem, frame: FrameState) -> dict[str, np.ndarray]:
        for k in range(1, 21):
            frame = frame.after(0.003)
            load = net.step(0.12 + 0.003 * k, {"second": frame})["second"]
        return {"impulse": load.impulse, "torque": load.torque, **net.simulation.state.arrays()}

    net = NetSystem(scene.net)
    frame = net.frame("second").after(0.12)
    net.step(0.12, {"second": frame})
    assert net.simulation.net.tension.max() > 1.0  # N: taut
    here = net.snapshot()
    here.save(tmp_path / "here")
    once = on(net, frame)
    net.restore(here)
    again = on(net, frame)
    other = NetSystem(scene.net)
    other.restore(Snapshot.load(tmp_path / "here"))
    anew = on(other, frame)
    net.reset()
    assert net.time == 0.0
    for name, values in once.items():
        np.testing.assert_array_equal(again[name], values)
        np.testing.assert_array_equal(anew[name], values)
    with pytest.raises(InputError, match="another case"):
        exunet.Simulation(scene.whole).restore(here)


@pytest.mark.slow
def test_the_books_tell_that_a_guard_took_the_net_back(tmp_path: Path) -> None:
    """The guards look at many steps at once: the host has taken those since."""
    scene = Scene(tmp_path)
    scene.net.write_text(scene.net.read_text().replace("velocity = [0.5, 0.0", "velocity = [25.0, 0.0"))
    net, host = scene.both()
    both = Cosimulation(net, host, step=0.002)
    with pytest.raises(exunet.RunStopped, match="an element is longer than 2 times its length"):
        both.advance_to(0.2)
    assert net.time < host.time
    assert f"the steps to t = {host.time:.6g} s are in the books, which the host took" in both.books.cut


@pytest.mark.ci
@pytest.mark.slow
def test_a_step_taken_again_shorter_is_that_step_from_the_start(scene: Scene) -> None:
    def ahead(net: NetSystem, duration: float) -> np.ndarray:
        return rows_of([net.frame("second").after(duration)])

    net, plain = NetSystem(scene.net), NetSystem(scene.net)
    undo = Undo(net)
    for k in range(6):  # beyond the first snapshots
        end = 0.01 * (k + 1)
        undo.step(end, ahead(net, 0.01))
        plain.follow(end, ahead(plain, 0.01))
        undo.step(end + 0.02, ahead(net, 0.02))
        assert undo.begin == plain.time
        undo.back()
        assert net.time == plain.time
        for name, values in plain.simulation.state.arrays().items():
            np.testing.assert_array_equal(net.simulation.state.arrays()[name], values)


@pytest.mark.slow
def test_what_a_host_may_not_do(scene: Scene) -> None:
    net = NetSystem(scene.net)
    frame = net.frame("second")
    bad, here = frame._replace(velocity=(np.nan, 0.0, 0.0)), net.snapshot().as_bytes()
    for frames, words in (
        ({}, "no state is given for port second"),
        ({"second": frame, "third": frame}, "there is no port 'third'"),
        (None, "the states of the ports by name, got None"),
        ({"second": FrameState((1.0, 2.0))}, r"a frame has position \(3\), velocity \(3\)"),  # type: ignore
        ({"second": FrameState("abc")}, r"a frame has position \(3\), velocity \(3\)"),  # type: ignore
        ({"second": FrameState(None)}, r"a frame has position \(3\), velocity \(3\)"),  # type: ignore
        ({"second": bad}, "port second: velocity contains NaN or infinity"),
        (
            {"second": frame._replace(attitude=(1.0, 1.0, 0.0, 0.0))},
            r"unit quaternion, got one of length 1\.41",
        ),
        ({"second": ((1.0, 2.0), 3.0)}, r"a frame has position \(3\), velocity \(3\)"),
        (
            {"second": frame._replace(position=(9.0, 0.0, 0.0))},
            r"port second jumps: .* its position is",
        ),
        (
            {"second": frame.after(0.01)._replace(attitude=(0.0, 0.0, 0.0, 1.0))},
            r"port second jumps: .* its (attitude|position) is",
        ),
    ):
        with pytest.raises(InputError, match=words):
            net.step(0.01, frames)
        assert net.snapshot().as_bytes() == here
    net.step(0.01, {"second": frame.after(0.01)})
    here = net.snapshot().as_bytes()
    for until in (0.01, 0.005, np.nan):
        with pytest.raises(InputError, match=r"later than the time reached, 0\.01 s"):
            net.step(until, {"second": frame})
        assert net.snapshot().as_bytes() == here


@pytest.mark.slow
def test_a_port_that_was_predicted_at_rest_may_be_put_right(scene: Scene) -> None:
    """It was to stop in a step, but went on by a tenth of that; then it stops indeed."""
    net, rest = NetSystem(scene.net), (0.0, 0.0, 0.0)
    frame = net.frame("second")
    for time, until in ((0.005, 0.01), (0.0055, 0.014)):
        net.step(until, {"second": frame.after(time)._replace(velocity=rest, angular_velocity=rest)})
    jumped = frame.after(0.0056)._replace(velocity=rest, angular_velocity=rest)
    with pytest.raises(InputError, match=r"port second jumps: .* its position is"):
        net.step(0.018, {"second": jumped})


@pytest.mark.ci
@pytest.mark.slow
def test_a_port_is_not_run_without_a_host(scene: Scene) -> None:
    with pytest.raises(exunet.CaseError, match=r'bodies\.second\.motion: motion = "port" requires a host'):
        exunet.Simulation(scene.net)
    with pytest.raises(exunet.CaseError, match=r"requires engine\.backend"):
        NetSystem(scene.net, ["engine.backend=exudyn"])
    net, host = scene.both()
    host.step(0.01, {})
    with pytest.raises(InputError, match=r"the host is at t = 0\.01 s, the net at 0 s"):
        Cosimulation(net, host, step=0.01)
    with pytest.raises(InputError, match="Cosimulation: the net has no port"):
        Cosimulation(NetSystem(scene.whole), exunet.BodiesHost(scene.whole), step=0.01)
    for arguments, words in (
        ({"step": 0.0}, "step must be"),
        ({"step": 1e-3, "iterations": 0}, "iterations"),
    ):
        with pytest.raises(InputError, match=words):
            Cosimulation(*scene.both(), **arguments)


@pytest.mark.slow
def test_the_largest_stable_macro_step(scene: Scene, tmp_path: Path) -> None:
    """A mass between two stretched cables: sqrt(m / k), and sqrt(6 m / k) with repeats."""
    net, host = spring(tmp_path)
    mass = 0.05 + net.carried_mass("b")
    known = MARGIN * np.sqrt(mass / stiffness())
    assert longest_step(net, STABLE) == pytest.approx(known, rel=1e-9)
    assert longest_step(net, CONTRACTING) == pytest.approx(np.sqrt(6.0) * known, rel=1e-9)
    net, host = spring(tmp_path)
    both = Cosimulation(net, host, step=1.0)
    assert f"macro steps of 1 s cut to {known:.4g} s" in str(both.books)
    assert both.longest == longest_step(net, STABLE)
    both.advance_to(10 * both.longest)
    assert both.books.longest <= both.longest * (1.0 + 1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("stretch", [1.001, 1.1, 1.2])
def test_the_largest_stable_step_falls_with_the_stretch(tmp_path: Path, stretch: float) -> None:
    """As the law's tangent grows: predicted, and measured within 3 %; amplitudes of 1e-5 m."""
    net, _ = spring(tmp_path, stretch)
    mass = 0.05 + net.carried_mass("b")
    limit = np.sqrt(mass / stiffness(stretch))
    assert longest_step(net, STABLE) == pytest.approx(MARGIN * limit, rel=1e-9)
    assert grown(tmp_path, 0.97 * limit, stretch, steps=200) < 0.0
    assert grown(tmp_path, 1.03 * limit, stretch, steps=200) > 0.0


@pytest.mark.slow
def test_steps_that_the_stretch_makes_too_long_are_cut_on_the_way(tmp_path: Path) -> None:
    """A body that swings at 8 m/s between two cables: the longest step is less where that is stretched."""
    spring(tmp_path)
    file = tmp_path / "spring.toml"
    file.write_text(file.read_text().replace("velocity = [0.01", "velocity = [8.0"))
    net = NetSystem(file)
    host = exunet.BodiesHost.of_ports(net)
    both = Cosimulation(net, host, step=1.0)
    longest, least = both.longest, 1.0
    begin = energy_of(net, host)
    for _ in range(60):
        time = both.time
        both.advance_to(time + longest)
        least = min(least, both.books.shortest)
    assert least < 0.9 * longest
    assert "stiffnesses that grow with the stretch" in both.books.cut
    assert energy_of(net, host) < begin


def grown(folder: Path, step: float, stretch: float, steps: int) -> float:
    """Energy [J] that explicit steps of net and host add; the host starts at 1 cm/s."""
    net, host = spring(folder, stretch)
    begin, predictor = energy_of(net, host), Predictor()
    for k in range(steps):
        now = rows_of(host.frames().values())
        told = predictor.told(k * step, (k + 1) * step, now)
        host.step((k + 1) * step, net.step((k + 1) * step, frames_of(net.ports, told)))
        predictor.keep(k * step, now)
    return energy_of(net, host) - begin
