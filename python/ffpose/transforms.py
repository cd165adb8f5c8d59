"""From an image to the network's input, and augmentations that leave the label true.

`Preprocessing` is what training, testing and deployment share, and what a weights file records. By
default it resizes the *whole* frame: the target of an object pose may stand anywhere in it, and a
crop that moves the target without its label teaches a wrong position. Ye et al. (Sensors 2023, 23,
8633, section 4.3) do crop: mode ``"center_crop"``, trained with ``Augmentation(random_crop=True)``.

`Augmentation` changes brightness, contrast, saturation and adds blur and noise, which no pose
depends on. Its one geometric change is a roll of the camera about its optical axis, under which
image and label move together exactly. A mirrored image is no view of the same craft: no flips.

Images here are Pillow's RGB, or tensors ``(3, h, w)``; sizes are ``(height, width)``.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal, NamedTuple, get_args

import numpy as np
import roma
import torch
from numpy.typing import NDArray
from PIL import Image
from torch import Tensor
from torchvision.transforms import v2

from ffpose.arrays import canonical_quaternion
from ffpose.geometry import Camera, FloatArray, rotation_matrix

Mode = Literal["resize", "center_crop"]
Interpolation = Literal["bilinear", "bicubic"]

IMAGENET_MEAN = (0.485, 0.456, 0.406)
IMAGENET_STD = (0.229, 0.224, 0.225)

CROP_MARGIN = 256 / 224
"""Frame over crop: the usual 256 pixels that a crop of 224 is cut from; the paper names neither."""

ROLL_ATTEMPTS = 10


class Window(NamedTuple):
    """A crop: the frame's rows ``top`` and columns ``left`` onwards."""

    top: int
    left: int


@dataclass(frozen=True)
class Preprocessing:
    """Turns an image into the network's input: frame, crop, scale, standardise.

    Attributes:
        size: ``(height, width)`` of the network's input.
        mode: ``"resize"`` brings the whole image to ``size``, each axis by its own factor.
            ``"center_crop"`` is the paper's: the image is resized, its aspect kept, until it
            exceeds ``size`` by `CROP_MARGIN`, and the centre is cut out.
        mean: Of red, green and blue in [0, 1], subtracted.
        std: Of the same, divided by.
        interpolation: Of the resize: ``"bilinear"`` or ``"bicubic"``, both antialiased.

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
        if self.mode not in get_args(Mode):
            raise ValueError(f"mode: expected one of {get_args(Mode)}, got {self.mode!r}")
        if self.interpolation not in get_args(Interpolation):
            known = get_args(Interpolation)
            raise ValueError(f"interpolation: expected one of {known}, got {self.interpolation!r}")
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

    def random_window(self, frame_size: tuple[int, int]) -> Window:
        """Draw a window anywhere in a frame of ``(height, width)``, from torch's generator."""
        top, left = (
            int(torch.randint(frame - size + 1, ()))
            for frame, size in zip(frame_size, self.size, strict=True)
        )
        return Window(top, left)

    def cut(self, frame: NDArray[np.uint8], window: Window) -> Tensor:
        """Return the window of a frame ``(H, W, 3)`` as float32 ``(3, h, w)`` in [0, 1]."""
        rows = slice(window.top, window.top + self.size[0])
        columns = slice(window.left, window.left + self.size[1])
        pixels = torch.from_numpy(frame[rows, columns].astype(np.float32) / 255)
        return pixels.permute(2, 0, 1).contiguous()

    def standardize(self, image: Tensor) -> Tensor:
        """Return ``(image - mean) / std`` of an image ``(3, h, w)`` in [0, 1]."""
        standardized: Tensor = v2.functional.normalize(image, list(self.mean), list(self.std))
        return standardized

    def __call__(self, image: Image.Image) -> Tensor:
        """Return the network's input, float32 ``(3, h, w)``.

        Raises:
            ValueError: The image is not RGB.
        """
        if image.mode != "RGB":
            raise ValueError(f"image: expected mode RGB, got {image.mode}")
        frame = self.frame(image)
        return self.standardize(self.cut(frame, self.center_window(frame.shape[:2])))

    def camera(self, camera: Camera) -> Camera:
        """Return the camera that sees the network's input, given that of the image."""
        height, width = self.frame_size(camera.width, camera.height)
        window = self.center_window((height, width))
        resized = camera.resized(width, height)
        return resized.cropped(window.left, window.top, self.size[1], self.size[0])

    def image_camera(self, view: Camera, width: int, height: int) -> Camera:
        """Return the camera of an image of ``width`` x ``height``: the inverse of `camera`.

        Args:
            view: The camera that sees the network's input.
            width: Of the image, in pixels.
            height: Of the image, in pixels.
        """
        frame_height, frame_width = self.frame_size(width, height)
        window = self.center_window((frame_height, frame_width))
        return view.cropped(-window.left, -window.top, frame_width, frame_height).resized(
            width, height
        )

    def to_dict(self) -> dict[str, Any]:
        """Return the fields as JSON can hold them; `from_dict` reads them back."""
        return {
            "size": list(self.size),
            "mode": self.mode,
            "mean": list(self.mean),
            "std": list(self.std),
            "interpolation": self.interpolation,
        }

    @classmethod
    def from_dict(cls, fields: Mapping[str, Any]) -> Preprocessing:
        """Build from what `to_dict` returned; without interpolation, as it once was, bilinear.

        Raises:
            ValueError: A field is missing, unknown or not usable.
        """
        if set(fields) - {"interpolation"} != {"size", "mode", "mean", "std"}:
            raise ValueError(
                "preprocessing: expected size, mode, mean, std, interpolation, "
                f"got {sorted(fields)}"
            )
        size, mean, std = (tuple(fields[name]) for name in ("size", "mean", "std"))
        return cls(size, fields["mode"], mean, std, fields.get("interpolation", "bilinear"))


