"""The stages of a training run, as data.

The paper (section 4.3) trains three times in a row: everything for 500 epochs; then, with the
orientation branch frozen, 150 epochs for the translation; then, with the translation branch frozen,
150 epochs for the orientation. It does not say what becomes of the backbone that both branches
share. It is read as fixed in the last two stages, its batch norm included: were it to move, it
would move under the branch that is frozen, and spoil it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from torch import nn

PARTS = ("backbone", "object_backbone", "translation_branch", "orientation_branch")
"""The submodules of a model that a stage may freeze; the second is of one that looks twice."""


@dataclass(frozen=True)
class Stage:
    """A number of epochs during which some parts of the model stand still.

    Attributes:
        name: What the stage is called in the table of results.
        epochs: How many passes over the training split.
        freeze: Names out of `PARTS`: submodules that get no gradient and stay in evaluation mode.
    """

    name: str
    epochs: int
    freeze: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if self.epochs < 1:
            raise ValueError(f"stage {self.name!r}: expected at least 1 epoch, got {self.epochs}")
        unknown = [part for part in self.freeze if part not in PARTS]
        if unknown:
            raise ValueError(
                f"stage {self.name!r}: expected parts out of {', '.join(PARTS)}, got {unknown[0]!r}"
            )


JOINT_STAGE = Stage("joint", 500)
"""The first stage of the paper: everything is trained."""

PAPER_STAGES = (
    JOINT_STAGE,
    Stage("translation", 150, ("backbone", "orientation_branch")),
    Stage("orientation", 150, ("backbone", "translation_branch")),
)
"""All three stages of the paper."""


@dataclass(frozen=True)
class Epoch:
    """One epoch of a plan.

    Attributes:
        number: Counts from 1 through all stages.
        stage: The stage that it belongs to.
        index: Counts from 0 within the stage.
    """

    number: int
    stage: Stage
    index: int

    @property
    def opens_stage(self) -> bool:
        """Whether this is the first epoch of its stage."""
        return self.index == 0


def plan(stages: tuple[Stage, ...]) -> list[Epoch]:
    """Lay the epochs of all stages in a row.

    Example:
        >>> [(e.number, e.stage.name, e.index) for e in plan((Stage("a", 2), Stage("b", 1)))]
        [(1, 'a', 0), (2, 'a', 1), (3, 'b', 0)]
    """
    steps = [(stage, index) for stage in stages for index in range(stage.epochs)]
    return [Epoch(number, stage, index) for number, (stage, index) in enumerate(steps, start=1)]


def check_stages(model: nn.Module, stages: Sequence[Stage]) -> None:
    """Check that each stage freezes parts that ``model`` has, and leaves one to train.

    Raises:
        ValueError: It does not; the message names the stage.
    """
    parts = [part for part in PARTS if getattr(model, part, None) is not None]
    for stage in stages:
        missing = [part for part in stage.freeze if part not in parts]
        if missing:
            raise ValueError(
                f"stage {stage.name!r}: expected parts out of {', '.join(parts)}, "
                f"got {missing[0]!r}"
            )
        if set(stage.freeze) == set(parts):
            raise ValueError(
                f"stage {stage.name!r}: nothing is left to train, all parts are frozen"
            )


def enter_stage(model: nn.Module, stage: Stage) -> None:
    """Put ``model`` in training mode, all but the parts that ``stage`` freezes.

    A frozen part gets no gradient and runs as in evaluation: no dropout, and batch norm keeps its
    running statistics. Safe to call again at every epoch.
    """
    model.train()
    model.requires_grad_(True)
    for part in stage.freeze:
        model.get_submodule(part).eval().requires_grad_(False)
