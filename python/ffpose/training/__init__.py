"""Training: configuration, stages, the training loop (`ffpose.training.engine`), checkpoints.

Nothing here loads torch, so that reading a configuration does not.
"""

from ffpose.training.config import DataConfig, LossConfig, OptimizerConfig, TrainConfig
from ffpose.training.stages import PAPER_STAGES, Stage

__all__ = [
    "PAPER_STAGES",
    "DataConfig",
    "LossConfig",
    "OptimizerConfig",
    "Stage",
    "TrainConfig",
]
