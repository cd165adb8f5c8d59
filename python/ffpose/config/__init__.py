"""Configurations of the networks and their presets; nothing here needs torch."""

from __future__ import annotations

from typing import TypeGuard

from ffpose.config.filterformer_pose import CONFIGS, FilterformerPoseConfig
from ffpose.config.network import FrameConfig, NetworkConfig
from ffpose.config.polar_pose import PolarPoseConfig
from ffpose.config.rivals import PoseNetConfig, UrsoNetConfig

__all__ = [
    "CONFIGS",
    "PRESETS",
    "FilterformerPoseConfig",
    "FrameConfig",
    "NetworkConfig",
    "PolarPoseConfig",
    "PoseNetConfig",
    "UrsoNetConfig",
    "config_type",
    "looks_twice",
]

PRESETS: dict[str, NetworkConfig] = {
    **CONFIGS,
    "polar": PolarPoseConfig(),
    "ursonet": UrsoNetConfig(),
    "posenet": PoseNetConfig(),
}
"""Presets of all networks by name: those of FilterformerPose, and one for each other network."""

_CONFIG_TYPES: dict[str, type[NetworkConfig]] = {
    each.architecture: each
    for each in (FilterformerPoseConfig, PolarPoseConfig, UrsoNetConfig, PoseNetConfig)
}


def config_type(architecture: str) -> type[NetworkConfig]:
    """Return the type of configuration of a network, by the name of the network's class.

    Raises:
        ValueError: There is no network of this name; the message lists the names.
    """
    if architecture not in _CONFIG_TYPES:
        known = ", ".join(_CONFIG_TYPES)
        raise ValueError(f"architecture: expected one of {known}, got {architecture!r}")
    return _CONFIG_TYPES[architecture]


def looks_twice(config: NetworkConfig) -> TypeGuard[PolarPoseConfig]:
    """Return whether the network takes a second look, through a virtual camera."""
    return isinstance(config, PolarPoseConfig)
