"""What a run's weights say of how they were made."""

from __future__ import annotations

import hashlib
from dataclasses import asdict
from typing import Any

from ffpose.datasets import PoseDataset
from ffpose.files import sha256
from ffpose.training.config import TrainConfig

OF_THIS_MACHINE = ("out", "device", "backbone_weights")
"""Fields that tell nothing to another machine; the weights say what the backbone began from."""


def recipe(config: TrainConfig) -> dict[str, Any]:
    """Return the configuration as JSON can hold it, without paths and names of this machine.

    ``init`` is the SHA-256 of the weights that the network began from.

    Raises:
        FileNotFoundError: There are no such weights.
    """
    fields = {name: value for name, value in asdict(config).items() if name not in OF_THIS_MACHINE}
    fields["init"] = None if config.init is None else sha256(config.init)
    fields["data"] = {
        name: value for name, value in fields["data"].items() if name not in ("root", "workers")
    }
    return fields


def describe_data(dataset: PoseDataset, kind: str) -> dict[str, Any]:
    """Return which images those of a run are: kind, how many, their size, and a digest.

    The digest is the SHA-256, in hexadecimal, of each image's name, a newline and its label
    ``[t, q]`` as little-endian float64, image after image.
    """
    digest = hashlib.sha256()
    for name, pose in zip(dataset.names, dataset.poses, strict=True):
        digest.update(f"{name}\n".encode() + pose.astype("<f8").tobytes())
    return {
        "kind": kind,
        "count": len(dataset),
        "image_size": [dataset.camera.width, dataset.camera.height],
        "digest": digest.hexdigest(),
    }
