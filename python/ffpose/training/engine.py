"""The training loop: a plain one.

The loss is that of equations 9 to 11, the optimiser Adam, the stages those of
`ffpose.training.stages`. Every random number of an epoch (the order of the images, augmentation,
dropout) comes from the run's seed and the number of the epoch alone, so a run that was interrupted
and taken up gives the weights of one that was not, bit for bit on the same machine and number of
threads.
"""

from __future__ import annotations

import os
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from ffpose.metrics import PoseError
from ffpose.models import FilterformerPose, read_metadata
from ffpose.training.calibrate import calibrate
from ffpose.training.checkpoint import Row, RunFolder, TrainState
from ffpose.training.config import TrainConfig
from ffpose.training.memory import keep_freed_memory
from ffpose.training.progress import Reporter
from ffpose.training.provenance import recipe
from ffpose.training.run import Run, build_optimizer, build_run
from ffpose.training.schedule import learning_rate
from ffpose.training.stages import Epoch, enter_stage, plan
from ffpose.training.tasks import trained_together

SELECTED_BY = "val_esa_score"
"""The column whose lowest value makes the best epoch: it weighs both errors without units."""


class NonFiniteLossError(RuntimeError):
    """The loss is not a number any more; the text names the images of the batch."""


@dataclass(frozen=True)
class TrainResult:
    """What a training run came to.

    Attributes:
        folder: Its files.
        history: The table of results, a row an epoch; ``samples`` and ``cpu_seconds`` are of its
            training, without the validation.
        best_epoch: Number of the epoch whose weights are the best.
        seconds: Time spent in epochs, those before an interruption included.
    """

    folder: RunFolder
    history: list[Row]
    best_epoch: int
    seconds: float


def train(
    config: TrainConfig,
    *,
    resume: bool = False,
    quiet: bool = False,
    cpu_minutes: float | None = None,
) -> TrainResult:
    """Train a model and leave its weights, its table of results and its configuration.

    Args:
        config: What to train, on which images, and where to write.
        resume: Take up the run in ``config.out`` after its last finished epoch; where there is
            none, begin one.
        quiet: Print nothing.
        cpu_minutes: Begin no epoch once training has taken as many minutes of CPU time.

    Returns:
        The run's files and figures.

    Raises:
        FileExistsError: ``config.out`` holds a run, and ``resume`` is false.
        ValueError: An unknown name in ``config``, or a configuration other than the run's.
        ffpose.DataError: An image or a label cannot be used.
        NonFiniteLossError: The loss is infinite or not a number.
    """
    keep_freed_memory()
    folder = RunFolder(config.out)
    state = folder.open(config, resume=resume)
    run = build_run(config)
    epochs = plan(config.resolved_stages)
    if state.history:
        _restore(run, state, epochs)
        run.average.model.backbone.source = read_metadata(folder.last).backbone_source
    folder.begin(config)
    done, steps = len(state.history), run.task.steps
    with Reporter(len(epochs), done, steps, quiet=quiet) as reporter:
        for epoch in epochs[done:]:
            if cpu_minutes is not None and _cpu_seconds_of(state) >= 60 * cpu_minutes:
                break
            row = _train_and_validate(run, epoch, reporter)
            state.history.append(row)
            _write(run, state, folder)
            reporter.epoch_ends(row)
    _calibrate(run, folder)
    seconds = sum(float(row["seconds"]) for row in state.history)
    return TrainResult(folder, state.history, state.best_epoch, seconds)


def _cpu_seconds_of(state: TrainState) -> float:
    return sum(float(row["cpu_seconds"]) for row in state.history)


def _header(run: Run) -> dict[str, Any]:
    """Return what the weights say of themselves."""
    return {
        "preprocessing": run.task.preprocessing,
        "backbone_source": run.average.model.backbone.source,
        "recipe": recipe(run.config),
        "data": run.task.describe(run.config.data.kind),
        "dtype": getattr(torch, run.config.weights_dtype),
    }


def _calibrate(run: Run, folder: RunFolder) -> None:
    """Set the uncertainty of the best weights right, and the threshold that flags empty images."""
    empty = run.task.empty()
    if empty is None:
        return
    model = FilterformerPose.from_pretrained(folder.best)
    model.variance_scales.fill_(1)  # a run that is taken up finds the same scales again
    found = calibrate(model, run.task.validation(), empty)
    model.variance_scales.copy_(found.variance_scales)
    header = _header(run) | {"in_view_threshold": found.in_view_threshold}
    model.save_pretrained(folder.best, **header)


def _restore(run: Run, state: TrainState, epochs: Sequence[Epoch]) -> None:
    """Bring ``run`` to where ``state`` left it, and check that the plan agrees with the history."""
    done = [(row["epoch"], row["stage"]) for row in state.history]
    if done != [(epoch.number, epoch.stage.name) for epoch in epochs[: len(done)]]:
        raise ValueError(
            f"resume: expected stages that begin with the {len(done)} finished epochs, got "
            + ", ".join(f"{stage.name} ({stage.epochs})" for stage in run.config.resolved_stages)
        )
    run.model.load_state_dict(state.model)
    run.average.load_state_dict(state.average)
    run.task.loss.load_state_dict(state.loss)
    run.optimizer.load_state_dict(state.optimizer)


