"""Inference sessions in ONNX Runtime and OpenVINO, behind one interface."""

from __future__ import annotations

import ctypes
import os
import platform
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any, Literal, Protocol, get_args
from weakref import WeakSet

from numpy.typing import NDArray

from ffpose.arrays import has_vnni
from ffpose.errors import expect, require
from ffpose.onnx.library import get_library_path
from ffpose.onnx.metadata import Filter

Runtime = Literal["onnxruntime", "openvino"]
Precision = Literal["float32", "bfloat16"]

DEFAULT_PROVIDERS = ("CPUExecutionProvider",)

_OPENED: WeakSet[Any] = WeakSet()
"""ONNX Runtime's sessions of this process."""


def _keep_in_child() -> None:
    """Keep the parent's sessions for ever: their end waits for threads that a child has not."""
    for session in _OPENED:
        ctypes.pythonapi.Py_IncRef(ctypes.py_object(session))


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_keep_in_child)


class Session(Protocol):
    """A network that is ready to run."""

    def run(self, *inputs: NDArray[Any]) -> dict[str, NDArray[Any]]:
        """Return the graph's outputs by name, for its inputs in order."""


def open_session(
    model: Path,
    filter: Filter,
    *,
    backend: Runtime = "onnxruntime",
    threads: int | None = None,
    providers: Sequence[str] | None = None,
    precision: Precision = "float32",
    data: bytes | None = None,
) -> Session:
    """Open a graph.

    Args:
        model: The ONNX file; for errors alone where its bytes are given.
        filter: How the graph computes spectral filters; the library is loaded for ``"custom"``.
        backend: ``"onnxruntime"`` or ``"openvino"``.
        threads: Number of threads within an image; None for the backend's default.
        providers: ONNX Runtime's execution providers, the first that can is taken for each node;
            None for the CPU's.
        precision: ``"float32"``, or ``"bfloat16"`` for matrix products where the CPU has
            instructions for it.
        data: Bytes of the file, where it was read already.

    Raises:
        MissingExtraError: The backend is not installed.
        ValueError: An unknown choice, or one that the backend or this CPU cannot do.
        FileNotFoundError: The library of the operator is not installed.
        RuntimeError: The backend cannot load graph or library.
    """
    expect(backend in get_args(Runtime), "backend", f"one of {get_args(Runtime)}", backend)
    known = get_args(Precision)
    expect(precision in known, "precision", f"one of {known}", precision)
    expect(threads is None or threads >= 1, "threads", "at least 1", threads)
    if backend == "onnxruntime":
        return OnnxRuntimeSession(model, filter, threads, providers, precision, data)
    if providers is not None:
        raise ValueError("providers: expected with backend 'onnxruntime', got backend 'openvino'")
    return OpenVinoSession(model, filter, threads, precision, data)


