"""Configuration of PolarPose; nothing here needs torch."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, ClassVar

from ffpose._internal.choices import PolarMixer
from ffpose.config.network import NetworkConfig, is_whole
from ffpose.errors import expect

MOST_DEGREES_OF_FREEDOM = 1000
"""A t distribution of more degrees of freedom is as good as a Gaussian."""

MOST_LOOKS = 16
"""Most second looks, and most candidates: each takes its time, and a place in a graph."""

STEM_STRIDE = (4, 8)
"""Rays of the second look per cell of its first feature map, along the radius and the angle."""

LAST_STRIDE = 2
"""Cells of the first feature map per cell of the last along the radius; along the angle one."""

DENSE = 2
"""Cells of the first look's heat map per cell of its feature map, along each side."""


@dataclass(frozen=True)
class PolarPoseConfig(NetworkConfig):
    """Architecture of `ffpose.models.PolarPose`; sizes are ``(height, width)``.

    Fields that are not described here are of the base.

    Attributes:
        backbone: Name of the first look's backbone, a timm model or one of
            `ffpose.models.compact_resnet`.
        first_stride: Downsampling factor from the network's input to the first look.
        first_reduction: Stride of the first look's feature map, pixels per cell.
        first_channels: Number of channels between that feature map and the heat map.
        candidates: Number of peaks of the heat map that may be looked at; the likeliest is kept.
            Where a further peak cannot be likelier, that look goes where the object was found.
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
        looks: Number of second looks, those at all candidates counting as one. Each further look is
            pointed by the one before. With 1 the pose is that of one look, else a mean of several.
        distance_m: Smallest and largest distance in training, meters.
        distance_scale: Factor on the predicted translation, found by calibration, that removes the
            median error of the distance.
        truncation_distance: Correction of the distance of an object that the border of the frame
            cuts, which is estimated too far: the translation is multiplied by
            ``exp(-truncation_distance s²)``, where ``s`` is the share of the view of
            ``object_radius_m`` that is cut off; found by calibration.
        doubt_sigma: Growth of the standard deviations of translation and rotation with the
            probability ``p`` that the attitude is not near the predicted one: they are multiplied
            by ``1 + doubt_sigma p``; found by calibration.
        truncation_sigma: Growth of these standard deviations with ``s``: they are multiplied by
            ``1 + truncation_sigma s²``; found by calibration.
        degrees_of_freedom: Of the multivariate t distributions of the errors of translation and
            rotation, whose covariances the network predicts; found by calibration. None for
            Gaussian errors.
        look_slope: Slopes, across and along the viewing ray, of the offset that one look at a given
            point measures against the true offset. `ffpose.models.PolarPose.predict_near` divides
            the offset by them; found by calibration.
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
    object_radius_m: float = 6.6
    channels: tuple[int, int, int] = (16, 64, 96)
    blocks: tuple[int, int] = (2, 4)
    mixer: PolarMixer = "filter"
    expansion: int = 2
    latent: int = 128
    angles: int = 48
    directions: int = 500
    bins_width_deg: float = 8.0
    looks: int = 2
    distance_m: tuple[float, float] = (8.0, 42.0)
    distance_scale: float = 1.0
    truncation_distance: float = 0.0
    doubt_sigma: tuple[float, float] = (0.0, 0.0)
    truncation_sigma: tuple[float, float] = (0.0, 0.0)
    degrees_of_freedom: tuple[float, float] | None = None
    look_slope: tuple[float, float] = (1.0, 1.0)

    def _check_values(self) -> None:
        super()._check_values()
        for name in ("looks", "candidates"):
            value = getattr(self, name)
            expect(value <= MOST_LOOKS, name, f"at most {MOST_LOOKS}", value)
        for name, least in (("channels", 1), ("blocks", 0), ("object_size", 1)):
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
        divides = all(side % self.first_stride == 0 for side in self.image_size)
        expected = f"a divisor of image_size {self.image_size}"
        expect(divides, "first_stride", expected, self.first_stride)
        if self.camera is None:
            raise ValueError("camera: the second look needs it, got None")
        self._check_measures()

    def _check_measures(self) -> None:
        near, far = self.distance_m
        expect(0 < near < far < math.inf, "distance_m", "0 < near < far", self.distance_m)
        for name in ("distance_scale", "object_radius_m", "bins_width_deg"):
            expect(0 < getattr(self, name) < math.inf, name, "above 0", getattr(self, name))
        for name in ("doubt_sigma", "truncation_sigma"):
            growths = getattr(self, name)
            expect(all(0 <= each < math.inf for each in growths), name, "0 or more each", growths)
        slopes = self.look_slope
        expect(all(0 < slope < math.inf for slope in slopes), "look_slope", "above 0 each", slopes)
        nearer = self.truncation_distance
        expect(math.isfinite(nearer), "truncation_distance", "a finite number", nearer)
        degrees = self.degrees_of_freedom or ()
        expected = f"above 2 and up to {MOST_DEGREES_OF_FREEDOM} each, or None"
        proper = all(2 < each <= MOST_DEGREES_OF_FREEDOM for each in degrees)
        expect(proper, "degrees_of_freedom", expected, degrees)

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
    def total_looks(self) -> int:
        """Number of second looks at a frame: one for each candidate, and those after the first."""
        return self.candidates + self.looks - 1

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

    def growth(self, doubt: Any, cut: Any) -> Iterator[Any]:
        """Yield the factors on the standard deviations of translation and rotation.

        Of probabilities (`doubt_sigma`) and shares (`truncation_sigma`), arrays or tensors.
        """
        for by_doubt, by_cut in zip(self.doubt_sigma, self.truncation_sigma, strict=True):
            yield (1 + doubt * by_doubt) * (1 + cut**2 * by_cut)
