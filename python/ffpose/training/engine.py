"""The training loop.

The loss is Eq. 9-11 of the paper, the optimizer Adam, and the stages are those of
`ffpose.training.stages`. All random numbers of an epoch (order of the images, augmentation,
dropout) come from the run's seed and the epoch's number alone, so a resumed run gives bit for bit
the weights of an uninterrupted one, on the same machine with the same number of threads.
"""

from __future__ import annotations

import math
import os
import time
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from ffpose._internal.files import held
from ffpose.config import looks_twice
from ffpose.errors import require
from ffpose.evaluation.metrics import PoseError
from ffpose.geometry import Target
from ffpose.geometry.symmetry import SymmetryGroup
from ffpose.models import WeightsMetadata, read_metadata
from ffpose.training.calibrate_weights import LEAST_IMAGES, write_calibrated
from ffpose.training.checkpoint import Row, RunFolder, TrainState
from ffpose.training.config import TrainConfig
from ffpose.training.memory import keep_freed_memory
from ffpose.training.processes import accumulating, count_processes, joined, started
from ffpose.training.progress import Reporter, events
from ffpose.training.run import Run, build_optimizer, build_run
from ffpose.training.stages import Epoch, enter_stage, next_epoch
from ffpose.training.tasks import Objective

SELECTED_BY: dict[Target, str] = {"object": "val_esa_score", "camera": "val_scene_score"}
"""Column whose lowest value selects the best epoch; it combines both errors without units.

Of an object it divides by the distance; of a camera, by the spread of the positions.
"""


class NonFiniteLossError(RuntimeError):
    """The loss, or a pose of a validation image, is infinite or NaN; the message says which."""


@dataclass(frozen=True)
class TrainResult:
    """Result of a training run.

    Attributes:
        folder: Files of the run.
        history: The table of results, one row per epoch; ``samples`` and ``cpu_seconds`` count its
            training without the validation.
        best_epoch: Number of the epoch with the best weights.
        leads: Whether this is the process, of several, that wrote the files.
    """

    folder: RunFolder
    history: list[Row]
    best_epoch: int
    leads: bool

    @property
    def seconds(self) -> float:
        """Time spent in epochs, including those before an interruption."""
        return sum(float(row["seconds"]) for row in self.history)


def train(
    config: TrainConfig,
    *,
    resume: bool = False,
    quiet: bool = False,
    cpu_minutes: float | None = None,
) -> TrainResult:
    """Train a model, and write its weights, table of results and configuration.

    Args:
        config: What to train, on which images, and where to write.
        resume: Resume the run in ``config.out`` after its last finished epoch; start a new run
            where there is none.
        quiet: Print nothing.
        cpu_minutes: Begin no epoch once training has taken as many minutes of CPU time.

    Returns:
        The run's files and results.

    Raises:
        FileExistsError: ``config.out`` holds a run, and ``resume`` is false; or its weights alone.
        ValueError: A name in ``config`` is unknown, or ``config``, the training labels or their
            camera differ from those of the run to resume.
        ffpose.DataError: An image or a label cannot be used.
        ffpose.MissingExtraError: TensorBoard is asked for and not installed.
        NonFiniteLossError: The loss is infinite or NaN.
        OSError: The folder cannot be written, or another process trains in it.
    """
    if config.tensorboard:
        require("tensorboard", "tb")
    config = replace(config, processes=count_processes(config.processes))
    RunFolder(config.out).open(config, resume=resume)  # refuses before others are started
    with started(config.processes, _train, config, resume, True, cpu_minutes):
        return _train(config, resume, quiet, cpu_minutes)


def _train(
    config: TrainConfig, resume: bool, quiet: bool, cpu_minutes: float | None
) -> TrainResult:
    """Do what `train` does, as one of the processes that train together."""
    keep_freed_memory()
    with joined(config.device) as processes, ExitStack() as folders:
        if there := config.out.is_dir() and processes.leads:
            folders.enter_context(held(config.out))  # before its state is read
        quiet = quiet or not processes.leads
        folder = RunFolder(config.out)
        state = folder.open(config, resume=resume)
        resumed = read_metadata(folder.last) if state.history else None
        run = build_run(config, processes, resumed=resumed, quiet=quiet)
        if resumed is not None:
            _restore(run, state, resumed)
        if processes.leads:
            folder.begin(config)
            if not there:
                folders.enter_context(held(config.out))
        done, steps = len(state.history), run.task.steps
        epochs = sum(stage.epochs for stage in config.resolved_stages)
        with (
            events(config.out, done, wanted=config.tensorboard and processes.leads) as write_events,
            Reporter(epochs, done, steps, quiet=quiet) as reporter,
        ):
            if run.calibration and (few := len(run.calibration.whole)) < LEAST_IMAGES:
                reporter.note(f"{few} images calibrate: fewer than {LEAST_IMAGES} tell little")
            while (epoch := _next_epoch(run, state)) is not None:
                spent = sum(float(row["cpu_seconds"]) for row in state.history)
                if cpu_minutes is not None and spent >= 60 * cpu_minutes:
                    break
                if epoch.index == 0 and state.history:
                    run.average.restart(state.best)
                row = _train_and_validate(run, epoch, reporter)
                state.history.append(row)
                _keep_best(run, state)
                if processes.leads:
                    _write(run, state, folder)
                write_events(row)
                reporter.epoch_ends(row)
        if processes.leads and looks_twice(run.model.config):
            assert run.calibration is not None
            for weights in (folder.best, folder.last):
                done_before = read_metadata(weights).calibration or {}
                if done_before.get("images") != run.calibration.about:
                    write_calibrated(weights, run.calibration)
        processes.wait()
        return TrainResult(folder, state.history, state.best_epoch, processes.leads)


