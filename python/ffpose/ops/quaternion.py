"""The quaternion activation ``q / ‖q‖``, differentiable to any order.

Ye et al., Sensors 2023, 23, 8633, Eq. 8 (whose printed form lost the root). With ``u = q / ‖q‖``
the gradient is ``B(g, q) = (g - u <u, g>) / ‖q‖``, the product of ``g`` with a symmetric matrix.
Rust computes both on the CPU, torch elsewhere, and where the gradient is differentiated again.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.autograd import Function

from ffpose import _rust
from ffpose._internal.torch_internals import (
    below_autograd,
    is_plain,
    is_recording,
    outer_tangents,
    primals,
    transforms_at_work,
)
from ffpose.ops.bridge import HALF_DTYPES, arithmetic_dtype, check_tensor

NAME = "ffpose::normalize_quaternion"

# On a GPU the check for zeros waits for it, which nothing may while a CUDA graph is captured.
TAGS = (torch.Tag.pt2_compliant_tag, torch.Tag.cudagraph_unsafe)
torch.library.define(NAME, "(Tensor q) -> Tensor", tags=TAGS)
_op: Callable[..., Tensor] = torch.ops.ffpose.normalize_quaternion.default


def normalize_quaternion(q: Tensor) -> Tensor:
    """Normalize quaternions: ``q / ‖q‖``, row by row.

    Args:
        q: Quaternions ``(..., 4)``, scalar first. float32, float64, or half precision, which is
            computed in float32. NaN propagates within its row.

    Returns:
        Unit quaternions with the shape, dtype and signs of ``q``; contiguous, differentiable to any
        order.

    Raises:
        ValueError: ``q`` is not ``(..., 4)``, or a row is zero; the message has its index over all
            leading dimensions. On devices other than the CPU this check synchronizes.
        TypeError: The dtype of ``q`` is not supported.
    """
    check_tensor("q", q)
    if is_plain(q):
        if not (torch.is_grad_enabled() and q.requires_grad):
            return _on_cpu(q)
        if not transforms_at_work():
            recorded: Tensor = _NormalizeQuaternionOnCpu.apply(q)
            return recorded
    result: Tensor = _op(q) if is_recording() else _NormalizeQuaternion.apply(q)
    return result


def _gradient(grad: Tensor, q: Tensor) -> Tensor:
    """Return ``B(grad, q)``."""
    if not torch.is_grad_enabled() and is_plain(grad, q):
        result = _rust.normalize_quaternion_backward(_array(grad), _array(q))
        return torch.from_numpy(result).to(q.dtype)
    kind = arithmetic_dtype(q.dtype)
    wide, g = q.to(kind), grad.to(kind)
    unit = normalize_quaternion(wide)
    return ((g - unit * _dot(unit, g)) / _dot(unit, wide)).to(q.dtype)


def _dot(a: Tensor, b: Tensor) -> Tensor:
    return (a * b).sum(-1, keepdim=True)


class _NormalizeQuaternion(Function):
    """``q / ‖q‖``."""

    @staticmethod
    def forward(q: Tensor) -> Tensor:
        return below_autograd(_op, q)

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[Tensor], output: Tensor) -> None:
        ctx.save_for_backward(*inputs)
        ctx.save_for_forward(*inputs)

    @staticmethod
    def backward(ctx: Any, grad: Tensor) -> Tensor:
        (q,) = ctx.saved_tensors
        return _gradient(grad, q)

    @staticmethod
    def jvp(ctx: Any, of_q: Tensor) -> Tensor:
        (q,) = primals(ctx.saved_tensors)
        with outer_tangents():
            return _gradient(of_q, q)

    @staticmethod
    def vmap(info: Any, in_dims: Sequence[int], q: Tensor) -> tuple[Tensor, int]:
        """Treat the batch as one more leading dimension."""
        return normalize_quaternion(q.movedim(in_dims[0], 0)), 0


class _NormalizeQuaternionOnCpu(Function):
    """`_NormalizeQuaternion` for plain autograd, with less overhead; see `ffpose.ops.spectral`."""

    @staticmethod
    def forward(ctx: Any, q: Tensor) -> Tensor:
        ctx.save_for_backward(q)
        return _on_cpu(q)

    backward = _NormalizeQuaternion.backward


# Kernels: Rust on the CPU, torch elsewhere, shapes alone for fake tensors.


def _check(q: Tensor) -> None:
    check_tensor("q", q)
    if q.dim() == 0 or q.shape[-1] != 4:
        raise ValueError(f"q: expected shape (..., 4), got {tuple(q.shape)}")


def _on_cpu(q: Tensor) -> Tensor:
    _check(q)
    return torch.from_numpy(_rust.normalize_quaternion(_array(q))).to(q.dtype)


def _array(tensor: Tensor) -> NDArray[Any]:
    """Return a C-contiguous, aligned array of the arithmetic dtype, copied only if necessary."""
    if tensor.dtype in HALF_DTYPES:
        tensor = tensor.float()
    return np.require(tensor.contiguous().numpy(force=True), requirements="A")


def _elsewhere(q: Tensor) -> Tensor:
    _check(q)
    zero = (q == 0).all(-1).flatten()
    if zero.any():
        row = int(zero.nonzero()[0])
        raise ValueError(f"q: expected quaternions other than zero, got zero in row {row}")
    wide = q.to(arithmetic_dtype(q.dtype)).contiguous()
    scaled = wide / wide.abs().amax(-1, keepdim=True)  # so that no square over- or underflows
    unit: Tensor = scaled / torch.linalg.vector_norm(scaled, dim=-1, keepdim=True)
    return unit.to(q.dtype)


def _fake(q: Tensor) -> Tensor:
    _check(q)
    return q.new_empty(q.shape)


torch.library.impl(NAME, "cpu", _on_cpu)
torch.library.impl(NAME, "default", _elsewhere)
torch.library.impl(NAME, "Autograd", _NormalizeQuaternion.apply)
torch.library.register_fake(NAME, _fake)
torch.library.register_vmap(NAME, _NormalizeQuaternion.vmap)
