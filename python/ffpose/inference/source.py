"""What a user names: a shipped network, a weights file, an exported graph, or a folder with one."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path
from typing import Literal, NamedTuple, get_args

from ffpose._internal.zoo import GRAPH, WEIGHTS, resolve
from ffpose.errors import expect, require

Backend = Literal["torch", "onnxruntime", "openvino"]
"""What computes a network: torch, for weights; one of the others, for an exported graph."""

NEEDED_BY_WEIGHTS = ("torch", "safetensors")
TRACK_SUFFIX = ".track.onnx"
"""Ending, in place of ``.onnx``, of a graph that looks once, at points of its second input."""

BEST = "best.safetensors"
"""The weights of a training's folder; beside them are those of its last epoch."""


class Source(NamedTuple):
    """A network's file; weights, if it is no exported graph."""

    path: Path
    is_graph: bool


def find_source(network: str | Path, backend: Backend | None = None) -> Source:
    """Find the file of a network, given a weights file, graph, folder with one, or shipped name.

    A word without folder and suffix is a name of a shipped network, unless a file has that name, or
    a folder with a network. Names and folders stand for weights where torch computes, which it does
    where it is installed and no other backend is named; elsewhere for graphs. In a folder that has
    only one of these that one is taken, and ``best.safetensors`` goes before other weights.

    Raises:
        FileNotFoundError: There is no such file or name, or the folder holds no network.
        MissingExtraError: Weights are named, and the extra `pose` is not installed.
        ValueError: The backend is unknown, or does not compute such a file, or the folder holds
            several networks.
    """
    known = get_args(Backend)
    expect(backend in (None, *known), "backend", f"one of {known}", backend)
    path = Path(network)
    in_torch = backend == "torch" or (backend is None and all(map(find_spec, NEEDED_BY_WEIGHTS)))
    if path.is_dir():
        path = _network_in(path, backend, in_torch=in_torch) or path
    path = resolve(path, WEIGHTS if in_torch else GRAPH)
    if path.suffix.lower() == GRAPH:
        wanted = f"onnxruntime or openvino for the graph {path}"
        expect(backend != "torch", "backend", wanted, backend)
        return Source(path, is_graph=True)
    if backend not in (None, "torch"):
        raise ValueError(
            f"backend: expected torch for the weights {path}, got {backend!r}, which computes what"
            " `ffpose export` makes of them"
        )
    for module in NEEDED_BY_WEIGHTS:
        require(module, "pose")
    return Source(path, is_graph=False)


def _network_in(folder: Path, backend: Backend | None, *, in_torch: bool) -> Path | None:
    """Return the one network in a folder; None where it may be a name instead."""
    weights, graphs = (sorted(folder.glob(f"*{suffix}")) for suffix in (WEIGHTS, GRAPH))
    weights = [path for path in weights if path.name == BEST] or weights
    graphs = [path for path in graphs if not path.name.endswith(TRACK_SUFFIX)]
    if backend is None:
        found = (weights or graphs) if in_torch else (graphs or weights)
    else:
        found = weights if in_torch else graphs
    if not found and len(folder.parts) == 1:
        return None
    if not found:
        raise FileNotFoundError(
            f"expected a folder with weights (*{WEIGHTS}) or a graph (*{GRAPH}), got {folder}"
            + (f" and backend {backend}" if backend else "")
        )
    if len(found) > 1:
        names = ", ".join(path.name for path in found)
        raise ValueError(f"expected a folder with one network, or a file of it, got {names}")
    return found[0]
