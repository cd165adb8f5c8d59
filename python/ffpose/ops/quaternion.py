"""The quaternion activation ``q / ‖q‖``, differentiable to any order.

Ye et al., Sensors 2023, 23, 8633, Eq. 8 (whose printed form lost the root). With ``u = q / ‖q‖``
the gradient is ``B(g, q) = (g - u <u, g>) / ‖q‖``, the product of ``g`` with a symmetric matrix.
Rust computes both on the CPU, torch elsewhere; derivatives of ``B`` are expressed by the same two
functions.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import torch
from torch import Tensor
from torch.autograd import Function

from ffpose import _rust
from ffpose._internal.torch_internals import (
    below_autograd,
    is_plain,
    is_recording,
    outer_tangents,
    primals,
)
from ffpose.ops.bridge import arithmetic_dtype, check_alike, check_tensor, to_array

FORWARD = "ffpose::normalize_quaternion"
BACKWARD = "ffpose::normalize_quaternion_backward"

# On a GPU the check for zeros waits for it, which nothing may while a CUDA graph is captured.
TAGS = (torch.Tag.pt2_compliant_tag, torch.Tag.cudagraph_unsafe)
torch.library.define(FORWARD, "(Tensor q) -> Tensor", tags=TAGS)
torch.library.define(BACKWARD, "(Tensor grad, Tensor q) -> Tensor", tags=TAGS)
_forward_op: Callable[..., Tensor] = torch.ops.ffpose.normalize_quaternion.default
_backward_op: Callable[..., Tensor] = torch.ops.ffpose.normalize_quaternion_backward.default


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
    if is_plain(q) and not (torch.is_grad_enabled() and q.requires_grad):
        return _forward_cpu(q)
    result: Tensor = _forward_op(q) if is_recording() else _NormalizeQuaternion.apply(q)
    return result


def _gradient(grad: Tensor, q: Tensor) -> Tensor:
    """Return ``B(grad, q)``."""
    if not torch.is_grad_enabled() and is_plain(grad, q):
        return _backward_cpu(grad, q)
    result: Tensor = _NormalizeQuaternionBackward.apply(grad, q)
    return result


class _NormalizeQuaternion(Function):
    """``q / ‖q‖``."""

    @staticmethod
    def forward(q: Tensor) -> Tensor:
        return below_autograd(_forward_op, q)

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
    def vmap(info: Any, in_dims: Sequence[int | None], q: Tensor) -> tuple[Tensor, int]:
        """Treat the batch as one more leading dimension."""
        return normalize_quaternion(_batch_first(q, in_dims[0], info.batch_size)), 0


class _NormalizeQuaternionBackward(Function):
    """``B(g, q) = (g - u <u, g>) / ‖q‖``."""

    @staticmethod
    def forward(grad: Tensor, q: Tensor) -> Tensor:
        return below_autograd(_backward_op, grad, q)

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[Tensor, Tensor], output: Tensor) -> None:
        ctx.save_for_backward(*inputs)
        ctx.save_for_forward(*inputs)

    @staticmethod
    def backward(ctx: Any, cotangent: Tensor) -> tuple[Tensor, Tensor | None]:
        grad, q = ctx.saved_tensors
        for_q = _second(cotangent, grad, q) if ctx.needs_input_grad[1] else None
        return _gradient(cotangent, q), for_q

    @staticmethod
    def jvp(ctx: Any, of_grad: Tensor, of_q: Tensor) -> Tensor:
        grad, q = primals(ctx.saved_tensors)
        with outer_tangents():
            return _gradient(of_grad, q) + _second(of_q, grad, q)

    @staticmethod
    def vmap(
        info: Any, in_dims: Sequence[int | None], grad: Tensor, q: Tensor
    ) -> tuple[Tensor, int]:
        """Treat the batch as one more leading dimension."""
        grad = _batch_first(grad, in_dims[0], info.batch_size)
        return _gradient(grad, _batch_first(q, in_dims[1], info.batch_size)), 0


def _second(a: Tensor, b: Tensor, q: Tensor) -> Tensor:
    """Return the second derivative of ``u(q)``, a symmetric trilinear form, in two directions.

    It is ``-(u <a, B(b, q)> + B(a, q) <u, b> + B(b, q) <u, a>) / ‖q‖``.
    """
    unit, of_a, of_b = normalize_quaternion(q), _gradient(a, q), _gradient(b, q)
    return -(unit * _dot(a, of_b) + of_a * _dot(unit, b) + of_b * _dot(unit, a)) / _dot(unit, q)


def _dot(a: Tensor, b: Tensor) -> Tensor:
    """Return ``<a, b>``, ``(..., 1)``."""
    return (a * b).sum(-1, keepdim=True)


def _batch_first(tensor: Tensor, dim: int | None, size: int) -> Tensor:
    return tensor.expand(size, *tensor.shape) if dim is None else tensor.movedim(dim, 0)


# Kernels: Rust on the CPU, torch elsewhere, shapes alone for fake tensors.


def _check(q: Tensor) -> None:
    check_tensor("q", q)
    if q.dim() == 0 or q.shape[-1] != 4:
        raise ValueError(f"q: expected shape (..., 4), got {tuple(q.shape)}")


def _check_gradient(grad: Tensor, q: Tensor) -> None:
    _check(q)
    check_alike("grad", grad, "q", q)


def _forward_cpu(q: Tensor) -> Tensor:
    _check(q)
    return torch.from_numpy(_rust.normalize_quaternion(to_array(q))).to(q.dtype)


def _backward_cpu(grad: Tensor, q: Tensor) -> Tensor:
    _check_gradient(grad, q)
    result = _rust.normalize_quaternion_backward(to_array(grad), to_array(q))
    return torch.from_numpy(result).to(q.dtype)


def _forward_elsewhere(q: Tensor) -> Tensor:
    _check(q)
    unit, _ = _unit_and_norm(q)
    return unit.to(q.dtype)


def _backward_elsewhere(grad: Tensor, q: Tensor) -> Tensor:
    _check_gradient(grad, q)
    unit, norm = _unit_and_norm(q)
    return ((grad - unit * _dot(unit, grad)) / norm).to(q.dtype).contiguous()


def _unit_and_norm(q: Tensor) -> tuple[Tensor, Tensor]:
    """Return ``q / ‖q‖`` and ``‖q‖ (..., 1)``, contiguous, in the arithmetic dtype."""
    zero = (q == 0).all(-1).flatten()
    if zero.any():
        row = int(zero.nonzero()[0])
        raise ValueError(f"q: expected quaternions other than zero, got zero in row {row}")
    q = q.to(arithmetic_dtype(q.dtype)).contiguous()
    largest = q.abs().amax(-1, keepdim=True)  # divided out: no square over- or underflows
    norm = torch.linalg.vector_norm(q / largest, dim=-1, keepdim=True)
    return q / largest / norm, largest * norm


def _forward_fake(q: Tensor) -> Tensor:
    _check(q)
    return q.new_empty(q.shape)


def _backward_fake(grad: Tensor, q: Tensor) -> Tensor:
    _check_gradient(grad, q)
    return q.new_empty(q.shape)


torch.library.impl(FORWARD, "cpu", _forward_cpu)
torch.library.impl(FORWARD, "default", _forward_elsewhere)
torch.library.impl(FORWARD, "Autograd", _NormalizeQuaternion.apply)
torch.library.register_fake(FORWARD, _forward_fake)
torch.library.register_vmap(FORWARD, _NormalizeQuaternion.vmap)
torch.library.impl(BACKWARD, "cpu", _backward_cpu)
torch.library.impl(BACKWARD, "default", _backward_elsewhere)
torch.library.impl(BACKWARD, "Autograd", _NormalizeQuaternionBackward.apply)
torch.library.register_fake(BACKWARD, _backward_fake)
torch.library.register_vmap(BACKWARD, _NormalizeQuaternionBackward.vmap)
