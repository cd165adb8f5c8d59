"""Networks that `python -m benchmarks model` measures: of a preset or of weights, or `gfnet`.

The last is a network of a user's kind: global filters between small perceptrons, after Rao et al.,
"Global Filter Networks for Image Classification", NeurIPS 2021, GFNet-Ti: patches of 16x16 pixels,
12 blocks on 14x14 tokens of 256 channels, the mean of which is classified. Layer scale and
stochastic depth, which cost nothing at inference, are left out.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import torch
from safetensors.torch import load_file
from torch import Tensor, nn

from ffpose._internal.zoo import resolve
from ffpose.bench.model import weights_of
from ffpose.imaging.preprocessing import Preprocessing
from ffpose.models import open_weights, read_metadata
from ffpose.models.weights import write_weights
from ffpose.nn import GlobalFilter, PositionCode, SpectralFilter
from ffpose.nn.attention import SelfAttention
from ffpose.onnx.metadata import Filter
from ffpose.onnx.pose_graph import graph_entries, output_names, random_images

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


def subject(name: str, folder: Path, **fields: int) -> Subject:
    """Return the network of that name.

    Args:
        name: ``"gfnet"``, or as `ffpose.bench.model.weights_of`.
        folder: Where random or changed weights are written.
        **fields: Fields of the network to change, as in `ffpose.models.load_network`.

    Raises:
        FileNotFoundError: No such network or weights.
        ValueError: A field cannot be changed.
        ffpose.DataError: The weights cannot be used.
    """
    if name == GFNET and fields:
        raise ValueError(
            f"{GFNET}: expected no fields of a network with a second look, got {fields}"
        )
    if name == GFNET:
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(0)
            classifier = GlobalFilterNetwork().eval()
        return Subject(
            classifier, Preprocessing(classifier.image_size), None, lambda _: {}, ["logits"]
        )
    weights = weights_of(name, folder)
    if fields:
        source = read_metadata(weights)
        state = load_file(resolve(weights))
        weights = folder / "changed.safetensors"
        write_weights(weights, state, replace(source, config=source.config.at_inference(fields)))
    model, source = open_weights(weights)
    return Subject(
        model,
        source.preprocessing,
        weights,
        graph_entries(weights, source),
        output_names(source.config),
    )


IMAGE_SIZE = (224, 224)
PATCH = 16
DIM = 256
DEPTH = 12
CLASSES = 1000


class GlobalFilterBlock(nn.Module):
    """Filter and perceptron, with one residual around both: ``x + mlp(norm(filter(norm(x))))``."""

    def __init__(self, grid: tuple[int, int], dim: int) -> None:
        super().__init__()
        rows, columns = grid
        self.norm1, self.norm2 = nn.LayerNorm(dim), nn.LayerNorm(dim)
        self.filter = GlobalFilter(dim, h=rows, w=columns // 2 + 1)
        self.mlp = nn.Sequential(nn.Linear(dim, 4 * dim), nn.GELU(), nn.Linear(4 * dim, dim))

    def forward(self, x: Tensor) -> Tensor:
        """Return ``(B, rows * columns, dim)`` for ``x`` of that shape."""
        result: Tensor = x + self.mlp(self.norm2(self.filter(self.norm1(x))))
        return result


class GlobalFilterNetwork(nn.Module):
    """Image classifier of global filters.

    Args:
        image_size: ``(height, width)``, square, multiples of `PATCH`.
        dim: Channels of the tokens.
        depth: Number of blocks.
        classes: Number of classes.
    """

    def __init__(
        self,
        image_size: tuple[int, int] = IMAGE_SIZE,
        dim: int = DIM,
        depth: int = DEPTH,
        classes: int = CLASSES,
    ) -> None:
        super().__init__()
        self.image_size = image_size
        grid = (image_size[0] // PATCH, image_size[1] // PATCH)
        self.patches = nn.Conv2d(3, dim, kernel_size=PATCH, stride=PATCH)
        self.position = PositionCode(grid, dim)
        self.blocks = nn.Sequential(*(GlobalFilterBlock(grid, dim) for _ in range(depth)))
        self.norm = nn.LayerNorm(dim)
        self.head = nn.Linear(dim, classes)

    def forward(self, images: Tensor) -> Tensor:
        """Return logits ``(B, classes)`` for images ``(B, 3, H, W)``."""
        tokens = self.patches(images).flatten(2).transpose(1, 2)  # (B, rows * columns, dim)
        tokens = self.norm(self.blocks(self.position(tokens)))
        result: Tensor = self.head(tokens.mean(1))
        return result
