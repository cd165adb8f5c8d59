"""Between torch tensors and the NumPy arrays of the Rust core."""

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
    """Return the dtype that is computed in: float32 for half precision, else ``dtype`` itself."""
    return torch.float32 if dtype in HALF_DTYPES else dtype


def check_tensor(name: str, tensor: object) -> None:
    """Refuse what is no real floating-point tensor.

    Raises:
        TypeError: Not a tensor, or of a dtype outside `DTYPES`.
    """
    if not isinstance(tensor, Tensor):
        raise TypeError(f"{name}: expected a torch.Tensor, got {type(tensor).__name__}")
    if tensor.dtype not in DTYPES:
        names = ", ".join(str(dtype) for dtype in DTYPES)
        raise TypeError(f"{name}: expected one of {names}, got {tensor.dtype}")


def check_alike(name: str, tensor: Tensor, like_name: str, like: Tensor) -> None:
    """Refuse a tensor whose shape, dtype or device is not another's.

    Raises:
        ValueError: Shape or device differ.
        TypeError: The dtype differs, or it is no tensor.
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
    """Whether Rust may be called at once: the dispatcher costs more than a small call.

    Not so for what is not simply numbers in the CPU's memory (no tensor, of a subclass, fake,
    batched by vmap, tracked by `torch.func`), nor while someone else records what happens:
    ``torch.compile`` and ``torch.export``, ``torch.jit.trace``, forward-mode derivatives, a
    dispatch mode. Whether a gradient is asked for is another question.
    """
    if is_compiling() or _dispatch_modes() or _tracing_state() or forward_ad._current_level >= 0:
        return False
    for tensor in tensors:
        if type(tensor) not in _PLAIN_TYPES or _dispatch_keys(tensor).raw_repr() not in _PLAIN_KEYS:
            return False
    return True


def is_recording() -> bool:
    """Whether a graph of operators is recorded: torch.compile, torch.export, torch.jit.trace."""
    return bool(is_compiling() or _tracing_state())


def transforms_at_work() -> bool:
    """Whether `torch.func` is at work, which records by rules of its own."""
    return torch._C._are_functorch_transforms_active()


def _plain_keys() -> frozenset[int]:
    """Return the dispatch keys of CPU tensors that nothing else has a hand in."""
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
    """Return a C-contiguous array of the arithmetic dtype; a copy only where it must be."""
    if tensor.dtype in HALF_DTYPES:
        tensor = tensor.float()
    return tensor.contiguous().numpy(force=True)


def to_tensor(array: NDArray[Any], dtype: torch.dtype) -> Tensor:
    """Return a tensor of ``dtype``; shares memory where that is the array's own."""
    tensor = torch.from_numpy(array)
    return tensor.to(dtype) if dtype in HALF_DTYPES else tensor


def below_autograd() -> AbstractContextManager[None]:
    """Within it operators go to their device's kernel, past the one that records for autograd."""
    return cast("AbstractContextManager[None]", torch._C._AutoDispatchBelowAutograd())


def add(a: Tensor | None, b: Tensor | None) -> Tensor | None:
    """Return ``a + b`` where None is zero."""
    if a is None or b is None:
        return b if a is None else a
    return a + b


def unbatch(
    tensors: Sequence[Tensor], dims: Sequence[int | None], size: int
) -> Iterator[tuple[Tensor, ...]]:
    """Take apart what `torch.vmap` batched: yield the tensors of each of ``size`` samples.

    Where there is no sample, yield one of zeros: `rebatch` reads shapes off its result.

    Args:
        tensors: Of the samples together.
        dims: For each tensor, the dimension that counts the samples; None where all share it.
        size: How many samples.
    """
    columns = (
        [tensor] * max(size, 1) if dim is None else tensor.unbind(dim) or [tensor.sum(dim)]
        for tensor, dim in zip(tensors, dims, strict=False)
    )
    return zip(*columns, strict=True)


def rebatch(results: Sequence[Tensor], size: int) -> Tensor:
    """Put together the results of the ``size`` samples that `unbatch` gave, counted first."""
    return torch.stack(tuple(results))[:size]
