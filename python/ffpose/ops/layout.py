"""The two layouts of the spectral filter, and the checks of its arguments.

All checks are in this module, so that every path to the operator raises the same errors.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal, get_args

from torch import Tensor

from ffpose.ops.bridge import arithmetic_dtype, check_alike, check_tensor

Layout = Literal["tokens", "grid"]
LAYOUTS: tuple[Layout, ...] = get_args(Layout)

RANK = {"tokens": 2, "grid": 3}
"""Number of dimensions of one image, without the batch."""

PLANE = {"tokens": (-2, -1), "grid": (-3, -2)}
"""The two transformed dimensions."""


def weight_shape(size: Sequence[int], layout: Layout) -> tuple[int, ...]:
    """Return the shape of the weight for ``(X, Y)`` of tokens, or ``(H, W, C)`` of a grid.

    Raises:
        ValueError: ``layout`` is unknown, or ``size`` has the wrong length for it.

    Examples:
        >>> weight_shape((14, 14, 256), "grid")
        (14, 8, 256, 2)
    """
    check_layout(layout)
    if isinstance(size, int):
        raise ValueError(
            f"size: layout {layout!r} expected {RANK[layout]} sizes, got the one number {size}"
        )
    if len(size) != RANK[layout]:
        raise ValueError(f"size: layout {layout!r} expected {RANK[layout]} sizes, got {len(size)}")
    rows, columns, *channels = size
    return (rows, columns // 2 + 1, *channels, 2)


def check_layout(layout: str) -> None:
    """Check that a layout exists, or raise a ValueError."""
    if layout not in LAYOUTS:
        raise ValueError(f"layout: expected one of {LAYOUTS}, got {layout!r}")


def check_filter(x: Tensor, weight: Tensor, layout: Layout) -> None:
    """Check the arguments of a filter.

    Raises:
        ValueError: The layout is unknown, or shapes or devices do not match.
        TypeError: A dtype is not supported, or the dtypes do not match.
    """
    check_layout(layout)
    check_tensor("x", x)
    if isinstance(weight, Tensor) and weight.is_complex():
        raise TypeError(
            "weight: expected real and imaginary part in a last axis, torch.view_as_real(weight),"
            f" got {weight.dtype}"
        )
    check_tensor("weight", weight)
    if weight.dtype not in (x.dtype, arithmetic_dtype(x.dtype)):
        expected = " or ".join(map(str, dict.fromkeys((x.dtype, arithmetic_dtype(x.dtype)))))
        raise TypeError(f"weight: expected {expected} for x of {x.dtype}, got {weight.dtype}")
    if weight.device != x.device:
        raise ValueError(f"weight: expected device {x.device}, that of x, got {weight.device}")
    if x.dim() < RANK[layout]:
        raise ValueError(
            f"x: layout {layout!r} expected at least {RANK[layout]} dimensions,"
            f" got shape {tuple(x.shape)}"
        )
    expected_shape = weight_shape(x.shape[-RANK[layout] :], layout)
    if weight.shape != expected_shape:
        raise ValueError(
            f"weight: layout {layout!r} expected shape {expected_shape} for x of shape"
            f" {tuple(x.shape)}, got {tuple(weight.shape)}"
        )


def check_out(x: Tensor, out: Tensor) -> None:
    """Check the tensor that a result is written to; raises as `check_filter`."""
    check_alike("out", out, "x", x)
    if not out.is_contiguous():
        raise ValueError(f"out: expected a contiguous tensor, got strides {out.stride()}")


def check_gradient(grad: Tensor, x: Tensor, weight: Tensor, layout: Layout) -> None:
    """Check the arguments of a filter's backward; raises as `check_filter`."""
    check_filter(x, weight, layout)
    check_alike("grad", grad, "x", x)
