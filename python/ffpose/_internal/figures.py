"""Style of all plots: empty figures, axes with a pale grid, atomic files."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from ffpose._internal.files import atomic_write
from ffpose.errors import require

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

GRID_COLOR = "#e6e8ec"


def new_figure(width: float, height: float) -> Figure:
    """Return an empty figure, size in inches, that is not in pyplot's global list."""
    figure: Figure = require("matplotlib.figure", "pose").Figure(
        figsize=(width, height), layout="constrained"
    )
    return figure


def style_axes(axes: Axes, grid: Literal["both", "x", "y"] | None = "both") -> None:
    """Draw no frame above and to the right, and grid lines behind the data."""
    axes.spines[["top", "right"]].set_visible(False)
    if grid is not None:
        axes.grid(visible=True, axis=grid, color=GRID_COLOR, linewidth=0.8)
        axes.set_axisbelow(True)


def save_figure(figure: Figure, path: Path, dpi: int = 120, format: str | None = None) -> None:
    """Write a figure atomically.

    Args:
        figure: The figure.
        path: File to write.
        dpi: Pixels per inch.
        format: Image format; None for that of the suffix.
    """
    with atomic_write(path) as temporary:
        figure.savefig(temporary, dpi=dpi, format=format)


def draw_bars(
    path: Path, title: str, rows: Sequence[Mapping[str, Any]], names: int, bar: str, end: str = ""
) -> None:
    """Write a PNG file of horizontal bars.

    Args:
        path: File to write.
        title: Of the picture.
        rows: Of a table: words and numbers by column.
        names: How many columns, of the first, name a bar.
        bar: Column of the bars' lengths.
        end: Column of the ends of lines beyond them; empty without.
    """
    figure = new_figure(7.0, 1.2 + 0.3 * len(rows))
    axes = figure.subplots()
    for row in rows:
        name = ", ".join(f"{column} {cell}" for column, cell in [*row.items()][:names])
        beyond = [[0.0], [row[end] - row[bar]]] if end else None
        axes.barh(name, row[bar], xerr=beyond, color="C0")
    axes.invert_yaxis()
    axes.set_title(title)
    style_axes(axes, "x")
    save_figure(figure, path, format="png")
