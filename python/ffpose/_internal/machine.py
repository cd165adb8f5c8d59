"""Facts about this machine and what is installed on it, as context of results."""

from __future__ import annotations

import os
import platform
import sys
from importlib import metadata
from pathlib import Path

NOT_INSTALLED = "not installed"


def package_version(package: str) -> str | None:
    """Return the version of a package, without importing it; None if it is not installed."""
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return None


def package_versions(*packages: str) -> dict[str, str]:
    """Return the version of each package; `NOT_INSTALLED` for one that is not."""
    return {package: package_version(package) or NOT_INSTALLED for package in packages}


def cores() -> int:
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def worker_processes(asked: int, pieces: int) -> int:
    """Return how many worker processes to start for so many pieces of work.

    Python waits for at most 61 on Windows; more would be an error there.
    """
    most = 61 if sys.platform == "win32" else asked
    return min(asked, pieces, most)


def processor() -> str:
    """Return the processor's name; empty where unknown."""
    return processor_fact("model name") or platform.processor()


def processor_fact(*names: str) -> str:
    """Return the first of these entries that Linux has for the first core."""
    info = Path("/proc/cpuinfo")
    if info.exists():
        for line in info.read_text(encoding="utf-8").splitlines():
            name, _, fact = line.partition(":")
            if name.strip() in names:
                return fact.strip()
    return ""
