"""Augmentations that keep image and label consistent.

`Augmentation` changes brightness, contrast and saturation, and adds blur and noise, none of which
changes the pose. Its one geometric change is a rotation of the camera about its center (pan, tilt
and roll, or toward the center of a crop), which transforms image and label exactly. There are no
flips: a mirrored image does not show the same spacecraft.

Images are tensors ``(3, h, w)``; `ffpose.imaging.preprocessing` makes and standardizes them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor
from torchvision.transforms import v2

from ffpose._internal.cached import cached_property
from ffpose.arrays import canonical_quaternion
from ffpose.errors import expect
from ffpose.geometry import Camera, FloatArray
from ffpose.geometry.rotations import (
    from_matrix,
    from_rotation_vector,
    multiply,
    rotation_matrix,
    shortest_turn,
)
from ffpose.geometry.warping import pixel_centers, sample_planes, source_planes
from ffpose.imaging.preprocessing import Preprocessing, Window

TURN_ATTEMPTS = 10


def random_window(preprocessing: Preprocessing, frame_size: tuple[int, int]) -> Window:
    """Draw a random window of a frame of size ``(height, width)``, from torch's generator."""
    top, left = (
        int(torch.randint(frame - size + 1, ()))
        for frame, size in zip(frame_size, preprocessing.size, strict=True)
    )
    return Window(top, left)


def camera_turn(pan: float, tilt: float, roll: float) -> FloatArray:
    """Return ``Rz(roll) @ Rx(tilt) @ Ry(pan)``, the scene's rotation in a rotating camera's frame.

    A point p of the camera frame becomes ``rotation @ p``. The angles are in degrees: a positive
    ``pan`` moves the scene to the right, ``tilt`` up, and ``roll`` turns right to down.
    """
    x, y, z = np.eye(3)
    pan, tilt, roll = np.radians([pan, tilt, roll])
    about_z_x = multiply(from_rotation_vector(roll * z), from_rotation_vector(tilt * x))
    return rotation_matrix(multiply(about_z_x, from_rotation_vector(pan * y)))


def crop_turn(crop: Camera, view: Camera) -> FloatArray:
    """Return the rotation ``(3, 3)`` of the camera that a crop stands for, the least one.

    A crop is seen by a camera with another principal point, which a network for one camera cannot
    know. The camera that turns, so that the ray through the crop's center takes the place of the
    ray through the view's, shows about the same part of the image with the intrinsics of the view.
    Neither has distortion, and ``view``, of the network's input, has the crop's size.
    """
    rays = (np.linalg.inv(c.matrix) @ (c.width / 2, c.height / 2, 1) for c in (crop, view))
    return shortest_turn(*(ray / np.linalg.norm(ray) for ray in rays))


def turn_camera(
    image: Tensor,
    translation: Tensor,
    orientation: Tensor,
    camera: Camera,
    rotation: FloatArray,
    view: Camera | None = None,
) -> tuple[Tensor, Tensor, Tensor]:
    """Rotate the camera about its center, and transform image and label accordingly.

    A point p of the camera frame becomes ``R p``, so ``t' = R t``, ``q' = qR q``, and pixels move
    by the homography ``K' R K^-1`` with the camera matrices K and K' (Hartley and Zisserman,
    "Multiple View Geometry", 2nd ed., section 8.4.2). This is exact at any depth, since the center
    does not move, and for unequal focal lengths, as after an anisotropic resize. Pixels that the
    camera did not see are black.

    Args:
        image: ``(3, h, w)``.
        translation: ``(3,)``, meters.
        orientation: ``(4,)``, unit quaternion ``(w, x, y, z)``.
        camera: The camera of this image; its size is the image's.
        rotation: R ``(3, 3)``, as from `camera_turn` or `crop_turn`.
        view: The camera after the rotation, which gives the returned image its size; None for
            ``camera``.

    Returns:
        Image, translation and orientation for the rotated camera; the quaternion is canonical.

    Raises:
        ValueError: The size of the image is not the camera's, or R is not a rotation matrix.
    """
    size, got = (camera.height, camera.width), tuple(image.shape[-2:])
    expect(got == size, "image", f"the camera's (height, width) {size}", got)
    if rotation.shape != (3, 3) or not (
        np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-6) and np.linalg.det(rotation) > 0
    ):
        raise ValueError(f"rotation: expected a rotation matrix (3, 3), got {rotation.tolist()}")
    turned = canonical_quaternion(multiply(from_matrix(rotation), orientation.double().numpy()))
    seen = camera if view is None else view
    source = torch.from_numpy(camera.matrix @ rotation.T @ np.linalg.inv(seen.matrix)).float()
    planes = source_planes(source[None], pixel_centers(seen.height, seen.width))
    return (
        sample_planes(image[None], *planes)[0],
        (torch.from_numpy(rotation) @ translation.double()).to(translation.dtype),
        torch.from_numpy(turned).to(orientation.dtype),
    )


