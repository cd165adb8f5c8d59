"""The images of a training run: opened, rendered or cut, as its configuration says."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ffpose.datasets import PoseDataset, open_dataset
from ffpose.datasets.scenes import find_scene, open_validation, open_views
from ffpose.geometry import Camera
from ffpose.models import FilterformerPoseConfig
from ffpose.training.config import DataConfig
from ffpose.transforms import Augmentation, Preprocessing
from ffpose.views import ViewSpec, cut_pieces

EMPTY_SEEDS = 500_000
"""Added to the seed of scenes without a spacecraft."""

Arrays = Mapping[str, NDArray[Any]]


@dataclass(frozen=True)
class TrainingData:
    """What a run learns from and is validated on.

    Attributes:
        poses: Labels of the training split ``(N, 7)``.
        val_set: Whole images of the validation split.
        camera: Of the network's input.
        train_set: Whole images of the training split, for a network that looks at the frame.
        views: Stored views, for one with a second look.
        empty: Stored views without an object.
    """

    poses: NDArray[np.float64]
    val_set: PoseDataset
    camera: Camera
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
    if model.orientation_view == "frame":
        return TrainingData(train_set.poses, val_set, camera, train_set)
    views = cut_views(train_set, view_spec(model, camera))
    return TrainingData(train_set.poses, val_set, camera, train_set, [views])


def _scenes(
    config: DataConfig, model: FilterformerPoseConfig, preprocessing: Preprocessing
) -> TrainingData:
    """Render what is not there yet."""
    if model.orientation_view == "frame":
        raise ValueError(
            "data.kind: scenes are views for a network with orientation_view 'object'; for one "
            "that looks at the frame alone render a set (ffpose render) and name it as urso"
        )
    scene = find_scene(config.scene, config.attitude_range_deg)
    camera = preprocessing.camera(scene.camera)
    spec = view_spec(model, camera)
    options = {"workers": config.workers}
    views = open_views(config.root, scene, config.seed, config.count, spec, empty=False, **options)
    empty = []
    if config.empty:
        # Another seed: the scenes behind the spacecraft are not those that show it.
        seed = EMPTY_SEEDS + config.seed
        empty = [open_views(config.root, scene, seed, config.empty, spec, empty=True, **options)]
    val_set = open_validation(
        config.root, scene, config.seed, config.validation, preprocessing, **options
    )
    return TrainingData(views["labels"][:, :7], val_set, camera, None, [views], empty)


def cut_views(dataset: PoseDataset, spec: ViewSpec) -> Arrays:
    """Cut the images of a set on disk into views, in memory; nothing is known of coordinates."""
    arrays = {
        name: np.zeros(shape, dtype) for name, (shape, dtype) in spec.shapes(len(dataset)).items()
    }
    for index, record in enumerate(dataset.records):
        frame = dataset.preprocessing.frame(dataset.load_image(index))
        cut_pieces(frame, record.pose, spec).store(arrays, index)
    return arrays


def view_spec(model: FilterformerPoseConfig, camera: Camera) -> ViewSpec:
    """Return how a network looks at the images of its camera."""
    return ViewSpec(camera, model.first_stride, model.object_size[1], model.object_radius_m)


def _augmentation(values: Mapping[str, Any]) -> Augmentation:
    try:
        return Augmentation(**values)
    except TypeError as error:  # an unknown name, or a value that is no number
        names = ", ".join(Augmentation.__dataclass_fields__)
        raise ValueError(
            f"data.augmentation: expected numbers for some of {names}, got {dict(values)}"
        ) from error
