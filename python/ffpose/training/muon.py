"""Muon: steps along the orthogonalized momentum of each matrix, and AdamW for all other weights.

A matrix's step is the orthogonal matrix next to its momentum, so that all directions of a layer
move alike, the rare ones too, which single weights' scales (Adam) leave behind (Jordan et al.,
"Muon: An optimizer for hidden layers in neural networks", 2024). Its length is that of AdamW's
steps, so both take one learning rate (Liu et al., "Muon is Scalable for LLM Training",
arXiv:2502.16982, 2025). `torch.optim.Muon` takes no convolutions.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import torch
from torch import Tensor, nn
from torch.optim.adamw import adamw

MOMENTUM = 0.95
BETAS = (0.9, 0.999)

RMS = 0.2
"""Root mean square of the elements of AdamW's steps, of which a matrix's are, in learning rates."""

QUINTIC = (3.4445, -4.7750, 2.0315)
"""Coefficients of the iteration, steepest at zero: singular values reach 0.7 to 1.2 (Jordan)."""

ITERATIONS = 5

COLORS = 3
"""Layers of so few input channels read pixels: their weights are stepped by AdamW."""


class Muon(torch.optim.Optimizer):
    """Muon for parameters in groups whose ``matrix`` is true, AdamW for those of the others.

    Weight decay is decoupled. Of more than two dimensions, those after the first are the columns.
    """

    def __init__(self, groups: list[dict[str, Any]], lr: float, eps: float) -> None:
        super().__init__(groups, {"lr": lr, "eps": eps, "weight_decay": 0.0, "matrix": False})

    @torch.no_grad()
    def step(self, closure: None = None) -> None:  # type: ignore[override]  # evaluates none
        """Take a step along the gradients; parameters without one stay."""
        for group in self.param_groups:
            step = self._step_matrices if group["matrix"] else self._step_others
            step(group, [each for each in group["params"] if each.grad is not None])

    def _step_matrices(self, group: dict[str, Any], parameters: list[Tensor]) -> None:
        for parameter in parameters:
            gradient, state = parameter.grad, self.state[parameter]
            assert gradient is not None
            if not state:
                state["momentum"] = torch.zeros_like(parameter)
            momentum = state["momentum"].lerp_(gradient, 1 - MOMENTUM)
            direction = orthogonalized(gradient.lerp(momentum, MOMENTUM).flatten(1))  # Nesterov
            length = RMS * math.sqrt(max(direction.shape))
            parameter.mul_(1 - group["lr"] * group["weight_decay"])
            parameter.sub_(direction.view_as(parameter), alpha=group["lr"] * length)

    def _step_others(self, group: dict[str, Any], parameters: list[Tensor]) -> None:
        states = [self.state[parameter] for parameter in parameters]
        for parameter, state in zip(parameters, states, strict=True):
            if not state:
                state["step"] = torch.zeros((), device=parameter.device)
                state["mean"] = torch.zeros_like(parameter)
                state["square"] = torch.zeros_like(parameter)
        adamw(
            parameters,
            [each.grad for each in parameters if each.grad is not None],
            [state["mean"] for state in states],
            [state["square"] for state in states],
            [],
            [state["step"] for state in states],
            fused=True,
            amsgrad=False,
            beta1=BETAS[0],
            beta2=BETAS[1],
            lr=group["lr"],
            weight_decay=group["weight_decay"],
            eps=group["eps"],
            maximize=False,
        )

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Restore what `state_dict` returned, counts of steps too on their parameters' devices."""
        super().load_state_dict(state_dict)
        for parameter, state in self.state.items():
            if "step" in state:
                state["step"] = state["step"].to(parameter.device)


def orthogonalized(matrix: Tensor) -> Tensor:
    """Return about the orthogonal matrix next to one, ``U V'`` of its ``U S V'``; zero of zero.

    Newton and Schulz's iteration, whose few products take no decomposition. Singular values become
    0.7 to 1.2, those below 0.01 of the root of the sum of their squares less.
    """
    a, b, c = QUINTIC
    tall = matrix.shape[0] > matrix.shape[1]
    x: Tensor = matrix.T if tall else matrix
    x = x / x.norm().clamp_min(1e-30)
    for _ in range(ITERATIONS):
        square = x @ x.T
        x = a * x + (b * square + c * square @ square) @ x
    return x.T if tall else x


def matrices(model: nn.Module) -> Iterator[Tensor]:
    """Yield the weights that mix features: of Linears and convolutions, but not those of pixels."""
    for module in model.modules():
        match module:
            case nn.Linear() | nn.Conv2d(groups=1) if module.weight.shape[1] > COLORS:
                yield module.weight
