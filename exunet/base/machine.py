"""Versions of what is installed; memory and disk space available to a run."""

from __future__ import annotations

import math
import os
import shutil
from contextlib import suppress
from functools import cache
from pathlib import Path

from exunet.base.errors import InputError


@cache  # finding it takes a millisecond, which each new simulation would spend
def installed_version(package: str) -> str:
    """Return the version of an installed package."""
    from importlib.metadata import version

    return version(package)


MEMORY_VARIABLE = "EXUNET_MEMORY"  # environment variable: bytes available to a run, as 8e9; inf for no limit

_PROC = Path("/proc")
_CGROUP = Path("/sys/fs/cgroup")
_HIERARCHIES = ("", "unified", "memory")  # version 2, version 2 beside version 1, version 1
_LIMITS = (  # of either version: files of the limit and of the usage, beginning of the names in memory.stat
    ("memory.max", "memory.current", ""),
    ("memory.limit_in_bytes", "memory.usage_in_bytes", "total_"),
)


def memory_left() -> int | None:
    """Return the bytes of memory that a program can obtain without swapping, or None if unknown.

    This is the least of the machine's memory and what each control group of the process (container, batch
    job, service) and each group around it allows. The environment variable EXUNET_MEMORY replaces both.

    Raises
    ------
    InputError
        If EXUNET_MEMORY is not a positive number.
    """
    if chosen := os.environ.get(MEMORY_VARIABLE):
        return _chosen_memory(chosen)
    available = _group_memory()
    with suppress(OSError, ValueError, IndexError, StopIteration):
        lines = (_PROC / "meminfo").read_text(encoding="ascii").splitlines()
        available.append(
            next(int(line.split()[1]) << 10 for line in lines if line.startswith("MemAvailable:"))
        )
    if not available:
        with suppress(AttributeError, OSError, ValueError):  # macOS: total memory
            available.append(os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"))
    return max(0, min(available)) if available else None


def disk_left(folder: Path) -> int | None:
    """Return the bytes that can be written into a folder, existing or not, or None if unknown."""
    existing = next((path for path in (folder, *folder.resolve().parents) if path.is_dir()), None)
    with suppress(OSError):
        usage = shutil.disk_usage(existing) if existing is not None else None
        return usage.free if usage and usage.total else None  # some mounts report a size of 0
    return None


def _chosen_memory(text: str) -> int | None:
    with suppress(ValueError):
        if (memory := float(text)) > 0.0:
            return int(memory) if math.isfinite(memory) else None
    raise InputError(f"{MEMORY_VARIABLE}: must be a positive number of bytes, or inf, got {text!r}")


def _group_memory() -> list[int]:
    """Return the bytes left in each control group of this process, or around it, that limits memory."""
    groups = {Path()}
    with suppress(OSError):
        for line in (_PROC / "self" / "cgroup").read_text(encoding="utf-8").splitlines():
            path = Path(line.split(":", 2)[2].lstrip("/"))
            groups.update((path, *path.parents))
    available = []
    for folder in (_CGROUP / hierarchy / group for hierarchy in _HIERARCHIES for group in groups):
        for limit, usage, prefix in _LIMITS:
            with suppress(OSError, ValueError):  # no such group, or "max": no limit
                bound = int((folder / limit).read_text(encoding="ascii"))
                used = int((folder / usage).read_text(encoding="ascii"))
                available.append(bound - used + _file_cache(folder, prefix))
    return available


def _file_cache(group: Path, prefix: str) -> int:
    """Return the bytes of cached files in a control group: part of its usage that can be freed."""
    names = {f"{prefix}inactive_file", f"{prefix}active_file"}
    with suppress(OSError, ValueError):
        lines = (group / "memory.stat").read_text(encoding="ascii").splitlines()
        return sum(int(value) for name, value in map(str.split, lines) if name in names)
    return 0
