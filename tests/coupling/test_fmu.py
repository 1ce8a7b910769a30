"""FMUs in hosts: the numbers of exunet, states to restore, ports, errors that end an instance and not the
host.

The host is most often a small program in C (`fmu_host.c`), in a process of its own without Python.
"""

import math
import os
import select
import shutil
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from fmu_hosts import PORT, THROWN, CHost, Unpacked, built_host, resident, workers_of, written
from scenes import CASES

import exunet
from exunet import FrameState, NetSystem
from exunet.base.files import pack_arrays
from exunet.base.version import VERSION
from exunet.bodies.port import frames_of, rows_of
from exunet.coupling.fmu.worker import DONE, FORMAT, HEADER, KIND, Content, Served
from exunet.coupling.rollback import Predictor
from exunet.coupling.stability import CONTRACTING, STABLE, longest_step

PATIENCE = 60.0  # [s] for a process to end
SNAP = 0.12  # [s] when threads of the thrown net snap taut
STEP = 0.01
BACK = "restore an FMU state that was kept by then, or reset the FMU"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("fmus")


@pytest.fixture(scope="module")
def case(folder: Path) -> Path:
    return written(folder, "thrown", THROWN)


@pytest.fixture(scope="module")
def program(folder: Path) -> Path:
    return built_host(folder)


@pytest.fixture(scope="module")
def fmus(folder: Path, case: Path) -> dict[int, Path]:
    return {fmi: exunet.export_fmu(case, folder / f"thrown{fmi}.fmu", fmi=fmi) for fmi in (2, 3)}


@pytest.fixture(scope="module")
def unpacked(folder: Path, fmus: dict[int, Path]) -> dict[int, Unpacked]:
    return {fmi: Unpacked.of(path, folder / f"fmi {fmi} %") for fmi, path in fmus.items()}


# Both versions share all but their functions; the quick tests have the newer one in C, and both in FMPy.
OLDER = pytest.param(2, marks=pytest.mark.slow)


@pytest.fixture(scope="module", params=[OLDER, 3])
def shared(request: pytest.FixtureRequest, program: Path, unpacked: dict[int, Unpacked]) -> Iterator[CHost]:
    with CHost(program, unpacked[request.param]) as host:
        host.do("new", 0)
        yield host
        host.do("free", 0)


@pytest.fixture
def host(shared: CHost) -> CHost:
    """One with an instance 0, as it is after a reset."""
    shared.do("reset", 0)
    return shared


def initialise(host: CHost, number: int = 0) -> None:
    host.do("enter", number, 0.0)
    host.do("exit", number)


def go(host: CHost, until: float, begin: float = 0.0, number: int = 0) -> None:
    """Steps of 10 ms."""
    for k in range(round((until - begin) / STEP)):
        host.do("step", number, begin + k * STEP, STEP)


def expected(case: Path, until: float, *overrides: str) -> dict[str, float]:
    """What `NetSystem` gives after steps of 10 ms, whose ends are stored times of the case."""
    net = NetSystem(case, overrides)
    for time in 0.005 * np.arange(2, round(until / 0.005) + 1, 2):
        net.step(float(time), {})
        net.finish()
    sim = net.simulation
    bullets = sim.net.position[sim.net.bullets]
    found = {
        f"net.bullet{k}.position.{axis}": bullets[k, n] for k in range(4) for n, axis in enumerate("xyz")
    }
    found |= {f"net.energy.{name}": value for name, value in sim.energy._asdict().items()}
    found["net.largest_tension"] = sim.largest_tension.tension
    return found


# Numbers


@pytest.mark.parametrize("fmi", [2, 3])
def test_the_validator_finds_nothing(fmus: dict[int, Path], fmi: int) -> None:
    validation = pytest.importorskip("fmpy.validation")
    assert validation.validate_fmu(str(fmus[fmi])) == []


@pytest.mark.slow
@pytest.mark.parametrize("fmi", [2, 3])
def test_fmpy_gets_the_same_numbers(fmus: dict[int, Path], case: Path, fmi: int) -> None:
    """Bitwise, with a parameter: ends of steps that are stored times but for round-off are those."""
    fmpy = pytest.importorskip("fmpy")
    found = fmpy.simulate_fmu(
        str(fmus[fmi]), stop_time=0.1, output_interval=STEP, start_values={"case.launch.speed": 4.0}
    )
    assert found["time"][-1] == pytest.approx(0.1, rel=1e-12)
    for name, value in expected(case, 0.1, "launch.speed=4.0").items():
        assert found[name][-1] == value, name


