"""The parts of a training run, built from its configuration and handed to the loop."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from ffpose._internal.torch_internals import multiplies_bfloat16
from ffpose._internal.zoo import resolve_initial
from ffpose.config import looks_twice
from ffpose.errors import expect
from ffpose.geometry.symmetry import IDENTITY, SymmetryGroup
from ffpose.models import (
    BaseNetwork,
    PolarPose,
    backbone_preprocessing,
    build_network,
    find_config,
    find_device,
)
from ffpose.models.weights import WeightsMetadata, load_weights, read_metadata
from ffpose.training.averaging import AveragedModel
from ffpose.training.calibration_images import CalibrationSet
from ffpose.training.config import OptimizerConfig, TrainConfig
from ffpose.training.data import NO_KEYPOINTS, TrainingData, open_training_data
from ffpose.training.losses import JointLoss
from ffpose.training.muon import Muon, matrices
from ffpose.training.object_objective import ObjectObjective
from ffpose.training.patches import PatchBatches
from ffpose.training.processes import ALONE, Processes
from ffpose.training.provenance import describe_images, describe_patches, origin, recipe
from ffpose.training.stages import check_stages
from ffpose.training.tasks import FrameTask, ObjectTask, Task

UNKNOWN_CAMERA = (1.0, 1.0, 0.0, 0.0)


@dataclass
class Run:
    """State of a training loop.

    Attributes:
        config: What the run is asked to do, ``autocast`` as it is on the device.
        model: The network.
        average: Its moving average, which is validated and saved.
        optimizer: Over network and loss; made anew where a stage begins.
        task: Batches, loss and validation.
        device: Where the network computes.
        calibration: Images that calibrate a network with a second look.
        symmetry: The rotations that labels and errors are modulo.
        recipe: What the weights' header says of the training (`ffpose.training.provenance`).
        data: What it says of the training images.
    """

    config: TrainConfig
    model: BaseNetwork
    average: AveragedModel[BaseNetwork]
    optimizer: torch.optim.Optimizer
    task: Task
    device: torch.device
    calibration: CalibrationSet | None
    symmetry: SymmetryGroup
    recipe: dict[str, Any]
    data: dict[str, Any]


def build_run(
    config: TrainConfig,
    processes: Processes = ALONE,
    *,
    resumed: WeightsMetadata | None = None,
    quiet: bool = True,
) -> Run:
    """Open the images and build model, loss and optimizer, the weights from the run's seed.

    ``resumed`` is the header of the last weights of a run that is resumed. Neither the backbone's
    pretrained weights nor the initial weights are read then: the checkpoint has all. ``quiet`` is
    as of `open_training_data`.

    Raises:
        FileNotFoundError: There are no such initial weights.
        ValueError: An unknown kind of image set, or fields that do not go together.
        ffpose.DataError: A label, or a file of weights, cannot be used.
    """
    device = find_device(config.device)
    config = replace(config, autocast=chosen_autocast(config.autocast, device))
    given = None if resumed else config.init
    initial = None if given is None else resolve_initial(given)
    if initial is not None and not initial.is_file():
        raise FileNotFoundError(f"init: expected a file or a name, got {initial}")
    fields = dict(config.model_fields)
    # What the data decide is not known yet; the structure is.
    model_config = find_config(config.model).with_fields({"camera": UNKNOWN_CAMERA, **fields})
    check_stages(model_config.parts, config.resolved_stages)
    symmetry = IDENTITY if config.symmetry is None else SymmetryGroup.read(config.symmetry)
    if len(symmetry) > 1 and not looks_twice(model_config):
        raise ValueError(
            f"symmetry: expected with a network that looks twice, got it with {config.model}"
        )
    size, mode = model_config.image_size, config.data.mode
    preprocessing = backbone_preprocessing(model_config.backbone, size, mode)
    if looks_twice(model_config):  # a virtual camera sees zero outside an image, which is black
        preprocessing = replace(preprocessing, mean=(0.0, 0.0, 0.0))
    with processes.leader_first():  # who renders and fills caches
        dense = config.object_loss.renders
        data = open_training_data(
            config.data, model_config, preprocessing, coordinates=dense, quiet=quiet
        )
    if (c := data.camera) is not None:
        fields.setdefault("camera", (c.fx, c.fy, c.cx, c.cy))
    if data.train_set is not None and looks_twice(model_config):
        _check_distances(data.train_set.poses, model_config.distance_m)
    elif data.train_set is not None and config.normalize_translation:
        before = resumed if initial is None else read_metadata(initial)
        statistics = translation_statistics(data.train_set.poses)
        if before is not None and type(before.config) is type(model_config):
            statistics = {name: getattr(before.config, name) for name in statistics}
            for name in statistics.keys() & fields.keys():  # their outputs are of that scale
                scale, own = tuple(fields[name]), tuple(statistics[name])
                expect(scale == own, name, f"{own}, that of the weights before", scale)
        fields = statistics | fields
    torch.manual_seed(config.seed)
    backbone_weights = config.backbone_weights if resumed is None else "none"
    model = build_network(config.model, backbone_weights=backbone_weights, **fields).to(device)
    init = None
    if resumed is not None:
        model.backbone.source = resumed.backbone_source
        init = (resumed.recipe or {}).get("init")
    elif initial is not None:
        load_weights(initial, model)
        init = origin(initial)
    task = _task(config, model, data, device, processes, symmetry)
    optimizer = build_optimizer(model, task.loss, config.optimizer)
    average = AveragedModel(model, config.ema, config.init_share)
    if isinstance(task, ObjectTask):
        described = describe_patches(data.patches, data.val_set, config.data)
    else:
        described = describe_images(task.train_set, config.data)
    return Run(
        config,
        model,
        average,
        optimizer,
        task,
        device,
        calibration=data.calibration,
        symmetry=symmetry,
        recipe=recipe(config, init, symmetry),
        data=described,
    )


def chosen_autocast(
    autocast: Literal["none", "bfloat16", "auto"], device: torch.device
) -> Literal["none", "bfloat16"]:
    """Return what "auto" is on a device (`TrainConfig.autocast`), and others as they are."""
    if autocast != "auto":
        return autocast
    return "bfloat16" if device.type != "cpu" or multiplies_bfloat16() else "none"


def _task(
    config: TrainConfig,
    model: BaseNetwork,
    data: TrainingData,
    device: torch.device,
    processes: Processes,
    symmetry: SymmetryGroup,
) -> FrameTask | ObjectTask:
    shared = config.batch_size, config.data.workers, processes
    if isinstance(model, PolarPose):
        keypoints = data.keypoints if config.object_loss.keypoints > 0 else NO_KEYPOINTS
        if config.object_loss.keypoints > 0 and not len(keypoints):
            raise ValueError(
                "object_loss.keypoints: expected 0 for images of an object without named points,"
                f" got {config.object_loss.keypoints}"
            )
        if config.batch_size < 2 and config.views.empty > 0:
            raise ValueError(
                "batch_size: expected 2 or more, of which some are without the object, got 1"
            )
        loss = ObjectObjective(model, config.object_loss, len(keypoints), symmetry).to(device)
        patches = PatchBatches(
            model,
            data.patches,
            data.empty,
            config.views,
            data.val_set.preprocessing.std,
            loss.cells,
            keypoints,
            symmetry,
            device,
        )
        return ObjectTask(data.val_set, loss, *shared, patches)
    assert data.train_set is not None
    own = config.loss
    joint_loss = JointLoss(model.config.loss_weights, own.s_t, own.s_q, own.antipodal).to(device)
    return FrameTask(data.val_set, joint_loss, *shared, data.train_set)


def translation_statistics(poses: NDArray[np.float64]) -> dict[str, tuple[float, ...]]:
    """Return the model's fields for mean and spread of the translations of poses ``(N, 7)``.

    A coordinate that does not vary, but for rounding, gets a spread of one: it is predicted by its
    mean.
    """
    mean, std = poses[:, :3].mean(axis=0), poses[:, :3].std(axis=0)
    spread = np.where(std > 1e-9 * np.maximum(1, np.abs(mean)), std, 1.0)
    return {
        "translation_mean": tuple(mean.tolist()),
        "translation_std": tuple(spread.tolist()),
    }


def _check_distances(poses: NDArray[np.float64], trained: Sequence[float]) -> None:
    """Check that a first look can tell the distances of labels ``(N, 7)``."""
    (near, far), distances = trained, np.linalg.norm(poses[:, :3], axis=1)
    low, high = float(distances.min()), float(distances.max())
    if not near / 2 <= low <= high <= 2 * far:
        raise ValueError(
            f"data: expected distances of {near / 2:g} to {2 * far:g} m, which the first look can"
            f" tell, got {low:.3g} to {high:.3g}; --model.distance-m {low:.3g},{high:.3g} trains"
            " such a network"
        )


def build_optimizer(
    model: nn.Module, loss: nn.Module, config: OptimizerConfig
) -> torch.optim.Optimizer:
    """Return the optimizer over the model, and over the loss's two weights without weight decay."""
    weights, decay = list(model.parameters()), {"weight_decay": config.weight_decay}
    groups: list[dict[str, Any]] = [
        {"params": weights, **decay},
        {"params": list(loss.parameters()), "weight_decay": 0.0},
    ]
    if config.kind == "muon":
        mixing = list(matrices(model))
        ids = set(map(id, mixing))
        groups[0]["params"] = [each for each in weights if id(each) not in ids]
        groups.append({"params": mixing, "matrix": True, **decay})
        return Muon(groups, config.learning_rate, config.eps)
    adam = torch.optim.AdamW if config.kind == "adamw" else torch.optim.Adam
    return adam(groups, lr=config.learning_rate, eps=config.eps, fused=True)
