"""Training objective of a network with a second look.

The terms, each a mean over the samples that show the object: the first look's own loss, the
orientation head's own loss, the offset, the likelihood of both errors under the network's standard
deviations, whether the object is in view (over all samples), and, for training alone, *dense
supervision*: the object's coordinates and silhouette (as in Wang et al., "GDR-Net", CVPR 2021), or
heatmaps of its keypoints (as in Park and D'Amico, "SPNv2", 2022), from the feature map by 1 x 1
convolutions that are not part of the saved network.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from ffpose.geometry.symmetry import IDENTITY, SymmetryGroup
from ffpose.models import PolarPose
from ffpose.models.second_look import SecondLookOutput, sigma_loss
from ffpose.nn.rotations import conjugate, nearest_equivalent, quaternion_product, rotation_vector
from ffpose.training.config import ObjectLossConfig
from ffpose.training.losses import LossTerms
from ffpose.training.patches import PatchBatch

CELLS_PER_SIDE = 2
"""Coordinates are predicted for this many places along each side of a cell of the feature map."""

SMOOTH = 0.05
"""Errors below it count by their square (Huber)."""


class ObjectObjective(nn.Module):
    """The loss of a network with a second look, and the convolutions of the dense supervision.

    Args:
        model: The network.
        config: Weights of the terms.
        keypoints: Number of the object's keypoints.
        symmetry: Errors of the decoded attitude are modulo it; the head learns the labels that the
            batches have.
    """

    rotations: Tensor

    def __init__(
        self,
        model: PolarPose,
        config: ObjectLossConfig,
        keypoints: int = 0,
        symmetry: SymmetryGroup = IDENTITY,
    ) -> None:
        super().__init__()
        self.config = config
        rotations = torch.from_numpy(symmetry.rotations).float()
        self.register_buffer("rotations", rotations, persistent=False)
        rows, columns = model.config.object_grid
        self.cells = (rows * CELLS_PER_SIDE, columns * CELLS_PER_SIDE)
        channels = model.object_backbone.channels[0]
        maps = {"coordinates": 4 if config.renders else 0, "heatmaps": keypoints}
        self.dense = nn.ModuleDict(
            {
                name: nn.Conv2d(channels, count * CELLS_PER_SIDE**2, 1)
                for name, count in maps.items()
                if count > 0
            }
        )

    def forward(self, model: PolarPose, batch: PatchBatch) -> LossTerms:
        """Return the loss, the mean position errors in meters at unit distance, and the head's."""
        first = model.first_loss(batch.frames, batch.translation)
        feature_map = model.encode(batch.crops, batch.tan_half_angle)
        numbers = model.decode(feature_map)
        with torch.autocast(feature_map.device.type, enabled=False):  # half: the network's alone
            return self._terms(model, batch, first, feature_map.float(), numbers.float())

    def _terms(
        self,
        model: PolarPose,
        batch: PatchBatch,
        first: Tensor,
        feature_map: Tensor,
        numbers: SecondLookOutput,
    ) -> LossTerms:
        c, present = self.config, batch.present
        shown, truth = numbers.of(present), batch.orientation[present]
        error = shown.offset - batch.offset[present]
        offset = F.smooth_l1_loss(shown.offset, batch.offset[present], beta=SMOOTH)
        orientation = model.orientation.loss(shown.orientation, truth).mean()
        with torch.set_grad_enabled(c.angle > 0 and torch.is_grad_enabled()):
            q_hat = model.orientation.decode(shown.orientation)
        with torch.no_grad():
            truth = nearest_equivalent(q_hat, truth, self.rotations)
            turned = rotation_vector(quaternion_product(truth, conjugate(q_hat)))
            residual = torch.cat((error, turned), dim=1)
        cosine = (q_hat * truth).sum(-1)  # of half the angle, whose sine pulls evenly
        angle = (1 - cosine.square() + 1e-6).clamp_min(1e-6).sqrt().mean()
        sigma = sigma_loss(shown, residual).mean()
        in_view = F.binary_cross_entropy_with_logits(numbers.in_view, present.float())
        total = (
            c.location * first
            + c.offset * offset
            + c.orientation * orientation
            + c.angle * angle
            + c.sigma * sigma
            + c.in_view * in_view
        )
        if "coordinates" in self.dense:
            total = total + self._coordinates_loss(feature_map, batch)
        if "heatmaps" in self.dense:
            seen = self._maps("heatmaps", feature_map, batch)
            total = total + c.keypoints * heatmap_loss(seen, batch.keypoints[present])
        return LossTerms(total, first + offset, orientation)

    def _maps(self, name: str, feature_map: Tensor, batch: PatchBatch) -> Tensor:
        """Return predicted maps ``(P, channels, rows, columns)`` of the samples with the object."""
        return F.pixel_shuffle(self.dense[name](feature_map), CELLS_PER_SIDE)[batch.present]

    def _coordinates_loss(self, feature_map: Tensor, batch: PatchBatch) -> Tensor:
        """Return the loss of coordinates and silhouette."""
        seen = self._maps("coordinates", feature_map, batch)
        truth = batch.coordinates[batch.present]
        mask = truth[:, 3:]
        error = ((seen[:, :3] - truth[:, :3]).abs() * mask).sum() / (3 * mask.sum() + 1)
        silhouette = F.binary_cross_entropy_with_logits(seen[:, 3:], mask)
        return self.config.coordinates * error + self.config.mask * silhouette


def heatmap_loss(logits: Tensor, places: Tensor) -> Tensor:
    """Return the mean cross-entropy of heatmaps over the keypoints that the view shows.

    The label of a keypoint is distributed over the four nearest cells as bilinear interpolation
    would weight them, so that it keeps the place within a cell. The last column is beside the
    first, as in polar coordinates.

    Args:
        logits: ``(B, K, rows, columns)``, of the cell in which each keypoint lies.
        places: ``(B, K, 2)``, column and row relative to width and height; those outside of 0 to 1
            do not count.
    """
    rows, columns = logits.shape[2:]
    shown = ((places > 0) & (places < 1)).all(-1)
    log_p = logits.flatten(2).log_softmax(-1)
    sides = torch.tensor([columns, rows], dtype=places.dtype, device=places.device)
    at = places * sides - 0.5
    around, across = at.unbind(-1)
    at = torch.stack([around, across.clamp(0, rows - 1)], dim=-1)
    near = at.floor()
    rest = at - near
    total = torch.zeros_like(log_p[..., 0])
    for corner in ((0, 0), (1, 0), (0, 1), (1, 1)):
        step = torch.tensor(corner, dtype=places.dtype, device=places.device)
        weight = torch.where(step > 0, rest, 1 - rest).prod(-1)
        u, v = (near + step).long().unbind(-1)
        cell = v.clamp(0, rows - 1) * columns + u % columns
        total = total - weight * log_p.gather(-1, cell[..., None])[..., 0]
    return (total * shown).sum() / shown.sum().clamp_min(1)
