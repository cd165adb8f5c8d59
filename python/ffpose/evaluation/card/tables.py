"""Markdown tables of a model card, from what `measurement.measure` returns."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from ffpose.render.scene import ALL_ATTITUDES

Row = Mapping[str, Any]

NONE = "–"
"""Placeholder for a missing value."""


def degrees(value: float) -> str:
    """Return an angle as text."""
    return f"{value:.2f}°"


def meters(value: float) -> str:
    """Return a length as text."""
    return f"{value:.2f} m"


def percent(share: float) -> str:
    """Return a share as text."""
    return f"{100 * share:.1f} %"


ERRORS: tuple[tuple[str, str, Callable[[float], str]], ...] = (
    ("E_q", "median_rotation_error_deg", degrees),
    ("mean", "mean_rotation_error_deg", degrees),
    ("90 %", "percentile_90_rotation_error_deg", degrees),
    ("> 30°", "share_over_30_deg", percent),
    ("in-plane", "median_in_plane_error_deg", degrees),
    ("out-of-plane", "median_out_of_plane_error_deg", degrees),
    ("E_t", "median_translation_error_m", meters),
    ("mean", "mean_translation_error_m", meters),
    ("E_t/‖t‖", "median_relative_translation_error", percent),
)
"""Columns of `errors_table`: header, key of the document, and the value as text."""


def format_card(document: Mapping[str, Any]) -> str:
    """Return the whole card in Markdown: setup, tables and notes."""
    width, height = document["size"]
    near, far = document["distance_m"]
    head = (
        f"{card_name(document)} (SHA-256 of the weights {document['sha256'][:12]}…): "
        f"{document['count']} images of {width}x{height} per condition, seed {document['seed']}"
        f"{' (final)' if document['final'] else ''}, "
        f"{near:g} to {far:g} m, {_attitudes(document.get('scene_parameters', {}))};"
        f" ffpose {document['ffpose']}."
    )
    parts = [head, errors_table(document)]
    if any("rotation" in row for row in document["conditions"]):
        parts.append(uncertainty_table(document["conditions"]))
    if document["without_object"]:
        parts.append(refusal_table(document))
    if symmetry := document.get("symmetry"):
        parts.append(f"Rotation errors are to the nearest attitude of the same look: {symmetry}.")
    return "\n\n".join([*parts, *document["notes"]]) + "\n"


def _attitudes(own: Mapping[str, Any]) -> str:
    """Say what a set's attitudes are; those without parameters of their own have all."""
    limits = own.get("attitude_range_deg", ALL_ATTITUDES)
    if tuple(limits) == ALL_ATTITUDES:
        return "all attitudes"
    return f"roll, pitch, yaw within {', '.join(f'{angle:g}' for angle in limits)} degrees"


def card_name(card: Mapping[str, Any]) -> str:
    """Return what a card is of: weights and set."""
    return f"`{card['weights']}` on `{card['scene']}`"


def errors_table(document: Mapping[str, Any]) -> str:
    """Return the table of errors of each condition, and of the constant pose.

    A row below the first condition shows the bootstrap intervals of its medians.
    """
    header = ["condition", "in training", "images", *(name for name, _, _ in ERRORS)]
    first, *others = document["conditions"]
    constant = {"name": "constant pose", **document["mean_pose_baseline"]}
    rows = [_errors(first), _intervals(first), *map(_errors, others), _errors(constant)]
    caption = "Medians, where no other is named; in brackets their bootstrap intervals of 95 %."
    told = "; ".join(f"{row['name']}: {row['about']}" for row in document["conditions"])
    about = f"{told}. {_partly(document['conditions'])}".rstrip()
    return f"{markdown_table(header, rows)}\n\n{caption} {about}"


def _errors(row: Row) -> list[str]:
    figures = (show(row[key]) for _, key, show in ERRORS)
    return [row["name"], row.get("seen", ""), str(row["images"]), *figures]


def _intervals(row: Row) -> list[str]:
    """Return the row of bootstrap intervals of the medians in `_errors`."""
    ends = row["median_intervals_95"]
    figures = (
        f"[{', '.join(map(show, ends[key]))}]" if key in ends else "" for _, key, show in ERRORS
    )
    return ["", "", "", *figures]


def _partly(rows: Sequence[Row]) -> str:
    """Say in what way a training had the conditions that it had in part; empty for none."""
    parts = [f"{row['name']} ({row['seen_how']})" for row in rows if row.get("seen_how")]
    return f"Partly in training: {'; '.join(parts)}." if parts else ""


def uncertainty_table(rows: Sequence[Row]) -> str:
    """Return the table of coverage, predicted standard deviations and flag, by condition."""
    header = ["condition", "E_q", "σ rotation", "E_t", "σ distance"]
    header += ["rotation in 50 / 90 / 99 %", "translation in 50 / 90 / 99 %", "in view", "flagged"]
    lines = [
        [
            row["name"],
            degrees(row["median_rotation_error_deg"]),
            degrees(row["median_sigma_rotation_deg"]),
            meters(row["median_translation_error_m"]),
            meters(row["median_sigma_distance_m"]),
            coverage_text(row["rotation"]),
            coverage_text(row["translation"]),
            f"{row['median_in_view']:.4g}",
            percent(row["flagged"]) if "flagged" in row else NONE,
        ]
        for row in rows
    ]
    caption = (
        "Medians of errors, of predicted standard deviations (rotation: of the whole angle; "
        "distance: along the ray) and of the probability of being in view; shares of the truths "
        "in the regions of 50, 90 and 99 %."
    )
    return f"{markdown_table(header, lines)}\n\n{caption}"


def refusal_table(document: Mapping[str, Any]) -> str:
    """Return the table of how well images without the object are detected."""
    rows = document["without_object"]
    lines = [
        [
            row["name"],
            row["about"],
            row.get("seen", ""),
            str(row["images"]),
            f"{row['auroc']:.4f}",
            percent(row["miss_rate"]) if "miss_rate" in row else NONE,
            f"{row['median_in_view']:.4g}",
        ]
        for row in rows
    ]
    header = ["without the object", "", "in training", "images", "AUROC", "missed", "in view"]
    threshold = document["in_view_threshold"]
    caption = "The weights hold no threshold to flag by."
    if threshold is not None:
        caption = (
            f"Flagged below {threshold:.4g}; false alarms on the scenes as trained: "
            f"{percent(rows[0]['false_alarm_rate'])}."
        )
    return f"{markdown_table(header, lines)}\n\n{caption} {_partly(rows)}".rstrip()


def markdown_table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a table in Markdown."""
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def coverage_text(shares: Mapping[str, float]) -> str:
    """Return the coverage of three regions, in percent."""
    return " / ".join(f"{100 * shares[f'coverage_{level}']:.0f}" for level in (50, 90, 99))
