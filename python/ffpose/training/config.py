"""Configuration of a training run: plain dataclasses, read from flags or from a YAML file.

Nothing heavy is imported here, so that ``ffpose train --help`` is fast. The defaults are those of
the paper (section 4.3) where it states a value.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any, Literal

from ffpose._internal.seeds import CALIBRATION, TRAINING, matching
from ffpose.config import PRESETS
from ffpose.errors import check_choices, expect, expect_least
from ffpose.imaging.images import check_white
from ffpose.training.stages import JOINT_STAGE, Stage

VARIANTS = ("cut", "randomized", "dusk")
"""Kinds of rendered images that training and calibration may show besides whole objects."""


@dataclass(frozen=True)
class CalibrationImages:
    """Images that calibrate weights, and that nothing else has seen.

    Attributes:
        kind: Layout of the image set, as in `DataConfig`, or "scenes" for rendered ones: of each
            kind (whole, cut, randomized, low sun, other spacecraft) ``count`` are rendered.
        root: Folder of the image set; for kind "scenes" that which keeps the images.
        scene: For kind "scenes": name or file of the rendered set; None for the first that the
            weights were trained on. For a set that they were trained on, kinds, distances and
            attitudes that are not given are those of the training.
        seed: For kind "scenes": seed of the set, one of `ffpose._internal.seeds.CALIBRATION`.
        count: For kind "scenes": number of images of each kind, 2 or more.
        cut: For kind "scenes": objects of which the border leaves 30 to 60 % too.
        randomized: For kind "scenes": domain randomization of light, materials and backgrounds too.
        dusk: For kind "scenes": the light of a low sun over dark ground too.
        distance: For kind "scenes": factors on the least and the greatest distance of the set.
        attitude_range_deg: For kind "scenes": limits of the absolute roll, pitch and yaw, degrees.
        split: Name of the split of a set on disk.
        start: Index of the first image that is used of the split.
        step: Every ``step``-th image is used, from ``start`` on.
        undistort: Whether to undistort the images of cameras with distortion.
        white: As in `DataConfig`.
        workers: Number of processes that render.
    """

    kind: str = "scenes"
    root: Path = Path("runs/calibration")
    scene: str | None = None
    seed: int = CALIBRATION.start
    count: int = 200
    cut: bool = False
    randomized: bool = False
    dusk: bool = False
    distance: tuple[float, float] = (1.0, 1.0)
    attitude_range_deg: tuple[float, float, float] = (180.0, 90.0, 180.0)
    split: str = "val"
    start: int = 0
    step: int = 1
    undistort: bool = False
    white: float | str | None = None
    workers: int = 0

    def __post_init__(self) -> None:
        expected = f"{CALIBRATION.start} to {CALIBRATION.stop - 1}, which are for calibration"
        expect(self.seed in CALIBRATION, "data.seed", expected, self.seed)
        expect_least(self, "data.", count=2, start=0, step=1, workers=0)
        rendered = ("scene", "seed", "count", *VARIANTS, "distance", "attitude_range_deg")
        if self.kind == "scenes":
            _expect_unchanged(self, ("split", "start", "step", "undistort", "white"), "scenes")
        else:
            _expect_unchanged(self, rendered, self.kind)


def _expect_unchanged(config: Any, names: Sequence[str], kind: str) -> None:
    """Check that fields that mean nothing for a kind of image set are as nobody gave them."""
    usual = {each.name: each.default for each in fields(config)}
    for name in names:
        got = getattr(config, name)
        expect(got == usual[name], f"data.{name}", f"{usual[name]} with kind {kind}", got)


@dataclass(frozen=True)
class DataConfig:
    """Training and validation images, and how they are read.

    Attributes:
        kind: Layout of the image set: "urso", "speed", "speedplus", "cambridge", "sevenscenes" or
            "csv" (docs/datasets.md), or "scenes" for scenes that are rendered as needed.
        root: Folder of the image set.
        mode: Conversion of an image to the network's input: "resize", the whole frame, or
            "center_crop", the paper's resize and center crop.
        augment: Whether to augment the training images of a network that looks at the frame alone.
        augmentation: Fields of `ffpose.imaging.transforms.Augmentation` to change, as in ``{roll:
            10}``.
        cache: Whether to store decoded and resized images in a file that later runs share.
        workers: Number of processes that render, read or augment images beside the one that trains;
            those that augment patches are shared by all that train on a machine.
        train_split: Name of the training split, or "all" with ``holdout``.
        val_split: Name of the validation split.
        holdout: Validate on every ``holdout``-th image of the training split instead of val_split,
            and leave it out of training; 0 leaves none out.
        keypoints: CSV file with the object's keypoints, columns name, x, y, z in meters, for dense
            supervision of a network with a second look; rendered scenes know their own.
        undistort: Whether to undistort the images of cameras with distortion.
        white: Level that becomes white in monochrome images of more than 8 bits, such as 4095 for
            12 bits, or the percentile of each image's own levels, such as "p99.5"; None for images
            of 8 bits.
        scene: For kind "scenes": name of the rendered set, or several joined by a plus; validation
            uses the first; or the file of a set (`ffpose.render.scene_file`). A name that stands
            twice is two sets, of other seeds.
        count: For kind "scenes": number of training images of each set, or a list of one number
            for each.
        validation: For kind "scenes": number of whole images that select the best epoch.
        calibration: For kind "scenes": number of images of each kind that calibrate a network with
            a second look. They are of the first of the sets, of each kind that training sees, and
            of other spacecraft. In a set on disk every other validation image calibrates instead.
        empty: For kind "scenes": number of images without the spacecraft, negatives for a network
            with a second look.
        decoys: For kind "scenes": number of images of other spacecraft, negatives too.
        cut: For kind "scenes": number of images of each set whose spacecraft the border cuts.
        randomized: For kind "scenes": number of images of each set with domain randomization of
            light, materials and backgrounds.
        dusk: For kind "scenes": number of images of each set in the light of a low sun over dark
            ground, where most large errors are made.
        distance: For kind "scenes": factors on the least and the greatest distance of the sets, in
            training and calibration; validation has the sets' own distances.
        seed: For kind "scenes": seed of the first set, of `ffpose._internal.seeds.TRAINING`; those
            of the others count on from it (`seeds`), so that no two sets show one scene.
        attitude_range_deg: For kind "scenes": limits of the absolute roll, pitch and yaw, degrees.
    """

    kind: str
    root: Path
    mode: Literal["resize", "center_crop"] = "resize"
    augment: bool = True
    augmentation: dict[str, Any] = field(default_factory=dict)
    cache: bool = False
    workers: int = 0
    train_split: str = "train"
    val_split: str = "val"
    holdout: int = 0
    keypoints: str | None = None
    undistort: bool = False
    white: float | str | None = None
    scene: str = "soyuz_hard"
    count: int | list[int] = 10000
    validation: int = 200
    calibration: int = 200
    empty: int = 1000
    decoys: int = 1000
    cut: int = 0
    randomized: int = 0
    dusk: int = 0
    distance: tuple[float, float] = (1.0, 1.0)
    seed: int = 0
    attitude_range_deg: tuple[float, float, float] = (180.0, 90.0, 180.0)

    def __post_init__(self) -> None:
        check_choices(self, "data.")
        expect(self.holdout == 0 or self.holdout > 1, "data.holdout", "0, 2 or more", self.holdout)
        if self.white is not None:
            check_white("data.white", self.white)
        expect(min(self.counts, default=0) >= 1, "data.count", "1 or more", self.count)
        if self.kind == "scenes":
            sets = len(self.scenes)
            expect(len(self.counts) == sets, "data.count", f"a number for {sets} sets", self.count)
            _expect_unchanged(self, ("holdout", "undistort", "white"), "scenes")
        least = {"workers": 0, "validation": 1, "calibration": 2, "empty": 0, "decoys": 0}
        expect_least(self, "data.", **least, **dict.fromkeys(VARIANTS, 0))
        near, far = self.distance
        expect(0 < near <= 1 <= far, "data.distance", "0 < near <= 1 <= far", self.distance)
        expected = f"0 to {TRAINING.stop - 1}, as later seeds are not for training"
        expect(self.seed in TRAINING, "data.seed", expected, self.seed)

    @property
    def scenes(self) -> list[str]:
        """Names of the rendered sets; or the one file of a set."""
        return [self.scene] if self.scene.endswith(".json") else self.scene.split("+")

    @property
    def counts(self) -> list[int]:
        """Number of training images of each of `scenes`."""
        return self.count if isinstance(self.count, list) else [self.count] * len(self.scenes)

    @property
    def seeds(self) -> list[int]:
        """Seed of each of `scenes`: ``seed``, ``seed + 1``, … and 0 after the last of training."""
        return [matching(TRAINING, self.seed + number) for number in range(len(self.scenes))]

    @property
    def calibration_images(self) -> CalibrationImages:
        """The images that calibrate a network with a second look; no others train or validate."""
        same = ("kind", "root", "undistort", "white", "workers")
        images = CalibrationImages(**{name: getattr(self, name) for name in same})
        if self.kind == "scenes":
            return replace(
                images,
                scene=self.scenes[0],
                seed=matching(CALIBRATION, self.seed),
                count=self.calibration,
                distance=self.distance,
                attitude_range_deg=self.attitude_range_deg,
                **{kind: getattr(self, kind) > 0 for kind in VARIANTS},
            )
        if self.holdout:
            step = 2 * self.holdout
            return replace(images, split=self.train_split, start=self.holdout, step=step)
        return replace(images, split=self.val_split, start=1, step=2)


@dataclass(frozen=True)
class OptimizerConfig:
    """Optimizer and learning rate schedule.

    Attributes:
        kind: "adam", as published; "adamw", with decoupled weight decay (Loshchilov and Hutter,
            "Decoupled Weight Decay Regularization", ICLR 2019); or "muon", which orthogonalizes the
            steps of the matrices (`ffpose.training.muon`), and is AdamW for all others.
        learning_rate: Highest learning rate.
        weight_decay: Weight decay of the model's parameters; those of the loss have none.
        eps: Adam's epsilon.
        clip_norm: Norm to which the gradient is clipped; 0 for no clipping.
        schedule: "step" multiplies the learning rate by step_factor every step_epochs epochs;
            "cosine" decreases it to zero at the end of each stage.
        step_epochs: Number of epochs between two steps.
        step_factor: Factor of the learning rate at each step.
        warmup_epochs: Number of epochs, possibly fractional, of linear warm-up from zero.
    """

    kind: Literal["adam", "adamw", "muon"] = "adam"
    learning_rate: float = 1e-4
    weight_decay: float = 1e-4
    eps: float = 1e-10
    clip_norm: float = 0.0
    schedule: Literal["step", "cosine"] = "step"
    step_epochs: int = 200
    step_factor: float = 0.1
    warmup_epochs: float = 0.0

    def __post_init__(self) -> None:
        for name in ("learning_rate", "eps", "step_factor"):
            value = getattr(self, name)
            expect(value > 0, f"optimizer.{name}", "more than 0", value)
        least = {"weight_decay": 0, "clip_norm": 0, "step_epochs": 1, "warmup_epochs": 0}
        expect_least(self, "optimizer.", **least)
        check_choices(self, "optimizer.")

    def rate(self, position: float, epochs: int) -> float:
        """Return the learning rate at a position in a stage of so many epochs, 0 to ``epochs``.

        The warm-up factor rises linearly and multiplies the schedule's rate. It is a function of
        the position alone, so checkpoints need no scheduler.

        Examples:
            >>> paper = OptimizerConfig()
            >>> [f"{paper.rate(epoch, 500):.0e}" for epoch in (0.1, 199.9, 200, 400.5)]
            ['1e-04', '1e-04', '1e-05', '1e-06']
        """
        rise = min(1.0, position / self.warmup_epochs) if self.warmup_epochs > 0 else 1.0
        if self.schedule == "cosine":
            fall = 0.5 * (1 + math.cos(math.pi * position / epochs))
        else:
            fall = self.step_factor ** (position // self.step_epochs)
        return self.learning_rate * rise * fall


MUON = OptimizerConfig("muon", 4e-3, eps=1e-8, clip_norm=1.0, schedule="cosine")
"""Optimizer of networks with a second look for batches of 32 samples, but for its warm-up."""


@dataclass(frozen=True)
class LossConfig:
    """Pose loss of a network that looks at the frame alone (paper, Eq. 9-11).

    UrsoNet, and PoseNet with ``beta``, have fixed weights among the fields of their configuration.

    Attributes:
        s_t: Initial log weight of the translation, learnable.
        s_q: Initial log weight of the orientation, learnable.
        antipodal: Whether the distance is to the nearer of q and -q; in Eq. 10 it is to q.
    """

    s_t: float = -3.0
    s_q: float = -6.5
    antipodal: bool = False


@dataclass(frozen=True)
class ObjectLossConfig:
    """Weights of the loss terms of a network with a second look.

    Attributes:
        location: Weight of the first look's loss.
        orientation: Weight of the orientation head's loss.
        angle: Weight of the sine of half the rotation error of the decoded attitude. It reduces
            errors smaller than the width of the soft labels, which those hardly distinguish.
        offset: Weight of the second look's position error.
        sigma: Weight of the likelihoods of both errors (t distributions), which train uncertainty.
        in_view: Weight of the classification of presence.
        coordinates: Weight of the object coordinates, dense supervision by the renderer's labels.
        mask: Weight of the silhouette, from the same labels.
        keypoints: Weight of the heatmaps of the object's keypoints (`data.keypoints`), dense
            supervision that needs no masks.
    """

    location: float = 10.0
    orientation: float = 1.0
    angle: float = 0.0
    offset: float = 3.0
    sigma: float = 0.1
    in_view: float = 0.5
    coordinates: float = 6.0
    mask: float = 2.0
    keypoints: float = 0.0

    def __post_init__(self) -> None:
        expect_least(self, "", **dict.fromkeys(vars(self), 0))

    @property
    def renders(self) -> bool:
        """Whether there is dense supervision by labels that the renderer writes."""
        return self.coordinates > 0 or self.mask > 0


@dataclass(frozen=True)
class PatchAugmentation:
    """Augmentation of the training patches of a network with a second look.

    Attributes:
        roll_deg: Largest rotation of the first look's camera about the boresight, degrees.
        look_lateral: Standard deviation of the simulated error of the first look across the viewing
            ray, as a fraction of the virtual camera's radius at the object.
        look_distance: Standard deviation of that error along the ray, in log distance.
        look_outliers: Fraction of samples whose simulated errors are five times as large.
        twist_deg: Largest rotation of the virtual camera about the viewing ray, degrees.
        brightness: Standard deviation of the base-2 logarithm of the brightness factor.
        noise: Largest standard deviation of Gaussian noise on pixel values in [0, 1].
        blur: Largest weight of a copy at half the resolution that is blended in.
        jpeg: Fraction of the second look's images that went through a JPEG file, of a quality from
            30 to 90.
        monochrome: Fraction of the images of either look that are made gray, as from a camera
            without colors: by three random weights of the colors for each image, noise included.
        empty: Fraction of samples without the object.
        frames: Fraction of samples whose frame trains the first look, which learns sooner.
    """

    roll_deg: float = 180.0
    look_lateral: float = 0.08
    look_distance: float = 0.09
    look_outliers: float = 0.05
    twist_deg: float = 180.0
    brightness: float = 0.25
    noise: float = 0.04
    blur: float = 0.5
    jpeg: float = 0.0
    monochrome: float = 0.0
    empty: float = 0.1
    frames: float = 0.25

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            most = 180.0 if name.endswith("_deg") else 1.0
            expect(0 <= value <= most, name, f"a number from 0 to {most:g}", value)


@dataclass(frozen=True)
class TrainConfig:
    """Configuration of a whole training run.

    Attributes:
        data: Training and validation images.
        out: Folder to write; it must not contain another run.
        model: Preset of the network: base (the paper's), small or tiny; transformerpose (base
            without filters); polar, that of the shipped weights; ursonet or posenet, which the
            paper compares with.
        model_fields: Fields of the preset to change, such as {"depth": 5}. Tuples are stored as
            lists, which is what a YAML file gives back.
        backbone_weights: "auto" (pretrained), "none" (random), or a file.
        normalize_translation: Whether the head predicts translations standardized by mean and
            standard deviation of the training split, instead of meters; a mean and a deviation
            among ``model_fields`` stay.
        epochs: Number of epochs of the first stage; overrides that of ``stages``.
        stages: Training stages, in order; by default the first stage of the paper alone. Each
            starts from the best weights of those before it. On a command line they come from a
            file, ``--config FILE``.
        patience: Number of epochs without a better validation score after which a stage ends early;
            0 for never.
        batch_size: Number of images per batch.
        accumulate: Number of batches whose gradients are accumulated for one step.
        processes: Number of training processes on this machine, each with batches of its own; where
            ``torchrun`` starts them, that of all on all machines.
        ema: Decay of the exponential moving average of the weights, such as 0.998; the average is
            validated and saved. 0 for none.
        autocast: "none", or "bfloat16" for the network's matrix products and convolutions; "auto"
            is "bfloat16" on a GPU, and on a processor that has instructions for it: on another,
            which has to convert, steps take several times as long.
        init: Weights to start from, a file or a name such as soyuz, of the same architecture.
        init_share: Share of the initial weights in those that are validated and saved, such as 0.5
            where fine-tuning on a few images must not lose what was learned before (WiSE-FT). It
            needs ``init`` and ``ema``.
        optimizer: Optimizer and learning rate schedule.
        loss: Loss of a network that looks at the frame alone.
        object_loss: Loss of a network with a second look.
        views: Augmentation of the views of a network with a second look.
        seed: Seed of the initial weights, the order of the images, augmentation and dropout.
        device: "auto" (a GPU if there is one) or a device that torch knows.
        weights_dtype: Dtype of the saved weights: "float32", or "float16" for half the file size.
        tensorboard: Whether to write the table of results as events for TensorBoard too.
        symmetry: File of the rotations that leave the object's look unchanged
            (`ffpose.geometry.symmetry`), for a network with a second look: labels, errors and
            calibration are modulo them. None for none.
    """

    data: DataConfig
    out: Path
    model: str = "base"
    model_fields: dict[str, Any] = field(default_factory=dict)
    backbone_weights: str = "auto"
    normalize_translation: bool = True
    epochs: int | None = None
    stages: tuple[Stage, ...] = (JOINT_STAGE,)
    patience: int = 0
    batch_size: int = 8
    accumulate: int = 1
    processes: int = 1
    ema: float = 0.0
    autocast: Literal["none", "bfloat16", "auto"] = "none"
    init: Path | None = None
    init_share: float = 0.0
    optimizer: OptimizerConfig = field(default_factory=OptimizerConfig)
    loss: LossConfig = field(default_factory=LossConfig)
    object_loss: ObjectLossConfig = field(default_factory=ObjectLossConfig)
    views: PatchAugmentation = field(default_factory=PatchAugmentation)
    seed: int = 0
    device: str = "auto"
    weights_dtype: Literal["float32", "float16"] = "float32"
    tensorboard: bool = False
    symmetry: Path | None = None

    def __post_init__(self) -> None:
        expect(len(self.stages) > 0, "stages", "at least one stage", self.stages)
        expect(self.model in PRESETS, "model", f"one of {', '.join(PRESETS)}", self.model)
        check_choices(self)
        expect(self.epochs is None or self.epochs >= 1, "epochs", "1 or more", self.epochs)
        expect_least(self, patience=0, batch_size=1, accumulate=1, processes=1, seed=0)
        expect(0 <= self.ema < 1, "ema", "0 <= ema < 1", self.ema)
        expect(0 <= self.init_share < 1, "init_share", "0 <= init_share < 1", self.init_share)
        if self.init_share > 0 and (self.init is None or self.ema == 0):
            got = f"init {self.init} and ema {self.ema:g}"
            raise ValueError(f"init_share: expected with init and with ema above 0, got {got}")
        self._check_keypoints()
        fields = {k: list(v) if isinstance(v, tuple) else v for k, v in self.model_fields.items()}
        object.__setattr__(self, "model_fields", fields)

    def _check_keypoints(self) -> None:
        """Check that keypoints and the weight of their heatmaps are given together."""
        weight, file = self.object_loss.keypoints, self.data.keypoints
        if self.data.kind == "scenes":
            expect(file is None, "data.keypoints", "none with kind scenes, which has its own", file)
        elif (weight > 0) != (file is not None):
            raise ValueError(
                "data.keypoints and object_loss.keypoints: expected a file and a weight above 0, "
                f"or neither, got {file!r} and {weight:g}"
            )

    @property
    def resolved_stages(self) -> tuple[Stage, ...]:
        """The stages, the first with ``epochs`` if that is not None."""
        if self.epochs is None:
            return self.stages
        return (replace(self.stages[0], epochs=self.epochs), *self.stages[1:])
