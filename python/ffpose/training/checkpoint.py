"""The folder of a training run, with the checkpoint that a run is resumed from.

Every file is written under a temporary name and then renamed, and `RunFolder.save_state` comes last
in an epoch: an epoch counts as finished once its state is saved. A run killed at any moment is
therefore resumed after its last finished epoch, whose files are complete or are rewritten with the
same contents. The first epoch saves a state without history before its weights, so that weights
without a state are those of a run that cannot be resumed.
"""

from __future__ import annotations

import hashlib
import io
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import torch

from ffpose._internal.files import atomic_write, remove_leftovers, same_place, write_csv, write_text
from ffpose.errors import DataError
from ffpose.training.config import TrainConfig
from ffpose.training.options import dump_config, flatten, load_config

Row = dict[str, float | str]
"""One epoch in the table of results, value by column name."""

FREE_FIELDS = {
    "out",
    "epochs",
    "stages",
    "patience",
    "device",
    "tensorboard",
    "data.root",
    "data.cache",
    "data.workers",
}
"""Fields that may change when a run is resumed: where it runs, for how long, and what it writes."""

PATHS = {"data.scene", "symmetry", "init", "backbone_weights"}
"""Fields that may be paths, of which another spelling is the same, or that of a moved file."""

DIGEST_SIZE = hashlib.sha256().digest_size
"""Number of bytes of the SHA-256 at the end of a checkpoint."""


@dataclass
class TrainState:
    """Checkpoint: the state that the next epoch depends on, besides the configuration.

    The order of the images and the random numbers of an epoch follow from the seed and the epoch's
    number, so no generator's state is kept. ``model``, ``average``, ``loss`` and ``optimizer`` are
    state dicts; ``best`` are the averaged weights after ``best_epoch``, the epoch with the lowest
    validation score, 0 before the first; the next stage starts from them.
    """

    model: dict[str, Any] = field(default_factory=dict)
    average: dict[str, Any] = field(default_factory=dict)
    loss: dict[str, Any] = field(default_factory=dict)
    optimizer: dict[str, Any] = field(default_factory=dict)
    history: list[Row] = field(default_factory=list)
    best_epoch: int = 0
    best: dict[str, Any] = field(default_factory=dict)


class RunFolder:
    """The files of a training run in a folder.

    Attributes:
        root: The folder.
        config: The configuration, which ``ffpose train --config`` reads.
        results: Table of results, one row per epoch.
        last: Weights after the last finished epoch.
        best: Weights with the lowest validation score.
        state: Checkpoint that a run is resumed from.
        curves: Plot of loss and errors over the epochs.
    """

    def __init__(self, root: Path) -> None:
        self.root = root
        self.config, self.results = root / "config.yaml", root / "results.csv"
        self.last, self.best = root / "last.safetensors", root / "best.safetensors"
        self.state, self.curves = root / "state.pt", root / "curves.png"

    def open(self, config: TrainConfig, *, resume: bool) -> TrainState:
        """Load the state to start from, a new run's without history; `begin` writes.

        Raises:
            FileExistsError: The folder holds a run, and ``resume`` is false; or its weights alone.
            ValueError: ``config`` differs from that of the run to resume.
            ffpose.DataError: A file of that run cannot be read.
        """
        if not self.state.exists():
            if self.best.exists() or self.last.exists():
                raise FileExistsError(
                    f"{self.root} holds weights without {self.state.name}, which a run resumes "
                    "from: write to another folder"
                )
            return TrainState()
        if not resume:
            raise FileExistsError(
                f"{self.root} holds a training run: resume it, or write to another folder"
            )
        self._check_config(config)
        return self.load_state()

    def begin(self, config: TrainConfig) -> None:
        """Create the folder and write the configuration, after all checks have passed."""
        self.root.mkdir(parents=True, exist_ok=True)
        remove_leftovers(self.root, older_than=0.0)  # only one process writes a run's files
        write_text(self.config, dump_config(config))

    def save_state(self, state: TrainState) -> None:
        """Write the checkpoint with its SHA-256; its last epoch then counts as finished."""
        contents = io.BytesIO()
        torch.save(vars(state), contents)
        with atomic_write(self.state) as path, path.open("wb") as file:
            file.write(contents.getbuffer())
            file.write(hashlib.sha256(contents.getbuffer()).digest())

    def load_state(self) -> TrainState:
        """Read the checkpoint that `save_state` wrote, or raise a DataError if it is damaged."""
        data = self.state.read_bytes()
        contents, digest = data[:-DIGEST_SIZE], data[-DIGEST_SIZE:]
        if (found := hashlib.sha256(contents).digest()) != digest:
            raise DataError(
                "damaged, or not a checkpoint of this version of ffpose: expected SHA-256 "
                f"{digest.hex()} at the end of the file, got {found.hex()}",
                self.state,
            )
        return TrainState(**torch.load(io.BytesIO(contents), map_location="cpu", weights_only=True))

    def save_results(self, history: list[Row]) -> None:
        """Write the table of the last row's columns; NaN where an older version's rows lack one."""
        columns = list(history[-1])
        rows = ([row.get(name, "nan") for name in columns] for row in history)
        write_csv(self.results, [columns, *rows])

    def _check_config(self, config: TrainConfig) -> None:
        saved, given = flatten(load_config(self.config)), flatten(config)
        changed = [
            f"{name}: expected {saved[name]!r}, got {given[name]!r}"
            for name in saved
            if name not in FREE_FIELDS
            and saved[name] != given[name]
            and not (name in PATHS and _same_file(saved[name], given[name]))
        ]
        if changed:
            raise ValueError(
                f"resume: not the configuration of {self.config}: {'; '.join(changed)}"
            )


def _same_file(saved: object, given: object) -> bool:
    """Return whether paths are of one file, or of one that is gone from where it was.

    Labels and symmetry are compared by what they hold as a run goes on, which reads no initial
    weights.
    """
    if same_place(saved, given):
        return True
    before, now = Path(str(saved)), Path(str(given))
    return before.is_absolute() and _is_gone(before) and now.is_file() and before.name == now.name


def _is_gone(path: Path) -> bool:
    try:
        return not path.exists()
    except PermissionError:  # a folder of another user
        return True
