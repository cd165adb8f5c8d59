"""What operators take: dtypes, checks of tensors, and batches of `torch.vmap`."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import torch
from torch import Tensor

HALF_DTYPES = (torch.bfloat16, torch.float16)
DTYPES = (torch.float32, torch.float64, *HALF_DTYPES)


def arithmetic_dtype(dtype: torch.dtype) -> torch.dtype:
    """Return the dtype of the arithmetic: float32 for half precision, else ``dtype`` itself."""
    return torch.float32 if dtype in HALF_DTYPES else dtype


def check_tensor(name: str, tensor: object) -> None:
    """Check that an argument is a tensor of one of `DTYPES`, or raise a TypeError."""
    if not isinstance(tensor, Tensor):
        raise TypeError(f"{name}: expected a torch.Tensor, got {type(tensor).__name__}")
    if tensor.dtype not in DTYPES:
        names = ", ".join(str(dtype) for dtype in DTYPES)
        raise TypeError(f"{name}: expected one of {names}, got {tensor.dtype}")
    if tensor.layout != torch.strided:
        raise TypeError(f"{name}: expected a strided tensor, got {tensor.layout}")


def check_alike(name: str, tensor: Tensor, like_name: str, like: Tensor) -> None:
    """Check that a tensor has the shape, dtype and device of another; raises as `check_filter`."""
    check_tensor(name, tensor)
    if tensor.dtype != like.dtype:
        raise TypeError(f"{name}: expected {like.dtype}, that of {like_name}, got {tensor.dtype}")
    if tensor.shape != like.shape:
        raise ValueError(
            f"{name}: expected shape {tuple(like.shape)}, that of {like_name},"
            f" got {tuple(tensor.shape)}"
        )
    if tensor.device != like.device:
        raise ValueError(
            f"{name}: expected device {like.device}, that of {like_name}, got {tensor.device}"
        )


def add(a: Tensor | None, b: Tensor | None) -> Tensor | None:
    """Return ``a + b``, with None as zero."""
    if a is None or b is None:
        return b if a is None else a
    return a + b


def unbatch(
    tensors: Sequence[Tensor], dims: Sequence[int | None], size: int
) -> Iterator[tuple[Tensor, ...]]:
    """Split tensors that `torch.vmap` batched, and yield the tensors of each sample.

    ``dims`` are the batch dimensions, None for a tensor that all samples share. If there are no
    samples, yield one of zeros, from whose result `rebatch` takes the shape.
    """
    columns = (
        [tensor] * max(size, 1) if dim is None else tensor.unbind(dim) or [tensor.sum(dim)]
        for tensor, dim in zip(tensors, dims, strict=False)
    )
    return zip(*columns, strict=True)


def rebatch(results: Sequence[Tensor], size: int) -> Tensor:
    """Stack the results of the ``size`` samples of `unbatch` along a new first dimension."""
    return torch.stack(tuple(results))[:size]
