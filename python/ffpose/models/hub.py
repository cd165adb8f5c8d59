"""Pretrained backbone weights: from timm's hub, from a file, or none.

Requested weights that are not available raise an error; they are never replaced by random ones, as
the same seed would then give another network.

The cache is checked first, then the hub is asked for the file's header with a timeout of seconds; a
download has a timeout as well. ``HF_HUB_OFFLINE=1`` uses the cache alone. Repositories in `PINNED`
give the bytes that are known, whatever their owner uploads; of others, the newest revision is
taken, and `BackboneSource` says which that was.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from pathlib import Path
from typing import Any, Literal, NamedTuple, TypeVar

import torch
from torch import Tensor, nn

from ffpose._internal.files import sha256
from ffpose.errors import DataError, explain, require

logger = logging.getLogger(__name__)

Answer = TypeVar("Answer")

BackboneSource = Mapping[str, str] | Literal["none"]
"""Source of weights: ``name``, ``source`` and ``sha256`` of pretrained ones, or ``"none"``.

The ``source`` is the name of a file or of a repository, whose commit is then the ``revision``.
"""

ANSWER_SECONDS = 4.0
DOWNLOAD_SECONDS = 180.0
HUB_FILE = "model.safetensors"
NEWEST = "main"
NAMES_SHOWN = 4


class Pin(NamedTuple):
    """A known revision: the commit of the repository, and the SHA-256 of its `HUB_FILE`."""

    commit: str
    sha256: str


PINNED = {
    "timm/efficientnet_b0.ra_in1k": Pin(
        "1b5383e5f79cc0f7fc067e372f8f26a5fa73f26a",
        "d569899762ea9b1384ee07f4af64805cf8caa1c55f9253ebb1080dc40e87a2cd",
    ),
    "timm/resnet18.a1_in1k": Pin(
        "491b427b45c94c7fb0e78b5474cc919aff584bbf",
        "80c49dee3da4822c009c5a7fe591e9223c5a2cfcf95a4067ca4dfb5a7b89c612",
    ),
    "timm/resnet50.a1_in1k": Pin(
        "767268603ca0cb0bfe326fa87277f19c419566ef",
        "773525d5821de224f8f30c33377b7a795d7863e08522698200d3217d3f2a41bb",
    ),
}
"""Repositories whose weights are known: the backbones of the paper's networks and tables.

