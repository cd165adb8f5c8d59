"""Running a study: every variant with every seed, trained and tested as any other network.

A run is a folder, ``VARIANT-seedK``, with the files of a training and, once it is finished,
``results.json``. Finished runs are skipped and interrupted ones taken up after their last epoch, so
a study may be stopped at any moment. A job array runs one process for each variant, in one folder,
after a first call that renders the images (``prepare``).
"""

from __future__ import annotations

import json
import platform
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import accumulate, pairwise
from pathlib import Path
from timeit import Timer
from typing import Any

import torch

import ffpose
from ffpose._internal.files import atomic_write, remove_leftovers
from ffpose._internal.seeds import CHOICES
from ffpose.bench.timing import take_turns
from ffpose.config import NetworkConfig
from ffpose.datasets import Decoding, Part
from ffpose.datasets.scenes import render_images
from ffpose.errors import expect
from ffpose.evaluation.evaluate import evaluate
from ffpose.imaging.preprocessing import Preprocessing
from ffpose.models import BaseNetwork, find_config, load_network
from ffpose.render import find_scene
from ffpose.training import Stage, TrainConfig
from ffpose.training.checkpoint import FREE_FIELDS
from ffpose.training.engine import TrainResult, train
from ffpose.training.options import flatten
from ffpose.training.run import UNKNOWN_CAMERA, build_run
from studies.study import Study, Variant, changed
from studies.table import RESULTS, read_run, write_tables

TEST_SEED = CHOICES.start + 100
"""Seed of the rendered test images, which no training, demo or model card shows."""

ENDLESS = 10_000
"""Epochs of a run that ends by time."""


@dataclass(frozen=True)
class Outcome:
    """Outcome of a call.

    Attributes:
        table: The file ``ablation.md``.
        done: Runs that this call finished.
    """

    table: Path
    done: tuple[str, ...]


@dataclass(frozen=True)
class Run:
    """One training of one variant.

    Attributes:
        variant: The variant.
        config: The training, its seed and folder among it.
        cpu_minutes: After which no epoch begins; None for all epochs.
        test_images: Rendered images to test on; None for the test split of a set on disk.
    """

    variant: Variant
    config: TrainConfig
    cpu_minutes: float | None
    test_images: int | None

    @property
    def folder(self) -> Path:
        """Its files."""
        return self.config.out

    @property
    def settings(self) -> dict[str, Any]:
        """Return the settings that a result depends on, as JSON, without those of the machine."""
        free = FREE_FIELDS - {"epochs", "stages"}
        values = {name: v for name, v in flatten(self.config).items() if name not in free}
        values |= {"cpu_minutes": self.cpu_minutes, "test_images": self.test_images}
        plain: dict[str, Any] = json.loads(json.dumps(values, default=str))
        return plain

    def finished(self) -> bool:
        """Return whether its result is there.

        Raises:
            ValueError: It is that of other settings.
        """
        if not (self.folder / RESULTS).exists():
            return False
        before = read_run(self.folder)["settings"]
        for name, value in self.settings.items():
            if before.get(name) != value:
                raise ValueError(
                    f"{self.folder}: expected {name} {before.get(name)} as when it ran, got "
                    f"{value}; remove the folder, or write to another with --out"
                )
        return True


def ablate(
    study: Study,
    out: Path,
    *,
    seeds: int = 2,
    epochs: int | None = None,
    cpu_minutes: float | None = None,
    variants: Sequence[str] = (),
    changes: Mapping[str, Any] | None = None,
    sets: Path | None = None,
    test_images: int = 500,
    prepare: bool = False,
    quiet: bool = False,
) -> Outcome:
    """Train and test what is not there yet, and write the table after each run.

    Args:
        study: What to train.
        out: The folder to write; one that was begun is gone on with.
        seeds: Runs a variant, with the seeds 0 ... ``seeds - 1`` of weights, order and
            augmentation. All see the same images.
        epochs: Budget of a run in place of the study's, shared by its stages in proportion.
        cpu_minutes: The same in minutes of the training's CPU time: whole epochs of one stage.
        variants: Names of those to run; all for none.
        changes: Fields of the study's base to change, nested: ``{"data": {"count": 1000}}``.
        sets: Folder of sets, each named as its scene, to train and test on: in URSO's layout in
            place of rendered scenes, or of the kind that the study is about.
        test_images: How many images the rendered test set has.
        prepare: Render and cache the images of all runs, and train nothing.
        quiet: Print nothing.

    Raises:
        ValueError: An unknown name, two budgets, or runs of other settings in ``out``.
        ffpose.DataError: An image or a label cannot be used.
        ffpose.training.engine.NonFiniteLossError: A training failed; the other runs can go on.
    """
    expect(seeds >= 1, "seeds", "at least 1", seeds)
    expect(test_images >= 1, "test_images", "at least 1", test_images)
    study = replace(study, base=changed(study.base, changes or {}))
    runs = [
        Run(variant, config, cpu_minutes, None if sets else test_images)
        for seed in range(seeds)
        for variant in study.choose(variants)
        for config in [_training(study, variant, seed, out, epochs, cpu_minutes, sets)]
    ]
    waiting = [run for run in runs if not run.finished()]
    out.mkdir(parents=True, exist_ok=True)
    remove_leftovers(out)
    done = []
    for number, run in enumerate(waiting, start=1):
        if prepare:
            _test_set(run)
            build_run(run.config)
            continue
        if not quiet:
            text = f"{number} of {len(waiting)}: {run.folder.name}, {run.variant.about}"
            print(text, file=sys.stderr, flush=True)
        _finish(study, run, quiet=quiet)
        write_tables(study, out)
        done.append(run.folder.name)
    return Outcome(write_tables(study, out), tuple(done))


