"""Corner units and a script in a case with a port: what a host steps is what a run does."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scripts import FALL, entry

import exunet
from exunet import FrameState, NetSystem
from exunet.base.errors import CaseError
from exunet.scene.casefile import Case, parse_case

# A net thrown from a port, on a tether; four units steer once a box is near, and the tether is cut.
SCENE = """
format = 1
title = "Units, a script and a port"
time = { end = 0.5, output_step = 0.05 }
solver = { method = "RK44", step = 2e-4 }
engine.backend = "compiled"
initial.packing = 0.98
initial.velocity = [0.0, 0.0, 2.0]
net.topology = "square"
net.size = 1.0
net.mesh = 0.25
net.cable = { diameter = 0.001, density = 1390.0, youngs_modulus = 1e8 }
net.bullets.mass = 0.02
[bodies.chaser]
mass = 50.0
inertia = [5.0, 5.0, 5.0]
position = [0.0, 0.0, -1.5]
velocity = [0.1, 0.0, 0.0]
angular_velocity = [0.0, 0.3, 0.0]
motion = "MOTION"
[bodies.box]
shape = "sphere"
radius = 0.2
mass = 5.0
position = [0.1, 0.0, 1.0]
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


def case_of(motion: str, more: str = "") -> Case:
    return parse_case(SCENE.replace("MOTION", motion) + more, Path("port.toml"))


def frames(result: exunet.Result, row: int) -> dict[str, FrameState]:
    """The motion of the chaser in a result."""
    body = result.bodies["chaser"]
    assert body.attitude is not None
    assert body.angular_velocity is not None
    parts = body.position[row], body.velocity[row], body.attitude[row], body.angular_velocity[row]
    return {"chaser": FrameState(*(tuple(part.tolist()) for part in parts))}


@pytest.mark.ci
@pytest.mark.slow
def test_a_host_steps_a_script_and_units_as_a_run_does() -> None:
    """To the round-off of the port's way: events, what the units spend, and what comes after a snapshot."""
    whole = exunet.run(case_of("prescribed"))
    net = NetSystem(case_of("port"))
    rows = range(1, len(whole.time))
    held = net.snapshot()
    for row in rows:
        if row == 3:  # after both events
            held = net.snapshot()
        net.step(float(whole.time[row]), frames(whole, row))
    events = net.simulation.monitor.events
    assert [event["entry"] for event in events] == ["steer", "cut"]
    for one, told in zip(events, whole.provenance["script"], strict=True):
        assert one["time_s"] == pytest.approx(told["time_s"], abs=1e-9)
    state = net.simulation.state
    np.testing.assert_allclose(state.position, whole.position[-1], atol=1e-9)
    net.restore(held)
    for row in rows[2:]:
        net.step(float(whole.time[row]), frames(whole, row))
    again = net.simulation.state
    for name, values in state.arrays().items():
        np.testing.assert_array_equal(again.arrays()[name], values)
    spent = whole.states["control/spent"].values[-1]
    assert (spent > 0.01).all()


def test_a_script_does_not_stop_what_a_host_steps() -> None:
    """The host would go on without the net: it is refused with its line before anything is stepped."""
    stop = entry("late", at=0.3, do="stop", verdict="late")
    line = SCENE.count("\n") + 4
    with pytest.raises(CaseError, match=rf"port\.toml:{line}: script\[2\]\.do: a host steps this net"):
        NetSystem(case_of("port", stop))
    with pytest.raises(CaseError, match=r"script\[0\]\.do: a host steps this net and ends the run"):
        NetSystem(parse_case(FALL + stop, Path("no_port.toml")))


@pytest.mark.slow
def test_a_script_and_units_act_in_an_fmu(tmp_path: Path) -> None:
    """The bullets are where a run has them; a script that stops is refused as the FMU is made."""
    fmpy = pytest.importorskip("fmpy")

    path = Path(__file__).parents[1] / "cases" / "missions" / "drift_controlled.toml"
    short = ["time.end=0.1", "time.output_step=0.01", "solver.step=1e-4"]
    entries = "{name='go',when='range < 0.85',do='control'},{name='off',after='go',delay=0.01,do='%s'}"
    case = exunet.load(path, [*short, f"script=[{entries % 'release_control'}]"])
    whole = exunet.run(case)
    assert [item["entry"] for item in whole.provenance["script"]] == ["go", "off"]
    exunet.export_fmu(case, tmp_path / "net.fmu")
    found = fmpy.simulate_fmu(str(tmp_path / "net.fmu"), stop_time=0.1, step_size=0.01, output_interval=0.01)
    bullet = whole.position[-1, whole.net.bullet_nodes[0]]
    names = [f"net.bullet0.position.{axis}" for axis in "xyz"]
    np.testing.assert_allclose([found[name][-1] for name in names], bullet, atol=1e-9)
    stops = entries.replace("'%s'", "'stop',verdict='late'")
    with pytest.raises(CaseError, match=r"script\[1\]\.do: a host steps this net and ends the run"):
        exunet.export_fmu(exunet.load(path, [*short, f"script=[{stops}]"]), tmp_path / "other.fmu")
