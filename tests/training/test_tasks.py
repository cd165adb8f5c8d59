"""What a network learns from: heads with a loss of their own, and batches made ahead."""

from dataclasses import replace

import pytest

from ffpose.evaluation import evaluate
from ffpose.training import OptimizerConfig, train
from ffpose.training.tasks import prefetched
from tiny_runs import MODEL_FIELDS, train_config, write_set


@pytest.mark.parametrize(
    "head",
    [
        {"orientation_head": "6d"},
        {
            "orientation_head": "bins",
            "bins": 300,
            "bins_degree": 2,
            "bins_width_deg": 20.0,
        },
    ],
    ids=["6d", "bins"],
)
def test_a_head_with_its_own_loss_learns_eight_images(tmp_path, head):
    """Images of noise, all attitudes: an answer that is constant is off by a quarter of a turn."""
    root = write_set(tmp_path / "set", train=8, val=2, test=2)
    config = train_config(
        root,
        tmp_path / "run",
        model_fields=MODEL_FIELDS | {"dropout": 0.0, **head},
        epochs=40,
        batch_size=8,
        optimizer=OptimizerConfig(learning_rate=5e-3, schedule="cosine", clip_norm=1.0),
    )
    config = replace(config, data=replace(config.data, augment=False))
    result = train(config, quiet=True)
    losses = [row["train_orientation_loss"] for row in result.history]
    assert losses[-1] < 0.7 * losses[0]
    found = evaluate(result.folder.last, "urso", root, "train").summary()
    assert found["median_rotation_error_deg"] < 30
    assert found["mean_pose_baseline"]["median_rotation_error_deg"] > 60


def test_what_is_made_ahead_comes_in_order():
    made = []

    def batches():
        for number in range(5):
            made.append(number)
            yield number

    ahead = prefetched(batches())
    assert made == []
    assert next(ahead) == 0
    assert list(ahead) == [1, 2, 3, 4]
    assert made == [0, 1, 2, 3, 4]


def test_an_error_ahead_comes_where_its_batch_would():
    def batches():
        yield 0
        raise ValueError("expected views, got none")

    ahead = prefetched(batches())
    assert next(ahead) == 0
    with pytest.raises(ValueError, match="expected views"):
        next(ahead)
