"""What the pages show of ``docs/figures/filter.json``."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import product
from statistics import geometric_mean
from typing import Any

from benchmarks.filter.cases import CHANNELS_FIRST, COMPILED, MATRICES, SCIPY, TORCH
from benchmarks.output import in_threads
from benchmarks.pages.documents import Figures
from benchmarks.pages.markdown import ISAS, NOTHING, Source, measured_on, spread, table

GROUPS: Mapping[str, tuple[str, str]] = {
    "grid, batch 1": ("grids", "grids 7×7×512 to 56×56×64, batch 1"),
    "grid, batch 8 and 32": ("grids", "these grids, batches 8 and 32"),
    "tokens": ("tokens", "tokens 196×128 to 784×256"),
    "other sizes": ("other sizes", "other sizes, primes and sequences among them"),
    "few channels": ("few channels", "one to seven channels, sequences and tokens"),
    "few rows": ("few rows", "eight rows, tokens 8×256 and grids 8×256×4"),
    "few tokens": ("few tokens", "few tokens, 7×7 to 100×5, batch 64"),
}
"""Of each group of cases its short and its long name."""

QUICK_GROUPS: Mapping[str, str] = {
    "grid, batch 1": "grid 14×14×256, batch 1",
    "grid, batch 8 and 32": "grid 14×14×256, batch 8",
    "tokens": "tokens 196×256",
    "other sizes": "sequence 50×64",
}
"""Their names where ``--quick`` measured one size of each."""

SHORT = ("grid, batch 1", "tokens")
WORKS = {"forward": "forward", "forward+backward": "forward + backward"}

Key = tuple[str, int, str, str]
"""Instruction set, threads, group, and work of a mean."""


def _means(figures: Figures) -> dict[Key, dict[str, Any]]:
    return {
        (each["isa"], each["threads"], each["group"], each["work"]): each
        for each in figures.results["geometric_means"]
    }


def _isas(figures: Figures) -> list[str]:
    return list(dict.fromkeys(isa for isa, *_ in _means(figures)))


def _name(figures: Figures, group: str) -> str:
    return QUICK_GROUPS[group] if figures.quick else GROUPS[group][1]


def _cell(mean: Mapping[str, Any] | None, best_layout: bool) -> str:
    if mean is None:
        return NOTHING
    prefix = "best_layout_" if best_layout else ""
    return spread(mean[f"{prefix}geometric_mean_ratio"], mean[f"{prefix}worst_ratio"])


def speedup(source: Source) -> str:
    """Return the range of the means over torch.fft in its better layout, in words."""
    figures = source("filter")
    isa, threads = _isas(figures)[0], min(figures.threads)
    means = sorted(
        (each["best_layout_geometric_mean_ratio"], GROUPS[group][0])
        for (one, count, group, _), each in _means(figures).items()
        if (one, count) == (isa, threads)
    )
    (low, least), (high, most) = means[0], means[-1]
    return (
        f"{low:.1f} ({least}) to {high:.1f} times ({most}) as fast as `torch.fft` in its better"
        " layout"
    )


def means(source: Source, groups: Sequence[str] = tuple(GROUPS)) -> str:
    """Return the table of the best instruction set, one thread: in our layout, and in the best."""
    figures = source("filter")
    found, isa, threads = _means(figures), _isas(figures)[0], min(figures.threads)
    header = [
        "times as fast as `torch.fft`, geometric mean (smallest)",
        *WORKS.values(),
        *(f"{work}, its best layout" for work in WORKS.values()),
    ]
    rows = [
        [
            _name(figures, group),
            *(
                _cell(found.get((isa, threads, group, work)), best)
                for best, work in product((False, True), WORKS)
            ),
        ]
        for group in groups
        if any((isa, threads, group, work) in found for work in WORKS)
    ]
    return f"{table(header, rows)}\n\n{measured_on(figures, [threads])}"


def instruction_sets(source: Source) -> str:
    """Return the table of all instruction sets and threads, over torch.fft in its best layout."""
    figures = source("filter")
    found = _means(figures)
    isas = _isas(figures)
    header = [
        "over `torch.fft` in its best layout, geometric mean (smallest)",
        *(f"{ISAS[isa]}, {work}" for isa, work in product(isas, WORKS.values())),
    ]
    rows = [
        [
            f"{_name(figures, group)}, {in_threads(threads)}",
            *(
                _cell(found.get((isa, threads, group, work)), True)
                for isa, work in product(isas, WORKS)
            ),
        ]
        for threads, group in product(figures.threads, GROUPS)
        if any((isa, threads, group, work) in found for isa, work in product(isas, WORKS))
    ]
    return f"{table(header, rows)}\n\n{measured_on(figures, figures.threads)}"


def _label(case: Mapping[str, Any]) -> str:
    size = "×".join(map(str, case["size"]))
    return f"{case['kind']} {size}, batch {case['batch']}, {WORKS.get(case['work'], case['work'])}"


def rivals(source: Source) -> str:
    """Return every rival's time over ours; the column of one that is left out says why."""
    figures = source("filter")
    names = (TORCH, CHANNELS_FIRST, COMPILED, SCIPY, MATRICES)
    notes = figures.results["notes"]
    rows = [
        [
            _label(each["case"]),
            *(
                f"{each['ratio'][name]:.1f}" if name in each["ratio"] else _absence(name, notes)
                for name in names
            ),
        ]
        for each in figures.results["results"]
        if {SCIPY, MATRICES} & set(each["ratio"])
    ]
    header = ["their time over ours", *names]
    return f"{table(header, rows)}\n\n{measured_on(figures, [min(figures.threads)])}"


