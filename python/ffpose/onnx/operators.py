"""How the operators of `ffpose.ops` are written in ONNX: one of our own domain, one in terms of it.

``ffpose::SpectralFilter(x, weight) -> y``, attribute ``layout``, is `ffpose.ops.spectral_filter`;
the library of `ffpose.onnx.get_library_path` computes it, with the weight prepared once a session
where it is a constant. `ffpose.onnx.matmul` replaces it by standard operators.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import torch

import ffpose.ops  # noqa: F401 - registers the operators that are translated
from ffpose.errors import require

DOMAIN = "ffpose"
DOMAIN_VERSION = 1
SPECTRAL_FILTER = "SpectralFilter"

FLOATS = ("float", "double", "float16", "bfloat16")


def translations() -> dict[Callable[..., Any], Callable[..., Any]]:
    """Return the table for `torch.onnx.export`: from our operators to functions of onnxscript."""
    return {
        torch.ops.ffpose.spectral_filter.default: _spectral_filter,
        torch.ops.ffpose.normalize_quaternion.default: _normalize_quaternion,
    }


def _spectral_filter(x: Any, weight: Any, layout: str) -> Any:
    return _spectral_filter_op()(x, weight, layout=layout)


def _normalize_quaternion(q: Any) -> Any:
    """Divide by the largest entry first, so that no square over- or underflows."""
    op = require("onnxscript", "export").opset18
    scaled = op.Div(q, op.ReduceMax(op.Abs(q), [-1], keepdims=1))
    return op.Div(scaled, op.ReduceL2(scaled, [-1], keepdims=1))


@cache
def _spectral_filter_op() -> Any:
    """Return the operator as onnxscript calls it."""
    schemas = require("onnx.defs", "export")
    values = require("onnxscript", "export").values
    schema = schemas.OpSchema
    types = [f"tensor({name})" for name in FLOATS]
    parameters = [
        schema.FormalParameter(name, kind) for name, kind in (("x", "T"), ("weight", "W"))
    ]
    layout = schema.Attribute("layout", schema.AttrType.STRING, "tokens or grid", required=True)
    return values.Op(
        values.Opset(DOMAIN, DOMAIN_VERSION),
        SPECTRAL_FILTER,
        schema(
            SPECTRAL_FILTER,
            DOMAIN,
            DOMAIN_VERSION,
            doc="y = irfft2(rfft2(x) * weight)",
            inputs=parameters,
            outputs=[schema.FormalParameter("y", "T")],
            type_constraints=[("T", types, "of x and y"), ("W", types, "of the weight")],
            attributes=[layout],
        ),
    )
