"""The training of the weights ``generic``: one network that learns from many spacecraft at once.

All are shown as if they were of one size, with a radius of one meter: the network reads a view that
is as wide as the spacecraft, and distances relative to the middle of their range.
"""

from __future__ import annotations

import multiprocessing
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch.utils.data import DataLoader

from ffpose._internal.files import sha256
from ffpose._internal.machine import cores
from ffpose._internal.zoo import resolve_initial
from ffpose.datasets.scenes import rendered_patches
from ffpose.imaging.patches import Arrays
from ffpose.learn.plan import (
    BEYOND,
    DEFAULT_CAMERA,
    FAR_DIAMETERS,
    NEAR_DIAMETERS,
    NETWORK,
    VIEW_MARGIN,
    first_stride,
    image_size,
)
from ffpose.models import PolarPose, backbone_preprocessing, build_network, find_device
from ffpose.models.weights import load_weights
from ffpose.training import OptimizerConfig
from ffpose.training.averaging import AveragedModel
from ffpose.training.config import ObjectLossConfig, PatchAugmentation
from ffpose.training.patches import PatchBatch, PatchBatches, Prepared
from ffpose.training.run import build_optimizer
from studies.generic.heads import ManyBinsHead, ManyObjective
from studies.generic.spacecraft import SEED, parts, subject

EMPTY = 60
"""Views without a spacecraft, of every third set."""

AVERAGE = 0.998
"""Decay of the moving average of the weights, which is saved."""

OPTIMIZER = OptimizerConfig(
    "adamw", 3e-3, eps=1e-8, clip_norm=1.0, schedule="cosine", warmup_epochs=1.7
)


@dataclass(frozen=True)
class GenericConfig:
    """What to learn from.

    Attributes:
        out: File to write.
        views: Folder of the rendered views.
        spacecraft: Number of spacecraft.
        count: Number of views of each.
        epochs: Passes over all views; each number is a cosine of its own, from the averaged weights
            of the one before.
        batch_size: Samples of each batch.
        init: Weights to start from, a file or a name.
        device: "auto" (a GPU if there is one) or a device that torch knows.
        workers: Processes that render, and half as many that read views.
    """

    out: Path
    views: Path
    spacecraft: int = 64
    count: int = 400
    epochs: tuple[int, ...] = (30, 34)
    batch_size: int = 288
    init: str = "soyuz"
    device: str = "auto"
    workers: int = cores()