def _absence(name: str, notes: Iterable[str]) -> str:
    """Return why a contender is nowhere measured; a dash if it is in other cases."""
    start = f"{name} is not measured: "
    return next((each.removeprefix(start) for each in notes if each.startswith(start)), NOTHING)


def vector_code(source: Source) -> str:
    """Return the ratios to torch.fft with MKL in its baseline and its vector code."""
    figures = source("filter")
    found = figures.results["vector_code"]
    if found is None:
        return "Not measured here: MKL runs its vector code anyway, or there is no C compiler."
    usual = {_label(each["case"]): each["ratio"] for each in reversed(figures.results["results"])}
    rows = [
        [
            label,
            *(
                f"{ratio[name]:.1f}" if name in ratio else NOTHING
                for ratio in (usual[label], each["ratio"])
                for name in (TORCH, CHANNELS_FIRST)
            ),
        ]
        for each in found["results"]
        if each["case"]["work"] in WORKS and (label := _label(each["case"])) in usual
    ]
    header = [
        "their time over ours",
        *(
            f"{name}, {code} code"
            for code in ("baseline", "vector")
            for name in (TORCH, CHANNELS_FIRST)
        ),
    ]
    return f"{table(header, rows)}\n\n{measured_on(figures, [1], mkl=False)}"


def limits(source: Source) -> str:
    """Return a list: small calls, half precision, copies, threads."""
    results = source("filter").results
    best = _isas(source("filter"))[0]
    lines = []
    shares = {each["work"]: each["call"] / each["torch_call"] for each in results["overheads"]}
    lines.append(
        f"*Small calls.* A call of a 7×7×32 filter takes {shares['forward']:.2f} of `torch.fft`'s"
        f" time without gradient, and {shares['recorded']:.2f} recording for one."
    )
    for key, words in (
        (
            "bfloat16_over_float32",
            "*Half precision.* bfloat16 at batch 32 takes {} of float32's time.",
        ),
        (
            "times_a_copy",
            "*Memory.* A grid's forward pass at batch 32 takes {} times as long as a copy.",
        ),
        (
            "gain_of_threads",
            "*Two threads* make calls of more than 200 µs {} times as fast as one.",
        ),
    ):
        measured = [each for each in results[key] if each["isa"] == best]
        if key == "gain_of_threads":
            measured = [each for each in measured if each["threads"] == 2]
        if values := [each["value"] for each in measured]:
            low, high = min(values), max(values)
            text = f"{low:.2f} to {high:.2f} ({geometric_mean(values):.2f} in the mean)"
            lines.append(words.format(text))
    return "\n".join(f"- {line}" for line in lines)
