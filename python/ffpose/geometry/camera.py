"""Cameras, in the conventions of `ffpose.geometry`."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from ffpose._internal import urso
from ffpose._internal.entries import read_object
from ffpose._internal.files import shortened, write_json
from ffpose.geometry.rotations import FloatArray, real_array

CAMERA_FILE = "camera.json"
"""Name of the file with the camera of all images in a folder (`Camera.read`, `Camera.write`)."""


@dataclass(frozen=True, slots=True)
class Camera:
    """A pinhole camera without distortion, in continuous pixel coordinates.

    Attributes:
        width: Image width in pixels.
        height: Image height in pixels.
        fx: Focal length along u, in pixels.
        fy: Focal length along v, in pixels.
        cx: u coordinate of the principal point.
        cy: v coordinate of the principal point.

    Raises:
        ValueError: The size is not of positive whole numbers, a number is not finite, or a focal
            length is not positive.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float

    def __post_init__(self) -> None:
        size = self.width, self.height
        if not all(each >= 1 and float(each).is_integer() for each in size):
            got = f"{self.width}x{self.height}"
            raise ValueError(f"camera: expected a positive size in whole pixels, got {got}")
        for field in fields(Camera):  # NumPy's numbers are none of JSON
            kind = int if field.name in ("width", "height") else float
            object.__setattr__(self, field.name, kind(getattr(self, field.name)))
        if not all(map(math.isfinite, (self.fx, self.fy, self.cx, self.cy))):
            raise ValueError(f"camera: expected finite intrinsics, got {self}")
        if self.fx <= 0 or self.fy <= 0:
            raise ValueError(f"camera: expected fx > 0 and fy > 0, got {self.fx}, {self.fy}")

    @staticmethod
    def read(path: str | Path) -> Camera:
        """Read a camera from a JSON file whose keys are the attributes.

        With a key ``distortion``, five numbers, the camera is a `DistortedCamera`. Width and height
        may be written with a fraction of zero, as ``640.0``.

        Raises:
            FileNotFoundError: The file does not exist.
            DataError: The file is not JSON, lacks a key or has another or one twice, or the values
                are not a valid camera, among them a width or height of 2⁵³ or more.
        """
        names = [field.name for field in fields(Camera)]
        expected = f"expected the keys {', '.join(names)}, and distortion of a lens that has it"
        entry = read_object(Path(path), expected)
        if missing := [name for name in names if name not in entry.values]:
            raise entry.error(f"{expected}; got none of the name {', '.join(missing)}")
        if unknown := [name for name in entry.values if name not in (*names, "distortion")]:
            raise entry.error(f"{expected}; got {', '.join(map(shortened, unknown))} too")
        values = *map(entry.whole, names[:2]), *map(entry.number, names[2:])
        if "distortion" not in entry.values:
            return entry.made(Camera, *values)
        return entry.made(DistortedCamera, *values, entry.numbers("distortion", 5))

    def write(self, path: str | Path) -> None:
        """Write the camera as `read` takes it."""
        write_json(path, asdict(self), 1)

    @property
    def matrix(self) -> FloatArray:
        """Calibration matrix ``(3, 3)``: ``matrix @ p_camera`` is ``depth * (u, v, 1)``."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    def has_aspect(self, width: int, height: int) -> bool:
        """Return whether ``width`` x ``height`` has the aspect ratio of this camera's images."""
        return width * self.height == height * self.width

    def resized(self, width: int, height: int) -> Camera:
        """Return the camera of this camera's image resized to ``width`` x ``height``."""
        x, y = width / self.width, height / self.height
        fx, fy, cx, cy = self.fx * x, self.fy * y, self.cx * x, self.cy * y
        return replace(self, width=width, height=height, fx=fx, fy=fy, cx=cx, cy=cy)

    def cropped(self, left: int, top: int, width: int, height: int) -> Camera:
        """Return the camera of a crop whose top left corner is the pixel (left, top)."""
        cx, cy = self.cx - left, self.cy - top
        return replace(self, width=width, height=height, cx=cx, cy=cy)

    def project(self, points: ArrayLike) -> FloatArray:
        """Project points of the camera frame onto the image.

        Args:
            points: ``(..., 3)``, meters.

        Returns:
            Pixels ``(..., 2)``, float64, which may lie outside the image; NaN for a point that is
            not in front of the camera (z <= 0).

        Raises:
            TypeError: The values are not real numbers.
            ValueError: Wrong shape, or a value that is not finite.
        """
        p = real_array("points", points, 3)
        depth = np.where(p[..., 2:] > 0, p[..., 2:], np.nan)
        return self.distort(p[..., :2] / depth) * (self.fx, self.fy) + (self.cx, self.cy)

    def distort(self, rays: FloatArray) -> FloatArray:
        """Return where the lens sends rays ``(x/z, y/z)`` ``(..., 2)``: a pinhole, as they are."""
        return rays


