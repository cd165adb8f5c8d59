"""Tests an installed wheel: the filter against NumPy's FFT, and one pose by ONNX Runtime."""

import numpy as np

import ffpose

rng = np.random.default_rng(0)
x = rng.standard_normal((2, 14, 8))
weight = rng.standard_normal((14, 5, 2))
expected = np.fft.irfft2(np.fft.rfft2(x) * (weight[..., 0] + 1j * weight[..., 1]), s=(14, 8))
np.testing.assert_allclose(ffpose.spectral_filter(x, weight), expected, atol=1e-12)

image = rng.integers(0, 256, (480, 640, 3), dtype=np.uint8)
pose = ffpose.load("soyuz", backend="onnxruntime")(image)
assert np.isfinite(pose.t).all()
np.testing.assert_allclose(np.linalg.norm(pose.q, axis=-1), 1, atol=1e-6)
print(f"ffpose {ffpose.__version__}: the filter agrees with NumPy, and ONNX Runtime poses an image")
