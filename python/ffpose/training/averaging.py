"""Exponential moving average (EMA) of the weights, which is what is validated and saved.

Polyak and Juditsky, "Acceleration of Stochastic Approximation by Averaging", 1992: the average of
the last steps lies nearer to the minimum than any one of them. Batch norm's running statistics are
averaged with the weights. The decay is smaller in the first steps, so that the initial weights are
soon forgotten.

A share of weights that a training began from may be kept in the average: halfway between weights
and those fine-tuned from them there often lie weights that are as good as either where it is good
(WiSE-FT; Wortsman et al., "Robust fine-tuning of zero-shot models", CVPR 2022).
"""

from __future__ import annotations

from copy import deepcopy
from typing import Any, Generic, TypeVar

import torch
from torch import Tensor, nn
from torch.optim.swa_utils import get_ema_multi_avg_fn

WARM_UP = 10.0

Model = TypeVar("Model", bound=nn.Module)


class AveragedModel(Generic[Model]):
    """A copy of a network whose weights are the moving average of its; the decay 0 keeps none.

    ``init_share`` of the present weights stays in the copy's from now on.
    """

    def __init__(self, model: Model, decay: float, init_share: float = 0.0) -> None:
        self.decay = decay
        self.init_share = init_share
        self.steps = 0
        self.trained = model
        self.model = deepcopy(model).requires_grad_(False) if decay > 0 else model
        state = self.model.state_dict() if init_share > 0 else {}
        self.initial = {name: value.clone() for name, value in state.items()}

    @torch.no_grad()
    def update(self) -> None:
        """Update the average after a step of the optimizer."""
        if self.decay == 0:
            return
        self.steps += 1
        decay = min(self.decay, self.steps / (self.steps + WARM_UP))
        move = get_ema_multi_avg_fn(decay)  # type: ignore[no-untyped-call]  # torch's own
        averages, values = self.model.state_dict(), self.trained.state_dict()
        moved = [name for name, value in averages.items() if value.is_floating_point()]
        # The average of interpolated weights is the interpolated average.
        targets = [
            values[name].lerp(self.initial[name], self.init_share) if self.initial else values[name]
            for name in moved
        ]
        move([averages[name] for name in moved], targets, None)
        for name in averages.keys() - moved:
            averages[name].copy_(values[name])

    @torch.no_grad()
    def restart(self, state: dict[str, Tensor]) -> None:
        """Go on from an average, and give the network its weights, without what a share is kept of.

        The average of what does not change after that, as of a frozen part, stays.
        """
        self.steps = 0
        self.model.load_state_dict(state)  # which may be on another device
        self.trained.load_state_dict(
            {
                name: torch.lerp(self.initial[name], value, 1 / (1 - self.init_share))
                if self.initial and value.is_floating_point()
                else value
                for name, value in self.model.state_dict().items()
            }
        )

    def state_dict(self) -> dict[str, Any]:
        """Return the averages and the number of steps, as `load_state_dict` takes them."""
        if self.decay == 0:
            return {}
        return {"steps": self.steps, "model": self.model.state_dict(), "initial": self.initial}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restore what `state_dict` returned."""
        if self.decay > 0:
            self.steps = state["steps"]
            self.model.load_state_dict(state["model"])
            own, initial = self.model.state_dict(), state.get("initial", {})  # older ones lack it
            self.initial = {name: value.to(own[name].device) for name, value in initial.items()}