Both numbers are those that several public projects recorded of their own downloads, each
independently, with the digest that the hub has of the file.
"""


def find_pretrained(name: str) -> tuple[Path, dict[str, str]]:
    """Find timm's pretrained weights of a model in the cache, or download them.

    Returns:
        The file, and its ``source``, the hub's name ``timm/…``, and ``revision``, the commit.

    Raises:
        FileNotFoundError: They cannot be had; the message says what happened and the alternatives.
        ffpose.DataError: The file is not the one that is known (`PINNED`).
    """
    config = require("timm", "pose").models.get_pretrained_cfg(name)
    if config is None or not config.hf_hub_id:
        raise _missing(name, "timm has none")
    repository, pin = config.hf_hub_id, PINNED.get(config.hf_hub_id)
    hub = require("huggingface_hub", "pose")
    revision = NEWEST if pin is None else pin.commit
    path = hub.try_to_load_from_cache(repository, HUB_FILE, revision=revision)
    if not isinstance(path, str):
        path = _download(name, repository, revision)
    if pin is not None and (got := sha256(path)) != pin.sha256:
        raise DataError(
            f"expected {repository} at {pin.commit}, SHA-256 {pin.sha256}, got {got}", path
        )
    return Path(path), {"source": repository, "revision": Path(path).parent.name}


def _download(name: str, repository: str, revision: str) -> str:
    """Download the file of a repository and return its path, in the folder of its commit."""
    hub = require("huggingface_hub", "pose")
    if hub.constants.HF_HUB_OFFLINE:
        raise _missing(name, f"HF_HUB_OFFLINE is set and the cache has no {repository}@{revision}")
    url = hub.hf_hub_url(repository, HUB_FILE, revision=revision)
    asking = f"asking {hub.constants.ENDPOINT}"
    _ask(name, asking, ANSWER_SECONDS, lambda: hub.get_hf_file_metadata(url))
    logger.info("downloading the weights of %s from %s", name, url)

    def download() -> str:
        return str(hub.hf_hub_download(repository, HUB_FILE, revision=revision))

    return _ask(name, "the download", DOWNLOAD_SECONDS, download)


def _ask(name: str, what: str, seconds: float, call: Callable[[], Answer]) -> Answer:
    """Return the result of ``call``, or raise that the weights are missing, and why."""
    try:
        return within(seconds, call)
    except TimeoutError as error:
        raise _missing(name, f"{what} took over {seconds:g} s") from error
    except Exception as error:  # of the hub's client, whose errors share no base, or of the disk
        raise _missing(name, f"{what} failed: {_told(error)}") from error


def _told(error: BaseException) -> str:
    """Return what happened: the cause at the end of the chain, where the client reports another."""
    while error.__cause__ is not None:
        error = error.__cause__
    return explain(error)


def _missing(name: str, reason: str) -> FileNotFoundError:
    return FileNotFoundError(
        f"backbone weights: expected the pretrained ones of {name}, got none ({reason}):"
        " --backbone-weights none starts from random weights,"
        " --backbone-weights FILE from a local file"
    )


def within(seconds: float, call: Callable[[], Answer]) -> Answer:
    """Return the result of ``call``, or raise what it does, or a TimeoutError.

    It runs in a daemon thread, because a DNS lookup has no timeout.
    """
    answer: Future[Answer] = Future()

    def attempt() -> None:
        try:
            answer.set_result(call())
        except Exception as error:  # for the thread that waits
            answer.set_exception(error)

    threading.Thread(target=attempt, daemon=True).start()
    return answer.result(seconds)


def load_backbone_weights(features: nn.Module, name: str, weights: str | Path) -> BackboneSource:
    """Load weights into a timm model's feature extractor, in place, and return their source.

    ``weights`` are ``"auto"``, ``"none"`` or a file; see `ffpose.models.build_backbone`.

    Raises:
        FileNotFoundError: The file does not exist, or the pretrained weights cannot be had.
        ffpose.DataError: The file does not hold this model's weights, or is not the one that is
            known (`PINNED`).
    """
    if weights == "none":
        return "none"
    path, origin = Path(weights), {"source": Path(weights).name}
    if weights == "auto":
        path, origin = find_pretrained(name)
    wanted, published = features.state_dict(), read_state(path)
    # timm's extractor may have flattened ``stages.0`` to ``stages_0``.
    flat = {key.replace(".", "_", 1): value for key, value in published.items()}
    state = {key: value for key, value in {**flat, **published}.items() if key in wanted}
    check_state(state, wanted, f"the weights of {name}", path)
    features.load_state_dict(state)
    return {"name": name, **origin, "sha256": sha256(path)}


def check_state(
    state: Mapping[str, Tensor], wanted: Mapping[str, Tensor], expected: str, path: Path
) -> None:
    """Check that tensors are those of a model: none missing, unknown, or of another shape.

    Raises:
        ffpose.DataError: They are not; the message begins with what was ``expected``.
    """
    differences = [
        *(f"{name} is missing" for name in wanted.keys() - state.keys()),
        *(f"{name} is unknown" for name in state.keys() - wanted.keys()),
        *(
            f"{name} has shape {tuple(state[name].shape)}, expected {tuple(wanted[name].shape)}"
            for name in wanted.keys() & state.keys()
            if state[name].shape != wanted[name].shape
        ),
    ]
    if differences:
        shown = "; ".join(sorted(differences)[:NAMES_SHOWN])
        raise DataError(f"expected {expected}, got {len(differences)} differences: {shown}", path)


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