class OnnxRuntimeSession:
    """A graph in ONNX Runtime; the arguments are those of `open_session`.

    Copies and pickles are sessions of their own, opened anew from the same arguments.
    """

    def __init__(
        self,
        model: Path,
        filter: Filter,
        threads: int | None = None,
        providers: Sequence[str] | None = None,
        precision: Precision = "float32",
        data: bytes | None = None,
    ) -> None:
        self.arguments = (model, filter, threads, providers, precision, data)
        runtime = require("onnxruntime", "onnx")
        wanted = list(DEFAULT_PROVIDERS if providers is None else providers)
        known = runtime.get_available_providers()
        if not wanted or not set(wanted) <= set(known):
            raise ValueError(f"providers: expected some of {known}, got {wanted}")
        options = runtime.SessionOptions()
        if not has_vnni():  # int8 sums saturate on x86-64; no effect elsewhere
            options.add_session_config_entry("session.x64quantprecision", "1")
        if threads is not None:
            options.intra_op_num_threads = threads
        if precision == "bfloat16":
            if platform.machine() not in ("aarch64", "arm64"):
                raise ValueError(
                    "precision: expected float32, ONNX Runtime computes in bfloat16 on ARM alone;"
                    " on x86-64, backend 'openvino' does"
                )
            options.add_session_config_entry("mlas.enable_gemm_fastmath_arm64_bfloat16", "1")
        if filter == "custom":
            library = get_library_path()
            try:
                options.register_custom_ops_library(library)
            except Exception as error:  # of ONNX Runtime, whose classes share no base of their own
                raise RuntimeError(
                    f"ONNX Runtime cannot load the custom operator's library {library}, which must"
                    f" be of this architecture ({platform.machine()}): {error}"
                ) from error
        graph = str(model) if data is None else data
        try:
            self.session = runtime.InferenceSession(graph, options, providers=wanted)
        except Exception as error:  # as above
            raise RuntimeError(f"ONNX Runtime cannot load {model}: {error}") from error
        _OPENED.add(self.session)
        self.inputs = [value.name for value in self.session.get_inputs()]
        self.outputs = [output.name for output in self.session.get_outputs()]

    def __reduce__(self) -> tuple[type[OnnxRuntimeSession], tuple[Any, ...]]:
        return type(self), self.arguments

    def run(self, *inputs: NDArray[Any]) -> dict[str, NDArray[Any]]:
        """Return the graph's outputs by name, for its inputs in order."""
        results = self.session.run(self.outputs, dict(zip(self.inputs, inputs, strict=True)))
        return dict(zip(self.outputs, results, strict=True))


class OpenVinoSession:
    """A graph in OpenVINO, copied and pickled as one in ONNX Runtime."""

    def __init__(
        self,
        model: Path,
        filter: Filter,
        threads: int | None = None,
        precision: Precision = "float32",
        data: bytes | None = None,
    ) -> None:
        self.arguments = (model, filter, threads, precision, data)
        if filter == "custom":
            raise ValueError(
                f"backend: OpenVINO expected a graph of standard operators, as `ffpose export MODEL"
                f" --filter matmul --out X.onnx` writes it, got {model} with a custom operator"
            )
        core = openvino_core()
        if precision == "bfloat16" and not openvino_takes_bfloat16():
            raise ValueError("precision: expected float32, this CPU has no bfloat16 instructions")
        settings: dict[str, Any] = {
            "INFERENCE_PRECISION_HINT": "bf16" if precision == "bfloat16" else "f32",
            "PERFORMANCE_HINT": "LATENCY",
        }
        if threads is not None:
            settings["INFERENCE_NUM_THREADS"] = threads
        try:
            graph = core.read_model(str(model) if data is None else data)
            self.compiled = core.compile_model(graph, "CPU", settings)
        except RuntimeError as error:
            raise RuntimeError(
                f"OpenVINO cannot load {model}; it takes graphs of standard operators, as"
                f" `ffpose export --filter matmul` writes them: {error}"
            ) from error
        # The compiled graph's outputs bear names of what was fused into them as well.
        self.outputs = [output.any_name for output in graph.outputs]

    def __reduce__(self) -> tuple[type[OpenVinoSession], tuple[Any, ...]]:
        return type(self), self.arguments

    def run(self, *inputs: NDArray[Any]) -> dict[str, NDArray[Any]]:
        """Return the graph's outputs by name, for its inputs in order."""
        results = self.compiled.create_infer_request().infer(list(inputs), share_outputs=False)
        return {name: results[place] for place, name in enumerate(self.outputs)}


@cache
def openvino_core() -> Any:
    """Return the one OpenVINO core of the process, which lasts as long as the process.

    A core's CPU plugin sets the thread's alternate signal stack, and its end sets the one before
    and unmaps its own: of two cores that end in the order in which they began, the second sets an
    unmapped stack, and the next signal, such as a DataLoader's SIGCHLD, is a segmentation fault.
    """
    return require("openvino", "openvino").Core()


def openvino_takes_bfloat16() -> bool:
    """Return whether this CPU has instructions with which OpenVINO multiplies in bfloat16."""
    return "BF16" in openvino_core().get_property("CPU", "OPTIMIZATION_CAPABILITIES")
