"""The contenders of `ffpose bench model attention`: a network with our attention, and with torch's.

The baseline differs in one layer: it runs the forward of `torch.nn.MultiheadAttention`, which in
evaluation on CPUs writes the scores of all pairs of tokens to memory.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Literal, TypeVar, get_args

import torch
from torch import Tensor, nn

from ffpose.bench.timing import OURS, Contender
from ffpose.models import FilterformerPose
from ffpose.nn.filterformer import SelfAttention

Task = Literal["inference", "training step"]
TASKS: tuple[Task, ...] = get_args(Task)

Precision = Literal["float32", "bfloat16"]
PRECISIONS: tuple[Precision, ...] = get_args(Precision)

Network = TypeVar("Network", bound=nn.Module)

BEFORE = "nn.MultiheadAttention"
APART = 1e-4
"""Largest difference of float32 poses, relative to the largest value, that counts as equal."""


@dataclass(frozen=True)
class NetworkCase:
    """A benchmark case of a network.

    Attributes:
        model: A name in `ffpose.config.CONFIGS`.
        batch: Images per batch.
        task: ``"inference"``: images to poses; ``"training step"``: forward, backward and AdamW.
        precision: ``"bfloat16"`` is autocast; parameters stay float32.
        threads: Number of torch's threads.
    """

    model: str
    batch: int
    task: Task = "inference"
    precision: Precision = "float32"
    threads: int = 1

    @property
    def label(self) -> str:
        """The case in words, without threads."""
        return f"{self.model}, batch {self.batch}, {self.task}, {self.precision}"


class BuiltInAttention(nn.Module):
    """Self-attention that calls the forward of ``nn.MultiheadAttention``."""

    def __init__(self, attention: nn.MultiheadAttention, queries: int | None) -> None:
        super().__init__()
        self.attention = attention
        self.queries = queries

    def forward(self, x: Tensor) -> Tensor:
        """Return ``(B, queries, dim)`` for ``x (B, N, dim)``, or ``(B, N, dim)`` for all."""
        query = x if self.queries is None else x[:, : self.queries]
        result: Tensor = self.attention(query, x, x, need_weights=False)[0]
        return result


def with_built_in_attention(model: Network) -> Network:
    """Return a copy of ``model`` whose attention is torch's."""
    model = copy.deepcopy(model)
    for parent in list(model.modules()):
        for name, child in parent.named_children():
            if isinstance(child, SelfAttention):
                setattr(parent, name, BuiltInAttention(child.attention, child.queries))
    return model


def networks(name: str) -> dict[str, FilterformerPose]:
    """Return each contender's network of that name, with the same random weights."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        ours = FilterformerPose.from_config(name, backbone_weights="none")
    return {OURS: ours, BEFORE: with_built_in_attention(ours)}


def random_images(model: FilterformerPose, batch: int) -> Tensor:
    """Return normal random images ``(batch, 3, H, W)``, the same for each contender."""
    generator = torch.Generator().manual_seed(0)
    return torch.randn(batch, 3, *model.config.image_size, generator=generator)


def largest_difference(models: Mapping[str, FilterformerPose], images: Tensor) -> float:
    """Return the largest difference of poses from ours, relative to the largest value.

    Raises:
        RuntimeError: The difference is larger than `APART`.
    """
    with torch.inference_mode():
        poses = {name: torch.cat(model.eval()(images), 1) for name, model in models.items()}
    largest = 0.0
    for name, pose in poses.items():
        difference = float((pose - poses[OURS]).abs().max() / poses[OURS].abs().max())
        if not difference < APART:
            raise RuntimeError(f"the poses by {name} differ from ffpose's by {difference:.1e}")
        largest = max(largest, difference)
    return largest


def contender(model: FilterformerPose, images: Tensor, case: NetworkCase) -> Contender:
    """Return the contender that runs one call; a training step changes the weights of ``model``."""
    return Contender(
        _training_step(model, images, case)
        if case.task == "training step"
        else _inference(model, images, case)
    )


def _inference(model: FilterformerPose, images: Tensor, case: NetworkCase) -> Callable[[], object]:
    model.eval()

    def call() -> None:
        with torch.inference_mode(), _autocast(case):
            model(images)

    return call


def _training_step(
    model: FilterformerPose, images: Tensor, case: NetworkCase
) -> Callable[[], object]:
    model.train()
    optimizer = torch.optim.AdamW(model.parameters(), lr=1e-5)

    def call() -> None:
        optimizer.zero_grad(set_to_none=True)
        with _autocast(case):
            pose = model(images)
        loss = pose.translation.square().mean() + pose.orientation.square().mean()
        torch.autograd.backward(loss)
        optimizer.step()

    return call


def _autocast(case: NetworkCase) -> torch.autocast:
    return torch.autocast("cpu", torch.bfloat16, enabled=case.precision == "bfloat16")