def roll_camera(
    image: Tensor, translation: Tensor, orientation: Tensor, camera: Camera, degrees: float
) -> tuple[Tensor, Tensor, Tensor]:
    """Turn the camera about its optical axis; image and label stay true to each other.

    The camera-frame point p becomes ``Rz(degrees) p``, a rotation of the scene from x (right) to y
    (down), so ``t' = Rz t``, ``q' = qz q`` and every pixel moves by the homography ``K Rz K^-1``, K
    being the camera's matrix: exact for unequal focal lengths, as a squeezing resize makes them.
    What comes from outside the image is black.

    Args:
        image: ``(3, h, w)``.
        translation: ``(3,)``, metres.
        orientation: ``(4,)``, unit quaternion ``(w, x, y, z)``.
        camera: The camera of this image, of its size.
        degrees: Angle of the turn.

    Returns:
        The turned image, translation and orientation, of canonical sign.

    Raises:
        ValueError: The image has not the camera's size.
    """
    if image.shape[-2:] != (camera.height, camera.width):
        raise ValueError(
            f"image: expected the camera's (height, width) {(camera.height, camera.width)}, "
            f"got {tuple(image.shape[-2:])}"
        )
    half = math.radians(degrees) / 2
    quaternion = (math.cos(half), 0.0, 0.0, math.sin(half))
    turn = rotation_matrix(quaternion)
    turned = roma.quat_xyzw_to_wxyz(
        roma.quat_product(
            roma.quat_wxyz_to_xyzw(torch.tensor(quaternion, dtype=torch.float64)),
            roma.quat_wxyz_to_xyzw(orientation.double()),
        )
    )
    return (
        _warp(image, camera.matrix @ turn @ np.linalg.inv(camera.matrix)),
        (torch.from_numpy(turn) @ translation.double()).to(translation.dtype),
        torch.from_numpy(canonical_quaternion(turned.numpy())).to(orientation.dtype),
    )


