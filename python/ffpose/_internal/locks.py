"""Locks that work in forked processes."""

from __future__ import annotations

import os
import threading


def fork_safe_lock() -> threading.Lock:
    """Return a lock that is free in a forked child, which lacks the thread that may hold it.

    Others stay held there for good.
    """
    lock = threading.Lock()
    if hasattr(os, "register_at_fork"):
        # As Python's own concurrent.futures does.
        os.register_at_fork(after_in_child=lock._at_fork_reinit)  # type: ignore[attr-defined]
    return lock
