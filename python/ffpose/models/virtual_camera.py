"""Virtual camera: same position as the real camera, pointed at the object.

A pure rotation of a pinhole camera transforms its image by the homography ``K_v R K^-1``: rotation,
crop and scale in one, exact for every depth. The view of a virtual camera that is pointed at the
object and covers a fixed number of meters at its distance shows the object centered and in the same
size, wherever it is in the frame; only the attitude and small corrections of the position are left
to learn. Poses are transformed between the two cameras by the rotation alone:

    t_v = R t,   R_v = R R_object

The rotation (`ffpose.nn.rotations.toward`) is the smallest one that takes the boresight to the
viewing ray, so that orientations in the virtual camera's frame are the allocentric ones. All
functions take batches, are differentiable, and can be exported to ONNX.

The pixels of a virtual image lie on rings about the viewing ray: radii by angles, as in polar
coordinates. A rotation of the object about the viewing ray is then a cyclic shift of the image's
columns (Esteves et al., "Polar Transformer Networks", ICLR 2018).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import torch
from torch import Tensor
from torch.nn import functional as F

from ffpose.geometry.warping import LEAST_DEPTH, source_planes
from ffpose.imaging.patches import LEVELS, SHARPNESS
from ffpose.nn.pyramid import halve, sample_pyramid
from ffpose.nn.rotations import (
    conjugate,
    quaternion_product,
    quaternion_to_matrix,
    toward,
    turned_about_axis,
)


class VirtualCamera(NamedTuple):
    """Virtual cameras pointed at the objects of a batch.

    Attributes:
        rotation: ``(B, 3, 3)``, rotations from the camera frame to the virtual camera's frame.
        quaternion: ``(B, 4)``, unit quaternions of these rotations.
        focal: ``(B,)``, focal lengths in pixels; the principal point is the image's center.
        distance: ``(B,)``, distances to the points that the cameras are pointed at, meters.
        size: ``(radii, angles)`` of the virtual image: row i lies at the radius ``(i + 1/2) /
            radii`` times half the width, column j at the angle ``(j + 1/2) / angles`` of a turn,
            from the x axis towards y.
        width: Diameter of the outermost ring in pixels, the unit of the focal length.
    """

    rotation: Tensor
    quaternion: Tensor
    focal: Tensor
    distance: Tensor
    size: tuple[int, int]
    width: int

    @property
    def tan_half_angle(self) -> Tensor:
        """Tangents ``(B,)`` of half the view's angle, which tell how strong the perspective is.

        The view does not: it shows an object in one size, whatever its distance.
        """
        return self.width / (2 * self.focal)

    def of(self, rows: Tensor | slice) -> VirtualCamera:
        """Return the cameras of some rows of the batch: indices, a mask or a slice."""
        return self._replace(
            rotation=self.rotation[rows],
            quaternion=self.quaternion[rows],
            focal=self.focal[rows],
            distance=self.distance[rows],
        )

    def resized(self, size: tuple[int, int]) -> VirtualCamera:
        """Return the same views in images of ``size``, so many radii and angles."""
        return self._replace(size=size)

    def image_plane(self) -> Tensor:
        """Return the places ``(2, h, w)`` of the image's pixels, (u, v) relative to its center."""
        radii, angles = self.size
        like: dict[str, Any] = {"dtype": self.focal.dtype, "device": self.focal.device}
        radius = (torch.arange(radii, **like) + 0.5)[:, None] * (self.width / 2 / radii)
        angle = (torch.arange(angles, **like) + 0.5) * (2 * math.pi / angles)
        return torch.stack([radius * angle.cos(), radius * angle.sin()])

    def places(self, points: Tensor) -> Tensor:
        """Return where ``(B, K, 2)`` the cameras see points ``(B, K, 3)`` of the camera frame.

        Column and row relative to the image's width and height; -1 for points behind the camera.
        """
        x, y, z = (points @ self.rotation.mT).unbind(-1)
        scale = self.focal[:, None] / z
        u, v = x * scale / self.width, y * scale / self.width
        turn = torch.atan2(v, u) / (2 * math.pi)
        places = torch.stack([turn - turn.floor(), 2 * torch.hypot(u, v)], dim=-1)
        return torch.where(z[..., None] > 0, places, -1.0)

    def points(self, points: Tensor) -> Tensor:
        """Transform points ``(B, 3)`` from the camera frame to the virtual camera's frame."""
        return (self.rotation @ points[:, :, None])[..., 0]

    def points_back(self, points: Tensor) -> Tensor:
        """Transform points ``(B, 3)`` from the virtual camera's frame to the camera frame."""
        return (self.rotation.transpose(1, 2) @ points[:, :, None])[..., 0]

    def turned_back(self, orientation: Tensor) -> Tensor:
        """Transform unit quaternions ``(B, 4)`` from the virtual camera's frame to the camera's."""
        turned = quaternion_product(conjugate(self.quaternion), orientation)
        return F.normalize(turned, dim=-1)  # for runtimes that multiply in bfloat16


