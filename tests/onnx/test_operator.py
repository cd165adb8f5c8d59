"""The operator ``ffpose::SpectralFilter`` in ONNX Runtime, against torch.fft in float64."""

import gc
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
import torch

from filter_graphs import (
    LIBRARY,
    assert_close,
    by_torch,
    filter_graph,
    filter_node,
    open_session,
    random_case,
    to_model,
)
from onnx import TensorProto, helper, load_from_string, numpy_helper

TOKENS = [(196, 256), (784, 128), (6, 16), (6, 17), (7, 9), (1, 1), (2, 1), (1, 2), (31, 10)]
GRIDS = [(14, 14, 256), (7, 7, 512), (28, 28, 64), (6, 4, 8), (5, 7, 3), (1, 1, 1), (11, 13, 17)]
SEQUENCES = [(1, 196, 64), (1, 50, 64), (1, 512, 8)]

CASES = [("tokens", size) for size in TOKENS] + [("grid", size) for size in GRIDS + SEQUENCES]


@pytest.mark.parametrize(("layout", "size"), CASES)
@pytest.mark.parametrize("threads", [1, 2])
def test_the_operator_gives_what_torch_gives(layout, size, threads):
    _, weight = random_case(layout, size)
    session = open_session(filter_graph(layout, None, weight), threads)
    for batch in [(), (1,), (3,), (2, 2), (0,)]:
        x, _ = random_case(layout, size, batch)
        (y,) = session.run(None, {"x": x})
        assert y.dtype == np.float32
        assert_close(y, by_torch(layout, x, weight))


@pytest.mark.parametrize(("layout", "size"), [("tokens", (36, 20)), ("grid", (6, 5, 8))])
@pytest.mark.parametrize("constant", [True, False])
def test_a_weight_may_be_constant_or_an_input(layout, size, constant):
    x, weight = random_case(layout, size, (2,))
    session = open_session(filter_graph(layout, None, weight, constant=constant))
    for scale in [1, 2]:
        feeds = {"x": x} if constant else {"x": x, "weight": np.float32(scale) * weight}
        (y,) = session.run(None, feeds)
        assert_close(y, (1 if constant else scale) * by_torch(layout, x, weight))


def test_an_initializer_that_a_caller_may_replace_is_not_kept():
    x, weight = random_case("tokens", (36, 20))
    model = load_from_string(filter_graph("tokens", None, weight))
    model.graph.input.append(helper.make_tensor_value_info("weight", TensorProto.FLOAT, None))
    session = open_session(model.SerializeToString())
    for feeds in [{"x": x}, {"x": x, "weight": np.float32(2) * weight}, {"x": x}]:
        (y,) = session.run(None, feeds)
        assert_close(y, by_torch("tokens", x, feeds.get("weight", weight)))


def test_a_weight_filters_both_widths_that_it_fits():
    """Nine columns of a spectrum are those of 16 columns and of 17."""
    _, weight = random_case("tokens", (6, 16))
    session = open_session(filter_graph("tokens", None, weight))
    for columns in [16, 17, 16, 17]:
        x, _ = random_case("tokens", (6, columns), (2,))
        (y,) = session.run(None, {"x": x})
        assert_close(y, by_torch("tokens", x, weight))


@pytest.mark.parametrize(("layout", "size"), [("tokens", (196, 32)), ("grid", (14, 14, 24))])
def test_float64_is_computed_as_such(layout, size):
    x, weight = random_case(layout, size, (2,), np.float64)
    session = open_session(filter_graph(layout, None, weight, kind=TensorProto.DOUBLE))
    (y,) = session.run(None, {"x": x})
    assert y.dtype == np.float64
    assert_close(y, by_torch(layout, x, weight), np.float64)


