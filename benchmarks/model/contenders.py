"""The contenders of a deployment: one network in torch and in the runtimes that take its graph.

A graph has its filters computed in different ways, or left out.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from benchmarks.model.networks import (
    BEFORE,
    BuiltInAttention,
    PlainAttention,
    with_attention,
    with_torch_fft,
)
from benchmarks.model.subjects import Subject
from ffpose.errors import require
from ffpose.onnx.backends import open_session
from ffpose.onnx.exporter import FilterChoice, record, relative_differences, serialized, tensors_of
from ffpose.onnx.int8 import quantize
from ffpose.onnx.metadata import Filter
from ffpose.onnx.nodes import nodes_of
from ffpose.onnx.operators import DOMAIN, SPECTRAL_FILTER
from ffpose.onnx.pose_graph import pose_differences

TORCH = "torch"
TORCH_BEFORE = f"torch, {BEFORE}"
TORCH_ALONE = "torch alone"
"""Filters by ``torch.fft``, attention by `scaled_dot_product_attention`: nothing is ffpose's."""
TORCH_AUTOCAST = "torch, bfloat16 autocast"
TORCH_BFLOAT16 = "torch, bfloat16"
COMPILED = "torch.compile"
COMPILED_ALONE = "torch.compile, torch alone"
CUSTOM = "ONNX Runtime, custom operator"
MATMUL = "ONNX Runtime, matmul"
DFT = "ONNX Runtime, torch's DFT export"
WITHOUT = "ONNX Runtime, without filters"
PLAIN = "ONNX Runtime"
INT8 = "ONNX Runtime, int8"
OPENVINO = "OpenVINO"
OPENVINO_BFLOAT16 = "OpenVINO, bfloat16"

GRAPH_OF: Mapping[str, GraphKind] = {
    CUSTOM: "custom",
    PLAIN: "custom",
    MATMUL: "matmul",
    DFT: "dft",
    WITHOUT: "without",
    INT8: "int8",
    OPENVINO: "matmul",
    OPENVINO_BFLOAT16: "matmul",
}
"""The graph that a contender runs; the others run the module."""

LESS_PRECISE = (TORCH_AUTOCAST, TORCH_BFLOAT16, OPENVINO_BFLOAT16, INT8)
APART = 1e-3
"""Largest difference of float32 contenders that counts as rounding; `ffpose export` asks for less
on batches of its own."""

Outputs = Mapping[str, NDArray[Any]]
Call = Callable[[], Outputs]


def contenders(
    subject: Subject,
    graphs: Mapping[GraphKind, Graph],
    names: Sequence[str],
    batch: int,
    threads: int,
) -> dict[str, Call]:
    """Return the calls of the contenders, each from the same images to outputs by name.

    torch's number of threads is the caller's to set.
    """
    images = subject.images(batch)
    return {
        name: _in_runtime(name, graphs[GRAPH_OF[name]], images, threads)
        if name in GRAPH_OF
        else _in_torch(name, subject, images)
        for name in names
    }


def _in_runtime(name: str, graph: Graph, images: Tensor, threads: int) -> Call:
    session = open_session(
        graph.path,
        graph.filter,
        backend="openvino" if name in (OPENVINO, OPENVINO_BFLOAT16) else "onnxruntime",
        threads=threads,
        precision="bfloat16" if name == OPENVINO_BFLOAT16 else "float32",
    )
    array = images.numpy()
    return lambda: session.run(array)


def _in_torch(name: str, subject: Subject, images: Tensor) -> Call:
    model: Any = _module(name, subject.model)
    if name == TORCH_BFLOAT16:
        images = images.bfloat16()

    def call() -> Outputs:
        autocast = torch.autocast("cpu", torch.bfloat16, enabled=name == TORCH_AUTOCAST)
        with torch.inference_mode(), autocast:
            leaves = tensors_of(model(images))
        arrays = (leaf.float().numpy() for leaf in leaves)
        return dict(zip(subject.outputs, arrays, strict=True))

    return call


def _module(name: str, model: nn.Module) -> Any:
    match name:
        case _ if name == TORCH_BEFORE:
            return with_attention(model, BuiltInAttention)
        case _ if name == TORCH_ALONE:
            return torch_alone(model)
        case _ if name == TORCH_BFLOAT16:
            return copy.deepcopy(model).bfloat16()
        case _ if name == COMPILED:
            return torch.compile(copy.deepcopy(model), dynamic=False)
        case _ if name == COMPILED_ALONE:
            return torch.compile(torch_alone(model), dynamic=False)
        case _:
            return model


