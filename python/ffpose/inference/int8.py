"""Quantization of a pose network's graph to int8 (``ffpose export --int8``), and its loss."""

from __future__ import annotations

import hashlib
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ffpose._internal.files import atomic_write, sha256
from ffpose.arrays import rotation_error, translation_error
from ffpose.errors import require
from ffpose.inference.estimator import PoseEstimator
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

    Images for a network that was trained on undistorted ones are taken as without distortion.

    Raises:
        FileNotFoundError: The graph, an image or the operator's library does not exist.
        ValueError: There are no images, the graph is already int8, or an image's aspect ratio
            differs from the camera's.
        ffpose.DataError: The graph was not written by ``ffpose export``, or an image is unreadable.
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
    )
    onnx = require("onnx", "export")
    taken = {"camera": metadata.camera, "resize": metadata.camera is None}
    read: dict[str, Any] = taken if metadata.undistorted else {}
    estimator = PoseEstimator(open_session(Path(graph), metadata.filter), metadata, **read)
    with tempfile.TemporaryDirectory(prefix="ffpose-int8-") as folder:
        say(f"calibrating with {len(images)} images")
        out = Path(folder) / "int8.onnx"
        inputs = (estimator.preprocess(image)[None] for image in images)
        nodes = quantize(Path(graph), out, metadata.filter, inputs)
        model = onnx.load(str(out))
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
