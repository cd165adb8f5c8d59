import shutil
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image
from safetensors.torch import load_file

from ffpose._internal.files import held
from ffpose.errors import DataError
from ffpose.geometry import Camera
from ffpose.models import FilterformerPose, read_metadata
from ffpose.training import DataConfig, OptimizerConfig, Stage, engine
from ffpose.training.checkpoint import RunFolder
from ffpose.training.engine import NonFiniteLossError, cpu_seconds, train, train_epoch
from ffpose.training.losses import JointLoss
from ffpose.training.options import load_config
from ffpose.training.processes import Processes
from ffpose.training.progress import Reporter
from ffpose.training.run import (
    build_optimizer,
    build_run,
    chosen_autocast,
    translation_statistics,
)
from ffpose.training.stages import Epoch
from studies.table import read_results
from tiny_runs import MODEL_FIELDS, train_config, write_set


@pytest.fixture(scope="module")
def image_set(tmp_path_factory):
    return write_set(tmp_path_factory.mktemp("engine") / "set")


@pytest.fixture(scope="module", autouse=True)
def one_thread():
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


def run_quietly(config, **options):
    return train(config, quiet=True, **options)


@pytest.fixture(scope="module")
def trained(image_set, tmp_path_factory, one_thread):
    """A run of one epoch, whose folder stays as it is."""
    out = tmp_path_factory.mktemp("engine") / "run"
    return run_quietly(train_config(image_set, out, epochs=1))


@pytest.fixture
def begun(image_set, trained, tmp_path):
    """The configuration of that run, in a copy of its folder."""
    out = shutil.copytree(trained.folder.root, tmp_path / "run")
    return train_config(image_set, out, epochs=1)


def same_files(first, second):
    return all(
        all(torch.equal(a, b) for a, b in zip(x.values(), y.values(), strict=True))
        for name in ("last.safetensors", "best.safetensors")
        for x, y in [(load_file(first / name), load_file(second / name))]
    )


def without_times(path):
    times = ("seconds", "cpu_seconds", "images_per_second", "loader_wait")
    return [{k: v for k, v in row.items() if k not in times} for row in read_results(path)]


def test_a_run_leaves_its_files_and_nothing_else(image_set, tmp_path):
    result = run_quietly(train_config(image_set, tmp_path / "run"))
    assert sorted(path.name for path in (tmp_path / "run").iterdir()) == [
        "best.safetensors",
        "best.safetensors.sha256",
        "config.yaml",
        "last.safetensors",
        "last.safetensors.sha256",
        "results.csv",
        "state.pt",
    ]
    rows = read_results(tmp_path / "run/results.csv")
    assert [row["epoch"] for row in rows] == [1, 2]
    assert {"train_loss", "learning_rate", "val_esa_score", "seconds"} <= set(rows[0])
    assert result.best_epoch in (1, 2)
    lowest = min(result.history, key=lambda row: row["val_esa_score"])
    assert lowest["epoch"] == result.best_epoch


@pytest.mark.slow
@pytest.mark.parametrize(
    ("workers", "epochs", "fields"),
    [
        (0, 3, {"ema": 0.9, "accumulate": 2}),
        (2, 2, {}),
        (0, 2, {"optimizer": OptimizerConfig(kind="muon", learning_rate=1e-3)}),
    ],
    ids=["adam", "workers", "muon"],
)
def test_a_resumed_run_equals_an_uninterrupted_one_bit_for_bit(
    image_set, tmp_path, workers, epochs, fields
):
    whole = train_config(image_set, tmp_path / "whole", epochs=epochs, **fields)
    whole = replace(whole, data=replace(whole.data, workers=workers))
    run_quietly(whole)
    part = replace(whole, out=tmp_path / "part")
    for done in range(epochs):
        run_quietly(replace(part, epochs=done + 1), resume=done > 0)
    assert same_files(tmp_path / "whole", tmp_path / "part")
    assert without_times(tmp_path / "whole/results.csv") == without_times(
        tmp_path / "part/results.csv"
    )


