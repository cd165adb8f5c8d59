"""Weights files: safetensors with a descriptive header, and their SHA-256 in a file beside.

The header holds what is needed to build the network (architecture, config with the camera,
preprocessing), its provenance (backbone, recipe, training data), the version of ffpose that wrote
it and the version of the format. Reading checks everything: a file that is truncated, altered,
of another format or of another architecture is rejected with the reason.
"""

from __future__ import annotations

import json
import logging
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray
from safetensors import SafetensorError, safe_open
from safetensors.torch import load_file, save
from torch import Tensor, nn

from ffpose import __version__
from ffpose._internal.files import atomic_write, sha256, write_text
from ffpose._internal.zoo import resolve
from ffpose.config import NetworkConfig, config_type
from ffpose.errors import DataError
from ffpose.geometry import Camera, Target
from ffpose.geometry.symmetry import SymmetryGroup
from ffpose.imaging.preprocessing import Preprocessing
from ffpose.models.hub import BackboneSource, check_state

logger = logging.getLogger(__name__)

FORMAT = 4
"""Version of the header, incremented whenever older code could not read it correctly."""

OPTIONAL = ("calibration", "tracking")
ORIGIN = ("backbone_source", "recipe", "data", "in_view_threshold", *OPTIONAL)
"""Fields of `WeightsMetadata` that are JSON values in the header, which may lack the optional."""


@dataclass(frozen=True)
class WeightsMetadata:
    """Header of a weights file; fields that it lacks are None.

    Attributes:
        config: Configuration of the network; its ``camera`` is that of the network's input.
        preprocessing: Conversion from image to network input.
        backbone_source: Initial weights of the backbone: ``name``, ``source`` and ``sha256`` of
            pretrained ones, with the ``revision`` of those of a hub, or ``"none"`` for random ones.
        recipe: Training configuration as a JSON document: loss, optimizer, augmentation, stages,
            seed, steps.
        data: Training data as a JSON document: ``kind``, ``name``, ``count``, ``digest``, and
            ``image_size``, the ``[height, width]`` of the images before preprocessing; ``locates``
            is `locates`, ``mean_pose`` `mean_pose` and ``distortion`` `distortion`.
        in_view_threshold: Images with a lower probability of the object being in view are flagged.
        calibration: What the network was calibrated on, as a JSON document: ``command``,
            ``images``.
        tracking: What a tracker expects of the network's errors: fields of
            `ffpose.tracking.Settings`, such as the angles of their correlation; "inf" for infinity.
        version: Version of ffpose that wrote the file.

    Raises:
        ValueError: ``in_view_threshold`` is not a probability, or ``image_size`` or ``locates`` is
            invalid.
    """

    config: NetworkConfig
    preprocessing: Preprocessing
    backbone_source: BackboneSource | None = None
    recipe: Mapping[str, Any] | None = None
    data: Mapping[str, Any] | None = None
    in_view_threshold: float | None = None
    calibration: Mapping[str, Any] | None = None
    tracking: Mapping[str, float] | None = None
    version: str = __version__

    def __post_init__(self) -> None:
        threshold = self.in_view_threshold
        if threshold is not None and not 0 <= threshold <= 1:
            raise ValueError(f"in_view_threshold: expected a probability, got {threshold}")
        match (self.data or {}).get("image_size", (1, 1)):
            case [int(height), int(width)] if min(height, width) >= 1:
                pass
            case other:
                raise ValueError(f"data: expected image_size [height, width], got {other!r}")
        if self.locates not in get_args(Target):
            raise ValueError(f"data: expected locates object or camera, got {self.locates!r}")

    @property
    def locates(self) -> Target:
        """What the network locates; an object, where ``data`` does not say."""
        target: Target = (self.data or {}).get("locates", "object")
        return target

    @property
    def symmetry(self) -> SymmetryGroup:
        """The rotations that labels of the training were modulo."""
        return SymmetryGroup.from_json((self.recipe or {}).get("symmetry") or [])

    @property
    def mean_pose(self) -> NDArray[np.float64] | None:
        """Mean pose of the training labels ``(7,)``; None if not stored."""
        stored = (self.data or {}).get("mean_pose")
        return None if stored is None else np.asarray(stored, np.float64)

    @property
    def undistorted(self) -> bool:
        """Whether the training images were undistorted (`ffpose.datasets.Decoding`)."""
        return bool(self._data_config.get("undistort", False))

    @property
    def distortion(self) -> tuple[float, ...] | None:
        """Distortion of the training images, where it was not taken out; None for none."""
        stored = (self.data or {}).get("distortion")
        return None if stored is None else tuple(stored)

    @property
    def white(self) -> float | str | None:
        """White level of training images of more than 8 bits (`ffpose.datasets.Decoding`)."""
        white: float | str | None = self._data_config.get("white")
        return white

    @property
    def _data_config(self) -> Mapping[str, Any]:
        config: Mapping[str, Any] = (self.recipe or {}).get("data", {})
        return config

    @property
    def camera(self) -> Camera | None:
        """Camera of the training images; None where the config has no camera.

        Where ``data`` has no image size, it is that of the network's input.
        """
        view = self.config.view_camera
        if view is None:
            return None
        height, width = (self.data or {}).get("image_size", (view.height, view.width))
        return self.preprocessing.image_camera(view, width, height)


