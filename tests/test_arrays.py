"""The NumPy face against float64 references, for random shapes of every kind."""

import inspect
import os
import re
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from importlib import metadata

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy import fft

import ffpose
import reference
from ffpose import _rust, arrays

LAYOUTS = ("tokens", "grid")
PRIMES = (2, 3, 5, 7, 11, 13, 17, 19, 23, 29, 31, 37, 41, 43, 47, 53, 59, 61)
sizes = st.one_of(st.integers(1, 24), st.sampled_from([1, *PRIMES, 14, 28, 32, 49, 56, 64]))
leading_axes = st.sampled_from([(), (1,), (3,), (1, 2)])


@st.composite
def filter_cases(draw):
    layout = draw(st.sampled_from(LAYOUTS))
    leading, rows, columns = draw(leading_axes), draw(sizes), draw(sizes)
    channels = () if layout == "tokens" else (draw(st.integers(1, 20)),)
    dtype = draw(st.sampled_from([np.float32, np.float64]))
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    x_shape = (*leading, rows, columns, *channels)
    weight_shape = (rows, columns // 2 + 1, *channels, 2)
    x, grad = rng.normal(size=(2, *x_shape)).astype(dtype)
    return layout, x, rng.normal(size=weight_shape).astype(dtype), grad


def points(x, layout):
    return int(np.prod(x.shape[-2:] if layout == "tokens" else x.shape[-3:-1]))


def peaks_of_spectra(x, layout, weight):
    """The largest magnitude of each image's spectrum, (batch,)."""
    images = x.reshape(-1, *x.shape[1 - weight.ndim :])
    spectra = np.abs(reference.rfft2(reference.planes(images, layout)))
    return spectra.reshape(len(images), -1).max(axis=1, initial=0.0)


def size_of_terms(x, weight, layout, expected):
    """The largest result, or the largest weight times what a plane's numbers are in the mean.

    Results of few pixels may cancel; the roundings of what was added up remain.
    """
    planes = reference.planes(x.reshape(-1, *x.shape[1 - weight.ndim :]), layout)
    mean_squares = np.mean(np.square(planes, dtype=np.float64), axis=(-2, -1))
    largest_weight = np.hypot(weight[..., 0], weight[..., 1]).max(initial=0.0)
    gained = largest_weight * np.sqrt(mean_squares.max(initial=0.0))
    return np.maximum(gained, np.abs(expected).max(initial=0.0))


def assert_filtered(actual, expected, x, layout, scale=None):
    """`scale`: the size of what was added up, where terms may cancel."""
    assert actual.dtype == x.dtype
    assert actual.shape == expected.shape
    error = np.abs(actual - expected).max(initial=0.0)
    scale = expected if scale is None else scale
    assert error <= reference.spectral_tolerance(scale, points(x, layout), x.dtype)


@example(
    (
        "tokens",
        np.array([[0.11461431], [0.32256629], [-0.66066958]]),
        np.array(
            [[[1.13688246, 1.0567632]], [[1.45920065, 0.26890815]], [[-0.91600979, 0.72274967]]]
        ),
        None,
    )
)
@settings(max_examples=300, deadline=None)
@given(filter_cases())
def test_filter_agrees_with_the_sums(case):
    layout, x, weight, _ = case
    actual = arrays.spectral_filter(x, weight, layout)
    expected = reference.spectral_filter(x, weight, layout)
    assert_filtered(actual, expected, x, layout, size_of_terms(x, weight, layout, expected))


@settings(max_examples=200, deadline=None)
@given(filter_cases())
def test_gradients_agree_with_the_sums(case):
    layout, x, weight, grad = case
    actual = _rust.spectral_filter_backward(grad, x, weight, layout, True, True)
    expected = reference.spectral_filter_backward(grad, x, weight, layout)
    assert_filtered(
        actual[0], expected[0], x, layout, size_of_terms(grad, weight, layout, expected[0])
    )
    # The gradient for the weight, a sum of products of two spectra, may cancel: the spectra count.
    peaks = [peaks_of_spectra(images, layout, weight) for images in (grad, x)]
    largest = 2 / points(x, layout) * (peaks[0] * peaks[1]).sum()
    assert_filtered(actual[1], expected[1], x, layout, scale=largest)


@pytest.mark.parametrize(
    ("layout", "shape"),
    [
        ("tokens", (2, 196, 256)),
        ("tokens", (784, 128)),
        ("tokens", (101, 103)),
        ("grid", (14, 14, 256)),
        ("grid", (2, 28, 28, 64)),
        ("grid", (56, 56, 20)),
        ("grid", (7, 7, 512)),
        ("grid", (13, 97, 12)),
    ],
)
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_filter_agrees_with_scipy_at_the_sizes_of_networks(layout, shape, dtype):
    rng = np.random.default_rng(1)
    axes = (-2, -1) if layout == "tokens" else (-3, -2)
    rows, columns = (shape[axis] for axis in axes)
    channels = shape[-1:] if layout == "grid" else ()
    x = rng.normal(size=shape).astype(dtype)
    weight = rng.normal(size=(rows, columns // 2 + 1, *channels, 2)).astype(dtype)
    spectrum = fft.rfft2(x.astype(np.float64), axes=axes)
    product = spectrum * (weight[..., 0] + 1j * weight[..., 1].astype(np.float64))
    expected = fft.irfft2(product, s=(rows, columns), axes=axes)
    assert_filtered(arrays.spectral_filter(x, weight, layout), expected, x, layout)


def test_gradients_are_made_only_where_needed():
    x, weight = np.ones((3, 4)), np.ones((3, 3, 2))
    grad_x, grad_weight = _rust.spectral_filter_backward(x, x, weight, "tokens", True, False)
    assert grad_x.shape == x.shape
    assert grad_weight is None
    grad_x, grad_weight = _rust.spectral_filter_backward(x, x, weight, "tokens", False, True)
    assert grad_x is None
    assert grad_weight.shape == weight.shape


@pytest.mark.parametrize("shape", [(0, 6, 4), (5, 0, 4), (5, 6, 0), (2, 0, 3, 4)])
def test_nothing_is_filtered_to_nothing(shape):
    weight = np.ones((shape[-2], shape[-1] // 2 + 1, 2))
    x = np.ones(shape)
    assert arrays.spectral_filter(x, weight).shape == shape
    grads = _rust.spectral_filter_backward(x, x, weight, "tokens", True, True)
    assert grads[0].shape == shape
    np.testing.assert_array_equal(grads[1], np.zeros_like(weight))


def test_threads_change_no_bit():
    rng = np.random.default_rng(2)
    x, grad = rng.normal(size=(2, 4, 28, 28, 96)).astype(np.float32)
    weight = rng.normal(size=(28, 15, 96, 2)).astype(np.float32)
    once = _rust.spectral_filter_backward(grad, x, weight, "grid", True, True)
    for num_threads in (2, 3, 7):
        again = _rust.spectral_filter_backward(grad, x, weight, "grid", True, True, num_threads)
        np.testing.assert_array_equal(once[0], again[0])
        np.testing.assert_array_equal(once[1], again[1])


def test_calls_of_several_threads_do_not_disturb_each_other():
    rng = np.random.default_rng(5)
    cases = []
    for shape in [(3, 7, 9, 5), (2, 14, 14, 40), (1, 30, 8, 3)] * 8:
        weight = rng.normal(size=(shape[1], shape[2] // 2 + 1, shape[3], 2))
        cases.append((rng.normal(size=shape), weight, "grid"))
    with ThreadPoolExecutor(4) as pool:
        together = pool.map(lambda case: arrays.spectral_filter(*case), cases)
    for case, y in zip(cases, together, strict=True):
        np.testing.assert_array_equal(y, arrays.spectral_filter(*case))


def test_a_read_only_array_is_read_and_left_alone():
    x, weight = np.random.default_rng(6).normal(size=(2, 4, 3, 2))
    x = x[..., 0].copy()
    weight = weight[:, :2].copy()
    x.flags.writeable = weight.flags.writeable = False
    before = x.copy(), weight.copy()
    expected = reference.spectral_filter(x, weight, "tokens")
    np.testing.assert_allclose(arrays.spectral_filter(x, weight), expected, atol=1e-14)
    np.testing.assert_array_equal(x, before[0])
    np.testing.assert_array_equal(weight, before[1])


def test_lists_and_strides_are_taken():
    x, weight = np.random.default_rng(3).normal(size=(2, 6, 4, 2))
    x, weight = x[..., 0], weight[:, :3]
    expected = reference.spectral_filter(x, weight, "tokens")
    for same in (x, x.tolist(), np.asfortranarray(x), x[:, ::-1][:, ::-1]):
        np.testing.assert_allclose(arrays.spectral_filter(same, weight), expected, atol=1e-14)


def test_an_unaligned_array_is_taken():
    numbers = np.arange(12.0)
    unaligned = np.frombuffer(b"x" + numbers.tobytes(), np.uint8)[1:].view(np.float64)
    assert not unaligned.flags.aligned
    q = arrays.normalize_quaternion(unaligned.reshape(3, 4))
    np.testing.assert_array_equal(q, arrays.normalize_quaternion(numbers.reshape(3, 4)))


@given(st.integers(0, 2**32))
def test_euler_angles_agree_with_scipy(seed):
    q = np.random.default_rng(seed).normal(size=(20, 4))
    expected = reference.rotation(q).as_euler("xyz", degrees=True)
    np.testing.assert_allclose(arrays.quaternion_to_euler(q), expected, atol=1e-9)
    back = arrays.euler_to_quaternion(expected)
    same = arrays.canonical_quaternion(arrays.normalize_quaternion(q))
    np.testing.assert_allclose(back, same, atol=1e-12)


@pytest.mark.parametrize("pitch", [90.0, -90.0])
def test_a_locked_gimbal_keeps_the_rotation(pitch):
    q = arrays.euler_to_quaternion([[30.0, pitch, -50.0], [170.0, pitch, 20.0]])
    angles = arrays.quaternion_to_euler(q)
    np.testing.assert_array_equal(angles[:, 0], 0.0)
    again = arrays.euler_to_quaternion(angles)
    np.testing.assert_allclose(reference.rotation_error(q, again), 0.0, atol=1e-5)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_euler_angles_are_above_minus_half_a_turn_and_do_not_depend_on_the_sign(dtype):
    signs = np.stack(np.meshgrid(*[[-1.0, -0.0, 0.0, 1.0]] * 4), axis=-1).reshape(-1, 4)
    q = signs[np.any(signs != 0, axis=1)].astype(dtype)
    nearly = np.array([[1e-9, 0, 0, -1], [1e-9, -1, 0, 0], [1, -1e-9, 1, 0], [1e-9, -1, 0, 1]])
    q = np.concatenate([q, nearly.astype(dtype)])
    angles = arrays.quaternion_to_euler(q)
    assert np.all((angles > -180) & (angles <= 180))
    np.testing.assert_array_equal(arrays.quaternion_to_euler(-q), angles)
    again = arrays.euler_to_quaternion(angles)
    np.testing.assert_allclose(reference.rotation_error(q, again), 0.0, atol=1e-3)
    locked = arrays.quaternion_to_euler([[-1.0, 0, -1, 0]])
    np.testing.assert_allclose(locked, [[0, 90, 0]], atol=1e-9)


def test_quaternions_of_euler_angles_are_canonical():
    degrees = np.arange(-360.0, 361.0, 45.0)
    angles = np.stack(np.meshgrid(degrees, degrees, degrees), axis=-1).reshape(-1, 3)
    for dtype in (np.float32, np.float64):
        q = arrays.euler_to_quaternion(angles.astype(dtype))
        np.testing.assert_array_equal(q, arrays.canonical_quaternion(q))


def _poses(rng: np.random.Generator) -> dict[str, np.ndarray]:
    """Return float32 arguments by name; half of the angles are eighths of a turn."""
    eighths = rng.integers(-8, 9, (200, 3)) * 45.0
    rpy = np.where(rng.random((200, 3)) < 0.5, eighths, rng.uniform(-400, 400, (200, 3)))
    q, q_hat, grad = rng.normal(size=(3, 200, 4))
    q[:50], q_hat[:50] = rng.integers(-1, 2, (2, 50, 4)) + np.eye(4)[rng.integers(0, 4, 50)] / 2
    q_hat[50:100] = q[50:100] + 1e-4 * grad[50:100]
    t, t_hat = rng.normal((0, 0, 5), size=(2, 200, 3))
    poses = {"q": q, "q_hat": q_hat, "grad": grad, "t": t, "t_hat": t_hat, "rpy": rpy}
    return {name: values.astype(np.float32) for name, values in poses.items()}


@pytest.mark.parametrize(
    "name",
    [
        "normalize_quaternion",
        "normalize_quaternion_backward",
        "canonical_quaternion",
        "quaternion_to_euler",
        "euler_to_quaternion",
        "translation_error",
        "rotation_error",
        "esa_score",
        "speed_plus_score",
    ],
)
@given(seed=st.integers(0, 2**32))
@settings(max_examples=20, deadline=None)
def test_single_precision_is_double_precision_rounded_once(name, seed):
    function = getattr(_rust, name)
    poses = _poses(np.random.default_rng(seed))
    single = [poses[argument] for argument in inspect.signature(function).parameters]
    expected = function(*(argument.astype(np.float64) for argument in single)).astype(np.float32)
    if name == "quaternion_to_euler":  # the open end of the range, where rounding came to it
        expected[expected == -180] = 180
    np.testing.assert_array_equal(function(*single), expected, strict=True)


@given(st.integers(0, 2**32), st.sampled_from([np.float32, np.float64]))
def test_errors_agree_with_scipy(seed, dtype):
    rng = np.random.default_rng(seed)
    q, q_hat = rng.normal(size=(2, 10, 4)).astype(dtype)
    t, t_hat = rng.normal(size=(2, 10, 3)).astype(dtype)
    rtol = 4 * np.finfo(dtype).eps
    rotation, translation = arrays.rotation_error(q_hat, q), arrays.translation_error(t_hat, t)
    assert rotation.dtype == translation.dtype == dtype
    expected = reference.rotation_error(q_hat, q)
    np.testing.assert_allclose(rotation, expected, rtol=rtol, atol=1e-13 if rtol < 1e-9 else 0)
    np.testing.assert_allclose(translation, reference.translation_error(t_hat, t), rtol=rtol)


def test_small_angles_keep_their_digits_in_single_precision():
    half = np.radians([1e-3, 1e-5]) / 2
    q_hat = np.zeros((2, 4), np.float32)
    q_hat[:, 0], q_hat[:, 1] = np.cos(half), np.sin(half)
    q = np.array([[1, 0, 0, 0]] * 2, np.float32)
    np.testing.assert_allclose(arrays.rotation_error(q_hat, q), [1e-3, 1e-5], rtol=1e-6)


def test_scores_by_hand():
    t = np.array([[0, 0, 10.0]] * 4)
    t_hat = np.array([[0, 3, 14.0], [0, 0, 10.02], [0, 0, 10.03], [0, 0, 10.02]])
    degrees = np.array([30.0, 30.0, 0.16, 0.16])
    q = np.array([[1.0, 0, 0, 0]] * 4)
    q_hat = arrays.euler_to_quaternion(np.stack([0 * degrees, 0 * degrees, degrees], axis=-1))
    radians = np.radians(degrees)
    esa = np.array([0.5, 0.002, 0.003, 0.002]) + radians
    np.testing.assert_allclose(arrays.esa_score(t_hat, q_hat, t, q), esa, rtol=1e-12)
    speed_plus = [0.5 + radians[0], radians[1], 0.003, 0.0]
    np.testing.assert_allclose(arrays.speed_plus_score(t_hat, q_hat, t, q), speed_plus, rtol=1e-12)


def test_gradient_of_a_normalization_by_differences():
    rng = np.random.default_rng(4)
    q, grad, step = rng.normal(size=(3, 6, 4))
    h = 1e-6
    ahead, behind = (
        arrays.normalize_quaternion(q + h * step),
        arrays.normalize_quaternion(q - h * step),
    )
    expected = (grad * (ahead - behind)).sum(axis=-1) / (2 * h)
    actual = (_rust.normalize_quaternion_backward(grad, q) * step).sum(axis=-1)
    np.testing.assert_allclose(actual, expected, rtol=1e-7)


def test_nan_goes_through_a_normalization():
    q = np.array([[np.nan, 0, 0, 0], [0, 0, 2.0, 0]])
    np.testing.assert_array_equal(arrays.normalize_quaternion(q), [[np.nan] * 4, [0, 0, 1, 0]])


def run_with_isa(name):
    code = "from ffpose import arrays; print(arrays.instruction_set())"
    environment = os.environ | {"FFPOSE_ISA": name}
    command = [sys.executable, "-c", code]
    return subprocess.run(command, env=environment, capture_output=True, text=True)


def test_an_instruction_set_can_be_forced():
    assert run_with_isa("scalar").stdout == "scalar\n"


def test_an_unknown_instruction_set_is_refused():
    done = run_with_isa("mmx")
    assert done.returncode == 1
    assert re.search(r"ValueError: FFPOSE_ISA must be one of scalar.*, got \"mmx\"", done.stderr)


def test_the_version_is_that_of_the_package():
    assert ffpose.__version__ == metadata.version("ffpose")


OUT_OF_MEMORY = """
import resource
import numpy as np
import ffpose
x = np.ones((2048, 2048, 1), np.float32)
weight = np.ones((2048, 1025, 1, 2), np.float32)
with open("/proc/self/statm") as file:
    used = int(file.read().split()[0]) * resource.getpagesize()
resource.setrlimit(resource.RLIMIT_AS, (used + 2 * x.nbytes, -1))
try:
    ffpose.spectral_filter(x, weight, "grid")
except MemoryError as error:
    print(error)
resource.setrlimit(resource.RLIMIT_AS, (-1, -1))
np.testing.assert_allclose(ffpose.spectral_filter(x, weight, "grid").sum(), x.sum(), rtol=1e-3)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="reads the sizes that Linux tells")
def test_working_memory_that_does_not_fit_is_an_error():
    command = [sys.executable, "-c", OUT_OF_MEMORY]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert re.match(r"expected \d+ bytes of working memory, got none", done.stdout)
