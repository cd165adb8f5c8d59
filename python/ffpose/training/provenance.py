"""Provenance of trained weights: the configuration and data that their header records."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ffpose._internal.files import sha256
from ffpose.datasets import PoseDataset
from ffpose.evaluation.baseline import mean_pose
from ffpose.geometry.symmetry import IDENTITY, SymmetryGroup
from ffpose.imaging.patches import Arrays
from ffpose.imaging.reprojection import lens_of
from ffpose.models import read_metadata
from ffpose.render import find_scene
from ffpose.training.config import DataConfig, TrainConfig

OF_THIS_MACHINE = ("out", "device", "backbone_weights")
"""Fields specific to this machine, left out; the header records the backbone's initial weights."""


def origin(weights: Path) -> dict[str, Any]:
    """Return the provenance of initial weights: SHA-256, and recipe and data of their header.

    The recipe's own ``init`` is the provenance of those before, and so on.
    """
    header = read_metadata(weights)
    return {"sha256": sha256(weights), "recipe": header.recipe, "data": header.data}


def recipe(
    config: TrainConfig, init: dict[str, Any] | None, symmetry: SymmetryGroup = IDENTITY
) -> dict[str, Any]:
    """Return the configuration as a JSON document, without paths and names of this machine.

    What `origin` returns of the initial weights stands in the place of their path, the axes of the
    symmetry that labels are modulo in that of its file.
    """
    fields = {name: value for name, value in asdict(config).items() if name not in OF_THIS_MACHINE}
    fields["init"] = init
    if config.symmetry is not None:
        fields["symmetry"] = symmetry.to_json()
    for name in ("root", "keypoints", "workers"):
        del fields["data"][name]
    if config.data.kind == "scenes":
        fields["data"]["scene"] = set_name(config.data)
    return fields


def set_name(config: DataConfig) -> str:
    """Return the name of an image set: of its folder, or of the rendered scenes."""
    scenes = map(scene_name, config.scenes)
    return "+".join(scenes) if config.kind == "scenes" else config.root.resolve().name


def scene_name(scene: str) -> str:
    """Return the name of a set, which its file stands for."""
    return find_scene(scene).name if scene.endswith(".json") else scene


def rendered_sets(config: DataConfig) -> dict[str, Any]:
    """Return name, seed and number of images of each set of scenes; nothing of sets on disk."""
    if config.kind != "scenes":
        return {}
    parts = zip(config.scenes, config.seeds, config.counts, strict=True)
    return {
        "sets": [{"scene": scene_name(scene), "seed": seed, "count": n} for scene, seed, n in parts]
    }


def describe_data(
    config: DataConfig, poses: NDArray[np.float64], images: PoseDataset, digest: Any
) -> dict[str, Any]:
    """Describe a run's images: name, sets, size; number, mean and digest of labels ``(N, 7)``."""
    size = images.image_size
    if config.kind == "scenes":  # whose images may be rendered smaller than the set's
        camera = find_scene(config.scenes[0]).camera
        size = camera.height, camera.width
    return {
        "kind": config.kind,
        "name": set_name(config),
        **rendered_sets(config),
        "count": len(poses),
        **({} if size is None else {"image_size": list(size)}),
        "mean_pose": mean_pose(poses).tolist(),
        "digest": digest.hexdigest(),
    }


def describe_patches(
    patches: Sequence[Arrays], val_set: PoseDataset, config: DataConfig
) -> dict[str, Any]:
    """Describe stored patches as `describe_data`; the digest is of their labels."""
    labels = [np.ascontiguousarray(arrays["labels"], "<f8") for arrays in patches]
    digest = hashlib.sha256(b"".join(part.tobytes() for part in labels))
    return describe_data(config, np.concatenate(labels)[:, :7], val_set, digest)


def describe_images(dataset: PoseDataset, config: DataConfig) -> dict[str, Any]:
    """Describe whole images as `describe_data`, what their labels locate, and their distortion.

    The digest is of the concatenation over all images of the name, a newline, and the label
    ``[t, q]`` as little-endian float64.
    """
    digest = hashlib.sha256()
    for name, pose in zip(dataset.names, dataset.poses, strict=True):
        digest.update(f"{name}\n".encode() + pose.astype("<f8").tobytes())
    described = describe_data(config, dataset.poses, dataset, digest)
    described["locates"] = dataset.target
    if dataset.camera is not None and (lens := lens_of(dataset.camera)) is not None:
        described["distortion"] = list(lens)
    return described
