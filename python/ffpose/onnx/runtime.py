"""Poses from images by an exported graph: NumPy, Pillow and a runtime, without torch."""

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
    """A graph of ``ffpose export`` and the way from an image to its input.

    Args:
        model: The ONNX file.
        camera: The camera of the images to come, which are turned by geometry into the network's
            view; None: that of the weights.
        any_camera: Resize any image to the network's input, as if the weights' camera had taken it.
        backend: ``"onnxruntime"`` or ``"openvino"``.
        threads: That an image is computed with; None: as many as the backend finds good.
        providers: ONNX Runtime's execution providers; None for the CPU's.
        precision: ``"float32"``, or ``"bfloat16"`` where backend and CPU have it.
        warm_up: Runs on a black image before the first real one, whose memory and plans they make.

    Attributes:
        metadata: What the graph says of itself.
        preprocessing: From image to network input.
        camera: The camera whose aspect ratio an image must have; None for any.

    Raises:
        FileNotFoundError: There is no such file, or the custom operator's library is missing.
        MissingExtraError: The backend is not installed.
        ffpose.DataError: The file is no graph of ``ffpose export``, is altered, or is newer than
            this version.
        ValueError: A choice that backend or CPU cannot do, or both a camera and any are asked for.
        RuntimeError: The backend cannot load graph or library.

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
            image: A file; or a Pillow image, RGB; or an array ``(H, W, 3)``, uint8, RGB.

        Raises:
            FileNotFoundError: There is no such file.
            ffpose.DataError: The file is no image that becomes RGB without loss.
            TypeError: No image, or an array of another dtype.
            ValueError: An array of another shape, an image of another mode, of another aspect ratio
                than its camera's, or a result that is not finite.
        """
        return self.batch([image])[0]

    def batch(self, images: Sequence[ImageLike] | NDArray[np.uint8]) -> list[Pose]:
        """Return the poses of several images, which the network sees at once; raises as for one.

        Args:
            images: As for one each, or an array ``(B, H, W, 3)``.
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
            inputs: ``(B, 3, h, w)``, float32, standardized as `preprocess` does.

        Returns:
            ``translation (B, 3)``, meters, and ``orientation (B, 4)``, scalar first and of either
            sign; of a network that knows its uncertainty ``translation_covariance (B, 3, 3)``,
            ``rotation_covariance (B, 3, 3)`` and ``in_view (B,)`` too.

        Raises:
            TypeError: Another dtype.
            ValueError: Another shape, or a number that is not finite.
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
    """Return a Pillow image, RGB; raises as `PoseEstimator`.

    Args:
        image: As there.
        white: Level of a file of more than 8 bits that becomes 255.
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
