"""Figures of training and evaluation; each function returns a figure."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from PIL import Image

from ffpose._internal.figures import GRID_COLOR, new_figure, save_figure, style_axes
from ffpose.evaluation.calibration import CURVE, coverage
from ffpose.evaluation.evaluate import Evaluation
from ffpose.geometry import FloatArray, rotation_matrix
from ffpose.imaging.overlay import TRUTH_COLORS, draw_axes

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MODEL_COLOR = "#2f6fdf"
BASELINE_COLOR = "#9aa3af"
GALLERY_TILE = (480, 360)

MAP_CELLS = (6, 12)
"""Cells of the map of views along height and longitude."""

FAR_DEG = 30.0
"""Rotation error beyond which an image is marked in the map of views, degrees."""


def training_curves(history: Sequence[Mapping[str, float | str]]) -> Figure:
    """Plot loss and validation errors over the epochs, rows of ``results.csv``."""
    figure = new_figure(10.5, 2.9)
    epochs = [float(row["epoch"]) for row in history]
    panels = (
        ("train_loss", "training loss"),
        ("val_median_translation_error_m", "median translation error, m"),
        ("val_median_rotation_error_deg", "median rotation error, degrees"),
    )
    for axes, (column, title) in zip(figure.subplots(1, 3), panels, strict=True):
        values = [float(row[column]) for row in history]
        axes.plot(epochs, values, color=MODEL_COLOR, marker="." if len(epochs) < 40 else "")
        _label(axes, title, xlabel="epoch")
        if column.startswith("val"):
            axes.set_ylim(bottom=0)
    return figure


def error_cdf(evaluation: Evaluation) -> Figure:
    """Plot the cumulative distribution of each error, for model and baseline."""
    figure = new_figure(9.0, 6.4)
    for axes, name, unit, *pair in _error_panels(figure, evaluation):
        styles = (("model", MODEL_COLOR), ("mean pose", BASELINE_COLOR))
        for values, (label, color) in zip(pair, styles, strict=True):
            share = np.arange(1, len(values) + 1) / len(values)
            axes.step(np.sort(values), share, where="post", label=label, color=color)
            axes.plot(np.median(values), 0.5, "o", color=color)
        title = f"images below a {name} error (dot: median)"
        _label(axes, title, xlabel=f"{name} error, {unit}", ylim=(0, 1))
        axes.set_xlim(left=0)
        axes.legend(frameon=False, loc="lower right")
    return figure


def error_histograms(evaluation: Evaluation) -> Figure:
    """Plot histograms of the errors, as in the paper's Figure 8."""
    figure = new_figure(9.0, 6.0)
    for axes, name, unit, model, baseline in _error_panels(figure, evaluation):
        edges = np.linspace(0.0, max(model.max(), baseline.max()), 41).tolist()
        axes.hist(baseline, edges, color=BASELINE_COLOR, alpha=0.55, label="mean pose")
        axes.hist(model, edges, color=MODEL_COLOR, alpha=0.85, label="model")
        title = f"distribution of the {name} error"
        _label(axes, title, xlabel=f"{name} error, {unit}", ylabel="images")
        axes.legend(frameon=False, loc="upper right")
    return figure


def errors_by_distance(evaluation: Evaluation) -> Figure:
    """Plot each image's errors over the distance of the object."""
    figure = new_figure(9.0, 6.0)
    distance = np.linalg.norm(evaluation.dataset.poses[:, :3], axis=1)
    for axes, name, unit, model, _ in _error_panels(figure, evaluation):
        axes.scatter(distance, model, s=9, color=MODEL_COLOR, alpha=0.6, linewidths=0)
        labels = {"xlabel": "true distance, m", "ylabel": f"{name} error, {unit}"}
        _label(axes, f"{name} error over distance", **labels)
        axes.set_ylim(bottom=0)
    return figure


