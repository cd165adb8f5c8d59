"""Facts about this machine and what is installed on it, as context of results; its processes."""

from __future__ import annotations

import os
import platform
import sys
from collections.abc import Iterator
from contextlib import contextmanager
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


@contextmanager
def environment(**values: str) -> Iterator[None]:
    """Set variables of this process's environment for as long as the block runs."""
    before = {name: os.environ.get(name) for name in values}
    os.environ.update(values)
    try:
        yield
    finally:
        for name, value in before.items():
            os.environ.pop(name, None)
            if value is not None:
                os.environ[name] = value


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
