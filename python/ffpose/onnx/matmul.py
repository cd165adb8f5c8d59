"""Replaces ``ffpose::SpectralFilter`` in a graph by standard operators (`ffpose.onnx.matrices`).

Of each filter remain MatMul, Mul, one Transpose, and Reshape, which moves nothing. Filters of one
size share their matrices. The arithmetic is of the weight's dtype, to which x is cast where it has
another.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ffpose.onnx.matrices import FilterMatrices, filter_factors, filter_matrices
from ffpose.onnx.nodes import Nodes, nodes_of
from ffpose.onnx.operators import DOMAIN, SPECTRAL_FILTER
from ffpose.ops.layout import RANK


def replace_filters(model: Any) -> None:
    """Replace every ``ffpose::SpectralFilter`` of an `onnx_ir.Model`, in place.

    Raises:
        ValueError: A filter's weight is computed in the graph, or the size of its input is not
            known.
    """
    for node in nodes_of(model, DOMAIN, SPECTRAL_FILTER):
        _Replacement(model.graph, node).write()
    model.opset_imports.pop(DOMAIN, None)


class _Replacement(Nodes):
    """The nodes that take the place of one filter."""

    def __init__(self, graph: Any, node: Any) -> None:
        super().__init__(graph, node)
        self.layout: str = node.attributes["layout"].as_string()
        self.x, self.weight_value = node.inputs
        self.weight = _constant(self.weight_value)
        self.shape = _sizes(self.x, RANK[self.layout])
        self.dtype, self.kind = self.weight.dtype, self.weight_value.dtype

    def write(self) -> None:
        """Write the nodes, and put them in the filter's place."""
        rows, columns, *channels = self.shape
        matrices = filter_matrices(rows, columns)
        name = f"dft_{self.layout}_{rows}x{columns}"
        half = columns // 2 + 1
        width = math.prod([half, *channels])
        y = self._columns(self._batched(), matrices.columns, f"{name}_columns")
        y = self._rows(y, matrices, width, name)
        y = self.reshape(y, (0, 2, rows, width))
        y = self.op("Transpose", y, perm=[0, 2, 1, 3])  # (B, rows, re/im, columns)
        y = self.reshape(y, (0, rows, 2 * half, *channels))
        y = self._columns(y, matrices.columns_back, f"{name}_columns_back")
        self.replace(self._cast(self._like_x(y), self.x.dtype))
        if not self.weight_value.uses():
            self.graph.initializers.pop(self.weight_value.name)

    def _cast(self, y: Any, dtype: Any) -> Any:
        if self.x.dtype == self.kind:
            return y
        cast = self.op("Cast", y, to=dtype)
        cast.dtype = dtype
        return cast

    def _rows(self, y: Any, matrices: FilterMatrices, columns: int, name: str) -> Any:
        """Write steps 2 to 4, for the spectrum's columns and channels as one axis."""
        n1, n2 = matrices.split
        factors = filter_factors(self.weight, (n1, n2)).reshape(n1, 2, 2 * n2, columns)
        if matrices.outer is not None:
            y = self.reshape(y, (0, 2 * n1, n2 * columns))
            y = self.op("MatMul", self._matrix(matrices.outer, f"{name}_outer"), y)
        y = self.reshape(y, (0, n1, 2 * n2, columns))
        y = self.op("MatMul", self._matrix(matrices.inner, f"{name}_inner"), y)
        y = self.reshape(y, (0, n1, 1, 2 * n2, columns))
        y = self.op("Mul", y, self.constant(factors, f"{self.weight_value.name}_factors"))
        y = self.reshape(y, (0, n1, 4 * n2, columns))
        y = self.op("MatMul", self._matrix(matrices.inner_back, f"{name}_inner_back"), y)
        if matrices.outer_back is not None:
            y = self.reshape(y, (0, 2 * n1, n2 * columns))
            y = self.op("MatMul", self._matrix(matrices.outer_back, f"{name}_outer_back"), y)
        return y

    def _columns(self, y: Any, matrices: NDArray[Any], name: str) -> Any:
        """Write step 1 or 5: from the right, or, of channels that stand last, from the left."""
        if self.layout == "tokens":
            return self.op("MatMul", y, self._matrix(matrices, name))
        left = matrices.swapaxes(-2, -1)
        if left.ndim == 3:
            left = left[:, None]  # (re/im, 1, ...): for every row the same
        return self.op("MatMul", self._matrix(np.ascontiguousarray(left), name), y)

    def _batched(self) -> Any:
        """Return x ``(B, 1, *size)``: an axis for the real and imaginary part to come."""
        x = self._cast(self.x, self.kind)
        if self.x.shape.rank() == 1 + len(self.shape):
            return self.op("Unsqueeze", x, self.integers([1]))
        return self.reshape(x, (-1, 1, *self.shape))

    def _like_x(self, y: Any) -> Any:
        """Give the result ``(B, *size)`` the shape of x."""
        if self.x.shape.rank() == 1 + len(self.shape):
            return y
        shape = self.op("Shape", self.x)
        shape.dtype = self.ir.DataType.INT64
        return self.op("Reshape", y, shape)

    def _matrix(self, values: NDArray[Any], name: str) -> Any:
        return self.constant(values.astype(self.dtype), f"{name}_{self.dtype}")


def _constant(weight: Any) -> NDArray[Any]:
    if weight.const_value is None:
        raise ValueError(
            f"filter matmul: expected a weight that is a parameter, got {weight.name}, which the"
            " graph computes"
        )
    values: NDArray[Any] = weight.const_value.numpy()
    return values


def _sizes(x: Any, rank: int) -> tuple[int, ...]:
    """Return the last dimensions, which the filter transforms or which are its channels."""
    sizes = tuple(x.shape)[-rank:]
    if not all(isinstance(size, int) for size in sizes):
        raise ValueError(f"filter matmul: expected an input of known size, got {x.shape}")
    return sizes
