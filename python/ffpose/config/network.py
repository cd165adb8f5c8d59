"""Base class of network configurations, for training, evaluation and export."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields, replace
from types import UnionType
from typing import Any, ClassVar, Self, get_args, get_origin

from ffpose.errors import check_choices, expect, hint, type_hints
from ffpose.geometry import Camera


@dataclass(frozen=True)
class NetworkConfig:
    """Fields that every network has; sizes of images are ``(height, width)``.

    Subclasses add theirs. By their annotations, tuples are of so many numbers, and an ``int`` is a
    whole number of at least 1.

    Attributes:
        image_size: Size of the network's input in pixels.
        backbone: Name of a timm model with feature maps, or of `ffpose.models.compact_resnet`.
        camera: Intrinsics ``(fx, fy, cx, cy)`` of the network's input, in pixels of ``image_size``;
            None if unknown. `view_camera` returns them as a `ffpose.geometry.Camera`.

    Raises:
        ValueError: A value is out of range, or sizes are inconsistent.
    """

    architecture: ClassVar[str]
    """Name of the network's class, recorded in files of weights and graphs."""

    image_size: tuple[int, int] = (224, 224)
    backbone: str = "efficientnet_b0"
    camera: tuple[float, float, float, float] | None = None

    def __post_init__(self) -> None:
        check_choices(self)
        kinds = type_hints(type(self))
        for name in (field.name for field in fields(self)):
            value, kind = getattr(self, name), kinds[name]
            if isinstance(kind, UnionType):  # with None
                if value is None:
                    continue
                kind = get_args(kind)[0]
            if get_origin(kind) is tuple:  # JSON and YAML bring lists
                length = len(get_args(kind))
                fits = isinstance(value, list | tuple) and len(value) == length
                expect(fits, name, f"{length} numbers", value)
                object.__setattr__(self, name, tuple(value))
            elif kind is int:
                fits = is_whole(value) and value >= 1
                expect(fits, name, "a whole number, at least 1", value)
        self._check_values()

    def _check_values(self) -> None:
        """Check the values of single fields, and of fields together."""
        size, camera, least = self.image_size, self.camera, self.coarsest_reduction
        expect(all(map(is_whole, size)), "image_size", "whole numbers", size)
        at_least = f"each at least {least}, the coarsest reduction"
        expect(min(size) >= least, "image_size", at_least, size)
        if camera is not None:
            expect(all(map(math.isfinite, camera)), "camera", "finite numbers", camera)
            expect(min(camera[:2]) > 0, "camera", "fx > 0 and fy > 0", camera)

    @property
    def coarsest_reduction(self) -> int:
        """Stride of the coarsest feature map, pixels per cell."""
        return 1

    @property
    def parts(self) -> tuple[str, ...]:
        """Names of the network's submodules that a training stage may freeze."""
        return ("backbone", "translation_branch", "orientation_branch")

    @property
    def loss_weights(self) -> tuple[float, float] | None:
        """Fixed weights of translation and orientation loss; None for learned ones."""
        return None

    @property
    def degrees_of_freedom(self) -> tuple[float, float] | None:
        """Those of the t distributions of translation and rotation errors; None for Gaussians."""
        return None

    @property
    def view_camera(self) -> Camera | None:
        """Camera of the network's input; None if unknown."""
        if self.camera is None:
            return None
        height, width = self.image_size
        return Camera(width, height, *self.camera)

    def grid(self, reduction: int) -> tuple[int, int]:
        """Return the size ``(rows, columns)`` of the feature map of stride ``reduction``."""
        height, width = self.image_size
        return math.ceil(height / reduction), math.ceil(width / reduction)

    def with_fields(self, values: Mapping[str, Any]) -> Self:
        """Return the config with some fields changed.

        Raises:
            ValueError: A field is unknown, with the names that there are, or a value is invalid.
        """
        self.check_names(values)
        return replace(self, **values)

    @property
    def free_fields(self) -> tuple[str, ...]:
        """Names of the fields that may be changed when trained weights are loaded."""
        return ()

    def at_inference(self, values: Mapping[str, Any]) -> Self:
        """Return the config with fields changed that trained weights do not depend on.

        Raises:
            ValueError: A field is not of `free_fields`, or a value is invalid.
        """
        for name in sorted(set(values) - set(self.free_fields)):
            known = ", ".join(self.free_fields) or "this network has none"
            raise ValueError(
                f"expected fields that may change after training ({known}), "
                f"got {name}{hint(name, self.free_fields)}"
            )
        return replace(self, **values)

    @classmethod
    def check_names(cls, values: Mapping[str, Any]) -> None:
        """Check that all names are fields of the config.

        Raises:
            ValueError: A name is unknown; the message lists the fields.
        """
        known = [field.name for field in fields(cls)]
        unknown = sorted(set(values) - set(known))
        if unknown:
            got = ", ".join(f"{name}{hint(name, known)}" for name in unknown)
            raise ValueError(f"config: expected fields out of {', '.join(known)}; got {got}")

    def to_json(self) -> str:
        """Return a JSON object with all fields."""
        return json.dumps(asdict(self))

    @classmethod
    def from_json(cls, text: str) -> Self:
        """Build a config from the result of `to_json`.

        Raises:
            ValueError: The text is not a JSON object, a field is unknown, or a value is invalid.
        """
        values = json.loads(text)
        if not isinstance(values, dict):
            raise ValueError(f"config: expected a JSON object, got {type(values).__name__}")
        cls.check_names(values)
        return cls(**values)


@dataclass(frozen=True)
class FrameConfig(NetworkConfig):
    """Fields of a network that regresses the translation from the whole frame.

    Attributes:
        translation_mean: Mean that is added to the translation head's output, meters, camera frame.
        translation_std: Scale of the translation head's output, meters. With a mean of zeros and a
            scale of ones the head regresses meters, as published.
    """

    translation_mean: tuple[float, float, float] = (0.0, 0.0, 0.0)
    translation_std: tuple[float, float, float] = (1.0, 1.0, 1.0)

    def _check_values(self) -> None:
        super()._check_values()
        mean, std = self.translation_mean, self.translation_std
        expect(all(map(math.isfinite, mean)), "translation_mean", "finite numbers", mean)
        positive = all(math.isfinite(each) and each > 0 for each in std)
        expect(positive, "translation_std", "finite numbers above 0", std)


def is_whole(value: Any) -> bool:
    """Return whether a value is an integer, which a bool is not."""
    return isinstance(value, int) and not isinstance(value, bool)
