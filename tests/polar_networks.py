"""A small PolarPose of random weights, for tests of what holds for any weights."""

import math

import torch

from ffpose.models import build_network

FIELDS = {
    "image_size": (96, 128),
    "camera": (64.0, 66.0, 64.0, 48.0),
    "first_stride": 4,
    "first_reduction": 4,
    "first_channels": 16,
    "object_size": (16, 96),
    "object_width": 32,
    "channels": (4, 8, 12),
    "blocks": (1, 1),
    "latent": 16,
    "angles": 24,
    "directions": 50,
}
CELL = 2 * math.pi / 12
"""Angle of a cell of the last map."""


def build_polar(**fields):
    """Build it for evaluation, with some fields changed and no output nearly zero."""
    torch.manual_seed(0)
    model = build_network("polar", backbone_weights="none", **(FIELDS | fields)).eval()
    for module in model.modules():
        if isinstance(module, torch.nn.Linear):
            torch.nn.init.normal_(module.weight, std=1.5 * module.in_features**-0.5)
    with torch.no_grad():
        model.orientation.weight.normal_()
    return model
