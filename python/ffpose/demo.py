"""The whole line in minutes: render, train, evaluate, report.

A small network, trained from nothing on a few thousand rendered images, on two cores. Its purpose
is to show that every part works and learns, not how well a network of the paper's size can do. So
that it learns in that time, the attitudes are kept within `DemoConfig.attitude_range_deg`; the
report says so, and the baseline that it is held against is computed on the same range. Yaw, a turn
in the image's plane, is what is left wide: it shows plainly. A small roll and a small pitch only
foreshorten, alike for either sign, and take a longer training to tell apart.
"""

from __future__ import annotations

import json
import platform
import shlex
import sys
import time
from dataclasses import asdict, dataclass, replace
from importlib import metadata
from pathlib import Path
from typing import Any

import ffpose
from ffpose.arrays import instruction_set
from ffpose.demo_record import DemoRecord
from ffpose.evaluation import Evaluation, evaluate
from ffpose.files import atomic_write
from ffpose.plots import save_figure, training_curves, write_evaluation_figures
from ffpose.render import Scene, get_scene
from ffpose.render.writer import write_dataset
from ffpose.report import Report, write_report
from ffpose.results import write_results
from ffpose.training import (
    DataConfig,
    LossConfig,
    OptimizerConfig,
    RunFolder,
    Stage,
    TrainConfig,
    TrainResult,
    train,
)

AUGMENTATION = {
    **dict.fromkeys(("brightness", "contrast", "saturation", "noise", "blur"), 0.0),
    "roll": 15.0,
}
"""A turn of the camera, exact for the label, and nothing that costs more time than it brings."""

ERRORS = ("median_translation_error_m", "median_rotation_error_deg")


@dataclass(frozen=True)
class DemoConfig:
    """The size of the demo; the defaults take minutes on two cores.

    Attributes:
        images: How many images are rendered; eight in ten train, one validates, one tests.
        size: Width and height of the images.
        attitude_range_deg: Roll, pitch and yaw lie within plus and minus these angles.
        epochs: Passes over the training images.
        model_fields: Fields of the model's configuration "tiny" to change.
        seed: Seed of the images and of the training.
        workers: Processes that render.
    """

    images: int = 3000
    size: tuple[int, int] = (256, 192)
    attitude_range_deg: tuple[float, float, float] = (20.0, 20.0, 90.0)
    epochs: int = 14
    model_fields: tuple[tuple[str, Any], ...] = ()
    seed: int = 0
    workers: int = 2

    @property
    def scene(self) -> Scene:
        """The set of images: the paper's easy one, within the range of attitudes."""
        return replace(
            get_scene("soyuz_easy"), name="demo", attitude_range_deg=self.attitude_range_deg
        )

    def training(self, images: Path, out: Path) -> TrainConfig:
        """Return a training that learns in a few thousand steps.

        It differs from the paper's where so short a run must: a higher learning rate that rises
        and then falls to zero, and loss weights that start where they would settle.
        """
        return TrainConfig(
            data=DataConfig("urso", images, cache=True, augmentation=AUGMENTATION),
            out=out,
            model="tiny",
            model_fields=dict(self.model_fields),
            backbone_weights="none",
            stages=(Stage("joint", self.epochs),),
            batch_size=16,
            optimizer=OptimizerConfig(
                learning_rate=1e-3, schedule="cosine", warmup_epochs=1.0, clip_norm=1.0
            ),
            loss=LossConfig(s_t=0.0, s_q=-4.0, antipodal=True),
            seed=self.seed,
        )


def run(out: Path, config: DemoConfig | None = None, *, quiet: bool = False) -> dict[str, Any]:
    """Render, train, evaluate and report.

    Args:
        out: The folder to write: ``images/``, ``training/``, ``evaluation/``, ``report.html`` and
            ``report.json``, and ``demo.json``, the settings. A demo that was begun there is taken
            up, and of one that has ended only evaluation and report are made again.
        config: The demo's size.
        quiet: Print nothing.

    Returns:
        What ``report.json`` holds.

    Raises:
        ValueError: ``out`` holds a demo of other settings.
        DataError: A file there cannot be read.
    """
    config = config or DemoConfig()
    record = DemoRecord.open(out, {**asdict(config), "ffpose": ffpose.__version__})
    out.mkdir(parents=True, exist_ok=True)
    record.write(out)
    _render(config, out, record, quiet=quiet)
    trained = _train(config, out, quiet=quiet)
    _say("evaluate: on images that were not trained on", quiet=quiet)
    began = time.perf_counter()
    evaluation = evaluate(trained.folder.best, "urso", out / "images")
    write_results(evaluation, out / "evaluation")
    seconds = {
        "render": record.render_seconds,
        "train": trained.seconds,
        "evaluate": time.perf_counter() - began,
    }
    _say(f"report: {out / 'report.html'}", quiet=quiet)
    write_evaluation_figures(evaluation, out / "evaluation")
    write_report(_page(config, out, evaluation, trained, record, seconds), out / "report.html")
    document = _document(config, out, evaluation, trained, record, seconds)
    with atomic_write(out / "report.json") as path:
        path.write_text(json.dumps(document, indent=2) + "\n")
    return document


