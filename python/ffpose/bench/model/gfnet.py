"""A network of a user's kind: global filters between small perceptrons, as GFNet.

After Rao et al., "Global Filter Networks for Image Classification", NeurIPS 2021, GFNet-Ti: patches
of 16x16 pixels, 12 blocks on 14x14 tokens of 256 channels, the mean of which is classified. Written
for this benchmark; layer scale and stochastic depth, which cost nothing at inference, are left out.
"""

from __future__ import annotations

from torch import Tensor, nn

from ffpose.nn import GlobalFilter, PositionCode

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
