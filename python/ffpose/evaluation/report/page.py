"""Report of an evaluation as one self-contained HTML page."""

from __future__ import annotations

import html
from collections.abc import Mapping, Sequence
from importlib import resources
from pathlib import Path
from string import Template
from typing import Any

from ffpose._internal.figures import embedded, jpeg_tag
from ffpose._internal.files import write_text
from ffpose.evaluation.evaluate import Evaluation
from ffpose.evaluation.report import plots, tables

GROUP = 8
"""Images of a gallery."""

DISTRIBUTIONS = (
    (plots.error_cdf, "share of the images below each error, model and mean pose"),
    (plots.error_histograms, "histograms of the errors, model and mean pose"),
    (plots.errors_by_distance, "each image's errors over the distance of the spacecraft"),
    (plots.errors_by_view, "map of the median rotation error over the viewing directions"),
    (plots.predicted_angles, "predicted roll, pitch and yaw over the true angles"),
)
"""Figures of the errors, with their alternative texts."""


def write_report(
    path: Path,
    evaluation: Evaluation,
    *,
    title: str,
    subtitle: str,
    history: Sequence[Mapping[str, float | str]],
    facts: Mapping[str, str],
    command: str,
) -> None:
    """Write the report of an evaluation as one self-contained HTML file.

    ``history`` are rows of ``results.csv``, none without training; ``facts`` stand at the end, and
    ``command`` reproduces the report.
    """
    template = resources.files("ffpose.evaluation.report").joinpath("page.html")
    summary = evaluation.summary()
    page = Template(template.read_text(encoding="utf-8")).substitute(
        title=html.escape(title),
        subtitle=html.escape(subtitle),
        headline=tables.headline(summary),
        figures=tables.figures_table(summary),
        baseline=html.escape(summary["mean_pose_baseline"]["of"]),
        parts=tables.parts_table(summary),
        correlation=html.escape(tables.correlation_text(summary)),
        conditions=tables.conditions_table(summary),
        uncertainty=_uncertainty(evaluation, summary),
        galleries=_galleries(evaluation),
        training=_training(history),
        distributions="".join(
            embedded(draw(evaluation), text, format="svg") for draw, text in DISTRIBUTIONS
        ),
        facts="".join(
            f"<tr><td>{html.escape(name)}</td><td>{html.escape(value)}</td></tr>"
            for name, value in facts.items()
        ),
        command=html.escape(command),
    )
    write_text(path, page)


def _training(history: Sequence[Mapping[str, float | str]]) -> str:
    """Return the section on the training; empty without training."""
    if not history:
        return ""
    text = "loss and validation errors over the epochs"
    figure = embedded(plots.training_curves(history), text, format="svg")
    return f"<h2>Training</h2>{figure}"


def _uncertainty(evaluation: Evaluation, summary: Mapping[str, Any]) -> str:
    """Return the section on the predicted uncertainty; empty for a network without it."""
    if "uncertainty" not in summary:
        return ""
    diagram = ""
    if evaluation.region_probabilities:
        text = "share of the truths in the predicted regions over the regions' probability"
        diagram = embedded(plots.reliability_diagram(evaluation), text, format="svg")
    return (
        f"<h2>Predicted uncertainty</h2><table>{tables.uncertainty_table(summary)}</table>{diagram}"
    )


def _galleries(evaluation: Evaluation) -> str:
    ranking = evaluation.ranking.tolist()
    groups = {
        "The best": ranking[:GROUP],
        "About the median": evaluation.typical(GROUP),
        "The worst": ranking[::-1][:GROUP],
    }
    tiles = {name: "".join(_tile(evaluation, i) for i in chosen) for name, chosen in groups.items()}
    return "".join(
        f'<h3>{name}</h3><div class="gallery">{each}</div>' for name, each in tiles.items()
    )


def _tile(evaluation: Evaluation, index: int) -> str:
    image, text = plots.draw_prediction(evaluation, index), plots.caption(evaluation, index)
    image.thumbnail(plots.GALLERY_TILE)
    name = html.escape(evaluation.dataset.names[index])
    return f"<figure>{jpeg_tag(image, text)}<figcaption>{name}: {text}</figcaption></figure>"