@pytest.mark.slow
@pytest.mark.parametrize("before", [0, 1])
def test_a_kill_between_weights_and_state_costs_the_epoch_alone(
    image_set, trained, tmp_path, monkeypatch, before
):
    whole = train_config(image_set, tmp_path / "whole", epochs=before + 1)
    killed = replace(whole, out=tmp_path / "killed")
    for config in (whole, killed) if before else ():
        shutil.copytree(trained.folder.root, config.out)
    run_quietly(whole, resume=True)

    def kill(*_):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(RunFolder, "save_results", kill)
        with pytest.raises(KeyboardInterrupt):
            run_quietly(killed, resume=True)
    run_quietly(killed, resume=True)
    assert same_files(whole.out, killed.out)


@pytest.mark.parametrize("resume", [False, True])
def test_what_a_killed_training_left_is_removed_at_the_next_start(image_set, tmp_path, resume):
    config = train_config(image_set, tmp_path / "run", epochs=1)
    left = config.out / ".ffpose-left"
    left.mkdir(parents=True)
    (left / "state.pt").write_bytes(b"cut off")
    assert len(run_quietly(config, resume=resume).history) == 1
    assert not left.exists()


def test_the_wait_for_data_is_measured(image_set, tmp_path):
    waits = []
    for name, pause in (("slow", 0.5), ("fast", 0.0)):
        run = build_run(train_config(image_set, tmp_path / name))
        batches = list(run.task.batches(0))

        def late(seed, batches=batches, pause=pause):
            for batch in batches:
                time.sleep(pause)
                yield batch

        run.task.batches = late
        with Reporter(1, 0, 3, quiet=True) as reporter:
            waits.append(train_epoch(run, Epoch(1, Stage("joint", 1), 0), reporter)["loader_wait"])
    assert 2 * waits[1] < waits[0] < 1


@pytest.mark.slow
def test_no_epoch_begins_once_the_time_is_used_up(image_set, tmp_path):
    config = train_config(image_set, tmp_path / "run", epochs=3)
    assert len(run_quietly(config, cpu_minutes=1e-6).history) == 1
    row = run_quietly(config, resume=True, cpu_minutes=1e-6).history[-1]
    assert (row["epoch"], row["samples"]) == (1, 10)
    assert row["cpu_seconds"] > 0
    assert len(run_quietly(config, resume=True, cpu_minutes=60.0).history) == 3


def test_the_time_of_workers_counts_once_they_have_ended():
    before = cpu_seconds()
    code = "import time\nwhile time.process_time() < 0.3: pass"
    subprocess.run([sys.executable, "-S", "-c", code], check=True)
    assert cpu_seconds() - before > 0.25


def test_resuming_a_finished_run_changes_nothing(begun):
    before = (begun.out / "last.safetensors").read_bytes()
    assert len(run_quietly(begun, resume=True).history) == 1
    assert (begun.out / "last.safetensors").read_bytes() == before


def test_a_run_is_not_overwritten(begun):
    with pytest.raises(FileExistsError, match="holds a training run"):
        run_quietly(begun)


@pytest.mark.parametrize("resume", [False, True])
@pytest.mark.parametrize("kept", ["best", "last"])
def test_weights_without_a_state_are_not_overwritten(image_set, tmp_path, kept, resume):
    config = train_config(image_set, tmp_path / "run", epochs=1)
    config.out.mkdir()
    weights = config.out / f"{kept}.safetensors"
    weights.write_bytes(b"trained for a week")
    with pytest.raises(FileExistsError, match=r"holds weights without state\.pt"):
        run_quietly(config, resume=resume)
    assert weights.read_bytes() == b"trained for a week"


