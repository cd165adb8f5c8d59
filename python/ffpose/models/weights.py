"""Weights on disk: a safetensors file that knows what it is, and its SHA-256 beside it.

The header holds the config, the preprocessing, the version of ffpose that wrote it and the version
of this format. Reading trusts none of it: a file that is cut short, changed, newer than this code
or of another architecture is refused with the reason.
"""

from __future__ import annotations

import hashlib
import json
import logging
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from safetensors import SafetensorError, safe_open
from safetensors.torch import load_file, save
from torch import Tensor, nn

from ffpose import __version__
from ffpose.errors import DataError
from ffpose.files import atomic_write
from ffpose.models.config import FilterformerPoseConfig
from ffpose.transforms import Preprocessing

logger = logging.getLogger(__name__)

FORMAT = 1
"""Version of the header; one more whenever older code could not read it rightly."""

NAMES_SHOWN = 4


@dataclass(frozen=True)
class WeightsMetadata:
    """What a weights file says about itself.

    Attributes:
        config: Builds the network.
        preprocessing: Turns an image into its input.
        version: Of ffpose that wrote the file.
    """

    config: FilterformerPoseConfig
    preprocessing: Preprocessing
    version: str = __version__


def checksum_path(path: str | Path) -> Path:
    """Return where the checksum of a weights file stands, in the form of ``sha256sum``."""
    return Path(f"{path}.sha256")


def write_weights(path: str | Path, state: Mapping[str, Tensor], metadata: WeightsMetadata) -> None:
    """Write a state dict and its checksum; a process that is killed leaves the old file or the new.

    Args:
        path: The weights file; its folder must exist.
        state: Names and tensors, on any device.
        metadata: Goes to the header.
    """
    header = {
        "format": str(FORMAT),
        "ffpose_version": metadata.version,
        "config": metadata.config.to_json(),
        "preprocessing": json.dumps(metadata.preprocessing.to_dict()),
    }
    tensors = {name: tensor.detach().cpu().contiguous() for name, tensor in state.items()}
    with atomic_write(path) as temporary:
        temporary.write_bytes(save(tensors, header))  # save_file would deny others to read it
        digest = _sha256(temporary)
        # Between the two renames a kill leaves weights without a checksum, never with a wrong one.
        checksum_path(path).unlink(missing_ok=True)
    with atomic_write(checksum_path(path)) as temporary:
        temporary.write_text(f"{digest}  {Path(path).name}\n", encoding="utf-8")


def read_metadata(path: str | Path) -> WeightsMetadata:
    """Read what a weights file says about itself, without its tensors.

    Raises:
        FileNotFoundError: There is no such file.
        ffpose.DataError: It is truncated, no weights file of ffpose, or newer than this version.
    """
    header = _read_header(Path(path))
    if "format" not in header:
        raise DataError("expected weights written by ffpose, got a safetensors file without", path)
    version = header.get("ffpose_version", "unknown")
    if header["format"] != str(FORMAT):
        raise DataError(
            f"expected weights of format {FORMAT}, which ffpose {__version__} reads;"
            f" got format {header['format']}, written by ffpose {version}",
            path,
        )
    try:
        config = FilterformerPoseConfig.from_json(header["config"])
        preprocessing = Preprocessing.from_dict(json.loads(header["preprocessing"]))
    except (KeyError, TypeError, ValueError) as error:
        raise DataError(f"expected a header that ffpose {version} wrote: {error}", path) from error
    return WeightsMetadata(config, preprocessing, version)


def load_weights(path: str | Path, model: nn.Module) -> None:
    """Fill a model with the tensors of a weights file, in place, after every check.

    Raises:
        FileNotFoundError: There is no such file.
        ffpose.DataError: It is truncated or altered, or its tensors are not those of ``model``.
    """
    _read_header(Path(path))
    _check_bytes(Path(path))
    state = load_file(path)
    _check_architecture(Path(path), state, model.state_dict())
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
    got = _sha256(path)
    if expected != [got]:
        raise DataError(
            f"the file was altered: expected SHA-256 {' '.join(expected)}, as {sidecar.name} says,"
            f" got {got}",
            path,
        )


def _sha256(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


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
