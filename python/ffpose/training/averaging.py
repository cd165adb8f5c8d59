"""Exponential moving average (EMA) of the weights, which is what is validated and saved.

Polyak and Juditsky, "Acceleration of Stochastic Approximation by Averaging", 1992: the average of
the last steps lies nearer to the minimum than any one of them. Batch norm's running statistics are
averaged with the weights. The decay is smaller in the first steps, so that the initial weights are
soon forgotten.
"""

from __future__ import annotations

from copy import deepcopy
from typing import Any, Generic, TypeVar

import torch
from torch import nn

from ffpose._internal.torch_internals import move_toward

WARM_UP = 10.0

Model = TypeVar("Model", bound=nn.Module)


class AveragedModel(Generic[Model]):
    """A copy of a network whose weights are the moving average of the network's.

    Args:
        model: The network being trained.
        decay: Weight of the old average in each step; 0 keeps no average.

    Attributes:
        model: The averaged network, to validate and save.
        steps: Number of steps averaged so far.
    """

    def __init__(self, model: Model, decay: float) -> None:
        self.decay = decay
        self.steps = 0
        self.trained = model
        self.model = deepcopy(model).requires_grad_(False) if decay > 0 else model

    @torch.no_grad()
    def update(self) -> None:
        """Update the average after a step of the optimizer."""
        if self.decay == 0:
            return
        self.steps += 1
        weight = 1 - min(self.decay, self.steps / (self.steps + WARM_UP))
        averages, values = [], []
        pairs = zip(
            self.model.state_dict().values(), self.trained.state_dict().values(), strict=True
        )
        for average, value in pairs:
            if average.is_floating_point():
                averages.append(average)
                values.append(value)
            else:
                average.copy_(value)
        move_toward(averages, values, weight)

    def state_dict(self) -> dict[str, Any]:
        """Return the average and the number of steps, as `load_state_dict` takes them."""
        return {"steps": self.steps, "model": self.model.state_dict()} if self.decay > 0 else {}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restore what `state_dict` returned."""
        if self.decay > 0:
            self.steps = state["steps"]
            self.model.load_state_dict(state["model"])
