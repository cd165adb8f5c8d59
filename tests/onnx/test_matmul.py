"""Filters as products with real matrices: the graph in ONNX Runtime against NumPy's FFT."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ffpose.onnx.matmul import replace_filters
from ffpose.onnx.matrices import best_split

onnx = pytest.importorskip("onnx")
ir = pytest.importorskip("onnx_ir")
runtime = pytest.importorskip("onnxruntime")

PLANE = {"tokens": (-2, -1), "grid": (-3, -2)}
SIZES = {
    "tokens": [(1, 1), (7, 8), (6, 5), (196, 12), (62, 3)],
    "grid": [(1, 50, 3), (7, 7, 4), (14, 14, 5), (28, 28, 2), (5, 6, 1)],
}
CASES = [(layout, size) for layout, sizes in SIZES.items() for size in sizes]


def value(name, shape):
    return onnx.helper.make_tensor_value_info(name, onnx.TensorProto.FLOAT, shape)


def draw_weight(size, seed=0):
    rows, columns, *channels = size
    shape = (rows, columns // 2 + 1, *channels, 2)
    return np.random.default_rng(seed).standard_normal(shape).astype(np.float32)


def filter_graph(layout, size, weights, lead=("batch",)):
    """One filter after the other; `lead` are the dimensions before those of the filter."""
    names = ["x", "y", *(f"y_{n}" for n in range(1, len(weights)))]  # as torch counts them
    nodes = [
        onnx.helper.make_node(
            "SpectralFilter", [names[n], f"w{n}"], [names[n + 1]], domain="ffpose", layout=layout
        )
        for n in range(len(weights))
    ]
    first, *between, last = (value(name, [*lead, *size]) for name in names)
    tensors = [onnx.numpy_helper.from_array(w, f"w{n}") for n, w in enumerate(weights)]
    graph = onnx.helper.make_graph(nodes, "g", [first], [last], tensors, value_info=between)
    opsets = [onnx.helper.make_opsetid("", 18), onnx.helper.make_opsetid("ffpose", 1)]
    return ir.from_proto(onnx.helper.make_model(graph, opset_imports=opsets, ir_version=10))


def run(model, x):
    options = runtime.SessionOptions()
    options.intra_op_num_threads = 1
    data = ir.to_proto(model).SerializeToString()
    session = runtime.InferenceSession(data, options, providers=["CPUExecutionProvider"])
    return session.run(None, {"x": x})[0]


def by_fft(x, weight, layout):
    axes = PLANE[layout]
    spectrum = np.fft.rfft2(x.astype(np.float64), axes=axes) * (
        weight[..., 0] + 1j * weight[..., 1]
    )
    return np.fft.irfft2(spectrum, s=[x.shape[axis] for axis in axes], axes=axes)


@pytest.mark.parametrize(("layout", "size"), CASES)
def test_the_matrices_filter_as_the_fft_does(layout, size):
    weight = draw_weight(size)  # of no symmetry: irfft2 takes the Hermitian part
    x = np.random.default_rng(1).standard_normal((3, *size)).astype(np.float32)
    model = filter_graph(layout, size, [weight])
    replace_filters(model)
    expected = by_fft(x, weight, layout)
    np.testing.assert_allclose(run(model, x), expected, rtol=0, atol=3e-6 * np.abs(expected).max())


@pytest.mark.parametrize(("lead", "shape"), [((), ()), ((2, "batch"), (2, 3)), (("batch",), (0,))])
def test_leading_dimensions_are_kept(lead, shape):
    weight = draw_weight((6, 5))
    if 0 in shape and tuple(map(int, runtime.__version__.split(".")[:2])) < (1, 32):
        pytest.skip("ONNX Runtime before 1.32 multiplies no empty batch by a matrix on its left")
    x = np.random.default_rng(1).standard_normal((*shape, 6, 5)).astype(np.float32)
    model = filter_graph("tokens", (6, 5), [weight], lead)
    replace_filters(model)
    np.testing.assert_allclose(run(model, x), by_fft(x, weight, "tokens"), rtol=0, atol=1e-5)


@pytest.mark.parametrize(("layout", "size"), [("tokens", (784, 4)), ("grid", (14, 14, 2))])
def test_standard_operators_and_one_transpose_remain(layout, size):
    model = filter_graph(layout, size, [draw_weight(size)])
    replace_filters(model)
    onnx.checker.check_model(ir.to_proto(model), full_check=True)
    assert set(model.opset_imports) == {""}
    kinds = [node.op_type for node in model.graph]
    assert set(kinds) == {"Unsqueeze", "MatMul", "Mul", "Reshape", "Transpose"}
    assert kinds.count("Transpose") == 1


def test_filters_of_one_size_share_their_matrices():
    weights = [draw_weight((7, 8), seed) for seed in range(3)]
    alone, together = (filter_graph("tokens", (7, 8), w) for w in (weights[:1], weights))
    replace_filters(alone)
    replace_filters(together)
    assert len(together.graph.initializers) == len(alone.graph.initializers) + 2  # two weights more
    x = np.random.default_rng(1).standard_normal((2, 7, 8)).astype(np.float32)
    expected = x
    for weight in weights:
        expected = by_fft(expected, weight, "tokens")
    np.testing.assert_allclose(
        run(together, x), expected, rtol=0, atol=3e-6 * np.abs(expected).max()
    )


def test_a_size_that_is_not_known_is_refused():
    model = filter_graph("tokens", ("rows", 8), [draw_weight((7, 8))])
    with pytest.raises(ValueError, match=r"expected an input of known size, got .*rows"):
        replace_filters(model)


def test_a_weight_that_is_an_input_is_refused():
    model = filter_graph("tokens", (7, 8), [draw_weight((7, 8))])
    weight = model.graph.initializers.pop("w0")
    weight.const_value = None
    model.graph.inputs.append(weight)
    with pytest.raises(ValueError, match="expected a weight that is a parameter, got w0"):
        replace_filters(model)


@given(st.integers(1, 1000))
def test_a_split_multiplies_to_the_rows(rows):
    assert math.prod(best_split(rows)) == rows


def test_784_tokens_are_transformed_as_28_by_28():
    assert best_split(784) == (28, 28)
    assert best_split(7) == (1, 7)
    assert 1 in best_split(197)  # prime
