"""From image files to poses."""

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
        image: The image's file.
        pose: The predicted pose.
        camera: The camera that took the image, of this or another size; None where it is not
            known.
        in_view_threshold: Below which probability the object is taken to be out of view; None
            where the weights hold none.
    """

    image: Path
    pose: Pose
    camera: Camera | None = None
    in_view_threshold: float | None = None

    @property
    def flagged(self) -> bool | None:
        """Whether the object seems not to be in view; None where the network does not tell."""
        if self.pose.uncertainty is None or self.in_view_threshold is None:
            return None
        return self.pose.uncertainty.in_view < self.in_view_threshold

    def to_dict(self) -> dict[str, Any]:
        """Return the prediction as JSON can hold it: meters, ``(w, x, y, z)``, degrees.

        Of a network that knows its uncertainty: covariances in m² and rad², a probability too.
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
    """Return one sigma of the distance, meters, and of the angle of rotation, degrees.

    The first is along the viewing ray to ``t``, ``sqrt(uᵀ C u)``; the second is the root mean
    square length of the rotation vector, ``sqrt(trace C)``.
    """
    ray = t / np.linalg.norm(t)
    distance = np.sqrt(ray @ uncertainty.translation_covariance @ ray)
    angle = np.sqrt(np.trace(uncertainty.rotation_covariance))
    return float(distance), float(np.degrees(angle))


class Predictor:
    """A trained model and the way from an image to its input.

    Args:
        model: The network; it is put in evaluation mode.
        preprocessing: From image to network input.
        camera: The camera whose images the preprocessing takes, of any size; None: any image.

    Attributes:
        model: As given.
        preprocessing: As given.
        camera: As given.

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

        Weights that do not know their camera take any image, resized to their input.

        Args:
            weights: The file, or the name of weights that come with the package.
            camera: The camera of the images to come, which are turned by geometry into the
                network's view; None: that of the weights.
            any_camera: Resize any image to the network's input, as if the weights' camera had
                taken it.

        Raises:
            FileNotFoundError: There is no such file or name.
            ValueError: The weights were altered, are of another kind of network, or both a camera
                and any are asked for.
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
        """Return the pose of the spacecraft in an RGB image, with its uncertainty if it has one.

        Raises:
            ValueError: The image has not the aspect ratio of its camera.
        """
        return self.batch([image])[0]

    def batch(self, images: Sequence[Image.Image]) -> list[Pose]:
        """Return the poses of several RGB images, at least one, which the network sees at once.

        Raises:
            ValueError: As for one image.
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
    """Return the poses of a batch, with their uncertainties where the network gives them."""
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
    """Predict the pose in each image file, one by one as they are asked for.

    Args:
        weights: As `Predictor.from_weights`, and so are the next two.
        images: Image files.
        camera: The camera of the images, where it is not that of the weights.
        any_camera: Take images of any camera, resized.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: The weights cannot be used.
        ffpose.DataError: As `ffpose.images.read_rgb`, or an image of another camera.
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
    """Return where the overlay of an image file goes: ``NAME_pose.png`` in ``folder``."""
    return folder / f"{image.stem}_pose.png"


def expect_distinct_overlays(images: Sequence[Path], folder: Path) -> None:
    """Check, before anything is computed, that no overlay would replace another.

    Raises:
        ValueError: Two images have one name; the text says which.
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
    """Write the image with the predicted axes drawn on it; without them if it is flagged.

    Args:
        prediction: The image, the pose and the camera; URSO's where there is none.
        folder: Where to write `overlay_path`; it is made where it is missing.

    Returns:
        The file written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    path = overlay_path(prediction.image, folder)
    drawn = read_rgb(prediction.image)
    if not prediction.flagged:
        drawn = draw_axes(drawn, prediction.pose, prediction.camera or URSO_CAMERA)
    with atomic_write(path) as temporary:
        drawn.save(temporary)
    return path
