"""Orientation heads: representations of an attitude by the outputs of a network, and their losses.

* ``"quaternion"``: a normalized quaternion (Ye et al., Sensors 2023, 23, 8633, Eq. 10).
* ``"bins"``: logits over some thousand attitudes, trained with soft labels (soft classification;
  Proenca and Gao, "Deep Learning for Spacecraft Pose Estimation from Photorealistic Rendering",
  ICRA 2020). The distribution can have several modes, as needed for a symmetric spacecraft in bad
  light. The attitudes are a super-Fibonacci spiral (Alexa, CVPR 2022). The logits are band-limited:
  the network predicts coefficients of the harmonics of SO(3) up to a degree, as in Klee et al.
  ("Image to Sphere", ICLR 2023), so that neighboring attitudes share parameters and the head has a
  twentieth of the weights. Decoding takes the weighted mean of the quaternions near the mode
  (Markley et al., "Averaging Quaternions", 2007).

Quaternions are Hamilton's, scalar first ``(w, x, y, z)``.
"""

from __future__ import annotations

import itertools
import math
from typing import Protocol

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from ffpose.errors import expect
from ffpose.ops import normalize_quaternion

NEIGHBORHOOD_DEG = 40.0
"""Angle from the mode within which bins enter the mean, degrees."""

POWER_SQUARINGS = 10
"""Number of squarings of the averaged matrix, equal to 2**10 power iterations."""

NEAR_SQUARINGS = 5
"""Number of squarings where all bins are within `NEIGHBORHOOD_DEG` of one: there the second
eigenvalue is at most ``tan(20 deg)**2`` of the first, whose 2**5th power is 1e-28."""

SCALED_EACH = 4
"""Squarings between two scalings. The first eigenvalue is 1 to 4 times the largest entry, so that
entries stay below 4**16."""


class QuaternionActivation(nn.Module):
    """Normalization of quaternions (Ye et al., Sensors 2023, 23, 8633, Eq. 8).

    A zero vector has no direction. In training mode it raises an error. In evaluation mode it gives
    the identity ``(1, 0, 0, 0)``, so that a deployed network always returns a unit quaternion. NaN
    propagates in both modes.
    """

    def forward(self, q: Tensor) -> Tensor:
        """Return unit quaternions for ``q (..., 4)``, scalar first.

        Raises:
            ValueError: The last dimension is not 4, or a row is zero in training mode.
            TypeError: The dtype of ``q`` is not floating point.
        """
        if not self.training:
            is_zero = (q == 0).all(dim=-1, keepdim=True)
            q = q + F.pad(is_zero.to(q.dtype), (0, 3))  # 1 to the scalar part
        return normalize_quaternion(q)


class OrientationHead(Protocol):
    """Interface of the orientation heads: decoding and loss of a head's outputs."""

    features: int

    def decode(self, raw: Tensor) -> Tensor:
        """Return unit quaternions ``(B, 4)`` for the head's outputs ``(B, features)``."""

    def loss(self, raw: Tensor, q: Tensor) -> Tensor:
        """Return the loss of each sample ``(B,)`` against unit quaternions ``q (B, 4)``."""


class QuaternionHead(nn.Module):
    """Normalized quaternion; the loss is the distance to the nearer of q and -q."""

    features = 4
    start = (1.0, 0.0, 0.0, 0.0)
    """Outputs that decode to the identity, for the initial bias."""

    def __init__(self) -> None:
        super().__init__()
        self.activation = QuaternionActivation()

    def decode(self, raw: Tensor) -> Tensor:
        """Return unit quaternions ``(B, 4)`` for ``raw (B, 4)``."""
        result: Tensor = self.activation(raw)
        return result

    def loss(self, raw: Tensor, q: Tensor) -> Tensor:
        """Return ``min(|q - q_hat|, |q + q_hat|)`` for each sample ``(B,)``."""
        q_hat = self.decode(raw)
        return torch.minimum((q - q_hat).norm(dim=-1), (q + q_hat).norm(dim=-1))


class AttitudeBins(nn.Module):
    """Logits over attitudes ``(bins, 4)``, trained with soft labels: Gaussians of the angle.

    The standard deviation of the labels is ``width``, radians.
    """

    bins: Tensor
    outer: Tensor

    def __init__(self, attitudes: Tensor, width: float) -> None:
        super().__init__()
        self.features = len(attitudes)
        self.width = width
        self.register_buffer("bins", attitudes.float(), persistent=False)
        outer = (attitudes[:, :, None] * attitudes[:, None]).flatten(1)  # (bins, 16)
        self.register_buffer("outer", outer.float(), persistent=False)

    def logits(self, raw: Tensor) -> Tensor:
        """Return logits ``(B, bins)`` for the network's outputs ``(B, features)``."""
        return raw

    def assign(self, q: Tensor) -> Tensor:
        """Return the soft labels ``(B, bins)``, of sum 1, of unit quaternions ``(B, 4)``."""
        angle = 2 * torch.acos((q @ self.bins.T).abs().clamp(max=1.0))
        return (-(angle / self.width).square() / 2).softmax(-1)

    def decode(self, raw: Tensor) -> Tensor:
        """Return unit quaternions ``(B, 4)`` for ``raw (B, features)``: the weighted mean."""
        p = self.logits(raw).softmax(-1)
        return self.mean(p, self.bins[p.argmax(-1)])

    def mean(self, weights: Tensor, start: Tensor, squarings: int = POWER_SQUARINGS) -> Tensor:
        """Return the means of the attitudes by ``weights (B, bins)``; see `mean_quaternion`."""
        matrix = torch.unflatten(weights @ self.outer, 1, (4, 4))  # sum of p q qT
        return mean_quaternion(matrix, start, squarings)

    def loss(self, raw: Tensor, q: Tensor) -> Tensor:
        """Return the cross-entropy with the soft labels for each sample ``(B,)``."""
        return -(self.assign(q) * self.logits(raw).log_softmax(-1)).sum(-1)


