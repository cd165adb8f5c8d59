"""What the configurations of networks with a second look have in common."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from ffpose.config.network import NetworkConfig, is_whole
from ffpose.errors import expect

MOST_DEGREES_OF_FREEDOM = 1000
"""A t distribution of more degrees of freedom is as good as a Gaussian."""

MOST_LOOKS = 16
"""Most second looks, and most candidates: each takes its time, and a place in a graph."""


@dataclass(frozen=True)
class SecondLookConfig(NetworkConfig):
    """Fields of a network that may look at the object through a virtual camera.

    Attributes:
        first_stride: Downsampling factor from the network's input to the first look.
        object_size: Size of the virtual camera's image.
        object_radius_m: Distance that the virtual camera's image covers from its center to its
            edge, in meters at the object.
        distance_m: Smallest and largest distance in training, meters.
        distance_scale: Factor on the predicted translation, found by calibration, that removes the
            median error of the distance.
        truncation_distance: Correction of the distance with the share ``s`` of the view of
            ``object_radius_m`` that the border of the frame cuts off, as an object of which less is
            seen looks farther: it is multiplied by ``exp(-truncation_distance s²)``; found by
            calibration.
        doubt_sigma: Growth of the standard deviations of translation and rotation with the
            probability ``p`` that the attitude is not near the predicted one: they are multiplied
            by ``1 + doubt_sigma p``; found by calibration.
        truncation_sigma: Their growth with that share: they are multiplied by
            ``1 + truncation_sigma s²``; found by calibration.
        degrees_of_freedom: Of the multivariate t distributions of the errors of translation and
            rotation, whose covariances the network predicts; found by calibration. None for
            Gaussian errors.
        looks: Number of times that the virtual camera is pointed; 2 looks again at the position
            that the first of these looks refined.
    """

    first_stride: int = 4
    object_size: tuple[int, int] = (64, 64)
    object_radius_m: float = 6.6
    distance_m: tuple[float, float] = (8.0, 42.0)
    distance_scale: float = 1.0
    truncation_distance: float = 0.0
    doubt_sigma: tuple[float, float] = (0.0, 0.0)
    truncation_sigma: tuple[float, float] = (0.0, 0.0)
    degrees_of_freedom: tuple[float, float] | None = None
    looks: int = 2

    @property
    @abstractmethod
    def looks_twice(self) -> bool:
        """Whether the network takes a second look."""

    @property
    def polar(self) -> bool:
        """Whether the virtual camera's image is polar."""
        return False

    @property
    @abstractmethod
    def object_grid(self) -> tuple[int, int]:
        """Size ``(rows, columns)`` of the second look's feature map."""

    @property
    @abstractmethod
    def object_width(self) -> int:
        """Width of the virtual camera's view in its pixels."""

    def growth(self, doubt: Any, cut: Any) -> Iterator[Any]:
        """Yield the factors on the standard deviations of translation and rotation.

        Of probabilities (`doubt_sigma`) and shares (`truncation_sigma`), arrays or tensors.
        """
        for by_doubt, by_cut in zip(self.doubt_sigma, self.truncation_sigma, strict=True):
            yield (1 + doubt * by_doubt) * (1 + cut**2 * by_cut)

    def _check_values(self) -> None:
        super()._check_values()
        size = self.object_size
        whole = all(is_whole(side) and side >= 1 for side in size)
        expect(whole, "object_size", "whole numbers, at least 1", size)
        expect(self.looks <= MOST_LOOKS, "looks", f"at most {MOST_LOOKS}", self.looks)
        near, far = self.distance_m
        expect(0 < near < far < math.inf, "distance_m", "0 < near < far", self.distance_m)
        for name in ("distance_scale", "object_radius_m"):
            expect(0 < getattr(self, name) < math.inf, name, "above 0", getattr(self, name))
        for name in ("doubt_sigma", "truncation_sigma"):
            growths = getattr(self, name)
            expect(all(0 <= each < math.inf for each in growths), name, "0 or more each", growths)
        nearer = self.truncation_distance
        expect(math.isfinite(nearer), "truncation_distance", "a finite number", nearer)
        degrees = self.degrees_of_freedom or ()
        expected = f"above 2 and up to {MOST_DEGREES_OF_FREEDOM} each, or None"
        proper = all(2 < each <= MOST_DEGREES_OF_FREEDOM for each in degrees)
        expect(proper, "degrees_of_freedom", expected, degrees)
        if self.looks_twice:
            if self.camera is None:
                raise ValueError("camera: the second look needs it, got None")
            divides = all(side % self.first_stride == 0 for side in self.image_size)
            expected = f"a divisor of image_size {self.image_size}"
            expect(divides, "first_stride", expected, self.first_stride)
