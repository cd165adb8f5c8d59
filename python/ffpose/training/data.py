"""The images of a training run: opened, rendered or cut, as its configuration says."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ffpose.datasets import PoseDataset, open_dataset
from ffpose.datasets.scenes import open_scenes, open_views
from ffpose.geometry import Camera
from ffpose.models import FilterformerPoseConfig
from ffpose.training.config import DataConfig
from ffpose.transforms import Augmentation, Preprocessing
from ffpose.views import ViewSpec

Arrays = Mapping[str, NDArray[Any]]


@dataclass(frozen=True)
class TrainingData:
    """What a run learns from and is validated on.

    Attributes:
        poses: Labels of the training split ``(N, 7)``.
        val_set: Whole images of the validation split.
        fields: Of the network's configuration that the data decide: its camera.
        train_set: Whole images of the training split, for a network that looks at the frame.
        views: Stored views, for one with a second look.
        empty: Stored views without an object.
    """

    poses: NDArray[np.float64]
    val_set: PoseDataset
    fields: dict[str, Any]
    train_set: PoseDataset | None = None
    views: list[Arrays] = field(default_factory=list)
    empty: list[Arrays] = field(default_factory=list)


def open_training_data(
    config: DataConfig, model: FilterformerPoseConfig, preprocessing: Preprocessing
) -> TrainingData:
    """Open the images that ``config`` names, as the network looks at them.

    Raises:
        ValueError: An unknown kind of image set, or fields that do not go together.
        ffpose.DataError: An image or a label cannot be used.
    """
    if config.kind == "scenes":
        return _scenes(config, model, preprocessing)
    val_set = open_dataset(config.kind, config.root, "val", preprocessing, None, config.cache)
    augmentation = _augmentation(config.augmentation) if config.augment else None
    train_set = open_dataset(
        config.kind, config.root, "train", preprocessing, augmentation, config.cache
    )
    camera = preprocessing.camera(train_set.camera)
    fields = camera_fields(camera)
    if model.orientation_view == "frame":
        return TrainingData(train_set.poses, val_set, fields, train_set)
    views, empty = cut_views(train_set, view_spec(model, camera), config)
    return TrainingData(train_set.poses, val_set, fields, None, [views], empty)