def _say(text: str, *, quiet: bool) -> None:
    if not quiet:
        print(text, file=sys.stderr, flush=True)


def _render(config: DemoConfig, out: Path, record: DemoRecord, *, quiet: bool) -> None:
    """Render the images that are not there yet, and record what they cost."""
    _say(f"render: {config.images} images of a Soyuz over the Earth", quiet=quiet)
    written = write_dataset(
        config.scene,
        out / "images",
        config.images,
        config.seed,
        size=config.size,
        workers=config.workers,
        progress=not quiet,
    )
    if written.rendered == 0:
        _say("render: all images were there already", quiet=quiet)
        return
    record.images_rendered += written.rendered
    record.render_seconds += written.seconds
    record.write(out)


def _train(config: DemoConfig, out: Path, *, quiet: bool) -> TrainResult:
    """Train the epochs that are not done yet."""
    training = config.training(out / "images", out / "training")
    _say(f"train: {_epochs_to_do(training)}", quiet=quiet)
    trained = train(training, resume=True, quiet=quiet)
    save_figure(training_curves(trained.history), trained.folder.curves)
    return trained


def _epochs_to_do(training: TrainConfig) -> str:
    """Say what is left of a training."""
    total = sum(stage.epochs for stage in training.resolved_stages)
    folder = RunFolder(training.out)
    done = len(folder.load_state().history) if folder.state.exists() else 0
    if done == 0:
        return f"{total} epochs from random weights"
    if done < total:
        return f"epochs {done + 1} to {total}, the others were done already"
    return f"all {total} epochs were done already"


def versions() -> dict[str, str]:
    """Return the versions and the machine that the figures depend on."""
    packages = ("torch", "timm", "numpy", "embreex")
    return {
        "ffpose": ffpose.__version__,
        "instruction set": instruction_set(),
        "python": platform.python_version(),
        **{name: metadata.version(name) for name in packages},
        "platform": platform.platform(),
    }


def command(out: Path) -> str:
    """Return the command that makes all of it, whether this environment is activated or not."""
    python = Path(sys.executable)
    if python.is_relative_to(Path.cwd()):
        python = python.relative_to(Path.cwd())
    return shlex.join([str(python), "-m", "ffpose.cli", "demo", "--out", str(out)])


def _attitudes(config: DemoConfig) -> dict[str, list[float]]:
    names = ("roll", "pitch", "yaw")
    return {n: [-a, a] for n, a in zip(names, config.attitude_range_deg, strict=True)}


def _document(
    config: DemoConfig,
    out: Path,
    evaluation: Evaluation,
    trained: TrainResult,
    record: DemoRecord,
    seconds: dict[str, float],
) -> dict[str, Any]:
    """Return what ``report.json`` holds."""
    summary = evaluation.summary()
    baseline = summary["mean_pose_baseline"]
    written = {path for path in out.rglob("*") if path.is_file() and path.parent != out / "images"}
    return {
        "images": config.images,
        "train_seconds": trained.seconds,
        "test_images": summary["images"],
        **{name: summary[name] for name in summary if name not in ("images", "mean_pose_baseline")},
        "mean_pose_baseline": baseline,
        "ratio_to_baseline": {
            name: summary[name] / baseline[name] if baseline[name] > 0 else None for name in ERRORS
        },
        "attitude_range_deg": _attitudes(config),
        "distance_range_m": list(config.scene.distance_m),
        "images_rendered": record.images_rendered,
        "seconds_per_step": seconds,
        "epochs": len(trained.history),
        "best_epoch": trained.best_epoch,
        "command": command(out),
        "versions": versions(),
        "files": sorted(str(path.relative_to(out)) for path in written | {out / "report.json"}),
    }


def _page(
    config: DemoConfig,
    out: Path,
    evaluation: Evaluation,
    trained: TrainResult,
    record: DemoRecord,
    seconds: dict[str, float],
) -> Report:
    """Return what ``report.html`` says."""
    ranges = ", ".join(f"{n} ±{high:g}°" for n, (_, high) in _attitudes(config).items())
    near, far = config.scene.distance_m
    return Report(
        title="From an image to a pose",
        subtitle=(
            f"A small FilterformerPose, trained from random weights in {trained.seconds:.0f} s on "
            f"rendered images of a Soyuz at {near:g} to {far:g} m ({ranges}), and tested on "
            f"{len(evaluation.dataset)} images that it never saw."
        ),
        evaluation=evaluation,
        history=trained.history,
        facts={
            "images rendered": f"{config.images} of {config.size[0]} × {config.size[1]} pixels",
            "attitudes": ranges,
            "epochs": f"{len(trained.history)}, the best is {trained.best_epoch}",
            f"seconds to render {record.images_rendered} images": f"{seconds['render']:.1f}",
            "seconds to train": f"{seconds['train']:.1f}",
            "seconds to evaluate": f"{seconds['evaluate']:.1f}",
            **versions(),
        },
        command=command(out),
    )
