"""ONNX forms of the operators of `ffpose.ops`: one of our own domain, one in terms of it.

``ffpose::SpectralFilter(x, weight) -> y``, attribute ``layout``, is `ffpose.ops.spectral_filter`;
the library of `ffpose.onnx.get_library_path` computes it, with the weight prepared once a session
where it is a constant. `ffpose.onnx.matmul` replaces it by standard operators.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch

import ffpose.ops  # noqa: F401 - registers the operators that are translated
from ffpose.errors import require
from ffpose.onnx.attention import translate_attention
from ffpose.onnx.schema import script_op

DOMAIN = "ffpose"
DOMAIN_VERSION = 1
SPECTRAL_FILTER = "SpectralFilter"

FLOATS = ("float", "double", "float16", "bfloat16")


def translations() -> dict[Callable[..., Any], Callable[..., Any]]:
    """Return the table for `torch.onnx.export`: from our operators to functions of onnxscript."""
    return {
        torch.ops.aten.scaled_dot_product_attention.default: translate_attention,
        torch.ops.ffpose.spectral_filter.default: _spectral_filter,
        torch.ops.ffpose.normalize_quaternion.default: _normalize_quaternion,
    }


def _spectral_filter(x: Any, weight: Any, layout: str) -> Any:
    op = script_op(
        SPECTRAL_FILTER,
        DOMAIN,
        DOMAIN_VERSION,
        ("x", "weight"),
        (("x", FLOATS), ("weight", FLOATS)),
        (("layout", "STRING"),),
    )
    return op(x, weight, layout=layout)


def _normalize_quaternion(q: Any) -> Any:
    """Divide by the largest entry first, so that no square over- or underflows."""
    op = require("onnxscript", "export").opset18
    scaled = op.Div(q, op.ReduceMax(op.Abs(q), [-1], keepdims=1))
    return op.Div(scaled, op.ReduceL2(scaled, [-1], keepdims=1))