def _training(
    study: Study,
    variant: Variant,
    seed: int,
    out: Path,
    epochs: int | None,
    cpu_minutes: float | None,
    sets: Path | None,
) -> TrainConfig:
    """Return the training of a run, once its network is known to be one that can be built."""
    if epochs is not None and cpu_minutes is not None:
        raise ValueError(f"budget: expected epochs or minutes, got {epochs} and {cpu_minutes}")
    if cpu_minutes is not None and not cpu_minutes > 0:
        raise ValueError(f"minutes: expected more than 0, got {cpu_minutes}")
    config = study.config(variant)
    network(config)
    if cpu_minutes is not None and config.optimizer.schedule == "cosine":
        raise ValueError("minutes: expected optimizer.schedule step, for cosine ends with an epoch")
    if epochs is not None:
        config = replace(config, stages=shortened(config.resolved_stages, epochs), epochs=None)
    if cpu_minutes is not None:
        config = replace(config, stages=(Stage("joint", ENDLESS),), epochs=None)
    data = replace(config.data, root=out / config.data.root)
    if sets is not None:
        kind = "urso" if data.kind == "scenes" else data.kind
        data = replace(data, kind=kind, root=sets / data.scene)
    elif data.kind == "cambridge":  # nothing that could be rendered
        raise ValueError(f"sets: expected the folder that holds {data.scene}, got none")
    return replace(config, data=data, out=out / f"{variant.name}-seed{seed}", seed=seed)


def shortened(stages: Sequence[Stage], epochs: int) -> tuple[Stage, ...]:
    """Return the stages with another number of epochs in all, in about the same proportions.

    Raises:
        ValueError: There are fewer epochs than stages.

    Examples:
        >>> stages = (Stage("joint", 500), Stage("translation", 150), Stage("orientation", 150))
        >>> [stage.epochs for stage in shortened(stages, 19)]
        [11, 4, 4]
    """
    spare, total = epochs - len(stages), sum(stage.epochs for stage in stages)
    if spare < 0:
        raise ValueError(f"epochs: expected at least {len(stages)}, one a stage, got {epochs}")
    ends = [round(spare * done / total) for done in accumulate(stage.epochs for stage in stages)]
    return tuple(
        replace(stage, epochs=1 + end - begin)
        for stage, (begin, end) in zip(stages, pairwise([0, *ends]), strict=True)
    )


def network(config: TrainConfig) -> NetworkConfig:
    """Return the network of a training; its camera comes with the images.

    Raises:
        ValueError: An unknown field, or a value that cannot be.
    """
    fields = {"camera": UNKNOWN_CAMERA, **config.model_fields}
    return find_config(config.model).with_fields(fields)


def _finish(study: Study, run: Run, *, quiet: bool) -> None:
    """Train what is left of a run, test its last weights, and write the result."""
    kind, root, split = _test_set(run)
    trained = train(run.config, resume=True, quiet=quiet, cpu_minutes=run.cpu_minutes)
    decoding = Decoding(run.config.data.undistort, run.config.data.white)
    evaluation = evaluate(trained.folder.last, kind, root, split, decoding=decoding)
    summary = evaluation.summary()
    summary.pop("uncertainty", None)  # the last weights are not calibrated
    model = load_network(trained.folder.last)
    result = {
        "study": study.name,
        "variant": run.variant.name,
        "seed": run.config.seed,
        "scene": run.config.data.scene,
        **_cost(trained),
        "parameters": sum(parameter.numel() for parameter in model.parameters()),
        "latency_ms": latency_ms(model),
        "threads": torch.get_num_threads(),
        "machine": platform.processor() or platform.machine(),
        "versions": {"ffpose": ffpose.__version__, "torch": torch.__version__},
        "settings": run.settings,
        "test": summary,
    }
    with atomic_write(run.folder / RESULTS) as path:
        path.write_text(json.dumps(result, indent=2) + "\n")


def _test_set(run: Run) -> tuple[str, Path, Part]:
    """Return kind, folder and split of the images to test on, rendered where they are not there.

    They are whole images of the network's input size, of the same scenes for every network.
    """
    data = run.config.data
    if run.test_images is None:
        return data.kind, data.root, "test"
    scene = find_scene(data.scene.split("+")[0], data.attitude_range_deg)
    preprocessing = Preprocessing(network(run.config).image_size, data.mode)
    folder = render_images(
        data.root, "test", scene, TEST_SEED, run.test_images, preprocessing, workers=data.workers
    )
    return "urso", folder, "all"


def _cost(trained: TrainResult) -> dict[str, float]:
    """Return what a training took."""
    totals = {
        name: sum(float(row[name]) for row in trained.history)
        for name in ("samples", "cpu_seconds", "seconds")
    }
    return {"epochs": len(trained.history), **totals}


def latency_ms(model: BaseNetwork) -> float:
    """Return the median time of one image's pose, in milliseconds, on torch's threads."""
    model.eval()
    image = torch.zeros(1, 3, *model.config.image_size)
    with torch.inference_mode():
        found = take_turns({"pose": Timer(lambda: model(image))}, 0.5)
    return 1000 * found["pose"].p50
