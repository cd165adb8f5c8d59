"""The learning rate as a pure function of the epoch: a resumed run needs no memory of it."""

from __future__ import annotations

import math

from ffpose.training.config import OptimizerConfig


def learning_rate(optimizer: OptimizerConfig, position: float, epochs: int) -> float:
    """Return the learning rate at a point of a stage.

    The warm-up rises linearly and multiplies what the schedule gives.

    Args:
        optimizer: The schedule and its figures.
        position: Epochs since the stage began, with a fraction; ``0 <= position <= epochs``. The
            engine takes the middle of a step, where no step has the rate of another epoch, and
            neither warm-up nor cosine a rate of zero.
        epochs: How many epochs the stage has.

    Example:
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
