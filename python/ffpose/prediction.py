"""From image files to poses, as data and as words; no torch unless the network needs it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from PIL import Image

from ffpose.arrays import quaternion_to_euler
from ffpose.errors import DataError
from ffpose.files import atomic_write
from ffpose.geometry import URSO_CAMERA, Camera, FloatArray, Pose, PoseUncertainty
from ffpose.images import read_rgb
from ffpose.overlay import draw_axes


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
        """Return the prediction as JSON can hold it: metres, ``(w, x, y, z)``, degrees.

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
        metres = degrees = ""
        if uncertainty is not None:
            distance, angle = standard_deviations(self.pose.t, uncertainty)
            metres, degrees = f" ± {distance:.2f} m along the ray", f" ± {angle:.1f}°"
        return (
            f"{self.image}: t = ({x:.2f}, {y:.2f}, {z:.2f}) m{metres}, "
            f"roll {roll:.1f}°, pitch {pitch:.1f}°, yaw {yaw:.1f}°{degrees}"
        )


def standard_deviations(t: FloatArray, uncertainty: PoseUncertainty) -> tuple[float, float]:
    """Return one sigma of the distance, metres, and of the angle of rotation, degrees.

    The first is along the viewing ray to ``t``, ``sqrt(uᵀ C u)``; the second is the root mean
    square length of the rotation vector, ``sqrt(trace C)``.
    """
    ray = t / np.linalg.norm(t)
    distance = np.sqrt(ray @ uncertainty.translation_covariance @ ray)
    angle = np.sqrt(np.trace(uncertainty.rotation_covariance))
    return float(distance), float(np.degrees(angle))


class Network(Protocol):
    """A network that poses images: by torch (`ffpose.predictor`) or without (`ffpose.onnx`)."""

    def __call__(self, image: Image.Image) -> Pose:
        """Return the pose of the spacecraft in an RGB image."""


class Description(Protocol):
    """What weights and exported graphs say of themselves."""

    @property
    def camera(self) -> Camera | None:
        """The camera of the images trained on; None where it is not known."""

    @property
    def in_view_threshold(self) -> float | None:
        """As `Prediction`."""


def open_network(
    weights: str | Path, *, camera: Camera | None = None, any_camera: bool = False
) -> Network:
    """Open weights or, by the suffix ``.onnx``, an exported graph; torch is only for the former.

    Args:
        weights: Of `ffpose.predictor.Predictor.from_weights`, or `ffpose.onnx.runtime`'s model.
        camera: As there, and so is the next.
        any_camera: Take images of any camera, resized.

    Raises:
        FileNotFoundError: There is no such file or name.
        ValueError: It cannot be used, or both a camera and any are asked for.
    """
    if is_graph(weights):
        from ffpose.onnx.runtime import PoseEstimator

        return PoseEstimator(weights, camera=camera, any_camera=any_camera)
    from ffpose.predictor import Predictor

    return Predictor.from_weights(weights, camera=camera, any_camera=any_camera)


def describe(weights: str | Path) -> Description:
    """Read what weights, or an exported graph, say of themselves; raises as `open_network`."""
    if is_graph(weights):
        from ffpose.onnx.metadata import read_model_metadata

        return read_model_metadata(weights)
    from ffpose.models import read_metadata

    return read_metadata(weights)


def is_graph(weights: str | Path) -> bool:
    """Whether a path is that of an exported graph."""
    return Path(weights).suffix.lower() == ".onnx"


def predict(
    weights: str | Path,
    images: Sequence[Path],
    *,
    camera: Camera | None = None,
    any_camera: bool = False,
) -> Iterator[Prediction]:
    """Predict the pose in each image file, one by one as they are asked for.

    Args:
        weights: As `open_network`, and so are the next two.
        images: Image files.
        camera: The camera of the images, where it is not that of the weights.
        any_camera: Take images of any camera, resized.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: The weights cannot be used.
        ffpose.DataError: As `ffpose.images.read_rgb`, or an image of another camera.
    """
    description = describe(weights)
    network = open_network(weights, camera=camera, any_camera=any_camera)
    for path in images:
        image = read_rgb(path)
        try:
            pose = network(image)
        except ValueError as error:
            raise DataError(str(error), path) from error
        yield Prediction(path, pose, camera or description.camera, description.in_view_threshold)


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
