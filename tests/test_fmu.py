"""FMUs in hosts: the numbers of exunet, states to go back to, faults that end an instance and not the host.

The host is most often a small program in C (`fmu_host.c`), in a process of its own that has no Python.
"""

import os
import select
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from fmu_hosts import THROWN, CHost, Unpacked, built_host, resident, workers_of, written

import exunet
from exunet.base.files import pack_arrays
from exunet.base.version import VERSION
from exunet.coupling.fmu.served import FORMAT, KIND, Served

CASES = Path(__file__).parent.parent / "cases"
PATIENCE = 60.0  # [s] for a process to end
SNAP = 0.12  # [s] when threads of the thrown net snap taut
STEP = 0.01
BACK = "restore an FMU state that was kept by then, or reset the FMU, which begins at 0 s again"


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


def expected(case: Path, times: list[float], overrides: tuple[str, ...] = ()) -> dict[str, float]:
    """What `NetSystem` gives at the last of these times."""
    net = exunet.NetSystem(case, overrides)
    for time in times:
        net.step(time, {})
        net.finish()
    sim = net.simulation
    bullets = sim.net.position[sim.net.bullets]
    found = {
        f"net.bullet{k}.position.{axis}": bullets[k, n] for k in range(4) for n, axis in enumerate("xyz")
    }
    found |= {f"net.energy.{name}": value for name, value in sim.energy._asdict().items()}
    found["net.largest_tension"] = sim.largest_tension["tension_N"]
    return found


def times_of(until: float) -> list[float]:
    """Ends of steps, which are stored times of the case."""
    return [float(time) for time in 0.005 * np.arange(2, round(until / 0.005) + 1, 2)]


# Numbers


@pytest.mark.slow
def test_a_host_in_c_gets_the_numbers_of_a_net_system(host: CHost, case: Path) -> None:
    """To the last bit, through a snap."""
    initialise(host)
    go(host, 0.2)
    for name, value in expected(case, times_of(0.2)).items():
        assert host.get(name) == value, name


@pytest.mark.parametrize("fmi", [2, 3])
def test_the_validator_finds_nothing(fmus: dict[int, Path], fmi: int) -> None:
    validation = pytest.importorskip("fmpy.validation")
    assert validation.validate_fmu(str(fmus[fmi])) == []


@pytest.mark.slow
@pytest.mark.parametrize("fmi", [2, 3])
def test_fmpy_gets_the_same_numbers(fmus: dict[int, Path], case: Path, fmi: int) -> None:
    """To the last bit, with a parameter: ends of steps that are stored times but for round-off are those."""
    fmpy = pytest.importorskip("fmpy")
    found = fmpy.simulate_fmu(
        str(fmus[fmi]), stop_time=0.1, output_interval=STEP, start_values={"case.launch.speed": 4.0}
    )
    assert found["time"][-1] == pytest.approx(0.1, rel=1e-12)
    for name, value in expected(case, times_of(0.1), ("launch.speed=4.0",)).items():
        assert found[name][-1] == value, name


@pytest.mark.slow
def test_libcosim_gets_the_same_numbers(fmus: dict[int, Path], case: Path) -> None:
    """In a process of its own, where its log goes. It counts time in nanoseconds."""
    pytest.importorskip("libcosimpy")
    program = """
import sys
from libcosimpy.CosimExecution import CosimExecution
from libcosimpy.CosimObserver import CosimObserver
from libcosimpy.CosimSlave import CosimLocalSlave
execution = CosimExecution.from_step_size(10_000_000)
slave = CosimLocalSlave(sys.argv[1], "net")
index = execution.add_local_slave(slave)
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
    for name, value in expected(case, times_of(0.1), ("launch.speed=4.0",)).items():
        assert found[name] == value, name


@pytest.mark.slow
@pytest.mark.parametrize("fmi", [2, 3])
def test_the_papers_net_is_that_of_a_run(tmp_path: Path, fmi: int) -> None:
    """Until 1.0 s, communication points being the stored times: to 1e-12 of the size and of the energy."""
    fmpy = pytest.importorskip("fmpy")
    path = CASES / "planar_deployment.toml"
    run = exunet.run(exunet.load(path, ["time.end=1.0"]))
    fmu = exunet.export_fmu(path, tmp_path / "net.fmu", fmi=fmi)
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
def test_parameters_are_set_until_the_initialisation_ends(host: CHost, case: Path) -> None:
    """An output that is asked for in between is that of the values so far; a reset brings the case's back."""
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
    for name, value in expected(case, times_of(0.2), tuple(softer)).items():
        assert host.get(name) == value, name
    assert "cannot be set after the initialisation" in host.fails("set", 0, references[speed], 4.0)
    host.do("reset", 0)
    initialise(host)
    assert host.get(speed) == 5.0
    assert host.get("net.energy.kinetic") == before


