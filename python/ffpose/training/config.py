"""What a training run is asked to do: plain dataclasses, read from flags or from a YAML file.

Nothing heavy is imported here, so that ``ffpose train --help`` answers at once. The defaults are
those of the paper (section 4.3) where it gives a figure.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal, get_args

from ffpose.training.stages import JOINT_STAGE, Stage

TEST_SEEDS = 1_000_000
"""From this seed on, scenes are for tests: no training renders them."""

ModelName = Literal["base", "small", "tiny", "compact"]
"""The keys of `ffpose.models.CONFIGS`, known here without torch: a wrong one is refused at once."""


def _expect(condition: bool, name: str, expected: str, got: object) -> None:
    """Raise a ValueError that says what ``name`` should have been, unless ``condition``."""
    if not condition:
        raise ValueError(f"{name}: expected {expected}, got {got!r}")


@dataclass(frozen=True)
class DataConfig:
    """Which images to train on, and how they are read.

    Attributes:
        kind: The layout of the image set: urso, speed, speedplus, cambridge, sevenscenes or csv
            (docs/datasets.md), or scenes, which are rendered.
        root: The folder of the image set.
        mode: How an image becomes the network's input: the whole frame resized, or the paper's
            resize and centre crop.
        augment: Whether to vary the training images.
        augmentation: Fields of `ffpose.transforms.Augmentation` to change, such as {"roll": 10}.
        cache: Whether to decode and resize each image once, into a file that later runs use too.
        workers: Processes that read or render images beside the training process.
        val_split: Name of the split that validates.
        holdout: Validate on every so manieth image of the training split, in place of val_split,
            and do not train on it; 0 holds none out.
        undistort: Whether to undistort the images of cameras with distortion.
        white: Level that becomes white in monochrome images of more than 8 bits, such as 4095 for
            12 bits; None for images of 8 bits.
        scene: For the kind scenes: the set whose scenes are rendered, or several, joined by a plus;
            the first validates.
        count: For the kind scenes: images of each set to learn from.
        validation: For the kind scenes: whole images that choose the best epoch.
        empty: For the kind scenes: images without the spacecraft, which a network with a second
            look learns to refuse.
        decoys: For the kind scenes: images of other spacecraft, which it learns to refuse as well.
        cut: For the kind scenes: images of each set whose spacecraft the border cuts.
        randomized: For the kind scenes: images of each set whose light, materials and backgrounds
            are not real.
        seed: For the kind scenes: seed of the images, below `TEST_SEEDS`.
        attitude_range_deg: For the kind scenes: roll, pitch and yaw lie within plus and minus
            these angles.
    """

    kind: str
    root: Path
    mode: Literal["resize", "center_crop"] = "resize"
    augment: bool = True
    augmentation: dict[str, Any] = field(default_factory=dict)
    cache: bool = False
    workers: int = 0
    val_split: str = "val"
    holdout: int = 0
    undistort: bool = False
    white: float | None = None
    scene: str = "soyuz_hard"
    count: int = 10000
    validation: int = 200
    empty: int = 1000
    decoys: int = 1000
    cut: int = 0
    randomized: int = 0
    seed: int = 0
    attitude_range_deg: tuple[float, float, float] = (180.0, 90.0, 180.0)

    def __post_init__(self) -> None:
        _expect(self.workers >= 0, "data.workers", "0 or more", self.workers)
        _expect(self.holdout == 0 or self.holdout > 1, "data.holdout", "0, 2 or more", self.holdout)
        usable = self.white is None or 0 < self.white < math.inf
        _expect(usable, "data.white", "a positive level", self.white)
        _expect(self.count >= 1, "data.count", "1 or more", self.count)
        _expect(self.validation >= 1, "data.validation", "1 or more", self.validation)
        for name in ("empty", "decoys", "cut", "randomized"):
            _expect(getattr(self, name) >= 0, f"data.{name}", "0 or more", getattr(self, name))
        expected = f"0 to {TEST_SEEDS - 1}, as later seeds are for tests"
        _expect(0 <= self.seed < TEST_SEEDS, "data.seed", expected, self.seed)


@dataclass(frozen=True)
class OptimizerConfig:
    """Adam and its learning rate.

    Attributes:
        kind: "adam", as published, or "adamw", whose weight decay is apart from the gradient
            (Loshchilov and Hutter, "Decoupled Weight Decay Regularization", ICLR 2019).
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

    kind: Literal["adam", "adamw"] = "adam"
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
        kinds = ("adam", "adamw")
        _expect(self.kind in kinds, "optimizer.kind", " or ".join(kinds), self.kind)
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
class ObjectLossConfig:
    """Weights of the terms.

    Attributes:
        location: Of the first look.
        orientation: Of the orientation head's loss.
        angle: Of the sine of half the angle of the decoded attitude. Soft labels some degrees wide
            hardly feel the last degrees; this does, once they have found the attitude.
        offset: Of the second look's position.
        sigma: Of the likelihoods.
        in_view: Of the presence.
        coordinates: Of the object's coordinates; zero, with ``mask``, leaves dense supervision out.
        mask: Of its silhouette.
    """

    location: float = 10.0
    orientation: float = 1.0
    angle: float = 0.0
    offset: float = 3.0
    sigma: float = 0.1
    in_view: float = 0.5
    coordinates: float = 6.0
    mask: float = 2.0

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not value >= 0:
                raise ValueError(f"{name}: expected 0 or more, got {value}")

    @property
    def dense(self) -> bool:
        """Whether there is dense supervision."""
        return self.coordinates > 0 or self.mask > 0


