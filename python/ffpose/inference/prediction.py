"""Poses of image files, as data and as text, and drawn on the images."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ffpose._internal.files import atomic_write
from ffpose.arrays import quaternion_to_euler
from ffpose.config import NetworkConfig, looks_twice
from ffpose.errors import DataError, expect, explain
from ffpose.geometry import CAMERA_FILE, Camera, FloatArray, Pose, Target, standard_deviations
from ffpose.imaging.images import read_rgb
from ffpose.imaging.overlay import draw_axes
from ffpose.inference.estimator import PoseEstimator

TOLD = 0.1
"""Least probability of a second attitude that is told in words."""


@dataclass(frozen=True)
class Prediction:
    """The pose seen in one image: of the object, or of the world if the network locates the camera.

    The camera may be for another image size, and None where unknown; ``white`` is the level of an
    image of more than 8 bits that becomes 255; ``axis_m`` the length of axes that are drawn, as
    of `ffpose.imaging.overlay.draw_axes`.
    """

    image: Path
    pose: Pose
    camera: Camera | None = None
    locates: Target = "object"
    white: float | str | None = None
    axis_m: float | None = None

    @property
    def center(self) -> FloatArray:
        """The camera's center in the frame of the object or world ``(3,)``, meters."""
        return self.pose.camera_center

    def to_dict(self) -> dict[str, Any]:
        """Return the prediction as a JSON document: meters, ``(w, x, y, z)``, degrees.

        With predicted uncertainty also covariances in m² and rad², degrees of freedom (null for
        Gaussian errors), the second most likely orientation with the probabilities of both, and the
        probability in view. Where the network locates the camera, ``locates`` and its center say
        so.
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
            document["degrees_of_freedom"] = uncertainty.degrees_of_freedom
            if uncertainty.alternative is not None:
                document["alternative_wxyz"] = uncertainty.alternative.tolist()
            document["probabilities"] = list(uncertainty.probabilities)
            document["in_view"] = uncertainty.in_view
        if self.pose.flagged is not None:
            document["flagged"] = self.pose.flagged
        return document

    def __str__(self) -> str:
        uncertainty = self.pose.uncertainty
        if uncertainty is not None and self.pose.flagged:
            below = f"p = {uncertainty.in_view:.4f}, threshold {uncertainty.in_view_threshold:.4f}"
            return f"{self.image}: no spacecraft in view ({below})"
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
            if uncertainty.alternative is not None and uncertainty.probabilities[1] >= TOLD:
                roll_2, pitch_2, yaw_2 = quaternion_to_euler(uncertainty.alternative)
                degrees += (
                    f", or roll {roll_2:.1f}°, pitch {pitch_2:.1f}°, yaw {yaw_2:.1f}°"
                    f" (p = {uncertainty.probabilities[1]:.2f})"
                )
        return (
            f"{self.image}: t = ({x:.2f}, {y:.2f}, {z:.2f}) m{meters}, "
            f"roll {roll:.1f}°, pitch {pitch:.1f}°, yaw {yaw:.1f}°{degrees}"
        )


@dataclass(frozen=True)
class Failure:
    """An image file that has no pose, and why."""

    image: Path
    error: Exception

    def to_dict(self) -> dict[str, Any]:
        """Return the failure as a JSON document."""
        return {"image": str(self.image), "error": explain(self.error)}

    def __str__(self) -> str:
        return explain(self.error)


def predict(
    estimator: PoseEstimator,
    images: Iterable[Path],
    *,
    batch: int = 1,
    point: NDArray[np.float64] | None = None,
) -> Iterator[Prediction | Failure]:
    """Predict the pose in each image file, in order, as soon as it is known.

    A file that cannot be used, as it is missing, damaged or of another camera, is a `Failure`, and
    those after it are still predicted. ``batch`` images are computed together; ``point`` is where
    the object is expected ``(3,)``, as in `PoseEstimator.run`.

    Raises:
        ValueError: ``batch`` is below one.
    """
    expect(batch >= 1, "batch", "at least 1", batch)
    paths, metadata = iter(images), estimator.metadata
    about = estimator.camera, metadata.locates, estimator.white, axis_length(metadata.config)
    return (
        Failure(path, answer) if isinstance(answer, Exception) else Prediction(path, answer, *about)
        for some in iter(lambda: list(islice(paths, batch)), [])
        for path, answer in zip(some, _answers(estimator, some, point), strict=True)
    )


def _answers(
    estimator: PoseEstimator, paths: Sequence[Path], point: NDArray[np.float64] | None
) -> list[Pose | Exception]:
    """Return for each file its pose, or why it has none."""
    inputs: dict[int, NDArray[np.float32]] = {}
    answers: dict[int, Pose | Exception] = {}
    for place, path in enumerate(paths):
        try:
            inputs[place] = estimator.preprocess(path)
        except (OSError, DataError) as error:
            answers[place] = error
        except ValueError as error:
            answers[place] = DataError(str(error), path)

    def posed(places: list[int]) -> list[Pose | Exception]:
        points = None if point is None else np.tile(point, (len(places), 1))
        try:
            return [*estimator.estimate(np.stack([inputs[each] for each in places]), points)]
        except ValueError as error:  # a number that is not finite, of one image or more
            if len(places) == 1:
                return [DataError(str(error), paths[places[0]])]
            return [answer for each in places for answer in posed([each])]

    if inputs:
        answers.update(zip(inputs, posed([*inputs]), strict=True))
    return [answers[place] for place in range(len(paths))]


def axis_length(config: NetworkConfig) -> float | None:
    """Return the length of an object's axes where they are drawn, meters; None of unknown size."""
    return config.object_radius_m / 3 if looks_twice(config) else None


