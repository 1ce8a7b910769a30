"""The machine around exunet: memory, disk, locks, MPLBACKEND, an installed wheel, what an import loads."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import zipfile
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from commands import CASES, PLANAR
from result_samples import square_net, unfolding

import exunet
from exunet.base import machine
from exunet.base.errors import InputError
from exunet.base.machine import disk_left, memory_left
from exunet.verification.suite import FOLDERS

ROOT = CASES.parent
MEBI = 1 << 20


def python(program: str, *arguments: object, folder: Path | None = None, **environment: str) -> str:
    """What a program prints in a new process."""
    command = [sys.executable, "-P", "-c", program, *map(str, arguments)]
    done = subprocess.run(
        command, env=os.environ | environment, cwd=folder, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


# Memory and disk available to a run


def group(folder: Path, version: int, limit: int | str, used: int, cached: int = 0) -> None:
    """Write the files of a control group, sizes in MiB."""
    if version == 2:
        limits, prefix = ("memory.max", "memory.current"), ""
    else:
        limits, prefix = ("memory.limit_in_bytes", "memory.usage_in_bytes"), "total_"
    folder.mkdir(parents=True, exist_ok=True)
    for name, value in zip(limits, (limit, used), strict=True):
        (folder / name).write_text(f"{value if isinstance(value, str) else value * MEBI}\n")
    stat = {"anon": used - cached, f"{prefix}inactive_file": cached, "inactive_file_of_others": 7}
    (folder / "memory.stat").write_text("".join(f"{name} {size * MEBI}\n" for name, size in stat.items()))


@pytest.fixture
def system(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> SimpleNamespace:
    """A machine of 8 GiB: /proc and /sys/fs/cgroup without any control group."""
    monkeypatch.delenv("EXUNET_MEMORY", raising=False)
    proc, groups = tmp_path / "proc", tmp_path / "cgroup"
    (proc / "self").mkdir(parents=True)
    (proc / "meminfo").write_text(f"MemTotal: 1 kB\nMemAvailable: {8 << 20} kB\n")
    monkeypatch.setattr(machine, "_PROC", proc)
    monkeypatch.setattr(machine, "_CGROUP", groups)
    return SimpleNamespace(groups=groups, member_of=(proc / "self" / "cgroup").write_text)


def test_this_machine_reports_memory_and_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert (disk_left(tmp_path / "not" / "yet") or 0) > MEBI
    assert (memory_left() or 0) > MEBI
    monkeypatch.setattr(machine.shutil, "disk_usage", lambda _: SimpleNamespace(total=0, used=0, free=0))
    assert disk_left(Path()) is None  # a disk of size 0 is unknown


def test_without_control_groups_the_machine_counts(system: SimpleNamespace) -> None:
    assert memory_left() == 8192 * MEBI
    system.member_of("0::/user.slice/absent\n")
    assert memory_left() == 8192 * MEBI


def test_cached_files_of_a_container_are_free(system: SimpleNamespace) -> None:
    group(system.groups, 2, limit=1000, used=990, cached=600)
    assert memory_left() == 610 * MEBI
    group(system.groups, 2, limit=100, used=120)
    assert memory_left() == 0


def test_the_narrowest_of_nested_groups_counts(system: SimpleNamespace) -> None:
    system.member_of("0::/slurm/job/step\n")
    group(system.groups / "slurm" / "job" / "step", 2, limit="max", used=50)
    group(system.groups / "slurm" / "job", 2, limit=500, used=100)
    group(system.groups / "slurm", 2, limit=4000, used=100)
    assert memory_left() == 400 * MEBI
    group(system.groups / "slurm", 2, limit=4000, used=3900)
    assert memory_left() == 100 * MEBI


@pytest.mark.parametrize("path", ["/docker/1f", "/"])
def test_limits_of_version_1(system: SimpleNamespace, path: str) -> None:
    """In a container the path is that of the host, and the mount shows the container's own group."""
    system.member_of(f"5:memory:{path}\n4:cpu:/elsewhere\n")
    group(system.groups / "memory", 1, limit=1000, used=900, cached=250)
    assert memory_left() == 350 * MEBI


@pytest.mark.parametrize(("text", "left"), [("2e9", 2 * 10**9), ("inf", None)])
def test_the_variable_replaces_what_the_system_reports(
    system: SimpleNamespace, monkeypatch: pytest.MonkeyPatch, text: str, left: int | None
) -> None:
    group(system.groups, 2, limit=100, used=100)
    monkeypatch.setenv("EXUNET_MEMORY", text)
    assert memory_left() == left


