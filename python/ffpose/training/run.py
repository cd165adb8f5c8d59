"""The parts of a training run, built from its configuration and handed to the loop."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from ffpose.datasets import PoseDataset, open_dataset
from ffpose.losses import PoseLoss
from ffpose.models import CONFIGS, FilterformerPose, backbone_preprocessing
from ffpose.training.config import OptimizerConfig, TrainConfig
from ffpose.transforms import Augmentation, Preprocessing


@dataclass
class Run:
    """What the loop works on.

    Attributes:
        config: What the run is asked to do.
        model: The network.
        loss: The joint loss with its two learnable weights.
        optimizer: Adam over both; made anew where a stage begins.
        train_set: Images to learn from.
        val_set: Images that choose the best epoch.
        device: Where the network computes.
    """

    config: TrainConfig
    model: FilterformerPose
    loss: PoseLoss
    optimizer: torch.optim.Optimizer
    train_set: PoseDataset
    val_set: PoseDataset
    device: torch.device


def build_run(config: TrainConfig) -> Run:
    """Open the images and build model, loss and optimiser, the weights from the run's seed.

    Raises:
        ValueError: An unknown kind of image set, or fields that do not go together.
        ffpose.DataError: A label, or a file of backbone weights, cannot be used.
    """
    device = _device(config.device)
    fields = dict(config.model_fields)
    height, width = fields.get("image_size", CONFIGS[config.model].image_size)
    backbone = fields.get("backbone", CONFIGS[config.model].backbone)
    preprocessing = backbone_preprocessing(backbone, (height, width), config.data.mode)
    train_set, val_set = _open_splits(config, preprocessing)
    if config.normalize_translation:
        fields |= translation_statistics(train_set.poses)
    torch.manual_seed(config.seed)
    model = FilterformerPose.from_config(
        config.model, backbone_weights=config.backbone_weights, **fields
    ).to(device)
    loss = PoseLoss(config.loss.s_t, config.loss.s_q, config.loss.antipodal).to(device)
    optimizer = build_optimizer(model, loss, config.optimizer)
    return Run(config, model, loss, optimizer, train_set, val_set, device)


def _open_splits(
    config: TrainConfig, preprocessing: Preprocessing
) -> tuple[PoseDataset, PoseDataset]:
    """Open the images to learn from, augmented, and those to validate on."""
    data = config.data
    augmentation = _augmentation(data.augmentation) if data.augment else None
    return (
        open_dataset(data.kind, data.root, "train", preprocessing, augmentation, data.cache),
        open_dataset(data.kind, data.root, "val", preprocessing, None, data.cache),
    )


def _augmentation(values: Mapping[str, Any]) -> Augmentation:
    try:
        return Augmentation(**values)
    except TypeError as error:  # an unknown name, or a value that is no number
        names = ", ".join(Augmentation.__dataclass_fields__)
        raise ValueError(
            f"data.augmentation: expected numbers for some of {names}, got {dict(values)}"
        ) from error


def _device(name: str) -> torch.device:
    if name == "auto":
        return torch.device("cuda" if torch.cuda.is_available() else "cpu")
    return torch.device(name)


def translation_statistics(poses: NDArray[np.float64]) -> dict[str, tuple[float, ...]]:
    """Return the model's fields for mean and spread of the translations of poses ``(N, 7)``.

    A coordinate that does not vary gets a spread of one: it is predicted by its mean.
    """
    mean, std = poses[:, :3].mean(axis=0), poses[:, :3].std(axis=0)
    spread = np.where(std > 0, std, 1.0)
    return {
        "translation_mean": tuple(mean.tolist()),
        "translation_std": tuple(spread.tolist()),
    }


def build_optimizer(
    model: nn.Module, loss: nn.Module, config: OptimizerConfig
) -> torch.optim.Optimizer:
    """Return Adam over the model, and over the loss's two weights without weight decay."""
    groups: list[dict[str, Any]] = [
        {"params": list(model.parameters()), "weight_decay": config.weight_decay},
        {"params": list(loss.parameters()), "weight_decay": 0.0},
    ]
    return torch.optim.Adam(groups, lr=config.learning_rate, eps=config.eps, fused=True)
