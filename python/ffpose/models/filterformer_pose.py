"""FilterformerPose: a satellite's pose from one image, by regression.

Ye et al., Sensors 2023, 23, 8633, section 3 and Figure 3. A convolutional backbone gives two
feature maps; each goes through a branch of its own (1 x 1 convolution, tokens, filterformer,
hypernetwork head), the coarser to translation, the finer to orientation, whose four numbers a
quaternion activation normalises. `FilterformerPoseConfig` names what the paper leaves open and how
it is read here.

Beyond the paper: the translation head may count in units of the training set's spread around its
mean, and the orientation head's last bias starts at the identity quaternion, so that the norm which
is divided by does not begin near zero.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple, Self

import torch
from torch import Tensor, nn
from torch.utils import _pytree

from ffpose.errors import DataError
from ffpose.models.backbone import Backbone, backbone_preprocessing, build_backbone
from ffpose.models.config import CONFIGS, FilterformerPoseConfig, check_names
from ffpose.models.weights import WeightsMetadata, load_weights, read_metadata, write_weights
from ffpose.nn import Filterformer, HyperHead, PositionCode, QuaternionActivation
from ffpose.transforms import Preprocessing

TOKEN_STD = 0.02


class PosePrediction(NamedTuple):
    """Poses of the object in the camera's frame (OpenCV: x right, y down, z forward).

    Attributes:
        translation: ``(B, 3)`` metres.
        orientation: ``(B, 4)`` unit quaternions, scalar first, of either sign.
    """

    translation: Tensor
    orientation: Tensor


# Saved programs name their result's type; torch leaves named tuples to whoever defines them.
_pytree._register_namedtuple(PosePrediction, serialized_type_name="ffpose.models.PosePrediction")


class PoseBranch(nn.Module):
    """From one feature map to a few numbers: projection, tokens, filterformer, head.

    Args:
        config: Sizes and readings.
        channels: Of the feature map.
        grid: ``(rows, columns)`` of the feature map.
        out_features: How many numbers.
        mlp_dim: Width of the head's generated perceptron.
    """

    def __init__(
        self,
        config: FilterformerPoseConfig,
        channels: int,
        grid: tuple[int, int],
        out_features: int,
        mlp_dim: int,
    ) -> None:
        super().__init__()
        self.projection = nn.Conv2d(channels, config.dim, kernel_size=1)
        self.position = PositionCode(grid, config.dim, config.position)
        self.pose_token = (
            nn.Parameter(torch.randn(1, 1, config.dim) * TOKEN_STD)
            if config.pooling == "token"
            else None
        )
        self.encoder = Filterformer(
            grid,
            config.dim,
            depth=config.depth,
            filter=config.filter,
            filter_std=config.filter_std,
            heads=config.heads,
            hidden=config.feed_forward,
            dropout=config.dropout,
            norm=config.norm,
            extra_tokens=0 if self.pose_token is None else 1,
        )
        self.head = HyperHead(config.dim, out_features, hidden=config.head_hidden, mlp_dim=mlp_dim)

    def forward(self, features: Tensor) -> Tensor:
        """Return ``(B, out_features)`` for a feature map ``(B, channels, rows, columns)``."""
        tokens = self.projection(features).flatten(2).transpose(1, 2)  # (B, rows * columns, dim)
        tokens = self.position(tokens)
        if self.pose_token is not None:
            token = self.pose_token.expand(tokens.shape[0], -1, -1)
            tokens = torch.cat((token, tokens), dim=1)  # (B, 1 + rows * columns, dim)
        encoded = self.encoder(tokens)
        latent = encoded.mean(1) if self.pose_token is None else encoded[:, 0]  # (B, dim)
        result: Tensor = self.head(latent)
        return result


class FilterformerPose(nn.Module):
    """The network; `from_config` builds it with its backbone, `from_pretrained` reads a file.

    `torch.export` takes it, with a batch of any size where ``dynamic_shapes`` asks for one. A saved
    program is loaded after ``import ffpose.models``, which knows its operators and its result.

    Args:
        config: Sizes and readings.
        backbone: Gives the maps of ``config.translation_reduction`` and
            ``config.orientation_reduction``, in this order.

    Attributes:
        config: As given.
        backbone: As given; stages 2 and 3 of training freeze it.
        translation_branch: The `PoseBranch` of the first map; stage 3 freezes it.
        orientation_branch: The `PoseBranch` of the second map; stage 2 freezes it.
    """

    translation_mean: Tensor
    translation_std: Tensor

    def __init__(self, config: FilterformerPoseConfig, backbone: Backbone) -> None:
        super().__init__()
        self.config = config
        self.backbone = backbone
        translation_channels, orientation_channels = backbone.channels
        self.translation_branch = PoseBranch(
            config,
            translation_channels,
            config.grid(config.translation_reduction),
            out_features=3,
            mlp_dim=config.translation_mlp_dim,
        )
        self.orientation_branch = PoseBranch(
            config,
            orientation_channels,
            config.grid(config.orientation_reduction),
            out_features=4,
            mlp_dim=config.orientation_mlp_dim,
        )
        self.quaternion = QuaternionActivation()
        for name in ("translation_mean", "translation_std"):
            self.register_buffer(name, torch.tensor(getattr(config, name)), persistent=False)
        with torch.no_grad():
            self.orientation_branch.head.bias.copy_(torch.tensor((1.0, 0.0, 0.0, 0.0)))

    def forward(self, images: Tensor) -> PosePrediction:
        """Return the pose of the object in each image.

        Args:
            images: ``(B, 3, H, W)`` with ``(H, W)`` = ``config.image_size``, standardised as in
                training.

        Raises:
            ValueError: Another shape.
        """
        expected = (3, *self.config.image_size)
        if images.dim() != 4 or tuple(images.shape[1:]) != expected:
            sizes = ", ".join(map(str, expected))
            raise ValueError(f"images: expected shape (B, {sizes}), got {tuple(images.shape)}")
        maps = self.backbone(images.contiguous(memory_format=torch.channels_last))
        translation = self.translation_branch(maps[0])
        orientation = self.orientation_branch(maps[1])
        return PosePrediction(
            translation * self.translation_std + self.translation_mean,
            self.quaternion(orientation),
        )

    @classmethod
    def from_config(
        cls,
        config: str | FilterformerPoseConfig,
        *,
        backbone_weights: str | Path = "auto",
        **fields: Any,
    ) -> Self:
        """Build the network with new weights.

        Args:
            config: ``"base"``, ``"small"``, ``"tiny"``, or a config.
            backbone_weights: ``"auto"``: pretrained, from the hub or its cache; ``"none"``: random;
                otherwise a safetensors or PyTorch file.
            **fields: Fields of the config to change.

        Raises:
            ValueError: An unknown preset or field, or values that do not go together.
            FileNotFoundError: There is no such weights file, or the pretrained weights cannot be
                had.
            ffpose.DataError: The file does not hold the backbone's weights.
        """
        if isinstance(config, str):
            if config not in CONFIGS:
                raise ValueError(f"config: expected one of {tuple(CONFIGS)}, got {config!r}")
            config = CONFIGS[config]
        check_names(fields)
        config = replace(config, **fields)
        reductions = (config.translation_reduction, config.orientation_reduction)
        return cls(config, build_backbone(config.backbone, reductions, backbone_weights))

    def save_pretrained(
        self, path: str | Path, *, preprocessing: Preprocessing | None = None
    ) -> None:
        """Write weights, config, preprocessing and this version to a safetensors file.

        The file appears whole or not at all, and beside it ``path.sha256``.

        Args:
            path: Where; its folder must exist.
            preprocessing: What turns an image into the network's input; a resize to
                ``config.image_size`` as the backbone expects it when None.

        Raises:
            ValueError: The preprocessing makes images of another size.
        """
        if preprocessing is None:
            preprocessing = backbone_preprocessing(self.config.backbone, self.config.image_size)
        if tuple(preprocessing.size) != self.config.image_size:
            raise ValueError(
                f"preprocessing: expected size {self.config.image_size}, got {preprocessing.size}"
            )
        write_weights(path, self.state_dict(), WeightsMetadata(self.config, preprocessing))

    @classmethod
    def from_pretrained(cls, path: str | Path) -> Self:
        """Read a network that `save_pretrained` wrote; it comes in evaluation mode.

        Raises:
            FileNotFoundError: There is no such file.
            ffpose.DataError: The file is truncated, altered, newer than this version, or not of
                this architecture.
        """
        config = read_metadata(path).config
        try:
            model = cls.from_config(config, backbone_weights="none")
        except ValueError as error:
            raise DataError(f"expected a network that can be built here: {error}", path) from error
        load_weights(path, model)
        return model.eval()
