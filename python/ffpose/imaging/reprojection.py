"""Reprojection of an image to another pinhole camera with the same position and orientation.

Without rotation the homography of the pixels, ``K_view K_source^-1``, is a scale and a shift of
each axis: an antialiased resize of a crop. The pose in the camera frame does not change.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from ffpose.errors import expect
from ffpose.geometry import Camera, DistortedCamera
from ffpose.imaging.preprocessing import Interpolation, Preprocessing
from ffpose.imaging.undistortion import undistort

SUPPORT: dict[Interpolation, int] = {"bilinear": 1, "bicubic": 2}
"""Reach of each of Pillow's filters, in pixels of the coarser of image and view."""

TOLERANCE = 1e-3
"""Relative difference up to which intrinsics count as those of the same camera."""

SNAP = 1e-6
"""Rounding tolerance: an edge this close to a pixel border, in pixels, is taken to be on it."""


class Axis(NamedTuple):
    """Mapping along one axis: pixels ``first`` to ``last`` of the view show ``start`` to ``end``.

    ``start`` and ``end`` are coordinates in the image, and may lie outside it. The other pixels of
    the view are black.
    """

    first: int
    last: int
    start: float
    end: float


def reproject(
    image: Image.Image, source: Camera, view: Camera, interpolation: Interpolation = "bilinear"
) -> Image.Image:
    """Reproject an image taken by ``source`` to the camera ``view``.

    Args:
        image: RGB image of the source's size.
        source: Camera of the image, without distortion.
        view: Camera with the same position and orientation.
        interpolation: ``"bilinear"`` or ``"bicubic"``, antialiased.

    Returns:
        An image of the view's size, black where it lies outside the source's field of view. If the
        view is the source resized, this is Pillow's resize.

    Raises:
        ValueError: The image's size differs from the source's, or it covers less than a pixel of
            the view, or the source has distortion.
    """
    pinhole, size = not isinstance(source, DistortedCamera), (source.width, source.height)
    expect(pinhole, "source", "a camera without distortion", source)
    expected = f"(width, height) {size}, as its camera has"
    expect(image.size == size, "image", expected, image.size)
    support = SUPPORT[interpolation]
    across = _axis(source.width, source.fx, source.cx, view.width, view.fx, view.cx, support)
    down = _axis(source.height, source.fy, source.cy, view.height, view.fy, view.cy, support)
    if across is None or down is None:
        raise ValueError(f"view: expected one that {source} covers in part, got {view}")
    left, right = math.floor(min(across.start, 0)), math.ceil(max(across.end, source.width))
    top, bottom = math.floor(min(down.start, 0)), math.ceil(max(down.end, source.height))
    canvas = image
    if (left, top, right, bottom) != (0, 0, *image.size):
        canvas = Image.new("RGB", (right - left, bottom - top))
        canvas.paste(image, (-left, -top))
    seen = canvas.resize(
        (across.last - across.first, down.last - down.first),
        Image.Resampling[interpolation.upper()],
        box=(across.start - left, down.start - top, across.end - left, down.end - top),
    )
    result = Image.new("RGB", (view.width, view.height))
    result.paste(seen, (across.first, down.first))
    return result


def _axis(
    size: int,
    focal: float,
    center: float,
    view_size: int,
    view_focal: float,
    view_center: float,
    support: int,
) -> Axis | None:
    """Return the pixels of the view's axis that can show the image; None where none can.

    Pixels beyond twice the reach of the filter are excluded, so that the canvas is at most a few
    times as large as the image, however wide the view. Within once the reach a pixel may show the
    image, and has the black on its other side whole.
    """
    scale = focal / view_focal  # pixels of the image per pixel of the view
    origin = center - view_center * scale
    reach = math.ceil(2 * support * max(1.0, 1 / scale))
    first = max(0, math.floor(-origin / scale) - reach)
    last = min(view_size, math.ceil((size - origin) / scale) + reach)
    if _snap(scale) > size or origin + view_size * scale <= 0 or origin >= size:
        return None
    return Axis(first, last, _snap(origin + first * scale), _snap(origin + last * scale))


def _snap(edge: float) -> float:
    return float(round(edge)) if abs(edge - round(edge)) < SNAP else edge


