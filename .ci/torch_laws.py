"""Tests an installed wheel: the filter against torch.fft, its gradients by differences."""

import torch

from ffpose.ops import spectral_filter

torch.manual_seed(0)
x = torch.randn(2, 14, 8, dtype=torch.float64, requires_grad=True)
weight = torch.randn(14, 5, 2, dtype=torch.float64, requires_grad=True)
expected = torch.fft.irfft2(torch.fft.rfft2(x) * torch.view_as_complex(weight), s=(14, 8))
torch.testing.assert_close(spectral_filter(x, weight), expected, rtol=0, atol=1e-12)
assert torch.autograd.gradcheck(spectral_filter, (x, weight))
print(f"the filter agrees with torch {torch.__version__}, its gradients with differences")
