"""``ffpose bench model NETWORK``: latency of a network in torch, ONNX Runtime and OpenVINO.

Poses are compared before they are timed. A runtime that is not installed is left out. Other graphs
may take turns with them, such as an older one, or the same in int8.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from importlib.util import find_spec
from itertools import product
from pathlib import Path
from tempfile import TemporaryDirectory
from timeit import Timer
from typing import Any

import torch

from ffpose._internal.figures import draw_bars
from ffpose._internal.files import expect_place
from ffpose._internal.machine import cores
from ffpose.bench.output import print_results
from ffpose.bench.timing import take_turns
from ffpose.config import PRESETS
from ffpose.imaging.preprocessing import Preprocessing
from ffpose.inference.in_torch import TorchSession, torch_threads
from ffpose.inference.load import load
from ffpose.models import build_network, open_weights, read_metadata
from ffpose.onnx.backends import OnnxRuntimeSession, Runtime
from ffpose.onnx.exporter import Exported, FilterChoice
from ffpose.onnx.pose_graph import doubt_growth, export_weights, pose_differences, random_images

APART = 1e-3
"""Largest difference of float32 poses that counts as rounding: meters, and parts of quaternions."""

FILTERS: dict[Runtime, FilterChoice] = {"onnxruntime": "custom", "openvino": "matmul"}
Calls = dict[str, Callable[[], Mapping[str, Any]]]


def run(
    network: str,
    as_json: bool,
    plot: Path | None,
    quick: bool,
    batches: Sequence[int] | None,
    threads: Sequence[int] | None,
    compare: Sequence[Path],
    **fields: Any,
) -> None:
    """Time a network, and print a table, or all latencies as JSON, on standard output."""
    expect_place(plot)
    for graph in compare:
        if not graph.is_file():
            raise FileNotFoundError(f"compare: expected an exported graph, got {graph}")
    counts = threads or ([1] if quick else sorted({1, min(2, cores()), cores()}))
    cases = product(counts, batches or ([1] if quick else [1, 8]))
    rows, results = [], []
    with TemporaryDirectory(prefix="ffpose-bench-") as folder:
        weights = weights_of(network, Path(folder))
        graphs = {
            runtime: export_weights(weights, Path(folder, f"{runtime}.onnx"), filter, **fields)
            for runtime, filter in FILTERS.items()
            if find_spec(runtime) and find_spec("onnxruntime")  # which checks any export
        }
        doubt = doubt_growth(read_metadata(weights).config)
        for count, batch in cases:
            with torch_threads(count):
                calls = _backends(weights, graphs, batch, count, **fields)
                apart = _differences(calls, doubt)
                calls |= {_name(graph, compare): _call(graph, batch, count) for graph in compare}
                timers = {name: Timer(call) for name, call in calls.items()}
                found = take_turns(timers, 0.5 if quick else 5.0)
            about = {"batch": batch, "threads": count}
            results.append({**about, "latencies": found, "differences": apart})
            for name, latency in found.items():
                times = {key: 1e3 * getattr(latency, key) for key in ("p50", "p95", "p99")}
                ratio = {"of torch's": latency.p50 / found["torch"].p50}
                difference = f"{apart[name]:.0e}" if name in apart else ""
                rows.append({**about, "backend": name, **times, **ratio, "difference": difference})
    print_results(f"{network}: milliseconds", rows, as_json, network=network, results=results)
    if plot is not None:
        draw_bars(plot, f"{network}: ms, p50 (bar) to p99 (line)", rows, 3, "p50", "p99")


def _name(graph: Path, compared: Sequence[Path]) -> str:
    """Return the name of a file, or its path where another has the same name."""
    alone = [each.name for each in compared].count(graph.name) == 1
    return graph.name if alone else str(graph)


def weights_of(network: str, folder: Path) -> Path:
    """Return the weights of a network: of a preset random ones, which are written to a folder."""
    if network not in PRESETS:
        return Path(network)
    torch.manual_seed(0)
    weights = folder / f"{network}.safetensors"
    build_network(network, backbone_weights="none").save_pretrained(weights)
    return weights


def _backends(
    weights: Path, graphs: Mapping[Runtime, Exported], batch: int, threads: int, **fields: Any
) -> Calls:
    model, source = open_weights(weights, **fields)
    images = random_images(source.preprocessing, batch).numpy()
    calls: Calls = {"torch": partial(TorchSession(model, "cpu", threads).run, images)}
    for runtime, graph in graphs.items():
        calls[runtime] = partial(load(graph.path, backend=runtime, threads=threads).run, images)
    return calls


def _differences(calls: Calls, doubt_sigma: tuple[float, float]) -> dict[str, float]:
    torchs = calls["torch"]()
    apart = {
        name: max(pose_differences(call(), torchs, doubt_sigma).values())
        for name, call in calls.items()
    }
    for name, difference in apart.items():
        if not difference <= APART:
            raise RuntimeError(f"poses by {name} differ from torch's by {difference:.1e}")
    return apart


def _call(graph: Path, batch: int, threads: int) -> Callable[[], Mapping[str, Any]]:
    """Return what runs a graph of any version of ffpose in ONNX Runtime, on random images."""
    session = OnnxRuntimeSession(graph, "custom", threads)
    *_, height, width = session.session.get_inputs()[0].shape
    return partial(session.run, random_images(Preprocessing((height, width)), batch).numpy())
