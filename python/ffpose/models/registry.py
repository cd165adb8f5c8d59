"""The networks by name: built from a configuration, or loaded from a weights file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ffpose._internal.zoo import resolve
from ffpose.config import PRESETS, NetworkConfig
from ffpose.models.base import BaseNetwork
from ffpose.models.filterformer_pose import FilterformerPose
from ffpose.models.polar_pose import PolarPose
from ffpose.models.posenet import PoseNet
from ffpose.models.ursonet import UrsoNet
from ffpose.models.weights import WeightsMetadata, read_metadata

NETWORKS: dict[str, type[BaseNetwork]] = {
    each.config_type.architecture: each for each in (FilterformerPose, PolarPose, UrsoNet, PoseNet)
}
"""Networks by the name of their class, which files of weights and graphs record."""


def find_config(model: str) -> NetworkConfig:
    """Return the configuration of a preset of any network.

    Raises:
        ValueError: The preset is unknown; the message lists the names.
    """
    if model not in PRESETS:
        raise ValueError(f"model: expected one of {', '.join(PRESETS)}, got {model!r}")
    return PRESETS[model]


def build_network(
    config: str | NetworkConfig, *, backbone_weights: str | Path = "auto", **fields: Any
) -> BaseNetwork:
    """Build any network, as `BaseNetwork.from_config` of its class.

    Args:
        config: A preset's name (`ffpose.config.PRESETS`), or a configuration.
        backbone_weights: A file, ``"none"`` for random ones, or ``"auto"`` for pretrained ones,
            which are downloaded where they are not in the cache.
        **fields: Fields of the configuration to change.

    Returns:
        The network, on the CPU, in training mode.

    Raises:
        ValueError: An unknown preset or field, or a value out of range.
        FileNotFoundError: The backbone's weights are not there, or cannot be downloaded.
    """
    if isinstance(config, str):
        config = find_config(config)
    network = NETWORKS[config.architecture]
    return network.from_config(config, backbone_weights=backbone_weights, **fields)


def load_network(path: str | Path, **fields: Any) -> BaseNetwork:
    """Load a network of any kind, as `BaseNetwork.from_pretrained` of its class.

    Args:
        path: Weights file, or a name of shipped weights such as ``"soyuz"``.
        **fields: Fields that may change after training: ``looks``, ``candidates``.

    Returns:
        The network, on the CPU, in evaluation mode.

    Raises:
        FileNotFoundError: There is no such file or name.
        ffpose.DataError: The file was not written by ffpose, or was altered.
        ValueError: A field cannot be changed, or its value is out of range.
    """
    return open_weights(path, **fields)[0]


def open_weights(path: str | Path, **fields: Any) -> tuple[BaseNetwork, WeightsMetadata]:
    """Load a network as `load_network`, with the header of its file, which is read once."""
    path = resolve(path)
    metadata = read_metadata(path)
    return NETWORKS[metadata.config.architecture].of_file(path, metadata, **fields), metadata
