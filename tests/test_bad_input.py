"""Malformed arguments of every kind meet a documented exception, and nothing else."""

import contextlib
import inspect

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import ffpose
from ffpose import _rust, arrays

X = np.ones((2, 3, 4), np.float32)
W = np.ones((3, 3, 2), np.float32)
Q = np.ones((2, 4))
T = np.ones((2, 3))

FUNCTIONS = [
    *(getattr(_rust, name) for name in _rust.__all__ if inspect.isbuiltin(getattr(_rust, name))),
    *(
        function
        for name, function in inspect.getmembers(arrays, inspect.isfunction)
        if function.__module__ == arrays.__name__ and not name.startswith("_")
    ),
]
GOOD = {
    "x": X,
    "y": X,
    "grad": X,
    "grad_x": X,
    "grad_weight": W,
    "weight": W,
    "layout": "tokens",
    "num_threads": 1,
    "out": None,
    "need_x": True,
    "need_weight": True,
    "q": Q,
    "q_hat": Q,
    "t": T,
    "t_hat": T,
    "rpy": T,
    "points": np.ones((3, 2), np.float32),
    "heights": np.ones(2, np.float32),
    "rays": np.ones((3, 2), np.float32),
    "nadir": (0.0, 1.0, 0.0),
    "altitude": 400.0,
    "sun": (1.0, 0.0, 0.0),
    "ground": np.eye(3).tolist(),
    "detail": 3,
    "pixel_angle": 1e-3,
    "texels": np.ones((3, 4), np.float16),
    "sides": (2, 1),
    "wrap": (0, 1),
    "corners": np.zeros((2, 3, 2), np.float32),
    "means": np.ones((2, 4), np.float16),
    "face": np.ones(2, np.int32),
    "weights": np.ones((3, 2), np.float32),
    "levels": np.ones(2, np.float32),
    "shares": np.ones(2, np.float32),
}


def shade_earth(**bad):
    names = inspect.signature(arrays.shade_earth).parameters
    return arrays.shade_earth(**{name: GOOD[name] for name in names} | bad)


def misaligned(array):
    if array.dtype.hasobject or not array.nbytes:
        return array
    raw = np.zeros(array.nbytes + 1, np.uint8)[1:]
    return raw.view(array.dtype).reshape(array.shape)


SPOILERS = [
    lambda array: array,
    lambda array: array.T,
    lambda array: array[..., ::-1] if array.ndim else array,
    lambda array: np.broadcast_to(array, (2, *array.shape)),
    np.ma.masked_array,
    misaligned,
]
DTYPES = ["f4", "f8", "f2", ">f4", ">f8", "g", "i4", "c16", "?", "O", "S3", "M8[s]"]
SHAPES = [(), (4,), (2, 4), (2, 3), (2, 3, 4), (3, 3, 2), (1,) * 40, (0, 4), (2**40, 0, 4), (0, 3)]


@st.composite
def any_arrays(draw):
    shape = draw(st.one_of(st.sampled_from(SHAPES), st.lists(st.integers(0, 5), max_size=5)))
    array = np.zeros(shape, draw(st.sampled_from(DTYPES)))
    if array.dtype.kind == "f":
        array.fill(draw(st.sampled_from([0.0, 1.0, np.nan, np.inf, -1e4])))
    return draw(st.sampled_from(SPOILERS))(array)


ODDITIES = [None, "Grid", "\ud800", b"grid", 0, 1, 3, -1, 2**70, 1.5, True, object, {}, []]
LISTS = [[[1.0, 2.0], [3.0]], [[1.0, 2.0, 3.0, 4.0]], [None], [1, 2, 3, 4], ["a"], (np.nan,) * 4]
anything = st.one_of(any_arrays(), any_arrays(), st.sampled_from(ODDITIES), st.sampled_from(LISTS))


@pytest.mark.slow
@pytest.mark.parametrize("function", FUNCTIONS, ids=lambda f: f"{f.__module__}.{f.__name__}")
@settings(max_examples=100, deadline=None)
@given(data=st.data())
def test_any_arguments_meet_documented_exceptions(function, data):
    names = list(inspect.signature(function).parameters)
    bad = data.draw(st.dictionaries(st.sampled_from(names), anything)) if names else {}
    # The last of an empty array whose other sides are beyond any memory (`_rust.pyi`).
    with contextlib.suppress(TypeError, ValueError, MemoryError):
        function(**{name: GOOD[name] for name in names} | bad)


def sample_texture(**bad):
    names = inspect.signature(arrays.sample_texture).parameters
    return arrays.sample_texture(**{name: GOOD[name] for name in names} | bad)


