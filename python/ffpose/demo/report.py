"""The report of a demo: ``report.json`` and ``report.html``."""

from __future__ import annotations

import platform
import shlex
import sys
from pathlib import Path
from typing import Any, NamedTuple

import ffpose
from ffpose._internal.machine import package_versions
from ffpose.arrays import instruction_set
from ffpose.demo.config import DemoConfig
from ffpose.evaluation.evaluate import Evaluation
from ffpose.evaluation.report.page import write_report
from ffpose.training.engine import TrainResult

SHIPPED = "soyuz"
"""The shipped weights that the demo uses."""

ERRORS = ("median_translation_error_m", "median_rotation_error_deg")


class Outcome(NamedTuple):
    """Result of a demo, in the folder ``out``; no training of the shipped weights.

    ``seconds`` are those of the steps render, for ``images_rendered``, views, train and evaluate; 0
    of skipped steps.
    """

    config: DemoConfig
    out: Path
    evaluation: Evaluation
    trained: TrainResult | None
    images_rendered: int
    seconds: dict[str, float]


def versions() -> dict[str, str]:
    """Return the versions and the machine facts that the measurements depend on."""
    return {
        "ffpose": ffpose.__version__,
        "instruction set": instruction_set(),
        "python": platform.python_version(),
        **package_versions("torch", "timm", "numpy", "embreex"),
        "platform": platform.platform(),
    }


def command(out: Path, *, train: bool) -> str:
    """Return the command that reproduces the demo, whether or not the environment is activated."""
    python = Path(sys.executable)
    if python.is_relative_to(Path.cwd()):
        python = python.relative_to(Path.cwd())
    words = [str(python), "-m", "ffpose.cli", "demo", "--out", str(out)]
    return shlex.join([*words, "--train"] if train else words)


def document(outcome: Outcome) -> dict[str, Any]:
    """Return the contents of ``report.json``; without training its times and epochs are 0."""
    config, out, trained = outcome.config, outcome.out, outcome.trained
    summary = outcome.evaluation.summary()
    baseline = summary["mean_pose_baseline"]
    return {
        "images": summary["images"],
        "weights": _weights_in_words(config),
        "train_seconds": outcome.seconds["train"],
        "test_images": summary["images"],
        **summary,
        "ratio_to_baseline": {
            name: summary[name] / baseline[name] if baseline[name] > 0 else None for name in ERRORS
        },
        "attitude_range_deg": _attitudes(config),
        "distance_range_m": list(config.scene.distance_m),
        "images_rendered": outcome.images_rendered,
        "seconds_per_step": outcome.seconds,
        "epochs": len(trained.history) if trained else 0,
        "best_epoch": trained.best_epoch if trained else 0,
        "command": command(out, train=config.train),
        "versions": versions(),
        "files": _files(out),
    }


def _files(out: Path) -> list[str]:
    """Return the names of the files written, including ``report.json`` but not the images."""
    bulky = (out / "images", out / "views")
    written = {path for path in out.rglob("*") if path.is_file()} | {out / "report.json"}
    kept = (path for path in written if not any(map(path.is_relative_to, bulky)))
    return sorted(path.relative_to(out).as_posix() for path in kept)


def _attitudes(config: DemoConfig) -> dict[str, list[float]]:
    names = ("roll", "pitch", "yaw")
    limits = config.scene.attitude_range_deg
    return {n: [-a, a] for n, a in zip(names, limits, strict=True)}


def _weights_in_words(config: DemoConfig) -> str:
    return "trained here from random weights" if config.train else f"{SHIPPED}, part of ffpose"


def write_page(outcome: Outcome) -> None:
    """Write ``report.html``."""
    config, trained = outcome.config, outcome.trained
    ranges = ", ".join(f"{n} ±{high:g}°" for n, (_, high) in _attitudes(config).items())
    near, far = config.scene.distance_m
    subject = f"{config.images} rendered images of a Soyuz at {near:g} to {far:g} m ({ranges})"
    how = f"with the shipped weights {SHIPPED}, which were trained on other scenes"
    training = {}
    if trained:
        how = (
            f"after a training of {trained.seconds:.0f} s from random weights on "
            f"{config.rendered_views} views of other scenes, {2 * config.negatives} of them "
            "without a Soyuz"
        )
        training = {
            f"seconds to render {config.rendered_views} views": _seconds(outcome, "views"),
            "seconds to train": _seconds(outcome, "train"),
            "epochs": f"{len(trained.history)}, the best is {trained.best_epoch}",
        }
    write_report(
        outcome.out / "report.html",
        outcome.evaluation,
        title="From an image to a pose",
        subtitle=f"{subject}, each posed from the image alone, {how}.",
        history=trained.history if trained else (),
        facts={
            "images": f"{config.images} of {config.size[0]} × {config.size[1]} pixels",
            "attitudes": ranges,
            "weights": _weights_in_words(config),
            f"seconds to render {outcome.images_rendered} images": _seconds(outcome, "render"),
            **training,
            "seconds to evaluate": _seconds(outcome, "evaluate"),
            **versions(),
        },
        command=command(outcome.out, train=config.train),
    )


def _seconds(outcome: Outcome, step: str) -> str:
    return f"{outcome.seconds[step]:.1f}"
