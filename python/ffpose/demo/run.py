"""The demo: render unseen images, predict their poses, evaluate them, and write a report.

The images have held-out seeds (`ffpose._internal.seeds.CHOICES`), all attitudes, and the set's
own distances. The poses come from the weights that ship with ffpose or, with `DemoConfig.train`,
from a network trained from scratch in minutes on two cores, which shows what so short a training
achieves and checks that every part of the network learns.
"""

from __future__ import annotations

import sys
import time
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import ffpose
from ffpose._internal.figures import save_figure
from ffpose._internal.files import write_json
from ffpose._internal.zoo import resolve
from ffpose.demo.config import DemoConfig
from ffpose.demo.record import DemoRecord
from ffpose.demo.report import SHIPPED, Outcome, document, write_page
from ffpose.evaluation.evaluate import evaluate
from ffpose.evaluation.report.plots import training_curves, write_evaluation_figures
from ffpose.evaluation.report.results import write_results
from ffpose.render.dataset.writer import write_dataset
from ffpose.training import TrainConfig
from ffpose.training.checkpoint import RunFolder
from ffpose.training.engine import TrainResult, train
from ffpose.training.options import load_config
from ffpose.training.run import build_run


def run(out: Path, config: DemoConfig | None = None) -> dict[str, Any]:
    """Render unseen images, optionally train a network, predict poses, and write a report.

    Args:
        out: The folder to write: ``images/``, ``evaluation/``, ``report.html``, ``report.json`` and
            ``demo.json`` (the settings), with training also ``views/`` and ``training/``. An
            unfinished demo in the folder is resumed; of a finished one only evaluation and report
            are repeated.
        config: The demo's size.

    Returns:
        The contents of ``report.json``.

    Raises:
        FileNotFoundError: The weights are missing from this installation.
        ValueError: ``out`` holds a demo with other settings.
        DataError: A file in ``out`` cannot be read.
    """
    config = config or DemoConfig()
    record = DemoRecord.open(out, {**asdict(config), "ffpose": ffpose.__version__})
    weights = RunFolder(config.training(out).out).best if config.train else resolve(SHIPPED)
    out.mkdir(parents=True, exist_ok=True)
    record.write(out)
    _render(config, out, record)
    trained = _train(config, out, record) if config.train else None
    _say(f"evaluate: {config.images} held-out images")
    began = time.perf_counter()
    evaluation = evaluate(weights, "urso", out / "images", "all")
    write_results(evaluation, out / "evaluation")
    seconds = {
        "render": record.render_seconds,
        "views": record.views_seconds,
        "train": trained.seconds if trained else 0.0,
        "evaluate": time.perf_counter() - began,
    }
    outcome = Outcome(config, out, evaluation, trained, record.images_rendered, seconds)
    _say(f"report: {out / 'report.html'}")
    write_evaluation_figures(evaluation, out / "evaluation")
    write_page(outcome)
    result = document(outcome)
    write_json(out / "report.json", result)
    return result


def _say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


def _render(config: DemoConfig, out: Path, record: DemoRecord) -> None:
    _say(f"render: {config.images} images of a Soyuz over the Earth")
    written = write_dataset(
        config.scene,
        out / "images",
        config.images,
        config.seed,
        size=config.size,
        workers=config.workers,
        progress=True,
    )
    if written.rendered == 0:
        _say("render: all images exist already")
        return
    record.images_rendered += written.rendered
    record.render_seconds += written.seconds
    record.write(out)


def _train(config: DemoConfig, out: Path, record: DemoRecord) -> TrainResult:
    training = _resumable(config.training(out))
    if record.views_seconds == 0:
        _say(f"views: rendering {config.rendered_views} training views")
        began = time.perf_counter()
        build_run(training)
        record.views_seconds = time.perf_counter() - began
        record.write(out)
    _say(f"train: {_epochs_to_do(training)}")
    trained = train(training, resume=True)
    save_figure(training_curves(trained.history), trained.folder.curves)
    return trained


def _resumable(training: TrainConfig) -> TrainConfig:
    """Return a training as it began, by processes of a CPU where this machine has a GPU now."""
    folder = RunFolder(training.out)
    if not folder.state.exists():
        return training
    begun = load_config(folder.config)
    device = "cpu" if begun.processes > 1 else training.device
    return replace(training, processes=begun.processes, batch_size=begun.batch_size, device=device)


def _epochs_to_do(training: TrainConfig) -> str:
    total = sum(stage.epochs for stage in training.resolved_stages)
    folder = RunFolder(training.out)
    done = len(folder.load_state().history) if folder.state.exists() else 0
    if done == 0:
        return f"{total} epochs from random weights"
    if done < total:
        return f"epochs {done + 1} to {total}, resumed"
    return f"all {total} epochs are done already"
