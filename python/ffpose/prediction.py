"""Pose prediction for image files, as data and as text; imports torch only for weights."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from PIL import Image

from ffpose.arrays import quaternion_to_euler
from ffpose.errors import DataError
from ffpose.files import atomic_write
from ffpose.geometry import (
    Camera,
    FloatArray,
    Pose,
    PoseUncertainty,
    Target,
)
from ffpose.images import read_rgb
from ffpose.overlay import draw_axes

if TYPE_CHECKING:
    from ffpose.models import WeightsMetadata
    from ffpose.onnx.metadata import ModelMetadata


@dataclass(frozen=True)
class Prediction:
    """The pose seen in one image.

    Attributes:
        image: Path of the image file.
        pose: The predicted pose of the object or, from a network that locates the camera, of the
            world in the camera frame.
        camera: The camera of the image, possibly for another image size; None where unknown.
        in_view_threshold: Probability below which the object counts as not in view; None where
            the weights have no threshold.
        locates: What the network locates.
        white: Level of an image of more than 8 bits that becomes 255.
    """

    image: Path
    pose: Pose
    camera: Camera | None = None
    in_view_threshold: float | None = None
    locates: Target = "object"
    white: float | str | None = None

    @property
    def center(self) -> FloatArray:
        """The camera's center in the frame of the object or world ``(3,)``, meters."""
        return np.asarray(-self.pose.rotation.T @ self.pose.t)

    @property
    def flagged(self) -> bool | None:
        """Whether the object counts as not in view; None where the network does not predict it."""
        if self.pose.uncertainty is None or self.in_view_threshold is None:
            return None
        return self.pose.uncertainty.in_view < self.in_view_threshold

    def to_dict(self) -> dict[str, Any]:
        """Return the prediction as a JSON document: meters, ``(w, x, y, z)``, degrees.

        With predicted uncertainty also covariances in m² and rad², and the probability in view.
        Where the network locates the camera, ``locates`` says so, the pose is the world's, and the
        camera's center in the world is there too.
        """
        document: dict[str, Any] = {
            "image": str(self.image),
            "translation_m": self.pose.t.tolist(),
            "orientation_wxyz": self.pose.q.tolist(),
            "roll_pitch_yaw_deg": quaternion_to_euler(self.pose.q).tolist(),
        }
        if self.locates == "camera":
            document |= {"locates": "camera", "camera_center_m": self.center.tolist()}
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
        roll, pitch, yaw = quaternion_to_euler(self.pose.q)
        if self.locates == "camera":
            x, y, z = self.center
            return (
                f"{self.image}: camera at ({x:.2f}, {y:.2f}, {z:.2f}) m in the world, "
                f"world to camera: roll {roll:.1f}°, pitch {pitch:.1f}°, yaw {yaw:.1f}°"
            )
        x, y, z = self.pose.t
        meters = degrees = ""
        if uncertainty is not None:
            distance, in_plane, out_of_plane = standard_deviations(self.pose.t, uncertainty)
            meters = f" ± {distance:.2f} m along the ray"
            degrees = f" ± {in_plane:.1f}° in plane, ± {out_of_plane:.1f}° out of plane"
        return (
            f"{self.image}: t = ({x:.2f}, {y:.2f}, {z:.2f}) m{meters}, "
            f"roll {roll:.1f}°, pitch {pitch:.1f}°, yaw {yaw:.1f}°{degrees}"
        )


def standard_deviations(t: FloatArray, uncertainty: PoseUncertainty) -> tuple[float, float, float]:
    """Return the standard deviations of the distance and of the rotation's two parts.

    Along the viewing ray ``u`` to ``t``: ``sqrt(uᵀ C u)`` of the translation, meters, and of the
    rotation vector, which is the rotation in plane, degrees; and out of plane, the root mean square
    length of the rotation vector across the ray, ``sqrt(trace C - uᵀ C u)``, degrees.
    """
    ray = t / np.linalg.norm(t)
    distance = np.sqrt(ray @ uncertainty.translation_covariance @ ray)
    along = ray @ uncertainty.rotation_covariance @ ray
    across = np.trace(uncertainty.rotation_covariance) - along
    return float(distance), *np.degrees(np.sqrt([along, across])).tolist()


class Network(Protocol):
    """A network over images: by torch (`ffpose.predictor`) or without (`ffpose.onnx`)."""

    def __call__(self, image: Image.Image) -> Pose:
        """Return the pose of the spacecraft in an RGB image.

        From a network that locates the camera, the pose of the world in the camera frame.
        """


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


def describe(weights: str | Path) -> WeightsMetadata | ModelMetadata:
    """Read the header of weights or of an exported graph; raises as `open_network`."""
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
    """Predict the pose in each image file, lazily, up to the first that cannot be used.

    Args:
        weights: Weights file, name of shipped weights, or exported ``.onnx`` graph.
        images: Image files.
        camera: Camera of the images, if other than the weights'.
        any_camera: Resize images of any camera to the network's input.

    Raises:
        FileNotFoundError: A file does not exist.
        ValueError: The weights cannot be used.
        ffpose.DataError: An image cannot be read, or its aspect ratio differs from its camera's.
    """
    yield from map(open_predictions(weights, camera=camera, any_camera=any_camera), images)


def open_predictions(
    weights: str | Path, *, camera: Camera | None = None, any_camera: bool = False
) -> Callable[[Path], Prediction]:
    """Open weights and return the function from an image file to its prediction.

    Arguments and errors are those of `predict`.
    """
    description = describe(weights)
    network = open_network(weights, camera=camera, any_camera=any_camera)

    def predicted(path: Path) -> Prediction:
        image = read_rgb(path, description.white)
        try:
            pose = network(image)
        except ValueError as error:
            raise DataError(str(error), path) from error
        return Prediction(
            path,
            pose,
            camera or description.camera,
            description.in_view_threshold,
            description.locates,
            description.white,
        )

    return predicted


def overlay_path(image: Path, folder: Path) -> Path:
    """Return the path of an image's overlay, ``NAME_pose.png`` in ``folder``."""
    return folder / f"{image.stem}_pose.png"


def expect_axes(weights: str | Path, camera: Camera | None) -> None:
    """Check in advance that there is an object to draw axes on, and a camera to project them.

    Raises:
        ValueError: The network locates the camera, or neither its weights nor ``camera`` say what
            the images' camera is.
    """
    metadata = describe(weights)
    if metadata.locates == "camera":
        raise ValueError(
            "overlay: expected weights that locate an object, got some that locate the camera"
        )
    if metadata.camera is None and camera is None:
        raise ValueError("overlay: expected --camera FILE, as these weights know no camera")


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
        prediction: Image, pose and camera.
        folder: Folder to write `overlay_path` to; created if missing.

    Returns:
        The path of the file.

    Raises:
        ValueError: The prediction has no camera.
    """
    if prediction.camera is None:
        raise ValueError("prediction: expected one with a camera, got camera None")
    folder.mkdir(parents=True, exist_ok=True)
    path = overlay_path(prediction.image, folder)
    drawn = read_rgb(prediction.image, prediction.white)
    if not prediction.flagged:
        drawn = draw_axes(drawn, prediction.pose, prediction.camera)
    with atomic_write(path) as temporary:
        drawn.save(temporary)
    return path
