"""Operators on torch tensors, computed by the Rust core on the CPU and by torch.fft elsewhere.

Importing this module registers ``torch.ops.ffpose.spectral_filter``, ``spectral_filter_backward``
and ``normalize_quaternion``. The functions below are the same operators, with less overhead where
neither a gradient nor a graph is needed; all are differentiable to any order. The transforms of
`torch.func` take the functions; of the bare operators only `torch.vmap` does.

A program saved by `torch.export` or AOTInductor refers to the operators by name only: import this
module before loading it.
"""

from ffpose.ops.bridge import arithmetic_dtype
from ffpose.ops.layout import LAYOUTS, Layout, weight_shape
from ffpose.ops.quaternion import normalize_quaternion
from ffpose.ops.spectral import spectral_filter

__all__ = [
    "LAYOUTS",
    "Layout",
    "arithmetic_dtype",
    "normalize_quaternion",
    "spectral_filter",
    "weight_shape",
]
