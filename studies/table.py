"""Results of a study: ``ablation.csv``, a row per run, and ``ablation.md``, means over the seeds.

Runs are compared twice: by the test images at the end of their training, and by the validation
images when each had taken the CPU time of the shortest run, which a slow network reaches after
fewer samples. CPU time is that of training, validation left out.
"""

from __future__ import annotations

import csv
import json
import statistics
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from ffpose._internal.files import atomic_write
from ffpose.errors import DataError
from ffpose.training.checkpoint import Row
from studies.study import Study, Variant

RESULTS = "results.json"

COSTS = ("epochs", "samples", "cpu_seconds", "seconds", "parameters", "latency_ms")

Result = dict[str, Any]
"""A run's ``results.json``, and ``history``, its training's table of results."""


class Error(NamedTuple):
    """An error of the tables: its name in `PoseError`, heading, unit and scale."""

    key: str
    heading: str
    unit: str
    scale: float = 1.0


MEDIANS = (
    Error("median_rotation_error_deg", "E_q", "°"),
    Error("median_in_plane_error_deg", "in-plane", "°"),
    Error("median_out_of_plane_error_deg", "out-of-plane", "°"),
    Error("median_relative_translation_error", "E_t / ‖t‖", " %", 100.0),
)
MEANS = (
    Error("mean_translation_error_m", "mean E_t", " m"),
    Error("mean_rotation_error_deg", "mean E_q", "°"),
)
PUBLISHED_MEDIANS = (
    Error("median_translation_error_m", "median E_t", " m"),
    Error("median_rotation_error_deg", "median E_q", "°"),
)


def read_run(folder: Path) -> Result:
    """Read what a finished run left.

    Raises:
        ffpose.DataError: The file holds something else.
    """
    path = folder / RESULTS
    try:
        result = json.loads(path.read_text())
        history = read_results(folder / "results.csv")
        if result["test"] and result["settings"]:
            return {**result, "history": history}
    except (ValueError, KeyError, TypeError) as error:
        raise DataError(f"expected the result of a run: {error!r}", path) from error
    raise DataError("expected the result of a run, got one without figures", path)


def read_results(path: Path) -> list[Row]:
    """Read a training's table of results: values as floats, and the stage's name."""
    with path.open(newline="", encoding="utf-8") as file:
        return [
            {name: value if name == "stage" else float(value) for name, value in row.items()}
            for row in csv.DictReader(file)
        ]


def write_tables(study: Study, out: Path) -> Path:
    """Write both tables of the finished runs in a folder; return the one for people."""
    results = list(_finished(study, out))
    with atomic_write(out / "ablation.csv") as path, path.open("w", newline="") as file:
        rows = [_row(result, shortest(results)) for result in results]
        writer = csv.DictWriter(file, fieldnames=list(rows[0]) if rows else ["variant"])
        writer.writeheader()
        writer.writerows(rows)
    with atomic_write(out / "ablation.md") as path:
        path.write_text(format_tables(study, results))
    return out / "ablation.md"


def _finished(study: Study, out: Path) -> Iterator[Result]:
    """Read the finished runs, variant by variant, by seed."""
    for variant in study.variants:
        folders = [path.parent for path in out.glob(f"{variant.name}-seed*/{RESULTS}")]
        runs = [read_run(folder) for folder in folders]
        yield from sorted(
            (run for run in runs if run["variant"] == variant.name), key=lambda run: run["seed"]
        )


def shortest(results: Sequence[Result]) -> float:
    """Return the CPU seconds of the run that took the fewest; 0 for no runs."""
    return min((result["cpu_seconds"] for result in results), default=0.0)


def epoch_within(history: Sequence[Row], cpu_seconds: float) -> Row | None:
    """Return the last epoch that ended within a time of training; None where none did.

    Returns:
        Its row of the table of results, with ``samples`` and ``cpu_seconds`` since the beginning.
    """
    found, samples, spent = None, 0.0, 0.0
    for row in history:
        samples, spent = samples + float(row["samples"]), spent + float(row["cpu_seconds"])
        if spent > cpu_seconds * (1 + 1e-9):  # sums of floats differ by the order of their terms
            break
        found = {**row, "samples": samples, "cpu_seconds": spent}
    return found


def _row(result: Result, cpu_seconds: float) -> dict[str, Any]:
    """Return a run's row of ``ablation.csv``; empty where it has no epoch within the time."""
    errors = [error.key for error in (*MEDIANS, *MEANS)]
    test, epoch = result["test"], epoch_within(result["history"], cpu_seconds) or {}
    return {
        **{name: result[name] for name in ("variant", "seed", "scene", *COSTS)},
        **{key: test.get(key, "") for key in errors},
        **{f"constant_{key}": test["mean_pose_baseline"].get(key, "") for key in errors},
        "equal_cpu_seconds": cpu_seconds,
        "equal_cpu_samples": epoch.get("samples", ""),
        **{f"equal_cpu_val_{key}": epoch.get(f"val_{key}", "") for key in errors},
    }


