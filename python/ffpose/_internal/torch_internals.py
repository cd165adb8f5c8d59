"""Everything that ffpose asks of torch's private names, which may go without notice.

Each is looked up once. Without it a slower way gives the same numbers: calls go through the
dispatcher, or a training does without bfloat16. Only five things
are lost: `torch.vmap` of the bare operators ``torch.ops.ffpose``, forward-mode derivatives of
forward-mode derivatives, the filter's name in profiles of inference, saving an exported program
whose result is a named tuple, and ONNX graphs of modules that `torch.compile` returned.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from typing import Any, TypeVar, cast

import torch
from torch import Tensor
from torch.autograd import forward_ad
from torch.compiler import is_compiling
from torch.nn import Module, Parameter

Result = TypeVar("Result")


def _find(module: str, name: str) -> Any:
    """Return a private name of a module of torch, or None where this torch has none."""
    try:
        return getattr(importlib.import_module(module), name, None)
    except ModuleNotFoundError:
        return None


_bfloat16_products = (
    _find("torch.cpu", "_is_avx512_bf16_supported"),
    _find("torch.cpu", "_is_amx_tile_supported"),
)
_below_autograd = _find("torch._C", "_AutoDispatchBelowAutograd")
_dispatch_keys = _find("torch._C", "_dispatch_keys")
_dispatch_modes = _find("torch._C", "_len_torch_dispatch_stack")
_forward_mode_enabled = _find("torch.autograd.forward_ad", "_set_fwd_grad_enabled")
_profiler_enabled = _find("torch.autograd", "_profiler_enabled")
_register_named_tuple = _find("torch.utils._pytree", "_register_namedtuple")
_transforms_active = _find("torch._C", "_are_functorch_transforms_active")
_tracing_state = _find("torch._C", "_get_tracing_state") or _find("torch.jit", "is_tracing")


def _plain_keys() -> frozenset[int]:
    """Return the dispatch keys of ordinary CPU tensors, outside and inside inference mode."""
    if None in (_dispatch_keys, _dispatch_modes, getattr(forward_ad, "_current_level", None)):
        return frozenset()  # nothing is known to be plain
    tensor = torch.empty(0, device="cpu")
    with torch.inference_mode():
        of_inference = torch.empty(0, device="cpu")
    return frozenset(_dispatch_keys(each).raw_repr() for each in (tensor, of_inference))


_unpack: Callable[[Tensor], Any] = forward_ad.unpack_dual  # torch annotates nothing of it
_PLAIN_KEYS = _plain_keys()
_PLAIN_TYPES = frozenset((Tensor, Parameter)) if _PLAIN_KEYS else frozenset()


def is_plain(*tensors: Tensor) -> bool:
    """Return whether Rust may be called directly, as the dispatcher costs more than a small call.

    False for anything but ordinary CPU tensors (tensor subclasses, fake tensors, tensors batched by
    vmap or tracked by `torch.func`), and while operators are being recorded: by ``torch.compile``,
    ``torch.export``, ``torch.jit.trace``, forward-mode differentiation or a dispatch mode. Whether
    a gradient is required is not considered.
    """
    if not _PLAIN_KEYS or is_compiling() or _dispatch_modes() or _tracing_state():
        return False
    if forward_ad._current_level >= 0:
        return False
    for tensor in tensors:
        if type(tensor) not in _PLAIN_TYPES or _dispatch_keys(tensor).raw_repr() not in _PLAIN_KEYS:
            return False
    return True


def is_recording() -> bool:
    """Return whether torch.compile, torch.export or torch.jit.trace is recording a graph."""
    return bool(is_compiling() or _tracing_state())


def is_profiled() -> bool:
    """Return whether `torch.profiler` is at work, which sees only what the dispatcher calls."""
    return _profiler_enabled is not None and bool(_profiler_enabled())


def transforms_at_work() -> bool:
    """Return whether a transform of `torch.func` is active, which records in its own way."""
    return _transforms_active is None or bool(_transforms_active())


def below_autograd(operator: Callable[..., Result], *args: Any, **kwargs: Any) -> Result:
    """Call an operator without autograd, by the device's kernel.

    Inference mode skips autograd too, but autograd cannot save its tensors: they are copied.
    """
    if _below_autograd is not None:
        with _below_autograd():
            return operator(*args, **kwargs)
    with torch.inference_mode():
        result: Any = operator(*args, **kwargs)
    if isinstance(result, tuple):
        result = tuple(each.clone() for each in result)
    elif result is not None:
        result = result.clone()
    return cast("Result", result)


def outer_tangents() -> AbstractContextManager[None]:
    """Return a context in which the ``jvp`` of a function follows forward mode of outer levels.

    torch calls ``jvp`` with forward mode off, so that a derivative nested in another one would lose
    its tangent without a word (https://github.com/pytorch/pytorch/issues/197867). With it on, the
    saved tensors still carry the tangents of their own level: take their `primals`.
    """
    if _forward_mode_enabled is None:
        return nullcontext()
    return cast("AbstractContextManager[None]", _forward_mode_enabled(True))


def primals(tensors: Sequence[Tensor]) -> tuple[Tensor, ...]:
    """Return tensors without their tangents of the present level of forward mode."""
    return tuple(_unpack(tensor).primal for tensor in tensors)


def have_tangent(*tensors: Tensor) -> bool:
    """Return whether one of the tensors has a tangent of the present level of forward mode."""
    return any(_unpack(tensor).tangent is not None for tensor in tensors)


def register_named_tuple(kind: type[tuple[Any, ...]], name: str) -> None:
    """Let saved programs (`torch.export.save`) refer to a named tuple by ``name``."""
    if _register_named_tuple is not None:
        _register_named_tuple(kind, serialized_type_name=name)


def uncompiled(module: Module) -> Module:
    """Return the module that `torch.compile` was given, or the one that is not of it."""
    original: Module = getattr(module, "_orig_mod", module)
    return original


def multiplies_bfloat16() -> bool:
    """Return whether this processor is known to have instructions for products of bfloat16."""
    return any(bool(has()) for has in _bfloat16_products if has is not None)


def constant(values: Sequence[Any]) -> Tensor:
    """Return a tensor for a module's constant, whatever mode and device its import happens in.

    An inference tensor could not be saved for backward, and one of ``meta`` has no values.
    """
    with torch.inference_mode(mode=False), torch.device("cpu"):
        return torch.tensor(values)