def chosen(taken: Tensor, these: Any, others: Any) -> Any:
    """Return the rows of ``these`` where ``taken (B,)`` is true, else of ``others``.

    Both are tensors ``(B, ...)``, or named tuples of them; what is neither is the same in both.
    """
    if isinstance(these, Tensor):
        return torch.where(taken.view(-1, *(1,) * (these.ndim - 1)), these, others)
    if hasattr(these, "_fields"):
        return type(these)(*(chosen(taken, *pair) for pair in zip(these, others, strict=True)))
    return these


def turn_to(
    points: Tensor,
    radius_m: float,
    size: tuple[int, int],
    width: int,
    twist: Tensor | None = None,
) -> VirtualCamera:
    """Point virtual cameras at points ``(B, 3)`` of the camera frame, meters, not behind it.

    Args:
        points: Points.
        radius_m: Half the width of the view at the point's distance, meters.
        size: ``(radii, angles)`` of the virtual image.
        width: Diameter of its outermost ring in pixels.
        twist: ``(B,)``, angles in radians by which the scene is then rotated about the viewing ray.
    """
    distance = points.norm(dim=-1)
    quaternion = conjugate(toward(points))
    if twist is not None:
        quaternion = quaternion_product(turned_about_axis(twist), quaternion)
    rotation, focal = quaternion_to_matrix(quaternion), distance * (width / 2 / radius_m)
    return VirtualCamera(rotation, quaternion, focal, distance, size, width)


def source_pixels(view: VirtualCamera, intrinsics: Tensor) -> Tensor:
    """Return the source image's coordinates ``(B, h, w, 2)`` of a virtual image's pixels.

    Continuous pixel coordinates (u, v), far outside for rays that the source camera cannot see, of
    ``intrinsics`` fx, fy, cx, cy ``(B, 4)`` or ``(4,)``.
    """
    planes = source_planes(homography(view, intrinsics), view.image_plane())
    return torch.stack(planes, dim=-1)


def homography(view: VirtualCamera, intrinsics: Tensor) -> Tensor:
    """Return the homographies ``K R^T K_v^-1`` ``(B, 3, 3)`` from virtual to source pixels.

    Virtual pixels are relative to the image's center. The third coordinate of the result is the
    depth of a ray whose depth in the virtual camera is one.
    """
    fx, fy, cx, cy = intrinsics.to(view.focal.dtype).unbind(-1)
    zero, one = torch.zeros_like(fx), torch.ones_like(fx)
    matrix = torch.stack([fx, zero, cx, zero, fy, cy, zero, zero, one], dim=-1)
    turned = torch.unflatten(matrix, -1, (3, 3)) @ view.rotation.mT
    return torch.cat((turned[:, :, :2] / view.focal[:, None, None], turned[:, :, 2:]), dim=2)


def pyramid(images: Tensor) -> list[Tensor]:
    """Return the pyramid of images ``(B, C, H, W)``, finest first; each level has half the size."""
    levels = [images]
    for _ in range(1, LEVELS):
        levels.append(halve(levels[-1]))
    return levels


def downsampled(pyramid: Sequence[Tensor], stride: int) -> Tensor:
    """Return the means of ``stride`` x ``stride`` pixels, those of a level if it has them."""
    level = stride.bit_length() - 1
    if stride == 2**level and level < LEVELS:
        return pyramid[level]
    return F.avg_pool2d(pyramid[0], stride)


def render_virtual(
    pyramid: Sequence[Tensor], view: VirtualCamera, points: Tensor, intrinsics: Tensor
) -> Tensor:
    """Render the images ``(B, C, h, w)`` of virtual cameras from the `pyramid` of each image.

    Each is sampled from the level whose resolution is about its own, which prevents aliasing for
    near objects. There may be several views of each image; view and points hold those of the
    first image, then those of the second.
    """
    level = pyramid_level(view, points, intrinsics).to(view.focal.dtype)
    return sample_pyramid(homography(view, intrinsics), level, view.image_plane(), pyramid)


def pyramid_level(view: VirtualCamera, points: Tensor, intrinsics: Tensor) -> Tensor:
    """Return the pyramid level ``(B,)`` for each virtual camera, 0 the finest."""
    # Off the axis a pinhole image is larger by one over the cosine of the angle.
    oblique = view.distance / points[:, 2].clamp_min(LEAST_DEPTH)
    ratio = intrinsics[0] / view.focal * oblique / SHARPNESS
    powers = 2.0 ** torch.arange(1, LEVELS, dtype=ratio.dtype, device=ratio.device)
    return (ratio[:, None] >= powers).sum(-1)
