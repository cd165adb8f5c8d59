"""What a reader needs to judge the figures: versions, processor, and what it can do at most."""

from __future__ import annotations

import ctypes
import os
import platform
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch

import ffpose
from ffpose.arrays import instruction_set
from ffpose.bench.timing import Contender, time_calls

MATRIX_SIDE = 768
COPIED_FLOATS = 2**24
TRIES = 8


@dataclass(frozen=True)
class Peak:
    """The most that was measured: float32 operations of a matrix product, bytes of a copy.

    Attributes:
        threads: Of torch.
        flops: Operations a second; a multiplication and its addition are two.
        copy_bytes: Bytes a second, read and written, of 64 MiB copied to elsewhere.
    """

    threads: int
    flops: float
    copy_bytes: float


def measure_peak(threads: int) -> Peak:
    """Measure what this machine can do at most; a tenth of a second or two."""
    torch.set_num_threads(threads)
    a, b = torch.randn(2, MATRIX_SIDE, MATRIX_SIDE)
    product = torch.empty_like(a)
    x = torch.zeros(COPIED_FLOATS)
    y = torch.empty_like(x)
    return Peak(
        threads,
        flops=2 * MATRIX_SIDE**3 / _fastest(lambda: torch.mm(a, b, out=product)),
        copy_bytes=2 * x.nbytes / _fastest(lambda: y.copy_(x)),
    )


def _fastest(call: Callable[[], object]) -> float:
    return min(time_calls(Contender(call), 1) for _ in range(TRIES))


def environment() -> dict[str, Any]:
    """Versions, processor, instruction sets of both sides, and what holds them to these."""
    return {
        "ffpose": ffpose.__version__,
        "torch": torch.__version__,
        "python": platform.python_version(),
        "machine": platform.machine(),
        "processor": _processor(),
        "instruction_set": instruction_set(),
        "torch_cpu_capability": torch.backends.cpu.get_cpu_capability(),
        "mkl_enable_instructions": os.environ.get("MKL_ENABLE_INSTRUCTIONS", ""),
        "mkl_code": _mkl_code(),
        "bfloat16_instructions": bfloat16_instructions(),
        "cores": cores(),
    }


def bfloat16_instructions() -> list[str]:
    """Return those of the processor, as Linux names them; none where that cannot be told."""
    known = {"avx512_bf16", "amx_bf16", "bf16", "svebf16"}
    return sorted(known & set(_processor_fact("flags", "Features").split()))


def cores() -> int:
    """Return how many cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _mkl_code() -> str:
    """Return which code torch's MKL runs: "vectorized", on Intel's processors alone, or "baseline".

    The answer is MKL's own, or that of a preloaded library; empty where there is no MKL.
    """
    bundled = Path(torch.__file__).parent / "lib" / "libtorch_cpu.so"
    for library in (None, str(bundled)):
        with suppress(OSError, AttributeError):
            return "vectorized" if ctypes.CDLL(library).mkl_serv_intel_cpu_true() else "baseline"
    return ""


def _processor() -> str:
    return _processor_fact("model name") or platform.processor()


def _processor_fact(*names: str) -> str:
    """Return what Linux says of the first core under the first of these names that it has."""
    info = Path("/proc/cpuinfo")
    if info.exists():
        for line in info.read_text().splitlines():
            name, _, fact = line.partition(":")
            if name.strip() in names:
                return fact.strip()
    return ""
