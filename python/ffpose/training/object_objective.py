"""Training objective of a network with a second look.

The terms, each a mean over the samples that show the object: the first look's location, the
orientation head's own loss, the offset, the likelihood of both errors under the network's standard
deviations, whether the object is in view (over all samples), and, for training alone, *dense
supervision*: the object's coordinates and silhouette from the feature map by a 1 x 1 convolution
that is not part of the saved network (as in Wang et al., "GDR-Net", CVPR 2021).
"""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from ffpose.losses import LossTerms
from ffpose.models import FilterformerPose
from ffpose.models.object_look import LookNumbers, rotation_vector, sigma_loss
from ffpose.training.config import ObjectLossConfig
from ffpose.training.views import ViewBatch

CELLS_PER_SIDE = 2
"""Coordinates are predicted for this many places along each side of a cell of the feature map."""

SMOOTH = 0.05
"""Errors below it count by their square (Huber)."""


class ObjectObjective(nn.Module):
    """The loss of a network with a second look, and the convolution of the dense supervision.

    Args:
        model: The network.
        config: Weights of the terms.

    Raises:
        ValueError: The network looks once.
    """

    def __init__(self, model: FilterformerPose, config: ObjectLossConfig) -> None:
        super().__init__()
        view = model.config.orientation_view
        if model.object_backbone is None:
            raise ValueError(f"model: expected orientation_view 'object', got {view!r}")
        self.config = config
        rows, columns = model.config.orientation_grid
        self.cells = (rows * CELLS_PER_SIDE, columns * CELLS_PER_SIDE)
        self.dense = (
            nn.Conv2d(model.object_backbone.channels[0], 4 * CELLS_PER_SIDE**2, 1)
            if config.dense
            else None
        )

    def forward(self, model: FilterformerPose, batch: ViewBatch) -> LossTerms:
        """Return the loss, the mean position errors in meters at unit distance, and the head's."""
        c, present = self.config, batch.present
        location = model.locate(batch.frames)
        feature_map = model.see(batch.crops)
        numbers = model.read(feature_map)
        first = F.smooth_l1_loss(location, batch.location, beta=SMOOTH)
        offset = F.smooth_l1_loss(numbers.offset[present], batch.offset[present], beta=SMOOTH)
        orientation = model.orientation.loss(numbers.orientation, batch.orientation)[present].mean()
        q_hat = self._decoded(model, numbers)
        angle = half_angle(q_hat[present], batch.orientation[present]).mean()
        with torch.no_grad():
            turned = rotation_vector(_between(q_hat, batch.orientation))
            residual = torch.cat((numbers.offset - batch.offset, turned), dim=1)
        sigma = sigma_loss(numbers.log_sigma, residual)[present].mean()
        in_view = F.binary_cross_entropy_with_logits(numbers.in_view, present.float())
        total = (
            c.location * first
            + c.offset * offset
            + c.orientation * orientation
            + c.angle * angle
            + c.sigma * sigma
            + c.in_view * in_view
        )
        if self.dense is not None:
            total = total + self._dense_loss(feature_map, batch)
        return LossTerms(total, first + offset, orientation)

    def _decoded(self, model: FilterformerPose, numbers: LookNumbers) -> Tensor:
        """Return the attitudes ``(B, 4)``, with gradients where the loss has a term of them."""
        if self.config.angle > 0:
            return model.orientation.decode(numbers.orientation)
        with torch.no_grad():
            return model.orientation.decode(numbers.orientation)

    def _dense_loss(self, feature_map: Tensor, batch: ViewBatch) -> Tensor:
        """Return the loss of coordinates and silhouette."""
        assert self.dense is not None
        seen = F.pixel_shuffle(self.dense(feature_map), CELLS_PER_SIDE)[batch.present]
        truth = batch.coordinates[batch.present]
        mask = truth[:, 3:]
        error = ((seen[:, :3] - truth[:, :3]).abs() * mask).sum() / (3 * mask.sum() + 1)
        silhouette = F.binary_cross_entropy_with_logits(seen[:, 3:], mask)
        return self.config.coordinates * error + self.config.mask * silhouette


def half_angle(q_hat: Tensor, q: Tensor) -> Tensor:
    """Return the sine of half the angle between attitudes ``(B, 4)``, which pulls evenly."""
    return (1 - (q_hat * q).sum(-1).square() + 1e-6).clamp_min(1e-6).sqrt()


def _between(q_from: Tensor, q_to: Tensor) -> Tensor:
    """Return the rotations ``q_to conj(q_from)`` ``(B, 4)``."""
    a, v = q_to[:, :1], q_to[:, 1:]
    b, u = q_from[:, :1], -q_from[:, 1:]
    scalar = a * b - (v * u).sum(-1, keepdim=True)
    return torch.cat((scalar, a * u + b * v + torch.linalg.cross(v, u)), dim=1)
