"""Pretrained backbone weights: from timm's hub, from a file, or none.

Requested weights that are not available raise an error; they are never replaced by random ones, as
the same seed would then give another network. The cache is checked first, then the hub is asked for
the file's header with a timeout of seconds; a download has a timeout as well.
``HF_HUB_OFFLINE=1`` uses the cache alone.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Literal

import torch
from torch import Tensor, nn

from ffpose.errors import DataError, require
from ffpose.files import sha256

logger = logging.getLogger(__name__)

ANSWER_SECONDS = 4.0
DOWNLOAD_SECONDS = 180.0
HUB_FILE = "model.safetensors"


BackboneSource = Mapping[str, str] | Literal["none"]
"""Source of weights: ``name``, ``source`` and ``sha256`` of pretrained ones, or ``"none"``."""


def load_backbone_weights(features: nn.Module, name: str, weights: str | Path) -> BackboneSource:
    """Load weights into a feature extractor, in place.

    Args:
        features: Model from `timm.create_model` with ``features_only``.
        name: timm's name of the model.
        weights: ``"auto"``, ``"none"`` or a file; see `ffpose.models.build_backbone`.

    Returns:
        The source of the weights; its ``source`` is the file's name or the hub's repository.

    Raises:
        FileNotFoundError: The file does not exist, or the pretrained weights are not available.
        ffpose.DataError: The file does not hold this model's weights.
    """
    if weights == "none":
        return "none"
    hub_id, path = find_pretrained(name) if weights == "auto" else ("", Path(weights))
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
    return {"name": name, "source": hub_id or path.name, "sha256": sha256(path)}


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


def find_pretrained(name: str) -> tuple[str, Path]:
    """Return the hub's name of timm's pretrained weights and their file, downloaded if necessary.

    Raises:
        FileNotFoundError: They are not available; the message has the reason and alternatives.
    """
    config = require("timm", "pose").models.get_pretrained_cfg(name)
    if config is None or not config.hf_hub_id:
        raise _missing(name, "timm has none")
    hub = require("huggingface_hub", "pose")
    cached = hub.try_to_load_from_cache(config.hf_hub_id, HUB_FILE)
    if isinstance(cached, str):
        return config.hf_hub_id, Path(cached)
    if hub.constants.HF_HUB_OFFLINE:
        raise _missing(name, "HF_HUB_OFFLINE is set and the cache has none")
    url = hub.hf_hub_url(config.hf_hub_id, HUB_FILE)
    if within(ANSWER_SECONDS, lambda: hub.get_hf_file_metadata(url)) is None:
        raise _missing(name, f"{hub.constants.ENDPOINT} does not answer")
    logger.info("downloading the weights of %s from %s", name, url)
    path = within(DOWNLOAD_SECONDS, lambda: hub.hf_hub_download(config.hf_hub_id, HUB_FILE))
    if path is None:
        raise _missing(name, f"the download took over {DOWNLOAD_SECONDS:.0f} s or failed")
    return config.hf_hub_id, Path(path)


def _missing(name: str, reason: str) -> FileNotFoundError:
    return FileNotFoundError(
        f"backbone weights: expected the pretrained ones of {name}, got none ({reason}):"
        " --backbone-weights none starts from random weights,"
        " --backbone-weights FILE from a local file"
    )


def within(seconds: float, call: Callable[[], Any]) -> Any:
    """Return the result of ``call``, or None if it fails or takes longer than ``seconds``.

    It runs in a daemon thread, because a DNS lookup has no timeout.
    """
    answers: list[Any] = []

    def attempt() -> None:
        try:
            answers.append(call())
        except Exception as error:  # whatever keeps the hub from answering, the answer is "not now"
            logger.debug("the hub said: %s", error)

    thread = threading.Thread(target=attempt, daemon=True)
    thread.start()
    thread.join(seconds)
    return answers[0] if answers else None
