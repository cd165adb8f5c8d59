"""The spectral filter with torch.fft, for devices and transforms that Rust does not support.

Arguments and results are those of the Rust core; the caller checks the arguments. Conjugates are
materialized (``conj_physical``), because the lazy conjugation of `Tensor.conj` is lost under a
dispatch mode, such as torch's FLOP counter.
"""

from __future__ import annotations

import torch
from torch import Tensor

from ffpose.ops.bridge import arithmetic_dtype
from ffpose.ops.layout import PLANE, RANK, Layout


def filter_by_fft(x: Tensor, weight: Tensor, layout: Layout) -> Tensor:
    """Return ``irfft2(rfft2(x) * weight)``; shapes as in `ffpose.ops.spectral_filter`."""
    if not x.numel():
        return x.new_empty(x.shape)
    return _inverse(_spectrum(x, layout) * _complex_weight(weight, x, layout), x, layout)


def filter_backward_by_fft(
    grad: Tensor, x: Tensor, weight: Tensor, layout: Layout, need_x: bool, need_weight: bool
) -> tuple[Tensor, Tensor]:
    """Return the gradients for ``x`` and ``weight``, of shape ``(0,)`` where one is not needed."""
    for_x = x.new_empty(x.shape if need_x else 0)
    for_weight = weight.new_zeros(weight.shape if need_weight else 0)
    if not x.numel():
        return for_x, for_weight
    spectrum = _spectrum(grad, layout)
    if need_x:
        product = spectrum * _complex_weight(weight, x, layout).conj_physical()
        for_x = _inverse(product, x, layout)
    if need_weight:
        for_weight = _correlate(spectrum, x, layout).to(weight.dtype)
    return for_x, for_weight


def _spectrum(x: Tensor, layout: Layout) -> Tensor:
    spectrum: Tensor = torch.fft.rfft2(x.to(arithmetic_dtype(x.dtype)), dim=PLANE[layout])
    return spectrum


def _inverse(spectrum: Tensor, like: Tensor, layout: Layout) -> Tensor:
    size = [like.shape[dim] for dim in PLANE[layout]]
    y: Tensor = torch.fft.irfft2(spectrum, s=size, dim=PLANE[layout])
    return y.to(like.dtype).contiguous()


def _complex_weight(weight: Tensor, x: Tensor, layout: Layout) -> Tensor:
    """Return the weight as ``irfft2`` sees it: DC and Nyquist columns made Hermitian.

    The product is then Hermitian in these columns too, so that the result does not depend on how an
    FFT library treats columns that are not.
    """
    weight = weight.to(arithmetic_dtype(weight.dtype))
    # A copy, also because torch sees no complex numbers that begin at an odd place of a storage.
    spectrum = torch.view_as_complex(weight.clone(memory_format=torch.contiguous_format))
    columns = _lone_columns(x.shape[PLANE[layout][1]])
    chosen = spectrum[:, columns]
    mirrored = chosen.flip(0).roll(1, 0).conj_physical()
    spectrum[:, columns] = (chosen + mirrored) / 2
    return spectrum


def _correlate(spectrum: Tensor, x: Tensor, layout: Layout) -> Tensor:
    """Return the gradient for the weight, from the spectrum of the result's gradient.

    Each column of the half spectrum counts twice, for itself and for its conjugate partner.
    """
    product = _spectrum(x, layout).conj_physical() * spectrum
    product = product.reshape(-1, *spectrum.shape[-RANK[layout] :])
    rows, columns = (x.shape[dim] for dim in PLANE[layout])
    total = product.sum(0) * (2 / (rows * columns))
    total[:, _lone_columns(columns)] /= 2
    return torch.view_as_real(total).contiguous()


def _lone_columns(width: int) -> slice:
    """Return the columns of a half spectrum without a conjugate partner: DC, Nyquist if any.

    A list would be copied to a GPU each time.
    """
    return slice(0, 1) if width % 2 else slice(0, None, width // 2)