def torch_alone(model: nn.Module) -> nn.Module:
    """Return a copy of ``model`` as a user of torch would write it."""
    return with_attention(with_torch_fft(model), PlainAttention)


def differences(
    calls: Mapping[str, Call], baseline: str, doubt_sigma: tuple[float, float] = (0.0, 0.0)
) -> dict[str, float | None]:
    """Return each contender's largest difference of outputs from the baseline's.

    Meters of translations and quaternions of one sign; relative to the largest number otherwise.
    None for the contender without filters, which computes something else. ``doubt_sigma`` is as in
    `ffpose.onnx.pose_graph.pose_differences`.

    Raises:
        RuntimeError: A float32 contender differs by more than `APART`, or gives NaN.
    """
    expected = calls[baseline]()
    found: dict[str, float | None] = {}
    for name, call in calls.items():
        if name == WITHOUT:
            found[name] = None
            continue
        got = _named(call(), expected)
        if "orientation" in expected:
            apart = pose_differences(got, expected, doubt_sigma)
        else:
            apart = relative_differences(got, expected)
        found[name] = largest = float(np.max([*apart.values()]))
        if not largest <= (np.inf if name in LESS_PRECISE else APART):
            raise RuntimeError(f"the outputs by {name} differ from {baseline}'s by {largest:.1e}")
    return found


def _named(outputs: Outputs, like: Outputs) -> Outputs:
    return dict(zip(like, outputs.values(), strict=True))


GraphKind = Literal["custom", "matmul", "dft", "without", "int8"]
"""``"custom"`` and ``"matmul"`` are `ffpose.onnx.export`'s; ``"dft"`` is what torch's own exporter
makes of ``torch.fft``; ``"without"`` has its filters left out, and computes something else;
``"int8"`` is ``"custom"`` quantized, calibrated with the images that it is recorded with."""


@dataclass(frozen=True)
class Graph:
    """An ONNX file, and how it computes spectral filters."""

    path: Path
    filter: Filter


def write_graphs(
    model: nn.Module,
    images: Tensor,
    folder: Path,
    kinds: Sequence[GraphKind],
    *,
    entries: Callable[[Filter], Mapping[str, str]] = lambda _: {},
    output_names: Sequence[str] | None = None,
) -> dict[GraphKind, Graph]:
    """Write the graphs of a network, each kind of operators recorded once.

    Args:
        model: In evaluation mode.
        images: A batch of more than one, to record with.
        folder: Where the files are written.
        kinds: Kinds of the graphs; ``"int8"`` needs ``"custom"``.
        entries: Gives a file's metadata, for how the graph computes its filters.
        output_names: Of the graph's outputs, in order.
    """
    ir = require("onnx_ir", "export")
    recorded: dict[FilterChoice, Any] = {}
    graphs: dict[GraphKind, Graph] = {}
    for kind in (kind for kind in kinds if kind != "int8"):
        choice: FilterChoice = "matmul" if kind == "matmul" else "custom"
        if kind == "dft":
            graph = record(with_torch_fft(model), (images,), output_names=output_names)
        else:
            if choice not in recorded:
                network = record(model, (images,), None, output_names, choice)
                recorded[choice] = ir.to_proto(network)
            graph = ir.from_proto(recorded[choice])
        if kind == "without":
            leave_out_filters(graph)
        data, filter = serialized(graph, choice, entries)
        path = folder / f"{kind}.onnx"
        path.write_bytes(data)
        graphs[kind] = Graph(path, filter)
    if "int8" in kinds:
        source, path = graphs["custom"], folder / "int8.onnx"
        quantize(source.path, path, source.filter, [images.numpy()])
        graphs["int8"] = Graph(path, source.filter)
    return graphs


def leave_out_filters(model: Any) -> None:
    """Put Identity in the place of every filter of an `onnx_ir.Model`."""
    ir = require("onnx_ir", "export")
    for node in nodes_of(model, DOMAIN, SPECTRAL_FILTER):
        x, weight = node.inputs
        identity = ir.node("Identity", [x])
        output = identity.outputs[0]
        output.name, output.dtype = f"{node.outputs[0].name}/unfiltered", node.outputs[0].dtype
        ir.convenience.replace_nodes_and_values(
            model.graph, node, [node], [identity], node.outputs, [output]
        )
        if not weight.uses():
            model.graph.initializers.pop(weight.name)
