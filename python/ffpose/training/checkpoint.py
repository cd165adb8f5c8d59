"""The folder of a training run, and how a run is taken up again.

Every file is written whole under another name and then renamed, and `RunFolder.save_state` comes
last in an epoch: it is what makes the epoch count. A run killed at any moment is therefore taken up
at the last epoch that it finished, and that epoch's files are there or are written again, the same.
"""

from __future__ import annotations

import csv
import pickle
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import torch

from ffpose.errors import DataError
from ffpose.files import atomic_write, remove_leftovers
from ffpose.training.config import TrainConfig
from ffpose.training.config_file import dump_config, flatten, load_config

Row = dict[str, float | str]
"""One epoch in the table of results: column name to value."""

FREE_FIELDS = {"out", "epochs", "stages", "device", "data.root", "data.cache", "data.workers"}
"""Fields that may change when a run is taken up: where it runs, and for how long."""


@dataclass
class TrainState:
    """All that the next epoch depends on, beside the configuration.

    The order of the images and the random numbers of an epoch come from the seed and the number of
    the epoch, so no generator's state is kept.

    Attributes:
        model: The model's `state_dict`.
        average: The `state_dict` of the weights' moving average.
        loss: The loss's `state_dict`: the learnable weights.
        optimizer: The optimizer's `state_dict`.
        history: The rows of all finished epochs.
        best_epoch: Number of the epoch with the lowest validation score; 0 before the first.
    """

    model: dict[str, Any] = field(default_factory=dict)
    average: dict[str, Any] = field(default_factory=dict)
    loss: dict[str, Any] = field(default_factory=dict)
    optimizer: dict[str, Any] = field(default_factory=dict)
    history: list[Row] = field(default_factory=list)
    best_epoch: int = 0


@dataclass(frozen=True)
class RunFolder:
    """The files of a training run.

    Attributes:
        root: The folder.
    """

    root: Path

    @property
    def config(self) -> Path:
        """The configuration, which ``ffpose train --config`` reads."""
        return self.root / "config.yaml"

    @property
    def results(self) -> Path:
        """The table of results, a row an epoch."""
        return self.root / "results.csv"

    @property
    def last(self) -> Path:
        """The weights after the last finished epoch."""
        return self.root / "last.safetensors"

    @property
    def best(self) -> Path:
        """The weights with the lowest validation score."""
        return self.root / "best.safetensors"

    @property
    def state(self) -> Path:
        """What a run is taken up from."""
        return self.root / "state.pt"

    @property
    def curves(self) -> Path:
        """The drawing of the table of results."""
        return self.root / "curves.png"

    def open(self, config: TrainConfig, *, resume: bool) -> TrainState:
        """Read what there is to go on from; nothing is written (`begin` does).

        Args:
            config: What the run is asked to do.
            resume: Go on from the state in the folder, where there is one.

        Returns:
            The state to go on from; its history is empty where a run begins.

        Raises:
            FileExistsError: The folder holds a run, and ``resume`` is false.
            ValueError: ``config`` is not that of the run to resume.
            ffpose.DataError: A file of that run cannot be read.
        """
        state = TrainState()
        if self.state.exists():
            if not resume:
                raise FileExistsError(
                    f"{self.root} holds a training run: resume it, or write to another folder"
                )
            self._check_config(config)
            state = self.load_state()
        return state

    def begin(self, config: TrainConfig) -> None:
        """Make the folder and write the configuration, once nothing speaks against the run."""
        self.root.mkdir(parents=True, exist_ok=True)
        remove_leftovers(self.root, older_than=0.0)  # one process alone writes a run's files
        with atomic_write(self.config) as path:
            path.write_text(dump_config(config))

    def save_state(self, state: TrainState) -> None:
        """Write ``state``; from then on its last epoch is done."""
        with atomic_write(self.state) as path:
            torch.save(asdict(state), path)

    def load_state(self) -> TrainState:
        """Read what `save_state` wrote.

        Raises:
            ffpose.DataError: The file is truncated or is something else.
        """
        try:
            return TrainState(**torch.load(self.state, map_location="cpu", weights_only=True))
        except (RuntimeError, EOFError, TypeError, pickle.UnpicklingError) as error:
            raise DataError(f"not a training state: {error}", self.state) from error

    def save_results(self, history: list[Row]) -> None:
        """Write the table of results; NaN where a run of an older version has no such column."""
        with atomic_write(self.results) as path, path.open("w", newline="") as file:
            writer = csv.DictWriter(file, fieldnames=list(history[-1]), restval="nan")
            writer.writeheader()
            writer.writerows(history)

    def _check_config(self, config: TrainConfig) -> None:
        saved, given = flatten(load_config(self.config)), flatten(config)
        for name in saved.keys() - FREE_FIELDS:
            if saved[name] != given[name]:
                raise ValueError(
                    f"resume: expected {name}={saved[name]!r} as in {self.config}, "
                    f"got {given[name]!r}"
                )


def read_results(path: Path) -> list[Row]:
    """Read a table of results: figures as floats, and the stage's name.

    Raises:
        FileNotFoundError: There is no such file.
    """
    with path.open(newline="") as file:
        return [
            {name: value if name == "stage" else float(value) for name, value in row.items()}
            for row in csv.DictReader(file)
        ]
