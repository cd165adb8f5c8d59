"""Versions, processor and measured peak performance, as the context of a benchmark."""

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
from benchmarks.timing import Contender, time_calls
from ffpose._internal.machine import cores, package_versions, processor, processor_fact
from ffpose.arrays import instruction_set

MATRIX_SIDE = 768
COPIED_FLOATS = 2**24
TRIES = 8


def bfloat16_instructions() -> list[str]:
    """Return the processor's bfloat16 instructions as named by Linux; empty where unknown."""
    known = {"avx512_bf16", "amx_bf16", "bf16", "svebf16"}
    return sorted(known & set(processor_fact("flags", "Features").split()))


@dataclass(frozen=True)
class Peak:
    """Measured peak performance: float32 matrix product, and memory copy.

    Attributes:
        threads: Number of torch's threads.
        flops: Operations per second; a multiply-add counts as two.
        copy_bytes: Bytes read and written per second in a copy of 64 MiB.
    """

    threads: int
    flops: float
    copy_bytes: float


def measure_peak(threads: int) -> Peak:
    """Measure the peak performance of this machine, in one or two tenths of a second."""
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
    """Return versions, processor, instruction sets of both sides, and variables that limit them."""
    return {
        "ffpose": ffpose.__version__,
        "torch": torch.__version__,
        **package_versions("onnxruntime", "openvino"),
        "python": platform.python_version(),
        "machine": platform.machine(),
        "processor": processor(),
        "instruction_set": instruction_set(),
        "torch_cpu_capability": torch.backends.cpu.get_cpu_capability(),
        "mkl_enable_instructions": os.environ.get("MKL_ENABLE_INSTRUCTIONS", ""),
        "mkl_code": _mkl_code(),
        "bfloat16_instructions": bfloat16_instructions(),
        "cores": cores(),
    }


def _mkl_code() -> str:
    """Return MKL's code path in torch: "vectorized" (Intel processors only) or "baseline".

    The answer comes from MKL itself, or from a preloaded library; empty without MKL.
    """
    bundled = Path(torch.__file__).parent / "lib" / "libtorch_cpu.so"
    for library in (None, str(bundled)):
        with suppress(OSError, AttributeError):
            return "vectorized" if ctypes.CDLL(library).mkl_serv_intel_cpu_true() else "baseline"
    return ""
