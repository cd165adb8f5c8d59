"""The joint loss of translation and orientation (Ye et al., Sensors 2023, 23, 8633, Eq. 9-11).

``L = L_t exp(-s_t) + s_t + L_q exp(-s_q) + s_q`` with ``L_t = ||t - t_hat||`` and
``L_q = ||q - q_hat / ||q_hat|| ||``, each a mean over the batch, and two learnable weights s_t and
s_q (Kendall and Cipolla, CVPR 2017). Their initial values are -3 and -6.5; the printed ones lost
their minus signs.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor, nn

from ffpose.ops import normalize_quaternion


class LossTerms(NamedTuple):
    """The joint loss (Eq. 11) and its terms, ``L_t`` in meters and ``L_q``, scalar tensors."""

    total: Tensor
    translation: Tensor
    orientation: Tensor


class JointLoss(nn.Module):
    """Base of the losses that join a translation term with an orientation term.

    With ``antipodal`` the distance is to the nearer of q and -q, which are the same rotation. The
    paper's loss relies on canonical labels, and its gradient points the wrong way for a prediction
    near a half turn with the other sign.
    """

    def __init__(self, antipodal: bool = False) -> None:
        super().__init__()
        self.antipodal = antipodal

    def joined(self, translation: Tensor, orientation: Tensor) -> LossTerms:
        """Return the loss for two given terms, scalars."""
        raise NotImplementedError

    def quaternion_distance(self, q_hat: Tensor, q: Tensor) -> Tensor:
        """Return the distance ``(B,)`` of unit quaternions ``(B, 4)``."""
        distance: Tensor = torch.linalg.vector_norm(q - q_hat, dim=-1)
        if not self.antipodal:
            return distance
        return torch.minimum(distance, torch.linalg.vector_norm(q + q_hat, dim=-1))


class FixedLoss(JointLoss):
    """The loss ``L = w_t L_t + w_q L_q`` with fixed weights; it has no parameters."""

    def __init__(self, translation: float, orientation: float, antipodal: bool = False) -> None:
        super().__init__(antipodal)
        self.translation, self.orientation = translation, orientation

    def joined(self, translation: Tensor, orientation: Tensor) -> LossTerms:
        """Return the loss for two given terms."""
        total = self.translation * translation + self.orientation * orientation
        return LossTerms(total, translation, orientation)


class PoseLoss(JointLoss):
    """The joint loss with its learnable weights, of initial log weights ``s_t`` and ``s_q``.

    Exclude them from weight decay: they are not weights of the network, and zero is not a neutral
    value for them.
    """

    def __init__(self, s_t: float = -3.0, s_q: float = -6.5, antipodal: bool = False) -> None:
        super().__init__(antipodal)
        self.s_t = nn.Parameter(torch.tensor(float(s_t)))
        self.s_q = nn.Parameter(torch.tensor(float(s_q)))

    def forward(self, t_hat: Tensor, q_hat: Tensor, t: Tensor, q: Tensor) -> LossTerms:
        """Compare predictions with labels: translations ``(B, 3)``, meters; quaternions ``(B, 4)``.

        Predicted quaternions, ``(w, x, y, z)``, may have any nonzero norm.

        Raises:
            ValueError: A shape is wrong, the batch is empty, or a predicted quaternion is zero.
        """
        expected = {"t_hat": (t_hat, 3), "q_hat": (q_hat, 4), "t": (t, 3), "q": (q, 4)}
        for name, (tensor, size) in expected.items():
            if tensor.shape != (len(t_hat), size) or len(t_hat) == 0:
                raise ValueError(
                    f"{name}: expected shape (B, {size}), one B >= 1, got {tuple(tensor.shape)}"
                )
        return self.joined(
            torch.linalg.vector_norm(t - t_hat, dim=-1).mean(),
            self.quaternion_distance(normalize_quaternion(q_hat), q).mean(),
        )

    def joined(self, translation: Tensor, orientation: Tensor) -> LossTerms:
        """Return Eq. 11 for two given terms."""
        total = (
            translation * torch.exp(-self.s_t)
            + self.s_t
            + orientation * torch.exp(-self.s_q)
            + self.s_q
        )
        return LossTerms(total, translation, orientation)
