"""Ablation of what makes a network learn attitude: each part removed or changed alone.

The learning rate is constant after its warm-up and the validated weights are a moving average, so
that the end of every epoch is a result of its own: runs can be compared after equal samples and
after equal time.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

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
    model="compact",
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
"""Two looks, flatten and linear, bins, dense supervision, exact augmentation of the views."""

FRAME = {
    "model_fields": {
        "orientation_view": "frame",
        "image_size": [96, 128],
        "backbone": "compact_resnet",
    },
    "data": {"augmentation": {"roll": 180.0, "contrast": 0.0, "saturation": 0.0, "noise": 0.04}},
    "loss": {"s_t": 0.0, "s_q": 0.0},
}
"""The whole image, of about the pixels that both looks have together, seen by the backbone of the
second; turned about the optical axis and varied as the views are. Cross-entropy and meters begin
with equal weights."""

NO_AUGMENTATION = {
    "views": {"roll_deg": 0.0, "twist_deg": 0.0, "brightness": 0.0, "noise": 0.0, "blur": 0.0}
}


def filterformer(filter: str, pooling: str) -> dict[str, Any]:
    """Return the changes that put two filterformer blocks into both branches."""
    return {"model_fields": {"depth": 2, "filter": filter, "pooling": pooling}}


ATTITUDE = Study(
    name="attitude",
    about="What view, dense supervision, head, augmentation and branch bring, each changed alone.",
    base=BASE,
    variants=(
        Variant("base", "two looks, dense, bins, augmented, flatten + linear"),
        Variant("view-frame", "one look, at the whole image", FRAME),
        Variant("no-dense", "no dense supervision", {"object_loss": {"coordinates": 0, "mask": 0}}),
        Variant("head-6d", "6-D regression", {"model_fields": {"orientation_head": "6d"}}),
        Variant(
            "head-quaternion",
            "quaternion regression",
            {"model_fields": {"orientation_head": "quaternion"}},
        ),
        Variant("no-augmentation", "views neither turned nor varied", NO_AUGMENTATION),
        Variant(
            "filterformer-tokens",
            "two blocks with token filters, pose token",
            filterformer("tokens", "token"),
        ),
        Variant(
            "filterformer-grid",
            "two blocks with grid filters, pose token",
            filterformer("grid", "token"),
        ),
        Variant(
            "transformer",
            "two blocks without filters, pose token",
            filterformer("none", "token"),
        ),
    ),
    notes="The first look's errors are drawn in every variant, for without them the second look "
    "does not learn what it will see. The frame's images show the same scenes as the views, at "
    "128 x 96 pixels, and are tested at that size; a network that looks at the frame alone has no "
    "dense supervision. A filterformer variant has its blocks in both branches, in the place of "
    "flatten + linear.",
)

FILTERS = Study(
    name="filters",
    about="What the filter of the filterformer block brings: tokens, grid, none.",
    base=BASE,
    variants=(
        Variant("tokens", "filter over tokens and channels", filterformer("tokens", "flatten")),
        Variant("grid", "filter over rows and columns", filterformer("grid", "flatten")),
        Variant("none", "no filter: attention alone", filterformer("none", "flatten")),
    ),
    notes="Two blocks before flatten + linear in both branches; all else as in the base of the "
    "study attitude, which is the same network without blocks.",
)


def polar(**fields: Any) -> dict[str, Any]:
    """Return the changes that make the second look polar.

    As in the study's base, a second look goes where the one before found the object, and its pose
    is the result. With more ``looks`` the pose would be the mean of two.
    """
    return {"model": "polar", "model_fields": {"looks": 1, **fields}}


MIXERS = Study(
    name="mixers",
    about="What mixes the cells of a polar second look: filter, convolutions, attention.",
    base=BASE,
    variants=(
        Variant("filter", "polar, spectral filters", polar()),
        Variant("depthwise3", "polar, depthwise 3 x 3", polar(mixer="depthwise3")),
        Variant("depthwise7", "polar, depthwise 7 x 7", polar(mixer="depthwise7")),
        Variant("attention", "polar, attention", polar(mixer="attention")),
        Variant("filterformer", "polar, attention and filters", polar(mixer="filterformer")),
        Variant("compact", "rows and columns, residual convolutions"),
    ),
    notes="The polar variants are the preset polar with looks=1, equal but for what mixes the "
    "cells in its blocks; the last is the base of the study attitude. Each takes two second looks, "
    "the second where the first found the object, and its pose alone is the result.",
)