# States


@pytest.mark.slow_for("2")
def test_a_rollback_in_a_snap_repeats_to_the_last_bit(host: CHost) -> None:
    initialise(host)
    go(host, SNAP)
    host.do("keep", 0, 0)
    here = host.all_outputs()
    go(host, 0.2, SNAP)
    first = host.all_outputs()
    assert first != here
    host.do("back", 0, 0)
    assert host.all_outputs() == here
    go(host, 0.2, SNAP)
    assert host.all_outputs() == first
    host.do("drop", 0, 0)


@pytest.mark.slow
def test_a_state_in_a_file_goes_to_new_instances_and_processes(
    host: CHost, program: Path, tmp_path: Path
) -> None:
    """Also into one that was not initialised, with a parameter that is not the case's."""
    host.do("enter", 0, 0.0)
    host.set("case.launch.speed", 6.0)
    host.do("exit", 0)
    go(host, SNAP)
    host.do("keep", 0, 0)
    host.do("save", 0, 0, tmp_path / "state")
    go(host, 0.2, SNAP)
    expected = host.all_outputs()
    host.do("drop", 0, 0)
    with CHost(program, host.fmu) as other:
        other.do("new", 1)
        other.do("load", 1, 0, tmp_path / "state")
        other.do("back", 1, 0)
        go(other, 0.2, SNAP, number=1)
        assert other.get("case.launch.speed", 1) == 6.0
        assert other.all_outputs(1) == expected
        other.do("free", 1)


@pytest.mark.slow
def test_states_that_do_not_belong_here_are_refused(
    host: CHost, program: Path, unpacked: dict[int, Unpacked], tmp_path: Path
) -> None:
    """Of another FMU, damaged, cut short, or freed with their worker; the instance goes on after a reset."""
    initialise(host)
    host.do("keep", 0, 0)
    host.do("save", 0, 0, tmp_path / "state")
    content = (tmp_path / "state").read_bytes()
    (tmp_path / "short").write_bytes(content[:-10])
    changed = bytearray(content)
    changed[-1] ^= 1
    (tmp_path / "changed").write_bytes(changed)
    (tmp_path / "empty").write_bytes(b"")
    host.do("new", 1)
    initialise(host, 1)
    assert "is of another instance: serialise it there" in host.fails("back", 1, 0)
    host.do("load", 0, 1, tmp_path / "state")  # the instance that has it goes on
    host.do("drop", 0, 1)
    host.do("free", 1)
    for name, words in (
        ("short", "damaged or cut short"),
        ("changed", "the checksum of net does not match"),
        ("empty", "damaged at its beginning"),
    ):
        assert words in host.fails("load", 0, 1, tmp_path / name)
        host.do("back", 0, 0)
    other = unpacked[5 - host.fmu.fmi]
    with CHost(program, other) as strange:
        strange.do("new", 0)
        words = strange.fails("load", 0, 0, tmp_path / "state")
        assert "is of another FMU" in words
        strange.do("free", 0)
    host.do("drop", 0, 0)


@pytest.mark.slow
def test_a_thousand_rollbacks_leak_nothing(host: CHost) -> None:
    """Neither in the host nor in the worker. A leaked snapshot of this net is 20 kB or more: 20 MB in all."""
    initialise(host)
    go(host, SNAP)
    (worker,) = workers_of(host.process.pid)
    host.do("rollbacks", 0, 100, SNAP, STEP)
    before = [resident(item) for item in (host.process.pid, worker)]
    host.do("rollbacks", 0, 1000, SNAP, STEP)
    after = [resident(entry) for entry in (host.process.pid, worker)]
    assert after[0] - before[0] < 100_000
    assert after[1] - before[1] < 2_000_000


# Instances


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
        values = expected(case, times_of(0.1), overrides)
        assert {name: host.get(name, number) for name in values} == values
    host.do("free", 1)
    assert len(workers_of(host.process.pid)) == 1


@pytest.mark.slow
def test_two_processes_do_not_disturb_each_other(
    program: Path, unpacked: dict[int, Unpacked], case: Path
) -> None:
    values = expected(case, times_of(0.1))
    with CHost(program, unpacked[2]) as one, CHost(program, unpacked[3]) as other:
        for host in (one, other):
            host.start()
        for k in range(10):
            for host in (one, other):
                host.do("step", 0, k * STEP, STEP)
        for host in (one, other):
            assert {name: host.get(name) for name in values} == values
            host.do("free", 0)


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


