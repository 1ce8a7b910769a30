"""Net that a host steps: what a port requires, going back, scripts and corner units, refused states."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from coupled import CHAIN, LUMP, SECOND, Scene, ahead
from scenes import CASES

import exunet
from exunet import CaseError, FrameState, InputError, NetSystem, Snapshot
from exunet.bodies.port import quaternion_of, times
from exunet.cli.check import describe
from exunet.scene.casefile import Case, parse_case

# Each compiles kernels of its own.
pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    return Scene(tmp_path_factory.mktemp("coupled"))


@pytest.mark.ci
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
    assert dict(describe(exunet.load(scene.net)))["body second"].startswith("3.1")  # kg, with its node
    with pytest.raises(InputError, match="first"):
        net.carried_mass("first")


TOLERANCE = "solver.tolerance=1e-10"
WINDING = 'tethers.tow.reel.commands=[{at=0.0, mode="rate", rate=0.9, force=60.0}]'
SCENES = {  # file, port, overrides, time of the snapshot, step, number of steps
    "throw": ("launch", "chaser", (TOLERANCE,), 0.03, 0.0175, 4),
    "ejection": ("release", "deployer", (TOLERANCE, "initial.frame.eject_at=0.2"), 0.19, 0.0125, 4),
    "reel": ("tow", "chaser", ("solver.tolerance=1e-9", WINDING), 1.5, 0.04, 12),
}


@pytest.mark.ci_for("snap")
@pytest.mark.parametrize("what", ["snap", *SCENES])
def test_restored_in_the_middle_it_repeats(scene: Scene, what: str, tmp_path: Path) -> None:
    """Of a snap, a throw, a later ejection, a reel: in the same net, and in a new one from a file."""
    case, overrides, port, begin, step, steps = scene.net, [], "second", 0.12, 0.003, 20
    if what != "snap":
        name, port, changes, begin, step, steps = SCENES[what]
        case = CASES / "bodies" / f"{name}.toml"
        overrides = ["engine.backend=compiled", *changes, f"bodies.{port}.motion=port"]

    def on(net: NetSystem, frame: FrameState) -> dict[str, np.ndarray]:
        for k in range(1, steps + 1):
            frame = frame.after(step)
            load = net.step(begin + step * k, {port: frame})[port]
        return {"impulse": load.impulse, "torque": load.torque, **net.simulation.state.arrays()}

    net = NetSystem(case, overrides)
    frame = net.frame(port).after(begin)
    net.step(begin, {port: frame})
    here = net.snapshot()
    here.save(tmp_path / "here")
    once = on(net, frame)
    net.restore(here)
    other = NetSystem(case, overrides)
    other.restore(Snapshot.load(tmp_path / "here"))
    again, anew = on(net, frame), on(other, frame)
    net.reset()
    assert net.time == 0.0
    for name, values in once.items():
        np.testing.assert_array_equal(again[name], values)
        np.testing.assert_array_equal(anew[name], values)
    with pytest.raises(InputError, match="another case"):
        exunet.Simulation(CASES / "planar_deployment.toml", ["engine.backend=compiled"]).restore(here)


def test_what_a_host_may_not_do(scene: Scene) -> None:
    """Invalid states, jumps, too large rotations and earlier times raise, and the net is unchanged."""
    net = NetSystem(scene.net)
    for k in range(3):
        net.step((k + 1) * 0.01, {"second": net.frame("second").after(0.01)})
    start, here = net.frame("second"), net.snapshot().as_bytes()
    end, speed, wrong = start.after(0.01), 0.01 * np.array(start.velocity), []
    for part in (0.5, 1.0, 2.5, -0.5, -1.0, -2.5):  # off by parts of the way of a step
        place = tuple((np.array(end.position) - part * speed).tolist())
        wrong.append((end._replace(position=place), "second jumps"))
    for angle in (0.01, 0.05, 0.08, -0.05):  # rad; the rotation of the step is 0.02. The centre moves too
        turn = times(end.attitude, quaternion_of((0.0, -angle, 0.0)))
        wrong.append((end._replace(attitude=turn), "second jumps"))
    wrong += [(end._replace(velocity=(np.nan, 0.0, 0.0)), "second: velocity"), ((1.0, 2.0), "port second")]
    cases = [({"second": state}, words) for state, words in wrong]
    cases += [({}, "port second"), ({"second": end, "third": end}, "third"), (None, "None")]
    for frames, words in cases:
        with pytest.raises(InputError, match=words):
            net.step(0.04, frames)  # type: ignore[arg-type]
        assert net.snapshot().as_bytes() == here
    for until in (0.03, 0.005, np.nan):
        with pytest.raises(InputError, match="later"):
            net.step(until, {"second": end})
    with pytest.raises(InputError, match="follow"):
        net.follow(0.01, np.zeros((1, 13)))
    assert net.snapshot().as_bytes() == here
    net.step(0.04, {"second": end})


def test_a_port_that_was_predicted_at_rest_may_be_corrected(scene: Scene) -> None:
    """It was to stop in a step, but moved a tenth of that further; then it stops indeed."""
    net, rest = NetSystem(scene.net), (0.0, 0.0, 0.0)
    frame = net.frame("second")
    for time, until in ((0.005, 0.01), (0.0055, 0.014)):
        net.step(until, {"second": frame.after(time)._replace(velocity=rest, angular_velocity=rest)})
    jumped = frame.after(0.0056)._replace(velocity=rest, angular_velocity=rest)
    with pytest.raises(InputError, match="port second jumps"):
        net.step(0.018, {"second": jumped})


def test_a_refused_step_changes_none_of_several_ports(tmp_path: Path) -> None:
    text = (CHAIN + SECOND).replace("mass = 3.0", 'mass = 3.0\nmotion = "port"')
    (tmp_path / "two.toml").write_text(text.replace("mass = 2.0", 'mass = 2.0\nmotion = "port"'))
    net = NetSystem(tmp_path / "two.toml")
    net.step(0.01, {name: net.frame(name).after(0.01) for name in net.ports})
    here = net.snapshot().as_bytes()
    frames = {name: net.frame(name).after(0.01) for name in net.ports}
    frames["second"] = frames["second"]._replace(position=(9.0, 9.0, 9.0))
    with pytest.raises(InputError, match="port second jumps"):
        net.step(0.02, frames)
    assert net.snapshot().as_bytes() == here


@pytest.mark.ci
def test_a_port_requires_a_host_and_the_compiled_loop(scene: Scene) -> None:
    case = exunet.load(scene.net)
    for run in (exunet.Simulation, exunet.run, lambda case: exunet.ensemble(case, runs=2)):
        with pytest.raises(CaseError, match=r"bodies\.second\.motion"):
            run(case)
    with pytest.raises(CaseError, match=r"engine\.backend"):
        NetSystem(scene.net, ["engine.backend=exudyn"])


@pytest.mark.ci
def test_the_state_vector_has_first_order_states_and_bodies(scene: Scene) -> None:
    """With what a wrench needs: an input adds first-order states."""
    plain, net = NetSystem(scene.net), NetSystem(scene.net, wrenches=("first",))
    net.follow(0.005, ahead(net, 0.005))
    _, _, bodies, first_order = net.simulation.moving
    vector = net.state_vector()
    parts = [first_order, bodies.position, bodies.velocity, bodies.angular_velocity, bodies.attitude]
    np.testing.assert_array_equal(vector, np.concatenate([part.ravel() for part in parts]))
    assert len(plain.state_vector()) < len(vector)


# A net thrown from a port, on a tether; four units steer once a box is near, and the tether is cut.
SCRIPTED = """
format = 1
title = "Units, a script and a port"
time = { end = 0.5, output_step = 0.05 }
solver = { method = "RK44", step = 2e-4 }
engine.backend = "compiled"
initial = { packing = 0.98, velocity = [0.0, 0.0, 2.0] }
[net]
topology = "square"
size = 1.0
mesh = 0.25
cable = { diameter = 0.001, density = 1390.0, youngs_modulus = 1e8 }
bullets.mass = 0.02
[bodies.chaser]
mass = 50.0
inertia = [5.0, 5.0, 5.0]
position = [0.0, 0.0, -1.5]
velocity = [0.1, 0.0, 0.0]
angular_velocity = [0.0, 0.3, 0.0]
motion = "MOTION"
[bodies]
box = { shape = "sphere", radius = 0.2, mass = 5.0, position = [0.1, 0.0, 1.0] }
[capture]
target = "box"
relative_speed = 1e3
duration = 0.0
[tethers.tow]
length = 1.7
divisions = 2
diameter = 0.001
density = 1390.0
youngs_modulus = 1e8
start = { body = "chaser" }
end = { node = 12 }
[control]
bullets = [0, 1, 2, 3]
kind = "point"
body = "box"
offset = [0.0, 0.0, 0.45]
stiffness = 1.0
damping = 0.3
period = 0.02
largest_thrust = 0.5
minimum_impulse = 1e-3
noise = { position = 0.005, velocity = 0.005, seed = 7 }
[[script]]
name = "steer"
when = "range < 0.8"
do = "control"
[[script]]
name = "cut"
when = "tether_tension > 0.5"
do = "cut"
on = "tow"
"""


def scripted(motion: str, more: str = "") -> Case:
    return parse_case(SCRIPTED.replace("MOTION", motion) + more, Path("port.toml"))


@pytest.mark.ci
def test_a_host_steps_a_script_and_units_as_a_run_does() -> None:
    """To the round-off of the port's way: events, what the units spend, and what comes after a snapshot."""
    whole = exunet.run(scripted("prescribed"))
    net, body = NetSystem(scripted("port")), whole.bodies["chaser"]

    def frames(row: int) -> dict[str, FrameState]:
        parts = body.position[row], body.velocity[row], body.attitude[row], body.angular_velocity[row]  # type: ignore[index]
        return {"chaser": FrameState(*(tuple(part.tolist()) for part in parts))}

    rows, held = range(1, len(whole.time)), net.snapshot()
    for row in rows:
        if row == 3:  # after both events
            held = net.snapshot()
        net.step(float(whole.time[row]), frames(row))
    events = net.simulation.log.events
    assert [event.entry for event in events] == ["steer", "cut"]
    for event, known in zip(events, whole.run.script, strict=True):
        assert event.time_s == pytest.approx(known.time_s, abs=1e-9)
    state = net.simulation.state
    np.testing.assert_allclose(state.position, whole.position[-1], atol=1e-9)
    net.restore(held)
    for row in rows[2:]:
        net.step(float(whole.time[row]), frames(row))
    again = net.simulation.state
    for name, values in state.arrays().items():
        np.testing.assert_array_equal(again.arrays()[name], values)
    assert (whole.states["control/spent"].values[-1] > 0.01).all()


def test_a_script_does_not_stop_what_a_host_steps() -> None:
    """The host would continue without the net: it is refused with its line before any step."""
    stop = '[[script]]\nname = "late"\nat = 0.3\ndo = "stop"\nverdict = "late"\n'
    line = SCRIPTED.count("\n") + 4
    with pytest.raises(CaseError, match=rf"port\.toml:{line}: script\[2\]\.do"):
        NetSystem(scripted("port", stop))