@dataclass(frozen=True)
class Augmentation:
    """Random augmentation of a training image, drawn from torch's global generator.

    It is reproducible with `torch.manual_seed`; a DataLoader seeds the generator of each worker.

    Attributes:
        brightness: Largest relative change of brightness, in [0, 1].
        contrast: Largest relative change of contrast, in [0, 1].
        saturation: Largest relative change of saturation, in [0, 1].
        noise: Largest standard deviation of Gaussian noise on pixel values in [0, 1].
        shot_noise: Largest standard deviation of a sensor's shot noise at full scale: the inverse
            square root of the full-well capacity, 0.0105 for the 9,000 electrons of the rendered
            scenes. Its variance is proportional to the linear intensity; pixel values are sRGB.
        read_noise: Largest standard deviation of a sensor's read noise, which does not depend on
            the intensity; 0.0013 in the rendered scenes.
        blur: Largest standard deviation of a Gaussian blur, in pixels.
        pan: Largest rotation of the camera about its y axis, degrees (`turn_camera`). Angles that
            would move the object's origin out of the image are drawn again, up to ten times; after
            that the image is not rotated.
        tilt: Largest rotation about x, degrees.
        roll: Largest rotation about the boresight, degrees.
        random_crop: Random crop, as in the paper. The label is *not* adjusted, and is true for the
            camera of the sample alone, which has another principal point; for the one camera that
            a network knows, it is wrong by up to the crop's margin. This and the next need
            ``Preprocessing(mode="center_crop")``, whose frame is larger than the crop.
        turned_crop: Random crop by turning the camera toward its center (`crop_turn`), so that the
            label stays true for the camera of a center crop.

    Raises:
        ValueError: A value is out of range, or there are two crops.
    """

    brightness: float = 0.2
    contrast: float = 0.2
    saturation: float = 0.2
    noise: float = 0.02
    shot_noise: float = 0.0
    read_noise: float = 0.0
    blur: float = 0.5
    pan: float = 0.0
    tilt: float = 0.0
    roll: float = 0.0
    random_crop: bool = False
    turned_crop: bool = False

    def __post_init__(self) -> None:
        shares = ("brightness", "contrast", "saturation", "noise", "shot_noise", "read_noise")
        limits = dict.fromkeys(shares, 1.0)
        limits |= {"blur": math.inf, "pan": 90.0, "tilt": 90.0, "roll": 180.0}
        for name, limit in limits.items():
            value = getattr(self, name)
            expect(0 <= value <= limit, name, f"a number from 0 to {limit}", value)
        if self.random_crop and self.turned_crop:
            raise ValueError("turned_crop: expected one crop, got random_crop too")

    @property
    def crops(self) -> bool:
        """Whether it crops at random."""
        return self.random_crop or self.turned_crop

    @property
    def turns(self) -> bool:
        """Whether it turns the camera."""
        return self.turned_crop or max(self.pan, self.tilt, self.roll) > 0

    @cached_property
    def _color_jitter(self) -> v2.Transform:
        return v2.ColorJitter(self.brightness, self.contrast, self.saturation)

    def __call__(
        self, image: Tensor, translation: Tensor, orientation: Tensor, camera: Camera
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Augment an image in [0, 1], and transform its label where the camera rotates.

        Arguments and what is returned are as of `turn_camera`.
        """
        rotation = self._draw_turn(translation, camera)
        if rotation is not None:
            image, translation, orientation = turn_camera(
                image, translation, orientation, camera, rotation
            )
        image = self._color_jitter(image)
        if self.blur > 0:
            image = _blur(image, sigma=self.blur * float(torch.rand(())))
        if self.shot_noise > 0 or self.read_noise > 0:
            strength = float(torch.rand(()))
            image = _sensor_noise(image, strength * self.shot_noise, strength * self.read_noise)
        if self.noise > 0:
            sigma = self.noise * torch.rand(())
            image = (image + sigma * torch.randn_like(image)).clamp(0, 1)
        return image, translation, orientation

    def _draw_turn(self, translation: Tensor, camera: Camera) -> FloatArray | None:
        """Draw a rotation ``(3, 3)`` that keeps the object's origin in the image; None for none."""
        greatest = np.array([self.pan, self.tilt, self.roll])
        if not greatest.any():
            return None
        origin = translation.double().numpy()
        for draws in torch.rand(TURN_ATTEMPTS, 3).double().numpy():
            rotation = camera_turn(*(greatest * (2 * draws - 1)))
            u, v = camera.project(rotation @ origin)
            if 0 <= u <= camera.width and 0 <= v <= camera.height:
                return rotation
        return None


def _sensor_noise(image: Tensor, shot: float, read: float) -> Tensor:
    """Add noise of variance ``shot² · light + read²`` to the linear intensity of an sRGB image."""
    light = torch.where(image <= 0.04045, image / 12.92, ((image + 0.055) / 1.055) ** 2.4)
    light = light + (light * shot**2 + read**2).sqrt_() * torch.randn_like(light)
    light.clamp_(0, 1)
    return torch.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)


def _blur(image: Tensor, sigma: float) -> Tensor:
    """Blur an image ``(3, h, w)``; a sigma below a tenth of a pixel leaves it unchanged.

    Separable, tap by tap: torchvision's ``gaussian_blur`` takes several times as long.
    """
    if sigma < 0.1:
        return image
    reach = min(math.ceil(3 * sigma), min(image.shape[1:]) - 1)  # what is left to reflect
    taps = [math.exp(-0.5 * (step / sigma) ** 2) for step in range(-reach, reach + 1)]
    for axis, margins in ((1, (0, 0, reach, reach)), (2, (reach, reach, 0, 0))):
        padded = torch.nn.functional.pad(image, margins, mode="reflect")
        blurred = torch.zeros_like(image)
        for start, tap in enumerate(taps):
            blurred.add_(padded.narrow(axis, start, image.shape[axis]), alpha=tap / sum(taps))
        image = blurred
    return image
