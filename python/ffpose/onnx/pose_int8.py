"""Quantization of a pose network's graph to int8 (``ffpose export --int8``), and its loss."""

from __future__ import annotations

import hashlib
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ffpose._internal.files import atomic_write, sha256
from ffpose.arrays import rotation_error, translation_error
from ffpose.errors import require
from ffpose.geometry import Pose, poses
from ffpose.imaging.images import read_rgb
from ffpose.imaging.reprojection import expect_aspect, for_images
from ffpose.onnx.backends import open_session
from ffpose.onnx.int8 import quantize
from ffpose.onnx.metadata import ModelMetadata, read_model_metadata, sealed


@dataclass(frozen=True)
class Quantized:
    """An int8 graph, and the differences of its poses from float32's on the calibration images.

    Attributes:
        path: Path of the ONNX file.
        bytes: Size of the file.
        nodes: Number of nodes in int8.
        translation_m: Differences of each image ``(N,)``, meters.
        rotation_deg: Differences of each image ``(N,)``, degrees.
    """

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
    """Write the int8 form of a graph of ``ffpose export``.

    Args:
        graph: The float32 graph.
        path: ONNX file to write; its folder must exist.
        images: Calibration images, typical of the weights' camera.
        say: Called with a line about each step.

    Raises:
        FileNotFoundError: The graph, an image or the operator's library does not exist.
        MissingExtraError: onnx or onnxruntime is not installed.
        ffpose.DataError: The graph was not written by ``ffpose export``, or an image cannot be
            read.
        ValueError: ``images`` is empty, the graph is already int8, or the aspect ratio of an image
            differs from the camera's.
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
    with tempfile.TemporaryDirectory(prefix="ffpose-int8-") as folder:
        say(f"calibrating with {len(images)} images")
        out = Path(folder) / "int8.onnx"
        nodes = quantize(Path(graph), out, metadata.filter, _inputs(metadata, images))
        model = onnx.load(str(out))
    onnx.helper.set_model_props(model, described.to_entries())
    data = sealed(model.SerializeToString())
    with atomic_write(path) as temporary:
        temporary.write_bytes(data)
        say("comparing with float32")
        pairs = list(
            zip(
                _poses(Path(graph), metadata, images),
                _poses(temporary, metadata, images),
                strict=True,
            )
        )
    t, t_hat, q, q_hat = (
        np.array(values) for values in zip(*((a.t, b.t, a.q, b.q) for a, b in pairs), strict=True)
    )
    return Quantized(
        Path(path), len(data), len(nodes), translation_error(t_hat, t), rotation_error(q_hat, q)
    )


def _inputs(metadata: ModelMetadata, images: Sequence[Path]) -> Iterator[NDArray[np.float32]]:
    """Yield the network's input ``(1, 3, h, w)`` for each image of the weights' camera."""
    preprocessing, camera = for_images(
        metadata.preprocessing,
        metadata.config.view_camera,
        metadata.camera,
        undistorted=metadata.undistorted,
    )
    for path in images:
        image = read_rgb(path, metadata.white)
        expect_aspect(camera, *image.size)
        yield preprocessing.array(image)[None]


def _poses(graph: Path, metadata: ModelMetadata, images: Sequence[Path]) -> Iterator[Pose]:
    """Yield the pose that a graph gives for each image."""
    session = open_session(graph, metadata.filter)
    for inputs in _inputs(metadata, images):
        found = session.run(inputs)
        yield from poses(
            **found,
            locates=metadata.locates,
            in_view_threshold=metadata.in_view_threshold,
            degrees_of_freedom=metadata.degrees_of_freedom,
        )
