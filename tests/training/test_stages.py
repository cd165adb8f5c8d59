import pytest
from torch import nn

from ffpose.config import CONFIGS, PRESETS
from ffpose.training.stages import PAPER_STAGES, Stage, check_stages, enter_stage, plan


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
    assert len(plan(PAPER_STAGES)) == 800


def test_plan_counts_through_all_stages():
    epochs = plan((Stage("a", 2), Stage("b", 1)))
    assert [epoch.number for epoch in epochs] == [1, 2, 3]
    assert [epoch.opens_stage for epoch in epochs] == [True, False, True]


def test_a_frozen_part_gets_no_gradient_and_stands_in_evaluation():
    model = Parts()
    enter_stage(model, PAPER_STAGES[1])
    assert trainable(model) == {"translation_branch"}
    assert model.translation_branch.training
    assert not any(module.training for module in model.backbone.modules())
    assert not any(module.training for module in model.orientation_branch.modules())


def test_the_next_stage_thaws_what_it_does_not_freeze():
    model = Parts()
    enter_stage(model, PAPER_STAGES[1])
    enter_stage(model, PAPER_STAGES[2])
    assert trainable(model) == {"orientation_branch"}
    enter_stage(model, PAPER_STAGES[0])
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
