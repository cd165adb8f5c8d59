"""Attention in a graph: one operator of ONNX Runtime, or standard operators.

torch's exporter writes ``scaled_dot_product_attention`` as products whose scores, of all pairs of
tokens, go through memory. ``com.microsoft::MultiHeadAttention`` computes them in blocks that stay
in the cache (flash attention; Dao et al., NeurIPS 2022).
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ffpose.errors import require
from ffpose.onnx.nodes import Nodes, nodes_of, script_op

DOMAIN = "com.microsoft"
ATTENTION = "MultiHeadAttention"


def translate_attention(
    query: Any,
    key: Any,
    value: Any,
    attn_mask: Any = None,
    dropout_p: float = 0.0,
    is_causal: bool = False,
    scale: float | None = None,
    enable_gqa: bool = False,
) -> Any:
    """Write ``scaled_dot_product_attention`` in onnxscript; torch's way what the operator cannot.

    That is a mask, another number of heads for keys, or another type than float32.
    """
    script = require("onnxscript", "export")
    known = len(query.shape) == 4 and all(isinstance(query.shape[axis], int) for axis in (1, 3))
    plain = attn_mask is None and not (dropout_p or is_causal or enable_gqa)
    alike = known and query.shape[1] == key.shape[1] == value.shape[1]
    if not (plain and alike and query.dtype == script.ir.DataType.FLOAT):
        torch_lib = require("onnxscript.function_libs.torch_lib.ops.nn", "export")
        return torch_lib.aten_scaled_dot_product_attention(
            query, key, value, attn_mask, dropout_p, is_causal, scale, enable_gqa
        )
    op = script.opset18
    heads, channels = query.shape[1], value.shape[3]
    tokens = [
        op.Reshape(op.Transpose(part, perm=[0, 2, 1, 3]), op.Constant(value_ints=[0, 0, -1]))
        for part in (query, key, value)
    ]
    names, kinds = ("query", "key", "value"), (("query", ("float",)),)
    settings = (("num_heads", "INT"), ("scale", "FLOAT"))
    attention = script_op(ATTENTION, DOMAIN, names, kinds, settings)
    scale = 1 / math.sqrt(query.shape[3]) if scale is None else scale
    mixed = attention(*tokens, num_heads=heads, scale=scale)
    shape = op.Constant(value_ints=[0, 0, heads, channels])
    return op.Transpose(op.Reshape(mixed, shape), perm=[0, 2, 1, 3])


def replace_attention(model: Any) -> None:
    """Replace every ``com.microsoft::MultiHeadAttention`` by standard operators, in place."""
    for node in nodes_of(model, DOMAIN, ATTENTION):
        heads = node.attributes["num_heads"].as_int()
        scale = np.array(node.attributes["scale"].as_float(), np.float32)
        nodes = Nodes(model.graph, node)
        query, key, value = (
            nodes.op("Transpose", nodes.reshape(part, (0, 0, heads, -1)), perm=perm)
            for part, perm in zip(
                node.inputs, ([0, 2, 1, 3], [0, 2, 3, 1], [0, 2, 1, 3]), strict=True
            )
        )
        scaled = nodes.op("Mul", query, nodes.constant(scale, f"scale_{scale}"))
        weights = nodes.op("Softmax", nodes.op("MatMul", scaled, key), axis=-1)
        mixed = nodes.op("Transpose", nodes.op("MatMul", weights, value), perm=[0, 2, 1, 3])
        nodes.replace(nodes.reshape(mixed, (0, 0, -1)))
    model.opset_imports.pop(DOMAIN, None)
