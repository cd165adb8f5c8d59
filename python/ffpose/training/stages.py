"""The stages of a training run.

The paper (section 4.3) trains in three stages: everything for 500 epochs; then the translation for
150 epochs with the orientation branch frozen; then the orientation for 150 epochs with the
translation branch frozen. It does not say whether the shared backbone is trained in the last two.
Here it is frozen there, including its batch norm: training it would change the features that the
frozen branch relies on. Each stage starts from the best weights so far.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from ffpose.errors import expect

if TYPE_CHECKING:
    from torch import nn


@dataclass(frozen=True)
class Stage:
    """A number of epochs during which some `ffpose.config.NetworkConfig.parts` are frozen.

    Those get no gradient and stay in evaluation mode.
    """

    name: str
    epochs: int
    freeze: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        expect(self.epochs >= 1, f"stage {self.name!r}", "at least 1 epoch", self.epochs)


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
    """One epoch of a run: its number in the run, from 1, and its index within its stage, from 0."""

    number: int
    stage: Stage
    index: int


def next_epoch(
    stages: Sequence[Stage], finished: Sequence[tuple[str, float]], patience: int = 0
) -> Epoch | None:
    """Return the epoch that follows the finished ones; None after the last.

    ``finished`` has stage and validation score, lower is better, of each epoch; a stage ends early
    after ``patience`` epochs without a better score in it, never with 0.

    Raises:
        ValueError: The finished epochs are not those of such stages.

    Examples:
        >>> stages = (Stage("a", 9), Stage("b", 1))
        >>> next_epoch(stages, [("a", 0.5), ("a", 0.6)]).index
        2
        >>> next_epoch(stages, [("a", 0.5), ("a", 0.6)], patience=1).stage.name
        'b'
    """
    left = list(finished)
    for stage in stages:
        scores = []
        while left and left[0][0] == stage.name:
            scores.append(left.pop(0)[1])
        if len(scores) == stage.epochs or _stopped(scores, patience):
            continue
        if left or len(scores) > stage.epochs:
            break
        return Epoch(len(finished) + 1, stage, len(scores))
    else:
        if not left:
            return None
    planned = ", ".join(f"{stage.name} ({stage.epochs})" for stage in stages)
    expected = f"expected stages that begin with the {len(finished)} finished epochs"
    raise ValueError(f"resume: {expected}, got {planned}")


def _stopped(scores: Sequence[float], patience: int) -> bool:
    """Tell whether the last ``patience`` scores of a stage are no better than one before."""
    return 0 < patience < len(scores) and min(scores[-patience:]) >= min(scores[:-patience])


def check_stages(parts: Sequence[str], stages: Sequence[Stage]) -> None:
    """Check that each stage freezes only parts that the network has, and not all of them.

    Raises:
        ValueError: One does not, or has another's name.
    """
    names = [stage.name for stage in stages]
    if len(set(names)) < len(names):
        raise ValueError(f"stages: expected names that differ, got {', '.join(names)}")
    for stage in stages:
        name = f"stage {stage.name!r}"
        for part in stage.freeze:
            expect(part in parts, name, f"parts out of {', '.join(parts)}", part)
        if set(stage.freeze) == set(parts):
            raise ValueError(f"{name}: nothing is left to train, all parts are frozen")


FROZEN_WITH = {"translation_branch": ("s_t",), "orientation_branch": ("s_q", "orientation")}
"""Learned weights of a branch's loss (`ffpose.training.losses.JointLoss`), and its head."""


def enter_stage(model: nn.Module, loss: nn.Module, stage: Stage) -> None:
    """Put ``model`` in training mode, except for the parts that ``stage`` freezes.

    A frozen part gets no gradient and stays in evaluation mode: no dropout, and batch norm uses its
    running statistics unchanged. The learned weight of a frozen branch's loss gets none either: the
    branch's errors do not fall any more, and would only move it.
    """
    frozen = {name for part in stage.freeze for name in (part, *FROZEN_WITH.get(part, ()))}
    for name, weight in loss.named_parameters():
        weight.requires_grad_(name not in frozen)
    model.train()
    model.requires_grad_(True)
    for name, part in model.named_children():
        if name in frozen:
            part.eval().requires_grad_(False)
