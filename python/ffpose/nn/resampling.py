"""Resampling a filter's weight for another size, keeping its spatial kernel.

A weight for ``n`` points is the frequency response of a kernel of ``n`` taps at the frequencies
``k / n``. With its taps centered on the origin, from ``-n/2`` to ``n/2``, the kernel has a response
at every frequency; the weight for ``m`` points is this response at ``k / m``. GFNet's paper (Rao et
al., 2021) also describes its filters as samples of a continuous response, but its code interpolates
bilinearly between the samples, which changes the kernel. Here the kernel is exact:

- the resized filter equals the convolution of the periodically continued image with the kernel;
- for ``m >= n`` no tap changes, and resizing back gives the original weight;
- for ``m < n`` taps that are ``m`` points apart are added: nothing is cut off, and the gain at DC
  is preserved.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from ffpose.ops import Layout, spectral_filter


def resample_weight(
    weight: Tensor, size: Sequence[int], plane: Sequence[int], layout: Layout
) -> Tensor:
    """Resample the weight of a filter of a ``size`` for planes ``(rows, columns)`` of another.

    The result has dtype and device of ``weight``, and is computed on the CPU in float64, which some
    devices lack. In the DC and Nyquist columns only the Hermitian part of ``weight`` has an effect,
    and only that part is kept.
    """
    with torch.no_grad():
        impulse = torch.zeros(tuple(size), dtype=torch.float64, device="cpu")
        impulse[0, 0] = 1
        kernel = spectral_filter(impulse, weight.cpu().double(), layout)
        for dim, length in enumerate(plane):
            kernel = _wrap(kernel, dim, length)
        return torch.view_as_real(torch.fft.rfft2(kernel, dim=(0, 1))).to(weight)


def _wrap(kernel: Tensor, dim: int, length: int) -> Tensor:
    """Wrap a kernel of one period, centered on the origin, to a period of ``length`` points.

    For an even period the tap at half the period is split equally between both sides.
    """
    period = kernel.shape[dim]
    half = period // 2
    offsets = torch.arange(-half, half + 1, device=kernel.device)
    share = torch.ones_like(offsets, dtype=kernel.dtype)
    if period % 2 == 0:
        share[[0, -1]] = 0.5
    taps = kernel.movedim(dim, -1)[..., offsets % period] * share
    wrapped = taps.new_zeros(*taps.shape[:-1], length)
    return wrapped.index_add_(-1, offsets % length, taps).movedim(-1, dim)
