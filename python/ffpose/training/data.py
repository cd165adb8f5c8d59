"""The images of a training run: opened, rendered or cut, as its configuration says."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ffpose._internal.seeds import TRAINING, VALIDATION, matching
from ffpose.config import NetworkConfig, PolarPoseConfig, looks_twice
from ffpose.datasets import Decoding, PoseDataset, list_splits, read_records
from ffpose.datasets.csv_set import read_keypoints
from ffpose.datasets.patches import dataset_patches
from ffpose.datasets.records import expect_in_front
from ffpose.datasets.scenes import open_frames, rendered_patches
from ffpose.errors import expect, hint
from ffpose.geometry import Camera, DistortedCamera
from ffpose.imaging.patches import Arrays, Content, PatchSpec
from ffpose.imaging.preprocessing import Preprocessing
from ffpose.imaging.reprojection import agree
from ffpose.imaging.transforms import Augmentation
from ffpose.render import Scene, find_scene
from ffpose.training.calibration_images import (
    EMPTY_SEEDS,
    CalibrationSet,
    open_calibration,
    varied,
)
from ffpose.training.config import DataConfig

NO_KEYPOINTS = np.zeros((0, 3))


@dataclass(frozen=True)
class TrainingData:
    """Training and validation data of a run.

    ``val_set`` are whole validation images; ``camera`` is that of the network's input, None where
    the images have several; ``train_set`` are whole training images, None where patches alone are
    rendered. A network with a second look has stored patches, those ``empty`` of an object, images
    for calibration and the object's keypoints ``(K, 3)``, meters, where known.
    """

    val_set: PoseDataset
    camera: Camera | None
    train_set: PoseDataset | None = None
    patches: list[Arrays] = field(default_factory=list)
    empty: list[Arrays] = field(default_factory=list)
    calibration: CalibrationSet | None = None
    keypoints: NDArray[np.float64] = field(default_factory=lambda: NO_KEYPOINTS)


def open_training_data(
    config: DataConfig,
    model: NetworkConfig,
    preprocessing: Preprocessing,
    *,
    coordinates: bool,
    quiet: bool = True,
) -> TrainingData:
    """Open the images that ``config`` names, as the network looks at them.

    ``coordinates``: whether a network with a second look learns the object's coordinates;
    ``quiet``: whether no bar shows how far the rendering of its views is.

    Raises:
        ValueError: An unknown kind of image set, or fields that do not go together.
        ffpose.DataError: An image or a label cannot be used.
    """
    fits = config.mode == "resize" or not looks_twice(model)
    expect(fits, "data.mode", "resize, with a network that looks twice", config.mode)
    if config.kind == "scenes":
        return _scenes(config, model, preprocessing, quiet)
    train_set, val_set = _open_splits(config, preprocessing, calibrated=looks_twice(model))
    camera = None if train_set.camera is None else preprocessing.camera(train_set.camera)
    if not looks_twice(model):
        return TrainingData(val_set, camera, train_set)
    if camera is None or isinstance(camera, DistortedCamera) or train_set.target != "object":
        raise ValueError(
            "model: a second look expects images of one camera without distortion "
            f"(--data.undistort) that locate an object, got images of {train_set.camera} that "
            f"locate the {train_set.target}"
        )
    spec = patch_spec(model, camera)
    patches = dataset_patches(train_set, spec, coordinates=coordinates, cache=config.cache)
    keypoints = NO_KEYPOINTS if config.keypoints is None else read_keypoints(Path(config.keypoints))
    calibration = open_calibration(config.calibration_images, preprocessing)
    return TrainingData(val_set, camera, train_set, [patches], [], calibration, keypoints)


def _open_splits(
    config: DataConfig, preprocessing: Preprocessing, *, calibrated: bool
) -> tuple[PoseDataset, PoseDataset]:
    """Open images to learn from, augmented, and to validate; others of the latter calibrate."""
    kind, decoding = config.kind, Decoding(config.undistort, config.white)
    known = list_splits(kind, config.root)
    splits = (*known, "all")
    among = f"one of {', '.join(splits)}"
    expect(config.train_split in splits, "data.train_split", among, config.train_split)
    if not config.holdout and config.val_split not in known:
        raise ValueError(
            f"data.val_split: expected one of {', '.join(known)}, got {config.val_split!r}; "
            "--data.holdout N validates on every Nth image of the training split instead"
        )
    if not config.holdout and config.train_split in (config.val_split, "all"):
        raise ValueError(
            "data.val_split: expected a split that is not trained on, got "
            f"{config.val_split!r} beside data.train_split {config.train_split!r}"
        )
    train = read_records(kind, config.root, config.train_split, decoding)
    if config.holdout:
        val = train[:: config.holdout]
        train = [record for index, record in enumerate(train) if index % config.holdout]
    else:
        val = read_records(kind, config.root, config.val_split, decoding)
    if calibrated:
        val = val[::2]
    augmentation = _augmentation(config)
    expect_in_front([*train, *val])
    train_set = PoseDataset(train, preprocessing, augmentation, config.cache)
    val_set = PoseDataset(val, preprocessing, None, config.cache)
    trained, validated = train_set.camera, val_set.camera
    if trained is not None and (
        validated is None or not agree(*map(preprocessing.camera, (trained, validated)))
    ):
        of = "several cameras" if validated is None else str(validated)
        raise ValueError(
            f"data.val_split: expected images of the training images' camera, {trained}, got {of}"
        )
    return train_set, val_set


def _scenes(
    config: DataConfig, model: NetworkConfig, preprocessing: Preprocessing, quiet: bool
) -> TrainingData:
    """Render what is not there yet."""
    shown = [find_scene(name, config.attitude_range_deg) for name in config.scenes]
    scenes = [scene.scaled(*config.distance) for scene in shown]
    camera = preprocessing.camera(scenes[0].camera)
    workers = config.workers
    val_seed = matching(VALIDATION, config.seed)
    val_set = open_frames(
        config.root, shown[0], val_seed, config.validation, preprocessing, workers=workers
    )
    kinds = [varied(scene) for scene in scenes]
    parts = list[tuple[Scene, int, int]]()
    for kind in kinds[0]:
        for each, seed, whole in zip(kinds, config.seeds, config.counts, strict=True):
            (part, more), count = each[kind], whole if kind == "whole" else getattr(config, kind)
            if count > 0:
                parts.append((part, matching(TRAINING, seed + more), count))
    if not looks_twice(model):
        frames = [open_frames(config.root, *part, preprocessing, workers=workers) for part in parts]
        records = [record for each in frames for record in each.records]
        train_set = PoseDataset(records, preprocessing, _augmentation(config), config.cache)
        return TrainingData(val_set, camera, train_set)
    spec = patch_spec(model, camera)

    def views(scene: Scene, seed: int, count: int, content: Content = "object") -> Arrays:
        options: dict[str, Any] = {"content": content, "workers": workers, "quiet": quiet}
        return rendered_patches(config.root, scene, seed, count, spec, **options)

    patches = [views(*part) for part in parts]
    seed = matching(TRAINING, config.seed + EMPTY_SEEDS)
    others: dict[Content, int] = {"empty": config.empty, "decoy": config.decoys}
    empty = [views(scenes[0], seed, count, what) for what, count in others.items() if count > 0]
    keypoints = np.array(list(scenes[0].build().keypoints.values())).reshape(-1, 3)
    calibration = open_calibration(config.calibration_images, preprocessing)
    return TrainingData(val_set, camera, None, patches, empty, calibration, keypoints)


def patch_spec(model: PolarPoseConfig, camera: Camera) -> PatchSpec:
    """Return how a network looks at the images of its camera."""
    return PatchSpec(camera, model.first_stride, model.object_width, model.object_radius_m)


def _augmentation(config: DataConfig) -> Augmentation | None:
    if not config.augment:
        return None
    values, known = config.augmentation, list(Augmentation.__dataclass_fields__)
    expected = f"data.augmentation: expected numbers for some of {', '.join(known)}"
    for name in values.keys() - known:
        raise ValueError(f"{expected}; got {name}{hint(name, known)}")
    try:
        return Augmentation(**values)
    except TypeError as error:  # a value that is no number
        raise ValueError(f"{expected}; got {values}") from error
