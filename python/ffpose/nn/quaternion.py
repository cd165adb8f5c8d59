"""The quaternion activation: four numbers to a rotation."""

from __future__ import annotations

from torch import Tensor, nn
from torch.nn import functional

from ffpose.ops import normalize_quaternion


class QuaternionActivation(nn.Module):
    """Divides by the norm, by the Rust operator (Ye et al., Sensors 2023, 23, 8633, Eq. 8).

    A zero vector has no direction. In training mode it is an error, since something went wrong
    before. In evaluation mode, which is what gets deployed, it becomes the identity ``(1, 0, 0,
    0)``: whoever steers by the answer gets a unit quaternion. NaN stays NaN in both.
    """

    def forward(self, q: Tensor) -> Tensor:
        """Return unit quaternions for ``q (..., 4)``, scalar first.

        Raises:
            ValueError: The last dimension is not 4, or a row is zero in training mode.
            TypeError: A dtype that is not floating point.
        """
        if not self.training:
            is_zero = (q == 0).all(dim=-1, keepdim=True)
            q = q + functional.pad(is_zero.to(q.dtype), (0, 3))  # 1 to the scalar part
        return normalize_quaternion(q)
