"""FilterformerPose, with each filter and without, against UrsoNet and PoseNet, on rendered scenes.

One backbone for all, and whole images: what differs is what follows the feature maps, and what the
orientation is trained on. The learning rate is constant after its warm-up and the validated weights
are a moving average, as in the study mixers.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from ffpose.training.config import LossConfig
from studies.mixers import BASE as MIXERS_BASE
from studies.study import Study, Variant

IMAGE = {"image_size": [96, 128], "backbone": "compact_resnet_narrow"}

BASE = replace(
    MIXERS_BASE,
    data=replace(
        MIXERS_BASE.data,
        count=3000,
        attitude_range_deg=(30.0, 30.0, 30.0),
        augmentation={"roll": 10.0, "contrast": 0.0, "saturation": 0.0, "noise": 0.04},
    ),
    model="tiny",
    model_fields=IMAGE,
    epochs=6,
)
"""Attitudes within 30° of the camera's axes: over all of them, whole images teach a network of this
size nothing in minutes. Turned about the optical axis, which is exact for image and label, and
varied in brightness."""

QUATERNION = {"loss": vars(LossConfig(s_t=0.0, s_q=-3.0, antipodal=True))}
"""Weights of meters and quaternions to begin with as Kendall and Cipolla (CVPR 2017) set them: the
paper's, -3 and -6.5, are of its longer training."""

BINS = {"orientation_head": "bins"}


def filterformer(filter: str, **fields: Any) -> dict[str, Any]:
    """Return the changes that make the network a FilterformerPose with a filter."""
    loss = {"loss": vars(LossConfig(s_t=0.0, s_q=0.0))} if fields else QUATERNION
    return {"model_fields": {"filter": filter, **fields}, **loss}


NETWORKS = Study(
    name="networks",
    about="FilterformerPose by filter, UrsoNet and PoseNet: whole images, one backbone and budget.",
    base=BASE,
    variants=(
        Variant("tokens", "FilterformerPose, filter over tokens", filterformer("tokens")),
        Variant("grid", "FilterformerPose, filter over the grid", filterformer("grid")),
        Variant("none", "TransformerPose: no filter", filterformer("none")),
        Variant(
            "tokens-bins",
            "FilterformerPose, tokens, soft classification",
            filterformer("tokens", **BINS),
        ),
        Variant("none-bins", "TransformerPose, soft classification", filterformer("none", **BINS)),
        Variant(
            "ursonet",
            "UrsoNet",
            {
                "model": "ursonet",
                "model_fields": {
                    "reduction": 16,
                    "bottleneck": 128,
                    "hidden": 256,
                    "bins_per_dim": 16,
                },
            },
        ),
        Variant(
            "posenet",
            "PoseNet: direct regression",
            {"model": "posenet", "model_fields": {"reduction": 16}, **QUATERNION},
        ),
    ),
    notes="All networks have the backbone compact_resnet_narrow from random weights, and see the "
    "same whole images at 128 x 96 pixels. FilterformerPose is the preset tiny, of two blocks; "
    "UrsoNet has 16 bins for each angle, and a bottleneck of 128 channels, for its map has 3 x 4 "
    "cells. The variants with soft classification are FilterformerPose with an orientation head of "
    "UrsoNet's kind: they tell the network's part from the head's, which published comparisons "
    "change together. --minutes gives all the same CPU time, epochs the same samples.",
)
