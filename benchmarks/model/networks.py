"""The contenders of `python -m benchmarks attention`: ours, and with torch's attention or FFT.

The baselines differ in one layer each: one runs the forward of `torch.nn.MultiheadAttention`, which
in evaluation on CPUs writes the scores of all pairs of tokens to memory; one calls torch's
`scaled_dot_product_attention` and nothing else, as ours does without dropout; one filters by
``torch.fft``.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Literal, TypeVar, get_args

import torch
from torch import Tensor, nn
from torch.nn.functional import linear, scaled_dot_product_attention

from benchmarks.timing import Contender
from ffpose._internal.choices import FilterKind
from ffpose.bench.filter import DIMS, OURS, torch_filter
from ffpose.models import FilterformerPose
from ffpose.nn import GlobalFilter, SpectralFilter
from ffpose.nn.attention import SelfAttention

Task = Literal["inference", "training step"]
TASKS: tuple[Task, ...] = get_args(Task)

Precision = Literal["float32", "bfloat16"]
PRECISIONS: tuple[Precision, ...] = get_args(Precision)

Network = TypeVar("Network", bound=nn.Module)

BEFORE = "nn.MultiheadAttention"
SDPA = "plain SDPA"
FFT = "torch.fft"
BASELINES = (BEFORE, SDPA, FFT)
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
        filter: Of the network, in place of the preset's.
    """

    model: str
    batch: int
    task: Task = "inference"
    precision: Precision = "float32"
    threads: int = 1
    filter: FilterKind | None = None

    @property
    def name(self) -> str:
        """The network in words."""
        return self.model if self.filter is None else f"{self.model}, {self.filter} filters"

    @property
    def label(self) -> str:
        """The case in words, without threads."""
        return f"{self.name}, batch {self.batch}, {self.task}, {self.precision}"


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


class PlainAttention(BuiltInAttention):
    """Self-attention by torch's `scaled_dot_product_attention`, with torch's own dropout."""

    def forward(self, x: Tensor) -> Tensor:
        """Return ``(B, queries, dim)`` for ``x (B, N, dim)``, or ``(B, N, dim)`` for all."""
        attention = self.attention
        weights, biases = attention.in_proj_weight.chunk(3), attention.in_proj_bias.chunk(3)
        query, key, value = (
            linear(tokens, weight, bias)
            .view(*tokens.shape[:2], attention.num_heads, attention.head_dim)
            .transpose(1, 2)
            for tokens, weight, bias in zip(
                (x[:, : self.queries], x, x), weights, biases, strict=True
            )
        )  # each (B, heads, N, dim / heads)
        rate = attention.dropout if self.training else 0.0
        mixed = scaled_dot_product_attention(query, key, value, dropout_p=rate)
        result: Tensor = attention.out_proj(mixed.transpose(1, 2).flatten(2))
        return result


def with_attention(model: Network, kind: type[BuiltInAttention]) -> Network:
    """Return a copy of ``model`` whose attention is of a kind that runs torch alone."""
    model = copy.deepcopy(model)
    for parent in list(model.modules()):
        for name, child in parent.named_children():
            if isinstance(child, SelfAttention):
                replacement = kind(child.attention, child.queries).train(child.training)
                setattr(parent, name, replacement)
    return model


class TorchFftFilter(nn.Module):
    """A filter in ``torch.fft``, with the weight of one of ours.

    Args:
        filter: The filter whose place it takes.
    """

    def __init__(self, filter: SpectralFilter | GlobalFilter) -> None:
        super().__init__()
        self.grid: tuple[int, int] | None = None
        if isinstance(filter, GlobalFilter):
            self.weight, self.grid = filter.complex_weight, (filter.h, filter.h)
        else:
            self.weight = filter.weight
        layout = "grid" if isinstance(filter, GlobalFilter) else filter.layout
        self.dim = DIMS[layout]

    def forward(self, x: Tensor) -> Tensor:
        """Return the filtered ``x``, of its shape and type; bfloat16 torch.fft cannot compute."""
        wide = x.float() if x.dtype == torch.bfloat16 else x
        if self.grid is not None:
            wide = torch.unflatten(wide, 1, self.grid)
        return torch_filter(wide, self.weight, self.dim).view_as(x).to(x.dtype)


def with_torch_fft(model: Network) -> Network:
    """Return a copy of ``model`` whose spectral filters are in ``torch.fft``."""
    model = copy.deepcopy(model)
    for parent in list(model.modules()):
        for name, child in parent.named_children():
            if isinstance(child, SpectralFilter | GlobalFilter):
                setattr(parent, name, TorchFftFilter(child))
    return model


def network(name: str, filter: FilterKind | None = None) -> FilterformerPose:
    """Return the network of a preset with random weights, the same at each call."""
    fields = {} if filter is None else {"filter": filter}
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        return FilterformerPose.from_config(name, backbone_weights="none", **fields)


def networks(name: str, filter: FilterKind | None = None) -> dict[str, FilterformerPose]:
    """Return each contender's network of that name, with the same random weights."""
    ours = network(name, filter)
    return {
        OURS: ours,
        BEFORE: with_attention(ours, BuiltInAttention),
        SDPA: with_attention(ours, PlainAttention),
        FFT: with_torch_fft(ours),
    }


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