def test_resume_takes_another_spelling_of_a_path(image_set, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    data = DataConfig("scenes", image_set, scene="run/scene.json")
    config = train_config(image_set, tmp_path / "run", data=data, init=Path("begin.safetensors"))
    folder = RunFolder(config.out)
    folder.begin(config)
    other = replace(data, scene=str(tmp_path / "run/scene.json"))
    folder._check_config(replace(config, data=other, init=tmp_path / "begin.safetensors"))
    with pytest.raises(ValueError, match=r"data\.scene: expected 'run/scene\.json', got"):
        folder._check_config(replace(config, data=replace(data, scene="scene.json")))


def test_resume_takes_files_that_were_moved_with_their_folder(image_set, tmp_path):
    """As all that `ffpose learn` writes; one that is still where it was is another file."""
    names = ("scene.json", "symmetry.json", "begin.safetensors")

    def config_in(root):
        root.mkdir()
        scene, symmetry, init = (root / name for name in names)
        for path in (scene, symmetry, init):
            path.touch()
        data = DataConfig("scenes", image_set, scene=str(scene))
        return train_config(image_set, root / "run", data=data, symmetry=symmetry, init=init)

    one, other = (config_in(tmp_path / name) for name in ("one", "other"))
    RunFolder(one.out).begin(one)
    with pytest.raises(ValueError, match=r"data\.scene: .*init: .*symmetry: expected"):
        RunFolder(one.out)._check_config(other)
    moved = shutil.move(tmp_path / "one", tmp_path / "moved") / "run"
    RunFolder(moved)._check_config(config_in(tmp_path / "new"))
    with pytest.raises(ValueError, match=r"init: expected .*, got None"):
        RunFolder(moved)._check_config(replace(other, init=None))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            {"seed": 1, "batch_size": 2},
            "batch_size: expected 4, got 2; seed: expected 0, got 1",
        ),
        ({"stages": (Stage("other", 2),)}, "expected stages that begin with the 1 finished"),
        ({"data": DataConfig("urso", Path("no such set"))}, "no such set"),
        ({"epochs": 2, "device": "no such device"}, "device: expected auto, .*no such device"),
    ],
    ids=["fields", "stages", "data", "device"],
)
def test_a_resume_that_is_refused_changes_no_file(begun, change, message):
    before = {path.name: path.read_bytes() for path in begun.out.iterdir()}
    with pytest.raises((ValueError, OSError), match=message):
        run_quietly(replace(begun, **change), resume=True)
    assert {path.name: path.read_bytes() for path in begun.out.iterdir()} == before


def test_a_run_does_not_go_on_modulo_another_symmetry(begun):
    """Though the path of its file is the same: what it holds counts."""
    run = build_run(begun)
    metadata = read_metadata(begun.out / "last.safetensors")
    folded = metadata.recipe | {"symmetry": [{"axis": [0, 0, 1], "fold": 2}]}
    state = RunFolder(begun.out).load_state()
    with pytest.raises(ValueError, match=r"symmetry: expected 2-fold .*, got none; train modulo"):
        engine._restore(run, state, replace(metadata, recipe=folded))
    engine._restore(run, state, metadata)


def test_a_run_that_is_refused_leaves_no_folder(tmp_path):
    with pytest.raises(FileNotFoundError):
        run_quietly(train_config(tmp_path / "no such set", tmp_path / "run"))
    assert not (tmp_path / "run").exists()


def test_a_run_resumes_with_the_same_images_in_another_folder(begun, image_set, tmp_path):
    moved = replace(begun.data, root=shutil.copytree(image_set, tmp_path / "moved"))
    assert len(run_quietly(replace(begun, data=moved, epochs=2), resume=True).history) == 2


