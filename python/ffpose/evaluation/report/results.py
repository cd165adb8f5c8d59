"""Result files of an evaluation, and the table that it prints."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ffpose._internal.files import write_csv, write_json
from ffpose.evaluation.evaluate import Evaluation
from ffpose.geometry import POSE_COLUMNS, FloatArray


def format_table(summary: dict[str, Any]) -> str:
    """Format the metrics of `Evaluation.summary` as a text table: name, model, baseline."""
    baseline = summary["mean_pose_baseline"]
    rows = [
        (name, f"{summary[name]:12.4f}{value:12.4f}")
        for name, value in baseline.items()
        if isinstance(value, float)
    ]
    rows += [
        (f"{name}, no symmetry", f"{value:12.4f}")
        for name, value in summary.get("without_symmetry", {}).items()
        if isinstance(value, float)
    ]
    width = max(34, *(len(name) for name, _ in rows))
    lines = [f"{summary['images']} images".ljust(width) + "model".rjust(12) + "mean pose".rjust(12)]
    lines += [name.ljust(width) + values for name, values in rows]
    lines.append(f"mean pose: of {baseline['of']}")
    return "\n".join(lines)


def write_results(evaluation: Evaluation, out: Path) -> None:
    """Write ``results.json`` and ``predictions.csv`` (one row per image) to the folder ``out``."""
    out.mkdir(parents=True, exist_ok=True)
    write_json(out / "results.json", evaluation.summary())
    columns = _columns(evaluation)
    table = np.stack(list(columns.values()), axis=1).tolist()
    rows = ([name, *row] for name, row in zip(evaluation.dataset.names, table, strict=True))
    write_csv(out / "predictions.csv", [["image", *columns], *rows])


def _columns(evaluation: Evaluation) -> dict[str, FloatArray]:
    """Return the columns ``(N,)`` of ``predictions.csv`` after the name."""
    columns = dict(zip(POSE_COLUMNS, evaluation.dataset.poses.T, strict=True))
    columns |= {
        f"predicted_{n}": c for n, c in zip(POSE_COLUMNS, evaluation.predicted.T, strict=True)
    }
    columns |= evaluation.errors.named()
    if evaluation.translation_covariance is not None:
        columns |= _deviations("t{}_m", evaluation.translation_covariance)
    if evaluation.rotation_covariance is not None:
        columns |= _deviations("r{}_deg", evaluation.rotation_covariance * np.degrees(1.0) ** 2)
    if (other := evaluation.alternative_errors_deg) is not None:
        assert evaluation.probabilities is not None
        columns["alternative_rotation_error_deg"] = other
        columns["probability"], columns["alternative_probability"] = evaluation.probabilities.T
    if evaluation.in_view is not None:
        columns["in_view"] = evaluation.in_view
    return columns


def _deviations(name: str, covariance: FloatArray) -> dict[str, FloatArray]:
    deviations = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2)).T
    return {f"sigma_{name.format(axis)}": c for axis, c in zip("xyz", deviations, strict=True)}
