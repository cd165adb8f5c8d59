"""Versions, instruction set, threads and installed extras, for a bug report.

Works with NumPy alone.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import re
from collections.abc import Sequence
from importlib import metadata
from typing import Any

import ffpose
from ffpose._internal.machine import package_version
from ffpose.arrays import instruction_set

_REQUIREMENT = re.compile(r"([A-Za-z0-9._-]+).*;\s*extra\s*==\s*['\"]([\w-]+)['\"]")


def collect() -> dict[str, Any]:
    """Return the facts about this installation and machine as a JSON document."""
    return {
        "ffpose": ffpose.__version__,
        "instruction_set": instruction_set(),
        "ffpose_isa": os.environ.get("FFPOSE_ISA"),
        "cores": os.cpu_count(),
        "threads": threads(),
        "python": platform.python_version(),
        "platform": platform.platform(),
        "machine": platform.machine(),
        "numpy": metadata.version("numpy"),
        "extras": extras(metadata.requires("ffpose") or []),
    }


def threads() -> int:
    """Return the number of threads that the filter uses: torch's number, or one without torch."""
    try:
        import torch
    except ModuleNotFoundError:
        return 1
    return torch.get_num_threads()


def extras(requirements: Sequence[str]) -> dict[str, dict[str, str | None]]:
    """Return the packages of each extra and their versions, None where not installed.

    Requirements are as in a package's metadata: ``torch>=2.10; extra == 'torch'``.
    """
    found: dict[str, dict[str, str | None]] = {}
    for match in filter(None, map(_REQUIREMENT.match, requirements)):
        package, extra = match.groups()
        if package != "ffpose":
            found.setdefault(extra, {})[package] = package_version(package)
    return found


def main(arguments: Sequence[str]) -> int:
    """Run ``ffpose info``; unlike the other commands its parser needs no extra."""
    parser = argparse.ArgumentParser(prog="ffpose info", description=__doc__)
    parser.add_argument("--json", action="store_true", help="print one JSON document")
    facts = collect()
    if parser.parse_args(arguments).json:
        print(json.dumps(facts, indent=2))
        return 0
    extras_found = facts.pop("extras")
    for name, value in facts.items():
        print(f"{name.replace('_', ' '):16} {'-' if value is None else value}")
    for extra, packages in extras_found.items():
        listed = ", ".join(f"{name} {version or 'missing'}" for name, version in packages.items())
        print(f"{'extra ' + extra:16} {listed}")
    return 0
