"""The door to pose estimation: one function for weights and graphs."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ffpose.errors import DataError, expect, require
from ffpose.geometry import Camera
from ffpose.inference.source import TRACK_SUFFIX, Backend, find_source

if TYPE_CHECKING:
    from ffpose.inference.estimator import Description, PoseEstimator
    from ffpose.onnx.backends import Precision, Session
    from ffpose.onnx.metadata import ModelMetadata


def load(
    network: str | Path,
    *,
    backend: Backend | None = None,
    threads: int | None = None,
    camera: Camera | None = None,
    resize: bool = False,
    white: float | str | None = None,
    device: str = "auto",
    precision: Precision = "float32",
    providers: Sequence[str] | None = None,
    track: bool = False,
    warm_up: int = 1,
) -> PoseEstimator:
    """Open a network, which then gives the pose of the spacecraft in an image.

    Args:
        network: Weights file, exported graph (``.onnx``), a folder that holds one, or a name of a
            shipped network such as ``"soyuz"``, of which there are both
            (`ffpose.inference.source.find_source`).
        backend: ``"torch"`` for weights; ``"onnxruntime"`` or ``"openvino"`` for a graph, which
            need no torch. None: what the file is for, of the runtimes the first that is installed;
            of a name torch, where it is installed.
        threads: Number of threads within an image, on the CPU; None for the backend's default. In
            torch it is 1 in a process forked from one that had loaded a network in torch, with a
            `RuntimeWarning` where more are asked for.
        camera: Camera of the images, which are reprojected to the network's view if it is another
            than that of training; None for that of training: no ``camera.json`` is looked for.
        resize: Resize any image to the network's input, as if taken by the camera of training.
        white: White level of files of monochrome images of more than 8 bits, 4095 for 12 bits, or
            the percentile of each image's own levels that is white, such as ``"p99.5"``; None for
            that of training, without which they are refused.
        device: Of torch: ``"auto"`` (a GPU if there is one) or a device that torch knows. Graphs
            run on the CPU.
        precision: Of a graph: ``"float32"``, or ``"bfloat16"`` where backend and CPU support it.
        providers: ONNX Runtime's execution providers; None for the CPU's.
        track: Open the network's single look at a point too (`PoseEstimator.run` with points) where
            there is one: in weights of a PolarPose, or in ``X.track.onnx`` beside a graph
            ``X.onnx``, which must be there if that was exported with ``--track``.
        warm_up: Number of runs on a black image, which allocate memory and plan, so that the first
            real image is not slowed by a cold start.

    Returns:
        An estimator: call it on an image or a list of them (`PoseEstimator.__call__`).

    Raises:
        FileNotFoundError: There is no such file or name, or the custom operator's library, or
            ``X.track.onnx`` as above, is missing.
        MissingExtraError: The backend is not installed.
        ffpose.DataError: The file was not written by ffpose, was altered, or is newer than this
            version.
        ValueError: The backend or this CPU cannot do what is asked for, a folder holds several
            networks, or both ``camera`` and ``resize`` are given, or neither for a network that was
            trained on undistorted images; or ``white`` is no level.
        TypeError: ``camera`` is no `Camera`, as the path of its file.
        RuntimeError: The runtime cannot load the graph or the library.

    Examples:
        ``ffpose.load("soyuz")("image.png").t``
    """
    if camera is not None and not isinstance(camera, Camera):
        got = type(camera).__name__
        raise TypeError(f"camera: expected a Camera, got {got}; Camera.read reads a file")
    source = find_source(network, backend)
    require("PIL.Image", "onnx")
    from ffpose.inference.estimator import PoseEstimator

    session: Session
    near: Session | None = None
    metadata: Description
    if source.is_graph:
        kinds = "auto or cpu for an exported graph"
        expect(device in ("auto", "cpu"), "device", kinds, device)
        if backend is None and find_spec("onnxruntime") is None and find_spec("openvino"):
            backend = "openvino"
        open_one = partial(
            _open_graph,
            backend=backend or "onnxruntime",
            threads=threads,
            providers=providers,
            precision=precision,
        )
        session, metadata = open_one(source.path)
        beside = source.path.with_suffix(TRACK_SUFFIX)
        if track and beside.is_file():
            near, _ = open_one(beside, metadata)
        elif track and metadata.track_sha256 is not None:
            raise FileNotFoundError(
                f"network: expected {beside}, a track's looks that {source.path} was exported with,"
                " got none: copy it too, export without --track, or track with --whole"
            )
    else:
        from ffpose.inference.in_torch import TorchSession
        from ffpose.models import PolarPose, open_weights
        from ffpose.models.polar_pose import NearPoint

        expect(precision == "float32", "precision", "float32 for weights", precision)
        if providers is not None:
            raise ValueError(f"providers: expected with a graph, got {providers} with weights")
        model, metadata = open_weights(source.path)
        session = TorchSession(model, device, threads)
        if track and isinstance(model, PolarPose):
            near = TorchSession(NearPoint(model), device, threads)
    estimator = PoseEstimator(
        session, metadata, near=near, camera=camera, resize=resize, white=white
    )
    estimator.warm_up(warm_up)
    return estimator


def _open_graph(
    path: Path, whole: ModelMetadata | None = None, **options: Any
) -> tuple[Session, ModelMetadata]:
    """Open a graph of whole frames, or that of the single looks beside one."""
    from ffpose.onnx.backends import open_session
    from ffpose.onnx.metadata import read_model

    graph, data = read_model(path)
    if whole is None and graph.takes_point:
        single = "one of single looks, which `track` opens beside it"
        raise DataError(f"expected a graph of whole frames, got {single}", path)
    if whole is not None:
        name = path.name.removesuffix(TRACK_SUFFIX) + ".onnx"
        got = hashlib.sha256(data).hexdigest()
        if whole.track_sha256 not in (None, got):
            raise DataError(f"expected SHA-256 {whole.track_sha256} (of {name}), got {got}", path)
        same = graph.weights_sha256 is not None and graph.weights_sha256 == whole.weights_sha256
        if not graph.takes_point or not same:
            raise DataError(f"expected the single looks of the weights of {name}", path)
    return open_session(path, graph.filter, data=data, **options), graph