@pytest.mark.slow
def test_libcosim_gets_the_same_numbers(fmus: dict[int, Path], case: Path) -> None:
    """In another process, which gets its log. It counts time in nanoseconds."""
    pytest.importorskip("libcosimpy")
    program = """
import sys
from libcosimpy.CosimExecution import CosimExecution
from libcosimpy.CosimObserver import CosimObserver
from libcosimpy.CosimSlave import CosimLocalSlave
execution = CosimExecution.from_step_size(10_000_000)
index = execution.add_local_slave(CosimLocalSlave(sys.argv[1], "net"))
observer = CosimObserver.create_last_value()
execution.add_observer(observer)
references = {one.name.decode(): one.reference for one in execution.slave_variables(index)}
execution.real_initial_value(index, references["case.launch.speed"], 4.0)
assert execution.step(10)
names = [name for name in references if name.startswith("net.")]
for name, value in zip(names, observer.last_real_values(index, [references[name] for name in names])):
    print("value", name, repr(value))
"""
    done = subprocess.run(
        [sys.executable, "-c", program, fmus[2]], capture_output=True, text=True, check=True
    )
    lines = [line.split() for line in done.stdout.splitlines() if line.startswith("value ")]  # and its log
    found = {name: float(value) for _, name, value in lines}
    for name, value in expected(case, 0.1, "launch.speed=4.0").items():
        assert found[name] == value, name


@pytest.mark.slow
def test_the_papers_net_is_that_of_a_run(tmp_path: Path) -> None:
    """Until 1.0 s, communication points being the stored times: to 1e-12 of the size and of the energy."""
    fmpy = pytest.importorskip("fmpy")
    path = CASES / "planar_deployment.toml"
    run = exunet.run(exunet.load(path, ["time.end=1.0"]))
    fmu = exunet.export_fmu(path, tmp_path / "net.fmu")
    found = fmpy.simulate_fmu(str(fmu), stop_time=1.0, output_interval=1e-3)
    np.testing.assert_allclose(found["time"], run.time, rtol=1e-14)
    for k, node in enumerate(run.net.bullet_nodes):
        for n, axis in enumerate("xyz"):
            for what, scale in (("position", 5.0), ("velocity", 2.5)):
                ours, theirs = found[f"net.bullet{k}.{what}.{axis}"], getattr(run, what)[:, node, n]
                np.testing.assert_allclose(ours, theirs, rtol=0.0, atol=1e-12 * scale)
    for what in ("kinetic", "elastic", "potential"):
        ours, theirs = found[f"net.energy.{what}"], getattr(run, what)
        np.testing.assert_allclose(ours, theirs, rtol=0.0, atol=1e-12 * run.kinetic[0])


@pytest.mark.slow
def test_a_host_in_c_and_its_parameters(host: CHost, case: Path) -> None:
    """Bitwise, through a snap. An output during initialisation is that of the values so far."""
    references, speed = host.fmu.references, "case.launch.speed"
    before = host.get("net.energy.kinetic")
    host.do("enter", 0, 0.0)
    host.set(speed, 10.0)
    assert host.get("net.energy.kinetic") == pytest.approx(4.0 * before, rel=1e-12)  # 4 = (10 / 5)^2
    host.set(speed, 5.0)
    host.set("stiffness_factor", 0.25)
    host.do("exit", 0)
    go(host, 0.2)
    softer = [f"net.{part}.youngs_modulus=17.5e9" for part in ("cable", "strings")]
    for name, value in expected(case, 0.2, *softer).items():
        assert host.get(name) == value, name
    assert "cannot be set after the initialisation" in host.fails("set", 0, references[speed], 4.0)
    host.do("reset", 0)
    initialise(host)
    assert host.get(speed) == 5.0
    assert host.get("net.energy.kinetic") == before


# States


@pytest.mark.slow_for("2")
def test_a_restored_state_in_a_snap_repeats(host: CHost) -> None:
    """Bitwise."""
    initialise(host)
    go(host, SNAP)
    host.do("keep", 0, 0)
    here = host.all_outputs()
    go(host, 0.15, SNAP)
    first = host.all_outputs()
    assert first != here
    host.do("back", 0, 0)
    assert host.all_outputs() == here
    go(host, 0.15, SNAP)
    assert host.all_outputs() == first
    host.do("drop", 0, 0)


