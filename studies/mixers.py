"""What mixes the cells of a polar second look, at an equal budget.

The learning rate is constant after its warm-up and the validated weights are a moving average, so
that the end of every epoch is a result of its own: runs can be compared after equal samples and
after equal time.
"""

from __future__ import annotations

from pathlib import Path

from ffpose.training.config import DataConfig, OptimizerConfig, TrainConfig
from studies.study import Study, Variant

BASE = TrainConfig(
    data=DataConfig(
        "scenes",
        Path("views"),
        scene="soyuz_easy",
        count=4000,
        empty=400,
        decoys=400,
        validation=100,
        seed=202,
        cache=True,
        workers=2,
    ),
    out=Path(),
    model="polar",
    model_fields={"looks": 1},
    backbone_weights="none",
    epochs=15,
    batch_size=32,
    ema=0.998,
    optimizer=OptimizerConfig(
        kind="adamw",
        learning_rate=1e-3,
        eps=1e-8,
        schedule="step",
        step_epochs=1_000_000,
        warmup_epochs=1.0,
        clip_norm=1.0,
    ),
)
"""As usual a second look goes where the one before found the object, and its pose is the result;
with more ``looks`` the pose would be the mean of several."""

ABOUT = {
    "filter": "spectral filters",
    "depthwise3": "depthwise 3 x 3",
    "depthwise7": "depthwise 7 x 7",
    "attention": "attention",
    "filterformer": "attention and filters",
}

MIXERS = Study(
    name="mixers",
    about="What mixes the cells of a polar second look: filter, convolutions, attention.",
    base=BASE,
    variants=tuple(
        Variant(mixer, f"polar, {about}", {"model_fields": {"mixer": mixer}})
        for mixer, about in ABOUT.items()
    ),
    notes="The variants are the preset polar with looks=1, equal but for what mixes the cells in "
    "its blocks. Each takes two second looks, the second where the first found the object, and its "
    "pose alone is the result.",
)