@pytest.mark.parametrize(
    ("fields", "focal_length"),
    [({"seed": 1}, 0), ({"train": 11}, 0), ({}, 50.0)],
    ids=["labels", "one more", "camera"],
)
def test_resume_refuses_other_images_labels_and_cameras(begun, tmp_path, fields, focal_length):
    other = write_set(tmp_path / "other", **fields)
    if focal_length:
        Camera(64, 48, focal_length, focal_length, 32.0, 24.0).write(other / "camera.json")
    data = replace(begun.data, root=other)
    with pytest.raises(ValueError, match=r"data: expected 10 images .* got 1[01] images .*--init"):
        run_quietly(replace(begun, data=data, epochs=2), resume=True)


def test_tuples_among_the_model_fields_resume(begun):
    config = replace(begun, model_fields=MODEL_FIELDS | {"image_size": (64, 64)})
    folder = RunFolder(config.out)
    folder.begin(config)
    assert len(folder.open(config, resume=True).history) == 1


def cut(data):
    return data[:-1000]


def flip_one_bit(data):
    middle = len(data) // 2  # within the weights, where no format would notice
    return data[:middle] + bytes([data[middle] ^ 1]) + data[middle + 1 :]


@pytest.mark.parametrize("damage", [cut, flip_one_bit])
def test_resume_refuses_a_damaged_state(begun, damage):
    state = begun.out / "state.pt"
    state.write_bytes(damage(state.read_bytes()))
    with pytest.raises(DataError, match=r"state\.pt: damaged, or not a checkpoint"):
        run_quietly(begun, resume=True)


def test_another_seed_gives_another_model(image_set, trained, tmp_path):
    other = run_quietly(train_config(image_set, tmp_path, epochs=1, seed=1))
    assert not same_files(trained.folder.root, other.folder.root)


def test_weights_remember_how_images_are_read(image_set, tmp_path):
    config = train_config(image_set, tmp_path / "run", epochs=1)
    config = replace(config, data=replace(config.data, mode="center_crop"))
    run_quietly(config)
    metadata = read_metadata(tmp_path / "run/best.safetensors")
    assert metadata.preprocessing.mode == "center_crop"
    assert metadata.preprocessing.size == (64, 64)


def test_images_are_standardized_as_the_backbone_expects(image_set, trained, tmp_path):
    """By the halves of mobilenetv4_conv_small_050, by which black is -1 and white is 1."""
    saved = read_metadata(trained.folder.best).preprocessing
    assert (saved.mean, saved.std, saved.interpolation) == ((0.5,) * 3, (0.5,) * 3, "bicubic")
    config = train_config(image_set, tmp_path / "run")
    run = build_run(replace(config, data=replace(config.data, augment=False)))
    assert run.task.val_set.preprocessing == saved
    for dataset in (run.task.train_set, run.task.val_set):
        assert dataset.preprocessing == saved
        with Image.open(image_set / dataset.names[0]) as image:
            pixels = np.asarray(image.resize((64, 64), Image.Resampling.BICUBIC), np.float32)
        expected = torch.from_numpy(pixels / 127.5 - 1).permute(2, 0, 1)
        torch.testing.assert_close(dataset[0].image, expected)


@pytest.fixture
def best_at_first(monkeypatch):
    """Scores that rise from epoch to epoch."""
    monkeypatch.setattr(
        "ffpose.training.engine._scores", lambda _, state: list(range(len(state.history)))
    )


TWO_STAGES = (Stage("joint", 2), Stage("translation", 2, ("backbone", "orientation_branch")))


@pytest.mark.parametrize(
    ("ema", "interrupted"),
    [(0.0, False), (0.9, False), (0.9, True)],
    ids=["plain", "ema", "resumed"],
)
def test_a_stage_starts_from_the_best_weights_so_far_and_trains_what_is_not_frozen(
    image_set, tmp_path, best_at_first, ema, interrupted
):
    config = train_config(image_set, tmp_path / "run", epochs=None, stages=TWO_STAGES, ema=ema)
    if interrupted:
        run_quietly(replace(config, stages=TWO_STAGES[:1]))
    result = run_quietly(config, resume=interrupted)
    assert result.best_epoch == 1
    best, last = (load_file(config.out / f"{name}.safetensors") for name in ("best", "last"))
    changed = {name for name in best if not torch.equal(best[name], last[name])}
    assert changed
    assert all(name.startswith("translation_branch") for name in changed)
    s_q, s_t = ([row[name] for row in result.history] for name in ("s_q", "s_t"))
    assert s_q[1] == s_q[2] == s_q[3] != s_q[0]
    assert len(set(s_t)) == 4


