"""From image files to poses."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from PIL import Image

from ffpose.arrays import quaternion_to_euler
from ffpose.files import atomic_write
from ffpose.geometry import URSO_CAMERA, Camera, Pose
from ffpose.images import read_rgb
from ffpose.models import FilterformerPose, read_metadata
from ffpose.overlay import draw_axes
from ffpose.transforms import Preprocessing


@dataclass(frozen=True)
class Prediction:
    """The pose seen in one image.

    Attributes:
        image: The image's file.
        pose: The predicted pose.
    """

    image: Path
    pose: Pose

    def to_dict(self) -> dict[str, Any]:
        """Return the prediction as JSON can hold it: metres, ``(w, x, y, z)``, degrees."""
        return {
            "image": str(self.image),
            "translation_m": self.pose.t.tolist(),
            "orientation_wxyz": self.pose.q.tolist(),
            "roll_pitch_yaw_deg": quaternion_to_euler(self.pose.q).tolist(),
        }

    def __str__(self) -> str:
        x, y, z = self.pose.t
        roll, pitch, yaw = quaternion_to_euler(self.pose.q)
        return (
            f"{self.image}: t = ({x:.2f}, {y:.2f}, {z:.2f}) m, "
            f"roll {roll:.1f}°, pitch {pitch:.1f}°, yaw {yaw:.1f}°"
        )


class Predictor:
    """A trained model and the preprocessing that its weights record.

    Args:
        model: The network; it is put in evaluation mode.
        preprocessing: From image to network input.

    Attributes:
        model: As given.
        preprocessing: As given.

    Example:
        ``Predictor.from_weights("best.safetensors")(Image.open("0_rgb.png").convert("RGB"))``
    """

    def __init__(self, model: FilterformerPose, preprocessing: Preprocessing) -> None:
        self.model = model.eval()
        self.preprocessing = preprocessing

    @classmethod
    def from_weights(cls, path: Path) -> Predictor:
        """Load weights.

        Raises:
            FileNotFoundError: There is no such file.
            ValueError: The weights were altered, or are of another kind of network.
        """
        return cls(FilterformerPose.from_pretrained(path), read_metadata(path).preprocessing)

    def __call__(self, image: Image.Image) -> Pose:
        """Return the pose of the spacecraft in an RGB image of any size."""
        inputs = self.preprocessing(image)[None]
        with torch.inference_mode():
            pose = self.model(inputs)
        return Pose(pose.translation[0].double().numpy(), pose.orientation[0].double().numpy())


def predict(weights: Path, images: Sequence[Path]) -> Iterator[Prediction]:
    """Predict the pose in each image file, one by one as they are asked for.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: The weights cannot be used.
        ffpose.DataError: As `ffpose.images.read_rgb`.
    """
    predictor = Predictor.from_weights(weights)
    for path in images:
        yield Prediction(path, predictor(read_rgb(path)))


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


def write_overlay(prediction: Prediction, folder: Path, camera: Camera = URSO_CAMERA) -> Path:
    """Write the image with the predicted axes drawn on it.

    Args:
        prediction: The image and the pose.
        folder: Where to write `overlay_path`; it is made where it is missing.
        camera: The camera that took the image; it is resized to the image's size.

    Returns:
        The file written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    path = overlay_path(prediction.image, folder)
    drawn = draw_axes(read_rgb(prediction.image), prediction.pose, camera)
    with atomic_write(path) as temporary:
        drawn.save(temporary)
    return path