# Faults


@pytest.mark.slow
def test_a_killed_worker_is_an_error_and_no_crash(host: CHost) -> None:
    """The host gets the words; all calls fail until a reset, which starts a new worker."""
    initialise(host)
    go(host, 0.03)
    host.do("keep", 0, 0)
    (worker,) = workers_of(host.process.pid)
    os.kill(worker, signal.SIGKILL)
    assert f"worker process {worker} was ended by signal 9" in host.fails("step", 0, 0.03, STEP)
    assert "stopped by an earlier error" in host.fails("step", 0, 0.03, STEP)
    assert "stopped by an earlier error" in host.fails("get", 0, 1)
    assert "ended by signal 9" in host.fails("back", 0, 0)
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
        (("set", 0, "net.mouth_area", 1.0), "net.mouth_area is an output, which cannot be set"),
        (("set", 0, 9999, 1.0), "no variable with the value reference 9999"),
        (("get", 0, 9999), "no variable with the value reference 9999"),
        (("turn", 0, "case.launch.speed", 1), "case.launch.speed is a number, and no boolean"),
        (("step", 0, 0.0, STEP), "doStep: the FMU is not initialised"),
        (("terminate", 0), "not initialised, or was terminated: there is nothing to terminate"),
        (("exit", 0), "the initialisation mode cannot be left: it was not entered"),
        (("enter", 0, 1.0), "the start time must be 0, got 1 s"),
    ],
    ids=lambda item: "-".join(map(str, item)) if isinstance(item, tuple) else "",
)
def test_calls_that_make_no_sense_stop_the_instance(
    host: CHost, command: tuple[object, ...], words: str
) -> None:
    named = [host.fmu.references.get(str(part), part) for part in command]
    assert words in host.fails(*named)
    assert "stopped by an earlier error" in host.fails("get", 0, 1)


@pytest.mark.slow_for("2")
@pytest.mark.parametrize(
    ("begin", "length", "words"),
    [
        (0.0, STEP, f"goes back in time, to 0 s, but the net is at 0.03 s: {BACK}"),
        (0.02, STEP, f"goes back in time, to 0.02 s, but the net is at 0.03 s: {BACK}"),
        (0.05, STEP, "begins at 0.05 s, but the net is at 0.03 s: a step from there to 0.05 s comes first"),
        (0.03, 0.0, "the communication step must be positive, got 0 s"),
        (
            0.03,
            -STEP,
            "a communication step of -0.01 s goes back in time: restore an FMU state",
        ),
        (0.03, "nan", "are no finite times"),
        (0.03, 1e-18, "a communication step of 1e-18 s is lost in the round-off of the time, 0.03 s"),
    ],
)
def test_steps_that_do_not_follow_are_told(host: CHost, begin: float, length: float, words: str) -> None:
    """A state that was kept brings the instance back."""
    initialise(host)
    go(host, 0.03)
    host.do("keep", 0, 0)
    assert words in host.fails("step", 0, begin, length)
    host.do("back", 0, 0)
    host.do("step", 0, 0.03, STEP)
    host.do("drop", 0, 0)


@pytest.mark.slow_for("2")
@pytest.mark.parametrize("time", [0.01, 0.05])
def test_the_time_of_a_co_simulation_cannot_be_set(host: CHost, time: float) -> None:
    """FMI 3.0 has all functions in each FMU. The words tell the way back, which works."""
    if host.fmu.fmi == 2:
        pytest.skip("the FMU has no such function")
    initialise(host)
    go(host, 0.01)
    host.do("keep", 0, 0)
    go(host, 0.03, 0.01)
    later = host.all_outputs()
    words = host.fails("time", 0, time)
    assert f"cannot set the time {time:g} s: this FMU is for co-simulation, whose time doStep moves" in words
    assert "to go back, restore an FMU state that was kept, or reset the FMU" in words
    host.do("back", 0, 0)
    go(host, 0.03, 0.01)
    assert host.all_outputs() == later
    host.do("drop", 0, 0)


