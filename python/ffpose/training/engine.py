"""The training loop: a plain one.

The loss is that of equations 9 to 11, the optimiser Adam, the stages those of
`ffpose.training.stages`. Every random number of an epoch (the order of the images, augmentation,
dropout) comes from the run's seed and the number of the epoch alone, so a run that was interrupted
and taken up gives the weights of one that was not, bit for bit on the same machine and number of
threads.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor
from torch.utils.data import DataLoader

from ffpose.datasets import PoseDataset, Sample
from ffpose.metrics import PoseError
from ffpose.training.checkpoint import Row, RunFolder, TrainState
from ffpose.training.config import TrainConfig
from ffpose.training.progress import Reporter
from ffpose.training.run import Run, build_optimizer, build_run
from ffpose.training.schedule import learning_rate
from ffpose.training.stages import Epoch, enter_stage, plan

SELECTED_BY = "val_esa_score"
"""The column whose lowest value makes the best epoch: it weighs both errors without units."""


class NonFiniteLossError(RuntimeError):
    """The loss is not a number any more; the text names the images of the batch."""


@dataclass(frozen=True)
class TrainResult:
    """What a training run came to.

    Attributes:
        folder: Its files.
        history: The table of results, a row an epoch.
        best_epoch: Number of the epoch whose weights are the best.
        seconds: Time spent in epochs, those before an interruption included.
    """

    folder: RunFolder
    history: list[Row]
    best_epoch: int
    seconds: float


def train(config: TrainConfig, *, resume: bool = False, quiet: bool = False) -> TrainResult:
    """Train a model and leave its weights, its table of results and its configuration.

    Args:
        config: What to train, on which images, and where to write.
        resume: Take up the run in ``config.out`` after its last finished epoch; where there is
            none, begin one.
        quiet: Print nothing.

    Returns:
        The run's files and figures.

    Raises:
        FileExistsError: ``config.out`` holds a run, and ``resume`` is false.
        ValueError: An unknown name in ``config``, or a configuration other than the run's.
        ffpose.DataError: An image or a label cannot be used.
        NonFiniteLossError: The loss is infinite or not a number.
    """
    folder = RunFolder(config.out)
    state = folder.open(config, resume=resume)
    run = build_run(config)
    epochs = plan(config.resolved_stages)
    if state.history:
        _restore(run, state, epochs)
    folder.begin(config)
    done, steps = len(state.history), len(_loader(run, run.train_set, seed=0))
    with Reporter(len(epochs), done, steps, quiet=quiet) as reporter:
        for epoch in epochs[done:]:
            row = _train_and_validate(run, epoch, reporter)
            state.history.append(row)
            _write(run, state, folder)
            reporter.epoch_ends(row)
    seconds = sum(float(row["seconds"]) for row in state.history)
    return TrainResult(folder, state.history, state.best_epoch, seconds)


def _restore(run: Run, state: TrainState, epochs: Sequence[Epoch]) -> None:
    """Bring ``run`` to where ``state`` left it, and check that the plan agrees with the history."""
    done = [(row["epoch"], row["stage"]) for row in state.history]
    if done != [(epoch.number, epoch.stage.name) for epoch in epochs[: len(done)]]:
        raise ValueError(
            f"resume: expected stages that begin with the {len(done)} finished epochs, got "
            + ", ".join(f"{stage.name} ({stage.epochs})" for stage in run.config.resolved_stages)
        )
    run.model.load_state_dict(state.model)
    run.loss.load_state_dict(state.loss)
    run.optimizer.load_state_dict(state.optimizer)


def _train_and_validate(run: Run, epoch: Epoch, reporter: Reporter) -> Row:
    """Return the epoch's row of results."""
    began = time.perf_counter()
    reporter.epoch_begins(epoch)
    row: Row = {"epoch": epoch.number, "stage": epoch.stage.name}
    row |= train_epoch(run, epoch, reporter)
    rate = len(run.train_set) / (time.perf_counter() - began)
    row |= validate(run)
    return row | {"images_per_second": rate, "seconds": time.perf_counter() - began}


def _write(run: Run, state: TrainState, folder: RunFolder) -> None:
    """Write the files of the last epoch in ``state``; its own comes last, and makes it count."""
    preprocessing = run.train_set.preprocessing
    best = min(state.history, key=lambda row: float(row[SELECTED_BY]))
    if best is state.history[-1]:
        state.best_epoch = len(state.history)
        run.model.save_pretrained(folder.best, preprocessing=preprocessing)
    run.model.save_pretrained(folder.last, preprocessing=preprocessing)
    folder.save_results(state.history)
    state.model = run.model.state_dict()
    state.loss = run.loss.state_dict()
    state.optimizer = run.optimizer.state_dict()
    folder.save_state(state)


def _loader(run: Run, dataset: PoseDataset, seed: int) -> DataLoader[Sample]:
    """Return batches of ``dataset``; the training split comes in an order drawn from ``seed``."""
    return DataLoader(
        dataset,
        batch_size=run.config.batch_size,
        shuffle=dataset is run.train_set,
        num_workers=run.config.data.workers,
        generator=torch.Generator().manual_seed(seed),
    )


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
        run.optimizer = build_optimizer(run.model, run.loss, run.config.optimizer)
    loader = _loader(run, run.train_set, seed)
    sums = torch.zeros(3, dtype=torch.float64)
    rate = 0.0
    for step, batch in enumerate(loader, start=1):
        position = epoch.index + (step - 0.5) / len(loader)  # the step's middle
        rate = learning_rate(run.config.optimizer, position, epoch.stage.epochs)
        values = _step(run, batch, rate, epoch)
        sums += values * len(batch.image)
        reporter.step(float(values[0]), rate, len(batch.image))
    means = (sums / len(run.train_set)).tolist()
    return {
        "learning_rate": rate,
        "train_loss": means[0],
        "train_translation_loss": means[1],
        "train_orientation_loss": means[2],
        "s_t": run.loss.s_t.item(),
        "s_q": run.loss.s_q.item(),
    }


def _step(run: Run, batch: Sample, rate: float, epoch: Epoch) -> Tensor:
    """Take one step of the optimiser; return the loss and its two terms ``(3,)``, float64."""
    for group in run.optimizer.param_groups:
        group["lr"] = rate
    run.optimizer.zero_grad(set_to_none=True)
    pose = run.model(batch.image.to(run.device))
    truth = batch.translation.to(run.device), batch.orientation.to(run.device)
    terms = run.loss(pose.translation, pose.orientation, *truth)
    values = torch.stack(terms).detach().double().cpu()
    if not bool(values.isfinite().all()):
        names = ", ".join(run.train_set.names[int(i)] for i in torch.as_tensor(batch.index))
        raise NonFiniteLossError(
            f"the loss became {float(values[0])} in epoch {epoch.number}; images: {names}"
        )
    terms.total.backward()
    if run.config.optimizer.clip_norm > 0:
        torch.nn.utils.clip_grad_norm_(run.model.parameters(), run.config.optimizer.clip_norm)
    run.optimizer.step()
    return values


@torch.no_grad()
def validate(run: Run) -> Row:
    """Return the errors on the validation split, by the names of `PoseError` after ``val_``."""
    run.model.eval()
    metric = PoseError()
    for batch in _loader(run, run.val_set, seed=0):
        pose = run.model(batch.image.to(run.device))
        metric.update(
            pose.translation.cpu(), pose.orientation.cpu(), batch.translation, batch.orientation
        )
    return {f"val_{name}": float(value) for name, value in metric.compute().items()}
