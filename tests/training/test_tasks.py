"""What a network learns from: heads with a loss of their own, and batches made ahead."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from ffpose.training import OptimizerConfig
from ffpose.training.processes import Processes
from ffpose.training.run import build_run
from ffpose.training.tasks import prefetched
from tiny_runs import MODEL_FIELDS, train_config, write_set


@pytest.mark.slow
def test_a_head_with_its_own_loss_learns_eight_images(tmp_path):
    """Images of noise, all attitudes: an answer that is constant is off by a quarter of a turn."""
    head = {"orientation_head": "bins", "bins": 300, "bins_degree": 2, "bins_width_deg": 20.0}
    root = write_set(tmp_path / "set", train=8, val=2, test=2)
    config = train_config(
        root,
        tmp_path / "run",
        model_fields=MODEL_FIELDS | {"dropout": 0.0, **head},
        batch_size=8,
        optimizer=OptimizerConfig(learning_rate=5e-3),
    )
    run = build_run(replace(config, data=replace(config.data, augment=False)))
    run.model.train()
    losses = []
    for seed in range(60):
        for batch in run.task.batches(seed):
            terms = run.task.terms(run.model, batch, run.device)
            terms.total.backward()
            losses.append(terms.orientation.item())
            run.optimizer.step()
            run.optimizer.zero_grad()
    assert losses[-1] < 0.7 * losses[0]
    with torch.no_grad():
        q_hat = run.model.eval()(batch.image).orientation
    turn = Rotation.from_quat(q_hat, scalar_first=True).inv() * Rotation.from_quat(
        batch.orientation, scalar_first=True
    )
    assert np.degrees(np.median(turn.magnitude())) < 30


def test_processes_augment_each_its_own_way(tmp_path):
    root = write_set(tmp_path / "set", train=8, val=2, test=2)
    config = train_config(root, tmp_path / "run")
    task = build_run(replace(config, data=replace(config.data, workers=1))).task
    task.train_set.records = [task.train_set.records[0]] * 8
    seen = []
    for rank in range(2):
        task.processes = Processes(rank, 2)
        seen.append(torch.cat([batch.image for batch in task.batches(0)]))
    assert not torch.equal(*seen)


def test_more_processes_than_images_are_refused(tmp_path):
    root = write_set(tmp_path / "set", train=2, val=2, test=2)
    task = build_run(train_config(root, tmp_path / "run")).task
    task.processes = Processes(0, 3)
    with pytest.raises(ValueError, match="processes: expected at most 2, one an image, got 3"):
        task.batches(0)


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
