"""Training: configuration, stages, the training loop, checkpoints.

What loads torch is imported on first access, so that reading a configuration does not.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING

from ffpose.training.config import DataConfig, LossConfig, OptimizerConfig, TrainConfig
from ffpose.training.stages import PAPER_STAGES, Stage

if TYPE_CHECKING:
    from ffpose.training.checkpoint import RunFolder
    from ffpose.training.engine import NonFiniteLossError, TrainResult, train

__all__ = [
    "PAPER_STAGES",
    "DataConfig",
    "LossConfig",
    "NonFiniteLossError",
    "OptimizerConfig",
    "RunFolder",
    "Stage",
    "TrainConfig",
    "TrainResult",
    "train",
]


def __getattr__(name: str) -> object:
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    home = "checkpoint" if name == "RunFolder" else "engine"
    return getattr(importlib.import_module(f"ffpose.training.{home}"), name)
