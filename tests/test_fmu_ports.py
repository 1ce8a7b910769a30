"""FMUs of nets with ports: motion in, wrench and impulse out, as `NetSystem` and `Cosimulation` have it."""

import math
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from fmu_hosts import PORT, CHost, Unpacked, built_host, written

import exunet
from exunet.bodies.port import frames_of, rows_of
from exunet.coupling.prediction import CONTRACTING, STABLE, Predictor, longest_step

pytestmark = pytest.mark.slow  # they compile a kernel

STEP = 0.01
PARTS = {
    "position": "xyz",
    "velocity": "xyz",
    "attitude": "wxyz",
    "angular_velocity": "xyz",
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("fmus")


@pytest.fixture(scope="module")
def case(folder: Path) -> Path:
    return written(folder, "port", PORT)


@pytest.fixture(scope="module")
def program(folder: Path) -> Path:
    return built_host(folder)


@pytest.fixture(scope="module")
def net(case: Path) -> exunet.NetSystem:
    return exunet.NetSystem(case, wrenches=("the-target",))


@pytest.fixture(scope="module", params=[2, 3])
def shared(request: pytest.FixtureRequest, folder: Path, program: Path, case: Path) -> Iterator[CHost]:
    fmu = exunet.export_fmu(case, folder / f"{request.param}.fmu", fmi=request.param)
    with CHost(program, Unpacked.of(fmu, folder / f"unpacked{request.param}")) as host:
        host.do("new", 0)
        yield host
        host.do("free", 0)


@pytest.fixture
def host(shared: CHost) -> CHost:
    shared.do("reset", 0)
    return shared


def tell(host: CHost, state: exunet.FrameState, port: str = "chaser") -> None:
    """The inputs of the port."""
    for what, parts in PARTS.items():
        for part, value in zip(parts, getattr(state, what), strict=True):
            host.set(f"ports.{port}.{what}.{part}", float(value))


def vector(host: CHost, name: str) -> np.ndarray:
    return np.array([host.get(f"{name}.{axis}") for axis in "xyz"])


def swaying(time: float) -> exunet.FrameState:
    """A chaser that accelerates and turns, from the start of the case on."""
    turn = 0.3 * time * time
    return exunet.FrameState(
        (-0.495 - 0.2 * time * time, -0.495, -0.2 + time),
        (-0.4 * time, 0.0, 1.0),
        (math.cos(0.5 * turn), 0.0, 0.0, math.sin(0.5 * turn)),
        (0.0, 0.0, 0.6 * time),
    )


@pytest.mark.ci_for("3-True")
@pytest.mark.slow
@pytest.mark.parametrize("at_end", [False, True])
def test_the_port_gives_what_a_net_system_gives(host: CHost, net: exunet.NetSystem, at_end: bool) -> None:
    """To the last bit through the pull of the tether: mean force and torque, their sums, bodies."""
    net.reset()
    host.do("enter", 0, 0.0)
    host.do("turn", 0, host.fmu.references["ports.inputs_at_end"], int(at_end))
    host.do("exit", 0)
    largest, predictor = 0.0, Predictor()
    for begin, end in pairwise((STEP * np.arange(61)).tolist()):
        told = swaying(end) if at_end else swaying(begin)
        tell(host, told)
        host.do("step", 0, begin.hex(), STEP)
        if not at_end:
            now = rows_of([told])
            told = frames_of(net.ports, predictor.told(begin, end, now))["chaser"]
            predictor.keep(begin, now)
        load = net.step(end, {"chaser": told})["chaser"]
        net.finish()
        largest = max(largest, float(np.abs(load.force).max()))
        assert (vector(host, "ports.chaser.force") == load.force).all()
        assert (vector(host, "ports.chaser.torque") == load.torque).all()
    given = net.given("chaser")
    assert (vector(host, "ports.chaser.impulse") == given.impulse).all()
    assert (vector(host, "ports.chaser.angular_impulse") == given.angular_impulse).all()
    assert host.get("ports.chaser.work") == given.work
    target = net.simulation.bodies["the-target"]
    assert target.angular_velocity is not None
    spin = vector(host, "bodies.'the-target'.angular_velocity")  # turned from one frame to another: rounded
    assert spin == pytest.approx(target.angular_velocity, abs=2e-16)
    assert host.get("net.largest_tension") == net.simulation.largest_tension["tension_N"]
    assert largest > 0.1  # [N]: it was pulled


@pytest.mark.slow
def test_a_wrench_acts_at_the_origin_of_the_bodys_frame(host: CHost) -> None:
    """Slack threads: m a = F at the centre of mass, and no turning where the torque cancels the arm's.

    With 0.5 g of the tether's end on the 5 kg of the body. Uncancelled, 1 N m on 0.2 kg m2 gives 5e-3 rad/s.
    """
    force, centre = np.array([0.0, 0.0, 50.0]), np.array([0.02, 0.0, 0.01])  # [N], [m]
    host.do("enter", 0, 0.0)
    for axis in "xyz":
        host.set(f"case.bodies.'the-target'.angular_velocity.{axis}", 0.0)
        host.set(f"case.bodies.'the-target'.velocity.{axis}", 0.0)
    host.do("exit", 0)
    of = "bodies.'the-target'"
    host.set(f"{of}.force.z", 50.0)
    for axis, value in zip("xyz", np.cross(centre, force), strict=True):
        host.set(f"{of}.torque.{axis}", float(value))
    host.do("step", 0, 0.0, 1e-3)
    np.testing.assert_allclose(vector(host, f"{of}.velocity"), [0.0, 0.0, 0.01], rtol=2e-4, atol=2e-6)
    np.testing.assert_allclose(vector(host, f"{of}.angular_velocity"), 0.0, atol=1e-5)


@pytest.mark.slow
def test_a_port_starts_where_its_inputs_are(host: CHost, case: Path) -> None:
    """Another velocity is that of a case with it; another place tears the net from its corner."""
    start = swaying(0.0)._replace(velocity=(0.0, 0.0, 0.5), angular_velocity=(0.0, 0.0, 0.1))
    host.do("enter", 0, 0.0)
    tell(host, start)
    host.do("exit", 0)
    host.do("step", 0, 0.0, STEP)
    turned = ["bodies.chaser.velocity=[0.0, 0.0, 0.5]", "bodies.chaser.angular_velocity=[0.0, 0.0, 0.1]"]
    other = exunet.NetSystem(case, turned, wrenches=("the-target",))
    other.step(STEP, {"chaser": start.after(STEP)})
    assert host.get("net.energy.kinetic") == other.simulation.energy.kinetic
    host.do("reset", 0)
    host.do("enter", 0, 0.0)
    tell(host, start._replace(position=(3.0, 0.0, 0.0)))
    assert "bodies.chaser.attachments" in host.fails("exit", 0)


@pytest.mark.ci_for("2")
@pytest.mark.slow
def test_faults_of_the_host_are_told_by_the_name_of_the_port(host: CHost) -> None:
    """And the last good state that it kept goes on as if nothing had been."""
    host.do("enter", 0, 0.0)
    host.do("exit", 0)
    for k in range(5):
        tell(host, swaying(k * STEP))
        host.do("step", 0, k * STEP, STEP)
    host.do("keep", 0, 0)
    tell(host, swaying(0.05))
    host.do("step", 0, 0.05, STEP)
    expected = host.all_outputs()
    for name, value, words in (
        ("ports.chaser.position.x", 4.0, "port chaser jumps"),
        ("ports.chaser.attitude.w", 0.3, "step: port chaser: the attitude is a unit quaternion"),
    ):
        host.do("back", 0, 0)
        tell(host, swaying(0.05))
        host.set(name, value)
        assert words in host.fails("step", 0, 0.05, STEP)
    host.do("back", 0, 0)
    reference = host.fmu.references["ports.chaser.velocity.y"]
    assert "ports.chaser.velocity.y cannot be set to nan" in host.fails("set", 0, reference, "nan")
    host.do("back", 0, 0)
    tell(host, swaying(0.05))
    host.do("step", 0, 0.05, STEP)
    assert host.all_outputs() == expected
    host.do("drop", 0, 0)


@pytest.mark.slow
def test_as_many_booleans_as_variables(host: CHost) -> None:
    """FMI 3 tells both numbers."""
    if host.fmu.fmi == 3:
        words = host.fails("miscount", 0, host.fmu.references["ports.inputs_at_end"], 2)
        assert "fmi3SetBoolean: 1 variables have 2 values" in words


@pytest.mark.slow
@pytest.mark.parametrize("at_end", [False, True])
def test_a_step_beyond_the_longest_is_discarded(host: CHost, net: exunet.NetSystem, at_end: bool) -> None:
    """Unless the parameter says otherwise; a shorter one goes on from there."""
    net.reset()
    longest = longest_step(net, CONTRACTING if at_end else STABLE)
    start = net.frame("chaser")
    for allowed in (0.0, 2.0 * longest):
        host.do("reset", 0)
        host.do("enter", 0, 0.0)
        host.do("turn", 0, host.fmu.references["ports.inputs_at_end"], int(at_end))
        host.set("ports.longest_step", allowed)
        host.do("exit", 0)
        tell(host, start.after(1.05 * longest) if at_end else start)
        status, last = host.ask("step", 0, 0.0, 1.05 * longest)
        if allowed:
            assert status == 0
            continue
        assert (status, last) == (2, 0.0)
        assert "is longer than the largest stable one for the ports" in " ".join(host.told)
        tell(host, start.after(0.95 * longest) if at_end else start)
        host.do("step", 0, 0.0, 0.95 * longest)
    host.do("reset", 0)
    host.do("enter", 0, 0.0)
    host.set("ports.longest_step", 1e-3)
    host.do("exit", 0)
    assert host.ask("step", 0, 0.0, 2e-3)[0] == 2
    assert "is longer than ports.longest_step, 0.001 s" in " ".join(host.told)


@pytest.mark.ci_for("2")
@pytest.mark.slow
def test_states_repeat_to_the_last_bit_while_the_tether_pulls(host: CHost, tmp_path: Path) -> None:
    """In memory and from bytes, with the port under way."""
    host.do("enter", 0, 0.0)
    host.do("exit", 0)

    def go(first: int, last: int) -> None:
        for k in range(first, last):
            tell(host, swaying(k * STEP))
            host.do("step", 0, k * STEP, STEP)

    go(0, 30)
    host.do("keep", 0, 0)
    host.do("save", 0, 0, tmp_path / "state")
    go(30, 60)
    expected = host.all_outputs()
    host.do("back", 0, 0)
    go(30, 60)
    assert host.all_outputs() == expected
    host.do("load", 0, 1, tmp_path / "state")
    host.do("reset", 0)
    host.do("back", 0, 1)
    go(30, 60)
    assert host.all_outputs() == expected
    host.do("drop", 0, 0)
    host.do("drop", 0, 1)


@pytest.mark.slow
@pytest.mark.parametrize("fmi", [2, 3])
def test_the_validator_finds_nothing(folder: Path, case: Path, fmi: int) -> None:
    validation = pytest.importorskip("fmpy.validation")
    path = exunet.export_fmu(case, folder / "checked.fmu", fmi=fmi, overwrite=True)
    assert validation.validate_fmu(str(path)) == []
