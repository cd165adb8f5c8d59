"""Networks in torch, behind the interface of the other backends."""

from __future__ import annotations

import os
import threading
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import torch
from numpy.typing import NDArray
from torch import nn

from ffpose.models import find_device


class TorchSession:
    """A network in torch (`ffpose.onnx.backends.Session`), put in evaluation mode on a device.

    The model returns a named tuple of tensors. ``threads`` is the number within an image on the
    CPU; as torch has one for the whole process, it is restored after each run. A forked child runs
    on one thread, whatever the number (`torch_threads`).

    Raises:
        ValueError: Torch does not find the device, or the number of threads is below one.
    """

    def __init__(self, model: nn.Module, device: str = "auto", threads: int | None = None) -> None:
        if threads is not None and threads < 1:
            raise ValueError(f"threads: expected at least 1, got {threads}")
        self.device = find_device(device)
        self.model = model.eval().to(self.device)
        self.threads = threads

    def run(self, *inputs: NDArray[Any]) -> dict[str, NDArray[Any]]:
        """Return the network's outputs by name, for its inputs in order."""
        tensors = [torch.from_numpy(each).to(self.device) for each in inputs]
        with torch_threads(self.threads), torch.inference_mode():
            outputs = self.model(*tensors)._asdict()
        return {name: values.cpu().numpy() for name, values in outputs.items()}


@dataclass
class _Process:
    """What this process has asked of torch's threads.

    Attributes:
        lock: Of ``blocks`` and ``outside``.
        blocks: How many blocks of `torch_threads` each Python thread is in, where it is in any.
        outside: Torch's number of threads before the first of these blocks.
        forked: Whether another process was forked to make this one.
        warned: Whether it has warned of that.
    """

    lock: threading.Lock = field(default_factory=threading.Lock)
    blocks: dict[int, int] = field(default_factory=dict)
    outside: int = 1
    forked: bool = False
    warned: bool = False

    def fork(self) -> None:
        """Become a child's: with the blocks, and the lock, of the one thread that it has."""
        me = threading.get_ident()
        self.lock, self.forked = threading.Lock(), True
        self.blocks = {thread: blocks for thread, blocks in self.blocks.items() if thread == me}

    def enter(self, count: int) -> int:
        """Let torch use ``count`` threads; return the number to `leave` with."""
        me = threading.get_ident()
        with self.lock:
            before = torch.get_num_threads()
            if not self.blocks:
                self.outside = before
            elif me not in self.blocks:
                before = self.outside  # torch may tell the number of another thread's block
            self.blocks[me] = self.blocks.get(me, 0) + 1
            torch.set_num_threads(count)
        return before

    def leave(self, before: int) -> None:
        """Restore the number of threads; the last block of a thread leaves that outside of all."""
        me = threading.get_ident()
        with self.lock:
            self.blocks[me] -= 1
            if not self.blocks[me]:
                del self.blocks[me]
                before = self.outside
            torch.set_num_threads(before)


_PROCESS = _Process()
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_PROCESS.fork)


@contextmanager
def torch_threads(count: int | None) -> Iterator[None]:
    """Let torch use ``count`` threads within the block; None leaves their number alone.

    It is one for the process: threads that run networks with counts of their own see each other's.
    After the last of them it is what it was before the first.

    In a forked child it is one thread, with a `RuntimeWarning` the first time that this is fewer
    than asked for: where the parent has used several, torch waits in the child for ever for
    threads that only the parent has.
    """
    count = _possible(count)
    if count is None:
        yield
        return
    before = _PROCESS.enter(count)
    try:
        yield
    finally:
        _PROCESS.leave(before)


def _possible(count: int | None) -> int | None:
    """Return the number of threads that this process can have where ``count`` is asked for."""
    if not _PROCESS.forked:
        return count
    asked = torch.get_num_threads() if count is None else count
    if asked > 1 and not _PROCESS.warned:
        _PROCESS.warned = True
        warnings.warn(
            f"torch uses 1 thread in a forked process, not {asked}: it could wait forever for "
            "threads of the parent; for more, start processes with the method 'spawn' or "
            "'forkserver', or load the network with backend='onnxruntime'",
            RuntimeWarning,
            stacklevel=4,
        )
    return 1
