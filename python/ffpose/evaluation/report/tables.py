"""HTML tables of a report, from the summary of an evaluation."""

from __future__ import annotations

import html
from collections.abc import Mapping, Sequence
from typing import Any

from ffpose.geometry.symmetry import SymmetryGroup

Summary = Mapping[str, Any]
"""The document that `Evaluation.summary` returns."""

ROWS = (
    ("median_translation_error_m", "median translation error", "m"),
    ("mean_translation_error_m", "mean translation error", "m"),
    ("median_relative_translation_error", "median translation error by distance", ""),
    ("mean_relative_translation_error", "mean translation error by distance", ""),
    ("median_rotation_error_deg", "median rotation error", "°"),
    ("mean_rotation_error_deg", "mean rotation error", "°"),
    ("esa_score", "ESA score", ""),
    ("speed_plus_score", "SPEED+ score", ""),
)
"""Key in the summary, name, and unit of each metric."""

CARDS = (ROWS[0], ROWS[4])

PARTS = (
    ("median_rotation_error_deg", "rotation error"),
    ("median_in_plane_error_deg", "in-plane"),
    ("median_out_of_plane_error_deg", "out-of-plane"),
)

CONDITIONS = (
    ("median_translation_error_m", "translation", " m"),
    ("median_relative_translation_error", "by distance", ""),
    ("median_rotation_error_deg", "rotation", "°"),
    ("median_in_plane_error_deg", "in-plane", "°"),
    ("median_out_of_plane_error_deg", "out-of-plane", "°"),
)


def headline(summary: Summary) -> str:
    """Return a card for each of the two main errors."""
    return "".join(_card(summary, *row) for row in CARDS)


def comparison(model: float, baseline: float) -> str:
    """Describe the ratio of an error to that of the mean pose.

    Examples:
        >>> comparison(2.0, 5.0), comparison(3.0, 2.0)
        ('2.5 times smaller than that of the mean pose', '1.5 times that of the mean pose')
    """
    if model == baseline:
        return "the same as that of the mean pose"
    if baseline == 0:
        return "larger than that of the mean pose"
    if model == 0:
        return "smaller than that of the mean pose"
    if model < baseline:
        return f"{baseline / model:.3g} times smaller than that of the mean pose"
    return f"{model / baseline:.3g} times that of the mean pose"


def _card(summary: Summary, key: str, name: str, unit: str) -> str:
    model, baseline = summary[key], summary["mean_pose_baseline"][key]
    return (
        f'<div class="card">{name}<b>{model:.2f} {unit}</b>'
        f'<span class="quiet">{comparison(model, baseline)}, {baseline:.2f} {unit}</span></div>'
    )


def figures_table(summary: Summary) -> str:
    """Return the table of metrics of model and baseline."""
    rows = _compared(summary)
    plain = summary.get("without_symmetry", {})
    for key, name, unit in ROWS:
        if key in plain:
            told = f"{name}, without regard to symmetry"
            rows.append((told, f"{plain[key]:.3f} {unit}", "", ""))
    for each in summary.get("modulo_unfolded", []):
        group = SymmetryGroup.from_json(each["axes"])
        rows += _compared(each, f", modulo {group}, which is not folded")
    return _table(("", "model", "mean pose", "ratio"), rows)


def _compared(metrics: Summary, suffix: str = "") -> list[tuple[str, ...]]:
    """Return a row for each of `ROWS` that there is, with the constant pose's beside."""
    rows: list[tuple[str, ...]] = []
    for key, name, unit in ROWS:
        if key in metrics:
            model, baseline = metrics[key], metrics["mean_pose_baseline"][key]
            ratio = f"{model / baseline:.2f}" if baseline > 0 else "–"
            rows.append((name + suffix, f"{model:.3f} {unit}", f"{baseline:.3f} {unit}", ratio))
    return rows


def parts_table(summary: Summary) -> str:
    """Return the table of the rotation error and its parts, with baseline and oracles."""
    others = summary["mean_pose_baseline"], *summary["oracles"].values()
    rows = []
    for key, name in PARTS:
        low, high = summary["median_intervals_95"][key]
        model = f"{summary[key]:.2f}° ({low:.2f} to {high:.2f})"
        rows.append((name, model, *(f"{other[key]:.2f}°" for other in others)))
    header = ("", "model", "mean pose", "oracle: in-plane known", "oracle: out-of-plane known")
    return _table(header, rows)


def correlation_text(summary: Summary) -> str:
    """Return the correlations of the angles as a sentence."""
    told = ", ".join(
        f"{name} {'undefined' if value is None else f'{value:.2f}'}"
        for name, value in summary["correlation"].items()
    )
    return f"Correlation of true and predicted angles (circular for roll and yaw): {told}."


def conditions_table(summary: Summary) -> str:
    """Return the table of medians by condition."""
    rows = [
        (
            group["group"],
            str(group["images"]),
            *(f"{group[key]:.3g}{unit}" for key, _, unit in CONDITIONS),
        )
        for groups in summary["groups"].values()
        for group in groups
    ]
    return _table(("", "images", *(name for _, name, _ in CONDITIONS)), rows)


def uncertainty_table(summary: Summary) -> str:
    """Return the table of coverage, and of the flag's rates where they are known."""
    told = summary["uncertainty"]
    rows = [
        (f"truths in the {level} % region of {name}", _percent(told[name][f"coverage_{level}"]))
        for name in ("translation", "rotation")
        if name in told
        for level in (50, 90, 99)
    ]
    if modes := told.get("modes"):
        off = "attitudes that are more than 30° off"
        rows.append((off, _percent(modes["share_over_30_deg"])))
        both = f"{off}, the second most likely one too"
        rows.append((both, _percent(modes["share_over_30_deg_of_both"])))
    flag = told.get("in_view", {})
    if "threshold" in flag:
        rows.append(("flagged as without the object: below", f"{flag['threshold']:.3g}"))
        rows.append(("images with it that are flagged", _percent(flag["false_alarm_rate"])))
    if "miss_rate" in flag:
        rows.append(("images without it that are not flagged", _percent(flag["miss_rate"])))
    if "auroc" in flag:
        rows.append(("area under the ROC curve", f"{flag['auroc']:.4f}"))
    return _table(("", ""), rows)


def _percent(share: float) -> str:
    return f"{100 * share:.1f} %"


def _table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = ["".join(f"<th>{html.escape(cell)}</th>" for cell in header)]
    lines += ["".join(f"<td>{html.escape(cell)}</td>" for cell in row) for row in rows]
    return "".join(f"<tr>{line}</tr>" for line in lines)