@pytest.mark.parametrize(("layout", "size"), [("tokens", (196, 32)), ("grid", (14, 14, 24))])
@pytest.mark.parametrize("half", ["float16", "bfloat16"])
@pytest.mark.parametrize("half_weight", [True, False])
def test_half_precision_is_rounded_once(layout, size, half, half_weight):
    """In a graph that casts from float32 and back."""
    dtype, kind = getattr(torch, half), getattr(TensorProto, half.upper())
    x, weight = (torch.from_numpy(array) for array in random_case(layout, size, (2,)))
    x = x.to(dtype).float().numpy()
    weight = (weight.to(dtype).float() if half_weight else weight).numpy()
    nodes = [
        helper.make_node("Cast", ["x32"], ["x"], to=kind),
        helper.make_node("Cast", ["w32"], ["weight"], to=kind if half_weight else 1),
        filter_node(layout),
        helper.make_node("Cast", ["y"], ["y32"], to=TensorProto.FLOAT),
    ]
    inputs = [helper.make_tensor_value_info("x32", TensorProto.FLOAT, None)]
    outputs = [helper.make_tensor_value_info("y32", TensorProto.FLOAT, None)]
    model = to_model(nodes, inputs, outputs, [numpy_helper.from_array(weight, "w32")])
    (y,) = open_session(model).run(None, {"x32": x})
    exact = by_torch(layout, x, weight)
    # half the distance to the next number of this type, and float32's own error
    bound = torch.finfo(dtype).eps / 2 * np.abs(exact) + 1e-5 * np.abs(exact).max()
    assert (np.abs(y - exact) <= bound).all()
    assert torch.equal(torch.from_numpy(y).to(dtype).float(), torch.from_numpy(y))


def test_the_output_has_the_shape_of_x_and_its_names():
    _, weight = random_case("grid", (6, 4, 8))
    session = open_session(filter_graph("grid", ["batch", 6, 4, 8], weight))
    (y,) = session.get_outputs()
    assert (y.type, y.shape) == ("tensor(float)", ["batch", 6, 4, 8])


@pytest.mark.parametrize("shape", [None, [None, 6, 4, 8]])
def test_nothing_is_inferred_from_what_is_unknown(shape):
    x, weight = random_case("grid", (6, 4, 8), (2,))
    session = open_session(filter_graph("grid", shape, weight))
    assert -1 not in (session.get_outputs()[0].shape or [])
    (y,) = session.run(None, {"x": x})
    assert_close(y, by_torch("grid", x, weight))


@pytest.mark.parametrize(("layout", "size"), [("tokens", (196, 256)), ("grid", (28, 28, 64))])
def test_the_result_does_not_depend_on_threads(layout, size):
    x, weight = random_case(layout, size, (9,))
    model = filter_graph(layout, None, weight)
    results = [open_session(model, threads).run(None, {"x": x})[0] for threads in (1, 2, 3, 8)]
    for result in results[1:]:
        np.testing.assert_array_equal(result, results[0])


def test_one_session_runs_on_several_threads_at_the_same_time():
    _, weight = random_case("grid", (14, 14, 64))
    session = open_session(filter_graph("grid", None, weight), 2)

    def run(batch):
        x, _ = random_case("grid", (14, 14, 64), (batch,))
        (y,) = session.run(None, {"x": x})
        assert_close(y, by_torch("grid", x, weight))

    with ThreadPoolExecutor(4) as threads:
        list(threads.map(run, [1, 2, 3, 4] * 20))


@pytest.mark.slow
def test_sessions_come_and_go():
    x, weight = random_case("tokens", (36, 20))
    model, expected = filter_graph("tokens", None, weight), by_torch("tokens", x, weight)
    for _ in range(4):
        (y,) = open_session(model).run(None, {"x": x})
        assert_close(y, expected)
        gc.collect()


@pytest.mark.skipif(sys.platform != "linux", reason="reads an ELF file")
def test_the_library_has_one_symbol_and_needs_neither_python_nor_a_runtime():
    try:
        result = subprocess.run(["nm", "-D", LIBRARY], capture_output=True, text=True, check=True)
    except FileNotFoundError:
        pytest.skip("nm, of the package binutils, is not installed")
    symbols = [line.split()[-2:] for line in result.stdout.splitlines()]
    assert [name for kind, name in symbols if kind not in "Uwv"] == ["RegisterCustomOps"]
    assert not [name for _, name in symbols if name.startswith(("Py", "_Py", "Ort"))]
