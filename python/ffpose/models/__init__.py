"""The networks, their configurations, and their weights files."""

from ffpose.config import (
    CONFIGS,
    PRESETS,
    FilterformerPoseConfig,
    NetworkConfig,
    PolarPoseConfig,
    PoseNetConfig,
    UrsoNetConfig,
)
from ffpose.models.backbone import Backbone, backbone_preprocessing, build_backbone
from ffpose.models.base import BaseNetwork, FrameNetwork, PosePrediction, find_device
from ffpose.models.filterformer_pose import FilterformerPose
from ffpose.models.polar_pose import PolarPose
from ffpose.models.posenet import PoseNet
from ffpose.models.registry import (
    build_network,
    find_config,
    load_network,
    open_weights,
)
from ffpose.models.ursonet import UrsoNet
from ffpose.models.weights import WeightsMetadata, read_metadata

__all__ = [
    "CONFIGS",
    "PRESETS",
    "Backbone",
    "BaseNetwork",
    "FilterformerPose",
    "FilterformerPoseConfig",
    "FrameNetwork",
    "NetworkConfig",
    "PolarPose",
    "PolarPoseConfig",
    "PoseNet",
    "PoseNetConfig",
    "PosePrediction",
    "UrsoNet",
    "UrsoNetConfig",
    "WeightsMetadata",
    "backbone_preprocessing",
    "build_backbone",
    "build_network",
    "find_config",
    "find_device",
    "load_network",
    "open_weights",
    "read_metadata",
]
