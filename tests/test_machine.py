"""Memory and disk space available to a run: control groups of both versions, the override, unknown sizes."""

from pathlib import Path
from types import SimpleNamespace

import pytest

from exunet.base import machine
from exunet.base.errors import InputError
from exunet.base.machine import disk_left, memory_left

MEBI = 1 << 20


def group(folder, version, limit, used, cached=0):
    """Files of a control group, sizes in MiB."""
    if version == 2:
        limits, prefix = ("memory.max", "memory.current"), ""
    else:
        limits, prefix = ("memory.limit_in_bytes", "memory.usage_in_bytes"), "total_"
    folder.mkdir(parents=True, exist_ok=True)
    for name, value in zip(limits, (limit, used), strict=True):
        (folder / name).write_text(f"{value if value == 'max' else value * MEBI}\n")
    stat = {"anon": used - cached, f"{prefix}inactive_file": cached, "inactive_file_of_others": 7}
    (folder / "memory.stat").write_text("".join(f"{name} {size * MEBI}\n" for name, size in stat.items()))


@pytest.fixture
def system(tmp_path, monkeypatch):
    """A machine of 8 GiB: /proc and /sys/fs/cgroup without any control group."""
    monkeypatch.delenv("EXUNET_MEMORY", raising=False)
    proc, groups = tmp_path / "proc", tmp_path / "cgroup"
    (proc / "self").mkdir(parents=True)
    (proc / "meminfo").write_text(f"MemTotal: 1 kB\nMemAvailable: {8 << 20} kB\n")
    monkeypatch.setattr(machine, "_PROC", proc)
    monkeypatch.setattr(machine, "_CGROUP", groups)
    return SimpleNamespace(groups=groups, member_of=(proc / "self" / "cgroup").write_text)


def test_this_machine_reports_memory_and_disk(tmp_path):
    assert (disk_left(tmp_path / "not" / "yet") or 0) > MEBI
    assert (memory_left() or 0) > MEBI


def test_without_control_groups_the_machine_counts(system):
    assert memory_left() == 8192 * MEBI
    system.member_of("0::/user.slice/absent\n")
    assert memory_left() == 8192 * MEBI


def test_cached_files_of_a_container_are_free(system):
    group(system.groups, 2, limit=1000, used=990, cached=600)
    assert memory_left() == 610 * MEBI


def test_the_narrowest_of_nested_groups_counts(system):
    system.member_of("0::/slurm/job/step\n")
    group(system.groups / "slurm" / "job" / "step", 2, limit="max", used=50)
    group(system.groups / "slurm" / "job", 2, limit=500, used=100)
    group(system.groups / "slurm", 2, limit=4000, used=100)
    assert memory_left() == 400 * MEBI
    group(system.groups / "slurm", 2, limit=4000, used=3900)
    assert memory_left() == 100 * MEBI


@pytest.mark.parametrize("path", ["/docker/1f", "/"])
def test_limits_of_version_1(system, path):
    """In a container the path is that of the host, and the mount shows the container's own group."""
    system.member_of(f"5:memory:{path}\n4:cpu:/elsewhere\n")
    group(system.groups / "memory", 1, limit=1000, used=900, cached=250)
    assert memory_left() == 350 * MEBI


def test_a_used_up_group_has_nothing_left(system):
    group(system.groups, 2, limit=100, used=120)
    assert memory_left() == 0


def test_the_variable_replaces_what_the_system_reports(system, monkeypatch):
    group(system.groups, 2, limit=100, used=100)
    monkeypatch.setenv("EXUNET_MEMORY", "2e9")
    assert memory_left() == 2 * 10**9
    monkeypatch.setenv("EXUNET_MEMORY", "inf")
    assert memory_left() is None


@pytest.mark.parametrize("text", ["much", "0", "-1", "nan"])
def test_a_wrong_value_of_the_variable_is_refused(monkeypatch, text):
    monkeypatch.setenv("EXUNET_MEMORY", text)
    with pytest.raises(InputError, match="EXUNET_MEMORY"):
        memory_left()


def test_a_disk_of_size_0_is_unknown(monkeypatch):
    monkeypatch.setattr(machine.shutil, "disk_usage", lambda _: SimpleNamespace(total=0, used=0, free=0))
    assert disk_left(Path()) is None
