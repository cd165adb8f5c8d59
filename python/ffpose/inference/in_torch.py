"""Networks in torch, behind the interface of the other backends."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import torch
from numpy.typing import NDArray
from torch import nn

from ffpose.models import find_device


class TorchSession:
    """A network in torch (`ffpose.onnx.backends.Session`), put in evaluation mode on a device.

    The model returns a named tuple of tensors. ``threads`` is the number within an image on the
    CPU; as torch has one for the whole process, it is restored after each run.

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


@contextmanager
def torch_threads(count: int | None) -> Iterator[None]:
    """Let torch use ``count`` threads within the block; None leaves their number alone.

    It is one for the process: threads that run networks with counts of their own see each other's.
    """
    before = torch.get_num_threads()
    if count is None or count == before:
        yield
        return
    torch.set_num_threads(count)
    try:
        yield
    finally:
        torch.set_num_threads(before)
