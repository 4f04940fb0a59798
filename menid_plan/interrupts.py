"""Ctrl-C, SIGTERM and SIGHUP, answered at places where nothing is left half done.

An exception that a signal raises may come anywhere: between two changes that belong together, or where
a library clears whatever was raised, so that it is lost.
"""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import TracebackType
from typing import Any

_DEFAULT: dict[signal.Signals, Any] = {signal.SIGINT: signal.default_int_handler}
_DEFAULT |= {
    signal.Signals[name]: signal.SIG_DFL
    for name in ("SIGTERM", "SIGHUP")
    if name in signal.Signals.__members__
}


class Interrupts:
    """While it is entered, a signal raises KeyboardInterrupt at the next `check`, and a second at once.

    Signals that the program handles otherwise, and threads other than the main one, stay as they are.
    It may be entered again within.
    """

    def __init__(self) -> None:
        self._came = False
        self._allowed = False
        self._depth = 0
        self._before: dict[signal.Signals, Any] = {}

    def __enter__(self) -> Interrupts:
        self._depth += 1
        if threading.current_thread() is threading.main_thread():
            for each, default in _DEFAULT.items():
                if signal.getsignal(each) is default:
                    self._before[each] = signal.signal(each, self._handle)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._depth -= 1
        if self._depth == 0:
            for each, handler in self._before.items():
                signal.signal(each, handler)
            self._before.clear()

    def check(self) -> None:
        """Raise KeyboardInterrupt if a signal came."""
        if self._came:
            raise KeyboardInterrupt

    @contextmanager
    def allowed(self) -> Iterator[None]:
        """Have a signal raise at once, as where nothing changes but by what is waited for."""
        before, self._allowed = self._allowed, True
        try:
            self.check()
            yield
        finally:
            self._allowed = before

    def _handle(self, *_: object) -> None:
        at_once = self._allowed or self._came
        self._came = True
        if at_once:
            raise KeyboardInterrupt


@contextmanager
def tidied_up() -> Iterator[None]:
    """Have any signal raise KeyboardInterrupt at once, so that what was begun is tidied up."""
    with Interrupts() as interrupts, interrupts.allowed():
        yield