def errors_by_view(evaluation: Evaluation) -> Figure:
    """Map the median rotation error over the directions from which the object is seen.

    Directions from the object to the camera, in the object's frame, in Mollweide's equal-area
    projection: x is in the middle, z above. All cells are of one area; a dot is an image, a cross
    one whose error is beyond `FAR_DEG`, and a cell without images is gray.
    """
    figure = new_figure(9.0, 4.8)
    axes = figure.add_subplot(projection="mollweide")
    axes.set_facecolor(GRID_COLOR)
    poses, errors = evaluation.dataset.poses, evaluation.errors.rotation_deg.numpy()
    rays = poses[:, :3] / np.linalg.norm(poses[:, :3], axis=1, keepdims=True)
    seen_from = -np.einsum("nji,nj->ni", rotation_matrix(poses[:, 3:]), rays)
    longitude = np.arctan2(seen_from[:, 1], seen_from[:, 0])
    height = np.clip(seen_from[:, 2], -1, 1)
    edges = np.linspace(-np.pi, np.pi, MAP_CELLS[1] + 1), np.linspace(-1, 1, MAP_CELLS[0] + 1)
    column, row = np.digitize(longitude, edges[0][1:-1]), np.digitize(height, edges[1][1:-1])
    medians = np.full(MAP_CELLS, np.nan)
    for cell in {*zip(row.tolist(), column.tolist(), strict=True)}:
        medians[cell] = np.median(errors[(row == cell[0]) & (column == cell[1])])
    colors = axes.pcolormesh(
        edges[0], np.arcsin(edges[1]), np.ma.masked_invalid(medians), cmap="Blues", vmin=0.0
    )
    figure.colorbar(colors, ax=axes, shrink=0.7, label="median rotation error, degrees")
    far = errors > FAR_DEG
    for chosen, marker, color in ((~far, ".", "#16202e"), (far, "x", "#d33")):
        axes.scatter(
            longitude[chosen],
            np.arcsin(height[chosen]),
            s=9,
            marker=marker,
            color=color,
            linewidths=0.8,
        )
    axes.set_xticks([-np.pi / 2, 0, np.pi / 2], ["-y", "+x", "+y"])
    axes.set_yticks([-np.pi / 3, 0, np.pi / 3], ["-60°", "0°", "60°"])
    axes.set_title("rotation error by viewing direction in the object's frame", fontsize=10)
    axes.grid(visible=True, color=GRID_COLOR, linewidth=0.8)
    return figure


def predicted_angles(evaluation: Evaluation) -> Figure:
    """Plot predicted over true roll, pitch and yaw: a line if they are learned, else a band."""
    figure = new_figure(10.5, 3.6)
    limits = {"roll": 180, "pitch": 90, "yaw": 180}
    panels = zip(
        figure.subplots(1, 3), limits.items(), *(a.T for a in evaluation.angles), strict=True
    )
    for axes, (name, limit), predicted, truth in panels:
        axes.plot([-limit, limit], [-limit, limit], color=BASELINE_COLOR, linewidth=0.8)
        axes.scatter(truth, predicted, s=9, color=MODEL_COLOR, alpha=0.6, linewidths=0)
        axes.set(xlim=(-limit, limit), ylim=(-limit, limit), aspect="equal")
        _label(axes, name, xlabel=f"true {name}, degrees", ylabel=f"predicted {name}, degrees")
    return figure


def reliability_diagram(evaluation: Evaluation) -> Figure:
    """Plot the coverage of confidence regions over their probability; diagonal if calibrated.

    Raises:
        ValueError: The evaluation holds no covariance.
    """
    if not evaluation.region_probabilities:
        raise ValueError("reliability diagram: expected an evaluation with covariances, got none")
    figure = new_figure(4.6, 4.2)
    axes = figure.subplots()
    axes.plot([0, 1], [0, 1], color=BASELINE_COLOR, linewidth=0.8, label="calibrated")
    for (name, probability), style in zip(
        evaluation.region_probabilities.items(), ("-", "--"), strict=False
    ):
        empirical = coverage(probability, CURVE)
        axes.plot(CURVE, empirical, style, color=MODEL_COLOR, marker=".", label=name)
    across, up = "probability of the predicted region", "share of the truths within it"
    _label(axes, "reliability of the covariances", xlabel=across, ylabel=up)
    axes.set(xlim=(0, 1), ylim=(0, 1), aspect="equal")
    axes.legend(frameon=False, loc="upper left")
    return figure


