"""Configuration of PolarPose; nothing here needs torch."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

from ffpose._internal.choices import PolarMixer
from ffpose.config.network import is_whole
from ffpose.config.second_look import MOST_LOOKS, SecondLookConfig
from ffpose.errors import expect

STEM_STRIDE = (4, 8)
"""Rays of the second look per cell of its first feature map, along the radius and the angle."""

LAST_STRIDE = 2
"""Cells of the first feature map per cell of the last along the radius; along the angle one."""

DENSE = 2
"""Cells of the first look's heat map per cell of its feature map, along each side."""


@dataclass(frozen=True)
class PolarPoseConfig(SecondLookConfig):
    """Architecture of `ffpose.models.PolarPose`; sizes are ``(height, width)``.

    Fields that are not described here are of the bases.

    Attributes:
        backbone: Name of the first look's backbone, a timm model or one of
            `ffpose.models.compact_resnet`.
        first_reduction: Stride of the first look's feature map, pixels per cell.
        first_channels: Number of channels between that feature map and the heat map.
        candidates: Number of peaks of the heat map that may be looked at; the likeliest is kept. A
            look at one that cannot be is spent where the object was found.
        object_size: ``(radii, angles)`` of the second look's polar image.
        object_width: Diameter of the polar image's outermost ring in pixels of the virtual camera.
        object_radius_m: Distance that the polar image covers, meters at the object.
        channels: Channels of the stem, of the first feature map and of the last.
        blocks: Number of blocks at the first feature map and at the last.
        mixer: What mixes the cells of a map in its blocks: ``"filter"``, the spectral filter;
            ``"depthwise3"`` and ``"depthwise7"``, convolutions of so many cells; ``"attention"``;
            ``"filterformer"``, attention and filter.
        expansion: Width of a block's perceptron relative to its channels.
        latent: Number of features of each angle, from which the head computes all of its outputs.
        angles: Number of angles of the orientation bins, rotations about the viewing ray.
        directions: Number of viewing directions of the orientation bins.
        bins_width_deg: Standard deviation of the bins' soft labels, degrees.
        looks: Number of second looks; each but the first is pointed by the one before.
        look_slope: Slopes across and along the viewing ray of the offset that one look at a given
            point measures on the true offset, by which `ffpose.models.PolarPose.predict_near`
            divides it; found by calibration.
    """

    architecture: ClassVar[str] = "PolarPose"

    image_size: tuple[int, int] = (384, 512)
    backbone: str = "compact_resnet_narrow"
    camera: tuple[float, float, float, float] | None = (256.0, 256.1852, 256.0, 192.0)  # URSO's
    first_stride: int = 8
    first_reduction: int = 8
    first_channels: int = 64
    candidates: int = 2
    object_size: tuple[int, int] = (32, 192)
    object_width: int = 96
    channels: tuple[int, int, int] = (16, 64, 96)
    blocks: tuple[int, int] = (2, 4)
    mixer: PolarMixer = "filter"
    expansion: int = 2
    latent: int = 128
    angles: int = 48
    directions: int = 500
    bins_width_deg: float = 8.0
    look_slope: tuple[float, float] = (1.0, 1.0)

    def _check_values(self) -> None:
        super()._check_values()
        few = self.candidates <= MOST_LOOKS
        expect(few, "candidates", f"at most {MOST_LOOKS}", self.candidates)
        for name, least in (("channels", 1), ("blocks", 0)):
            values = getattr(self, name)
            whole = all(is_whole(value) and value >= least for value in values)
            expect(whole, name, f"whole numbers, at least {least}", values)
        (radii, angles), cells = self.object_size, self.object_grid[1]
        by_radius, by_angle = STEM_STRIDE[0] * LAST_STRIDE, 2 * STEM_STRIDE[1]
        expected = f"radii and angles that are multiples of {by_radius} and {by_angle}"
        fits = radii % by_radius == 0 and angles % by_angle == 0
        expect(fits, "object_size", expected, self.object_size)
        expected = f"a multiple of {cells}, the angles of the last feature map"
        expect(self.angles % cells == 0, "angles", expected, self.angles)
        width, slopes = self.bins_width_deg, self.look_slope
        expect(0 < width < math.inf, "bins_width_deg", "above 0", width)
        expect(all(0 < slope < math.inf for slope in slopes), "look_slope", "above 0 each", slopes)

    @property
    def coarsest_reduction(self) -> int:
        """Stride of the first look's feature map, pixels of the network's input per cell."""
        return self.first_stride * self.first_reduction

    @property
    def parts(self) -> tuple[str, ...]:
        """Names of the submodules that a training stage may freeze."""
        return ("backbone", "object_backbone", "translation_branch", "orientation_branch")

    @property
    def free_fields(self) -> tuple[str, ...]:
        """The numbers of second looks and of candidates."""
        return ("looks", "candidates")

    @property
    def looks_twice(self) -> bool:
        """True: the network always looks twice."""
        return True

    @property
    def polar(self) -> bool:
        """True: the pixels of the second look lie on rings."""
        return True

    @property
    def heat_grid(self) -> tuple[int, int]:
        """Size ``(rows, columns)`` of the first look's heat map."""
        rows, columns = self.grid(self.coarsest_reduction)
        return rows * DENSE, columns * DENSE

    @property
    def object_grid(self) -> tuple[int, int]:
        """Size ``(radii, angles)`` of the second look's last feature map."""
        radii, angles = self.object_size
        return radii // (STEM_STRIDE[0] * LAST_STRIDE), angles // STEM_STRIDE[1]