@dataclass(frozen=True, kw_only=True)
class Reprojection(Preprocessing):
    """Preprocessing that reprojects the images of one camera to the network's view.

    Attributes:
        source: Camera of the images, which are undistorted first if it has distortion; an image of
            another size is taken as resized.
        view: Camera of the network's input, with image size ``size``.

    Raises:
        ValueError: An attribute of `Preprocessing` is invalid, or ``view`` is not of ``size``.
    """

    source: Camera
    view: Camera

    def __post_init__(self) -> None:
        super().__post_init__()
        if (self.view.height, self.view.width) != tuple(self.size):
            raise ValueError(f"view: expected (height, width) {tuple(self.size)}, got {self.view}")

    @classmethod
    def of(cls, preprocessing: Preprocessing, source: Camera, view: Camera) -> Reprojection:
        """Build the reprojection of images of ``source`` to the input of ``preprocessing``."""
        return cls(**{**vars(preprocessing), "source": source, "view": view})

    def frame_size(self, width: int, height: int) -> tuple[int, int]:
        """Return ``(height, width)`` of the network's input, for any image."""
        return self.size

    def frame(self, image: Image.Image) -> NDArray[np.uint8]:
        """Reproject an RGB image to the view ``(height, width, 3)``.

        Raises:
            ValueError: The aspect ratio of the image differs from its camera's.
        """
        if not self.source.has_aspect(*image.size):
            raise ValueError(
                f"image: expected the aspect ratio of its camera, {self.source}, "
                f"got {image.size[0]}x{image.size[1]}"
            )
        source = self.source.resized(*image.size)
        if isinstance(source, DistortedCamera):
            image, source = undistort(image, source), source.pinhole
        return np.asarray(reproject(image, source, self.view, self.interpolation))

    def camera(self, camera: Camera) -> Camera:
        """Return the camera of the view."""
        return self.view

    def image_camera(self, view: Camera, width: int, height: int) -> Camera:
        """Return the source camera, resized to an image of ``width`` x ``height``."""
        return self.source.resized(width, height)


def for_images(
    preprocessing: Preprocessing,
    view: Camera | None,
    expected: Camera | None,
    *,
    camera: Camera | None = None,
    resize: bool = False,
    undistorted: bool = False,
    distortion: tuple[float, ...] | None = None,
) -> tuple[Preprocessing, Camera | None]:
    """Return what brings the images to come to a network's input.

    Args:
        preprocessing: Of the network.
        view: The camera of the network's input; None where it is not known.
        expected: The camera of the images trained on; None where it is not known.
        camera: The camera of the images to come; None: they are of the expected one.
        resize: They are resized, as if the expected camera had taken them.
        undistorted: The images trained on were undistorted.
        distortion: Theirs, where they were taken as they are; None for none.

    Returns:
        The preprocessing, which turns images of another ``camera`` by geometry, and the camera
        whose aspect ratio an image must have (`expect_aspect`), None for any.

    Raises:
        ValueError: Both a camera and a resize are asked for, or neither where the images to come
            must be undistorted as those trained on were; or the images trained on had a distortion
            that those to come have not.
    """
    if camera is not None and resize:
        raise ValueError("camera: expected one to reproject from, or resize; got both")
    if undistorted and camera is None and not resize:
        raise ValueError(
            "camera: expected one (--camera FILE), whose distortion is taken out of images as in"
            " training, or resize (--resize) for images without distortion, got neither"
        )
    if view is None and undistorted and isinstance(camera, DistortedCamera):
        straight = preprocessing.camera(camera.pinhole)
        return Reprojection.of(preprocessing, camera, straight), None
    if camera is None or view is None:
        return preprocessing, None if resize or camera is not None else expected
    if lens_of(camera) == distortion and agree(preprocessing.camera(camera), view):
        return preprocessing, camera
    if distortion is not None:
        raise ValueError(
            f"camera: expected that of training, with the distortion {distortion}, which was not"
            f" taken out, got {camera}; --resize takes images as they are"
        )
    return Reprojection.of(preprocessing, camera, view), None


def agree(camera: Camera, other: Camera) -> bool:
    """Return whether size and intrinsics of two cameras agree within `TOLERANCE`.

    Distortion is none of them: images are undistorted, or not, as in training.
    """
    pairs = ((getattr(camera, each.name), getattr(other, each.name)) for each in fields(Camera))
    return all(math.isclose(one, two, rel_tol=TOLERANCE) for one, two in pairs)


def lens_of(camera: Camera) -> tuple[float, ...] | None:
    """Return the distortion of a camera's images, which `agree` does not compare; None for none."""
    if isinstance(camera, DistortedCamera) and any(camera.distortion):
        return camera.distortion
    return None


def expect_aspect(camera: Camera | None, width: int, height: int) -> None:
    """Refuse an image of ``width`` x ``height`` that a camera cannot have taken; None: any could.

    Raises:
        ValueError: Its aspect ratio is another; the text says what can be done.
    """
    if camera is not None and not camera.has_aspect(width, height):
        raise ValueError(
            f"expected the aspect ratio of its camera, {camera}, got an image of "
            f"{width}x{height} pixels, which another camera took: name that one "
            "(--camera FILE), or resize any image to the network's input (--resize)"
        )