def format_tables(study: Study, results: Sequence[Result]) -> str:
    """Return the tables of a study in Markdown."""
    lines = [f"# Ablation: {study.name}", "", study.about, ""]
    if not results:
        return "\n".join([*lines, "No run has finished.", ""])
    runs = [(v, [r for r in results if r["variant"] == v.name]) for v in study.variants]
    present = [(variant, found) for variant, found in runs if found]
    lines += [*_at_the_end(present), "", *_within(present, shortest(results)), ""]
    if any(variant.paper for variant, _ in present):
        lines += [*_beside_the_paper(present, medians=study.medians), ""]
    missing = [variant.name for variant, found in runs if not found]
    if missing:
        lines += [f"Not run yet: {', '.join(missing)}.", ""]
    return "\n".join([*lines, study.notes, ""] if study.notes else lines)


Runs = Sequence[tuple[Variant, Sequence[Result]]]


def _at_the_end(runs: Runs) -> Iterator[str]:
    counts = sorted({r["test"]["images"] for _, found in runs for r in found})
    images = " or ".join(map(str, counts))
    yield f"Medians over {images} test images at the end of training, as mean ±"
    yield "standard deviation over the seeds:"
    yield ""
    headings = ("samples", "CPU s", *(error.heading for error in MEDIANS))
    yield from _header("variant", "what", "runs", *headings)
    for variant, found in runs:
        costs = [spread([r[name] for r in found], digits=0) for name in ("samples", "cpu_seconds")]
        errors = [_said([r["test"] for r in found], error) for error in MEDIANS]
        yield _line(variant.name, variant.about, str(len(found)), *costs, *errors)
    scenes = {r["scene"]: r["test"]["mean_pose_baseline"] for _, found in runs for r in found}
    for scene, constant in scenes.items():
        errors = [_said([constant], error) for error in MEDIANS]
        yield _line("constant pose", scene, "", "", "", *errors)


def _within(runs: Runs, cpu_seconds: float) -> Iterator[str]:
    yield f"The same over the validation images, at the last epoch within {cpu_seconds:.0f} CPU"
    yield "seconds of training, those of the shortest run:"
    yield ""
    yield from _header("variant", "runs", "samples", *(error.heading for error in MEDIANS))
    for variant, found in runs:
        epochs = [epoch_within(r["history"], cpu_seconds) for r in found]
        rows = [row for row in epochs if row is not None]
        samples = spread([float(row["samples"]) for row in rows], digits=0)
        errors = [_said(rows, error, "val_") for error in MEDIANS]
        yield _line(variant.name, str(len(rows)), samples, *errors)


def _beside_the_paper(runs: Runs, *, medians: bool) -> Iterator[str]:
    compared = PUBLISHED_MEDIANS if medians else MEANS
    what = "Medians" if medians else "Means"
    yield f"{what}, beside those that the paper prints, and the time of one image:"
    yield ""
    measured = [error.heading for error in compared]
    yield from _header("variant", *measured, *(f"paper's {m}" for m in measured), "ms", "paper's")
    for variant, found in runs:
        errors = [_said([r["test"] for r in found], error) for error in compared]
        latency = spread([r["latency_ms"] for r in found])
        yield _line(variant.name, *errors, *_published(variant), latency, _published_ms(variant))


def _published(variant: Variant) -> tuple[str, str]:
    if variant.paper is None:
        return "–", "–"
    return f"{variant.paper.translation_m} m", f"{variant.paper.rotation_deg}°"


def _published_ms(variant: Variant) -> str:
    latency = variant.paper and variant.paper.latency_ms
    return "–" if latency is None else f"{latency}"


def _said(rows: Sequence[Any], error: Error, prefix: str = "") -> str:
    key = prefix + error.key  # that labels of a camera may lack
    values = [error.scale * float(row[key]) for row in rows if key in row]
    return spread(values, error.unit)


def spread(values: Sequence[float], unit: str = "", digits: int = 2) -> str:
    """Return the mean and the standard deviation of a sample; the mean alone of a single value.

    Examples:
        >>> spread([1.0, 3.0], "°"), spread([4.0], " m"), spread([])
        ('2.00° ± 1.41°', '4.00 m', '–')
    """
    if not values:
        return "–"
    mean = f"{statistics.fmean(values):.{digits}f}{unit}"
    if len(values) < 2:
        return mean
    return f"{mean} ± {statistics.stdev(values):.{digits}f}{unit}"


def _header(*cells: str) -> Iterator[str]:
    yield _line(*cells)
    yield _line(*("---" for _ in cells))


def _line(*cells: str) -> str:
    return f"| {' | '.join(cells)} |"
