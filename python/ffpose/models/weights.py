"""Weights on disk: a safetensors file that knows what it is, and its SHA-256 beside it.

The header holds what builds the network (architecture, config with the camera, preprocessing), how
it was made (backbone, recipe, training data), the version of ffpose that wrote it and the version
of this format. Reading trusts none of it: a file that is cut short, changed, newer than this code
or of another architecture is refused with the reason. Format 1 said nothing of how the network was
made, and still loads.
"""

from __future__ import annotations

import json
import logging
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from safetensors import SafetensorError, safe_open
from safetensors.torch import load_file, save
from torch import Tensor, nn

from ffpose import __version__
from ffpose.config import FilterformerPoseConfig
from ffpose.errors import DataError
from ffpose.files import atomic_write, sha256
from ffpose.geometry import Camera
from ffpose.models.compact_resnet import EXTRA_PART
from ffpose.models.pretrained import BackboneSource
from ffpose.models.zoo import resolve
from ffpose.preprocessing import Preprocessing

logger = logging.getLogger(__name__)

FORMAT = 2
"""Version of the header; one more whenever older code could not read it rightly."""

ARCHITECTURE = "FilterformerPose"

NAMES_SHOWN = 4

ORIGIN = ("backbone_source", "recipe", "data", "in_view_threshold")
"""Fields of `WeightsMetadata` that format 2 added, each a JSON value in the header."""


@dataclass(frozen=True)
class WeightsMetadata:
    """What a weights file says about itself; what it does not say is None.

    Attributes:
        config: Builds the network; its ``camera`` is that of the network's input.
        preprocessing: Turns an image into its input.
        backbone_source: What the backbone's training began from: ``name``, ``source`` and
            ``sha256`` of pretrained weights, or ``"none"``: random ones.
        recipe: How the network was trained, as JSON can hold it: loss, optimiser, augmentation,
            stages, seed, steps.
        data: What it was trained on, as JSON can hold it: name, ``count``, ``digest``, and
            ``image_size``, the ``[width, height]`` of the images before preprocessing.
        in_view_threshold: An image whose probability that the object is in view lies below this is
            flagged.
        architecture: Name of the network's class.
        version: Of ffpose that wrote the file.

    Raises:
        ValueError: A threshold that is no probability, or an ``image_size`` that is none.
    """

    config: FilterformerPoseConfig
    preprocessing: Preprocessing
    backbone_source: BackboneSource | None = None
    recipe: Mapping[str, Any] | None = None
    data: Mapping[str, Any] | None = None
    in_view_threshold: float | None = None
    architecture: str = ARCHITECTURE
    version: str = __version__

    def __post_init__(self) -> None:
        threshold = self.in_view_threshold
        if threshold is not None and not 0 <= threshold <= 1:
            raise ValueError(f"in_view_threshold: expected a probability, got {threshold}")
        match (self.data or {}).get("image_size", (1, 1)):
            case [int(width), int(height)] if min(width, height) >= 1:
                pass
            case other:
                raise ValueError(f"data: expected image_size [width, height], got {other!r}")

    @property
    def camera(self) -> Camera | None:
        """The camera of the images trained on; None where the config does not know it.

        Where ``data`` does not tell their size, they are taken to be of the network's input's.
        """
        view = self.config.view_camera
        if view is None:
            return None
        width, height = (self.data or {}).get("image_size", (view.width, view.height))
        return self.preprocessing.image_camera(view, width, height)


def checksum_path(path: str | Path) -> Path:
    """Return where the checksum of a weights file stands, in the form of ``sha256sum``."""
    return Path(f"{path}.sha256")


def write_weights(path: str | Path, state: Mapping[str, Tensor], metadata: WeightsMetadata) -> None:
    """Write a state dict and its checksum; a process that is killed leaves the old file or the new.

    Args:
        path: The weights file; its folder must exist.
        state: Names and tensors, on any device.
        metadata: Goes to the header.

    Raises:
        TypeError: The metadata hold what JSON cannot.
        ValueError: They hold a number that is not finite.
    """
    header = _to_header(metadata)
    tensors = {name: tensor.detach().cpu().contiguous() for name, tensor in state.items()}
    with atomic_write(path) as temporary:
        temporary.write_bytes(save(tensors, header))  # save_file would deny others to read it
        digest = sha256(temporary)
        # Between the two renames a kill leaves weights without a checksum, never with a wrong one.
        checksum_path(path).unlink(missing_ok=True)
    with atomic_write(checksum_path(path)) as temporary:
        temporary.write_text(f"{digest}  {Path(path).name}\n", encoding="utf-8")


