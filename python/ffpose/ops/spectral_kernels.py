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


def _forward_elsewhere(x: Tensor, weight: Tensor, layout: Layout) -> Tensor:
    check_filter(x, weight, layout)
    return filter_by_fft(x, weight, layout)


def _out_elsewhere(x: Tensor, weight: Tensor, layout: Layout, *, out: Tensor) -> None:
    check_out(x, out)
    out.copy_(_forward_elsewhere(x, weight, layout))


def _out_fake(x: Tensor, weight: Tensor, layout: Layout, *, out: Tensor) -> None:
    check_filter(x, weight, layout)
    check_out(x, out)


def backward_rust(
    grad: Tensor, x: Tensor, weight: Tensor, layout: Layout, need_x: bool, need_weight: bool
) -> tuple[Tensor, Tensor]:
    """Return both gradients of CPU tensors, of shape ``(0,)`` where one is not needed."""
    grad, x, weight = grad.contiguous(), x.contiguous(), weight.contiguous()
    for_x = torch.empty_like(x) if need_x else x.new_empty(0)
    for_weight = torch.empty_like(weight) if need_weight else weight.new_empty(0)
    outputs = (for_x if need_x else None, for_weight if need_weight else None)
    try:
        _rust.filter_tensors_backward(grad, x, weight, *outputs, layout, torch.get_num_threads())
    except (TypeError, ValueError) as error:
        check_gradient(grad, x, weight, layout)
        if isinstance(error, TypeError) and x.dtype == torch.float16:
            wide = (grad.float(), x.float(), weight.float())
            for_x, for_weight = backward_rust(*wide, layout, need_x, need_weight)
            return for_x.to(x.dtype), for_weight.to(weight.dtype)
        if not _are_aligned(grad, x, weight):
            copies = (grad.clone(), x.clone(), weight.clone())
            return backward_rust(*copies, layout, need_x, need_weight)
        raise
    return for_x, for_weight


def _are_aligned(*tensors: Tensor) -> bool:
    return not any(tensor.data_ptr() % tensor.element_size() for tensor in tensors)


def _forward_fake(x: Tensor, weight: Tensor, layout: Layout) -> Tensor:
    check_filter(x, weight, layout)
    return x.new_empty(x.shape)


def _backward_elsewhere(
    grad: Tensor, x: Tensor, weight: Tensor, layout: Layout, need_x: bool, need_weight: bool
) -> tuple[Tensor, Tensor]:
    check_gradient(grad, x, weight, layout)
    return filter_backward_by_fft(grad, x, weight, layout, need_x, need_weight)


def _backward_fake(
    grad: Tensor, x: Tensor, weight: Tensor, layout: Layout, need_x: bool, need_weight: bool
) -> tuple[Tensor, Tensor]:
    check_gradient(grad, x, weight, layout)
    for_x = x.new_empty(x.shape if need_x else 0)
    return for_x, weight.new_empty(weight.shape if need_weight else 0)


torch.library.impl(FORWARD, "cpu", forward_rust)
torch.library.impl(FORWARD, "default", _forward_elsewhere)
torch.library.register_fake(FORWARD, _forward_fake)
torch.library.impl(FORWARD_OUT, "cpu", _out_cpu)
torch.library.impl(FORWARD_OUT, "default", _out_elsewhere)
torch.library.register_fake(FORWARD_OUT, _out_fake)
torch.library.impl(BACKWARD, "cpu", backward_rust)
torch.library.impl(BACKWARD, "default", _backward_elsewhere)
torch.library.register_fake(BACKWARD, _backward_fake)
