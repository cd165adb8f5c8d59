"""Metadata of exported graphs, stored in ``metadata_props`` of the ONNX file.

All entries are strings: ``ffpose_format`` (version of these entries), ``ffpose_version``,
``architecture``, ``quaternion_order``, ``filter``, ``weights_sha256``; and, as JSON, ``config``,
``preprocessing``, ``camera`` (of the training images), ``view_camera`` (of the network's input),
``in_view_threshold`` and ``degrees_of_freedom`` (of the errors of translation and rotation, null
for Gaussian ones). An int8 graph also has ``precision`` and ``calibration_sha256``, the SHA-256
of the concatenated hexadecimal SHA-256s of its calibration images. A graph that locates the camera
in the world has ``locates``, with the value ``camera``. One that takes the point where to look as a
second input, ``point``, has ``takes_point``, with the value ``true``; a graph that was exported
with one has ``track_sha256``, the SHA-256 of its file. ``tracking`` is there where the weights say
what a tracker expects of the network's errors, as JSON.

The last record of the file is the entry ``ffpose_sha256``, the SHA-256 of all bytes before it,
which shows alterations without a second file. ONNX files are protobuf messages, whose records may
come in any order, so every reader accepts such a file; `ffpose.onnx.records` parses just the
records needed here, without a library.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any, Literal, get_args

from ffpose import __version__
from ffpose.config import NetworkConfig, config_type
from ffpose.errors import DataError, expect
from ffpose.geometry import Camera, Target
from ffpose.geometry.symmetry import IDENTITY, SymmetryGroup
from ffpose.imaging.preprocessing import Preprocessing
from ffpose.onnx.records import METADATA_PROPS, expect_self_contained, read_entries

FORMAT = 2
"""Version of the entries; one more whenever older code could not read them rightly."""

QUATERNION_ORDER = "wxyz"
CHECKSUM = "ffpose_sha256"

Filter = Literal["custom", "matmul", "none"]
"""How a graph computes its spectral filters: custom operator, standard operators, or has none."""

Precision = Literal["float32", "int8"]


@dataclass(frozen=True)
class ModelMetadata:
    """Metadata of an exported graph; None where unknown.

    ``camera`` is that of the training images, ``undistorted`` and ``white`` say how they were read,
    ``distortion`` is theirs, where it was not taken out;
    ``weights_sha256`` is of the weights file that was exported, ``calibration_sha256`` of an int8
    graph's calibration images; ``takes_point`` says that the graph looks once, at points that are
    its input ``point``, and ``track_sha256`` is of the file of such a graph that belongs to this
    one. The rest is as in the header of weights.
    """

    config: NetworkConfig
    preprocessing: Preprocessing
    filter: Filter
    camera: Camera | None = None
    in_view_threshold: float | None = None
    weights_sha256: str | None = None
    version: str = __version__
    precision: Precision = "float32"
    calibration_sha256: str | None = None
    locates: Target = "object"
    undistorted: bool = False
    distortion: tuple[float, ...] | None = None
    white: float | str | None = None
    takes_point: bool = False
    track_sha256: str | None = None
    tracking: Mapping[str, float] | None = None
    symmetry: SymmetryGroup = IDENTITY

    def to_entries(self) -> dict[str, str]:
        """Return the entries, without the checksum."""
        view = self.config.view_camera
        decoding: dict[str, Any] = {"undistorted": self.undistorted, "white": self.white}
        if self.distortion is not None:
            decoding["distortion"] = self.distortion
        float32 = self.precision == "float32"
        # JSON has no infinity: a word stands for it.
        tracking = {k: "inf" if v == math.inf else v for k, v in (self.tracking or {}).items()}
        entries = {
            "ffpose_format": str(FORMAT),
            "ffpose_version": self.version,
            "architecture": self.config.architecture,
            "quaternion_order": QUATERNION_ORDER,
            "filter": self.filter,
            "weights_sha256": self.weights_sha256 or "",
            "config": self.config.to_json(),
            "precision": None if float32 else self.precision,
            "calibration_sha256": None if float32 else self.calibration_sha256 or "",
            "locates": None if self.locates == "object" else self.locates,
            "takes_point": "true" if self.takes_point else None,
            "track_sha256": self.track_sha256,
            "tracking": _json(tracking) if tracking else None,
            "symmetry": _json(self.symmetry.to_json()) if self.symmetry.axes else None,
            "decoding": _json(decoding) if any(decoding.values()) else None,
            "preprocessing": _json(self.preprocessing.to_dict()),
            "camera": _json(None if self.camera is None else asdict(self.camera)),
            "view_camera": _json(None if view is None else asdict(view)),
            "in_view_threshold": _json(self.in_view_threshold),
            "degrees_of_freedom": _json(self.config.degrees_of_freedom),
        }
        return {name: value for name, value in entries.items() if value is not None}

    @classmethod
    def from_entries(cls, entries: Mapping[str, str]) -> ModelMetadata:
        """Parse the entries that `to_entries` returns.

        Raises:
            KeyError: An entry is missing.
            ValueError: An entry has an invalid value.
        """
        choices = {
            "quaternion_order": (QUATERNION_ORDER,),
            "filter": get_args(Filter),
            "precision": get_args(Precision),
            "locates": get_args(Target),
        }
        told: dict[str, Any] = {"precision": "float32", "locates": "object", **entries}
        for name, known in choices.items():
            expect(told[name] in known, name, f"one of {known}", told[name])
        camera = json.loads(entries["camera"])
        decoding = json.loads(entries.get("decoding", "{}"))
        if decoding.get("distortion") is not None:
            decoding["distortion"] = tuple(decoding["distortion"])
        return cls(
            config_type(entries["architecture"]).from_json(entries["config"]),
            Preprocessing.from_dict(json.loads(entries["preprocessing"])),
            told["filter"],
            None if camera is None else Camera(**camera),
            json.loads(entries["in_view_threshold"]),
            entries["weights_sha256"] or None,
            entries["ffpose_version"],
            told["precision"],
            entries.get("calibration_sha256") or None,
            told["locates"],
            takes_point=entries.get("takes_point") == "true",
            track_sha256=entries.get("track_sha256"),
            tracking=json.loads(entries.get("tracking", "null")),
            symmetry=SymmetryGroup.from_json(json.loads(entries.get("symmetry", "[]"))),
            **decoding,
        )


def read_model_metadata(path: str | Path) -> ModelMetadata:
    """Read the metadata of an exported graph, as `read_model`."""
    return read_model(path)[0]


def read_model(path: str | Path) -> tuple[ModelMetadata, bytes]:
    """Read an exported graph, once: its metadata, and the bytes whose checksum was verified.

    Raises:
        FileNotFoundError: The file does not exist.
        ffpose.DataError: The file is not an ONNX file, was not written by ``ffpose export``, was
            altered, is newer than this version, or keeps weights in other files.
    """
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"model: expected a file, got {path}")
    data = path.read_bytes()
    try:
        entries = dict(read_entries(data))
    except ValueError as error:
        raise DataError(
            f"expected an ONNX file, got one that is cut short or none: {error}", path
        ) from error
    if "ffpose_format" not in entries:
        raise DataError(
            "expected a graph that `ffpose export` wrote, got one without its metadata", path
        )
    version = entries.get("ffpose_version", "unknown")
    if entries["ffpose_format"] != str(FORMAT):
        raise DataError(
            f"expected a graph of format {FORMAT}, which ffpose {__version__} reads; got format"
            f" {entries['ffpose_format']}, written by ffpose {version}",
            path,
        )
    _check_bytes(data, entries.get(CHECKSUM), path)
    try:
        expect_self_contained(memoryview(data))
    except ValueError as error:
        raise DataError(str(error), path) from error
    try:
        return ModelMetadata.from_entries(entries), data
    except (KeyError, TypeError, ValueError) as error:
        raise DataError(f"expected metadata that ffpose {version} wrote: {error}", path) from error


_json = partial(json.dumps, allow_nan=False)


def sealed(data: bytes) -> bytes:
    """Append the record of its checksum to the bytes of an ONNX file."""
    return data + _checksum_record(hashlib.sha256(data).hexdigest())


def _check_bytes(data: bytes, expected: str | None, path: Path) -> None:
    if expected is None:
        raise DataError("the file was altered: expected its SHA-256 in it, got none", path)
    record = _checksum_record(expected)
    got = hashlib.sha256(data.removesuffix(record)).hexdigest()
    if not data.endswith(record) or got != expected:
        raise DataError(f"the file was altered: expected SHA-256 {expected}, got {got}", path)


def _checksum_record(digest: str) -> bytes:
    """Return the record of ``ffpose_sha256``; all its lengths are below 128, a byte each."""
    key, value = CHECKSUM.encode(), digest.encode()
    entry = bytes([1 << 3 | 2, len(key)]) + key + bytes([2 << 3 | 2, len(value)]) + value
    return bytes([METADATA_PROPS << 3 | 2, len(entry)]) + entry
