"""Style of all plots: empty figures, axes with a pale grid, atomic files."""

from __future__ import annotations

import base64
import html
import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from ffpose._internal.files import atomic_write
from ffpose.errors import require

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from PIL.Image import Image

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
    """Write a figure atomically, in the format of the suffix unless one is given."""
    with atomic_write(path) as temporary:
        figure.savefig(temporary, dpi=dpi, format=format)


def embedded(figure: Figure, text: str, **options: Any) -> str:
    """Return a figure as an element of an HTML page; ``options`` are those of `savefig`."""
    buffer = io.BytesIO()
    figure.savefig(buffer, **options)
    return image_tag(options["format"], buffer.getvalue(), text)


def image_tag(format: str, data: bytes, text: str) -> str:
    """Return an element of an HTML page with an image (png, jpeg or svg) and its description."""
    kind = "svg+xml" if format == "svg" else format
    encoded = base64.b64encode(data).decode("ascii")
    return f'<img src="data:image/{kind};base64,{encoded}" alt="{html.escape(text)}">'


def jpeg_tag(image: Image, text: str) -> str:
    """Return an element of an HTML page with a Pillow image as JPEG, and its description."""
    buffer = io.BytesIO()
    image.save(buffer, "JPEG", quality=88)
    return image_tag("jpeg", buffer.getvalue(), text)


def draw_bars(
    path: Path, title: str, rows: Sequence[Mapping[str, Any]], names: int, bar: str, end: str = ""
) -> None:
    """Write a PNG file of horizontal bars, one for each row of a table.

    The first ``names`` columns name a bar, column ``bar`` is its length, and ``end``, if any, where
    a line beyond it ends.
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
