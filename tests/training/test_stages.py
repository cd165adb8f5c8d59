import pytest
from torch import nn

from ffpose.training.stages import PAPER_STAGES, PARTS, Stage, check_stages, enter_stage, plan


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


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"name": "a", "epochs": 0}, "expected at least 1 epoch, got 0"),
        ({"name": "a", "epochs": 1, "freeze": ("head",)}, "got 'head'"),
    ],
)
def test_bad_stages_are_refused(fields, message):
    with pytest.raises(ValueError, match=message):
        Stage(**fields)


ONE_LOOK = tuple(part for part in PARTS if part != "object_backbone")


@pytest.mark.parametrize("second_backbone", [None, nn.Linear(4, 4)])
def test_all_parts_that_a_model_has_cannot_be_frozen(second_backbone):
    model = Parts()
    model.object_backbone = second_backbone
    frozen = ONE_LOOK if second_backbone is None else PARTS
    check_stages(model, (Stage("a", 1, frozen[1:]), *PAPER_STAGES))
    with pytest.raises(ValueError, match="stage 'b': nothing is left to train"):
        check_stages(model, (Stage("a", 1), Stage("b", 1, frozen)))


def test_a_part_that_a_model_lacks_cannot_be_frozen():
    model = Parts()
    model.object_backbone = None
    expected = rf"stage 'a': expected parts out of {', '.join(ONE_LOOK)}, got 'object_backbone'"
    with pytest.raises(ValueError, match=expected):
        check_stages(model, (Stage("a", 1, ("object_backbone",)),))
