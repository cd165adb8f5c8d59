"""What `ffpose bench model` can measure: a pose network of a preset or of weights, or `gfnet`."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor, nn

from ffpose.bench.model.gfnet import GlobalFilterNetwork
from ffpose.bench.model.networks import networks
from ffpose.config import CONFIGS
from ffpose.models import FilterformerPose, read_metadata
from ffpose.nn import GlobalFilter, SpectralFilter
from ffpose.nn.filterformer import SelfAttention
from ffpose.onnx.metadata import Filter
from ffpose.onnx.pose_graph import graph_entries, output_names, random_images
from ffpose.preprocessing import Preprocessing

GFNET = "gfnet"


@dataclass(frozen=True)
class Subject:
    """A network, and what is needed to measure and to export it.

    Attributes:
        model: In evaluation mode.
        preprocessing: Of its images.
        weights: File or name of a pose network's weights; None for a network that gives no pose.
        entries: Gives the metadata of a graph, for how it computes its filters.
        outputs: Names of the outputs, in order.
    """

    model: nn.Module
    preprocessing: Preprocessing
    weights: Path | None
    entries: Callable[[Filter], Mapping[str, str]]
    outputs: Sequence[str]

    @property
    def has_filters(self) -> bool:
        """Whether there is a spectral filter in it."""
        return self._has(SpectralFilter, GlobalFilter)

    @property
    def has_attention(self) -> bool:
        """Whether there is self-attention in it."""
        return self._has(SelfAttention)

    def images(self, batch: int) -> Tensor:
        """Return images ``(batch, 3, H, W)`` of random patches, always the same."""
        return random_images(self.preprocessing, batch)

    def _has(self, *kinds: type[nn.Module]) -> bool:
        return any(isinstance(module, kinds) for module in self.model.modules())


def subject(name: str, folder: Path) -> Subject:
    """Return the network of that name.

    Args:
        name: ``"gfnet"``, a preset of `ffpose.config.CONFIGS`, whose weights are then random, or a
            weights file or name.
        folder: Where random weights are written.

    Raises:
        FileNotFoundError: No such network or weights.
        ffpose.DataError: The weights cannot be used.
    """
    if name == GFNET:
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(0)
            model = GlobalFilterNetwork().eval()
        return Subject(model, Preprocessing(model.image_size), None, lambda _: {}, ["logits"])
    weights = Path(name)
    if name in CONFIGS:
        weights = folder / f"{name}.safetensors"
        random = next(iter(networks(name).values()))
        random.save_pretrained(weights)
    source = read_metadata(weights)
    return Subject(
        FilterformerPose.from_pretrained(weights),
        source.preprocessing,
        weights,
        graph_entries(weights),
        output_names(source.config),
    )
