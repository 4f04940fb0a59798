"""Processes that end when the one that started them does.

On Linux the kernel sees to it, whatever the process is busy with. Elsewhere a process learns it from
the end of its standard input. This file is also run as a program, which asks the kernel for that
and becomes another program: `python orphans.py PARENT PROGRAM [ARGUMENT...]`.
"""

import os
import sys

_PR_SET_PDEATHSIG = 1
_SIGKILL = 9


def die_with_parent(parent: int) -> None:
    """Have this process killed when its parent (a process id) ends. Does nothing but on Linux.

    Strictly it is the thread that ends which started this process.
    """
    if not sys.platform.startswith("linux"):
        return
    import ctypes

    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, _SIGKILL, 0, 0, 0)
    if os.getppid() != parent:  # it ended before the kernel knew
        os._exit(1)


def wrapped(command: list[str]) -> list[str]:
    """A command whose program dies with this process, where the kernel can do that."""
    if not sys.platform.startswith("linux") or not sys.executable:
        return command
    return [sys.executable, "-I", "-S", __file__, str(os.getpid()), *command]


if __name__ == "__main__":
    die_with_parent(int(sys.argv[1]))
    try:
        os.execvp(sys.argv[2], sys.argv[2:])  # noqa: S606
    except OSError as error:
        sys.exit(f"{sys.argv[2]}: {error.strerror}")
