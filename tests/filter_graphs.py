"""Graphs with one filter, made by hand so that they can be wrong, and what torch.fft says of them.

Importing this module skips the tests that need it where ONNX, its runtime or the library is absent.
"""

from __future__ import annotations

import numpy as np
import pytest
import torch

onnx = pytest.importorskip("onnx")
runtime = pytest.importorskip("onnxruntime")
library = pytest.importorskip("ffpose.onnx.library")

from onnx import TensorProto, helper, numpy_helper  # noqa: E402 - after it is known to be there

try:
    LIBRARY = library.get_library_path()
except FileNotFoundError as error:
    pytest.skip(str(error), allow_module_level=True)

AXES = {"tokens": (-2, -1), "grid": (-3, -2)}

ERRORS = tuple(
    value
    for value in vars(runtime.capi.onnxruntime_pybind11_state).values()
    if isinstance(value, type) and issubclass(value, Exception)
)
"""ONNX Runtime's exceptions, which share no base of their own."""


def weight_shape(layout, size):
    rows, columns, *channels = size
    return (rows, columns // 2 + 1, *channels, 2)


def random_case(layout, size, batch=(), dtype=np.float32):
    generator = np.random.default_rng(len(size) + sum(size))
    x = generator.standard_normal((*batch, *size)).astype(dtype)
    return x, generator.standard_normal(weight_shape(layout, size)).astype(dtype)


def by_torch(layout, x, weight):
    """Filter in float64."""
    axes = AXES[layout]
    if np.size(x) == 0:  # which torch 2.10 refuses
        return np.zeros(np.shape(x))
    x = torch.from_numpy(np.asarray(x, np.float64))
    factors = torch.view_as_complex(torch.from_numpy(np.asarray(weight, np.float64)))
    spectrum = torch.fft.rfft2(x, dim=axes) * factors
    size = [x.shape[axis] for axis in axes]
    return torch.fft.irfft2(spectrum, s=size, dim=axes).numpy()


def assert_close(got, expected, dtype=np.float32):
    """Allow some roundings of the largest number, as the errors of a transform are."""
    assert got.shape == expected.shape
    largest = np.abs(expected).max(initial=0)
    np.testing.assert_allclose(got, expected, rtol=0, atol=16 * np.finfo(dtype).eps * largest)


def filter_node(layout="tokens"):
    """Return ``y = SpectralFilter(x, weight)``; a layout of None gives a node without one."""
    attributes = {} if layout is None else {"layout": layout}
    return helper.make_node(
        "SpectralFilter", ["x", "weight"], ["y"], "filter", domain="ffpose", **attributes
    )


def filter_graph(layout, x_shape, weight, *, kind=TensorProto.FLOAT, constant=True):
    """Return a model of one filter.

    Args:
        layout: Of the filter; anything that an attribute can hold, or None.
        x_shape: As the graph says it; None: nothing is said, not even how many axes there are.
        weight: The array, of which only the element type counts where it is not constant.
        kind: ONNX's type of the elements of x.
        constant: Whether the weight is in the graph, or an input.
    """
    values = numpy_helper.from_array(weight, "weight")
    inputs = [helper.make_tensor_value_info("x", kind, x_shape)]
    if not constant:
        inputs.append(helper.make_tensor_value_info("weight", values.data_type, None))
    outputs = [helper.make_tensor_value_info("y", kind, None)]
    return to_model([filter_node(layout)], inputs, outputs, [values] if constant else [])


def to_model(nodes, inputs, outputs, constants):
    graph = helper.make_graph(nodes, "a filter", inputs, outputs, constants)
    opsets = [helper.make_opsetid("", 18), helper.make_opsetid("ffpose", 1)]
    return helper.make_model(graph, opset_imports=opsets, ir_version=9).SerializeToString()


def session_options(threads=1):
    options = runtime.SessionOptions()
    options.intra_op_num_threads = threads
    options.log_severity_level = 4  # errors are raised, not printed
    options.register_custom_ops_library(LIBRARY)
    return options


def open_session(model, threads=1):
    options = session_options(threads)
    return runtime.InferenceSession(model, options, providers=["CPUExecutionProvider"])
