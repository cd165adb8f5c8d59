"""``ffpose bench model NETWORK``: latency of a network in torch, ONNX Runtime and OpenVINO.

The contenders of a case take turns in this process, each with its own copy of the network, and
their poses are compared before they are timed. A runtime that is not installed is left out. Other
graphs may take turns with them, such as an older one, or the same in int8.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from importlib.util import find_spec
from itertools import product
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import torch
from rich.console import Console
from rich.table import Table
from safetensors.torch import load_file

from ffpose._internal.info import collect
from ffpose._internal.machine import cores, processor
from ffpose._internal.zoo import resolve
from ffpose.bench.timing import (
    Latency,
    draw_bars,
    expect_place,
    percentiles,
    take_turns,
    timed,
)
from ffpose.config import PRESETS
from ffpose.imaging.preprocessing import Preprocessing
from ffpose.inference.in_torch import torch_threads
from ffpose.inference.load import load
from ffpose.inference.source import Backend
from ffpose.models import build_network, read_metadata
from ffpose.models.weights import write_weights
from ffpose.onnx.backends import OnnxRuntimeSession
from ffpose.onnx.pose_graph import export_weights, pose_differences, random_images

APART = 1e-3
"""Largest difference of float32 poses that counts as rounding: meters, and parts of quaternions."""

BATCHES = (1, 8)


@dataclass(frozen=True)
class Result:
    """Latencies by backend or other graph, and how far the outputs of backends are from torch's."""

    batch: int
    threads: int
    latencies: Mapping[str, Latency]
    differences: Mapping[str, float]


def run(
    network: str,
    as_json: bool = False,
    plot: Path | None = None,
    quick: bool = False,
    *,
    batches: Sequence[int] | None = None,
    threads: Sequence[int] | None = None,
    compare: Sequence[Path] = (),
    **fields: int,
) -> None:
    """Time a network, and print a table, or all latencies as JSON, on standard output.

    Args:
        network: A preset, whose weights are then random, or weights: a file or a name.
        as_json: Print one JSON document in place of the table.
        plot: PNG file to draw.
        quick: Batch 1, one thread, short timings.
        batches: Images a batch; None for 1 and 8.
        threads: Numbers of threads; None for 1, 2 and all.
        compare: Graphs that take turns with it in ONNX Runtime, each named by its file.
        **fields: Fields of the network to change: ``looks`` and ``candidates``.

    Raises:
        FileNotFoundError: No such network, or no folder for the plot.
        MissingExtraError: What the export needs is not installed.
        ValueError: A batch or a number of threads is below one, or a field cannot be changed.
        RuntimeError: A backend computes other poses than torch.
    """
    expect_place(plot)
    for name, values in (("batch", batches), ("threads", threads)):
        if values is not None and min(values, default=0) < 1:
            raise ValueError(f"{name}: expected numbers of at least 1, got {list(values)}")
    counts = threads or ((1,) if quick else sorted({1, min(2, cores()), cores()}))
    with TemporaryDirectory(prefix="ffpose-bench-") as name:
        weights = weights_of(network, Path(name), **fields)
        files = _files(weights, Path(name))
        results = [
            _measure(files, compare, batch, count, 0.5 if quick else 5.0)
            for count, batch in product(counts, batches or ((1,) if quick else BATCHES))
        ]
    if as_json:
        document = {"network": network, "environment": {**collect(), "torch": torch.__version__}}
        print(json.dumps({**document, "results": [asdict(each) for each in results]}, indent=2))
    else:
        Console().print(_table(network, results))
    if plot is not None:
        bars = {
            f"{name}, batch {each.batch}, threads {each.threads}": latency
            for each in results
            for name, latency in each.latencies.items()
        }
        title = f"{network}: ms, p50 (bar) to p99 (line)"
        medians = {name: 1e3 * latency.p50 for name, latency in bars.items()}
        draw_bars(plot, medians, title, [1e3 * latency.p99 for latency in bars.values()])


