"""The learning rate as a pure function of the epoch, so that checkpoints need no scheduler."""

from __future__ import annotations

import math

from ffpose.training.config import OptimizerConfig


def learning_rate(optimizer: OptimizerConfig, position: float, epochs: int) -> float:
    """Return the learning rate at a position in a stage of so many epochs, 0 to ``epochs``.

    The warm-up factor rises linearly and multiplies the schedule's rate. The engine passes the
    middle of a step, so that neither warm-up nor cosine gives a rate of zero.

    Examples:
        >>> paper = OptimizerConfig()
        >>> [f"{learning_rate(paper, epoch, 500):.0e}" for epoch in (0.1, 199.9, 200, 400.5)]
        ['1e-04', '1e-04', '1e-05', '1e-06']
    """
    warmup = optimizer.warmup_epochs
    rise = min(1.0, position / warmup) if warmup > 0 else 1.0
    if optimizer.schedule == "cosine":
        fall = 0.5 * (1 + math.cos(math.pi * position / epochs))
    else:
        fall = optimizer.step_factor ** (position // optimizer.step_epochs)
    return optimizer.learning_rate * rise * fall
