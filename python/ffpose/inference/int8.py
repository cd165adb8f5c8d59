"""Quantization of a pose network's graph to int8 (``ffpose export --int8``), and its loss."""

from __future__ import annotations

import hashlib
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ffpose._internal.files import atomic_write, sha256
from ffpose.arrays import rotation_error, translation_error
from ffpose.errors import DataError, require
from ffpose.inference.estimator import PoseEstimator
from ffpose.inference.prediction import camera_beside
from ffpose.onnx.backends import open_session
from ffpose.onnx.int8 import quantize
from ffpose.onnx.metadata import read_model_metadata, sealed


@dataclass(frozen=True)
class Quantized:
    """An int8 graph, and how its poses differ from float32's on each calibration image ``(N,)``."""

    path: Path
    bytes: int
    nodes: int
    translation_m: NDArray[np.floating[Any]]
    rotation_deg: NDArray[np.floating[Any]]

    def lines(self) -> list[str]:
        """Return the differences as text: median and largest."""
        pairs = (("translation", self.translation_m, "m"), ("rotation", self.rotation_deg, "deg"))
        return [
            f"int8 against float32, {what}: median {np.median(values):.3g} {unit}, largest"
            f" {values.max():.3g} {unit}"
            for what, values, unit in pairs
        ]


def quantize_graph(
    graph: str | Path,
    path: str | Path,
    images: Sequence[Path],
    *,
    say: Callable[[str], None] = lambda _: None,
) -> Quantized:
    """Write the int8 form of a graph of ``ffpose export``, calibrated on typical images.

    Images are of the camera of ``camera.json`` beside them, as `ffpose predict` takes them; without
    that file they are as those of the network's training.

    Raises:
        FileNotFoundError: The graph, an image or the operator's library does not exist.
        ValueError: There are no images, some lie beside another camera than others, or the graph is
            already int8.
        ffpose.DataError: The graph was not written by ``ffpose export``, an image is unreadable, or
            its aspect ratio is not the camera's.
    """
    metadata = read_model_metadata(graph)
    if metadata.precision != "float32":
        raise ValueError(f"graph: expected float32, got {metadata.precision}: {graph}")
    if not images:
        raise ValueError("images: expected at least 1, got none")
    digests = "".join(sha256(image) for image in images)
    described = replace(
        metadata,
        precision="int8",
        calibration_sha256=hashlib.sha256(digests.encode()).hexdigest(),
        track_sha256=None,  # its looks are of other bytes
    )
    onnx = require("onnx", "export")
    from ffpose.onnx.exporter import halve

    with _camera_beside_images():
        camera = camera_beside(images)
        read: dict[str, Any] = {"camera": camera}
        if camera is None and metadata.undistorted:
            read = {"camera": metadata.camera, "resize": metadata.camera is None}
        estimator = PoseEstimator(open_session(Path(graph), metadata.filter), metadata, **read)
    with tempfile.TemporaryDirectory(prefix="ffpose-int8-") as folder:
        say(f"calibrating with {len(images)} images")
        out = Path(folder) / "int8.onnx"
        inputs = (_input(estimator, image)[None] for image in images)
        nodes = quantize(Path(graph), out, metadata.filter, inputs)
        intermediate = require("onnx_ir", "export")
        folded = intermediate.load(str(out))
        halve(folded)  # again, as what was half is folded to float32
        model = intermediate.to_proto(folded)
    onnx.helper.set_model_props(model, described.to_entries())
    data = sealed(model.SerializeToString())
    with atomic_write(path) as temporary:
        temporary.write_bytes(data)
        say("comparing with float32")
        quantized = PoseEstimator(open_session(temporary, metadata.filter), metadata, **read)
        found = [[each(image) for image in images] for each in (estimator, quantized)]
    (t, q), (t_hat, q_hat) = (
        map(np.stack, zip(*((pose.t, pose.q) for pose in poses), strict=True)) for poses in found
    )
    return Quantized(
        Path(path), len(data), len(nodes), translation_error(t_hat, t), rotation_error(q_hat, q)
    )


@contextmanager
def _camera_beside_images(image: Path | None = None) -> Iterator[None]:
    """Let an error of the block say which camera is meant, and name the image."""
    try:
        yield
    except DataError:
        raise
    except ValueError as error:
        text = f"{error}; of calibration images it is the camera.json beside them, not an option"
        raise (DataError(text, image) if image else ValueError(text)) from error


def _input(estimator: PoseEstimator, image: Path) -> NDArray[np.float32]:
    """Return what the network sees of an image."""
    with _camera_beside_images(image):
        return estimator.preprocess(image)
