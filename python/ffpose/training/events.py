"""Event files of a training for TensorBoard: the numbers of ``results.csv``, epoch by epoch."""

from __future__ import annotations

from pathlib import Path
from types import TracebackType
from typing import Any, Self

from ffpose.errors import require
from ffpose.training.checkpoint import Row

FOLDER = "tensorboard"


class Events:
    """Writes the rows of results as scalars; nothing where TensorBoard was not asked for.

    Args:
        folder: Of the run; the events lie in ``tensorboard`` in it.
        done: Number of finished epochs; what a stopped run wrote of later ones is left out.
        wanted: Whether to write at all.

    Raises:
        ffpose.MissingExtraError: TensorBoard is not installed.
    """

    def __init__(self, folder: Path, done: int, *, wanted: bool) -> None:
        self._writer: Any = None
        if wanted:
            require("tensorboard", "tb")
            module = require("torch.utils.tensorboard", "tb")
            self._writer = module.SummaryWriter(str(folder / FOLDER), purge_step=done + 1)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._writer is not None:
            self._writer.close()

    def epoch_ends(self, row: Row) -> None:
        """Write a row's numbers under their names in ``results.csv``."""
        if self._writer is None:
            return
        for name, value in row.items():
            if name != "epoch" and not isinstance(value, str):
                self._writer.add_scalar(name, value, int(row["epoch"]))
        self._writer.flush()
