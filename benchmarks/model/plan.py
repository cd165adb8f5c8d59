"""Plan of `python -m benchmarks model NETWORK`: contenders, batches, threads, and times."""

from __future__ import annotations

import importlib.util
import os
import shutil
from collections.abc import Sequence
from dataclasses import dataclass

from benchmarks.machine import bfloat16_instructions
from benchmarks.model.contenders import (
    COMPILED,
    COMPILED_ALONE,
    CUSTOM,
    DFT,
    INT8,
    MATMUL,
    OPENVINO,
    OPENVINO_BFLOAT16,
    PLAIN,
    TORCH,
    TORCH_ALONE,
    TORCH_AUTOCAST,
    TORCH_BEFORE,
    TORCH_BFLOAT16,
    WITHOUT,
)
from benchmarks.model.subjects import Subject
from ffpose._internal.machine import cores
from ffpose.onnx.backends import openvino_takes_bfloat16
from ffpose.onnx.library import get_library_path

BATCHES = (1, 8)


@dataclass(frozen=True)
class DeploymentPlan:
    """Plan of a deployment's benchmark.

    Attributes:
        names: Contenders, the baseline first.
        batches: Images a batch.
        threads: Numbers of threads.
        seconds: Time for each contender of a case, on average.
        starts: New processes of each contender.
        notes: For the reader, on what is left out or unusual.
    """

    names: Sequence[str]
    batches: Sequence[int]
    threads: Sequence[int]
    seconds: float
    starts: int
    notes: Sequence[str]


def make_plan(
    measured: Subject,
    quick: bool,
    batches: Sequence[int] | None = None,
    threads: Sequence[int] | None = None,
) -> DeploymentPlan:
    """Plan a benchmark of a network; what cannot be measured here becomes a note.

    Args:
        measured: The network.
        quick: Batch 1, one thread, the contenders that start fast, and short timings.
        batches: In place of 1 and 8.
        threads: In place of 1, 2 and all cores.
    """
    names, notes = _in_torch(measured)
    for found, remarks in (
        _compiled(measured, quick),
        _in_runtimes(measured, quick),
        _in_openvino(),
    ):
        names += found
        notes += remarks
    if quick:
        notes.append("quick: short timings")
        return DeploymentPlan(names, batches or (1,), threads or (1,), 0.5, 1, notes)
    if cores() == 1 and threads is None:
        notes.append("one core: two threads are not measured")
    counts = threads or tuple(sorted({1, min(2, cores()), cores()}))
    return DeploymentPlan(names, batches or BATCHES, counts, 10.0, 5, notes)


def _in_torch(measured: Subject) -> tuple[list[str], list[str]]:
    """Return the baseline first, then others; half precision for networks that give no pose."""
    if measured.weights is not None:
        alone = [TORCH_ALONE] if measured.has_filters else []
        return [*alone, TORCH, *([TORCH_BEFORE] if measured.has_attention else [])], []
    notes = []
    if not bfloat16_instructions():
        notes.append("torch, bfloat16: this processor has no instructions for it, torch emulates")
    return [TORCH_ALONE, TORCH, TORCH_AUTOCAST, TORCH_BFLOAT16], notes


def _compiled(measured: Subject, quick: bool) -> tuple[list[str], list[str]]:
    if quick:
        return [], [f"{COMPILED} is not measured: it takes too long to compile"]
    if shutil.which(os.environ.get("CXX", "g++")) is None:
        return [], [f"{COMPILED} is not measured: it needs a C++ compiler, and g++ is not found"]
    return [COMPILED, *([COMPILED_ALONE] if measured.has_filters else [])], []


def _in_runtimes(measured: Subject, quick: bool) -> tuple[list[str], list[str]]:
    if importlib.util.find_spec("onnxruntime") is None:
        return [], ["ONNX Runtime is not measured: it is not installed"]
    # The parts of a pose network that are quantized are known by their names.
    int8 = [INT8] if measured.weights is not None else []
    if not measured.has_filters:
        return [PLAIN, *int8], [
            "this network has no spectral filter: its graph is standard operators"
        ]
    try:
        get_library_path()
    except FileNotFoundError as error:
        return [MATMUL, WITHOUT], [f"{CUSTOM} is not measured: {error}"]
    if quick:
        return [CUSTOM, MATMUL, WITHOUT, *int8], [
            f"{DFT} is not measured: it takes a second export"
        ]
    return [CUSTOM, MATMUL, DFT, WITHOUT, *int8], []


def _in_openvino() -> tuple[list[str], list[str]]:
    if importlib.util.find_spec("openvino") is None:
        return [], [f"{OPENVINO} is not measured: it is not installed"]
    if openvino_takes_bfloat16():
        return [OPENVINO, OPENVINO_BFLOAT16], []
    return [OPENVINO], [f"{OPENVINO_BFLOAT16} is not measured: this CPU has no instructions for it"]
