"""What the configurations of networks with a second look have in common."""

from __future__ import annotations

import math
from abc import abstractmethod
from dataclasses import dataclass
from typing import ClassVar

from ffpose.config.network import NetworkConfig, is_whole


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
        hidden_sigma: Growth of the standard deviations of translation and rotation with the share
            ``h`` of the object that lies outside of the frame: they are multiplied by ``1 +
            hidden_sigma h``; found by calibration.
        looks: Number of times that the virtual camera is pointed; 2 looks again at the position
            that the first of these looks refined.

    Raises:
        ValueError: A value is out of range, or sizes are inconsistent.
    """

    TUPLES: ClassVar[dict[str, int]] = NetworkConfig.TUPLES | {
        "object_size": 2,
        "distance_m": 2,
        "hidden_sigma": 2,
    }
    COUNTS: ClassVar[tuple[str, ...]] = ("first_stride", "looks")

    first_stride: int = 4
    object_size: tuple[int, int] = (64, 64)
    object_radius_m: float = 6.6
    distance_m: tuple[float, float] = (8.0, 42.0)
    distance_scale: float = 1.0
    hidden_sigma: tuple[float, float] = (0.0, 0.0)
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

    def _check_values(self) -> None:
        super()._check_values()
        if not all(is_whole(side) and side >= 1 for side in self.object_size):
            raise ValueError(
                f"object_size: expected whole numbers, at least 1, got {self.object_size}"
            )
        near, far = self.distance_m
        if not 0 < near < far < math.inf:
            raise ValueError(f"distance_m: expected 0 < near < far, got {self.distance_m}")
        if not 0 < self.distance_scale < math.inf:
            raise ValueError(f"distance_scale: expected above 0, got {self.distance_scale}")
        if not all(0 <= growth < math.inf for growth in self.hidden_sigma):
            raise ValueError(f"hidden_sigma: expected 0 or more each, got {self.hidden_sigma}")
        if not 0 < self.object_radius_m < math.inf:
            raise ValueError(f"object_radius_m: expected above 0, got {self.object_radius_m}")
        if self.looks_twice:
            if self.camera is None:
                raise ValueError("camera: the second look needs it, got None")
            if any(side % self.first_stride for side in self.image_size):
                raise ValueError(
                    f"first_stride: expected a divisor of image_size {self.image_size},"
                    f" got {self.first_stride}"
                )