def _scores(run: Run, state: TrainState) -> list[float]:
    """Return the validation score of each finished epoch; the lowest is the best."""
    column = SELECTED_BY[run.task.val_set.target]
    return [float(row[column]) for row in state.history]


def _next_epoch(run: Run, state: TrainState) -> Epoch | None:
    stages = (str(row["stage"]) for row in state.history)
    finished = list(zip(stages, _scores(run, state), strict=True))
    return next_epoch(run.config.resolved_stages, finished, run.config.patience)


def _keep_best(run: Run, state: TrainState) -> None:
    """Keep the averaged weights of the last epoch in ``state``, if they are the best so far."""
    scores = _scores(run, state)
    if state.best_epoch == 0 or scores[-1] < min(scores[:-1]):
        state.best_epoch = len(scores)
        weights = run.average.model.state_dict()
        state.best = {name: value.detach().clone() for name, value in weights.items()}


def _restore(run: Run, state: TrainState, resumed: WeightsMetadata) -> None:
    """Restore ``run`` from ``state``, and check that stages and data agree with its history."""
    _next_epoch(run, state)
    expected, got = (
        f"{data.get('count')} images of digest {str(data.get('digest'))[:12]} and camera {camera}"
        for data, camera in (
            (resumed.data or {}, resumed.config.camera),
            (run.data, run.model.config.camera),
        )
    )
    if expected != got:
        raise ValueError(
            f"data: expected {expected}, which the run began with, got {got}; train on others in a "
            "new folder (--out), from these weights (--init) or from none"
        )
    began = SymmetryGroup.from_json((resumed.recipe or {}).get("symmetry") or [])
    if began.to_json() != run.symmetry.to_json():
        raise ValueError(
            f"symmetry: expected {began}, which the run began with, got {run.symmetry}; train"
            " modulo another in a new folder (--out)"
        )
    run.model.load_state_dict(state.model)
    run.average.load_state_dict(state.average)
    run.task.loss.load_state_dict(state.loss)
    run.optimizer.load_state_dict(state.optimizer)


def _train_and_validate(run: Run, epoch: Epoch, reporter: Reporter) -> Row:
    """Train one epoch, validate, and return the epoch's row of results."""
    began, cpu_began = time.perf_counter(), cpu_seconds()
    reporter.epoch_begins(epoch)
    row: Row = {"epoch": epoch.number, "stage": epoch.stage.name}
    row |= train_epoch(run, epoch, reporter)
    rate = run.task.images / (time.perf_counter() - began)
    spent = run.task.processes.total(torch.tensor(cpu_seconds() - cpu_began, dtype=torch.float64))
    row |= validate(run)
    row |= {"samples": run.task.images, "cpu_seconds": float(spent), "images_per_second": rate}
    return row | {"seconds": time.perf_counter() - began}


def cpu_seconds() -> float:
    """Return the CPU time of this process and of the workers that it has ended."""
    times = os.times()
    return time.process_time() + times.children_user + times.children_system


def _write(run: Run, state: TrainState, folder: RunFolder) -> None:
    """Write the files of the last epoch in ``state``, the checkpoint last."""
    if len(state.history) == 1:
        folder.save_state(TrainState())
    is_best = state.best_epoch == len(state.history)
    for weights in (folder.best, folder.last) if is_best else (folder.last,):
        run.average.model.save_pretrained(
            weights,
            preprocessing=run.task.val_set.preprocessing,
            backbone_source=run.average.model.backbone.source,
            recipe=run.recipe,
            data=run.data,
            dtype=getattr(torch, run.config.weights_dtype),
        )
    folder.save_results(state.history)
    state.model = run.model.state_dict()
    state.average = run.average.state_dict()
    state.loss = run.task.loss.state_dict()
    state.optimizer = run.optimizer.state_dict()
    folder.save_state(state)