def test_the_wrong_number_of_arguments_is_refused():
    for function in FUNCTIONS:
        with pytest.raises(TypeError):
            function(*[X] * 10)


@pytest.mark.parametrize(
    ("call", "kind", "message"),
    [
        (lambda: ffpose.spectral_filter(X, W[..., 0] * 1j), TypeError, r"weight.*real.*complex64"),
        (lambda: ffpose.spectral_filter(X, W[:2]), ValueError, r"weight.*\(3, 3, 2\).*\(2, 3, 2\)"),
        (lambda: ffpose.spectral_filter(X[0, 0], W), ValueError, r"x.*\(\.\.\., X, Y\).*\(4,\)"),
        (lambda: ffpose.spectral_filter(X, W, "Grid"), ValueError, '"tokens".*"grid".*"Grid"'),
        (lambda: ffpose.spectral_filter(X, W, num_threads=0), ValueError, "num_threads.*1.*0"),
        (lambda: ffpose.spectral_filter(X, W, num_threads=2**80), ValueError, f"{2**80}"),
        (lambda: ffpose.spectral_filter(X, W, num_threads=1.5), TypeError, "num_threads"),
        (lambda: ffpose.spectral_filter(X, np.ones(W.shape)), TypeError, "weight.*32.*float64"),
        (lambda: ffpose.spectral_filter(X.astype("f2"), W), TypeError, "x.*64, got float16"),
        (lambda: ffpose.spectral_filter(X.astype(">f4"), W), TypeError, "x.*64, got >f4"),
        (lambda: ffpose.normalize_quaternion([1, 2, 3, 4]), TypeError, "q.*64, got int64"),
        (lambda: ffpose.normalize_quaternion(Q * [[1], [0]]), ValueError, "q.*norm.*row 1"),
        (lambda: ffpose.normalize_quaternion(T), ValueError, r"q.*\(\.\.\., 4\).*\(2, 3\)"),
        (lambda: ffpose.normalize_quaternion(np.ma.array(Q)), TypeError, "q.*mask"),
        (lambda: ffpose.rotation_error(Q * np.nan, Q), ValueError, "q_hat.*finite.*NaN.*row 0"),
        (lambda: ffpose.rotation_error(Q, Q[:1]), ValueError, r"q must.*\(2, 4\).*\(1, 4\)"),
        (lambda: ffpose.translation_error(T[0], T[0]), ValueError, r"t_hat.*\(N, 3\).*\(3,\)"),
        (
            lambda: shade_earth(nadir=np.zeros(3, "c8")),
            TypeError,
            "(?s)real numbers, got .*j.*nadir",
        ),
        (
            lambda: shade_earth(altitude=np.complex64(1)),
            TypeError,
            "(?s)real numbers, got .1.*altitude",
        ),
        (lambda: shade_earth(detail=-1), ValueError, r"(?s)detail must be in 0…16, got -1"),
        (lambda: shade_earth(detail=2**80), ValueError, f"detail must be in 0…16, got {2**80}"),
        (
            lambda: shade_earth(ground=[[1j] * 3] * 3),
            TypeError,
            "(?s)real numbers, got .*1j.*ground",
        ),
        (
            lambda: shade_earth(rays=np.where(np.eye(3, 5), np.nan, 1).astype(np.float32)),
            ValueError,
            r"rays must be finite, got \[NaN, 1.0, 1.0\] in column 0",
        ),
        (
            lambda: shade_earth(sun=(0.0, np.inf, 0.0)),
            ValueError,
            r"sun.*finite.*\[0.0, inf, 0.0\]",
        ),
        (lambda: shade_earth(altitude=0.0), ValueError, r"altitude.*above zero, got \[0.0\]"),
        (lambda: sample_texture(sides=(2, 3)), ValueError, "sides.*powers of two.*16384, got 3"),
        (lambda: sample_texture(wrap=(0, 3)), ValueError, "wrap must be 0 .*, got 3"),
        (lambda: sample_texture(texels=T), TypeError, "texels must be float16, got float64"),
        (
            lambda: sample_texture(means=T.astype("f2")),
            ValueError,
            r"means.*\(2, 4\), got \(2, 3\)",
        ),
        (
            lambda: sample_texture(face=np.int32([1, 2])),
            ValueError,
            r"face.*got \[2.0\] in column 1",
        ),
        (lambda: _rust.spectral_filter(X.tolist(), W, "tokens"), TypeError, "x.*ndarray.*list"),
        (lambda: _rust.spectral_filter(X[..., ::2], W, "tokens"), ValueError, "x.*contiguous"),
    ],
)
def test_messages_say_expected_and_got(call, kind, message):
    with pytest.raises(kind, match=message):
        call()
