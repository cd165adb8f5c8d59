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


class LossTerms(NamedTuple):
    """The joint loss (Eq. 11) and its terms, ``L_t`` in meters and ``L_q``, scalar tensors."""

    total: Tensor
    translation: Tensor
    orientation: Tensor


class JointLoss(nn.Module):
    """The joint loss with its learnable weights, or with fixed ones.

    Exclude the learnable ones from weight decay: they are not weights of the network, and zero is
    not a neutral value for them.

    Args:
        weights: Fixed ``(w_t, w_q)``, of the loss ``L = w_t L_t + w_q L_q``; None for learnable
            weights, parameters ``s_t`` and ``s_q``.
        s_t: Initial value of the translation's log weight.
        s_q: Initial value of the orientation's.
        antipodal: Whether the distance is to the nearer of q and -q, which are the same rotation.
            The paper's loss relies on canonical labels, and its gradient points the wrong way for a
            prediction near a half turn with the other sign.
    """

    def __init__(
        self,
        weights: tuple[float, float] | None = None,
        s_t: float = -3.0,
        s_q: float = -6.5,
        antipodal: bool = False,
    ) -> None:
        super().__init__()
        self.weights, self.antipodal = weights, antipodal
        if weights is None:
            self.s_t = nn.Parameter(torch.tensor(float(s_t)))
            self.s_q = nn.Parameter(torch.tensor(float(s_q)))

    def joined(self, translation: Tensor, orientation: Tensor) -> LossTerms:
        """Return the loss, Eq. 11 where weights are learnable, for two given terms, scalars."""
        if self.weights is not None:
            w_t, w_q = self.weights
            total = w_t * translation + w_q * orientation
        else:
            total = (
                translation * torch.exp(-self.s_t)
                + self.s_t
                + orientation * torch.exp(-self.s_q)
                + self.s_q
            )
        return LossTerms(total, translation, orientation)

    def quaternion_distance(self, q_hat: Tensor, q: Tensor) -> Tensor:
        """Return the distance ``(B,)`` of unit quaternions ``(B, 4)`` (Eq. 10)."""
        distance: Tensor = torch.linalg.vector_norm(q - q_hat, dim=-1)
        if not self.antipodal:
            return distance
        return torch.minimum(distance, torch.linalg.vector_norm(q + q_hat, dim=-1))
