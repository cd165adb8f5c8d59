"""Signals that end this process, and the processes that it starts."""

from __future__ import annotations

import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def exit_on_sigterm() -> Iterator[None]:
    """Let SIGTERM raise SystemExit in the block, unless it is ignored.

    Only a main thread may handle signals.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.getsignal(signal.SIGTERM)
    if before in (signal.SIG_IGN, None):  # None: a handler that is not of Python
        yield
        return
    signal.signal(signal.SIGTERM, lambda number, _: sys.exit(128 + number))
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


@contextmanager
def interrupts_held() -> Iterator[None]:
    """Hold Ctrl-C back for good from the processes that the block starts.

    It waits for the end of the block in this process too, where that has no other threads. A
    process of Python imports modules before it can ignore a signal: it would print a traceback.
    Windows holds nothing back.
    """
    if sys.platform == "win32":
        yield
        return
    from multiprocessing import resource_tracker  # `ffpose --help` needs none

    resource_tracker.ensure_running()  # its start lets the signal through again
    before = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def leave_interrupts_to_parent() -> None:
    """Ignore Ctrl-C in this process, and let SIGTERM end it at once, also where it is a fork."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