@pytest.mark.parametrize("text", ["much", "0", "-1", "nan"])
def test_a_wrong_value_of_the_variable_is_refused(monkeypatch: pytest.MonkeyPatch, text: str) -> None:
    monkeypatch.setenv("EXUNET_MEMORY", text)
    with pytest.raises(InputError, match="EXUNET_MEMORY"):
        memory_left()


STATES = 10**6
# [MB] above a run of a thousand states, of which imports and compiled code take some 450: twenty numbers of
# each stored time are in memory at once, but never the 3 GB of positions and velocities.
MEMORY = 250.0
LARGE = """
import sys
from pathlib import Path
from exunet.cli.main import app

try:
    app(sys.argv[1:])
except SystemExit as end:
    assert not end.code
# getrusage would begin with the peak of the process that started this one
print(Path("/proc/self/status").read_text().partition("VmHWM:")[2].split()[0])
"""


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="reads the largest memory of a process from /proc")
def test_a_run_with_a_million_stored_states_stays_below_the_bound(tmp_path: Path) -> None:
    """Two seconds of flight, stored every 2 microseconds: run, described, drawn, and compared with itself.

    Some minutes, and 3 GB on the disk twice over.
    """
    folder, short = tmp_path / "run", tmp_path / "short"
    settings = ("--set", "engine.backend=compiled", "--ensemble", 0)
    few, many = (("--set", f"time.output_step={step}", *settings) for step in (2e-3, 2e-6))

    def peak(*arguments: object) -> float:
        return int(python(LARGE, *arguments).split()[-1]) / 1024

    try:
        own = peak("run", PLANAR, *few, "--out", short)
        assert peak("run", PLANAR, *many, "--out", folder) < own + MEMORY
        assert peak("compare", folder, folder) < own + MEMORY
        assert len(exunet.load_result(folder).time) == STATES + 1
    finally:
        (folder / "result.h5").unlink(missing_ok=True)


# File systems without locks, as some network mounts are, and files that another program writes

NO_LOCKS = """
#define _GNU_SOURCE
#include <errno.h>
#include <fcntl.h>
#include <stdarg.h>
#include <stdlib.h>
#include <sys/syscall.h>
#include <unistd.h>

static int refused(void) { errno = atoi(getenv("LOCK_ERROR")); return -1; }

int flock(int file, int operation) { (void)file, (void)operation; return refused(); }

int fcntl(int file, int command, ...) {
    va_list rest;
    va_start(rest, command);
    void *argument = va_arg(rest, void *);
    va_end(rest);
    if (command == F_SETLK || command == F_SETLKW || command == F_OFD_SETLK) return refused();
    return syscall(SYS_fcntl, file, command, argument);
}

int fcntl64(int file, int command, ...) __attribute__((alias("fcntl")));
"""
# A run is stored, and its result is read: all of it in one process, as the import takes longest.
STORE_AND_READ = """
import os, sys
from pathlib import Path
import exunet
from exunet.simulation.run import run_into
case = exunet.load(sys.argv[1], ["time.end=0.02", "time.output_step=0.01"])
for error in sys.argv[3:]:
    os.putenv("LOCK_ERROR", error)
    folder = Path(sys.argv[2]) / error
    folder.mkdir()
    run_into(folder, case)
    print(len(exunet.load_result(folder).time))
"""


@pytest.mark.skipif(sys.platform != "linux" or shutil.which("gcc") is None, reason="preloads a library")
def test_a_run_is_stored_and_read_where_there_are_no_locks(tmp_path: Path) -> None:
    """ENOLCK, EINVAL and EOPNOTSUPP."""
    source, library = tmp_path / "locks.c", tmp_path / "locks.so"
    source.write_text(NO_LOCKS)
    subprocess.run(["gcc", "-shared", "-fPIC", "-o", library, source], check=True)
    arguments = (PLANAR, tmp_path, 37, 22, 95)
    assert python(STORE_AND_READ, *arguments, LD_PRELOAD=str(library)).split() == ["3", "3", "3"]


