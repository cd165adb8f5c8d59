"""Keeping freed memory in the process, as every training step allocates the same sizes again.

glibc returns large freed blocks to the system, and the page faults of each step's temporaries then
take a third of the time of a small network's training step. With other C libraries this does
nothing.
"""

from __future__ import annotations

import ctypes
import sys

M_TRIM_THRESHOLD, M_TOP_PAD, M_MMAP_THRESHOLD = -1, -2, -3  # malloc.h
KEPT_BYTES = 2**31 - 1
PAD_BYTES = 1 << 28


def keep_freed_memory() -> bool:
    """Make malloc keep freed memory; return whether it accepted."""
    if not sys.platform.startswith("linux"):
        return False
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (OSError, AttributeError):  # another C library
        return False
    options = {M_MMAP_THRESHOLD: KEPT_BYTES, M_TRIM_THRESHOLD: KEPT_BYTES, M_TOP_PAD: PAD_BYTES}
    return all(mallopt(name, value) == 1 for name, value in options.items())
