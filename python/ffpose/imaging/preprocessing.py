"""Preprocessing of an image to the network's input, shared by training and deployment.

By default the *whole* frame is resized: the target of an object pose may stand anywhere in it, and
a crop that moves the target without its label teaches a wrong position. Ye et al. (Sensors 2023,
23, 8633, section 4.3) do crop: mode ``"center_crop"``, trained with
``Augmentation(random_crop=True)`` of `ffpose.imaging.transforms`; with ``turned_crop`` the label is
true.

NumPy and Pillow do all of it, so that it runs where there is no torch. Images are Pillow's RGB;
sizes are ``(height, width)``.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from ffpose.errors import check_choices, expect
from ffpose.geometry import Camera

if TYPE_CHECKING:
    from torch import Tensor

Mode = Literal["resize", "center_crop"]
Interpolation = Literal["bilinear", "bicubic"]

IMAGENET_MEAN = (0.485, 0.456, 0.406)
IMAGENET_STD = (0.229, 0.224, 0.225)

CROP_MARGIN = 256 / 224
"""Frame over crop: the usual 256 pixels that a crop of 224 is cut from; the paper names neither."""


class Window(NamedTuple):
    """A crop: the frame's rows ``top`` and columns ``left`` onwards."""

    top: int
    left: int


def planes(pixels: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Return pixels ``(h, w, 3)`` as float32 ``(3, h, w)`` in [0, 1]."""
    floats = np.ascontiguousarray(pixels.transpose(2, 0, 1), np.float32)
    floats /= 255
    return floats


@dataclass(frozen=True)
class Preprocessing:
    """Conversion of an image to the network's input: frame, crop, resize, standardize.

    Attributes:
        size: ``(height, width)`` of the network's input.
        mode: ``"resize"`` resizes the whole image to ``size``, each axis by its own factor.
            ``"center_crop"`` is the paper's: the image is resized, keeping its aspect ratio, until
            it exceeds ``size`` by `CROP_MARGIN`, and the center is cropped.
        mean: Per-channel mean (red, green, blue in [0, 1]), which is subtracted.
        std: Per-channel standard deviation, by which the result is divided.
        interpolation: Interpolation of the resize: ``"bilinear"`` or ``"bicubic"``, antialiased.

    Raises:
        ValueError: A size below one, an unknown mode or interpolation, or a mean or std that cannot
            be used.
    """

    size: tuple[int, int] = (224, 224)
    mode: Mode = "resize"
    mean: tuple[float, float, float] = IMAGENET_MEAN
    std: tuple[float, float, float] = IMAGENET_STD
    interpolation: Interpolation = "bilinear"

    def __post_init__(self) -> None:
        if len(self.size) != 2 or min(self.size) < 1:
            raise ValueError(f"size: expected (height, width), each at least 1, got {self.size}")
        check_choices(self)
        if len(self.mean) != 3 or not all(map(math.isfinite, self.mean)):
            raise ValueError(f"mean: expected three finite numbers, got {self.mean}")
        if len(self.std) != 3 or not all(math.isfinite(s) and s > 0 for s in self.std):
            raise ValueError(f"std: expected three finite numbers above 0, got {self.std}")

    def frame_size(self, width: int, height: int) -> tuple[int, int]:
        """Return ``(height, width)`` of the frame for an image of ``width`` x ``height``."""
        if self.mode == "resize":
            return self.size
        scale = CROP_MARGIN * max(self.size[0] / height, self.size[1] / width)
        return round(height * scale), round(width * scale)

    def frame(self, image: Image.Image) -> NDArray[np.uint8]:
        """Resize an RGB image, antialiased, to the frame ``(frame height, frame width, 3)``.

        All that follows is cheap and may be random, so the frame is what a data set caches.
        """
        height, width = self.frame_size(*image.size)
        filter = Image.Resampling[self.interpolation.upper()]
        return np.asarray(image.resize((width, height), filter))

    def center_window(self, frame_size: tuple[int, int]) -> Window:
        """Return the window in the middle of a frame of ``(height, width)``."""
        return Window((frame_size[0] - self.size[0]) // 2, (frame_size[1] - self.size[1]) // 2)

    def crop(self, frame: NDArray[np.uint8], window: Window) -> NDArray[np.float32]:
        """Return the window of a frame ``(H, W, 3)`` as float32 ``(3, h, w)`` in [0, 1]."""
        (top, left), (height, width) = window, self.size
        return planes(frame[top : top + height, left : left + width])

    def array(self, image: Image.Image) -> NDArray[np.float32]:
        """Return the network's input as an array, ``(3, h, w)``.

        Raises:
            ValueError: The image is not RGB.
        """
        expect(image.mode == "RGB", "image", "mode RGB", image.mode)
        frame = self.frame(image)
        standardized = self.crop(frame, self.center_window(frame.shape[:2]))
        self.standardize(standardized)
        return standardized

    def standardize(self, image: NDArray[np.float32] | Tensor) -> None:
        """Make ``(image - mean) / std`` of an image ``(3, h, w)`` in [0, 1], in place."""
        for plane, mean, std in zip(image, self.mean, self.std, strict=True):
            plane -= np.float32(mean)
            plane /= np.float32(std)

    def __call__(self, image: Image.Image) -> Tensor:
        """Return the network's input as a tensor, float32 ``(3, h, w)``; raises as `array`."""
        import torch

        return torch.from_numpy(self.array(image))

    def frame_camera(self, camera: Camera) -> Camera:
        """Return the camera that sees the frame, given that of the image."""
        height, width = self.frame_size(camera.width, camera.height)
        return camera.resized(width, height)

    def window_camera(self, camera: Camera, window: Window) -> Camera:
        """Return the camera that sees a window of the frame: the principal point moves with it."""
        frame = self.frame_camera(camera)
        return frame.cropped(window.left, window.top, self.size[1], self.size[0])

    def camera(self, camera: Camera) -> Camera:
        """Return the camera that sees the network's input, given that of the image."""
        size = self.frame_size(camera.width, camera.height)
        return self.window_camera(camera, self.center_window(size))

    def image_camera(self, view: Camera, width: int, height: int) -> Camera:
        """Return the camera of an image of ``width`` x ``height``: the inverse of `camera`."""
        rows, columns = self.frame_size(width, height)
        top, left = self.center_window((rows, columns))
        return view.cropped(-left, -top, columns, rows).resized(width, height)

    def to_dict(self) -> dict[str, Any]:
        """Return the fields as JSON can hold them; `from_dict` reads them back."""
        return asdict(self)

    @classmethod
    def from_dict(cls, fields: Mapping[str, Any]) -> Preprocessing:
        """Build from what `to_dict` returned; without interpolation, as it once was, bilinear.

        Raises:
            ValueError: A field is missing, unknown or not usable.
        """
        if set(fields) - {"interpolation"} != {"size", "mode", "mean", "std"}:
            expected = "size, mode, mean, std, interpolation"
            raise ValueError(f"preprocessing: expected {expected}, got {sorted(fields)}")
        size, mean, std = (tuple(fields[name]) for name in ("size", "mean", "std"))
        return cls(size, fields["mode"], mean, std, fields.get("interpolation", "bilinear"))
