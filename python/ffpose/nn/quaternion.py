"""Quaternion activation: normalization of four outputs to a unit quaternion."""

from __future__ import annotations

from torch import Tensor, nn
from torch.nn import functional

from ffpose.ops import normalize_quaternion


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
            q = q + functional.pad(is_zero.to(q.dtype), (0, 3))  # 1 to the scalar part
        return normalize_quaternion(q)