def camera_beside(images: Iterable[Path]) -> Camera | None:
    """Return the camera of the file ``camera.json`` beside images; None where there is none.

    Raises:
        ValueError: Some images lie beside that of another camera, or beside none.
        ffpose.DataError: The file does not describe a camera.
    """
    found = {
        folder: Camera.read(folder / CAMERA_FILE) if (folder / CAMERA_FILE).is_file() else None
        for folder in dict.fromkeys(image.parent for image in images)
    }
    first = next(iter(found), Path())
    for folder, camera in found.items():
        if camera != found[first]:
            raise ValueError(
                f"camera: expected one beside all images, got {found[first]} in {first} and"
                f" {camera} in {folder}; --camera FILE names one"
            )
    return found.get(first)


def overlay_path(image: Path, folder: Path) -> Path:
    """Return the path of an image's overlay, ``NAME_pose.png`` in ``folder``."""
    return folder / f"{image.stem}_pose.png"


def expect_axes(estimator: PoseEstimator) -> None:
    """Raise a ValueError if there is no object to draw axes on, or no camera to project them."""
    found = estimator.metadata.locates
    expect(found == "object", "overlay", "weights that locate an object", found)
    if estimator.camera is None:
        raise ValueError("overlay: expected --camera FILE, as these weights know no camera")


def expect_distinct_overlays(images: Sequence[Path], folder: Path) -> None:
    """Raise a ValueError if an overlay would overwrite another, or an image."""
    first: dict[Path, Path] = {}
    known = {os.path.realpath(image) for image in images}  # of links in a circle, too
    for image in images:
        path = overlay_path(image, folder)
        other = first.setdefault(path, image)
        if other is not image:
            raise ValueError(
                f"overlay: expected images of distinct names, got {other} and {image}, both for"
                f" {path}"
            )
        if os.path.realpath(path) in known:
            raise ValueError(
                f"overlay: expected a folder without the images, got {folder}, where that of"
                f" {image} would overwrite {path}"
            )


def write_overlay(prediction: Prediction, folder: Path) -> Path:
    """Write an image with its axes drawn on it, or without if it is flagged; return its path.

    Raises:
        ValueError: The prediction has no camera.
    """
    if prediction.camera is None:
        raise ValueError("prediction: expected one with a camera, got camera None")
    folder.mkdir(parents=True, exist_ok=True)
    path = overlay_path(prediction.image, folder)
    drawn = read_rgb(prediction.image, prediction.white)
    if not prediction.pose.flagged:
        drawn = draw_axes(drawn, prediction.pose, prediction.camera, prediction.axis_m)
    with atomic_write(path) as temporary:
        drawn.save(temporary)
    return path