@pytest.mark.slow
def test_a_state_in_a_file_goes_to_another_process(host: CHost, program: Path, tmp_path: Path) -> None:
    """Into an instance that was not initialised, with a parameter that is not the case's."""
    host.do("enter", 0, 0.0)
    host.set("case.launch.speed", 6.0)
    host.do("exit", 0)
    go(host, SNAP)
    host.do("keep", 0, 0)
    host.do("save", 0, 0, tmp_path / "state")
    go(host, 0.2, SNAP)
    known = host.all_outputs()
    host.do("drop", 0, 0)
    with CHost(program, host.fmu) as other:
        other.do("new", 1)
        other.do("load", 1, 0, tmp_path / "state")
        other.do("back", 1, 0)
        go(other, 0.2, SNAP, number=1)
        assert other.get("case.launch.speed", 1) == 6.0
        assert other.all_outputs(1) == known
        other.do("free", 1)


@pytest.mark.slow
def test_states_that_do_not_belong_here(
    host: CHost, program: Path, unpacked: dict[int, Unpacked], tmp_path: Path
) -> None:
    """Of another instance or FMU, damaged, cut short; the instance continues after a restore."""
    initialise(host)
    host.do("keep", 0, 0)
    host.do("save", 0, 0, tmp_path / "state")
    content = (tmp_path / "state").read_bytes()
    changed = content[:-1] + bytes([content[-1] ^ 1])
    host.do("new", 1)
    initialise(host, 1)
    assert "is of another instance" in host.fails("back", 1, 0)
    host.do("load", 0, 1, tmp_path / "state")  # the instance that has it continues
    host.do("drop", 0, 1)
    host.do("free", 1)
    for name, part in (("short", content[:-10]), ("changed", changed), ("empty", b"")):
        (tmp_path / name).write_bytes(part)
        assert host.fails("load", 0, 1, tmp_path / name)
        host.do("back", 0, 0)
    with CHost(program, unpacked[5 - host.fmu.fmi]) as strange:
        strange.do("new", 0)
        assert "is of another FMU" in strange.fails("load", 0, 0, tmp_path / "state")
        strange.do("free", 0)
    host.do("drop", 0, 0)
    served = Served(unpacked[3].folder / "resources")
    header, values = {"token": served.content.token, "overrides": []}, np.zeros(2)
    for arrays in ({"values": values}, {"values": values, "net": np.zeros(0, dtype=np.uint8)}):
        with pytest.raises(exunet.InputError, match="damaged"):
            served.unpack(pack_arrays(KIND, FORMAT, header, arrays), 2)


@pytest.mark.slow
def test_a_thousand_rollbacks_leak_nothing(host: CHost) -> None:
    """Neither in the host nor in the worker. A leaked snapshot of this net is 20 kB or more: 20 MB in all."""
    initialise(host)
    go(host, SNAP)
    processes = host.process.pid, *workers_of(host.process.pid)
    host.do("rollbacks", 0, 100, SNAP, STEP)
    before = [resident(process) for process in processes]
    host.do("rollbacks", 0, 1000, SNAP, STEP)
    grown = [resident(process) - size for process, size in zip(processes, before, strict=True)]
    assert grown[0] < 100_000
    assert grown[1] < 2_000_000


# Instances and errors


@pytest.mark.slow
def test_two_instances_in_one_process_have_workers_of_their_own(host: CHost, case: Path) -> None:
    host.do("new", 1)
    initialise(host)
    host.do("enter", 1, 0.0)
    host.set("case.launch.speed", 4.0, 1)
    host.do("exit", 1)
    assert len(workers_of(host.process.pid)) == 2
    for k in range(10):
        for number in (0, 1):
            host.do("step", number, k * STEP, STEP)
    for number, overrides in ((0, ()), (1, ("launch.speed=4.0",))):
        values = expected(case, 0.1, *overrides)
        assert {name: host.get(name, number) for name in values} == values
    host.do("free", 1)
    assert len(workers_of(host.process.pid)) == 1


