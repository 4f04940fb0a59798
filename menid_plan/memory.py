"""How much memory there is, asked before a large array is made."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

from menid_plan.errors import LimitError

MEGABYTE = 1e6
SMALL = 8 * MEGABYTE  # less is not worth asking for


def available() -> float:
    """Bytes that can still be had without swapping; inf where the system does not tell.

    The least of what the system has, what its control group leaves, and the limits of the process.
    """
    found = [float("inf")]
    with suppress(OSError):
        for line in Path("/proc/meminfo").read_text(encoding="ascii").splitlines():
            if line.startswith("MemAvailable:"):
                found.append(1024.0 * int(line.split()[1]))
    with suppress(OSError, ValueError):
        group = Path("/sys/fs/cgroup")
        most = float((group / "memory.max").read_text(encoding="ascii"))
        found.append(most - float((group / "memory.current").read_text(encoding="ascii")))
    with suppress(ImportError, OSError, ValueError):
        import resource

        most = resource.getrlimit(resource.RLIMIT_AS)[0]
        if most != resource.RLIM_INFINITY:
            pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
            found.append(float(most - pages * resource.getpagesize()))
    return max(0.0, min(found))


def demand(size: float, so_far: str) -> None:
    """Raise LimitError if so many bytes cannot be had; ``so_far`` ends its message."""
    if size < SMALL:
        return
    left = available()
    if size > 0.95 * left:
        raise LimitError(
            f"this needs {size / MEGABYTE:.0f} MB more, and {left / MEGABYTE:.0f} MB can be had; "
            f"{so_far}"
        )
