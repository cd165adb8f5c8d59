"""Tables, ratios and captions of the pages' figures."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

from benchmarks.output import in_threads
from benchmarks.pages.documents import Figures

Source = Callable[[str], Figures]
"""Gives the figures of a name."""

NOTHING = "–"

ISAS = {"avx512": "AVX-512", "avx2": "AVX2", "neon": "NEON", "scalar": "scalar code"}

MKL = {"baseline": ", MKL's baseline code", "vectorized": ", MKL's vector code", "": ""}


def table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a table of Markdown.

    >>> print(table(["a", "b"], [["1", "2"]]))
    | a | b |
    |---|---|
    | 1 | 2 |
    """
    lines = [_row(header), "|" + "---|" * len(header), *map(_row, rows)]
    return "\n".join(lines)


def _row(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cells)} |".replace("  ", " ")


def spread(mean: float, worst: float) -> str:
    """Return a mean with the worst in parentheses.

    >>> spread(11.46, 6.84)
    '11.5 (6.8)'
    """
    return f"{mean:.1f} ({worst:.1f})"


def milliseconds(seconds: float) -> str:
    """Return a duration in milliseconds, with a digit after the point below 10.

    >>> [milliseconds(value) for value in (0.12345, 0.00456)]
    ['123', '4.6']
    """
    return f"{1e3 * seconds:.{1 if seconds < 0.00995 else 0}f}"


def measured_on(figures: Figures, threads: Sequence[int], mkl: bool = True) -> str:
    """Return where and how figures were measured, as a line in italics.

    Args:
        figures: The data file.
        threads: Numbers of threads that the table shows.
        mkl: Whether MKL ran one kind of code throughout, which is then named.
    """
    about = figures.environment
    isa = ISAS[about["instruction_set"]]
    words = [
        " and ".join(map(in_threads, threads)),
        f"{figures.machine}, {about['cores']} cores, {isa}",
        f"ffpose {about['ffpose']}, torch {about['torch']}{MKL[about['mkl_code']] if mkl else ''}",
        *(["a few cases with short timings (`--quick`)"] if figures.quick else []),
        *([figures.note] if figures.note else []),
    ]
    return f"*{'; '.join(words)}*"
