"""Settings of the demo and of its optional training."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from ffpose._internal.seeds import CHOICES
from ffpose.models.base import find_device
from ffpose.render import Scene, find_scene
from ffpose.render.scene import ALL_ATTITUDES
from ffpose.training import DataConfig, TrainConfig
from ffpose.training.config import MUON, PatchAugmentation

SCENE = "soyuz_easy"


@dataclass(frozen=True)
class DemoConfig:
    """Settings of the demo; the defaults take a minute on two cores.

    Attributes:
        images: Number of unseen images to render and evaluate.
        size: Width and height of the images.
        seed: Seed of the images.
        workers: Number of processes that render, and on a CPU train together.
        train: Use a network trained here from scratch, in about six minutes on two cores after one
            of rendering.
        views: Number of rendered training views of the spacecraft (`rendered_views` counts all).
        validation: Number of whole validation images, which select the best epoch.
        calibration: Number of images of each kind that calibrate the network.
        epochs: Number of passes over the views.
        model_fields: Overrides of fields of the model configuration "polar".
    """

    images: int = 200
    size: tuple[int, int] = (512, 384)
    seed: int = CHOICES.start
    workers: int = 2
    train: bool = False
    views: int = 3000
    validation: int = 30
    calibration: int = 40
    epochs: int = 32
    model_fields: tuple[tuple[str, Any], ...] = ()

    @property
    def scene(self) -> Scene:
        """Set that the images are rendered from, of all attitudes."""
        return find_scene(SCENE, ALL_ATTITUDES)

    @property
    def negatives(self) -> int:
        """Number of training views without any spacecraft, and as many of other spacecraft.

        The threshold that flags is chosen on images of other spacecraft alone, and has to hold for
        those without any, so both are learned.
        """
        return self.views // 10

    @property
    def rendered_views(self) -> int:
        """Number of all training views."""
        return self.views + 2 * self.negatives

    def training(self, out: Path) -> TrainConfig:
        """Return a training that learns from 96,000 samples, in folders of the demo's.

        Its views vary less than those of the shipped weights: a short training learns sooner.
        On a GPU one process trains, on a CPU all workers do.
        """
        processes = self.workers if find_device("auto").type == "cpu" else 1
        return TrainConfig(
            data=DataConfig(
                "scenes",
                out / "views",
                scene=SCENE,
                count=self.views,
                empty=self.negatives,
                decoys=self.negatives,
                validation=self.validation,
                calibration=self.calibration,
                workers=self.workers,
            ),
            out=out / "training",
            model="polar",
            model_fields=dict(self.model_fields),
            backbone_weights="none",
            epochs=self.epochs,
            batch_size=max(1, 32 // processes),
            processes=processes,
            ema=0.998,
            autocast="auto",
            optimizer=replace(MUON, warmup_epochs=1.0),
            views=PatchAugmentation(
                look_outliers=0.02, brightness=0.15, noise=0.02, blur=0.2, empty=0.06
            ),
        )
