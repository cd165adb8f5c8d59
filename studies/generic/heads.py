"""A head for each of many spacecraft, over one network: what is theirs alone, the rest is shared.

An attitude means nothing without the frame of the spacecraft that has it. Each spacecraft therefore
has orientation bins and coordinate maps of its own, and all else of the network learns from all.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from ffpose.models import PolarPose
from ffpose.models.polar_second_look import map_angles
from ffpose.nn.polar_bins import WEIGHT_STD, PolarBinsHead
from ffpose.training.config import ObjectLossConfig
from ffpose.training.losses import LossTerms
from ffpose.training.object_objective import CELLS_PER_SIDE, ObjectObjective
from ffpose.training.patches import PatchBatch


class ManyBinsHead(PolarBinsHead):
    """`PolarBinsHead` with weights for each of many spacecraft.

    Args:
        model: The network whose head has these bins.
        spacecraft: Their number.

    Attributes:
        chosen: ``(B,)``, numbers of the spacecraft of the outputs that are decoded next.
    """

    chosen: Tensor

    def __init__(self, model: PolarPose, spacecraft: int) -> None:
        c = model.config
        super().__init__(c.latent, map_angles(c), c.angles, c.directions, c.bins_width_deg)
        weights = torch.randn(spacecraft, c.latent, c.directions) * WEIGHT_STD
        self.weight = nn.Parameter(weights)
        self.bias = nn.Parameter(torch.zeros(spacecraft, 1, c.directions))

    def logits(self, raw: Tensor) -> Tensor:
        """Return logits ``(B, bins)`` by the weights of the chosen spacecraft."""
        features = torch.unflatten(raw, 1, (-1, self.latent))
        scores = features @ self.weight[self.chosen] + self.bias[self.chosen]
        return (self.interpolation @ scores).flatten(1)


class ManyObjective(ObjectObjective):
    """The loss of a network with a `ManyBinsHead`, with coordinate maps for each spacecraft.

    Args:
        model: The network.
        config: Weights of the terms.
        numbers: Number of the spacecraft of each sample of the set ``(N,)``.
    """

    numbers: Tensor

    def __init__(self, model: PolarPose, config: ObjectLossConfig, numbers: Tensor) -> None:
        super().__init__(model, config)
        channels, maps = model.object_backbone.channels[0], 4 * CELLS_PER_SIDE**2
        count = int(numbers.max()) + 1
        self.register_buffer("numbers", numbers, persistent=False)
        self.weight = nn.Parameter(torch.randn(count, maps, channels) / channels**0.5)
        self.bias = nn.Parameter(torch.zeros(count, maps, 1, 1))
        self.dense["coordinates"] = nn.Identity()  # says that there are some; `_maps` makes them

    def forward(self, model: PolarPose, batch: PatchBatch) -> LossTerms:
        """Return the loss terms, each sample by the head of its spacecraft."""
        head = model.orientation
        assert isinstance(head, ManyBinsHead)
        head.chosen = self.numbers[batch.index][batch.present]
        return super().forward(model, batch)

    def _maps(self, name: str, feature_map: Tensor, batch: PatchBatch) -> Tensor:
        shown, chosen = feature_map[batch.present], self.numbers[batch.index][batch.present]
        maps = torch.einsum("bchw,bkc->bkhw", shown, self.weight[chosen]) + self.bias[chosen]
        return F.pixel_shuffle(maps, CELLS_PER_SIDE)
