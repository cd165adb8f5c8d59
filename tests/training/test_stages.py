from itertools import repeat

import pytest
from torch import nn

from ffpose.config import CONFIGS, PRESETS
from ffpose.training.losses import JointLoss
from ffpose.training.stages import (
    PAPER_STAGES,
    Stage,
    check_stages,
    enter_stage,
    next_epoch,
)


class Parts(nn.Module):
    def __init__(self):
        super().__init__()
        self.backbone = nn.Sequential(nn.Conv2d(3, 4, 1), nn.BatchNorm2d(4))
        self.translation_branch = nn.Sequential(nn.Linear(4, 4), nn.Dropout())
        self.orientation_branch = nn.Sequential(nn.Linear(4, 4), nn.Dropout())


def trainable(model):
    return {name for name, part in model.named_children() if next(part.parameters()).requires_grad}


def test_the_papers_stages():
    assert [(stage.name, stage.epochs) for stage in PAPER_STAGES] == [
        ("joint", 500),
        ("translation", 150),
        ("orientation", 150),
    ]


def run_through(stages, scores, patience=0):
    """The epochs of a run whose validation gives these scores in turn."""
    epochs, finished = [], []
    while (epoch := next_epoch(stages, finished, patience)) is not None:
        epochs.append(epoch)
        finished.append((epoch.stage.name, next(scores)))
    return epochs


def test_epochs_count_through_all_stages():
    epochs = run_through((Stage("a", 2), Stage("b", 1)), repeat(0.0))
    assert [(epoch.number, epoch.stage.name, epoch.index) for epoch in epochs] == [
        (1, "a", 0),
        (2, "a", 1),
        (3, "b", 0),
    ]
    assert len(run_through(PAPER_STAGES, repeat(0.0))) == 800


@pytest.mark.parametrize(
    ("patience", "names"), [(0, "aaaaab"), (1, "aaab"), (2, "aaaaab"), (3, "aaaaab")]
)
def test_a_stage_ends_early_once_its_score_falls_no_more(patience, names):
    scores = iter([0.5, 0.4, 0.6, 0.3, 0.9, 0.0])
    epochs = run_through((Stage("a", 5), Stage("b", 1)), scores, patience)
    assert "".join(epoch.stage.name for epoch in epochs) == names
    assert [epoch.number for epoch in epochs] == list(range(1, len(names) + 1))


@pytest.mark.parametrize(
    "finished",
    [
        [("b", 0.0)],
        [("a", 0.0), ("b", 0.0)],
        [("a", 0.0)] * 3,
        [("a", 0.0)] * 2 + [("b", 0.0)] * 2,
        [("a", 0.0)] * 2 + [("b", 0.0), ("c", 0.0)],
    ],
)
def test_finished_epochs_of_other_stages_are_refused(finished):
    expected = rf"begin with the {len(finished)} finished epochs, got a \(2\), b \(1\)"
    with pytest.raises(ValueError, match=expected):
        next_epoch((Stage("a", 2), Stage("b", 1)), finished)


def test_stages_of_one_name_are_refused():
    with pytest.raises(ValueError, match="stages: expected names that differ, got a, a"):
        check_stages(CONFIGS["base"].parts, (Stage("a", 1), Stage("a", 2)))


@pytest.mark.parametrize(
    ("stage", "learned"), list(zip(PAPER_STAGES, ("s_t s_q", "s_t", "s_q"), strict=True))
)
def test_the_weight_of_a_frozen_branch_is_frozen(stage, learned):
    loss = JointLoss()
    enter_stage(Parts(), loss, PAPER_STAGES[1])
    enter_stage(Parts(), loss, stage)
    assert [n for n, w in loss.named_parameters() if w.requires_grad] == learned.split()


def test_a_frozen_part_gets_no_gradient_and_stands_in_evaluation():
    model = Parts()
    enter_stage(model, JointLoss(), PAPER_STAGES[1])
    assert trainable(model) == {"translation_branch"}
    assert model.translation_branch.training
    assert not any(module.training for module in model.backbone.modules())
    assert not any(module.training for module in model.orientation_branch.modules())


def test_the_orientation_head_is_frozen_with_its_branch():
    model = Parts()
    model.orientation = nn.Linear(4, 4)
    enter_stage(model, JointLoss(), PAPER_STAGES[1])
    assert trainable(model) == {"translation_branch"}
    enter_stage(model, JointLoss(), PAPER_STAGES[2])
    assert trainable(model) == {"orientation_branch", "orientation"}


def test_the_next_stage_thaws_what_it_does_not_freeze():
    model = Parts()
    enter_stage(model, JointLoss(), PAPER_STAGES[1])
    enter_stage(model, JointLoss(), PAPER_STAGES[2])
    assert trainable(model) == {"orientation_branch"}
    enter_stage(model, JointLoss(), PAPER_STAGES[0])
    assert trainable(model) == {"backbone", "translation_branch", "orientation_branch"}
    assert all(module.training for module in model.modules())


def test_a_stage_without_epochs_is_refused():
    with pytest.raises(ValueError, match="expected at least 1 epoch, got 0"):
        Stage("a", 0)


@pytest.mark.parametrize("config", PRESETS.values(), ids=PRESETS)
def test_every_network_goes_through_the_papers_stages_and_cannot_be_frozen_whole(config):
    check_stages(config.parts, (Stage("a", 1, config.parts[1:]), *PAPER_STAGES))
    with pytest.raises(ValueError, match="stage 'b': nothing is left to train"):
        check_stages(config.parts, (Stage("a", 1), Stage("b", 1, config.parts)))


@pytest.mark.parametrize("part", ["object_backbone", "head"])
def test_a_part_that_a_network_lacks_cannot_be_frozen(part):
    parts = CONFIGS["base"].parts
    expected = rf"stage 'a': expected parts out of {', '.join(parts)}, got '{part}'"
    with pytest.raises(ValueError, match=expected):
        check_stages(parts, (Stage("a", 1, (part,)),))
