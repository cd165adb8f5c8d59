"""Training: configuration, stages, the training loop, checkpoints.

Names are imported on first access, so that reading a configuration does not load torch.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ffpose.training.checkpoint import RunFolder
    from ffpose.training.config import DataConfig, LossConfig, OptimizerConfig, TrainConfig
    from ffpose.training.engine import NonFiniteLossError, TrainResult, train
    from ffpose.training.stages import PAPER_STAGES, Stage

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

_HOMES = {
    "checkpoint": ("RunFolder",),
    "config": ("DataConfig", "LossConfig", "OptimizerConfig", "TrainConfig"),
    "engine": ("NonFiniteLossError", "TrainResult", "train"),
    "stages": ("PAPER_STAGES", "Stage"),
}


def __getattr__(name: str) -> object:
    for home, names in _HOMES.items():
        if name in names:
            return getattr(importlib.import_module(f"ffpose.training.{home}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
