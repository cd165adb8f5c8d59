"""Child processes, each measuring with one instruction set and one allocator setting."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import IO, Any

from benchmarks.filter.worker import Measurement, Request
from benchmarks.machine import Peak

ROOT = Path(__file__).parents[2]
"""The folder of the sources, where ``python -m benchmarks`` is found."""

ALLOCATORS: Mapping[str, Mapping[str, str]] = {
    "default": {},
    # The C library then keeps freed memory. torch's temporaries are sometimes faster that way, as
    # they cause no page faults, and sometimes slower; each side gets the better of both settings.
    "kept": {"MALLOC_MMAP_THRESHOLD_": "2000000000", "MALLOC_TRIM_THRESHOLD_": "4000000000"},
}

RIVALS_HELD: Mapping[str, Mapping[str, str]] = {
    "avx2": {"MKL_ENABLE_INSTRUCTIONS": "AVX2", "ATEN_CPU_CAPABILITY": "avx2"},
}
"""Environment variables that limit torch to an instruction set; "scalar" has none, so torch is not
limited there."""


@dataclass(frozen=True)
class Setting:
    """Settings of a whole process: our instruction set, and a key of `ALLOCATORS`."""

    isa: str
    allocator: str

    def variables(self) -> dict[str, str]:
        """Return the environment variables of the setting."""
        held = RIVALS_HELD.get(self.isa, {})
        return {"FFPOSE_ISA": self.isa, **held, **ALLOCATORS[self.allocator]}


@dataclass(frozen=True)
class Opening:
    """First message of a child: its setting, environment and peaks."""

    setting: Setting
    environment: Mapping[str, Any]
    peaks: tuple[Peak, ...]


def run_child(setting: Setting, request: Request, caches: str) -> Iterator[Opening | Measurement]:
    """Start a child and yield its messages: one `Opening`, then each `Measurement`.

    Args:
        setting: Setting of the child.
        request: Cases to measure.
        caches: Cache folder of torch.compile, so that each kernel is compiled once.

    Raises:
        RuntimeError: The child failed; the message holds its last line of output.
    """
    variables = {**os.environ, **setting.variables(), "TORCHINDUCTOR_CACHE_DIR": caches}
    with tempfile.TemporaryFile("w+") as errors, _started(variables, errors) as child:
        assert child.stdin is not None
        assert child.stdout is not None
        with suppress(BrokenPipeError), child.stdin as stdin:  # a dead child is reported below
            json.dump(asdict(request), stdin)
        lines = map(json.loads, child.stdout)
        for opening in lines:
            peaks = tuple(Peak(**peak) for peak in opening["peaks"])
            yield Opening(setting, opening["environment"], peaks)
            break
        yield from map(Measurement.from_json, lines)
        if child.wait() != 0:
            errors.seek(0)
            last = (errors.read().strip().splitlines() or ["no message"])[-1]
            words = f"{setting.isa}, allocator {setting.allocator}"
            raise RuntimeError(f"the measuring process ({words}) failed: {last}")


@contextmanager
def _started(variables: dict[str, str], errors: IO[str]) -> Iterator[subprocess.Popen[str]]:
    """Start a worker, and terminate it at the end of the block."""
    with subprocess.Popen(
        [sys.executable, "-m", "benchmarks.filter.worker"],
        env=variables,
        cwd=ROOT,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=errors,
        text=True,
    ) as child:
        try:
            yield child
        finally:
            child.kill()
