"""The stages of a training run.

The paper (section 4.3) trains in three stages: everything for 500 epochs; then the translation for
150 epochs with the orientation branch frozen; then the orientation for 150 epochs with the
translation branch frozen. It does not say whether the shared backbone is trained in the last two.
Here it is frozen there, including its batch norm: training it would change the features that the
frozen branch relies on.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from torch import nn


@dataclass(frozen=True)
class Stage:
    """A number of epochs during which some parts of the model are frozen.

    Attributes:
        name: Name of the stage in the table of results.
        epochs: Number of passes over the training split.
        freeze: Submodules that get no gradient and stay in evaluation mode, out of the parts that
            the network's configuration names (`ffpose.config.NetworkConfig.parts`).
    """

    name: str
    epochs: int
    freeze: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if self.epochs < 1:
            raise ValueError(f"stage {self.name!r}: expected at least 1 epoch, got {self.epochs}")


JOINT_STAGE = Stage("joint", 500)
"""First stage of the paper: everything is trained."""

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
        number: Number of the epoch in the whole run, counted from 1.
        stage: The stage of the epoch.
        index: Index of the epoch within its stage, counted from 0.
    """

    number: int
    stage: Stage
    index: int

    @property
    def opens_stage(self) -> bool:
        """Whether this is the first epoch of its stage."""
        return self.index == 0


def plan(stages: tuple[Stage, ...]) -> list[Epoch]:
    """List the epochs of all stages in order.

    Examples:
        >>> [(e.number, e.stage.name, e.index) for e in plan((Stage("a", 2), Stage("b", 1)))]
        [(1, 'a', 0), (2, 'a', 1), (3, 'b', 0)]
    """
    steps = [(stage, index) for stage in stages for index in range(stage.epochs)]
    return [Epoch(number, stage, index) for number, (stage, index) in enumerate(steps, start=1)]


def check_stages(parts: Sequence[str], stages: Sequence[Stage]) -> None:
    """Check that each stage freezes only parts that the network has, and not all of them.

    Raises:
        ValueError: A stage freezes a part that the network lacks, or all parts.
    """
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
    """Put ``model`` in training mode, except for the parts that ``stage`` freezes.

    A frozen part gets no gradient and stays in evaluation mode: no dropout, and batch norm uses its
    running statistics unchanged. Safe to call at every epoch.
    """
    model.train()
    model.requires_grad_(True)
    for part in stage.freeze:
        model.get_submodule(part).eval().requires_grad_(False)