def train_epoch(run: Run, epoch: Epoch, reporter: Reporter) -> Row:
    """Train for one pass over the training split.

    Returns:
        The epoch's last learning rate, the means of the loss and its terms over the images, the
        weights of the loss terms, and ``loader_wait``, the share of the time in which the loop
        waited for data.

    Raises:
        NonFiniteLossError: The loss is infinite or NaN; nothing was written.
    """
    seed = int(np.random.SeedSequence([run.config.seed, epoch.number]).generate_state(1)[0])
    torch.manual_seed(seed + run.task.processes.rank)
    enter_stage(run.model, run.task.loss, epoch.stage)
    if epoch.index == 0:
        run.optimizer = build_optimizer(run.model, run.task.loss, run.config.optimizer)
    objective = run.task.processes.parallel(Objective(run.task, run.model, run.device))
    sums = torch.zeros(3, dtype=torch.float64)
    rate, steps, every = 0.0, run.task.steps, run.config.accumulate
    began, waits = time.perf_counter(), list[float]()
    for step, batch in enumerate(awaited(run.task.batches(seed), waits), start=1):
        position = epoch.index + (step - 0.5) / steps  # the middle, where no schedule is at zero
        rate = run.config.optimizer.rate(position, epoch.stage.epochs)
        # Number of batches whose gradients make one step; the last step may have fewer.
        share = min(every, steps - (step - 1) // every * every)
        last = step % every == 0 or step == steps
        with accumulating(objective, last=last):
            values = _gradients(run, objective, batch, epoch, share)
        if last:
            _step(run, rate)
        count = len(batch.index)
        sums += values * count
        reporter.step(float(values[0]), rate, count)
    means = (run.task.processes.total(sums) / run.task.images).tolist()
    return {
        "learning_rate": rate,
        "train_loss": means[0],
        "train_translation_loss": means[1],
        "train_orientation_loss": means[2],
        **run.task.weights(),
        "loader_wait": sum(waits) / (time.perf_counter() - began),
    }


def awaited(items: Iterator[Any], waits: list[float]) -> Iterator[Any]:
    """Yield the items, and add the seconds of waiting for each, and for the end, to ``waits``."""
    while True:
        began = time.perf_counter()
        item = next(items, None)
        waits.append(time.perf_counter() - began)
        if item is None:
            return
        yield item


def _gradients(run: Run, objective: nn.Module, batch: Any, epoch: Epoch, share: int) -> Tensor:
    """Accumulate a batch's gradients, divided by ``share``; return its loss terms ``(3,)``."""
    with torch.autocast(run.device.type, torch.bfloat16, enabled=run.config.autocast == "bfloat16"):
        terms = objective(batch)
    values = torch.stack(terms).detach().double().cpu()
    finite = bool(values.isfinite().all())
    if run.task.processes.total(torch.tensor(float(not finite))) > 0:  # so that all end alike
        became = f"the loss became {float(values[0])}" if not finite else "a loss is not finite"
        where = f"images: {run.task.names(batch)}" if not finite else "in another process"
        raise _diverged(run, f"{became} in epoch {epoch.number}; {where}")
    torch.autograd.backward(terms.total / share)
    return values


def _diverged(run: Run, found: str) -> NonFiniteLossError:
    rate = f"a lower optimizer.learning_rate than {run.config.optimizer.learning_rate:g}"
    return NonFiniteLossError(f"{found}. Another seed, a clip_norm, or {rate} may help")


def _step(run: Run, rate: float) -> None:
    for group in run.optimizer.param_groups:
        group["lr"] = rate
    parameters = [*run.model.parameters(), *run.task.loss.parameters()]
    if run.config.optimizer.clip_norm > 0:
        torch.nn.utils.clip_grad_norm_(parameters, run.config.optimizer.clip_norm)
    run.optimizer.step()
    run.optimizer.zero_grad(set_to_none=True)
    run.average.update()


@torch.no_grad()
def validate(run: Run) -> Row:
    """Return the errors on the validation split, named as in `PoseError` with prefix ``val_``.

    Rotation errors are modulo the run's symmetry. Where labels locate the camera,
    ``val_scene_score`` besides: the median position error, relative to the spread of the split's
    positions, plus the median rotation error in radians. Each process computes its share; the
    metric brings them together.

    Raises:
        NonFiniteLossError: A pose is not finite.
    """
    run.task.processes.agree(run.average.model)
    model = run.average.model.eval()
    metric = PoseError(run.task.val_set.target, process_group=run.task.processes.patient)
    for batch in run.task.validation():
        t_hat, q_hat = (part.cpu() for part in model(batch.image.to(run.device))[:2])
        if not bool(t_hat.isfinite().all() and q_hat.isfinite().all()):
            raise _diverged(run, "training diverged: poses of validation images are not finite")
        truth = run.symmetry.nearest(*(q.double().numpy() for q in (q_hat, batch.orientation)))
        metric.update(t_hat, q_hat, batch.translation, torch.from_numpy(truth))
    row: Row = {f"val_{name}": float(value) for name, value in metric.compute().items()}
    if run.task.val_set.target == "camera":
        position = float(row["val_median_translation_error_m"]) / run.task.val_set.spread
        rotation = math.radians(float(row["val_median_rotation_error_deg"]))
        row["val_scene_score"] = position + rotation
    return row
