"""The size of the demo, and the training that it can do."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ffpose.datasets.scenes import find_scene
from ffpose.render import Scene
from ffpose.training import DataConfig, OptimizerConfig, TrainConfig
from ffpose.training.config import TEST_SEEDS, ViewAugmentation

SCENE = "soyuz_easy"


@dataclass(frozen=True)
class DemoConfig:
    """The size of the demo; with the defaults it takes a minute or two on two cores.

    Attributes:
        images: How many unseen images are rendered and posed.
        size: Width and height of the images.
        attitude_range_deg: Roll, pitch and yaw lie within plus and minus these angles.
        seed: Seed of the images.
        workers: Processes that render, and that train together.
        train: Pose with a network trained here from nothing, six minutes in all on two cores.
        views: Of a training: rendered views to learn from; one in ten more show no spacecraft.
        validation: Of a training: whole images that choose the best epoch.
        epochs: Of a training: passes over the views.
        model_fields: Of a training: fields of the model's configuration "compact" to change.
    """

    images: int = 500
    size: tuple[int, int] = (512, 384)
    attitude_range_deg: tuple[float, float, float] = (180.0, 90.0, 180.0)
    seed: int = TEST_SEEDS
    workers: int = 2
    train: bool = False
    views: int = 3000
    validation: int = 30
    epochs: int = 24
    model_fields: tuple[tuple[str, Any], ...] = ()

    @property
    def scene(self) -> Scene:
        """The set of the images."""
        return find_scene(SCENE, self.attitude_range_deg)

    def training(self, out: Path) -> TrainConfig:
        """Return a training that learns in some ten thousand samples.

        Its views vary less than those of the shipped weights: a short training learns sooner.

        Args:
            out: The demo's folder; ``views/`` and ``training/`` of it are written.
        """
        return TrainConfig(
            data=DataConfig(
                "scenes",
                out / "views",
                scene=SCENE,
                count=self.views,
                empty=self.views // 10,
                validation=self.validation,
                workers=self.workers,
                attitude_range_deg=self.attitude_range_deg,
            ),
            out=out / "training",
            model="compact",
            model_fields=dict(self.model_fields),
            backbone_weights="none",
            epochs=self.epochs,
            batch_size=max(1, 32 // self.workers),
            processes=self.workers,
            ema=0.998,
            optimizer=OptimizerConfig(
                kind="adamw",
                learning_rate=2e-3,
                eps=1e-8,
                schedule="cosine",
                warmup_epochs=1.0,
                clip_norm=1.0,
            ),
            views=ViewAugmentation(
                look_outliers=0.02, brightness=0.15, noise=0.02, blur=0.2, empty=0.06
            ),
        )
