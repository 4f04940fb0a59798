"""What environments print in this process: it is no result, and goes to standard error."""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Iterator


@contextlib.contextmanager
def prints_to_stderr() -> Iterator[None]:
    """Turn standard output into standard error, for Python and for libraries in C alike."""
    if sys.stdout is None or sys.stderr is None:
        yield
        return
    sys.stdout.flush()
    with contextlib.ExitStack() as opened:
        # Under a test runner, or where the caller closed them, they may be something else.
        with contextlib.suppress(OSError, ValueError):
            output, error = sys.stdout.fileno(), sys.stderr.fileno()
            if output != error:
                kept = os.dup(output)
                opened.callback(os.close, kept)
                os.dup2(error, output)
                opened.callback(os.dup2, kept, output)
        opened.enter_context(contextlib.redirect_stdout(sys.stderr))
        yield