def test_a_result_that_another_program_writes_is_not_called_damaged(tmp_path: Path) -> None:
    path = tmp_path / "run.h5"
    exunet.save(unfolding(square_net(cells=2)), path)
    writes = "import sys, h5py; file = h5py.File(sys.argv[1], 'a'); print(flush=True); input()"
    pipes: dict[str, Any] = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    with subprocess.Popen([sys.executable, "-c", writes, path], **pipes) as other:
        other.stdout.readline()
        with pytest.raises(InputError, match="another program is writing"):
            exunet.load_result(path)
        other.communicate(b"\n")
    assert len(exunet.load_result(path).time)


# Imports and installation

DRAW = """
import os, sys
import exunet
exunet.figure(exunet.load_result(sys.argv[1]), "reference_net").savefig(sys.argv[2])
import matplotlib
print(os.environ["MPLBACKEND"], matplotlib.rcParams._get_backend_or_none())
"""


def test_figures_are_drawn_though_mplbackend_names_what_is_not_there(tmp_path: Path) -> None:
    """As in the terminal of a notebook; the caller's choice stays."""
    exunet.save(unfolding(square_net(cells=2)), tmp_path / "result.h5")
    backend = "module://of.no"
    printed = python(DRAW, tmp_path / "result.h5", tmp_path / "net.png", MPLBACKEND=backend)
    assert printed == f"{backend} {backend}\n"
    assert (tmp_path / "net.png").stat().st_size > 1000


@pytest.mark.slow
def test_an_import_is_cheap_and_has_all_public_names() -> None:
    python("""
import sys, exunet
names = dir(exunet)
assert not {"numpy", "matplotlib", "exudyn"} & set(sys.modules), "import exunet is not cheap"
assert names == sorted(exunet.__all__)
for name in names:
    assert getattr(exunet, name) is not None
""")


INSTALLED = """
import exunet
from exunet.verification.suite import AT_STATES, suite
from exunet.base.cases import shipped
from importlib.resources import files
print(exunet.__file__)
print(len([item for item in suite() if item.section == AT_STATES]))
print(len(shipped("verification")), len(shipped("hard")))
print(len([item for item in (files("exunet.coupling.fmu") / "c").iterdir() if item.name.endswith(".c")]))
"""


@pytest.mark.slow
def test_the_cases_and_sources_come_with_the_wheel(tmp_path: Path) -> None:
    """From an empty folder. Building takes hatchling from the package index, as installing does."""
    wheel = [sys.executable, "-m", "pip", "wheel", "-q", "--no-deps", "-w", str(tmp_path), str(ROOT)]
    subprocess.run(wheel, check=True)
    (built,) = tmp_path.glob("*.whl")
    installed, empty = tmp_path / "installed", tmp_path / "empty"
    with zipfile.ZipFile(built) as file:
        file.extractall(installed)
    empty.mkdir()
    place, *counts = python(INSTALLED, folder=empty, PYTHONPATH=str(installed)).split()
    assert Path(place) == installed / "exunet" / "__init__.py"
    count: Callable[[str], int] = lambda pattern: len(list(ROOT.glob(pattern)))  # noqa: E731
    cases = sum(count(f"cases/{folder}/*.toml") for folder in FOLDERS)
    others = ("cases/verification/*.toml", "cases/hard/*.toml", "exunet/coupling/fmu/c/*.c")
    assert [int(number) for number in counts] == [cases, *map(count, others)]


@pytest.mark.slow
def test_an_editable_install_is_found_beside_a_folder_of_its_name(tmp_path: Path) -> None:
    """A clone is a folder named exunet, which Python takes for a package without code in the folder above."""
    install = [
        sys.executable,
        "-m",
        "pip",
        "install",
        "-q",
        "--no-deps",
        "--target",
        str(tmp_path / "site"),
        "-e",
    ]
    subprocess.run([*install, str(ROOT)], check=True)
    (tmp_path / "exunet").mkdir()
    program = (
        f"import site; site.addsitedir({str(tmp_path / 'site')!r}); import exunet; print(exunet.__file__)"
    )
    above = {"env": {"PYTHONPATH": str(tmp_path)}, "cwd": tmp_path}
    place = subprocess.run(
        [sys.executable, "-S", "-c", program], check=True, capture_output=True, text=True, **above
    )
    assert Path(place.stdout.strip()) == ROOT / "exunet" / "__init__.py"
    assert not (tmp_path / "site" / "exunet").exists()  # no copy of the cases
