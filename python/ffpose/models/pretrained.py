"""Pretrained backbone weights: from timm's hub, from a file, or none.

Requested weights that are not available raise an error; they are never replaced by random ones, as
the same seed would then give another network. `ffpose.models.hub` finds those of timm's hub.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

import torch
from torch import Tensor, nn

from ffpose._internal.files import sha256
from ffpose.errors import DataError, require
from ffpose.models.hub import find_pretrained

BackboneSource = Mapping[str, str] | Literal["none"]
"""Source of weights: ``name``, ``source`` and ``sha256`` of pretrained ones, or ``"none"``.

The ``source`` is the name of a file or of a repository, whose commit is then the ``revision``.
"""


def load_backbone_weights(features: nn.Module, name: str, weights: str | Path) -> BackboneSource:
    """Load weights into a feature extractor, in place.

    Args:
        features: Model from `timm.create_model` with ``features_only``.
        name: timm's name of the model.
        weights: ``"auto"``, ``"none"`` or a file; see `ffpose.models.build_backbone`.

    Returns:
        The source of the weights.

    Raises:
        FileNotFoundError: The file does not exist, or the pretrained weights cannot be had.
        ffpose.DataError: The file does not hold this model's weights, or is not the one that is
            known (`ffpose.models.hub.PINNED`).
    """
    if weights == "none":
        return "none"
    path, origin = Path(weights), {"source": Path(weights).name}
    if weights == "auto":
        found = find_pretrained(name)
        path, origin = found.path, {"source": found.repository, "revision": found.revision}
    state = read_state(path)
    wanted = features.state_dict()
    wrong = [
        key for key, value in wanted.items() if key not in state or state[key].shape != value.shape
    ]
    if wrong:
        raise DataError(
            f"expected the weights of {name}; {len(wrong)} of {len(wanted)} entries are missing or"
            f" have another shape, the first: {', '.join(wrong[:4])}",
            path,
        )
    features.load_state_dict({key: state[key] for key in wanted})
    return {"name": name, **origin, "sha256": sha256(path)}


def read_state(path: Path) -> Mapping[str, Tensor]:
    """Read a state dict from a safetensors file or a file of `torch.save` (weights only).

    Raises:
        FileNotFoundError: The file does not exist.
        ffpose.DataError: The file cannot be read or holds something else.
    """
    if not path.is_file():
        raise FileNotFoundError(f"backbone weights: expected a file, got {path}")
    try:
        if path.suffix == ".safetensors":
            state: Any = require("safetensors.torch", "pose").load_file(path)
        else:
            state = torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:  # a broken pickle may raise anything
        raise DataError(f"expected weights that can be read: {error}", path) from error
    state = state.get("state_dict", state) if isinstance(state, Mapping) else state
    if not isinstance(state, Mapping) or not all(isinstance(v, Tensor) for v in state.values()):
        raise DataError("expected a mapping from names to tensors", path)
    return state