def train_generic(config: GenericConfig) -> None:
    """Render the views that are not there, train, and write the shared weights.

    The head of the written network has random weights: it is that of no spacecraft.

    Raises:
        ValueError: A batch is larger than the set.
        OSError: A file cannot be written.
    """
    device = find_device(config.device)
    torch.manual_seed(0)
    model = new_network()
    load_weights(resolve_initial(config.init), model)
    model.orientation = ManyBinsHead(model, config.spacecraft)
    model.to(device).train()
    arrays, empty, numbers = opened_views(config, model)
    loss = ManyObjective(model, ObjectLossConfig(angle=5.0, offset=5.0), numbers).to(device)
    preprocessing = backbone_preprocessing(model.config.backbone, model.config.image_size, "resize")
    preprocessing = replace(preprocessing, mean=(0.0, 0.0, 0.0))
    augmentation = PatchAugmentation(
        empty=0.08, jpeg=0.1, monochrome=0.2, frames=0.4, look_outliers=0.12
    )
    nothing = np.zeros((0, 3))
    batches = PatchBatches(
        model, arrays, empty, augmentation, preprocessing.std, loss.cells, nothing, device=device
    )
    for stage, epochs in enumerate(config.epochs):
        average = AveragedModel(model, AVERAGE)
        optimizer = build_optimizer(model, loss, OPTIMIZER)
        for epoch in range(epochs):
            began = time.monotonic()
            losses = []
            order = batches.epoch(1000 * stage + epoch, config.batch_size)
            for step, batch in enumerate(_read(order, config.workers // 2)):
                position = epoch + (step + 0.5) / len(order)
                for group in optimizer.param_groups:
                    group["lr"] = OPTIMIZER.rate(position, epochs)
                losses.append(_step(batch, batches, model, loss, optimizer))
                average.update()
            seconds = time.monotonic() - began
            mean = float(torch.stack(losses).mean())
            print(f"epoch {epoch + 1} of {epochs}: loss {mean:.3f}, {seconds:.1f} s", flush=True)
        model.load_state_dict(average.model.state_dict())
    written = new_network()
    shared = {k: v for k, v in model.state_dict().items() if not k.startswith("orientation.")}
    written.load_state_dict({**written.state_dict(), **shared})
    written.save_pretrained(
        config.out,
        preprocessing=preprocessing,
        recipe=recipe(config),
        dtype=torch.float16,
    )


def new_network() -> PolarPose:
    """Return the network of `ffpose.learn` with random weights, for a radius of one meter."""
    c, near, far = DEFAULT_CAMERA, 2 * NEAR_DIAMETERS, 2 * FAR_DIAMETERS
    model = build_network(
        NETWORK,
        backbone_weights="none",
        image_size=image_size(c),
        camera=(c.fx, c.fy, c.cx, c.cy),
        first_stride=first_stride(1.0, BEYOND[1] * far, c),
        object_radius_m=VIEW_MARGIN,
        distance_m=(near, far),
    )
    assert isinstance(model, PolarPose)
    return model


def recipe(config: GenericConfig) -> dict[str, Any]:
    """Return what the header of the weights says of their training."""
    return {
        "study": "generic",
        "spacecraft": config.spacecraft,
        "seed": SEED,
        "count": config.count,
        "epochs": list(config.epochs),
        "batch_size": config.batch_size,
        "init": {"sha256": sha256(resolve_initial(config.init))},
    }


def opened_views(
    config: GenericConfig, model: PolarPose
) -> tuple[list[Arrays], list[Arrays], torch.Tensor]:
    """Return the views of all spacecraft, those of none, and the number of each sample's."""
    first, width = model.config.first_stride, model.config.object_width
    jobs = [
        (config.views, number, part, config.count, first, width)
        for part in range(len(parts(subject(0).scene, 0, config.count)) + 1)
        for number in range(config.spacecraft)
    ]
    fork = "fork" if sys.platform == "linux" else "spawn"
    with multiprocessing.get_context(fork).Pool(config.workers) as pool:
        for _ in pool.imap_unordered(_views, jobs):
            pass
    arrays: list[Arrays] = []
    empty: list[Arrays] = []
    numbers = []
    for job in jobs:
        found, shown = _views(job)
        if found is not None:
            (arrays if shown else empty).append(found)
            if shown:
                numbers += [job[1]] * len(found["labels"])
    return arrays, empty, torch.tensor(numbers)


def _views(job: tuple[Path, int, int, int, int, int]) -> tuple[Arrays | None, bool]:
    """Return a part of a spacecraft's views, rendered where it is not there yet, or none."""
    root, number, part, count, first, width = job
    torch.set_num_threads(1)
    craft = subject(number)
    sets = parts(craft.scene, number, count)
    spec = craft.spec(first, width)
    if part < len(sets):
        arrays = rendered_patches(root, *sets[part], spec, workers=1)
    elif number % 3 == 0:
        seed = SEED + 10 * number + 9
        arrays = rendered_patches(root, craft.scene, seed, EMPTY, spec, content="empty", workers=1)
    else:
        return None, False
    labels = np.array(arrays["labels"])
    labels[:, :3] /= craft.radius_m
    return {**arrays, "labels": labels}, part < len(sets)


def _read(epoch: Any, workers: int) -> Iterator[Prepared]:
    context = "fork" if workers and sys.platform == "linux" else None
    return iter(
        DataLoader(
            epoch,
            batch_size=None,
            num_workers=workers if context else 0,
            multiprocessing_context=context,
        )
    )


def _step(
    batch: Prepared,
    batches: PatchBatches,
    model: PolarPose,
    loss: ManyObjective,
    optimizer: torch.optim.Optimizer,
) -> torch.Tensor:
    if not isinstance(batch, PatchBatch):
        with torch.no_grad():
            batch = batches.augmented(batch)
    kind = batches.device.type
    with torch.autocast(kind, torch.bfloat16, enabled=kind != "cpu"):
        terms = loss(model, batch)
    torch.autograd.backward(terms.total)
    parameters = [*model.parameters(), *loss.parameters()]
    torch.nn.utils.clip_grad_norm_(parameters, OPTIMIZER.clip_norm)
    optimizer.step()
    optimizer.zero_grad(set_to_none=True)
    total: torch.Tensor = terms.total
    return total.detach()