@dataclass(frozen=True)
class ViewAugmentation:
    """How the views of a training sample vary.

    Attributes:
        roll_deg: Greatest turn of the first look's camera about its axis.
        look_lateral: Standard deviation of the first look's error across the viewing ray, as a
            part of the virtual camera's radius at the object.
        look_distance: The same along the ray, of the logarithm of the distance.
        look_outliers: Part of the samples whose errors are three times as large.
        twist_deg: Greatest turn of the virtual camera about the viewing ray.
        brightness: Standard deviation of the logarithm (base 2) of a factor.
        noise: Greatest standard deviation of Gaussian noise, of the range [0, 1].
        blur: Greatest share of a copy of half the resolution.
        empty: Part of the samples that show no object.
        frames: Part of the samples whose frame is given to the first look, which learns sooner.
    """

    roll_deg: float = 180.0
    look_lateral: float = 0.08
    look_distance: float = 0.09
    look_outliers: float = 0.05
    twist_deg: float = 180.0
    brightness: float = 0.25
    noise: float = 0.04
    blur: float = 0.5
    empty: float = 0.1
    frames: float = 0.25

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            most = 180.0 if name.endswith("_deg") else 1.0
            if not 0 <= value <= most:
                raise ValueError(f"{name}: expected a number from 0 to {most:g}, got {value}")


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
        batch_size: Images whose gradients are computed at once.
        accumulate: Batches whose gradients make one step.
        processes: Processes on this machine that train together, each on batches of its own; under
            ``torchrun``, which starts them itself, 1.
        ema: Share of the moving average of the weights that stays at each step, such as 0.998; the
            average is what is validated and saved. 0 keeps none.
        autocast: "none", or "bfloat16" for the network's matrix products and convolutions.
        init: Weights to start from: of a network of the same architecture, or of one that lacks
            extra blocks (`ffpose.models.compact_resnet`), which begin as their skip connection.
        optimizer: Adam and its learning rate.
        loss: The pose loss of a network that looks at the frame alone.
        object_loss: The loss of a network with a second look.
        views: How the views of such a network's samples vary.
        seed: Seed of the weights, the order of the images, augmentation and dropout.
        device: "auto" (a GPU where there is one) or a name that torch knows.
        weights_dtype: Of the saved weights: "float32", or "float16" for files of half the size.
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
    accumulate: int = 1
    processes: int = 1
    ema: float = 0.0
    autocast: Literal["none", "bfloat16"] = "none"
    init: Path | None = None
    optimizer: OptimizerConfig = field(default_factory=OptimizerConfig)
    loss: LossConfig = field(default_factory=LossConfig)
    object_loss: ObjectLossConfig = field(default_factory=ObjectLossConfig)
    views: ViewAugmentation = field(default_factory=ViewAugmentation)
    seed: int = 0
    device: str = "auto"
    weights_dtype: Literal["float32", "float16"] = "float32"

    def __post_init__(self) -> None:
        _expect(len(self.stages) > 0, "stages", "at least one stage", self.stages)
        names = get_args(ModelName)
        _expect(self.model in names, "model", f"one of {', '.join(names)}", self.model)
        _expect(self.epochs is None or self.epochs >= 1, "epochs", "1 or more", self.epochs)
        _expect(self.batch_size >= 1, "batch_size", "1 or more", self.batch_size)
        _expect(self.accumulate >= 1, "accumulate", "1 or more", self.accumulate)
        _expect(self.processes >= 1, "processes", "1 or more", self.processes)
        _expect(0 <= self.ema < 1, "ema", "0 <= ema < 1", self.ema)
        kinds = ("none", "bfloat16")
        _expect(self.autocast in kinds, "autocast", " or ".join(kinds), self.autocast)
        kinds = ("float32", "float16")
        _expect(
            self.weights_dtype in kinds, "weights_dtype", " or ".join(kinds), self.weights_dtype
        )
        _expect(self.seed >= 0, "seed", "0 or more", self.seed)
        fields = {k: list(v) if isinstance(v, tuple) else v for k, v in self.model_fields.items()}
        object.__setattr__(self, "model_fields", fields)

    @property
    def resolved_stages(self) -> tuple[Stage, ...]:
        """The stages, the first with ``epochs`` where that is given."""
        if self.epochs is None:
            return self.stages
        return (replace(self.stages[0], epochs=self.epochs), *self.stages[1:])
