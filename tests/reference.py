"""What the fast code must agree with: slow, obvious, in float64, from the definitions."""

import numpy as np
from scipy.spatial.transform import Rotation


def dft_matrix(n, sign):
    """``exp(sign 2 pi i j k / n)``, the exponent reduced before it is rounded."""
    k = np.arange(n)
    return np.exp(sign * 2j * np.pi * (np.outer(k, k) % n) / n)


def rfft2(x):
    """Half spectra ``(..., R, C // 2 + 1)`` of planes ``(..., R, C)``."""
    rows, columns = x.shape[-2:]
    spectrum = dft_matrix(rows, -1) @ x.astype(np.float64) @ dft_matrix(columns, -1)
    return spectrum[..., : columns // 2 + 1]


def irfft2(spectrum, columns):
    """Planes ``(..., R, columns)`` of half spectra, as torch.fft.irfft2 makes them.

    The second axis is inverted as that of a real signal: frequency zero and, if ``columns`` is
    even, Nyquist count once and without their imaginary parts, all others twice.
    """
    rows = spectrum.shape[-2]
    v = np.arange(columns // 2 + 1)
    copies = np.where((v == 0) | (2 * v == columns), 1.0, 2.0)
    by_rows = dft_matrix(rows, +1) @ spectrum
    return (by_rows * copies @ dft_matrix(columns, +1)[: len(v)]).real / (rows * columns)


def planes(x, layout):
    """Images as planes ``(..., R, C)``: channels, if there are any, become a leading axis."""
    return np.moveaxis(x, -1, -3) if layout == "grid" else x


def images(x, layout):
    """The inverse of `planes`."""
    return np.moveaxis(x, -3, -1) if layout == "grid" else x


def complex_planes(weight, layout):
    """A real weight ``(..., 2)`` as complex planes."""
    return planes(weight[..., 0].astype(np.float64) + 1j * weight[..., 1], layout)


def spectral_filter(x, weight, layout):
    """``irfft2(rfft2(x) * weight)``."""
    spectrum = rfft2(planes(x, layout)) * complex_planes(weight, layout)
    return images(irfft2(spectrum, planes(x, layout).shape[-1]), layout)


def spectral_filter_backward(grad, x, weight, layout):
    """Gradients of ``sum(grad * spectral_filter(x, weight))`` with respect to x and weight."""
    grad_spectrum, columns = rfft2(planes(grad, layout)), planes(x, layout).shape[-1]
    grad_x = irfft2(grad_spectrum * complex_planes(weight, layout).conj(), columns)

    v = np.arange(columns // 2 + 1)
    copies = np.where((v == 0) | (2 * v == columns), 1.0, 2.0)
    products = rfft2(planes(x, layout)).conj() * grad_spectrum * copies
    leading = tuple(range(x.ndim - weight.ndim + 1))
    summed = images(products.sum(axis=leading), layout)
    points = grad_x.shape[-2] * columns
    return images(grad_x, layout), np.stack([summed.real, summed.imag], axis=-1) / points


def spectral_tolerance(expected, points, dtype):
    """Four roundings for each doubling of the plane, relative to the largest number."""
    largest = np.abs(expected).max(initial=0.0)
    return 4 * np.finfo(dtype).eps * max(1.0, np.log2(points)) * largest


def rotation(q):
    """SciPy's rotation for quaternions ``(..., 4)`` of order w, x, y, z."""
    return Rotation.from_quat(np.asarray(q, dtype=np.float64), scalar_first=True)


def rotation_error(q_hat, q):
    """Angle between orientations in degrees."""
    return np.degrees((rotation(q).inv() * rotation(q_hat)).magnitude())


def translation_error(t_hat, t):
    """Distance between translations."""
    return np.linalg.norm(np.asarray(t_hat, np.float64) - np.asarray(t, np.float64), axis=-1)
