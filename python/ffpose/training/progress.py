"""Progress of a training run on standard error, and its results as events for TensorBoard."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

if TYPE_CHECKING:
    from ffpose.training.checkpoint import Row
    from ffpose.training.stages import Epoch


EVENTS = "tensorboard"
"""Folder of a run with its events."""

LONG_WAIT = 0.05
"""Share of an epoch spent waiting for data from which it is shown."""


class Reporter(Progress):
    """A progress bar over the steps of a run with ``finished`` epochs, and a line per epoch."""

    def __init__(self, epochs: int, finished: int, steps: int, *, quiet: bool) -> None:
        super().__init__(
            TextColumn("epoch {task.fields[epoch]}"),
            BarColumn(),
            MofNCompleteColumn(),
            TextColumn("{task.fields[figures]}"),
            TimeElapsedColumn(),
            TextColumn("left"),
            TimeRemainingColumn(elapsed_when_finished=False),
            console=Console(stderr=True, quiet=quiet),
            transient=True,
            disable=quiet,
        )
        self._epochs = epochs
        self._bar = self.add_task("train", total=(epochs - finished) * steps, epoch="", figures="")
        self._images = 0
        self._began = time.perf_counter()

    def note(self, text: str) -> None:
        """Print a line about the run."""
        self.console.print(text, highlight=False)

    def epoch_begins(self, epoch: Epoch) -> None:
        """Show the current epoch, and reset the count of images."""
        self._images, self._began = 0, time.perf_counter()
        self.update(self._bar, epoch=f"{epoch.number}/{self._epochs} {epoch.stage.name}")

    def step(self, loss: float, learning_rate: float, images: int) -> None:
        """Count one step, and show its loss and rates."""
        self._images += images
        rate = self._images / max(time.perf_counter() - self._began, 1e-9)
        figures = f"loss {loss:.4g}  lr {learning_rate:.2e}  {rate:.0f} images/s"
        self.update(self._bar, advance=1, figures=figures)

    def epoch_ends(self, row: Row) -> None:
        """Print the results of the epoch, and the wait for data if it is long."""
        wait = float(row["loader_wait"])
        self.console.print(
            f"epoch {row['epoch']}/{self._epochs}  loss {row['train_loss']:.4g}  "
            f"lr {row['learning_rate']:.2e}  "
            f"val {row['val_median_translation_error_m']:.3g} m "
            f"{row['val_median_rotation_error_deg']:.3g}°  "
            f"{row['images_per_second']:.0f} images/s  {row['seconds']:.1f} s"
            + (f"  {100 * wait:.0f} % of it for data" if wait > LONG_WAIT else ""),
            highlight=False,
        )


@contextmanager
def events(folder: Path, done: int, *, wanted: bool) -> Iterator[Callable[[Row], None]]:
    """Yield a function that writes a row's numbers as scalars, under their names in the table.

    It writes nothing where TensorBoard is not wanted. What a stopped run wrote of epochs after
    ``done`` is left out.
    """
    if not wanted:
        yield lambda row: None
        return
    from torch.utils.tensorboard import SummaryWriter

    with SummaryWriter(str(folder / EVENTS), purge_step=done + 1) as writer:

        def write(row: Row) -> None:
            for name, value in row.items():
                if name != "epoch" and not isinstance(value, str):
                    writer.add_scalar(name, value, int(row["epoch"]))
            writer.flush()

        yield write
