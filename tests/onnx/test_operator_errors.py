"""Nodes and inputs that ``ffpose::SpectralFilter`` cannot take: an error each, and life goes on."""

import os
import random
import subprocess
import sys

import numpy as np
import pytest

from filter_graphs import (
    ERRORS,
    LIBRARY,
    assert_close,
    by_torch,
    filter_graph,
    open_session,
    random_case,
    runtime,
    session_options,
    weight_shape,
)
from onnx import TensorProto, helper

DTYPES = [np.float32, np.float64, np.float16, np.int32, np.int64, np.uint8, np.bool_]


@pytest.mark.parametrize(
    ("layout", "x", "weight", "message"),
    [
        (None, None, (6, 9, 2), "'filter': expected the attribute layout"),
        (3, None, (6, 9, 2), "expected the attribute layout"),
        ("rows", None, (6, 9, 2), 'layout must be "tokens" or "grid", got "rows"'),
        ("tokens", ["n"], (6, 9, 2), r"x must have shape \(\.\.\., X, Y\), got \(\?\)"),
        ("grid", [4, 3], (6, 9, 2), r"x must have shape \(\.\.\., H, W, C\), got \(4, 3\)"),
        ("tokens", ["n", 6, 16], (6, 8, 2), r"= \(6, 9, 2\), got \(6, 8, 2\)"),
        ("tokens", None, (6, 9, 3), r"\(X, Y/2\+1, 2\) = \(\?, \?, 2\), got \(6, 9, 3\)"),
        ("tokens", None, (), r"\(X, Y/2\+1, 2\) = \(\?, \?, 2\), got \(\)"),
        ("grid", None, (6, 9, 2), r"\(H, W/2\+1, C, 2\) = \(\?, \?, \?, 2\), got \(6, 9, 2\)"),
    ],
)
def test_what_a_graph_says_is_checked_when_it_is_loaded(layout, x, weight, message):
    with pytest.raises(ERRORS, match=message):
        open_session(filter_graph(layout, x, np.zeros(weight, np.float32)))


@pytest.mark.parametrize(
    ("layout", "x", "weight", "message"),
    [
        ("tokens", (), (6, 9, 2), r"x must have shape \(\.\.\., X, Y\), got \(\)"),
        ("tokens", (16,), (6, 9, 2), r"x must have shape \(\.\.\., X, Y\), got \(16,\)"),
        ("grid", (4, 3), (6, 9, 5, 2), r"x must have shape \(\.\.\., H, W, C\), got \(4, 3\)"),
        ("tokens", (6, 18), (6, 9, 2), r"weight must have shape \(6, 10, 2\), got \(6, 9, 2\)"),
        ("grid", (6, 16, 4), (6, 9, 5, 2), r"weight must have shape \(6, 9, 4, 2\), got"),
    ],
)
def test_what_a_graph_does_not_say_is_checked_when_it_runs(layout, x, weight, message):
    session = open_session(filter_graph(layout, None, np.zeros(weight, np.float32)))
    with pytest.raises(ERRORS, match=message):
        session.run(None, {"x": np.zeros(x, np.float32)})


def test_element_types_that_do_not_belong_together_are_refused():
    weight = np.zeros((6, 9, 2), np.float32)
    with pytest.raises(ERRORS):
        open_session(filter_graph("tokens", None, weight.astype(np.float64)))
    for kind in (TensorProto.INT64, TensorProto.INT8, TensorProto.BOOL, TensorProto.DOUBLE):
        with pytest.raises(ERRORS):
            open_session(filter_graph("tokens", None, weight, kind=kind))


def test_a_library_that_is_registered_twice_is_an_error():
    options = session_options()
    options.register_custom_ops_library(LIBRARY)
    model = filter_graph("tokens", None, np.zeros((6, 9, 2), np.float32))
    with pytest.raises(ERRORS):
        runtime.InferenceSession(model, options, providers=["CPUExecutionProvider"])
    open_session(model)


