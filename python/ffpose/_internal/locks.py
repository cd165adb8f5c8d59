"""A lock that works in forked processes."""

from __future__ import annotations

import os
import threading


class Lock:
    """Lock of a ``with`` block, free in a forked child, which lacks the thread that may hold it.

    `threading.Lock` stays held there for good.
    """

    def __init__(self) -> None:
        self._renew()
        if hasattr(os, "register_at_fork"):
            os.register_at_fork(after_in_child=self._renew)

    def _renew(self) -> None:
        self._lock = threading.Lock()

    def __enter__(self) -> None:
        self._lock.acquire()

    def __exit__(self, *_: object) -> None:
        self._lock.release()
