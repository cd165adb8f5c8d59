"""Every network in the same harness: learns, stops and goes on, is tested, predicts."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from ffpose.evaluation.evaluate import evaluate
from ffpose.inference.load import load
from ffpose.models import read_metadata
from ffpose.training import OptimizerConfig, Stage
from ffpose.training.engine import train
from ffpose.training.run import build_run
from networks import MODEL_FIELDS, NETWORKS
from tiny_runs import train_config, write_set

COMPARED = ("ursonet", "posenet")


@pytest.fixture(scope="module")
def root(tmp_path_factory):
    return write_set(tmp_path_factory.mktemp("set") / "set", train=8, val=4, test=4)


def config_of(name, root, out, **fields):
    return train_config(root, out, model=name, model_fields=MODEL_FIELDS[name], **fields)


@pytest.mark.parametrize("fields", [{"beta": 500.0}, {}], ids=["beta", "learned"])
def test_the_weights_of_the_losses_are_fixed_or_learned(root, tmp_path, fields):
    config = config_of("posenet", root, tmp_path)
    run = build_run(replace(config, model_fields=config.model_fields | fields))
    batch = next(run.task.batches(0))
    total, translation, orientation = run.task.terms(run.model, batch, run.device)
    learned = not fields
    assert set(run.task.weights()) == ({"s_t", "s_q"} if learned else set())
    if not learned:
        torch.testing.assert_close(total, translation + 500.0 * orientation)


@pytest.mark.slow
@pytest.mark.parametrize("name", COMPARED)
def test_it_learns_eight_images(name, root, tmp_path):
    """Images of noise, all attitudes: a constant answer is off by a quarter of a turn."""
    config = config_of(name, root, tmp_path, batch_size=8, normalize_translation=True)
    config = replace(
        config,
        data=replace(config.data, augment=False),
        optimizer=OptimizerConfig(learning_rate=3e-3, eps=1e-8, weight_decay=0.0),
    )
    run = build_run(config)
    run.model.train()
    batch = next(run.task.batches(0))
    for _ in range(100):
        run.task.terms(run.model, batch, run.device).total.backward()
        run.optimizer.step()
        run.optimizer.zero_grad()
    with torch.no_grad():
        t_hat, raw = run.model.regress(batch.image)
        q_hat = run.model.orientation.decode(raw)
    cosine = (q_hat * batch.orientation).sum(-1).abs().clamp(max=1)
    assert np.degrees(2 * torch.acos(cosine).numpy()).max() < 15
    assert (t_hat - batch.translation).norm(dim=-1).max() < 0.3


@pytest.mark.slow
@pytest.mark.parametrize("name", NETWORKS)
def test_trained_in_stages_resumed_tested_and_used(name, root, tmp_path):
    stages = (Stage("joint", 1), Stage("translation", 1, ("backbone", "orientation_branch")))
    whole = config_of(name, root, tmp_path / "whole", epochs=None, stages=stages)
    stopped = replace(whole, out=tmp_path / "stopped", stages=stages[:1])
    train(whole, quiet=True)
    train(stopped, quiet=True)
    train(replace(stopped, stages=stages), quiet=True, resume=True)
    last = "last.safetensors"
    assert (whole.out / last).read_bytes()[-1000:] == (stopped.out / last).read_bytes()[-1000:]
    assert read_metadata(whole.out / last).config.camera is not None
    evaluation = evaluate(whole.out / last, "urso", root)
    assert evaluation.predicted.shape == (4, 7)
    pose = load(whole.out / last)(evaluation.dataset.load_image(0))
    np.testing.assert_allclose(pose.t, evaluation.predicted[0, :3], rtol=1e-3, atol=1e-3)