@pytest.mark.ci
@pytest.mark.slow
def test_a_worker_ends_with_its_host(program: Path, unpacked: dict[int, Unpacked]) -> None:
    """Also if the host is killed."""
    host = CHost(program, unpacked[3])
    host.__enter__()
    host.start()
    (worker,) = workers_of(host.process.pid)
    descriptor = os.pidfd_open(worker)
    host.process.kill()
    host.process.communicate()
    ended, _, _ = select.select([descriptor], [], [], PATIENCE)
    os.close(descriptor)
    assert ended


@pytest.mark.ci
@pytest.mark.slow
def test_a_worker_ends_within_a_step_once_its_host_is_gone(case: Path, tmp_path: Path) -> None:
    """A step of 5e7 steps of the method takes far longer than the worker may live."""
    fine = ['solver={method = "RK44", step = 1e-8}']
    fmu = Unpacked.of(exunet.export_fmu(case, tmp_path / "fine.fmu", fine), tmp_path)
    resources = fmu.folder / "resources"
    values = np.array(Content.read(resources).starts)
    ours, theirs = socket.socketpair()
    with ours, subprocess.Popen([sys.executable, "-P", resources / "start.py"], stdin=theirs) as worker:
        theirs.close()
        build, step = (
            HEADER.pack(request, content.nbytes) + content.tobytes()
            for request, content in ((0, values), (1, np.concatenate([[0.0, 0.5], values])))
        )
        ours.sendall(build)
        answers = [HEADER.unpack(ours.recv(HEADER.size))]  # ready, with the token
        ours.recv(answers[0][1], socket.MSG_WAITALL)
        answers.append(HEADER.unpack(ours.recv(HEADER.size)))
        assert [status for status, _ in answers] == [DONE, DONE]
        ours.sendall(step)
        ours.close()
        assert worker.wait(PATIENCE) == 0


@pytest.mark.slow
def test_a_killed_worker_is_an_error_and_no_crash(host: CHost) -> None:
    """The host gets the reason; all calls fail until a reset, which starts a new worker."""
    initialise(host)
    go(host, 0.03)
    host.do("keep", 0, 0)
    (worker,) = workers_of(host.process.pid)
    os.kill(worker, signal.SIGKILL)
    assert f"worker process {worker} was ended by signal 9" in host.fails("step", 0, 0.03, STEP)
    for command in (("step", 0, 0.03, STEP), ("get", 0, 1), ("back", 0, 0)):
        assert host.fails(*command)
    host.do("reset", 0)
    assert "was lost with the worker" in host.fails("back", 0, 0)
    host.do("drop", 0, 0)
    host.do("reset", 0)
    initialise(host)
    go(host, 0.03)


@pytest.mark.slow_for("2")
@pytest.mark.parametrize(
    ("command", "words"),
    [
        (("set", 0, "case.launch.speed", "nan"), "case.launch.speed cannot be set to nan"),
        (("set", 0, "case.launch.speed", "inf"), "case.launch.speed cannot be set to inf"),
        (("set", 0, "net.mouth_area", 1.0), "net.mouth_area is an output"),
        (("set", 0, 9999, 1.0), "9999"),
        (("get", 0, 9999), "9999"),
        (("turn", 0, "case.launch.speed", 1), "case.launch.speed is a number"),
        (("step", 0, 0.0, STEP), "not initialised"),
        (("terminate", 0), "not initialised"),
        (("exit", 0), "not entered"),
        (("enter", 0, 1.0), "start time"),
        (("enter", 0, 0.0, "nan"), "stop time"),
    ],
    ids=lambda item: "-".join(map(str, item)) if isinstance(item, tuple) else "",
)
def test_invalid_calls_stop_the_instance(host: CHost, command: tuple[object, ...], words: str) -> None:
    named = [host.fmu.references.get(str(part), part) for part in command]
    assert words in host.fails(*named)
    assert "stopped by an earlier error" in host.fails("get", 0, 1)


