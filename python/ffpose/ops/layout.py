"""The spectral filter's two layouts: what is transformed, and what shape the weight has.

Every check of a filter's arguments is here, so that each way to the operator refuses the same
things in the same words.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal, get_args

from torch import Tensor

from ffpose.ops.bridge import arithmetic_dtype, check_alike, check_tensor

Layout = Literal["tokens", "grid"]
LAYOUTS: tuple[Layout, ...] = get_args(Layout)

RANK = {"tokens": 2, "grid": 3}
"""Dimensions of one image, the batch left out."""

PLANE = {"tokens": (-2, -1), "grid": (-3, -2)}
"""The two dimensions that are transformed."""


def weight_shape(size: Sequence[int], layout: Layout) -> tuple[int, ...]:
    """Return the shape of the weight for images of one shape.

    Args:
        size: ``(X, Y)`` in layout ``"tokens"``, ``(H, W, C)`` in layout ``"grid"``.
        layout: ``"tokens"`` or ``"grid"``.

    Returns:
        ``(X, Y//2+1, 2)`` or ``(H, W//2+1, C, 2)``.

    Raises:
        ValueError: An unknown layout, or not as many sizes as it has.

    Example:
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
    """Refuse a layout that there is not.

    Raises:
        ValueError: It is none of `LAYOUTS`.
    """
    if layout not in LAYOUTS:
        raise ValueError(f"layout: expected one of {LAYOUTS}, got {layout!r}")


def check_filter(x: Tensor, weight: Tensor, layout: Layout) -> None:
    """Refuse arguments of a filter that do not fit together.

    Raises:
        ValueError: A rank, size, device or layout that does not fit.
        TypeError: A dtype that does not fit.
    """
    check_layout(layout)
    check_tensor("x", x)
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


def check_gradient(grad: Tensor, x: Tensor, weight: Tensor, layout: Layout) -> None:
    """Refuse arguments of a filter's backward that do not fit; raises as `check_filter`."""
    check_filter(x, weight, layout)
    check_alike("grad", grad, "x", x)
