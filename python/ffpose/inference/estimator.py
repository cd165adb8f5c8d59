"""Pose estimation from images, whatever computes the network; torch is not imported here."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias, TypeVar, overload

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from ffpose.errors import expect
from ffpose.geometry import Camera, Pose, poses
from ffpose.imaging.images import check_white, read_rgb
from ffpose.imaging.reprojection import expect_aspect, for_images

if TYPE_CHECKING:
    from ffpose.models import WeightsMetadata
    from ffpose.onnx.backends import Session
    from ffpose.onnx.metadata import ModelMetadata

    Description: TypeAlias = WeightsMetadata | ModelMetadata

ImageLike: TypeAlias = str | Path | Image.Image | NDArray[np.uint8]
"""Path of an image file, Pillow image (RGB), or array ``(H, W, 3)``, uint8, RGB."""

AnyImage = TypeVar("AnyImage", bound=ImageLike)


class PoseEstimator:
    """A network with its preprocessing: poses from images; `ffpose.load` opens it.

    It can be copied and pickled, as for worker processes.

    Args:
        session: The network.
        metadata: What its file says of it.
        near: The network's single look, which takes points as its second input; None without.
        camera: Camera of the images, which are reprojected to the network's view if it is another
            than that of training; None for that of training.
        resize: Resize any image to the network's input, as if taken by the camera of training.
        white: White level of monochrome images of more than 8 bits, as for
            `ffpose.imaging.images.to_rgb`; None for that of training.

    Attributes:
        preprocessing: Conversion from image to network input.
        camera: Camera of the images, possibly for another image size; None where unknown.

    Raises:
        ValueError: Both ``camera`` and ``resize`` are given, or neither for a network that was
            trained on undistorted images; or ``white`` is no level.

    Examples:
        ``ffpose.load("soyuz")("image.png").t``
    """

    def __init__(
        self,
        session: Session,
        metadata: Description,
        *,
        near: Session | None = None,
        camera: Camera | None = None,
        resize: bool = False,
        white: float | str | None = None,
    ) -> None:
        if white is not None:
            check_white("white", white)
        self.session = session
        self.near = near
        self.metadata = metadata
        self.camera = camera or metadata.camera
        self.white = metadata.white if white is None else white
        self.preprocessing, self._expected = for_images(
            metadata.preprocessing,
            metadata.config.view_camera,
            metadata.camera,
            camera=camera,
            resize=resize,
            undistorted=metadata.undistorted,
            distortion=metadata.distortion,
        )

    @overload
    def __call__(self, image: ImageLike) -> Pose: ...

    @overload
    def __call__(self, image: list[AnyImage] | tuple[AnyImage, ...]) -> list[Pose]: ...

    def __call__(self, image: ImageLike | list[Any] | tuple[Any, ...]) -> Pose | list[Pose]:
        """Return the pose of the spacecraft in an image, with its uncertainty if there is one.

        From a network that locates the camera, the pose of the world in the camera frame.

        Args:
            image: Path of an image file, Pillow image (RGB), or array ``(H, W, 3)``, uint8, RGB;
                or a list of them, which is computed as one batch.

        Returns:
            The pose, or for a list the list of poses.

        Raises:
            FileNotFoundError: The file does not exist.
            ffpose.DataError: The file is not an image that converts to RGB without loss.
            TypeError: ``image`` is none of these, or its dtype is not uint8.
            ValueError: The shape is not ``(H, W, 3)``, the mode not RGB, the aspect ratio not the
                camera's, or a result is not finite.
        """
        images = image if isinstance(image, list | tuple) else [image]
        if not images:
            return []
        found = self.estimate(np.stack([self.preprocess(each) for each in images]))
        return found if images is image else found[0]

    def preprocess(self, image: ImageLike) -> NDArray[np.float32]:
        """Return the network's input ``(3, h, w)`` for an image; raises as for its pose."""
        picture = as_image(image, self.white)
        expect_aspect(self._expected, *picture.size)
        return self.preprocessing.array(picture)

    def estimate(
        self, inputs: NDArray[np.float32], points: NDArray[np.float64] | None = None
    ) -> list[Pose]:
        """Return the poses for a batch of inputs; arguments and errors are those of `run`."""
        return poses(
            **self.run(inputs, points),
            locates=self.metadata.locates,
            in_view_threshold=self.metadata.in_view_threshold,
            degrees_of_freedom=self.metadata.config.degrees_of_freedom,
        )

    def run(
        self, inputs: NDArray[np.float32], points: NDArray[np.float64] | None = None
    ) -> dict[str, NDArray[Any]]:
        """Return the network's outputs by name for a batch of inputs.

        Args:
            inputs: Images ``(B, 3, h, w)``, float32, standardized as by `preprocess`.
            points: Where the objects are expected ``(B, 3)``, meters, camera frame, in front of
                the camera, for a single look there; None for everywhere.

        Returns:
            ``translation (B, 3)``, meters, and ``orientation (B, 4)``, scalar first and of either
            sign; with predicted uncertainty also ``translation_covariance (B, 3, 3)``,
            ``rotation_covariance (B, 3, 3)``, ``in_view (B,)``, ``alternative (B, 4)`` and
            ``probabilities (B, 2)``.

        Raises:
            TypeError: The dtype is not float32.
            ValueError: A shape is not as above, a number is not finite, a point is not in front of
                the camera, or there are points and the network's single look was not opened.
        """
        height, width = self.preprocessing.size
        if inputs.dtype != np.float32:
            raise TypeError(f"inputs: expected float32, got {inputs.dtype}")
        fits = inputs.ndim == 4 and inputs.shape[1:] == (3, height, width)
        expect(fits, "inputs", f"shape (B, 3, {height}, {width})", inputs.shape)
        if not np.isfinite(inputs).all():
            raise ValueError("inputs: expected finite numbers, got NaN or infinity")
        if points is None:
            return self.session.run(inputs)
        if self.near is None:
            raise ValueError(
                "points: expected an estimator of ffpose.load(track=True) of weights with a second"
                " look, or of a graph beside its .track.onnx, got one without single looks"
            )
        if points.shape != (len(inputs), 3) or not np.isfinite(points).all():
            raise ValueError(
                f"points: expected finite numbers of shape ({len(inputs)}, 3), got {points}"
            )
        with np.errstate(over="ignore", under="ignore"):  # the network computes so
            near = points.astype(np.float32)
            squared = (near * near).sum(axis=1)
        behind = (near[:, 2] <= 0) | (squared == 0) | ~np.isfinite(squared)
        if behind.any():
            got = points[behind.argmax()].tolist()
            raise ValueError(f"points: expected in front of the camera, z above 0, got {got}")
        return self.near.run(inputs, near)

    def warm_up(self, runs: int) -> None:
        """Run the network on a black image, so that memory is allocated and plans are made."""
        black = np.zeros((1, 3, *self.preprocessing.size), np.float32)
        for _ in range(runs):
            self.run(black)
            if self.near is not None:
                self.run(black, np.array([[0.0, 0.0, 1.0]]))


def as_image(image: ImageLike, white: float | str | None = None) -> Image.Image:
    """Convert to a Pillow image, RGB, as `PoseEstimator`; ``white`` is as of `read_rgb`."""
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