@pytest.mark.slow_for("2")
@pytest.mark.parametrize(
    ("begin", "length", "words"),
    [
        (0.0, STEP, f"to 0 s, but the net is at 0.03 s: {BACK}"),
        (0.02, STEP, f"to 0.02 s, but the net is at 0.03 s: {BACK}"),
        (0.05, STEP, "begins at 0.05 s, but the net is at 0.03 s"),
        (0.03, 0.0, "must be positive"),
        (0.03, -STEP, "goes back in time"),
        (0.03, "nan", "no finite times"),
        (0.03, 1e-18, "round-off"),
    ],
)
def test_steps_that_do_not_follow(host: CHost, begin: float, length: float, words: str) -> None:
    """A state that was kept brings the instance back."""
    initialise(host)
    go(host, 0.03)
    host.do("keep", 0, 0)
    assert words in host.fails("step", 0, begin, length)
    host.do("back", 0, 0)
    if host.fmu.fmi == 3:  # which has all functions in each FMU
        assert "cannot set the time" in host.fails("time", 0, 0.01)
        host.do("back", 0, 0)
    host.do("step", 0, 0.03, STEP)
    host.do("drop", 0, 0)


@pytest.mark.ci_for("2")
@pytest.mark.slow_for("2")
def test_no_step_passes_the_stop_time_of_the_host(host: CHost) -> None:
    """But for round-off, of 1e-9 at most; a state has its stop time, a reset has none."""
    host.do("enter", 0, 0.0, 0.03 * (1.0 - 0.9e-9))
    host.do("exit", 0)
    go(host, 0.02)
    host.do("keep", 0, 0)
    assert host.ask("step", 0, 0.02, 1.000001 * STEP)[0] == 3
    host.do("back", 0, 0)
    host.do("step", 0, 0.02, STEP)
    assert host.ask("step", 0, 0.03, 1e-6)[0] == 3
    host.do("reset", 0)
    initialise(host)
    go(host, 0.04)
    host.do("back", 0, 0)
    assert host.ask("step", 0, 0.02, 2.0 * STEP)[0] == 3
    host.do("drop", 0, 0)


@pytest.mark.ci_for("2")
@pytest.mark.slow_for("2")
def test_a_value_that_the_case_refuses_is_reported_with_its_key(host: CHost) -> None:
    host.do("enter", 0, 0.0)
    host.set("case.net.bullets.mass", -1.0)
    assert "net.bullets.mass" in host.fails("exit", 0)


@pytest.mark.slow
def test_a_step_that_a_guard_stops_is_discarded(program: Path, case: Path, folder: Path) -> None:
    """The net stays at its last good state."""
    soft = exunet.export_fmu(case, folder / "soft.fmu", ["net.strings.youngs_modulus=1e3"], overwrite=True)
    with CHost(program, Unpacked.of(soft, folder / "soft")) as host:
        host.start()
        go(host, 0.02)
        here = host.all_outputs()
        assert host.ask("step", 0, 0.02, 2.0) == (2, 0.02)
        assert host.all_outputs() == here
        host.do("step", 0, 0.02, STEP)
        host.do("free", 0)


@pytest.mark.ci
@pytest.mark.slow
def test_binary_description_resources_and_version_belong_together(
    program: Path, fmus: dict[int, Path], unpacked: dict[int, Unpacked], tmp_path: Path
) -> None:
    with CHost(program, unpacked[3], token="{other}") as host:
        assert "the token of the model description" in host.fails("new", 0)
    mixed = tmp_path / "mixed"
    mixed.mkdir()
    for part, fmi in (("binaries", 3), ("modelDescription.xml", 3), ("resources", 2)):
        (mixed / part).symlink_to(unpacked[fmi].folder / part)
    with CHost(program, Unpacked(mixed)) as host:
        assert "are of two exports" in host.fails("new", 0)
    fmu = Unpacked.of(fmus[3], tmp_path / "fmu")
    content = fmu.folder / "resources" / "content.json"
    content.write_text(content.read_text().replace(f'"exunet": "{VERSION}"', '"exunet": "0.0.9"'))
    with CHost(program, fmu) as host:
        assert f"the FMU is of exunet 0.0.9, its worker of exunet {VERSION}" in host.fails("new", 0)


