"""The operators ``spectral_filter`` and ``spectral_filter_backward`` for each device.

On the CPU Rust computes, in as many threads as `torch.get_num_threads` says; elsewhere torch.fft;
for fake tensors, shapes alone. Derivatives are in `ffpose.ops.spectral`.
"""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from ffpose import _rust
from ffpose.ops.bridge import to_array, to_tensor
from ffpose.ops.fourier import filter_backward_by_fft, filter_by_fft
from ffpose.ops.layout import Layout, check_filter, check_gradient

FORWARD = "ffpose::spectral_filter"
BACKWARD = "ffpose::spectral_filter_backward"

torch.library.define(
    FORWARD,
    "(Tensor x, Tensor weight, str layout) -> Tensor",
    tags=(torch.Tag.pt2_compliant_tag,),
)
# A gradient that is not needed comes back as a tensor of shape (0,): operators cannot return None.
torch.library.define(
    BACKWARD,
    "(Tensor grad, Tensor x, Tensor weight, str layout, bool need_x, bool need_weight)"
    " -> (Tensor, Tensor)",
    tags=(torch.Tag.pt2_compliant_tag,),
)
forward_op: Callable[..., Tensor] = torch.ops.ffpose.spectral_filter.default
backward_op: Callable[..., tuple[Tensor, Tensor]] = (
    torch.ops.ffpose.spectral_filter_backward.default
)


def forward_rust(x: Tensor, weight: Tensor, layout: Layout) -> Tensor:
    """Filter CPU tensors that were checked; arguments as in `ffpose.ops.spectral_filter`."""
    y = _rust.spectral_filter(to_array(x), to_array(weight), layout, torch.get_num_threads())
    return to_tensor(y, x.dtype)


def backward_rust(
    grad: Tensor, x: Tensor, weight: Tensor, layout: Layout, need_x: bool, need_weight: bool
) -> tuple[Tensor, Tensor]:
    """Return both gradients of CPU tensors that were checked, ``(0,)`` for one not needed."""
    arrays = (to_array(grad), to_array(x), to_array(weight))
    grad_x, grad_weight = _rust.spectral_filter_backward(
        *arrays, layout, need_x, need_weight, torch.get_num_threads()
    )
    return (
        x.new_empty(0) if grad_x is None else to_tensor(grad_x, x.dtype),
        weight.new_empty(0) if grad_weight is None else to_tensor(grad_weight, weight.dtype),
    )


def _forward_cpu(x: Tensor, weight: Tensor, layout: Layout) -> Tensor:
    check_filter(x, weight, layout)
    return forward_rust(x, weight, layout)


def _forward_elsewhere(x: Tensor, weight: Tensor, layout: Layout) -> Tensor:
    check_filter(x, weight, layout)
    return filter_by_fft(x, weight, layout)


def _forward_fake(x: Tensor, weight: Tensor, layout: Layout) -> Tensor:
    check_filter(x, weight, layout)
    return x.new_empty(x.shape)


def _backward_cpu(
    grad: Tensor, x: Tensor, weight: Tensor, layout: Layout, need_x: bool, need_weight: bool
) -> tuple[Tensor, Tensor]:
    check_gradient(grad, x, weight, layout)
    return backward_rust(grad, x, weight, layout, need_x, need_weight)


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


torch.library.impl(FORWARD, "cpu", _forward_cpu)
torch.library.impl(FORWARD, "default", _forward_elsewhere)
torch.library.register_fake(FORWARD, _forward_fake)
torch.library.impl(BACKWARD, "cpu", _backward_cpu)
torch.library.impl(BACKWARD, "default", _backward_elsewhere)
torch.library.register_fake(BACKWARD, _backward_fake)