def _warp(image: Tensor, homography: FloatArray) -> Tensor:
    """Move the pixels of an image (3, h, w) by an affine homography (3, 3) of pixel coordinates."""
    height, width = image.shape[-2:]
    # affine_grid counts from -1 to 1 between the image's edges, and asks where a pixel comes from.
    to_unit = np.array([[2 / width, 0, -1], [0, 2 / height, -1], [0, 0, 1]])
    source = to_unit @ np.linalg.inv(to_unit @ homography)
    theta = torch.from_numpy(source[None, :2]).to(image.dtype)
    grid = torch.nn.functional.affine_grid(theta, [1, 3, height, width], align_corners=False)
    return torch.nn.functional.grid_sample(image[None], grid, align_corners=False)[0]


@dataclass(frozen=True)
class Augmentation:
    """Random changes of a training image, drawn from torch's global generator.

    Seed that generator (`torch.manual_seed`) and the same changes come back; a DataLoader seeds it
    for each of its workers.

    Attributes:
        brightness: Greatest relative change of brightness, in [0, 1].
        contrast: The same for contrast.
        saturation: The same for saturation.
        noise: Greatest standard deviation of Gaussian noise, of the range [0, 1].
        blur: Greatest standard deviation of a Gaussian blur, in pixels.
        roll: Greatest turn of the camera about its axis, in degrees (`roll_camera`). An angle that
            would take the object's origin out of the image is drawn again, ten times at most; then
            the image is left as it is.
        random_crop: The paper's crop, at a random place of the frame. The label does *not* follow,
            so the position that it teaches is wrong by up to the crop's play; it needs
            ``Preprocessing(mode="center_crop")``, whose frame has the room for it.

    Raises:
        ValueError: A value outside its range.
    """

    brightness: float = 0.2
    contrast: float = 0.2
    saturation: float = 0.2
    noise: float = 0.02
    blur: float = 0.5
    roll: float = 0.0
    random_crop: bool = False

    def __post_init__(self) -> None:
        limits = {"brightness": 1, "contrast": 1, "saturation": 1, "noise": 1, "roll": 180}
        for name, limit in (limits | {"blur": math.inf}).items():
            if not 0 <= getattr(self, name) <= limit:
                raise ValueError(
                    f"{name}: expected a number from 0 to {limit}, got {getattr(self, name)}"
                )

    @cached_property
    def _colour(self) -> v2.Transform:
        return v2.ColorJitter(self.brightness, self.contrast, self.saturation)

    def __call__(
        self, image: Tensor, translation: Tensor, orientation: Tensor, camera: Camera
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Change an image and move its label with it.

        Args:
            image: ``(3, h, w)`` in [0, 1].
            translation: ``(3,)``, metres.
            orientation: ``(4,)``, unit quaternion ``(w, x, y, z)``.
            camera: The camera of this image, of its size.

        Returns:
            Image in [0, 1], translation and orientation, shaped as they came.
        """
        if self.roll > 0:
            degrees = self._draw_roll(translation, camera)
            image, translation, orientation = roll_camera(
                image, translation, orientation, camera, degrees
            )
        image = self._colour(image)
        if self.blur > 0:
            image = _blur(image, sigma=self.blur * float(torch.rand(())))
        if self.noise > 0:
            sigma = self.noise * torch.rand(())
            image = (image + sigma * torch.randn_like(image)).clamp(0, 1)
        return image, translation, orientation

    def _draw_roll(self, translation: Tensor, camera: Camera) -> float:
        """Return an angle in degrees that leaves the object's origin in the image, else 0."""
        x, y, z = translation.tolist()
        for draw in torch.rand(ROLL_ATTEMPTS).tolist():
            angle = math.radians(self.roll * (2 * draw - 1))
            cos, sin = math.cos(angle), math.sin(angle)
            u, v = camera.project([cos * x - sin * y, sin * x + cos * y, z])
            if 0 <= u <= camera.width and 0 <= v <= camera.height:
                return math.degrees(angle)
        return 0.0


def _blur(image: Tensor, sigma: float) -> Tensor:
    """Blur an image (3, h, w); a sigma below a tenth of a pixel would change nothing."""
    if sigma < 0.1:
        return image
    size = 2 * math.ceil(3 * sigma) + 1
    blurred: Tensor = v2.functional.gaussian_blur(image, [size, size], [sigma, sigma])
    return blurred
