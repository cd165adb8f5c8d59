"""The joint loss of translation and orientation (Ye et al., Sensors 2023, 23, 8633, Eq. 9-11).

``L = L_t exp(-s_t) + s_t + L_q exp(-s_q) + s_q`` with ``L_t = ||t - t_hat||`` and
``L_q = ||q - q_hat / ||q_hat|| ||``, each a mean over the batch, and two learnable weights s_t and
s_q (Kendall and Cipolla, CVPR 2017). The printed start values lost their minus signs: they are -3
and -6.5.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor, nn

from ffpose.ops import normalize_quaternion


class LossTerms(NamedTuple):
    """A loss and what it is made of, each a tensor without axes.

    Attributes:
        total: Eq. 11, to be minimized.
        translation: ``L_t``, Eq. 9, meters.
        orientation: ``L_q``, Eq. 10.
    """

    total: Tensor
    translation: Tensor
    orientation: Tensor


class PoseLoss(nn.Module):
    """The joint loss with its learnable weights.

    An optimizer with weight decay must leave ``s_t`` and ``s_q`` out of it: they are no weights of
    the network, and zero is no neutral value for them.

    Args:
        s_t: Start of the translation's log weight.
        s_q: Start of the orientation's log weight.
        antipodal: Measure the distance to the nearer of q and -q, which are one rotation. The
            paper's loss (False) relies on labels of one sign, and pulls the wrong way for a
            prediction near a half turn that chose the other sign.
    """

    def __init__(self, s_t: float = -3.0, s_q: float = -6.5, antipodal: bool = False) -> None:
        super().__init__()
        self.s_t = nn.Parameter(torch.tensor(float(s_t)))
        self.s_q = nn.Parameter(torch.tensor(float(s_q)))
        self.antipodal = antipodal

    def forward(self, t_hat: Tensor, q_hat: Tensor, t: Tensor, q: Tensor) -> LossTerms:
        """Compare predictions with labels.

        Args:
            t_hat: Predicted translations ``(B, 3)``, meters.
            q_hat: Predicted quaternions ``(B, 4)``, ``(w, x, y, z)``, of any norm but zero.
            t: True translations ``(B, 3)``.
            q: True quaternions ``(B, 4)``, of norm one.

        Returns:
            The loss and its terms.

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
            self._quaternion_distance(q, normalize_quaternion(q_hat)).mean(),
        )

    def joined(self, translation: Tensor, orientation: Tensor) -> LossTerms:
        """Return Eq. 11 of two means: for an orientation head with a loss of its own."""
        total = (
            translation * torch.exp(-self.s_t)
            + self.s_t
            + orientation * torch.exp(-self.s_q)
            + self.s_q
        )
        return LossTerms(total, translation, orientation)

    def _quaternion_distance(self, q: Tensor, q_hat: Tensor) -> Tensor:
        distance: Tensor = torch.linalg.vector_norm(q - q_hat, dim=-1)
        if not self.antipodal:
            return distance
        return torch.minimum(distance, torch.linalg.vector_norm(q + q_hat, dim=-1))