def test_training_without_progress_ends_early(image_set, tmp_path, best_at_first):
    config = train_config(image_set, tmp_path, epochs=50, patience=2)
    assert len(run_quietly(config).history) == 3
    assert len(run_quietly(replace(config, patience=3), resume=True).history) == 4


@pytest.fixture
def gradient_descent(monkeypatch):
    """Steps that are proportional to the gradients, so that weights tell how large those were."""

    def build(model, loss, config):
        return torch.optim.SGD([*model.parameters(), *loss.parameters()], lr=config.learning_rate)

    monkeypatch.setattr("ffpose.training.engine.build_optimizer", build)


def test_accumulated_gradients_are_those_of_the_larger_batch(image_set, tmp_path, gradient_descent):
    """Where no image sees another: without dropout, batch norm standing still.

    Of 10 images the last two make a step of their own, by fours and by eights.
    """

    def trained(name, **sizes):
        config = train_config(
            image_set,
            tmp_path / name,
            epochs=None,
            stages=(Stage("joint", 1, ("backbone",)),),
            model_fields=MODEL_FIELDS | {"dropout": 0.0},
            optimizer=OptimizerConfig(learning_rate=1e-5),
            **sizes,
        )
        config = replace(config, data=replace(config.data, augment=False))
        begun = build_run(config).model.state_dict()
        after = load_file(run_quietly(config).folder.last)
        return torch.cat([(after[key] - begun[key]).flatten().double() for key in sorted(after)])

    large = trained("large", batch_size=8)
    halves = trained("halves", batch_size=4, accumulate=2)
    apart = trained("apart", batch_size=4)
    assert large.norm() > 0
    assert (halves - large).norm() < 1e-3 * large.norm()
    assert (apart - large).norm() > 0.1 * large.norm()


def test_weights_in_half_precision_take_half_the_room(image_set, tmp_path):
    config = train_config(image_set, tmp_path / "run", epochs=1, weights_dtype="float16")
    folder = run_quietly(config).folder
    trained = folder.load_state().model
    stored = load_file(folder.last)
    for name, value in trained.items():
        if value.is_floating_point():
            half = value.numpy().astype(np.float16)
            assert stored[name].dtype == torch.float16
            np.testing.assert_array_equal(stored[name].numpy(), half)
        else:
            assert torch.equal(stored[name], value)
    whole = tmp_path / "whole.safetensors"
    model = FilterformerPose.from_pretrained(folder.last)
    model.save_pretrained(whole)
    assert folder.last.stat().st_size < 0.6 * whole.stat().st_size
    assert {p.dtype for p in model.parameters()} == {torch.float32}
    for name, value in model.state_dict().items():
        torch.testing.assert_close(value, trained[name], rtol=2**-11, atol=2**-25)


def test_autocast_computes_in_half_and_keeps_whole_weights(image_set, trained, tmp_path):
    half = run_quietly(train_config(image_set, tmp_path, epochs=1, autocast="bfloat16"))
    for result in (trained, half):
        assert {p.dtype for p in load_file(result.folder.last).values()} <= {
            torch.float32,
            torch.int64,
        }
    whole, loss = (result.history[0]["train_translation_loss"] for result in (trained, half))
    assert loss != whole
    assert loss == pytest.approx(whole, rel=0.1)