def _train_and_validate(run: Run, epoch: Epoch, reporter: Reporter) -> Row:
    """Return the epoch's row of results."""
    began, cpu_began = time.perf_counter(), cpu_seconds()
    reporter.epoch_begins(epoch)
    row: Row = {"epoch": epoch.number, "stage": epoch.stage.name}
    row |= train_epoch(run, epoch, reporter)
    rate = run.task.images / (time.perf_counter() - began)
    cost: Row = {"samples": run.task.images, "cpu_seconds": cpu_seconds() - cpu_began}
    row |= validate(run)
    seconds = time.perf_counter() - began
    return row | cost | {"images_per_second": rate, "seconds": seconds}


def cpu_seconds() -> float:
    """Return the CPU time of this process and of the workers that it has ended."""
    times = os.times()
    return time.process_time() + times.children_user + times.children_system


def _write(run: Run, state: TrainState, folder: RunFolder) -> None:
    """Write the files of the last epoch in ``state``; its own comes last, and makes it count."""
    header = _header(run)
    best = min(state.history, key=lambda row: float(row[SELECTED_BY]))
    if best is state.history[-1]:
        state.best_epoch = len(state.history)
        run.average.model.save_pretrained(folder.best, **header)
    run.average.model.save_pretrained(folder.last, **header)
    folder.save_results(state.history)
    state.model = run.model.state_dict()
    state.average = run.average.state_dict()
    state.loss = run.task.loss.state_dict()
    state.optimizer = run.optimizer.state_dict()
    folder.save_state(state)


def _epoch_seed(seed: int, epoch: int) -> int:
    return int(np.random.SeedSequence([seed, epoch]).generate_state(1)[0])


def train_epoch(run: Run, epoch: Epoch, reporter: Reporter) -> Row:
    """Pass once over the training split.

    Returns:
        The epoch's last learning rate, the means of the loss and its terms over the images, and
        the loss weights.

    Raises:
        NonFiniteLossError: The loss is infinite or not a number; nothing was written.
    """
    seed = _epoch_seed(run.config.seed, epoch.number)
    torch.manual_seed(seed)
    enter_stage(run.model, epoch.stage)
    if epoch.opens_stage:
        run.optimizer = build_optimizer(run.model, run.task.loss, run.config.optimizer)
    sums = torch.zeros(3, dtype=torch.float64)
    rate, steps, every = 0.0, run.task.steps, run.config.accumulate
    for step, batch in enumerate(run.task.batches(seed), start=1):
        position = epoch.index + (step - 0.5) / steps  # the step's middle
        rate = learning_rate(run.config.optimizer, position, epoch.stage.epochs)
        # Of the batches whose gradients make one step; the last ones may be fewer.
        share = min(every, steps - (step - 1) // every * every)
        values = _gradients(run, batch, epoch, share)
        if step % every == 0 or step == steps:
            _step(run, rate)
        count = run.task.size(batch)
        sums += values * count
        reporter.step(float(values[0]), rate, count)
    means = (sums / run.task.images).tolist()
    return {
        "learning_rate": rate,
        "train_loss": means[0],
        "train_translation_loss": means[1],
        "train_orientation_loss": means[2],
        **run.task.weights(),
    }


def _gradients(run: Run, batch: Any, epoch: Epoch, share: int) -> Tensor:
    """Add a batch's gradients, over ``share``; return its loss and two terms ``(3,)``, float64."""
    with torch.autocast(run.device.type, torch.bfloat16, enabled=run.config.autocast == "bfloat16"):
        terms = run.task.terms(run.model, batch, run.device)
    values = torch.stack(terms).detach().double().cpu()
    if not bool(values.isfinite().all()):
        raise NonFiniteLossError(
            f"the loss became {float(values[0])} in epoch {epoch.number}; "
            f"images: {run.task.names(batch)}"
        )
    torch.autograd.backward(terms.total / share)
    return values


def _step(run: Run, rate: float) -> None:
    """Take one step of the optimizer."""
    for group in run.optimizer.param_groups:
        group["lr"] = rate
    if run.config.optimizer.clip_norm > 0:
        torch.nn.utils.clip_grad_norm_(
            trained_together(run.model, run.task.loss), run.config.optimizer.clip_norm
        )
    run.optimizer.step()
    run.optimizer.zero_grad(set_to_none=True)
    run.average.update()


@torch.no_grad()
def validate(run: Run) -> Row:
    """Return the errors on the validation split, by the names of `PoseError` after ``val_``."""
    model = run.average.model.eval()
    metric = PoseError()
    for batch in run.task.validation():
        pose = model(batch.image.to(run.device))
        metric.update(
            pose.translation.cpu(), pose.orientation.cpu(), batch.translation, batch.orientation
        )
    return {f"val_{name}": float(value) for name, value in metric.compute().items()}
