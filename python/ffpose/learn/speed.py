"""Speed of this machine at rendering and training, by which a budget is planned."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
import torch

from ffpose._internal.machine import cores
from ffpose.inference.in_torch import torch_threads
from ffpose.learn.plan import Speed
from ffpose.models import PolarPose, build_network
from ffpose.models.base import find_device
from ffpose.render import Scene
from ffpose.render.patches import render_all_patches
from ffpose.training import TrainConfig
from ffpose.training.data import patch_spec
from ffpose.training.object_objective import ObjectObjective
from ffpose.training.patches import PatchBatches
from ffpose.training.processes import Processes
from ffpose.training.run import build_optimizer

VIEWS = 24
"""Rendered views, for each process."""

WARM_UP, STEPS = 2, 6
TOGETHER = 0.85
"""Speed of each of several processes relative to one alone; they share memory and caches."""


def measure_speed(config: TrainConfig, scene: Scene) -> tuple[Speed, str]:
    """Render and train a little, as a training of `ffpose.learn.plan.training`, and forget it.

    Returns the speed of all processes together, and the faster type of `TrainConfig.autocast`.
    """
    processes, renderers = config.processes, max(1, config.data.workers)
    fields = dict(config.model_fields)
    camera = scene.camera.resized(*reversed(fields["image_size"]))
    fields["camera"] = (camera.fx, camera.fy, camera.cx, camera.cy)
    torch.manual_seed(config.seed)
    device = find_device(config.device)
    model = build_network(config.model, backbone_weights="none", **fields).to(device)
    assert isinstance(model, PolarPose)
    spec = patch_spec(model.config, camera)
    count = VIEWS * renderers
    arrays = spec.empty(count)
    wide = scene.scaled(*config.data.distance)
    began = time.perf_counter()
    for row, view in enumerate(
        render_all_patches(wide, config.data.seed, range(count), spec, "object", renderers)
    ):
        view.store(arrays, row)
    views = count / (time.perf_counter() - began)
    loss = ObjectObjective(model, config.object_loss).to(device)
    batches = PatchBatches(
        model,
        [arrays],
        [],
        config.views,
        (1.0, 1.0, 1.0),
        loss.cells,
        np.zeros((0, 3)),
        device=device,
    )
    threads = torch.get_num_threads() // processes
    with torch_threads(max(1, threads) if device.type == "cpu" else 1):  # workers have one each
        rates = {
            autocast: _rate(replace(config, autocast=autocast), model, loss, batches, device)
            for autocast in ("none", "bfloat16")
        }
    best = max(rates, key=rates.__getitem__)
    at_once = min(processes, cores()) if device.type == "cpu" else processes
    together = 1 if at_once == 1 else TOGETHER * at_once
    stored = sum(array.nbytes for array in arrays.values()) // count
    return Speed(views, rates[best] * together, stored), best


def _rate(
    config: TrainConfig,
    model: PolarPose,
    loss: ObjectObjective,
    batches: PatchBatches,
    device: torch.device,
) -> float:
    """Return training samples per second of one process.

    On a CPU, batches and steps share the cores; for a GPU, workers read patches meanwhile.
    """
    size = config.batch_size
    generator = torch.Generator().manual_seed(0)
    optimizer = build_optimizer(model, loss, replace(config.optimizer, learning_rate=1e-5))
    model.train()
    preparing = stepping = 0.0
    for step in range(-WARM_UP, STEPS):
        began = time.perf_counter()
        index = torch.randint(len(batches), (size,), generator=generator)
        stored = batches.gathered(batches.drawn(index, generator))
        prepared = time.perf_counter()
        batch = batches.augmented(stored)
        with torch.autocast(device.type, torch.bfloat16, enabled=config.autocast == "bfloat16"):
            terms = loss(model, batch)
        torch.autograd.backward(terms.total)
        optimizer.step()
        optimizer.zero_grad(set_to_none=True)
        terms.total.item()  # waits for a GPU
        if step >= 0:
            preparing += prepared - began
            stepping += time.perf_counter() - prepared
    if device.type == "cpu":
        return STEPS * size / (preparing + stepping)
    workers = Processes(here=config.processes).workers(config.data.workers) or 1  # or a thread
    return STEPS * size / max(preparing / workers, stepping)