def test_auto_is_what_the_processor_has_instructions_for(image_set, tmp_path):
    cpuinfo = Path("/proc/cpuinfo")
    if not cpuinfo.is_file() or "flags" not in (text := cpuinfo.read_text()):
        pytest.skip("nothing else tells the processor's instructions")
    expected = "bfloat16" if {"avx512_bf16", "amx_bf16"} & set(text.split()) else "none"
    folder = run_quietly(train_config(image_set, tmp_path, epochs=1, autocast="auto")).folder
    assert read_metadata(folder.best).recipe["autocast"] == expected
    assert load_config(folder.config).autocast == "auto"  # another machine may resume the run
    assert chosen_autocast("auto", torch.device("cuda")) == "bfloat16"


def test_a_loss_that_is_no_number_names_the_images(image_set, tmp_path, monkeypatch):
    monkeypatch.setattr(
        JointLoss, "quaternion_distance", lambda _, q_hat, q: (q_hat * q).sum(1) * torch.nan
    )
    config = train_config(image_set, tmp_path / "run", batch_size=10)
    with pytest.raises(NonFiniteLossError, match=r"the loss became nan in epoch 1; images: ") as e:
        run_quietly(config)
    told, remedy = str(e.value).split("images: ")[1].split(". Another seed, ")
    assert "lower optimizer.learning_rate than" in remedy
    named = told.split(", ")
    assert sorted(named) == sorted(f"{index}_rgb.png" for index in range(10))
    assert not (tmp_path / "run/last.safetensors").exists()


def test_a_loss_that_is_no_number_elsewhere_ends_this_process_too(image_set, tmp_path, monkeypatch):
    """Processes tell each other before the backward pass, in which they wait for each other."""
    told = []
    monkeypatch.setattr(Processes, "total", lambda _, value: told.append(float(value)) or value + 1)
    with pytest.raises(NonFiniteLossError, match="a loss is not finite in epoch 1; in another"):
        run_quietly(train_config(image_set, tmp_path / "run"))
    assert told == [0.0]


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no locks of folders")
def test_two_runs_do_not_write_to_one_folder(image_set, tmp_path):
    (tmp_path / "run").mkdir()
    with held(tmp_path / "run"), pytest.raises(OSError, match="expected no other run at work in"):
        run_quietly(train_config(image_set, tmp_path / "run"))
    assert not list((tmp_path / "run").iterdir())


def test_a_training_that_diverges_is_called_so(image_set, tmp_path):
    """By the validation, where an epoch has one batch."""
    rate = OptimizerConfig(learning_rate=1e10)
    config = train_config(image_set, tmp_path / "run", epochs=1, optimizer=rate)
    with pytest.raises(NonFiniteLossError, match=r"training diverged: .* than 1e\+10"):
        run_quietly(replace(config, batch_size=10))
    assert not (tmp_path / "run/last.safetensors").exists()


def test_training_lowers_the_loss(image_set, tmp_path):
    config = train_config(
        image_set,
        tmp_path / "run",
        epochs=6,
        batch_size=10,
        model_fields=MODEL_FIELDS | {"dropout": 0.0},
        optimizer=OptimizerConfig(learning_rate=3e-3, schedule="cosine", clip_norm=1.0),
    )
    config = replace(config, data=replace(config.data, augment=False, cache=True))
    losses = [row["train_translation_loss"] for row in run_quietly(config).history]
    assert losses[-1] < 0.8 * losses[0]


@pytest.fixture
def rates(monkeypatch):
    """The learning rate of every step that is taken, in order."""
    taken = []
    monkeypatch.setattr(Reporter, "step", lambda _, loss, rate, images: taken.append(rate))
    return taken


def test_every_step_of_an_epoch_has_the_rate_of_that_epoch(image_set, tmp_path, rates):
    optimizer = OptimizerConfig(learning_rate=1e-3, step_epochs=1, step_factor=0.5)
    config = train_config(image_set, tmp_path / "run", epochs=3, optimizer=optimizer)
    history = run_quietly(config).history
    assert rates == [1e-3] * 3 + [5e-4] * 3 + [2.5e-4] * 3
    assert [row["learning_rate"] for row in history] == [1e-3, 5e-4, 2.5e-4]