GRID = 33
"""Points along each side of the image at which a distortion is checked."""


@dataclass(frozen=True, slots=True)
class DistortedCamera(Camera):
    """A camera whose lens distorts, in OpenCV's model of radial and tangential distortion.

    A ray ``(x, y)``, ``r² = x² + y²``, is seen where a pinhole sees ``x' = x d + 2 p1 x y +
    p2 (r² + 2 x²)``, ``y' = y d + p1 (r² + 2 y²) + 2 p2 x y``, ``d = 1 + k1 r² + k2 r⁴ + k3 r⁶``.
    The polynomial was fitted to the image: far outside, it may bend points back into view.

    Attributes:
        distortion: ``(k1, k2, p1, p2, k3)``, the order of OpenCV, whose shapes ``(1, 5)`` and
            ``(5, 1)`` are taken too.

    Raises:
        ValueError: Two parts of the undistorted image would be seen at the same pixels.
    """

    distortion: tuple[float, float, float, float, float]

    def __post_init__(self) -> None:
        Camera.__post_init__(self)
        values = real_array("distortion", np.ravel(self.distortion), 5).tolist()
        object.__setattr__(self, "distortion", tuple(values))
        self._check_folds()

    def _check_folds(self) -> None:
        """Check that no cell of a grid of the pinhole's pixels is turned over into the image."""
        size = np.array((self.width, self.height))
        shares = np.linspace(0, 1, GRID)
        pixels = np.stack(np.meshgrid(shares, shares), axis=-1) * size
        focal, center = (self.fx, self.fy), (self.cx, self.cy)
        seen = self.distort((pixels - center) / focal) * focal + center
        right, down = (np.diff(seen, axis=axis) for axis in (1, 0))
        right, down = right[:-1], down[:, :-1]
        turned = right[..., 0] * down[..., 1] - right[..., 1] * down[..., 0] <= 0
        corners = seen[:-1, :-1]
        within = ((corners >= 0) & (corners <= size)).all(axis=-1)
        if np.any(turned & within):
            raise ValueError(
                "distortion: expected different pixels for different rays of the image, got"
                f" {self.distortion}, which folds it"
            )

    @property
    def pinhole(self) -> Camera:
        """The camera of this camera's undistorted images: the same without the lens."""
        return Camera(self.width, self.height, self.fx, self.fy, self.cx, self.cy)

    def distort(self, rays: FloatArray) -> FloatArray:
        """Return where the lens sends rays ``(x/z, y/z)`` ``(..., 2)``."""
        k1, k2, p1, p2, k3 = self.distortion
        x, y = rays[..., 0], rays[..., 1]
        square = x * x + y * y
        radial = 1 + square * (k1 + square * (k2 + square * k3))
        u = x * radial + 2 * p1 * x * y + p2 * (square + 2 * x * x)
        v = y * radial + p1 * (square + 2 * y * y) + 2 * p2 * x * y
        return np.stack([u, v], axis=-1)


URSO_CAMERA = Camera(*urso.SIZE, *urso.FOCAL_LENGTHS, *urso.CENTER)
"""The camera of URSO's published image sets."""
