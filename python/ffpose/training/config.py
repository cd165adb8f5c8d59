"""What a training run is asked to do: plain dataclasses, read from flags or from a YAML file.

Nothing heavy is imported here, so that ``ffpose train --help`` answers at once. The defaults are
those of the paper (section 4.3) where it gives a figure.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal, get_args

from ffpose.training.stages import JOINT_STAGE, Stage

ModelName = Literal["base", "small", "tiny"]
"""The keys of `ffpose.models.CONFIGS`, known here without torch: a wrong one is refused at once."""


def _expect(condition: bool, name: str, expected: str, got: object) -> None:
    """Raise a ValueError that says what ``name`` should have been, unless ``condition``."""
    if not condition:
        raise ValueError(f"{name}: expected {expected}, got {got!r}")


@dataclass(frozen=True)
class DataConfig:
    """Which images to train on, and how they are read.

    Attributes:
        kind: The layout of the image set, such as urso.
        root: The folder of the image set.
        mode: How an image becomes the network's input: the whole frame resized, or the paper's
            resize and centre crop.
        augment: Whether to vary the training images.
        augmentation: Fields of `ffpose.transforms.Augmentation` to change, such as {"roll": 10}.
        cache: Whether to keep the decoded and resized images in memory.
        workers: Processes that read images beside the training process.
    """

    kind: str
    root: Path
    mode: Literal["resize", "center_crop"] = "resize"
    augment: bool = True
    augmentation: dict[str, Any] = field(default_factory=dict)
    cache: bool = False
    workers: int = 0

    def __post_init__(self) -> None:
        _expect(self.workers >= 0, "data.workers", "0 or more", self.workers)


@dataclass(frozen=True)
class OptimizerConfig:
    """Adam and its learning rate.

    Attributes:
        learning_rate: The highest learning rate.
        weight_decay: Pull of the model's weights towards zero; the loss weights have none.
        eps: Adam's epsilon.
        clip_norm: Largest norm of the gradient; zero leaves it as it is.
        schedule: "step" multiplies the learning rate by step_factor every step_epochs; "cosine"
            lets it fall to zero at the end of each stage.
        step_epochs: Epochs between two steps.
        step_factor: What a step multiplies the learning rate by.
        warmup_epochs: Epochs, or a part of one, over which the learning rate first rises from zero.
    """

    learning_rate: float = 1e-4
    weight_decay: float = 1e-4
    eps: float = 1e-10
    clip_norm: float = 0.0
    schedule: Literal["step", "cosine"] = "step"
    step_epochs: int = 200
    step_factor: float = 0.1
    warmup_epochs: float = 0.0

    def __post_init__(self) -> None:
        _expect(
            self.learning_rate > 0, "optimizer.learning_rate", "more than 0", self.learning_rate
        )
        _expect(self.weight_decay >= 0, "optimizer.weight_decay", "0 or more", self.weight_decay)
        _expect(self.eps > 0, "optimizer.eps", "more than 0", self.eps)
        _expect(self.clip_norm >= 0, "optimizer.clip_norm", "0 or more", self.clip_norm)
        _expect(self.step_epochs >= 1, "optimizer.step_epochs", "1 or more", self.step_epochs)
        _expect(self.step_factor > 0, "optimizer.step_factor", "more than 0", self.step_factor)
        _expect(self.warmup_epochs >= 0, "optimizer.warmup_epochs", "0 or more", self.warmup_epochs)
        known = ("step", "cosine")
        _expect(self.schedule in known, "optimizer.schedule", " or ".join(known), self.schedule)


@dataclass(frozen=True)
class LossConfig:
    """The pose loss (paper, equations 9 to 11).

    Attributes:
        s_t: First value of the learnable weight of the translation.
        s_q: First value of the learnable weight of the orientation.
        antipodal: Whether q and -q count as one rotation, which equation 10 does not see.
    """

    s_t: float = -3.0
    s_q: float = -6.5
    antipodal: bool = False


@dataclass(frozen=True)
class TrainConfig:
    """All of a training run.

    Attributes:
        data: The images.
        out: The folder to write; it must not hold another run.
        model: Name of the model's configuration: base (the paper's), small or tiny.
        model_fields: Fields of that configuration to change, such as {"depth": 5}; a tuple becomes
            the list that a YAML file gives back.
        backbone_weights: "auto" (pretrained), "none" (random), or a file.
        normalize_translation: Whether the head predicts in units of the training split's spread
            about its mean, in place of raw metres.
        epochs: Epochs of the first stage, in place of the number that stages gives it.
        stages: What is trained, in which order; the first stage of the paper alone by default.
        batch_size: Images a step.
        optimizer: Adam and its learning rate.
        loss: The pose loss.
        seed: Seed of the weights, the order of the images, augmentation and dropout.
        device: "auto" (a GPU where there is one) or a name that torch knows.
    """

    data: DataConfig
    out: Path
    model: ModelName = "base"
    model_fields: dict[str, Any] = field(default_factory=dict)
    backbone_weights: str = "auto"
    normalize_translation: bool = True
    epochs: int | None = None
    stages: tuple[Stage, ...] = (JOINT_STAGE,)
    batch_size: int = 8
    optimizer: OptimizerConfig = field(default_factory=OptimizerConfig)
    loss: LossConfig = field(default_factory=LossConfig)
    seed: int = 0
    device: str = "auto"

    def __post_init__(self) -> None:
        _expect(len(self.stages) > 0, "stages", "at least one stage", self.stages)
        names = get_args(ModelName)
        _expect(self.model in names, "model", f"one of {', '.join(names)}", self.model)
        _expect(self.epochs is None or self.epochs >= 1, "epochs", "1 or more", self.epochs)
        _expect(self.batch_size >= 1, "batch_size", "1 or more", self.batch_size)
        _expect(self.seed >= 0, "seed", "0 or more", self.seed)
        fields = {k: list(v) if isinstance(v, tuple) else v for k, v in self.model_fields.items()}
        object.__setattr__(self, "model_fields", fields)

    @property
    def resolved_stages(self) -> tuple[Stage, ...]:
        """The stages, the first with ``epochs`` where that is given."""
        if self.epochs is None:
            return self.stages
        return (replace(self.stages[0], epochs=self.epochs), *self.stages[1:])
