"""What the machine has left for a run: memory and disk."""

from __future__ import annotations

import os
import shutil
from contextlib import suppress
from pathlib import Path

_CGROUP = Path("/sys/fs/cgroup")


def memory_left() -> int | None:
    """Bytes of memory that a program can still get without swapping; None where the system does not say."""
    found = []
    with suppress(OSError, ValueError, IndexError):
        lines = Path("/proc/meminfo").read_text(encoding="ascii").splitlines()
        found.append(next(int(line.split()[1]) << 10 for line in lines if line.startswith("MemAvailable:")))
    with suppress(OSError, ValueError):  # of a container
        limit = int((_CGROUP / "memory.max").read_text(encoding="ascii"))
        found.append(limit - int((_CGROUP / "memory.current").read_text(encoding="ascii")))
    if not found:
        with suppress(AttributeError, OSError, ValueError):  # macOS, of all memory
            found.append(os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"))
    return max(0, min(found)) if found else None


def disk_left(folder: Path) -> int | None:
    """Bytes that can be written into a folder, or where it will be; None where the system does not say."""
    there = next((one for one in (folder, *folder.resolve().parents) if one.is_dir()), None)
    with suppress(OSError):
        return shutil.disk_usage(there).free if there is not None else None
    return None
