"""FilterformerPose: the network, its configurations, and its weights files."""

from ffpose.config import CONFIGS, FilterformerPoseConfig
from ffpose.models.backbone import Backbone, backbone_preprocessing, build_backbone
from ffpose.models.filterformer_pose import FilterformerPose, PosePrediction
from ffpose.models.weights import WeightsMetadata, read_metadata

__all__ = [
    "CONFIGS",
    "Backbone",
    "FilterformerPose",
    "FilterformerPoseConfig",
    "PosePrediction",
    "WeightsMetadata",
    "backbone_preprocessing",
    "build_backbone",
    "read_metadata",
]