@pytest.mark.ci
@pytest.mark.slow
def test_the_loader_and_python_variables_of_the_host_do_not_reach_the_worker(
    program: Path, unpacked: dict[int, Unpacked], tmp_path: Path
) -> None:
    """A simulator has its own libraries, often with a Python of its own."""
    script, found = tmp_path / "python", tmp_path / "environment"
    script.write_text(f'#!/bin/sh\nenv > "{found}"\nexec "{sys.executable}" "$@"\n')
    script.chmod(0o755)
    of_host = dict.fromkeys(("LD_LIBRARY_PATH", "LD_ORIGIN_PATH", "PYTHONHOME", "PYTHONPATH"), "/absent")
    kept = {"EXUNET_PYTHON": str(script), "OF_THE_USER": "kept"}
    with CHost(program, unpacked[3], environment=of_host | kept) as host:
        host.start()
        host.do("free", 0)
    variables = dict(line.split("=", 1) for line in found.read_text().splitlines() if "=" in line)
    assert not [name for name in variables if name.startswith(("LD_", "PYTHON"))]
    assert kept.items() <= variables.items()
    with CHost(program, unpacked[3], environment=of_host) as host:  # with the Python of the export
        host.start()
        host.do("free", 0)


@pytest.mark.slow
def test_an_unsuitable_python_of_the_worker(
    program: Path, unpacked: dict[int, Unpacked], tmp_path: Path
) -> None:
    """By the environment variable: missing, without exunet, one that ends at once, that garbles."""
    script = tmp_path / "python"
    garbles = (
        f"""exec "{sys.executable}" -c "import os, struct; os.write(0, struct.pack('=QQ', %s) + b'short')" """
    )
    for text, words in (
        ("", "No such file"),
        (f'exec "{sys.executable}" -I -S "$@"', "cannot import exunet"),
        ("exit 7", "ended with exit code 7 before it was ready"),
        (garbles % "99, 5", "damaged"),
        (garbles % "0, 1 << 60", "damaged"),
        (garbles % "0, 500", "ended with exit code 0 before it was ready"),
    ):
        script.write_text(f"#!/bin/sh\n{text}\n")
        script.chmod(0o755)
        python = str(script) if text else "/absent/python"
        with CHost(program, unpacked[3], environment={"EXUNET_PYTHON": python}) as host:
            assert words in host.fails("new", 0)
    with CHost(program, unpacked[3], environment={"EXUNET_PYTHON": sys.executable}) as host:
        host.start()
        host.do("free", 0)


# Ports; these compile a kernel

PARTS = {"position": "xyz", "velocity": "xyz", "attitude": "wxyz", "angular_velocity": "xyz"}
TARGET = "bodies.'the-target'"


@pytest.fixture(scope="module")
def moved(folder: Path) -> NetSystem:
    return NetSystem(written(folder, "port", PORT), wrenches=("the-target",))


@pytest.fixture(scope="module", params=[2, 3])
def shared_port(request: pytest.FixtureRequest, folder: Path, program: Path) -> Iterator[CHost]:
    case = written(folder, "port", PORT)
    fmu = exunet.export_fmu(case, folder / f"port{request.param}.fmu", fmi=request.param)
    with CHost(program, Unpacked.of(fmu, folder / f"port{request.param}")) as host:
        host.do("new", 0)
        yield host
        host.do("free", 0)


@pytest.fixture
def port(shared_port: CHost) -> CHost:
    shared_port.do("reset", 0)
    return shared_port


def move(host: CHost, state: FrameState, port: str = "chaser") -> None:
    """Set the inputs of the port."""
    for what, parts in PARTS.items():
        for part, value in zip(parts, getattr(state, what), strict=True):
            host.set(f"ports.{port}.{what}.{part}", float(value))


def vector(host: CHost, name: str) -> np.ndarray:
    return np.array([host.get(f"{name}.{axis}") for axis in "xyz"])


def swaying(time: float) -> FrameState:
    """A chaser that accelerates and turns, from the start of the case on."""
    turn = 0.3 * time * time
    return FrameState(
        (-0.495 - 0.2 * time * time, -0.495, -0.2 + time),
        (-0.4 * time, 0.0, 1.0),
        (math.cos(0.5 * turn), 0.0, 0.0, math.sin(0.5 * turn)),
        (0.0, 0.0, 0.6 * time),
    )


def begin_with(host: CHost, *, at_end: bool, **values: float) -> None:
    host.do("enter", 0, 0.0)
    host.do("turn", 0, host.fmu.references["ports.inputs_at_end"], int(at_end))
    for name, value in values.items():
        host.set(f"ports.{name}", value)
    host.do("exit", 0)


