"""How well weights do on images that they were not trained on, beside what no looking achieves.

The figures are those of the paper's tables: errors of translation (equation 13) and orientation
(equation 14), always mean and median, and the scores of the ESA 2019 and SPEED+ 2021 challenges.
Beside them stands a baseline, the best constant answer: the mean pose of the training split, given
for every image. A model that does not beat it has not learned to look.
"""

from __future__ import annotations

import csv
import json
import math
import time
from dataclasses import astuple, dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch.utils.data import DataLoader

from ffpose.datasets import Part, PoseDataset, open_dataset
from ffpose.files import atomic_write
from ffpose.geometry import Camera, Pose
from ffpose.metrics import PoseError, PoseErrors, pose_error
from ffpose.models import FilterformerPose, WeightsMetadata, read_metadata
from ffpose.reprojection import Reprojection
from ffpose.transforms import Preprocessing

FloatArray = NDArray[np.float64]

CAMERA_TOLERANCE = 1e-3
"""How far intrinsics may lie apart, relatively, and still be those of one camera."""

VECTOR = ("tx", "ty", "tz", "qw", "qx", "qy", "qz")


@dataclass(frozen=True)
class Evaluation:
    """Predictions on the images of one split, and the baseline on the same images.

    Attributes:
        dataset: The images and their labels.
        predicted: Predicted poses ``(N, 7)``, ``[t, q]``.
        baseline: The constant pose ``(7,)`` of the baseline.
        seconds_per_image: From the image's file to the pose, on average.
    """

    dataset: PoseDataset
    predicted: FloatArray
    baseline: FloatArray
    seconds_per_image: float

    @cached_property
    def errors(self) -> PoseErrors:
        """Errors of the predictions, image by image."""
        return _errors(self.predicted, self.dataset.poses)

    @cached_property
    def baseline_errors(self) -> PoseErrors:
        """Errors of the baseline, image by image."""
        constant = np.broadcast_to(self.baseline, self.dataset.poses.shape)
        return _errors(constant, self.dataset.poses)

    @cached_property
    def ranking(self) -> NDArray[np.intp]:
        """Places of the images from the best to the worst, by their part of the ESA score."""
        return np.argsort(self.errors.esa_score.numpy(), kind="stable")

    def typical(self, count: int) -> list[int]:
        """Return the ``count`` images in the middle of the ranking; all where there are fewer."""
        begin = max(0, len(self.ranking) - count) // 2
        chosen: list[int] = self.ranking[begin : begin + count].tolist()
        return chosen

    def pose(self, index: int) -> Pose:
        """Return the predicted pose of image ``index``."""
        return Pose.from_vector(self.predicted[index])

    def summary(self) -> dict[str, Any]:
        """Return the figures of the model and, under ``mean_pose_baseline``, of the baseline."""
        return {
            "images": len(self.dataset),
            **figures(self.predicted, self.dataset.poses),
            "seconds_per_image": self.seconds_per_image,
            "mean_pose_baseline": {
                "pose": self.baseline.tolist(),
                **figures(np.broadcast_to(self.baseline, self.predicted.shape), self.dataset.poses),
            },
        }


def evaluate(
    weights: str | Path,
    kind: str,
    root: Path,
    split: Part = "test",
    *,
    batch_size: int = 32,
    workers: int = 0,
    any_camera: bool = False,
) -> Evaluation:
    """Predict the poses of a split's images.

    Args:
        weights: The file, or the name of weights that come with the package; they say how images
            become the network's input.
        kind: The layout of the image set.
        root: The folder of the image set. Its training split gives the baseline.
        split: The images to predict, ``"all"`` for those of every split.
        batch_size: Images at a time.
        workers: Processes that read images beside this one.
        any_camera: Turn images of another camera than the weights' into the network's view, by
            geometry (`ffpose.reprojection`).

    Returns:
        Predictions and labels.

    Raises:
        FileNotFoundError: The weights or a file of the image set are missing.
        ValueError: The weights were altered, are of another kind of network, or have another
            camera than the images.
        ffpose.DataError: An image or a label cannot be used.
    """
    model = FilterformerPose.from_pretrained(weights).eval()
    metadata = read_metadata(weights)
    dataset = open_dataset(kind, root, split, metadata.preprocessing)
    dataset.preprocessing = _preprocessing(metadata, dataset.camera, any_camera)
    baseline = mean_pose(open_dataset(kind, root, "train", metadata.preprocessing).poses)
    loader = DataLoader(dataset, batch_size=batch_size, num_workers=workers)
    began = time.perf_counter()
    with torch.inference_mode():
        poses = [model(batch.image) for batch in loader]
    seconds = (time.perf_counter() - began) / len(dataset)
    predicted = torch.cat([torch.cat([p.translation, p.orientation], dim=1) for p in poses])
    return Evaluation(dataset, predicted.double().numpy(), baseline, seconds)


