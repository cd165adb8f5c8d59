"""Trainings on rendered scenes, in small."""

from ffpose.training import DataConfig, OptimizerConfig, TrainConfig

COUNT = 4
"""Images that validate, and images of each kind that calibrate."""

FIELDS = {
    "image_size": [96, 128],
    "first_stride": 4,
    "first_channels": 16,
    "object_size": [16, 96],
    "object_width": 48,
    "channels": [8, 16, 24],
    "blocks": [1, 1],
    "latent": 32,
    "directions": 50,
    "distance_m": [8.0, 22.0],
}


def scenes_config(root, out, **fields):
    """Two epochs of three batches, of all that a run on scenes may use."""
    values = {
        "data": DataConfig(
            *("scenes", root),
            scene="soyuz_easy",
            count=12,
            validation=COUNT,
            calibration=COUNT,
            empty=2,
            decoys=1,
            seed=3,
        ),
        "out": out,
        "model": "polar",
        "model_fields": FIELDS,
        "backbone_weights": "none",
        "epochs": 2,
        "batch_size": 4,
        "ema": 0.9,
        "optimizer": OptimizerConfig(kind="adamw", learning_rate=1e-3),
        "device": "cpu",
    }
    return TrainConfig(**(values | fields))