@pytest.mark.ci_for("3-True")
@pytest.mark.slow
@pytest.mark.parametrize("at_end", [False, True])
def test_the_port_gives_what_a_net_system_gives(port: CHost, moved: NetSystem, at_end: bool) -> None:
    """Bitwise through the pull of the tether: mean force and torque, their sums, bodies."""
    moved.reset()
    begin_with(port, at_end=at_end)
    largest, predictor = 0.0, Predictor()
    for begin, end in pairwise((STEP * np.arange(61)).tolist()):
        state = swaying(end) if at_end else swaying(begin)
        move(port, state)
        port.do("step", 0, begin.hex(), STEP)
        if not at_end:
            now = rows_of([state])
            state = frames_of(moved.ports, predictor.ahead(begin, end, now))["chaser"]
            predictor.keep(begin, now, recoils=False)
        load = moved.step(end, {"chaser": state})["chaser"]
        moved.finish()
        largest = max(largest, float(np.abs(load.force).max()))
        assert (vector(port, "ports.chaser.force") == load.force).all()
        assert (vector(port, "ports.chaser.torque") == load.torque).all()
    total = moved.delivered("chaser")
    assert (vector(port, "ports.chaser.impulse") == total.impulse).all()
    assert (vector(port, "ports.chaser.angular_impulse") == total.angular_impulse).all()
    assert port.get("ports.chaser.work") == total.work
    spin = vector(port, f"{TARGET}.angular_velocity")  # turned from one frame to another: rounded
    assert spin == pytest.approx(moved.simulation.bodies["the-target"].angular_velocity, abs=2e-16)
    assert port.get("net.largest_tension") == moved.simulation.largest_tension.tension
    assert largest > 0.1  # [N]: it was pulled


@pytest.mark.slow
def test_a_wrench_acts_at_the_origin_of_the_bodys_frame(port: CHost) -> None:
    """Slack threads: m a = F at the centre of mass, and no turning where the torque cancels the arm's.

    With 0.5 g of the tether's end on the 5 kg of the body. Uncancelled, 1 N m on 0.2 kg m2 gives 5e-3 rad/s.
    """
    force, centre = np.array([0.0, 0.0, 50.0]), np.array([0.02, 0.0, 0.01])  # [N], [m]
    port.do("enter", 0, 0.0)
    for axis in "xyz":
        port.set(f"case.{TARGET}.angular_velocity.{axis}", 0.0)
        port.set(f"case.{TARGET}.velocity.{axis}", 0.0)
    port.do("exit", 0)
    port.set(f"{TARGET}.force.z", 50.0)
    for axis, value in zip("xyz", np.cross(centre, force), strict=True):
        port.set(f"{TARGET}.torque.{axis}", float(value))
    port.do("step", 0, 0.0, 1e-3)
    np.testing.assert_allclose(vector(port, f"{TARGET}.velocity"), [0.0, 0.0, 0.01], rtol=2e-4, atol=2e-6)
    np.testing.assert_allclose(vector(port, f"{TARGET}.angular_velocity"), 0.0, atol=1e-5)


@pytest.mark.slow
def test_a_port_starts_where_its_inputs_are(port: CHost, folder: Path) -> None:
    """Another velocity is that of a case with it; another position tears the net from its corner."""
    start = swaying(0.0)._replace(velocity=(0.0, 0.0, 0.5), angular_velocity=(0.0, 0.0, 0.1))
    port.do("enter", 0, 0.0)
    move(port, start)
    port.do("exit", 0)
    port.do("step", 0, 0.0, STEP)
    turned = ["bodies.chaser.velocity=[0.0, 0.0, 0.5]", "bodies.chaser.angular_velocity=[0.0, 0.0, 0.1]"]
    other = NetSystem(folder / "port.toml", turned, wrenches=("the-target",))
    other.step(STEP, {"chaser": start.after(STEP)})
    assert port.get("net.energy.kinetic") == other.simulation.energy.kinetic
    port.do("reset", 0)
    port.do("enter", 0, 0.0)
    move(port, start._replace(position=(3.0, 0.0, 0.0)))
    assert "bodies.chaser.attachments" in port.fails("exit", 0)


