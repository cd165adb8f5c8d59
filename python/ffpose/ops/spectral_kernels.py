"""Kernels of the operators ``spectral_filter`` and ``spectral_filter_backward`` by device.

Rust on the CPU, in torch's own thread pool with `torch.get_num_threads` threads; torch.fft on other
devices; only shapes for fake tensors. Derivatives are in `ffpose.ops.spectral`.
"""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor
from torch.autograd.graph import increment_version

from ffpose import _rust
from ffpose.ops.fourier import filter_backward_by_fft, filter_by_fft
from ffpose.ops.layout import Layout, check_filter, check_gradient, check_out

FORWARD = "ffpose::spectral_filter"
FORWARD_OUT = "ffpose::spectral_filter.out"
BACKWARD = "ffpose::spectral_filter_backward"

torch.library.define(
    FORWARD,
    "(Tensor x, Tensor weight, str layout) -> Tensor",
    tags=(torch.Tag.pt2_compliant_tag,),
)
# It returns nothing: torch.compile takes no custom operator whose result is one of its arguments.
torch.library.define(
    FORWARD_OUT,
    "(Tensor x, Tensor weight, str layout, *, Tensor(a!) out) -> ()",
    tags=(torch.Tag.pt2_compliant_tag,),
)
# A gradient that is not needed is returned as a tensor of shape (0,): operators cannot return None.
torch.library.define(
    BACKWARD,
    "(Tensor grad, Tensor x, Tensor weight, str layout, bool need_x, bool need_weight)"
    " -> (Tensor, Tensor)",
    tags=(torch.Tag.pt2_compliant_tag,),
)
forward_op: Callable[..., Tensor] = torch.ops.ffpose.spectral_filter.default
out_op: Callable[..., None] = torch.ops.ffpose.spectral_filter.out
backward_op: Callable[..., tuple[Tensor, Tensor]] = (
    torch.ops.ffpose.spectral_filter_backward.default
)


def forward_rust(x: Tensor, weight: Tensor, layout: Layout, *, out: Tensor | None = None) -> Tensor:
    """Filter CPU tensors; arguments and errors are those of `ffpose.ops.spectral_filter`.

    Rust checks the arguments, so that a valid call needs no second check in Python. It refuses what
    is rare on CPUs: float16, which torch converts to float32 and back, and elements at an address
    that is no multiple of their size, which are copied.
    """
    x, weight = x.contiguous(), weight.contiguous()
    y = torch.empty_like(x) if out is None else out
    try:
        _rust.filter_tensors(x, weight, y, layout, torch.get_num_threads())
    except (TypeError, ValueError) as error:
        check_filter(x, weight, layout)  # raises the same error as on other devices
        if isinstance(error, TypeError) and x.dtype == torch.float16:
            return y.copy_(forward_rust(x.float(), weight.float(), layout))
        if not _are_aligned(x, weight):
            return forward_rust(x.clone(), weight.clone(), layout, out=out)
        raise
    return y


def _out_cpu(x: Tensor, weight: Tensor, layout: Layout, *, out: Tensor) -> None:
    check_out(x, out)
    forward_rust(x, weight, layout, out=out)
    increment_version(out)  # here, as inference mode skips autograd's kernel


def _out_elsewhere(x: Tensor, weight: Tensor, layout: Layout, *, out: Tensor) -> None:
    check_out(x, out)
    out.copy_(_forward_elsewhere(x, weight, layout))


def _out_fake(x: Tensor, weight: Tensor, layout: Layout, *, out: Tensor) -> None:
    check_filter(x, weight, layout)
    check_out(x, out)


def backward_rust(
    grad: Tensor, x: Tensor, weight: Tensor, layout: Layout, need_x: bool, need_weight: bool
) -> tuple[Tensor | None, Tensor | None]:
    """Return both gradients of CPU tensors, with None for one that is not needed."""
    grad, x, weight = grad.contiguous(), x.contiguous(), weight.contiguous()
    grad_x = torch.empty_like(x) if need_x else None
    grad_weight = torch.empty_like(weight) if need_weight else None
    try:
        _rust.filter_tensors_backward(
            grad, x, weight, grad_x, grad_weight, layout, torch.get_num_threads()
        )
    except (TypeError, ValueError) as error:
        check_gradient(grad, x, weight, layout)
        if isinstance(error, TypeError) and x.dtype == torch.float16:
            wide = (grad.float(), x.float(), weight.float())
            for_x, for_weight = backward_rust(*wide, layout, need_x, need_weight)
            return _narrowed(for_x, x.dtype), _narrowed(for_weight, weight.dtype)
        if not _are_aligned(grad, x, weight):
            copies = (grad.clone(), x.clone(), weight.clone())
            return backward_rust(*copies, layout, need_x, need_weight)
        raise
    return grad_x, grad_weight


def _are_aligned(*tensors: Tensor) -> bool:
    return not any(tensor.data_ptr() % tensor.element_size() for tensor in tensors)


def _narrowed(grad: Tensor | None, dtype: torch.dtype) -> Tensor | None:
    return None if grad is None else grad.to(dtype)


def _forward_elsewhere(x: Tensor, weight: Tensor, layout: Layout) -> Tensor:
    check_filter(x, weight, layout)
    return filter_by_fft(x, weight, layout)


def _forward_fake(x: Tensor, weight: Tensor, layout: Layout) -> Tensor:
    check_filter(x, weight, layout)
    return x.new_empty(x.shape)


def _backward_cpu(
    grad: Tensor, x: Tensor, weight: Tensor, layout: Layout, need_x: bool, need_weight: bool
) -> tuple[Tensor, Tensor]:
    for_x, for_weight = backward_rust(grad, x, weight, layout, need_x, need_weight)
    return (
        x.new_empty(0) if for_x is None else for_x,
        weight.new_empty(0) if for_weight is None else for_weight,
    )


def _backward_elsewhere(
    grad: Tensor, x: Tensor, weight: Tensor, layout: Layout, need_x: bool, need_weight: bool
) -> tuple[Tensor, Tensor]:
    check_gradient(grad, x, weight, layout)
    return filter_backward_by_fft(grad, x, weight, layout, need_x, need_weight)


def _backward_fake(
    grad: Tensor, x: Tensor, weight: Tensor, layout: Layout, need_x: bool, need_weight: bool
) -> tuple[Tensor, Tensor]:
    check_gradient(grad, x, weight, layout)
    return (
        x.new_empty(x.shape if need_x else 0),
        weight.new_empty(weight.shape if need_weight else 0),
    )


torch.library.impl(FORWARD, "cpu", forward_rust)
torch.library.impl(FORWARD, "default", _forward_elsewhere)
torch.library.register_fake(FORWARD, _forward_fake)
torch.library.impl(FORWARD_OUT, "cpu", _out_cpu)
torch.library.impl(FORWARD_OUT, "default", _out_elsewhere)
torch.library.register_fake(FORWARD_OUT, _out_fake)
torch.library.impl(BACKWARD, "cpu", _backward_cpu)
torch.library.impl(BACKWARD, "default", _backward_elsewhere)
torch.library.register_fake(BACKWARD, _backward_fake)