def read_metadata(path: str | Path) -> WeightsMetadata:
    """Read what a weights file says about itself, without its tensors.

    Args:
        path: The file, or a name, as `ffpose.models.zoo.resolve` takes it.

    Raises:
        FileNotFoundError: There is no such file or name.
        ffpose.DataError: It is truncated, no weights file of ffpose, or newer than this version.
    """
    path = resolve(path)
    header = _read_header(path)
    if "format" not in header:
        raise DataError("expected weights written by ffpose, got a safetensors file without", path)
    version = header.get("ffpose_version", "unknown")
    if header["format"] not in ("1", str(FORMAT)):
        raise DataError(
            f"expected weights of format 1 to {FORMAT}, which ffpose {__version__} reads;"
            f" got format {header['format']}, written by ffpose {version}",
            path,
        )
    try:
        metadata = _from_header(header, version)
    except (KeyError, TypeError, ValueError) as error:
        raise DataError(f"expected a header that ffpose {version} wrote: {error}", path) from error
    if metadata.architecture != ARCHITECTURE:
        raise DataError(
            f"expected weights of a {ARCHITECTURE}, got those of a {metadata.architecture}", path
        )
    return metadata


def _to_header(metadata: WeightsMetadata) -> dict[str, str]:
    """Return the header of format `FORMAT`, a string each, as safetensors wants it."""
    origin = {name: getattr(metadata, name) for name in ORIGIN}
    return {
        "format": str(FORMAT),
        "ffpose_version": metadata.version,
        "architecture": metadata.architecture,
        "config": metadata.config.to_json(),
        "preprocessing": json.dumps(metadata.preprocessing.to_dict()),
        **{name: json.dumps(value, allow_nan=False) for name, value in origin.items()},
    }


def _from_header(header: Mapping[str, str], version: str) -> WeightsMetadata:
    """Return what a header of a known format says; format 1 knows no origin."""
    origin: dict[str, Any] = {}
    if header["format"] != "1":
        origin = {name: json.loads(header[name]) for name in ORIGIN}
        for name in ("backbone_source", "recipe", "data"):
            value = origin[name]
            if not isinstance(value, dict | None) and (name, value) != ("backbone_source", "none"):
                raise ValueError(f"{name}: expected a JSON object, got {value!r}")
    return WeightsMetadata(
        FilterformerPoseConfig.from_json(header["config"]),
        Preprocessing.from_dict(json.loads(header["preprocessing"])),
        **origin,
        architecture=header.get("architecture", ARCHITECTURE),
        version=version,
    )


def load_weights(path: str | Path, model: nn.Module, *, grow: bool = False) -> None:
    """Fill a model with the tensors of a weights file, in place, after every check.

    Args:
        path: The file.
        model: The network.
        grow: Whether the file may lack the extra blocks of a
            `ffpose.models.compact_resnet.CompactResNet`, which then stay as they are: a new model
            computes what the file's network computed.

    Raises:
        FileNotFoundError: There is no such file.
        ffpose.DataError: It is truncated or altered, or its tensors are not those of ``model``.
    """
    path = Path(path)
    _read_header(path)
    _check_bytes(path)
    state, expected = load_file(path), model.state_dict()
    if grow:
        state = {name: t for name, t in expected.items() if EXTRA_PART in name} | state
    _check_architecture(path, state, expected)
    model.load_state_dict(state)


def _read_header(path: Path) -> dict[str, str]:
    if not path.is_file():
        raise FileNotFoundError(f"weights: expected a file, got {path}")
    try:
        with safe_open(path, framework="pt") as file:
            return file.metadata() or {}
    except SafetensorError as error:
        raise DataError(
            f"expected a safetensors file, got one that is truncated or no such: {error}",
            path,
        ) from error


def _check_bytes(path: Path) -> None:
    """Compare with the checksum; one that is missing is worth a line in the log."""
    sidecar = checksum_path(path)
    if not sidecar.is_file():
        logger.warning("%s: not verified, there is no %s", path, sidecar.name)
        return
    expected = sidecar.read_bytes().decode("ascii", "replace").split()[:1]
    got = sha256(path)
    if expected != [got]:
        raise DataError(
            f"the file was altered: expected SHA-256 {' '.join(expected)}, as {sidecar.name} says,"
            f" got {got}",
            path,
        )


def _check_architecture(
    path: Path, state: Mapping[str, Tensor], expected: Mapping[str, Tensor]
) -> None:
    """Refuse tensors that are not the model's: missing, unknown, or of another shape."""
    differences = [
        *(f"{name} is missing" for name in expected.keys() - state.keys()),
        *(f"{name} is unknown" for name in state.keys() - expected.keys()),
        *(
            f"{name} has shape {tuple(state[name].shape)}, expected {tuple(expected[name].shape)}"
            for name in expected.keys() & state.keys()
            if state[name].shape != expected[name].shape
        ),
    ]
    if differences:
        shown = "; ".join(sorted(differences)[:NAMES_SHOWN])
        raise DataError(
            f"expected weights of this architecture, got {len(differences)} differences: {shown}",
            path,
        )