def draw_prediction(evaluation: Evaluation, index: int) -> Image.Image:
    """Return image ``index`` with the predicted axes drawn over the pale true ones."""
    dataset = evaluation.dataset
    image = dataset.load_image(index)
    if image.width < GALLERY_TILE[0]:
        scale = GALLERY_TILE[0] / image.width
        image = image.resize((GALLERY_TILE[0], round(image.height * scale)))
    record, wide = dataset.records[index], max(4, image.width // 80)
    camera = record.camera
    truth = dataset.to_pose(evaluation.truth[index])  # of one look's, the nearest
    length = evaluation.axis_m
    image = draw_axes(image, truth, camera, length, TRUTH_COLORS, wide)
    found = dataset.to_pose(evaluation.predicted[index])
    return draw_axes(image, found, camera, length, width=max(2, wide // 3))


def caption(evaluation: Evaluation, index: int) -> str:
    """Return the errors of image ``index`` in words."""
    errors = evaluation.errors
    return f"{float(errors.translation_m[index]):.2f} m, {float(errors.rotation_deg[index]):.1f}°"


def gallery(evaluation: Evaluation, indices: Sequence[int], columns: int = 4) -> Figure:
    """Draw predictions on their images, with their errors."""
    rows = -(-len(indices) // columns)
    figure = new_figure(3.0 * columns, 2.5 * rows)
    grid = figure.subplots(rows, columns, squeeze=False).ravel()
    for axes in grid:
        axes.set_axis_off()
    for axes, index in zip(grid, indices, strict=False):
        axes.imshow(np.asarray(draw_prediction(evaluation, index)))
        axes.set_title(
            f"{evaluation.dataset.names[index]}\n{caption(evaluation, index)}",
            fontsize=8,
            parse_math=False,
        )
    return figure


def write_evaluation_figures(evaluation: Evaluation, out: Path) -> None:
    """Write all figures of an evaluation to the folder ``out``."""
    figures: dict[str, Callable[[Evaluation], Figure]] = {
        "error_cdf.png": error_cdf,
        "error_histograms.png": error_histograms,
        "predicted_angles.png": predicted_angles,
        "typical.png": lambda each: gallery(each, each.typical(8)),
        "worst.png": lambda each: gallery(each, each.ranking[::-1][:16].tolist()),
    }
    if evaluation.dataset.target == "object":
        figures["errors_by_distance.png"] = errors_by_distance
    if evaluation.region_probabilities:
        figures["reliability.png"] = reliability_diagram
    for name, draw in figures.items():
        save_figure(draw(evaluation), out / name)


def _error_panels(
    figure: Figure, evaluation: Evaluation
) -> list[tuple[Axes, str, str, FloatArray, FloatArray]]:
    """Return a panel for each error: axes, name, unit, and the errors of model and baseline."""
    fields = [
        ("translation", "m", "translation_m"),
        ("rotation", "degrees", "rotation_deg"),
        ("in-plane", "degrees", "in_plane_deg"),
        ("out-of-plane", "degrees", "out_of_plane_deg"),
    ]
    both = evaluation.errors, evaluation.baseline_errors
    if evaluation.dataset.target == "camera":
        fields = fields[:2]  # the others are NaN
    grid = figure.subplots(len(fields) // 2, 2, squeeze=False).flat
    return [
        (axes, name, unit, *(getattr(errors, field).numpy() for errors in both))
        for axes, (name, unit, field) in zip(grid, fields, strict=True)
    ]


def _label(axes: Axes, title: str, **labels: Any) -> None:
    axes.set(**labels)
    axes.set_title(title, fontsize=10, loc="left")
    style_axes(axes)