def weights_of(network: str, folder: Path, **fields: int) -> Path:
    """Return the weights file or name of a network, written to a folder where that is needed.

    Args:
        network: A preset of `ffpose.config.PRESETS`, which gets random weights, or weights.
        folder: Where random or changed weights are written.
        **fields: Fields of the network to change, as in `ffpose.models.load_network`.

    Raises:
        FileNotFoundError: No such network or weights.
        ValueError: A field cannot be changed.
        ffpose.DataError: The weights cannot be used.
    """
    weights = Path(network)
    if network in PRESETS:
        weights = folder / f"{network}.safetensors"
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(0)
            build_network(network, backbone_weights="none").save_pretrained(weights)
    try:
        source = read_metadata(weights)
    except FileNotFoundError as error:
        known = ", ".join(PRESETS)
        raise FileNotFoundError(f"network: expected one of {known}, or weights; {error}") from error
    if fields:
        state = load_file(resolve(weights))
        weights = folder / "changed.safetensors"
        write_weights(weights, state, replace(source, config=source.config.at_inference(fields)))
    return weights


def _files(weights: Path, folder: Path) -> dict[Backend, Path]:
    """Return the file that each installed backend opens."""
    files: dict[Backend, Path] = {"torch": weights}
    if find_spec("onnxruntime") is not None:
        files["onnxruntime"] = folder / "custom.onnx"
        export_weights(weights, files["onnxruntime"])
    if find_spec("openvino") is not None and find_spec("onnxruntime") is not None:
        files["openvino"] = folder / "matmul.onnx"
        export_weights(weights, files["openvino"], "matmul")
    return files


def _measure(
    files: Mapping[Backend, Path], compare: Sequence[Path], batch: int, threads: int, seconds: float
) -> Result:
    with torch_threads(threads):
        estimators = {
            name: load(path, backend=name, threads=threads, device="cpu")
            for name, path in files.items()
        }
        inputs = random_images(estimators["torch"].preprocessing, batch).numpy()
        calls: dict[str, Callable[[], Mapping[str, Any]]] = {
            name: partial(each.run, inputs) for name, each in estimators.items()
        }
        expected = calls["torch"]()
        apart: dict[str, float] = {
            name: max(pose_differences(call(), expected).values()) for name, call in calls.items()
        }
        for name, difference in apart.items():
            if not difference <= APART:
                raise RuntimeError(f"poses by {name} differ from torch's by {difference:.1e}")
        calls |= {graph.name: _call(graph, batch, threads) for graph in compare}
        samples = take_turns({name: timed(call) for name, call in calls.items()}, seconds)
        latencies: dict[str, Latency] = {
            name: percentiles(times) for name, times in samples.items()
        }
    return Result(batch, threads, latencies, apart)


def _call(graph: Path, batch: int, threads: int) -> Callable[[], Mapping[str, Any]]:
    """Return what runs a graph of any version of ffpose in ONNX Runtime, on random images."""
    session = OnnxRuntimeSession(graph, "custom", threads)
    *_, height, width = session.session.get_inputs()[0].shape
    return partial(session.run, random_images(Preprocessing((height, width)), batch).numpy())


def _table(network: str, results: Sequence[Result]) -> Table:
    table = Table(title=f"{network}: milliseconds, {processor()}", title_justify="left")
    for name in ("batch", "threads", "backend"):
        table.add_column(name)
    for name in ("p50", "p95", "p99", "of torch's", "difference"):
        table.add_column(name, justify="right")
    for each in results:
        for name, latency in each.latencies.items():
            table.add_row(
                *(str(each.batch), str(each.threads), name),
                *(f"{1e3 * value:.1f}" for value in (latency.p50, latency.p95, latency.p99)),
                f"{latency.p50 / each.latencies['torch'].p50:.2f}",
                f"{each.differences[name]:.0e}" if name in each.differences else "",
            )
    return table
