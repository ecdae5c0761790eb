"""Ctrl-C while something is trained in several parts, so that none of them is lost."""

from __future__ import annotations

import signal
import threading

INTERRUPTED = "interrupted"


class CtrlC:
    """Within ``with CtrlC() as ctrl_c:`` the first Ctrl-C stops nothing by itself: ``ctrl_c.came`` tells of it.

    Searches look at it between two evaluations and end with their best so far; what makes a block of that goes on to
    its end. A second Ctrl-C is raised as ever. Outside the main thread, where Python hears no signals, and where
    somebody else handles them, nothing changes.
    """

    def __init__(self):
        self.came = False
        self._hears = False

    def __enter__(self) -> CtrlC:
        in_main = threading.current_thread() is threading.main_thread()
        self._hears = in_main and signal.getsignal(signal.SIGINT) is signal.default_int_handler
        if self._hears:
            signal.signal(signal.SIGINT, self._noted)
        return self

    def __exit__(self, *_) -> None:
        if self._hears:
            signal.signal(signal.SIGINT, signal.default_int_handler)

    def _noted(self, *_) -> None:
        if self.came:
            raise KeyboardInterrupt
        self.came = True
