"""Laws that hold for any input: of the spectral filter, and of quaternions."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import reference
from ffpose import _rust, arrays

LAYOUTS = st.sampled_from(["tokens", "grid"])
SIZES = st.integers(1, 20)
SEEDS = st.integers(0, 2**32)
few = settings(max_examples=40, deadline=None)


@st.composite
def images_and_weights(draw, count=1):
    """A layout, ``count`` images and ``count`` weights in float64, and a generator for more."""
    layout, rows, columns = draw(LAYOUTS), draw(SIZES), draw(SIZES)
    channels = () if layout == "tokens" else (draw(st.integers(1, 9)),)
    rng = np.random.default_rng(draw(SEEDS))
    x = rng.normal(size=(count, draw(st.integers(1, 3)), rows, columns, *channels))
    weight = rng.normal(size=(count, rows, columns // 2 + 1, *channels, 2))
    return layout, x, weight, rng


def plane_axes(layout):
    return (-2, -1) if layout == "tokens" else (-3, -2)


def close(actual, expected):
    scale = np.abs(expected).max(initial=1.0)
    np.testing.assert_allclose(actual, expected, rtol=0, atol=1e-13 * scale)


@few
@given(images_and_weights(count=2), st.floats(-3, 3), st.floats(-3, 3))
def test_the_filter_is_linear_in_image_and_weight(case, a, b):
    layout, (x, other_x), (weight, other_weight), _ = case
    f = arrays.spectral_filter
    by_image = a * f(x, weight, layout) + b * f(other_x, weight, layout)
    close(f(a * x + b * other_x, weight, layout), by_image)
    by_weight = a * f(x, weight, layout) + b * f(x, other_weight, layout)
    close(f(x, a * weight + b * other_weight, layout), by_weight)


@few
@given(images_and_weights(), st.tuples(st.integers(-30, 30), st.integers(-30, 30)))
def test_a_shifted_image_gives_the_shifted_result(case, shift):
    layout, (x,), (weight,), _ = case
    axes = plane_axes(layout)
    expected = np.roll(arrays.spectral_filter(x, weight, layout), shift, axes)
    close(arrays.spectral_filter(np.roll(x, shift, axes), weight, layout), expected)


@few
@given(images_and_weights())
def test_the_weight_one_changes_nothing(case):
    layout, (x,), (weight,), _ = case
    one = np.zeros_like(weight)
    one[..., 0] = 1
    close(arrays.spectral_filter(x, one, layout), x)


@few
@given(images_and_weights())
def test_a_weight_of_unit_length_keeps_the_energy(case):
    """Parseval's theorem, with the phases of a signal: they are Hermitian where they must be."""
    layout, (x,), (weight,), rng = case
    signal = rng.normal(size=x.shape[1:])
    spectrum = reference.images(reference.rfft2(reference.planes(signal, layout)), layout)
    phases = spectrum / np.abs(spectrum)
    weight = np.stack([phases.real, phases.imag], axis=-1)
    energy = np.sum(x**2)
    np.testing.assert_allclose(np.sum(arrays.spectral_filter(x, weight, layout) ** 2), energy)


@few
@given(images_and_weights())
def test_the_gradients_are_adjoints(case):
    """<g, F(x, w)> = <F*(g, w), x> = <w, gradient of w>."""
    layout, (x,), (weight,), rng = case
    grad = rng.normal(size=x.shape)
    grad_x, grad_weight = _rust.spectral_filter_backward(grad, x, weight, layout, True, True)
    assert grad_x is not None
    assert grad_weight is not None
    expected = np.sum(grad * arrays.spectral_filter(x, weight, layout))
    scale = np.linalg.norm(grad) * np.linalg.norm(x) * np.abs(weight).max()
    assert np.sum(grad_x * x) == pytest.approx(expected, abs=1e-13 * scale)
    assert np.sum(grad_weight * weight) == pytest.approx(expected, abs=1e-13 * scale)


@few
@given(images_and_weights())
def test_channels_and_images_do_not_mix(case):
    layout, (x,), (weight,), _ = case
    y = arrays.spectral_filter(x, weight, layout)
    if layout == "tokens":
        close(arrays.spectral_filter(x[0], weight, layout), y[0])
    else:
        close(arrays.spectral_filter(x[0, ..., -1], weight[..., -1, :], "tokens"), y[0, ..., -1])


def quaternions(seed, count=8):
    return np.random.default_rng(seed).normal(size=(count, 4))


@given(SEEDS)
def test_a_quaternion_and_its_negative_are_one_rotation(seed):
    q, q_hat = quaternions(seed), quaternions(seed + 1)
    expected = arrays.rotation_error(q_hat, q)
    np.testing.assert_array_equal(arrays.rotation_error(q_hat, -q), expected)
    np.testing.assert_array_equal(arrays.rotation_error(-q_hat, q), expected)
    np.testing.assert_array_equal(arrays.canonical_quaternion(-q), arrays.canonical_quaternion(q))
    np.testing.assert_allclose(arrays.quaternion_to_euler(-q), arrays.quaternion_to_euler(q))


@given(SEEDS)
def test_the_rotation_error_is_a_distance(seed):
    a, b, c = quaternions(seed), quaternions(seed + 1), quaternions(seed + 2)
    np.testing.assert_array_equal(arrays.rotation_error(a, a), 0.0)
    np.testing.assert_allclose(arrays.rotation_error(a, b), arrays.rotation_error(b, a))
    by_way_of_b = arrays.rotation_error(a, b) + arrays.rotation_error(b, c)
    assert (arrays.rotation_error(a, c) <= by_way_of_b + 1e-9).all()


@given(SEEDS, st.floats(1e-200, 1e200))
def test_the_norm_of_a_quaternion_does_not_matter(seed, scale):
    q, q_hat = quaternions(seed), quaternions(seed + 1)
    unit = arrays.normalize_quaternion(q)
    np.testing.assert_allclose(np.linalg.norm(unit, axis=-1), 1.0, rtol=1e-15)
    np.testing.assert_allclose(arrays.normalize_quaternion(scale * q), unit, atol=1e-15)
    np.testing.assert_allclose(
        arrays.rotation_error(q_hat, scale * q), arrays.rotation_error(q_hat, q), atol=1e-6
    )


@given(SEEDS)
def test_the_gradient_of_a_normalization_is_across_the_quaternion(seed):
    q, grad = quaternions(seed), quaternions(seed + 1)
    by_q = _rust.normalize_quaternion_backward(grad, q)
    np.testing.assert_allclose((by_q * q).sum(axis=-1), 0.0, atol=1e-13)