def test_an_unknown_isa_is_an_error_of_the_session(tmp_path):
    path = tmp_path / "filter.onnx"
    path.write_bytes(filter_graph("tokens", None, np.zeros((6, 9, 2), np.float32)))
    program = f"""
import onnxruntime
options = onnxruntime.SessionOptions()
options.log_severity_level = 4
options.register_custom_ops_library({LIBRARY!r})
try:
    onnxruntime.InferenceSession({str(path)!r}, options, providers=["CPUExecutionProvider"])
except Exception as error:
    print(error)
"""
    result = subprocess.run(
        [sys.executable, "-c", program],
        env={**os.environ, "FFPOSE_ISA": "abacus"},
        capture_output=True,
        text=True,
        check=True,
    )
    assert "SpectralFilter 'filter': FFPOSE_ISA must be one of" in result.stdout
    assert "abacus" in result.stdout


def a_shape(generator):
    """Return the shape of a small array of up to five axes."""
    return tuple(generator.choices([0, 1, 2, 3, 5, 9, 16], k=generator.randrange(6)))


def a_dtype(generator, others):
    """Return float32, or with a probability of ``others`` any type."""
    return generator.choice(DTYPES) if generator.random() < others else np.float32


def fits(layout, x, weight):
    """Whether shapes belong together, by the conventions' own words."""
    axes = 2 if layout == "tokens" else 3
    return len(x) >= axes and weight == weight_shape(layout, x[-axes:])


def test_any_input_gives_a_result_or_an_error():
    """In 1,000 runs; the sessions are of use after each."""
    generator, errors = random.Random(0), 0
    weight = np.zeros((1, 1, 2), np.float32)
    sessions = {
        layout: open_session(filter_graph(layout, None, weight, constant=False))
        for layout in ("tokens", "grid")
    }
    for _ in range(1000):
        layout = generator.choice(["tokens", "grid"])
        shapes = [a_shape(generator) for _ in range(2)]
        dtypes = [a_dtype(generator, others=0.2) for _ in range(2)]
        x, weight = (np.ones(s, d) for s, d in zip(shapes, dtypes, strict=True))
        if fits(layout, *shapes) and dtypes == [np.float32] * 2:
            assert sessions[layout].run(None, {"x": x, "weight": weight})[0].shape == x.shape
        else:
            errors += 1
            with pytest.raises(ERRORS):
                sessions[layout].run(None, {"x": x, "weight": weight})
        x, weight = random_case(layout, (3, 4) if layout == "tokens" else (3, 4, 2))
        (y,) = sessions[layout].run(None, {"x": x, "weight": weight})
        assert_close(y, by_torch(layout, x, weight))
    assert errors > 900


LAYOUTS = ["tokens", "grid", "", "Tokens", "rows", "tokens\0", "ä" * 300, 1, 0.5, ["tokens"], None]


@pytest.mark.slow
def test_any_node_gives_a_session_or_an_error():
    """Of 1,000 graphs; a good one loads after each."""
    generator, errors = random.Random(1), 0
    good = filter_graph("tokens", None, np.zeros((3, 3, 2), np.float32))
    for _ in range(1000):
        layout = generator.choice(["tokens", "grid", generator.choice(LAYOUTS)])
        x, weight = a_shape(generator), a_shape(generator)
        types = [np.dtype(a_dtype(generator, others=0.2)) for _ in range(2)]
        kind = helper.np_dtype_to_tensor_dtype(types[0])
        values = np.ones(weight, types[1])
        try:
            open_session(filter_graph(layout, list(x) or None, values, kind=kind))
        except ERRORS:
            errors += 1
        else:
            assert layout in ("tokens", "grid")
            assert fits(layout, x, weight) if x else len(weight) == (3, 4)[layout == "grid"]
        open_session(good)
    assert errors > 900
