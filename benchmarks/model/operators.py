"""Share of each operator in a graph's time, by ONNX Runtime's profiler."""

from __future__ import annotations

import json
from collections import defaultdict
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.model.contenders import Graph
from ffpose.errors import require
from ffpose.onnx.int8 import session_options

RUNS = 20


def operator_shares(
    graph: Graph, images: NDArray[np.float32], folder: Path, threads: int
) -> dict[str, float]:
    """Return the share of each operator in the time of all nodes, largest first.

    Args:
        graph: The graph.
        images: A batch of its input.
        folder: Folder for the profiler's file.
        threads: Number of threads within an image.
    """
    runtime = require("onnxruntime", "export")
    options = session_options(runtime, graph.filter)
    options.intra_op_num_threads = threads
    options.enable_profiling = True
    options.profile_file_prefix = str(folder / graph.path.stem)
    session = runtime.InferenceSession(str(graph.path), options, providers=["CPUExecutionProvider"])
    inputs = {session.get_inputs()[0].name: images}
    for _ in range(RUNS):
        session.run(None, inputs)
    return shares(Path(session.end_profiling()))


def shares(profile: Path) -> dict[str, float]:
    """Return the shares of a profiler's file, without the first run, which allocates memory."""
    events = json.loads(profile.read_text())
    first = min((e for e in events if e["name"] == "model_run"), key=lambda e: int(e["ts"]))
    begin = first["ts"] + first["dur"]
    seconds: dict[str, float] = defaultdict(float)
    for event in events:
        if event["name"].endswith("_kernel_time") and event["ts"] >= begin:
            seconds[event["args"]["op_name"]] += event["dur"]
    total = sum(seconds.values())
    ordered = sorted(seconds.items(), key=lambda item: -item[1])
    return {name: value / total for name, value in ordered}
