"""The spectral filter ``y = irfft2(rfft2(x) * W)``, differentiable to any order.

Ye et al., Sensors 2023, 23, 8633, Eq. 1-3 (layout ``"tokens"``); Rao et al., "Global Filter
Networks for Image Classification", 2021 (layout ``"grid"``). ``W`` is a half spectrum, held as a
real tensor ``[..., 2]`` of real and imaginary parts. Results equal those of torch.fft, for any
``W``: as the inverse transform is real, only the Hermitian part of the DC column and (for even
width) of the Nyquist column has an effect.

Forward and gradients are bilinear. With the filter ``F(x, w)``, the conjugate ``w*``, and the
correlation ``C(g, x)`` that is the gradient for the weight,

    <g, F(x, w)> = <x, F(g, w*)> = <w, C(g, x)>.

``spectral_filter_backward`` returns ``F(g, w*)`` and ``C(g, x)``. Its own derivatives are expressed
by the same two operators, so they suffice for derivatives of any order.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor
from torch.autograd import Function

from ffpose._internal.torch_internals import (
    below_autograd,
    have_tangent,
    is_plain,
    is_profiled,
    is_recording,
    outer_tangents,
    primals,
    transforms_at_work,
)
from ffpose.ops.bridge import add, check_tensor, rebatch, unbatch
from ffpose.ops.layout import Layout, check_filter
from ffpose.ops.spectral_kernels import (
    BACKWARD,
    FORWARD,
    FORWARD_OUT,
    backward_op,
    backward_rust,
    forward_op,
    forward_rust,
    out_op,
)


def spectral_filter(
    x: Tensor, weight: Tensor, layout: Layout = "tokens", *, out: Tensor | None = None
) -> Tensor:
    """Filter real data in the frequency domain: ``irfft2(rfft2(x) * weight)``.

    Args:
        x: ``(..., X, Y)`` in layout ``"tokens"``, the DFT over both; ``(..., H, W, C)`` channels
            last in layout ``"grid"``, the DFT over H and W of each channel. float32, float64, or
            half precision, which is computed in float32. Any strides; may be empty.
        weight: ``(X, Y//2+1, 2)`` or ``(H, W//2+1, C, 2)``, real and imaginary part last, of the
            dtype of ``x``; or float32 where that is half precision.
        layout: ``"tokens"`` or ``"grid"``.
        out: Contiguous tensor with the shape, dtype and device of ``x`` to write to: memory of its
            own, or ``x`` itself, which is then filtered in place. Not differentiable, as torch's
            own functions with ``out``.

    Returns:
        ``out``, or a new contiguous tensor with the shape and dtype of ``x``, differentiable to any
        order.

    Raises:
        ValueError: The layout is unknown, shapes or devices do not match; or, on the CPU, ``out``
            shares a part of its memory with another argument, or a call in another thread writes to
            memory of this one, or uses ``out``.
        TypeError: A dtype is not supported, or the dtypes do not match.
        RuntimeError: ``out`` is given where a gradient would be recorded or forward mode follows a
            tangent, or another thread gave a tensor other memory during the call.
    """
    if out is not None:
        if not all(isinstance(each, Tensor) for each in (x, weight, out)):
            check_filter(x, weight, layout)
            check_tensor("out", out)
        out_op(x, weight, layout, out=out)
        return out
    plain = is_plain(x, weight)
    if plain and not (torch.is_grad_enabled() and (x.requires_grad or weight.requires_grad)):
        if is_profiled():
            return below_autograd(forward_op, x, weight, layout)
        return forward_rust(x, weight, layout)
    if not plain:
        check_filter(x, weight, layout)
        if is_recording():
            return forward_op(x, weight, layout)
    direct = plain and not transforms_at_work()
    return _recorded(_SpectralFilterOnCpu if direct else _SpectralFilter, x, weight, layout)


def _recorded(function: type[Function], x: Tensor, weight: Tensor, layout: Layout) -> Tensor:
    """Return the result of a function that autograd records."""
    if x.is_inference() and not torch.is_inference_mode_enabled():
        x = x.clone()  # autograd cannot save inference tensors
    result: Tensor = function.apply(x, weight, layout)
    return result


def _gradients(
    grad: Tensor, x: Tensor, weight: Tensor, layout: Layout, *, need_x: bool, need_weight: bool
) -> tuple[Tensor | None, Tensor | None]:
    """Return ``F(grad, weight*)`` and ``C(grad, x)``, with None for one that is not needed."""
    if not (need_x or need_weight):
        return None, None
    if not torch.is_grad_enabled() and is_plain(grad, x, weight):
        run = backward_rust
    else:
        run = backward_op if is_recording() else _SpectralFilterBackward.apply
    for_x, for_weight = run(grad, x, weight, layout, need_x, need_weight)
    return for_x if need_x else None, for_weight if need_weight else None


def _save_needed(ctx: Any, x: Tensor, weight: Tensor, layout: Layout) -> None:
    """Save what gradients are computed from: the weight for that of x, and x for the weight's."""
    need_x, need_weight, _ = ctx.needs_input_grad
    ctx.save_for_backward(x if need_weight else None, weight if need_x else None)
    ctx.layout, ctx.weight_shape, ctx.weight_dtype = layout, weight.shape, weight.dtype


class _SpectralFilter(Function):
    """``F(x, w)``."""

    @staticmethod
    def forward(x: Tensor, weight: Tensor, layout: Layout) -> Tensor:
        return below_autograd(forward_op, x, weight, layout)

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[Any, ...], output: Tensor) -> None:
        x, weight, layout = inputs
        _save_needed(ctx, x, weight, layout)
        ctx.save_for_forward(x, weight)

    @staticmethod
    def backward(ctx: Any, grad: Tensor) -> tuple[Tensor | None, ...]:
        x, weight = ctx.saved_tensors
        need_x, need_weight, _ = ctx.needs_input_grad
        if x is None:
            x = grad
        if weight is None:
            weight = grad.new_empty(ctx.weight_shape, dtype=ctx.weight_dtype)
        gradients = _gradients(grad, x, weight, ctx.layout, need_x=need_x, need_weight=need_weight)
        return *gradients, None

    @staticmethod
    def jvp(ctx: Any, of_x: Tensor | None, of_weight: Tensor | None, _: None) -> Tensor | None:
        x, weight = primals(ctx.saved_tensors)
        with outer_tangents():
            return add(
                None if of_x is None else spectral_filter(of_x, weight, ctx.layout),
                None if of_weight is None else spectral_filter(x, of_weight, ctx.layout),
            )

    @staticmethod
    def vmap(
        info: Any, in_dims: Sequence[int | None], x: Tensor, weight: Tensor, layout: Layout
    ) -> tuple[Tensor, int]:
        """Apply the operator to a batch of ``x`` with one weight; loop over samples otherwise."""
        if in_dims[0] is not None and in_dims[1] is None:
            return spectral_filter(x.movedim(in_dims[0], 0), weight, layout), 0
        samples = unbatch((x, weight), in_dims, info.batch_size)
        results = [spectral_filter(x, weight, layout) for x, weight in samples]
        return rebatch(results, info.batch_size), 0


