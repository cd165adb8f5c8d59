"""ONNX forms of ffpose's operators: two of our own domain, one of standard operators.

``ffpose::SpectralFilter(x, weight) -> y``, attribute ``layout``, is `ffpose.ops.spectral_filter`;
the library of `ffpose.onnx.get_library_path` computes it, with the weight prepared once a session
where it is a constant. `ffpose.onnx.matmul` replaces it by standard operators.

``ffpose::SamplePyramid(homographies, levels, plane, finest, half, quarter, eighth) -> y`` is
`ffpose.nn.pyramid.sample_pyramid`, float32, of the same library. Without a translation torch
writes the standard operators that it consists of. `ffpose.nn.pyramid.halve` is an AveragePool.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import torch

import ffpose.nn.pyramid
import ffpose.ops  # noqa: F401 - both register operators that are translated
from ffpose.errors import require
from ffpose.onnx.attention import translate_attention
from ffpose.onnx.nodes import script_op

DOMAIN = "ffpose"
SPECTRAL_FILTER = "SpectralFilter"
SAMPLE_PYRAMID = "SamplePyramid"

FLOATS = ("float", "double", "float16", "bfloat16")


def translations(*, standard: bool = False) -> dict[Callable[..., Any], Callable[..., Any]]:
    """Return the table for `torch.onnx.export`: from our operators to functions of onnxscript.

    Args:
        standard: Leave out what only the library computes and torch can write otherwise.
    """
    table: dict[Callable[..., Any], Callable[..., Any]] = {
        torch.ops.aten.scaled_dot_product_attention.default: translate_attention,
        torch.ops.ffpose.spectral_filter.default: _spectral_filter,
        torch.ops.ffpose.normalize_quaternion.default: _normalize_quaternion,
        torch.ops.ffpose.halve.default: _halve,
    }
    if not standard:
        table[torch.ops.ffpose.sample_pyramid.default] = _sample_pyramid
    return table


def _halve(images: Any) -> Any:
    op = require("onnxscript", "export").opset18
    return op.AveragePool(images, kernel_shape=[2, 2], strides=[2, 2])


def _sample_pyramid(homographies: Any, levels: Any, plane: Any, pyramid: Sequence[Any]) -> Any:
    names = ("homographies", "levels", "plane", "finest", "half", "quarter", "eighth")
    kinds = (("homographies", ("float",)),)
    op = script_op(SAMPLE_PYRAMID, DOMAIN, names, kinds)
    return op(homographies, levels, plane, *pyramid)


def _spectral_filter(x: Any, weight: Any, layout: str) -> Any:
    names, kinds = ("x", "weight"), (("x", FLOATS), ("weight", FLOATS))
    settings = (("layout", "STRING"),)
    op = script_op(SPECTRAL_FILTER, DOMAIN, names, kinds, settings)
    return op(x, weight, layout=layout)


def _normalize_quaternion(q: Any) -> Any:
    """Divide by the largest entry first, so that no square over- or underflows."""
    op = require("onnxscript", "export").opset18
    scaled = op.Div(q, op.ReduceMax(op.Abs(q), [-1], keepdims=1))
    return op.Div(scaled, op.ReduceL2(scaled, [-1], keepdims=1))
