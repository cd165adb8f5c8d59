"""Base classes of pose networks, for training, evaluation, prediction and export.

A network maps images to a named tuple of predictions and has parts that a training stage may freeze
(`ffpose.config.NetworkConfig.parts`). It is a subclass of `BaseNetwork`, for Python cannot name a
type that has a protocol and is an ``nn.Module`` too. One that looks at the frame alone is a
`FrameNetwork`, and brings its losses: that of the translation, and that of its orientation head.
Its configuration names it in files, by which `ffpose.models.load_network` finds the class again.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar, NamedTuple, Self

import torch
from torch import Tensor, nn

from ffpose._internal.torch_internals import register_named_tuple
from ffpose._internal.zoo import resolve
from ffpose.config import PRESETS, FrameConfig, NetworkConfig
from ffpose.errors import DataError, expect, expect_shape
from ffpose.imaging.preprocessing import Preprocessing
from ffpose.models.backbone import Backbone, backbone_preprocessing
from ffpose.models.hub import BackboneSource
from ffpose.models.weights import WeightsMetadata, load_weights, read_metadata, write_weights
from ffpose.nn.orientation import OrientationHead


class PosePrediction(NamedTuple):
    """Poses of the object in the camera frame (OpenCV: x right, y down, z forward).

    ``translation (B, 3)``, meters, and ``orientation (B, 4)``, unit quaternions, scalar first, of
    either sign.
    """

    translation: Tensor
    orientation: Tensor


class UncertainPose(NamedTuple):
    """Poses as in `PosePrediction`, with their predicted uncertainty.

    Attributes:
        translation: ``(B, 3)``, meters.
        orientation: ``(B, 4)``, unit quaternions, scalar first, of either sign.
        translation_covariance: ``(B, 3, 3)``, covariance of the translation, camera frame, m².
        rotation_covariance: ``(B, 3, 3)``, covariance of the rotation vector r, camera frame, rad²;
            ``R_true = exp([r]x) R``.
        in_view: ``(B,)``, probability that the object is in the image.
        alternative: ``(B, 4)``, the second most likely orientation, as ``orientation``, which is
            the most likely.
        probabilities: ``(B, 2)``, that the true orientation is near ``orientation`` and near
            ``alternative`` (`ffpose.nn.polar_bins.Modes`).
    """

    translation: Tensor
    orientation: Tensor
    translation_covariance: Tensor
    rotation_covariance: Tensor
    in_view: Tensor
    alternative: Tensor
    probabilities: Tensor


# Saved programs refer to named tuples by name, which torch requires to be registered.
for _result in (PosePrediction, UncertainPose):
    register_named_tuple(_result, f"ffpose.models.{_result.__name__}")


def find_device(name: str) -> torch.device:
    """Return a device by torch's name for it; ``"auto"`` is a GPU if there is one, else the CPU.

    Raises:
        ValueError: Torch does not know the device, or it is absent.
    """
    if name == "auto":
        return torch.device("cuda" if torch.cuda.is_available() else "cpu")
    try:
        return torch.empty(0, device=name).device
    except (RuntimeError, AssertionError) as error:  # the latter of a torch built without it
        raise ValueError(
            f"device: expected auto, or a device that torch finds here, got {name!r} ({error})"
        ) from error


class BaseNetwork(nn.Module, ABC):
    """Base of the networks: construction by name, and weights files.

    A subclass sets `config_type`, builds its modules after ``super().__init__(config)``, among them
    ``backbone``, ``orientation`` (decoding and loss of the orientation) and the parts that its
    configuration names, and defines `build` and `forward`.
    """

    config_type: ClassVar[type[NetworkConfig]]

    config: NetworkConfig
    backbone: Backbone
    orientation: OrientationHead

    def __init__(self, config: NetworkConfig) -> None:
        super().__init__()
        self.config = config

    @classmethod
    @abstractmethod
    def build(cls, config: Any, backbone_weights: str | Path) -> Self:
        """Build a network with new weights from a configuration of `config_type`."""

    @abstractmethod
    def forward(self, images: Tensor) -> PosePrediction | UncertainPose:
        """Predict the pose of the object in each image, standardized as in training.

        Raises:
            ValueError: ``images`` is not ``(B, 3, *config.image_size)``.
        """

    @classmethod
    def from_config(
        cls,
        config: str | NetworkConfig,
        *,
        backbone_weights: str | Path = "auto",
        **fields: Any,
    ) -> Self:
        """Build a network with new weights.

        Args:
            config: Preset of this network (of FilterformerPose: ``"base"``, ``"small"``,
                ``"tiny"``) or a config.
            backbone_weights: ``"auto"``: pretrained, from the hub or its cache; ``"none"``: random;
                otherwise a safetensors or PyTorch file.
            **fields: Fields of the config to change.

        Raises:
            ValueError: A preset or field is unknown, or values are inconsistent.
            FileNotFoundError: The weights file does not exist, or the pretrained weights are not
                available.
            ffpose.DataError: The file does not contain the backbone's weights.
        """
        presets = {n: c for n, c in PRESETS.items() if isinstance(c, cls.config_type)}
        if isinstance(config, str):
            expect(config in presets, "config", f"one of {tuple(presets)}", config)
            config = presets[config]
        if not isinstance(config, cls.config_type):
            raise ValueError(
                f"config: expected a {cls.config_type.__name__}, got a {type(config).__name__}"
            )
        return cls.build(config.with_fields(fields), backbone_weights)

    def save_pretrained(
        self,
        path: str | Path,
        *,
        preprocessing: Preprocessing | None = None,
        backbone_source: BackboneSource | None = None,
        recipe: Mapping[str, Any] | None = None,
        data: Mapping[str, Any] | None = None,
        in_view_threshold: float | None = None,
        dtype: torch.dtype = torch.float32,
    ) -> None:
        """Write weights, config, preprocessing and this version to a safetensors file.

        The write is atomic; the checksum is written to ``path.sha256``. Metadata that is None is
        stored as unknown; see `WeightsMetadata` for what is not described here.

        Args:
            path: File to write; its folder must exist.
            preprocessing: Conversion from an image to the network's input; None for a resize to
                ``config.image_size``, standardized as the backbone expects.
            backbone_source: Source of the backbone's initial weights.
            recipe: Training configuration.
            data: Training data.
            in_view_threshold: Probability of being in view below which an image is flagged.
            dtype: Dtype of the floating-point tensors in the file. float16 halves its size and
                keeps about three decimal digits; tensors with numbers beyond its range keep their
                own. All are read back as float32.

        Raises:
            ValueError: The output size of the preprocessing is not ``config.image_size``, or a
                value is invalid.
            TypeError: A metadata value cannot be stored as JSON.
        """
        if preprocessing is None:
            preprocessing = backbone_preprocessing(self.config.backbone, self.config.image_size)
        fits = tuple(preprocessing.size) == self.config.image_size
        expect(fits, "preprocessing", f"size {self.config.image_size}", preprocessing.size)
        metadata = WeightsMetadata(
            self.config, preprocessing, backbone_source, recipe, data, in_view_threshold
        )
        state = {name: _narrowed(tensor, dtype) for name, tensor in self.state_dict().items()}
        write_weights(path, state, metadata)

    @classmethod
    def from_pretrained(cls, path: str | Path, **fields: Any) -> Self:
        """Load a network that `save_pretrained` wrote, in evaluation mode.

        Args:
            path: Weights file, or name of shipped weights such as ``"soyuz"``.
            **fields: Fields of the config to change that the weights do not depend on: ``looks``
                and ``candidates`` of PolarPose, for less latency.

        Raises:
            FileNotFoundError: No such file or name.
            ValueError: A field is none of those, or its value is invalid.
            ffpose.DataError: The file is truncated, altered, newer than this version, or of another
                architecture.
        """
        path = resolve(path)
        return cls.of_file(path, read_metadata(path), **fields)

    @classmethod
    def of_file(cls, path: Path, metadata: WeightsMetadata, **fields: Any) -> Self:
        """Load a network from a file whose header is ``metadata``; otherwise `from_pretrained`."""
        config = metadata.config
        if not isinstance(config, cls.config_type):
            raise DataError(
                f"expected weights of a {cls.config_type.architecture}, got those of a"
                f" {config.architecture}",
                path,
            )
        config = config.at_inference(fields)
        try:
            model = cls.build(config, "none")
        except ValueError as error:
            raise DataError(f"expected a network that can be built here: {error}", path) from error
        load_weights(path, model)
        return model.eval()


class FrameNetwork(BaseNetwork):
    """Base of the networks that look at the frame alone; they define `regress`."""

    config: FrameConfig
    translation_mean: Tensor
    translation_std: Tensor

    def __init__(self, config: FrameConfig) -> None:
        super().__init__(config)
        for name in ("translation_mean", "translation_std"):
            self.register_buffer(name, torch.tensor(getattr(config, name)), persistent=False)

    @abstractmethod
    def regress(self, images: Tensor) -> tuple[Tensor, Tensor]:
        """Compute translations ``(B, 3)``, meters, and the inputs of the orientation head."""

    def translation_loss(self, t_hat: Tensor, t: Tensor) -> Tensor:
        """Return the Euclidean distance of each sample ``(B,)``, meters."""
        distance: Tensor = torch.linalg.vector_norm(t - t_hat, dim=-1)
        return distance

    def forward(self, images: Tensor) -> PosePrediction:
        """Predict the pose of the object in each image, as `BaseNetwork.forward`."""
        expect_shape("images", images, 3, *self.config.image_size)
        translation, orientation = self.regress(images)
        kind = images.device.type
        if not torch.is_autocast_enabled(kind):
            return PosePrediction(translation, self.orientation.decode(orientation))
        with torch.autocast(kind, enabled=False):  # half precision is for what is learned alone
            found = self.orientation.decode(orientation.float())
            return PosePrediction(translation.float(), found)

    def in_meters(self, output: Tensor) -> Tensor:
        """Return translations ``(B, 3)``, meters, for the outputs of the translation branch."""
        return output * self.translation_std + self.translation_mean


def _narrowed(tensor: Tensor, dtype: torch.dtype) -> Tensor:
    """Return a tensor of floats in a dtype, or as it is if that makes infinity of a number."""
    if not tensor.is_floating_point():
        return tensor
    narrow = tensor.to(dtype)
    return narrow if torch.equal(narrow.isfinite(), tensor.isfinite()) else tensor