class _SpectralFilterOnCpu(Function):
    """`_SpectralFilter` for plain autograd, with less overhead.

    With separate methods `forward` and `setup_context`, which `torch.func` requires, torch needs
    tens of microseconds more than with a single one.
    """

    @staticmethod
    def forward(ctx: Any, x: Tensor, weight: Tensor, layout: Layout) -> Tensor:
        _save_needed(ctx, x, weight, layout)
        return forward_rust(x, weight, layout)

    backward = _SpectralFilter.backward


class _SpectralFilterBackward(Function):
    """``F(g, w*)`` and ``C(g, x)``."""

    @staticmethod
    def forward(
        grad: Tensor, x: Tensor, weight: Tensor, layout: Layout, need_x: bool, need_weight: bool
    ) -> tuple[Tensor, Tensor]:
        return below_autograd(backward_op, grad, x, weight, layout, need_x, need_weight)

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[Any, ...], output: tuple[Tensor, Tensor]) -> None:
        grad, x, weight, ctx.layout, ctx.gave_x, ctx.gave_weight = inputs
        ctx.save_for_backward(grad, x, weight)
        ctx.save_for_forward(grad, x, weight)
        ctx.set_materialize_grads(False)

    @staticmethod
    def backward(
        ctx: Any, for_x: Tensor | None, for_weight: Tensor | None
    ) -> tuple[Tensor | None, ...]:
        """Differentiate ``<for_x, F(g, w*)> + <for_weight, C(g, x)>``.

        By adjointness that is ``<g, F(for_x, w) + F(x, for_weight)>``.
        """
        grad, x, weight = ctx.saved_tensors
        layout, (need_grad, need_x, need_weight, *_) = ctx.layout, ctx.needs_input_grad
        of_grad = of_x = of_weight = None
        if ctx.gave_x and for_x is not None:
            of_grad = spectral_filter(for_x, weight, layout) if need_grad else None
            _, of_weight = _gradients(
                grad, for_x, weight, layout, need_x=False, need_weight=need_weight
            )
        if ctx.gave_weight and for_weight is not None:
            term = spectral_filter(x, for_weight, layout) if need_grad else None
            of_grad = add(of_grad, term)
            of_x, _ = _gradients(grad, x, for_weight, layout, need_x=need_x, need_weight=False)
        return of_grad, of_x, of_weight, None, None, None

    @staticmethod
    def jvp(
        ctx: Any, of_grad: Tensor | None, of_x: Tensor | None, of_weight: Tensor | None, *_: None
    ) -> tuple[Tensor, Tensor]:
        """Differentiate along a direction: linear in each argument, so one term for each."""
        grad, x, weight = primals(ctx.saved_tensors)
        terms = (
            ((of_grad, x, weight), ctx.gave_x, ctx.gave_weight),
            ((grad, of_x, weight), False, ctx.gave_weight),
            ((grad, x, of_weight), ctx.gave_x, False),
        )
        for_x = x.new_zeros(x.shape if ctx.gave_x else 0)
        for_weight = weight.new_zeros(weight.shape if ctx.gave_weight else 0)
        with outer_tangents():
            for (g, a, w), need_x, need_weight in terms:
                if g is None or a is None or w is None:
                    continue
                term_x, term_weight = _gradients(
                    g, a, w, ctx.layout, need_x=need_x, need_weight=need_weight
                )
                for_x = for_x if term_x is None else for_x + term_x
                for_weight = for_weight if term_weight is None else for_weight + term_weight
        return for_x, for_weight

    @staticmethod
    def vmap(
        info: Any,
        in_dims: Sequence[int | None],
        grad: Tensor,
        x: Tensor,
        weight: Tensor,
        layout: Layout,
        need_x: bool,
        need_weight: bool,
    ) -> tuple[tuple[Tensor, Tensor], tuple[int, int]]:
        """Loop over samples, as each has its own gradient for the weight."""
        samples = unbatch((grad, x, weight), in_dims, info.batch_size)
        gradients = [
            _SpectralFilterBackward.apply(*each, layout, need_x, need_weight) for each in samples
        ]
        for_x, for_weight = zip(*gradients, strict=True)
        return (rebatch(for_x, info.batch_size), rebatch(for_weight, info.batch_size)), (0, 0)


def _record_forward(x: Tensor, weight: Tensor, layout: Layout) -> Any:
    if is_plain(x, weight):
        return spectral_filter(x, weight, layout)
    return _recorded(_SpectralFilter, x, weight, layout)


def _write_unrecorded(x: Tensor, weight: Tensor, layout: Layout, *, out: Tensor) -> None:
    if torch.is_grad_enabled() and any(t.requires_grad for t in (x, weight, out)):
        raise RuntimeError(
            "spectral_filter with out: expected arguments without gradient, got one that requires"
            " it; call it under torch.no_grad()"
        )
    if have_tangent(x, weight, out):
        raise RuntimeError(
            "spectral_filter with out: expected arguments without tangent, got one of forward mode;"
            " call it without out"
        )
    below_autograd(out_op, x, weight, layout, out=out)


torch.library.impl(FORWARD, "Autograd", _record_forward)
torch.library.impl(FORWARD_OUT, "Autograd", _write_unrecorded)
torch.library.impl(BACKWARD, "Autograd", _SpectralFilterBackward.apply)
torch.library.register_vmap(FORWARD, _SpectralFilter.vmap)
torch.library.register_vmap(BACKWARD, _SpectralFilterBackward.vmap)
