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
from torch.optim.swa_utils import get_ema_multi_avg_fn

WARM_UP = 10.0

Model = TypeVar("Model", bound=nn.Module)


class AveragedModel(Generic[Model]):
    """A copy of a network whose weights are the moving average of its; the decay 0 keeps none."""

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
        decay = min(self.decay, self.steps / (self.steps + WARM_UP))
        move = get_ema_multi_avg_fn(decay)  # type: ignore[no-untyped-call]  # torch's own
        states = (each.state_dict().values() for each in (self.model, self.trained))
        pairs = list(zip(*states, strict=True))
        averages, values = zip(*(p for p in pairs if p[0].is_floating_point()), strict=True)
        move(averages, values, None)
        for average, value in pairs:
            if not average.is_floating_point():
                average.copy_(value)

    def state_dict(self) -> dict[str, Any]:
        """Return the average and the number of steps, as `load_state_dict` takes them."""
        return {"steps": self.steps, "model": self.model.state_dict()} if self.decay > 0 else {}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restore what `state_dict` returned."""
        if self.decay > 0:
            self.steps = state["steps"]
            self.model.load_state_dict(state["model"])