def checksum_path(path: str | Path) -> Path:
    """Return the path of a weights file's checksum, which is in the format of ``sha256sum``."""
    return Path(f"{path}.sha256")


def write_weights(path: str | Path, state: Mapping[str, Tensor], metadata: WeightsMetadata) -> None:
    """Write a state dict and its checksum atomically; the same ones are the same bytes.

    Where ``path`` is a link, the file that it names is written, and a checksum beside each.

    Raises:
        TypeError: The metadata cannot be represented in JSON.
        ValueError: The metadata contain a number that is not finite.
    """
    header = _to_header(metadata)
    tensors = {name: tensor.detach().cpu().contiguous() for name, tensor in state.items()}
    _write(path, _in_order(save(tensors, header)))


def copy_weights(weights: Path, path: Path) -> None:
    """Copy a weights file, and write its checksum, atomically as `write_weights`."""
    _write(path, weights.read_bytes())


def _write(path: str | Path, content: bytes) -> None:
    sidecars = {checksum_path(each).resolve() for each in (path, Path(path).resolve())}
    with atomic_write(path) as temporary:
        temporary.write_bytes(content)  # safetensors' own file would deny others to read it
        digest = sha256(temporary)
        # Between the two renames a kill leaves weights without a checksum, never with a wrong one.
        for sidecar in sidecars:
            sidecar.unlink(missing_ok=True)
    for sidecar in sidecars:
        write_text(sidecar, f"{digest}  {sidecar.stem}\n")


def _in_order(content: bytes) -> bytes:
    """Return a safetensors file with its metadata sorted; safetensors writes them in any order."""
    start = 8 + int.from_bytes(content[:8], "little")
    header = json.loads(content[8:start])
    header["__metadata__"] = dict(sorted(header["__metadata__"].items()))
    text = json.dumps(header, ensure_ascii=False, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 8)  # tensors begin at a multiple of 8 bytes
    return len(text).to_bytes(8, "little") + text + content[start:]


def read_metadata(path: str | Path) -> WeightsMetadata:
    """Read the header of a weights file, or of a name, without its tensors.

    Raises:
        FileNotFoundError: ``path`` is neither a file nor a name of shipped weights.
        ffpose.DataError: The file is truncated, not a weights file of ffpose, or of another format.
    """
    path = resolve(path)
    with _safetensors(path), safe_open(path, framework="pt") as file:
        header = file.metadata() or {}
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
        return _from_header(header, version)
    except (KeyError, TypeError, ValueError) as error:
        raise DataError(f"expected a header that ffpose {version} wrote: {error}", path) from error


def _to_header(metadata: WeightsMetadata) -> dict[str, str]:
    """Return the header of format `FORMAT` as strings, as safetensors requires."""
    origin = {name: getattr(metadata, name) for name in ORIGIN}
    return {
        "format": str(FORMAT),
        "ffpose_version": metadata.version,
        "architecture": metadata.config.architecture,
        "config": metadata.config.to_json(),
        "preprocessing": json.dumps(metadata.preprocessing.to_dict()),
        **{name: json.dumps(value, allow_nan=False) for name, value in origin.items()},
    }


def _from_header(header: Mapping[str, str], version: str) -> WeightsMetadata:
    known = [name for name in ORIGIN if name in header or name not in OPTIONAL]
    origin: dict[str, Any] = {name: json.loads(header[name]) for name in known}
    for name in ("backbone_source", "recipe", "data"):
        value = origin[name]
        if not isinstance(value, dict | None) and (name, value) != ("backbone_source", "none"):
            raise ValueError(f"{name}: expected a JSON object, got {value!r}")
    return WeightsMetadata(
        config_type(header["architecture"]).from_json(header["config"]),
        Preprocessing.from_dict(json.loads(header["preprocessing"])),
        **origin,
        version=version,
    )


def load_weights(path: str | Path, model: nn.Module) -> None:
    """Load the tensors of a weights file into a model, in place, after all checks.

    Raises:
        FileNotFoundError: The file does not exist.
        ffpose.DataError: The file is truncated or altered, or its tensors are not the model's.
    """
    path = Path(path)
    with _safetensors(path):
        _check_bytes(path)
        state = load_file(path)
    check_state(state, model.state_dict(), "weights of this architecture", path)
    model.load_state_dict(state)


@contextmanager
def _safetensors(path: Path) -> Iterator[None]:
    """Check that there is a file; what safetensors cannot read in it becomes a `DataError`."""
    if not path.is_file():
        raise FileNotFoundError(f"weights: expected a file, got {path}")
    try:
        yield
    except SafetensorError as error:
        raise DataError(
            f"expected a safetensors file, got one that is truncated or no such: {error}",
            path,
        ) from error


def _check_bytes(path: Path) -> None:
    """Verify the checksum; a missing one is logged."""
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
