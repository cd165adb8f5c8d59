"""Pose estimation with an exported graph: NumPy, Pillow and a runtime, without torch."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from ffpose.geometry import Camera, Pose, poses
from ffpose.images import read_rgb
from ffpose.onnx.backends import Backend, Precision, open_session
from ffpose.onnx.metadata import read_model_metadata
from ffpose.reprojection import expect_aspect, for_images

ImageLike = str | Path | Image.Image | NDArray[np.uint8]


class PoseEstimator:
    """A graph written by ``ffpose export``, with its preprocessing: poses from images.

    Args:
        model: Path of the ONNX file.
        camera: Camera of the images, which are reprojected to the network's view; None for the
            weights' own camera.
        any_camera: Resize any image to the network's input, as if taken by the weights' camera.
        backend: ``"onnxruntime"`` or ``"openvino"``.
        threads: Number of threads within an image; None for the backend's default.
        providers: ONNX Runtime's execution providers; None for the CPU's.
        precision: ``"float32"``, or ``"bfloat16"`` where backend and CPU support it.
        warm_up: Number of runs on a black image at construction, which allocate memory and plan.

    Attributes:
        metadata: Metadata of the graph.
        preprocessing: Conversion from image to network input.
        camera: Camera whose aspect ratio an image must have; None for any.

    Raises:
        FileNotFoundError: The file does not exist, or the custom operator's library is missing.
        MissingExtraError: The backend is not installed.
        ffpose.DataError: The file was not written by ``ffpose export``, was altered, or is newer
            than this version.
        ValueError: Backend or CPU do not support a choice, or both ``camera`` and ``any_camera``
            are given.
        RuntimeError: The backend cannot load the graph or the library.

    Examples:
        ``PoseEstimator("model.onnx", threads=1)("image.png").t``
    """

    def __init__(
        self,
        model: str | Path,
        *,
        camera: Camera | None = None,
        any_camera: bool = False,
        backend: Backend = "onnxruntime",
        threads: int | None = None,
        providers: Sequence[str] | None = None,
        precision: Precision = "float32",
        warm_up: int = 1,
    ) -> None:
        self.metadata = read_model_metadata(model)
        self.preprocessing, self.camera = for_images(
            self.metadata.preprocessing,
            self.metadata.config.view_camera,
            self.metadata.camera,
            camera=camera,
            any_camera=any_camera,
            undistorted=self.metadata.undistorted,
        )
        self._session = open_session(
            Path(model),
            self.metadata.filter,
            backend=backend,
            threads=threads,
            providers=providers,
            precision=precision,
        )
        black = np.zeros((1, 3, *self.metadata.config.image_size), np.float32)
        for _ in range(warm_up):
            self._session.run(black)

    def __call__(self, image: ImageLike) -> Pose:
        """Return the pose of the spacecraft in an image, with its uncertainty if there is one.

        From a network that locates the camera, the pose of the world in the camera frame.

        Args:
            image: Path of an image file, Pillow image (RGB), or array ``(H, W, 3)``, uint8, RGB.

        Raises:
            FileNotFoundError: The file does not exist.
            ffpose.DataError: The file is not an image that converts to RGB without loss.
            TypeError: ``image`` is none of these, or its dtype is not uint8.
            ValueError: The shape is not ``(H, W, 3)``, the mode not RGB, the aspect ratio not the
                camera's, or a result is not finite.
        """
        return self.batch([image])[0]

    def batch(self, images: Sequence[ImageLike] | NDArray[np.uint8]) -> list[Pose]:
        """Return the poses of several images, computed as one batch; raises as for one.

        Args:
            images: Images as for one, or an array ``(B, H, W, 3)``.
        """
        if len(images) == 0:
            return []
        inputs = [self.preprocess(image) for image in images]
        return poses(**self.run(np.stack(inputs)), locates=self.metadata.locates)

    def preprocess(self, image: ImageLike) -> NDArray[np.float32]:
        """Return the network's input ``(3, h, w)`` for an image; raises as for its pose."""
        picture = as_image(image, self.metadata.white)
        expect_aspect(self.camera, *picture.size)
        return self.preprocessing.array(picture)

    def run(self, inputs: NDArray[np.float32]) -> dict[str, NDArray[Any]]:
        """Return the network's outputs by name for a batch of inputs.

        Args:
            inputs: Images ``(B, 3, h, w)``, float32, standardized as by `preprocess`.

        Returns:
            ``translation (B, 3)``, meters, and ``orientation (B, 4)``, scalar first and of either
            sign; with predicted uncertainty also ``translation_covariance (B, 3, 3)``,
            ``rotation_covariance (B, 3, 3)`` and ``in_view (B,)``.

        Raises:
            TypeError: The dtype is not float32.
            ValueError: The shape is not ``(B, 3, h, w)``, or a number is not finite.
        """
        expected = (3, *self.metadata.config.image_size)
        if inputs.dtype != np.float32:
            raise TypeError(f"inputs: expected float32, got {inputs.dtype}")
        if inputs.ndim != 4 or inputs.shape[1:] != expected:
            sizes = ", ".join(map(str, expected))
            raise ValueError(f"inputs: expected shape (B, {sizes}), got {inputs.shape}")
        if not np.isfinite(inputs).all():
            raise ValueError("inputs: expected finite numbers, got NaN or infinity")
        return self._session.run(inputs)


def as_image(image: ImageLike, white: float | str | None = None) -> Image.Image:
    """Convert to a Pillow image, RGB; raises as `PoseEstimator`.

    Args:
        image: Image as there.
        white: Level that becomes 255 in a file of more than 8 bits.
    """
    if isinstance(image, str | Path):
        return read_rgb(Path(image), white)
    if isinstance(image, Image.Image):
        if image.mode != "RGB":
            raise ValueError(f"image: expected mode RGB, got {image.mode}")
        return image
    if not isinstance(image, np.ndarray):
        raise TypeError(
            f"image: expected a path, a Pillow image or an array, got {type(image).__name__}"
        )
    if image.dtype != np.uint8:
        raise TypeError(f"image: expected an array of uint8, got {image.dtype}")
    if image.ndim != 3 or image.shape[2] != 3 or 0 in image.shape:
        raise ValueError(f"image: expected an array (H, W, 3), got shape {image.shape}")
    return Image.fromarray(image)
