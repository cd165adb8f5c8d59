"""Networks in torch, behind the interface of the other backends."""

from __future__ import annotations

import os
import threading
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from ffpose._internal.locks import fork_safe_lock
from ffpose.errors import expect
from ffpose.models import find_device


class TorchSession:
    """A network in torch (`ffpose.onnx.backends.Session`), put in evaluation mode on a device.

    The model returns a named tuple of tensors. ``threads`` is the number within an image on the
    CPU; as torch has one for the whole process, it is restored after each run. It is one in a child
    forked from a process that has this module, whatever the number (`torch_threads`).

    Raises:
        ValueError: Torch does not find the device, or the number of threads is below one.
    """

    def __init__(self, model: nn.Module, device: str = "auto", threads: int | None = None) -> None:
        expect(threads is None or threads >= 1, "threads", "at least 1", threads)
        self.device = find_device(device)
        self.model = model.eval().to(self.device)
        self.threads = threads

    def run(self, *inputs: NDArray[Any]) -> dict[str, NDArray[Any]]:
        """Return the network's outputs by name, for its inputs in order."""
        # Torch takes no arrays of negative strides, and warns of those that are read-only.
        arrays = [np.require(each, requirements=["C", "W"]) for each in inputs]
        tensors = [torch.from_numpy(each).to(self.device) for each in arrays]
        with torch_threads(self.threads), torch.inference_mode():
            outputs = self.model(*tensors)._asdict()
        return {name: values.cpu().numpy() for name, values in outputs.items()}


class _Own(threading.local):
    """How many blocks of `torch_threads` a Python thread is in."""

    blocks = 0


@dataclass
class _Threads:
    """Torch's number of threads, of which a process has one.

    Attributes:
        lock: Of ``blocks`` and ``outside``.
        blocks: How many blocks of `torch_threads` there are now, in all Python threads.
        own: Those of a thread.
        outside: The number before the first of them.
        forked: Whether another process was forked to make this one.
    """

    lock: threading.Lock = field(default_factory=fork_safe_lock)
    blocks: int = 0
    own: _Own = field(default_factory=_Own)
    outside: int = 1
    forked: bool = False

    def begin(self, count: int) -> int:
        """Begin a block with ``count`` threads; return the number to `end` it with."""
        with self.lock:
            before = torch.get_num_threads()
            if self.blocks == 0:
                self.outside = before
            elif self.own.blocks == 0:
                before = self.outside  # torch may tell the number of another thread's block
            self.blocks += 1
            self.own.blocks += 1
            torch.set_num_threads(count)
        return before

    def end(self, before: int) -> None:
        """End a block."""
        with self.lock:
            self.blocks -= 1
            self.own.blocks -= 1
            torch.set_num_threads(1 if self.forked else before)

    def fork(self) -> None:
        """Become a forked child's, which lacks the threads of torch's pool.

        Torch would hang, even where it copies weights.
        """
        self.forked = True
        torch.set_num_threads(1)


_THREADS = _Threads()

if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_THREADS.fork)


@contextmanager
def torch_threads(count: int | None) -> Iterator[None]:
    """Let torch use ``count`` threads within the block; None leaves their number alone.

    It is one for the process: threads that run networks with counts of their own see each other's.
    After the last of them it is what it was before the first. In a child forked from a process that
    has imported this module it is 1, with a `RuntimeWarning` where ``count`` is greater.
    """
    if count is None:
        yield
        return
    if _THREADS.forked and count > 1:
        warnings.warn(
            f"torch uses 1 thread in a forked process, not {count}: it could wait forever for "
            "threads of the parent; for more, start processes with the method 'spawn' or "
            "'forkserver', or load the network with backend='onnxruntime'",
            RuntimeWarning,
            stacklevel=4,
        )
        count = 1
    before = _THREADS.begin(count)
    try:
        yield
    finally:
        _THREADS.end(before)
