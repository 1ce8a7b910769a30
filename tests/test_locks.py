"""File systems without locks, as some network mounts are, and files that another program writes."""

import os
import shutil
import subprocess
import sys

import pytest
from result_samples import square_net, unfolding

import exunet
from exunet.base.errors import InputError
from exunet.results.io import save

FIXED = """
format = 1
title = "A thread between two fixed points"
[time]
end = 0.02
output_step = 0.01
[solver]
method = "RK44"
[engine]
backend = "exudyn"
[net]
topology = "explicit"
nodes = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]
elements = [[0, 1]]
fixed = [0, 1]
cable = { diameter = 0.002, density = 1390.0, youngs_modulus = 1e9 }
[initial]
packing = 1.0
"""
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


@pytest.fixture(scope="module")
def without_locks(tmp_path_factory):
    """Run a Python program where locking a file fails with an error number."""
    if not sys.platform.startswith("linux") or shutil.which("gcc") is None:
        pytest.skip("preloads a library")
    folder = tmp_path_factory.mktemp("locks")
    source, library = folder / "locks.c", folder / "locks.so"
    source.write_text(NO_LOCKS)
    subprocess.run(["gcc", "-shared", "-fPIC", "-o", library, source], check=True)

    def run(error, *arguments):
        environment = os.environ | {"LD_PRELOAD": str(library), "LOCK_ERROR": str(error)}
        command = [sys.executable, *map(str, arguments)]
        return subprocess.run(command, env=environment, capture_output=True, text=True, check=False)

    return run


@pytest.fixture
def saved(tmp_path):
    save(unfolding(square_net(cells=2)), tmp_path / "run.h5")
    return tmp_path / "run.h5"


def test_a_run_is_stored_and_read_where_there_are_no_locks(tmp_path, without_locks):
    (tmp_path / "fixed.toml").write_text(FIXED)
    folder = tmp_path / "out"
    done = without_locks(37, "-m", "exunet", "run", tmp_path / "fixed.toml", "--spread", 0, "--out", folder)
    assert done.returncode == 0, done.stderr
    assert (folder / "summary.json").is_file()


@pytest.mark.parametrize("error", [22, 95])  # EINVAL, EOPNOTSUPP
def test_a_result_is_read_where_there_are_no_locks(saved, without_locks, error):
    program = "import sys, exunet; print(len(exunet.load_result(sys.argv[1]).time))"
    assert without_locks(error, "-c", program, saved).stdout == f"{len(exunet.load_result(saved).time)}\n"


def test_a_result_that_another_program_writes_is_not_called_damaged(saved):
    writes = "import sys, h5py; file = h5py.File(sys.argv[1], 'a'); print(flush=True); input()"
    with subprocess.Popen(
        [sys.executable, "-c", writes, saved], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as other:
        other.stdout.readline()
        with pytest.raises(InputError, match="another program is writing"):
            exunet.load_result(saved)
        other.communicate(b"\n")
    assert len(exunet.load_result(saved).time)
