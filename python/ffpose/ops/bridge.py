"""Conversion between torch tensors and NumPy arrays of the Rust core, and checks of tensors."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager
from typing import Any, cast

import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.autograd import forward_ad
from torch.compiler import is_compiling
from torch.nn import Parameter

HALF_DTYPES = (torch.bfloat16, torch.float16)
DTYPES = (torch.float32, torch.float64, *HALF_DTYPES)


def arithmetic_dtype(dtype: torch.dtype) -> torch.dtype:
    """Return the dtype of the arithmetic: float32 for half precision, else ``dtype`` itself."""
    return torch.float32 if dtype in HALF_DTYPES else dtype


def check_tensor(name: str, tensor: object) -> None:
    """Check that an argument is a real floating-point tensor.

    Raises:
        TypeError: ``tensor`` is not a tensor, or its dtype is not in `DTYPES`.
    """
    if not isinstance(tensor, Tensor):
        raise TypeError(f"{name}: expected a torch.Tensor, got {type(tensor).__name__}")
    if tensor.dtype not in DTYPES:
        names = ", ".join(str(dtype) for dtype in DTYPES)
        raise TypeError(f"{name}: expected one of {names}, got {tensor.dtype}")


def check_alike(name: str, tensor: Tensor, like_name: str, like: Tensor) -> None:
    """Check that a tensor has the shape, dtype and device of another.

    Raises:
        ValueError: Shape or device differ.
        TypeError: The dtype differs, or ``tensor`` is not a tensor.
    """
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


def is_plain(*tensors: Tensor) -> bool:
    """Return whether Rust may be called directly, as the dispatcher costs more than a small call.

    False for anything but ordinary CPU tensors (tensor subclasses, fake tensors, tensors batched by
    vmap or tracked by `torch.func`), and while operators are being recorded: by ``torch.compile``,
    ``torch.export``, ``torch.jit.trace``, forward-mode differentiation or a dispatch mode. Whether
    a gradient is required is not considered.
    """
    if is_compiling() or _dispatch_modes() or _tracing_state() or forward_ad._current_level >= 0:
        return False
    for tensor in tensors:
        if type(tensor) not in _PLAIN_TYPES or _dispatch_keys(tensor).raw_repr() not in _PLAIN_KEYS:
            return False
    return True


def is_recording() -> bool:
    """Return whether torch.compile, torch.export or torch.jit.trace is recording a graph."""
    return bool(is_compiling() or _tracing_state())


def transforms_at_work() -> bool:
    """Return whether a transform of `torch.func` is active, which records in its own way."""
    return torch._C._are_functorch_transforms_active()


def _plain_keys() -> frozenset[int]:
    """Return the dispatch keys of ordinary CPU tensors, outside and inside inference mode."""
    tensor = torch.empty(0, device="cpu")
    with torch.inference_mode():
        of_inference = torch.empty(0, device="cpu")
    return frozenset(_dispatch_keys(each).raw_repr() for each in (tensor, of_inference))


_dispatch_keys = torch._C._dispatch_keys
_dispatch_modes = torch._C._len_torch_dispatch_stack
_tracing_state = torch._C._get_tracing_state
_PLAIN_KEYS = _plain_keys()
_PLAIN_TYPES = frozenset((Tensor, Parameter))


def to_array(tensor: Tensor) -> NDArray[Any]:
    """Return a C-contiguous array of the arithmetic dtype, copied only if necessary."""
    if tensor.dtype in HALF_DTYPES:
        tensor = tensor.float()
    return tensor.contiguous().numpy(force=True)


def to_tensor(array: NDArray[Any], dtype: torch.dtype) -> Tensor:
    """Return a tensor of ``dtype``, which shares the array's memory if the dtypes are equal."""
    tensor = torch.from_numpy(array)
    return tensor.to(dtype) if dtype in HALF_DTYPES else tensor


def below_autograd() -> AbstractContextManager[None]:
    """Return a context in which operators skip autograd and dispatch to the device's kernel."""
    return cast("AbstractContextManager[None]", torch._C._AutoDispatchBelowAutograd())


def add(a: Tensor | None, b: Tensor | None) -> Tensor | None:
    """Return ``a + b``, with None as zero."""
    if a is None or b is None:
        return b if a is None else a
    return a + b


def unbatch(
    tensors: Sequence[Tensor], dims: Sequence[int | None], size: int
) -> Iterator[tuple[Tensor, ...]]:
    """Split tensors that `torch.vmap` batched, and yield the tensors of each sample.

    If there are no samples, yield one of zeros, from whose result `rebatch` takes the shape.

    Args:
        tensors: Tensors batched over the samples.
        dims: Batch dimension of each tensor; None for a tensor that all samples share.
        size: Number of samples.
    """
    columns = (
        [tensor] * max(size, 1) if dim is None else tensor.unbind(dim) or [tensor.sum(dim)]
        for tensor, dim in zip(tensors, dims, strict=False)
    )
    return zip(*columns, strict=True)


def rebatch(results: Sequence[Tensor], size: int) -> Tensor:
    """Stack the results of the ``size`` samples of `unbatch` along a new first dimension."""
    return torch.stack(tuple(results))[:size]
