"""A filter's weight for another size: the same kernel in space, on images of another period.

A weight on ``n`` points is the response of a kernel of ``n`` taps at the frequencies ``k / n``.
Taken about its origin, from ``-n/2`` to ``n/2``, the kernel has a response at every frequency, and
the weight for ``m`` points is this response at ``k / m``. GFNet's paper (Rao et al., 2021) reads
its filters so, as samples of a continuous response; its code interpolates bilinearly between the
samples, which changes the kernel. Here it is kept to the last tap:

- resized, the filter does to an image what the kernel does to that image repeated without end;
- where ``m >= n`` no tap changes, and up and down again is where it began;
- where ``m < n`` taps ``m`` points apart fall together: nothing is cut off, and so the gain at
  frequency zero is kept.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from ffpose.ops import Layout, spectral_filter


def resample_weight(
    weight: Tensor, size: Sequence[int], plane: Sequence[int], layout: Layout
) -> Tensor:
    """Return the weight of the same filter on planes of another size.

    Args:
        weight: ``(X, Y//2+1, 2)`` or ``(H, W//2+1, C, 2)``, float32 or float64.
        size: What it is for: ``(X, Y)`` or ``(H, W, C)``.
        plane: Rows and columns to be: ``(X', Y')`` or ``(H', W')``.
        layout: ``"tokens"`` or ``"grid"``.

    Returns:
        ``(X', Y'//2+1, 2)`` or ``(H', W'//2+1, C, 2)``, of the dtype and device of ``weight``,
        computed in float64. In the columns of frequency zero and Nyquist only the Hermitian part
        of ``weight`` acts, and only that is taken over.
    """
    with torch.no_grad():
        impulse = weight.new_zeros(tuple(size), dtype=torch.float64)
        impulse[0, 0] = 1
        kernel = spectral_filter(impulse, weight.double(), layout)
        for dim, length in enumerate(plane):
            kernel = _wrap(kernel, dim, length)
        return torch.view_as_real(torch.fft.rfft2(kernel, dim=(0, 1))).to(weight.dtype)


def _wrap(kernel: Tensor, dim: int, length: int) -> Tensor:
    """Lay a kernel of one period about the origin of a circle of ``length`` points.

    The last tap of an even period is as far before the origin as behind it: half goes to each.
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