def test_a_state_without_a_part_is_damaged(unpacked: dict[int, Unpacked]) -> None:
    served = Served(unpacked[3].folder / "resources")
    header, values = {"token": served.content.token, "overrides": []}, np.zeros(2)
    for arrays in ({"values": values}, {"values": values, "net": np.zeros(0, dtype=np.uint8)}):
        with pytest.raises(exunet.InputError, match="the FMU state is damaged: it has not what a state has"):
            served.unpack(pack_arrays(KIND, FORMAT, header, arrays), 2)


@pytest.mark.ci_for("2")
@pytest.mark.slow_for("2")
def test_a_value_that_the_case_refuses_is_told_with_its_key(host: CHost) -> None:
    host.do("enter", 0, 0.0)
    host.set("case.net.bullets.mass", -1.0)
    words = host.fails("exit", 0)
    assert "net.bullets.mass" in words
    assert "greater than 0" in words


@pytest.mark.slow
def test_a_step_that_a_guard_stops_is_discarded(program: Path, case: Path, folder: Path) -> None:
    """The net stays at its last good state, from which a state that was kept is the way on."""
    soft = exunet.export_fmu(case, folder / "soft.fmu", ["net.strings.youngs_modulus=1e3"], overwrite=True)
    with CHost(program, Unpacked.of(soft, folder / "soft")) as host:
        host.start()
        go(host, 0.02)
        here, (status, last) = host.all_outputs(), host.ask("step", 0, 0.02, 2.0)
        assert (status, last) == (2, 0.02)
        assert "last valid state, t = 0.02 s" in " ".join(host.told)
        assert host.all_outputs() == here
        host.do("step", 0, 0.02, STEP)
        host.do("free", 0)


@pytest.mark.slow
def test_binary_description_and_resources_belong_together(
    program: Path, unpacked: dict[int, Unpacked], tmp_path: Path
) -> None:
    with CHost(program, unpacked[3], token="{other}") as host:
        assert "the token of the model description" in host.fails("new", 0)
    mixed = tmp_path / "mixed"
    mixed.mkdir()
    for part, fmi in (("binaries", 3), ("modelDescription.xml", 3), ("resources", 2)):
        (mixed / part).symlink_to(unpacked[fmi].folder / part)
    with CHost(program, Unpacked(mixed)) as host:
        assert "are of two exports" in host.fails("new", 0)


@pytest.mark.slow
def test_what_is_wrong_with_the_workers_python_is_told(
    program: Path, unpacked: dict[int, Unpacked], tmp_path: Path
) -> None:
    """By the environment variable: one that is not there, without exunet, that ends at once, that garbles."""
    bare = tmp_path / "bare"
    bare.write_text(f'#!/bin/sh\nexec "{sys.executable}" -I -S "$@"\n')
    ends = tmp_path / "ends"
    ends.write_text("#!/bin/sh\nexit 7\n")
    for script in (bare, ends):
        script.chmod(0o755)
    for python, words in (
        ("/absent/python", "/absent/python: No such file or directory"),
        (str(bare), "cannot import exunet"),
        (str(ends), "ended with exit code 7 before it was ready"),
    ):
        with CHost(program, unpacked[3], environment={"EXUNET_PYTHON": python}) as host:
            told = host.fails("new", 0)
            assert words in told
            assert "EXUNET_PYTHON" in told
    garbled = tmp_path / "garbled"
    for header, words in (
        ("99, 5", "the worker's reply is damaged"),
        ("0, 1 << 60", "the worker's reply is damaged"),
        ("0, 500", "ended with exit code 0 before it was ready"),
    ):
        code = f"import os, struct; os.write(0, struct.pack('=QQ', {header}) + b'short')"
        garbled.write_text(f'#!/bin/sh\nexec "{sys.executable}" -c "{code}"\n')
        garbled.chmod(0o755)
        with CHost(program, unpacked[3], environment={"EXUNET_PYTHON": str(garbled)}) as host:
            assert words in host.fails("new", 0)
    with CHost(program, unpacked[3], environment={"EXUNET_PYTHON": sys.executable}) as host:
        host.start()
        host.do("free", 0)


@pytest.mark.ci
@pytest.mark.slow
def test_an_fmu_of_another_version_is_refused(program: Path, fmus: dict[int, Path], tmp_path: Path) -> None:
    """By its worker, with both versions."""
    fmu = Unpacked.of(fmus[3], tmp_path / "fmu")
    content = fmu.folder / "resources" / "content.json"
    content.write_text(content.read_text().replace(f'"exunet": "{VERSION}"', '"exunet": "0.0.9"'))
    with CHost(program, fmu) as host:
        assert f"the FMU is of exunet 0.0.9, its worker of exunet {VERSION}" in host.fails("new", 0)