def test_warm_up_and_cosine_average_to_half_and_no_step_has_none(image_set, tmp_path, rates):
    """Both integrate to half the full rate; for these two the midpoint rule is exact."""
    half = {"learning_rate": 2e-3, "schedule": "cosine"}
    config = train_config(image_set, tmp_path / "c", optimizer=OptimizerConfig(**half))
    run_quietly(config)
    assert sum(rates) / len(rates) == pytest.approx(1e-3)
    assert rates == sorted(rates, reverse=True)
    assert rates[-1] > 0
    rates.clear()
    rise = OptimizerConfig(learning_rate=2e-3, warmup_epochs=2.0)
    run_quietly(train_config(image_set, tmp_path / "w", optimizer=rise))
    assert sum(rates) / len(rates) == pytest.approx(1e-3)
    assert rates[0] > 0


def test_the_head_counts_from_the_training_splits_mean(image_set, tmp_path):
    run = build_run(train_config(image_set, tmp_path / "run"))
    assert run.model.config.translation_mean == pytest.approx(
        run.task.train_set.poses[:, :3].mean(0)
    )
    raw = build_run(train_config(image_set, tmp_path / "raw", normalize_translation=False))
    assert raw.model.config.translation_mean == (0.0, 0.0, 0.0)


def test_translation_statistics_by_hand():
    poses = torch.zeros(2, 7, dtype=torch.float64).numpy()
    poses[:, 0] = 1, 3
    poses[:, 1] = 0.1, 0.1
    poses[:, 2] = 10, 10
    poses = poses.repeat(3, axis=0)  # whose mean 0.1 has a rounding error
    assert translation_statistics(poses) == {
        "translation_mean": (2.0, pytest.approx(0.1), 10.0),
        "translation_std": (1.0, 1.0, 1.0),
    }


def test_loss_weights_have_no_decay():
    model, loss = torch.nn.Linear(2, 2), JointLoss()
    groups = build_optimizer(model, loss, OptimizerConfig()).param_groups
    decay = {id(p): group["weight_decay"] for group in groups for p in group["params"]}
    assert decay[id(loss.s_t)] == decay[id(loss.s_q)] == 0
    assert decay[id(model.weight)] == 1e-4
    assert {group["eps"] for group in groups} == {1e-10}


@pytest.mark.parametrize(
    ("kind", "expected"), [("adam", lambda w: w - 0.1 * w.sign()), ("adamw", lambda w: 0.99 * w)]
)
def test_weight_decay_is_part_of_the_gradient_or_apart_from_it(kind, expected):
    """One step of a rate of 0.1 where the loss has no slope.

    Adam's is of one length, whatever the gradient; AdamW shrinks each weight by rate times decay.
    """
    model, loss = torch.nn.Linear(2, 2), JointLoss()
    config = OptimizerConfig(kind=kind, learning_rate=0.1, weight_decay=0.1)
    optimizer = build_optimizer(model, loss, config)
    before = model.weight.detach().clone()
    for parameter in (*model.parameters(), *loss.parameters()):
        parameter.grad = torch.zeros_like(parameter)
    optimizer.step()
    torch.testing.assert_close(model.weight.detach(), expected(before))
    assert (loss.s_t.item(), loss.s_q.item()) == (-3.0, -6.5)


@pytest.mark.parametrize(
    ("bad", "got"), [({"rol": 10}, r"rol \(did you mean roll\?\)"), ({"roll": "ten"}, "{.roll")]
)
def test_unknown_augmentation_lists_the_known(image_set, tmp_path, bad, got):
    config = train_config(image_set, tmp_path / "run")
    config = replace(config, data=replace(config.data, augmentation=bad))
    with pytest.raises(ValueError, match=rf"data\.augmentation: expected .*roll.* got {got}"):
        run_quietly(config)
