"""Pose prediction for image files."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from PIL import Image

from ffpose.arrays import quaternion_to_euler
from ffpose.errors import DataError
from ffpose.files import atomic_write
from ffpose.geometry import URSO_CAMERA, Camera, FloatArray, Pose, PoseUncertainty
from ffpose.images import read_rgb
from ffpose.models import FilterformerPose, PosePrediction, read_metadata
from ffpose.overlay import draw_axes
from ffpose.reprojection import Reprojection
from ffpose.transforms import Preprocessing


@dataclass(frozen=True)
class Prediction:
    """The pose seen in one image.

    Attributes:
        image: Path of the image file.
        pose: The predicted pose.
        camera: The camera of the image, possibly for another image size; None where unknown.
        in_view_threshold: Probability below which the object counts as not in view; None where
            the weights have no threshold.
    """

    image: Path
    pose: Pose
    camera: Camera | None = None
    in_view_threshold: float | None = None

    @property
    def flagged(self) -> bool | None:
        """Whether the object counts as not in view; None where the network does not predict it."""
        if self.pose.uncertainty is None or self.in_view_threshold is None:
            return None
        return self.pose.uncertainty.in_view < self.in_view_threshold

    def to_dict(self) -> dict[str, Any]:
        """Return the prediction as a JSON document: meters, ``(w, x, y, z)``, degrees.

        With predicted uncertainty also covariances in m² and rad², and the probability in view.
        """
        document: dict[str, Any] = {
            "image": str(self.image),
            "translation_m": self.pose.t.tolist(),
            "orientation_wxyz": self.pose.q.tolist(),
            "roll_pitch_yaw_deg": quaternion_to_euler(self.pose.q).tolist(),
        }
        uncertainty = self.pose.uncertainty
        if uncertainty is not None:
            document["translation_covariance_m2"] = uncertainty.translation_covariance.tolist()
            document["rotation_covariance_rad2"] = uncertainty.rotation_covariance.tolist()
            document["in_view"] = uncertainty.in_view
        if self.flagged is not None:
            document["flagged"] = self.flagged
        return document

    def __str__(self) -> str:
        uncertainty = self.pose.uncertainty
        if uncertainty is not None and self.flagged:
            return f"{self.image}: no spacecraft in view (p = {uncertainty.in_view:.2g})"
        x, y, z = self.pose.t
        roll, pitch, yaw = quaternion_to_euler(self.pose.q)
        meters = degrees = ""
        if uncertainty is not None:
            distance, angle = standard_deviations(self.pose.t, uncertainty)
            meters, degrees = f" ± {distance:.2f} m along the ray", f" ± {angle:.1f}°"
        return (
            f"{self.image}: t = ({x:.2f}, {y:.2f}, {z:.2f}) m{meters}, "
            f"roll {roll:.1f}°, pitch {pitch:.1f}°, yaw {yaw:.1f}°{degrees}"
        )


def standard_deviations(t: FloatArray, uncertainty: PoseUncertainty) -> tuple[float, float]:
    """Return the standard deviations of the distance, meters, and the rotation angle, degrees.

    The first is that along the viewing ray ``u`` to ``t``, ``sqrt(uᵀ C u)``; the second is the root
    mean square length of the rotation vector, ``sqrt(trace C)``.
    """
    ray = t / np.linalg.norm(t)
    distance = np.sqrt(ray @ uncertainty.translation_covariance @ ray)
    angle = np.sqrt(np.trace(uncertainty.rotation_covariance))
    return float(distance), float(np.degrees(angle))


class Predictor:
    """A trained model with its preprocessing: predicts the pose in an image.

    Args:
        model: The network; it is put in evaluation mode.
        preprocessing: Conversion from image to network input.
        camera: Camera of the images, at any image size; None accepts images of any camera.

    Attributes:
        model: The network.
        preprocessing: Conversion from image to network input.
        camera: Camera of the images, or None.

    Example:
        ``Predictor.from_weights("soyuz-easy")(Image.open("0_rgb.png").convert("RGB"))``
    """

    def __init__(
        self, model: FilterformerPose, preprocessing: Preprocessing, camera: Camera | None = None
    ) -> None:
        self.model = model.eval()
        self.preprocessing = preprocessing
        self.camera = camera

    @classmethod
    def from_weights(
        cls, weights: str | Path, *, camera: Camera | None = None, any_camera: bool = False
    ) -> Predictor:
        """Load weights.

        Weights that have no camera in their header accept any image, resized to their input.

        Args:
            weights: Weights file, or the name of shipped weights.
            camera: Camera of the images, which are reprojected to the network's view; None for
                the weights' own camera.
            any_camera: Resize any image to the network's input, as if taken by the weights' camera.

        Raises:
            FileNotFoundError: ``weights`` is neither a file nor a name of shipped weights.
            ValueError: The weights were altered or are of another kind of network, or both
                ``camera`` and ``any_camera`` are given.
        """
        if camera is not None and any_camera:
            raise ValueError("expected --camera or --any-camera, got both")
        metadata = read_metadata(weights)
        preprocessing, view = metadata.preprocessing, metadata.config.view_camera
        expected = None if any_camera or camera is not None else metadata.camera
        if camera is not None and view is not None:
            preprocessing = Reprojection.of(preprocessing, camera, view)
        return cls(FilterformerPose.from_pretrained(weights), preprocessing, expected)

    def __call__(self, image: Image.Image) -> Pose:
        """Predict the pose of the spacecraft in an RGB image, with uncertainty if available.

        Raises:
            ValueError: The aspect ratio of the image differs from its camera's.
        """
        return self.batch([image])[0]

    def batch(self, images: Sequence[Image.Image]) -> list[Pose]:
        """Predict the poses in RGB images, at least one, as one batch.

        Raises:
            ValueError: The aspect ratio of an image differs from its camera's.
        """
        for image in images:
            self._check_aspect(*image.size)
        with torch.inference_mode():
            return _poses(self.model(torch.stack([self.preprocessing(i) for i in images])))

    def _check_aspect(self, width: int, height: int) -> None:
        if self.camera is not None and not self.camera.has_aspect(width, height):
            raise ValueError(
                f"expected the aspect ratio of the weights' camera, {self.camera}, got an image of "
                f"{width}x{height} pixels, which another camera took: name it "
                "(--camera FILE), or resize any image to the network's input (--any-camera)"
            )


def _poses(prediction: PosePrediction) -> list[Pose]:
    """Return the poses of a batch, with uncertainties if the network predicts them."""
    poses = zip(_rows(prediction.translation), _rows(prediction.orientation), strict=True)
    in_view = getattr(prediction, "in_view", None)
    if in_view is None:
        return [Pose(t, q) for t, q in poses]
    names = ("translation_covariance", "rotation_covariance")
    covariances = (_rows(getattr(prediction, name)) for name in names)
    uncertainties = map(PoseUncertainty, *covariances, _rows(in_view).tolist())
    return [Pose(t, q, u) for (t, q), u in zip(poses, uncertainties, strict=True)]


def _rows(values: torch.Tensor) -> FloatArray:
    return np.asarray(values.double().cpu().numpy())


def predict(
    weights: str | Path,
    images: Sequence[Path],
    *,
    camera: Camera | None = None,
    any_camera: bool = False,
) -> Iterator[Prediction]:
    """Predict the pose in each image file, lazily.

    Args:
        weights: Weights file, or the name of shipped weights.
        images: Image files.
        camera: Camera of the images, if other than the weights'.
        any_camera: Resize images of any camera to the network's input.

    Raises:
        FileNotFoundError: A file does not exist.
        ValueError: The weights cannot be used.
        ffpose.DataError: An image cannot be read, or its aspect ratio differs from its camera's.
    """
    metadata = read_metadata(weights)
    predictor = Predictor.from_weights(weights, camera=camera, any_camera=any_camera)
    for path in images:
        image = read_rgb(path)
        try:
            pose = predictor(image)
        except ValueError as error:
            raise DataError(str(error), path) from error
        yield Prediction(path, pose, camera or metadata.camera, metadata.in_view_threshold)


def overlay_path(image: Path, folder: Path) -> Path:
    """Return the path of an image's overlay, ``NAME_pose.png`` in ``folder``."""
    return folder / f"{image.stem}_pose.png"


def expect_distinct_overlays(images: Sequence[Path], folder: Path) -> None:
    """Check in advance that no overlay would overwrite another.

    Raises:
        ValueError: Two images have the same name; the message says which.
    """
    first: dict[Path, Path] = {}
    for image in images:
        path = overlay_path(image, folder)
        if path in first:
            raise ValueError(
                f"overlay: expected images of distinct names, got {first[path]} and {image}, "
                f"both for {path}"
            )
        first[path] = image


def write_overlay(prediction: Prediction, folder: Path) -> Path:
    """Write the image with the predicted axes drawn on it, or without them if it is flagged.

    Args:
        prediction: Image, pose and camera; URSO's camera if it has none.
        folder: Folder to write `overlay_path` to; created if missing.

    Returns:
        The path of the file.
    """
    folder.mkdir(parents=True, exist_ok=True)
    path = overlay_path(prediction.image, folder)
    drawn = read_rgb(prediction.image)
    if not prediction.flagged:
        drawn = draw_axes(drawn, prediction.pose, prediction.camera or URSO_CAMERA)
    with atomic_write(path) as temporary:
        drawn.save(temporary)
    return path
