"""The graphs that are compared: one network, with its filters computed in different ways."""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, get_args

from torch import Tensor, nn

from ffpose.bench.filter.rivals import torch_filter
from ffpose.errors import require
from ffpose.nn import GlobalFilter, SpectralFilter
from ffpose.onnx.exporter import record, serialized
from ffpose.onnx.matmul import filters_of
from ffpose.onnx.metadata import Filter

GraphKind = Literal["custom", "matmul", "dft", "without"]
"""``"custom"`` and ``"matmul"`` are `ffpose.onnx.export`'s; ``"dft"`` is what torch's own exporter
makes of ``torch.fft``; ``"without"`` has its filters left out, and computes something else."""

GRAPH_KINDS: tuple[GraphKind, ...] = get_args(GraphKind)


@dataclass(frozen=True)
class Graph:
    """An ONNX file, and how it computes spectral filters."""

    path: Path
    filter: Filter


class TorchFftFilter(nn.Module):
    """A filter in ``torch.fft``, with the weight of one of ours.

    Args:
        filter: The filter whose place it takes.
    """

    def __init__(self, filter: SpectralFilter | GlobalFilter) -> None:
        super().__init__()
        self.grid: tuple[int, int] | None = None
        if isinstance(filter, GlobalFilter):
            self.weight, self.grid = filter.complex_weight, (filter.h, filter.h)
        else:
            self.weight = filter.weight
        layout = "grid" if isinstance(filter, GlobalFilter) else filter.layout
        self.compute = torch_filter(layout)

    def forward(self, x: Tensor) -> Tensor:
        """Return the filtered ``x``, of its shape."""
        if self.grid is None:
            return self.compute(x, self.weight)
        return self.compute(x.reshape(x.shape[0], *self.grid, x.shape[-1]), self.weight).flatten(
            1, 2
        )


def with_torch_fft(model: nn.Module) -> nn.Module:
    """Return a copy of ``model`` whose spectral filters are in ``torch.fft``."""
    model = copy.deepcopy(model)
    for parent in list(model.modules()):
        for name, child in parent.named_children():
            if isinstance(child, SpectralFilter | GlobalFilter):
                setattr(parent, name, TorchFftFilter(child))
    return model


def write_graphs(
    model: nn.Module,
    images: Tensor,
    folder: Path,
    kinds: Sequence[GraphKind],
    *,
    entries: Callable[[Filter], Mapping[str, str]] = lambda _: {},
    output_names: Sequence[str] | None = None,
) -> dict[GraphKind, Graph]:
    """Write the graphs of a network, recorded once but for ``"dft"``.

    Args:
        model: In evaluation mode.
        images: A batch of more than one, to record with.
        folder: Where the files are written.
        kinds: Of the graphs.
        entries: Gives a file's metadata, for how the graph computes its filters.
        output_names: Of the graph's outputs, in order.
    """
    ir = require("onnx_ir", "export")
    recorded = ir.to_proto(record(model, (images,), output_names=output_names))
    graphs = {}
    for kind in kinds:
        if kind == "dft":
            graph = record(with_torch_fft(model), (images,), output_names=output_names)
        else:
            graph = ir.from_proto(recorded)
        if kind == "without":
            leave_out_filters(graph)
        data, filter = serialized(graph, "matmul" if kind == "matmul" else "custom", entries)
        path = folder / f"{kind}.onnx"
        path.write_bytes(data)
        graphs[kind] = Graph(path, filter)
    return graphs


def leave_out_filters(model: Any) -> None:
    """Put Identity in the place of every filter of an `onnx_ir.Model`."""
    ir = require("onnx_ir", "export")
    for node in filters_of(model):
        x, weight = node.inputs
        identity = ir.node("Identity", [x])
        output = identity.outputs[0]
        output.name, output.dtype = f"{node.outputs[0].name}/unfiltered", node.outputs[0].dtype
        ir.convenience.replace_nodes_and_values(
            model.graph, node, [node], [identity], node.outputs, [output]
        )
        if not weight.uses():
            model.graph.initializers.pop(weight.name)