@pytest.mark.ci_for("2")
@pytest.mark.slow
def test_states_of_a_port_repeat_also_after_errors(port: CHost, tmp_path: Path) -> None:
    """While the tether pulls: in memory and from bytes; after inputs that jump or are invalid."""
    initialise(port)

    def on(first: int, last: int) -> None:
        for k in range(first, last):
            move(port, swaying(k * STEP))
            port.do("step", 0, k * STEP, STEP)

    on(0, 30)
    port.do("keep", 0, 0)
    port.do("save", 0, 0, tmp_path / "state")
    on(30, 60)
    known = port.all_outputs()
    for name, value, words in (
        ("position.x", 4.0, "port chaser jumps"),
        ("attitude.w", 0.3, "port chaser: the attitude is a unit quaternion"),
    ):
        port.do("back", 0, 0)
        move(port, swaying(30 * STEP))
        port.set(f"ports.chaser.{name}", value)
        assert words in port.fails("step", 0, 30 * STEP, STEP)
    port.do("back", 0, 0)
    reference = port.fmu.references["ports.chaser.velocity.y"]
    assert "ports.chaser.velocity.y cannot be set to nan" in port.fails("set", 0, reference, "nan")
    if port.fmu.fmi == 3:  # which passes both numbers
        port.do("back", 0, 0)
        words = port.fails("miscount", 0, port.fmu.references["ports.inputs_at_end"], 2)
        assert "fmi3SetBoolean: 1 variables have 2 values" in words
    port.do("back", 0, 0)
    on(30, 60)
    assert port.all_outputs() == known
    port.do("load", 0, 1, tmp_path / "state")
    port.do("reset", 0)
    port.do("back", 0, 1)
    on(30, 60)
    assert port.all_outputs() == known
    for number in (0, 1):
        port.do("drop", 0, number)


@pytest.mark.slow
@pytest.mark.parametrize("at_end", [False, True])
def test_a_step_beyond_the_longest_is_discarded(port: CHost, moved: NetSystem, at_end: bool) -> None:
    """Unless the parameter allows it; a shorter one continues from there."""
    moved.reset()
    longest = longest_step(moved, CONTRACTING if at_end else STABLE)
    start = moved.frame("chaser")
    for allowed, length, status in (
        (0.0, 1.05, 2), (0.0, 0.95, 0), (2.0 * longest, 1.05, 0), (1e-3, 2e-3 / longest, 2)
    ):  # fmt: skip
        port.do("reset", 0)
        begin_with(port, at_end=at_end, longest_step=allowed)
        step = length * longest
        move(port, start.after(step) if at_end else start)
        found, last = port.ask("step", 0, 0.0, step)
        assert (found, last) == (status, step if status == 0 else 0.0)


@pytest.mark.ci
@pytest.mark.slow
def test_the_default_step_is_short_enough_to_the_end(tmp_path: Path) -> None:
    """The free body stretches the threads at the port, so that the bound of the start is discarded later."""
    fmpy = pytest.importorskip("fmpy")
    longest = ["bodies.chaser.velocity=[0.0, 0.0, 0.0]", "time={end=1.0, output_step=0.5}"]
    fmu = exunet.export_fmu(written(tmp_path, "port", PORT), tmp_path / "net.fmu", longest)
    assert fmpy.simulate_fmu(str(fmu))["time"][-1] == pytest.approx(1.0, abs=1e-9)


@pytest.mark.slow
def test_a_mesh_at_a_port(program: Path, tmp_path: Path) -> None:
    """Its file goes with the FMU: bitwise what the net gives, when the file is gone."""
    for name in ("l_shape.toml", "l_shape.obj"):
        shutil.copy(CASES / "capture" / name, tmp_path / name)
    port = ["engine.backend=compiled", "bodies.l_shape.motion=port"]
    net = NetSystem(tmp_path / "l_shape.toml", port)
    fmu = exunet.export_fmu(tmp_path / "l_shape.toml", tmp_path / "net.fmu", port)
    (tmp_path / "l_shape.obj").unlink()
    with CHost(program, Unpacked.of(fmu, tmp_path / "unpacked")) as host:
        host.do("new", 0)
        begin_with(host, at_end=True)
        for begin, end in pairwise((1e-3 * np.arange(301)).tolist()):
            state = net.frame("l_shape").after(end - begin)  # continues as it began
            move(host, state, "l_shape")
            host.do("step", 0, begin.hex(), end - begin)
            net.step(end, {"l_shape": state})
        net.finish()
        total = net.delivered("l_shape")
        assert np.abs(total.impulse).max() > 1e-3  # N s
        for name in ("impulse", "angular_impulse"):
            np.testing.assert_array_equal(vector(host, f"ports.l_shape.{name}"), getattr(total, name))
        host.do("free", 0)