def _preprocessing(metadata: WeightsMetadata, camera: Camera, any_camera: bool) -> Preprocessing:
    """Return what brings images of ``camera`` to the network's input, or refuse them."""
    plain, view = metadata.preprocessing, metadata.config.view_camera
    if view is None or _agree(plain.camera(camera), view):
        return plain
    if any_camera:
        return Reprojection.of(plain, camera, view)
    expected = plain.image_camera(view, camera.width, camera.height)
    raise ValueError(
        f"expected images of the weights' camera, {expected}, got a set of {camera}; "
        "--any-camera turns them into the network's view"
    )


def _agree(camera: Camera, other: Camera) -> bool:
    """Return whether the intrinsics of two cameras of one image size agree."""
    pairs = zip(astuple(camera), astuple(other), strict=True)
    return all(math.isclose(one, two, rel_tol=CAMERA_TOLERANCE) for one, two in pairs)


def mean_pose(poses: FloatArray) -> FloatArray:
    """Return the mean of poses ``(N, 7)``: a pose ``(7,)`` with ``qw >= 0``.

    The orientation is the quaternion whose squared chordal distances to all others have the least
    sum, whatever their signs: the principal eigenvector of the sum of ``q qᵀ`` (Markley et al.,
    "Averaging Quaternions", 2007).

    Raises:
        ValueError: There are no poses.
    """
    if len(poses) == 0:
        raise ValueError("mean pose: expected at least one pose, got none")
    q = poses[:, 3:]
    _, vectors = np.linalg.eigh(q.T @ q)
    orientation = vectors[:, -1] if vectors[0, -1] >= 0 else -vectors[:, -1]
    return np.concatenate([poses[:, :3].mean(axis=0), orientation])


def figures(predicted: FloatArray, truth: FloatArray) -> dict[str, float]:
    """Return means, medians and scores of predictions ``(N, 7)``, named as `PoseError` does."""
    metric = PoseError()
    metric.update(*_tensors(predicted), *_tensors(truth))
    return {name: float(value) for name, value in metric.compute().items()}


def format_table(summary: dict[str, Any]) -> str:
    """Return the figures of `Evaluation.summary` as lines of text: name, model, baseline."""
    baseline = summary["mean_pose_baseline"]
    lines = [f"{summary['images']} images".ljust(28) + "model".rjust(12) + "mean pose".rjust(12)]
    for name, value in baseline.items():
        if name != "pose":
            lines.append(f"{name:28}{summary[name]:12.4f}{value:12.4f}")
    return "\n".join(lines)


def write_results(evaluation: Evaluation, out: Path) -> None:
    """Write ``results.json``, the figures, and ``predictions.csv``, a row an image, to ``out``."""
    out.mkdir(parents=True, exist_ok=True)
    with atomic_write(out / "results.json") as path:
        path.write_text(json.dumps(evaluation.summary(), indent=2) + "\n")
    header = ["image", *VECTOR, *(f"predicted_{name}" for name in VECTOR)]
    header += ["translation_error_m", "rotation_error_deg", "esa_score", "speed_plus_score"]
    errors = np.stack([error.numpy() for error in evaluation.errors], axis=1)
    table = np.concatenate([evaluation.dataset.poses, evaluation.predicted, errors], axis=1)
    with atomic_write(out / "predictions.csv") as path, path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(header)
        for name, row in zip(evaluation.dataset.names, table.tolist(), strict=True):
            writer.writerow([name, *row])


def _errors(predicted: FloatArray, truth: FloatArray) -> PoseErrors:
    return pose_error(*_tensors(predicted), *_tensors(truth))


def _tensors(poses: FloatArray) -> tuple[torch.Tensor, torch.Tensor]:
    """Split poses ``(N, 7)`` into translations ``(N, 3)`` and orientations ``(N, 4)``."""
    tensor = torch.from_numpy(np.ascontiguousarray(poses))
    return tensor[:, :3], tensor[:, 3:]
