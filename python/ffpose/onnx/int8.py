"""Static quantization of the costly operators of a graph to int8.

Convolutions and products with constant matrices on the right, in the backbone and the branches,
become int8 if they have `LEAST_WEIGHTS`: weights by channel, activations by the range that
calibration images show, after a ReLU that follows. Products write float32 where no other reads
integers. Spectral filters, normalizations, heads and the geometry of a second look stay float32; so
do products with a matrix on the left, which ONNX Runtime before 1.32 cannot scale by channel.
Written as pairs of QuantizeLinear and DequantizeLinear, which ONNX Runtime and OpenVINO fuse into
integer operators.
"""

from __future__ import annotations

import ast
import math
from collections.abc import Iterable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ffpose.errors import require
from ffpose.onnx.library import get_library_path
from ffpose.onnx.metadata import Filter

OPERATORS = ("Conv", "Gemm", "MatMul")
"""Operators that are quantized where their weight is constant."""

RELU = "Relu"
"""Operator that is fused with the convolution before it: all 8 bits are for what is positive."""

LEAST_WEIGHTS = 128
"""Size of a matrix or kernel from which integers pay for turning numbers into them."""

PARTS = ("backbone", "object_backbone", "projection", "attention", "feed_forward")
"""Words of a module's path within which operators are quantized."""

SCOPES = "pkg.torch.onnx.name_scopes"
"""Metadata of a node: the path of the module that it comes from."""


def quantize(
    graph: Path, out: Path, filter: Filter, inputs: Iterable[NDArray[np.float32]]
) -> list[str]:
    """Write the int8 form of a graph, and return the names of the nodes that were quantized.

    Nodes are to be named as by torch's exporter. Other files may be written beside ``out``
    meanwhile; ``inputs`` are calibration batches of the graph's first input, at least one.

    Raises:
        RuntimeError: No node can be quantized.
    """
    onnx, kinds = require("onnx", "export"), require("onnxruntime.quantization", "export").QuantType
    wanted = {
        node.name
        for node in onnx.load(str(graph)).graph.node
        if node.op_type in OPERATORS and set(PARTS) & set(_module_path(node))
    }
    folded = out.with_name("folded.onnx")
    _fold(graph, folded, filter)
    model = onnx.load(str(folded))
    weights = {tensor.name: tensor.dims for tensor in model.graph.initializer}
    nodes = [
        node.name
        for node in model.graph.node
        if node.name in wanted and math.prod(weights.get(node.input[1], (0,))) >= LEAST_WEIGHTS
    ]
    if not nodes:
        raise RuntimeError(
            f"int8: expected a graph with {', '.join(OPERATORS)} of {LEAST_WEIGHTS} weights or"
            " more, got none"
        )
    _separate_weights(model.graph, set(nodes))
    outputs = {node.output[0] for node in model.graph.node if node.name in nodes}
    fused = [
        node.name for node in model.graph.node if node.op_type == RELU and node.input[0] in outputs
    ]
    quantizer = require("onnxruntime.quantization.qdq_quantizer", "export").QDQQuantizer(
        model,
        per_channel=True,
        reduce_range=False,
        weight_qType=kinds.QInt8,
        activation_qType=kinds.QUInt8,
        tensors_range=_ranges(folded, out.with_name("observed.onnx"), filter, inputs),
        nodes_to_quantize=nodes + fused,
        nodes_to_exclude=[],
        op_types_to_quantize=[*OPERATORS, RELU],
        extra_options={
            "MatMulConstBOnly": True,
            "OpTypesToExcludeOutputQuantization": ["Gemm", "MatMul"],
        },
    )
    quantizer.quantize_model()
    quantizer.model.save_model_to_file(str(out))
    return nodes


def _module_path(node: Any) -> list[str]:
    """Return the words of the path of a node's module; none of a node that ffpose wrote."""
    entries = {entry.key: entry.value for entry in node.metadata_props}
    scopes = ast.literal_eval(entries.get(SCOPES, "[]"))
    return ".".join(scopes[:-1]).split(".")


def _fold(graph: Path, folded: Path, filter: Filter) -> None:
    """Write a graph with its batch norms folded into convolutions."""
    runtime = require("onnxruntime", "export")
    options = session_options(runtime, filter)
    options.graph_optimization_level = runtime.GraphOptimizationLevel.ORT_ENABLE_BASIC
    options.optimized_model_filepath = str(folded)
    runtime.InferenceSession(str(graph), options, providers=["CPUExecutionProvider"])


def _separate_weights(graph: Any, names: set[str]) -> None:
    """Give each of the named nodes of an ONNX graph weights that no other of them reads.

    Where sums of int8 products saturate (x86-64 without VNNI), ONNX Runtime writes the weight of
    every such node anew, as uint8 under a name made of its own, and fails at the second of a name.
    """
    weights = {tensor.name: tensor for tensor in graph.initializer}
    taken = set()
    for node in graph.node:
        if node.name not in names:
            continue
        for place, name in enumerate(node.input[:2]):
            if name in taken:
                copy = graph.initializer.add()
                copy.CopyFrom(weights[name])
                copy.name = node.input[place] = f"{name}_of_{node.name}"
            elif name in weights:
                taken.add(name)


def _ranges(
    graph: Path, observed: Path, filter: Filter, inputs: Iterable[NDArray[np.float32]]
) -> Any:
    """Return the ranges of the tensors about what is quantized, over all calibration batches."""
    runtime = require("onnxruntime", "export")
    calibrate = require("onnxruntime.quantization.calibrate", "export")
    calibrator = calibrate.MinMaxCalibrater(graph, [*OPERATORS, RELU], str(observed))
    calibrator.augment_graph()
    options = session_options(runtime, filter)  # the calibrator's own know no library
    options.graph_optimization_level = runtime.GraphOptimizationLevel.ORT_DISABLE_ALL
    session = runtime.InferenceSession(str(observed), options, providers=["CPUExecutionProvider"])
    calibrator.infer_session, name = session, session.get_inputs()[0].name
    batches = ({name: batch} for batch in inputs)
    calibrator.collect_data(SimpleNamespace(get_next=lambda: next(batches, None)))
    return calibrator.compute_data()


def session_options(runtime: Any, filter: Filter) -> Any:
    """Return ONNX Runtime's options for a graph, with the operator's library if it needs that."""
    options = runtime.SessionOptions()
    if filter == "custom":
        options.register_custom_ops_library(get_library_path())
    return options