class BinsHead(AttitudeBins):
    """Band-limited logits over attitudes spread evenly over SO(3); 8,000 are 9 degrees apart.

    Harmonics up to ``degree`` have ``(degree + 1)(2 degree + 1)(2 degree + 3) / 3`` coefficients.

    Raises:
        ValueError: There are fewer attitudes than coefficients.
    """

    basis: Tensor

    def __init__(self, bins: int = 8000, degree: int = 5, width_deg: float = 7.0) -> None:
        attitudes = super_fibonacci(bins)
        super().__init__(attitudes, math.radians(width_deg))
        basis = harmonics(attitudes, degree)
        self.features = basis.shape[1]
        self.register_buffer("basis", basis.float().T.contiguous(), persistent=False)

    def logits(self, raw: Tensor) -> Tensor:
        """Return logits ``(B, bins)`` for coefficients ``raw (B, features)``."""
        return raw @ self.basis

    def decode(self, raw: Tensor) -> Tensor:
        """Return unit quaternions ``(B, 4)``: the mean within `NEIGHBORHOOD_DEG` of the mode."""
        p = self.logits(raw).softmax(-1)
        mode = self.bins[p.argmax(-1)]  # (B, 4)
        near = (mode @ self.bins.T).abs() > math.cos(math.radians(NEIGHBORHOOD_DEG) / 2)
        return self.mean(p * near, mode, NEAR_SQUARINGS)


def mean_quaternion(matrix: Tensor, start: Tensor, squarings: int = POWER_SQUARINGS) -> Tensor:
    """Return the mean ``(B, 4)`` of quaternions whose weighted sum of ``q qT`` is ``matrix``.

    It is the principal eigenvector (Markley et al., "Averaging Quaternions", 2007), computed by
    power iteration, which can be exported to ONNX, from initial vectors ``(B, 4)`` that are not
    orthogonal to the mean, such as one of the quaternions. ``2**squarings`` iterations suffice
    where as high a power of the second eigenvalue over the first is nothing. Half precision, which
    the powers would overflow, is computed in float32.
    """
    dtype, kind = start.dtype, torch.promote_types(matrix.dtype, torch.float32)
    matrix, start = matrix.to(kind), start.to(kind)
    for number in range(squarings):
        if number % SCALED_EACH == 0:
            matrix = matrix / matrix.amax((-2, -1), keepdim=True)  # which is on the diagonal
        matrix = matrix @ matrix
    mean = (matrix @ start[:, :, None])[..., 0]
    unit: Tensor = mean / mean.norm(dim=-1, keepdim=True)
    return unit.to(dtype)


def super_fibonacci(count: int) -> Tensor:
    """Return attitudes spread evenly over SO(3), unit quaternions ``(count, 4)``, float64.

    Alexa, "Super-Fibonacci Spirals: Fast, Low-Discrepancy Sampling of SO(3)", CVPR 2022.
    """
    place = torch.arange(count, dtype=torch.float64) + 0.5
    r, rest = (place / count).sqrt(), (1 - place / count).sqrt()
    alpha = 2 * math.pi * place / math.sqrt(2)
    beta = 2 * math.pi * place / 1.533751168755204288118041
    return torch.stack(
        [r * alpha.sin(), r * alpha.cos(), rest * beta.sin(), rest * beta.cos()], dim=-1
    )


def harmonics(q: Tensor, degree: int) -> Tensor:
    """Return an orthonormal basis of functions on SO(3) up to a degree, sampled at ``q (N, 4)``.

    Even polynomials of the quaternion of degree ``2 degree`` span the same functions as Wigner's D
    matrices up to ``degree``. The basis ``(N, (degree + 1)(2 degree + 1)(2 degree + 3) / 3)``,
    float64, is orthonormal in the mean. Its signs are fixed, so it is the same everywhere up to
    rounding.

    Raises:
        ValueError: There are fewer attitudes than functions.
    """
    power = 2 * degree
    powers = q[:, :, None] ** torch.arange(power + 1)  # (N, 4, power + 1)
    exponents = [
        (*rest, power - sum(rest))
        for rest in itertools.product(range(power + 1), repeat=3)
        if sum(rest) <= power
    ]
    expected = f"at least {len(exponents)}, as many as harmonics of degree {degree}"
    expect(len(q) >= len(exponents), "bins", expected, len(q))
    columns = [
        math.sqrt(math.factorial(power) / math.prod(map(math.factorial, e)))
        * powers[:, 0, e[0]]
        * powers[:, 1, e[1]]
        * powers[:, 2, e[2]]
        * powers[:, 3, e[3]]
        for e in exponents
    ]
    orthonormal, triangular = torch.linalg.qr(torch.stack(columns, dim=1))
    result: Tensor = orthonormal * triangular.diagonal().sign() * math.sqrt(len(q))
    return result
