"""The JSON document of a benchmark: every timing, and the results derived from them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from ffpose.bench.filter.cases import COPY, OURS
from ffpose.bench.filter.children import Opening
from ffpose.bench.filter.figures import operations, traffic
from ffpose.bench.filter.results import (
    Comparison,
    GroupMean,
    gains_of_threads,
    group_means,
    half_over_single,
    over_copy,
    overheads,
)


def make_document(
    openings: Sequence[Opening], comparisons: Sequence[Comparison], notes: Sequence[str]
) -> dict[str, Any]:
    """Return all measurements as a JSON document; times in seconds."""
    return {
        "notes": list(notes),
        "processes": [asdict(opening) for opening in openings],
        "geometric_means": [_mean(each) for each in group_means(comparisons)],
        "times_a_copy": _listed(over_copy(comparisons)),
        "bfloat16_over_float32": _listed(half_over_single(comparisons)),
        "gain_of_threads": _listed(gains_of_threads(comparisons)),
        "overheads": [asdict(each) for each in overheads(comparisons)],
        "results": [_result(each) for each in comparisons],
    }


def _mean(mean: GroupMean) -> dict[str, Any]:
    return {
        "isa": mean.isa,
        "threads": mean.threads,
        "group": mean.group,
        "work": mean.work,
        "geometric_mean_ratio": mean.mean,
        "worst_ratio": mean.worst.ratio(),
        "worst_case": mean.worst.case.label,
    }


def _listed(pairs: Sequence[tuple[Comparison, float]]) -> list[dict[str, Any]]:
    return [
        {"isa": one.isa, "case": one.case.label, "threads": one.case.threads, "value": value}
        for one, value in pairs
    ]


def _result(one: Comparison) -> dict[str, Any]:
    seconds = one.best(OURS).median
    rivals = [name for name in one.names if name not in (OURS, COPY)]
    return {
        "isa": one.isa,
        "case": asdict(one.case),
        "group": one.case.group,
        "ratio": {name: one.ratio(name) for name in rivals},
        "ratio_default_allocator": {name: one.default_ratio(name) for name in rivals},
        "flops": operations(one.case) / seconds,
        "bytes": traffic(one.case) / seconds,
        "largest_difference": one.largest_difference,
        "timings": {
            allocator: {name: asdict(timing) for name, timing in timings.items()}
            for allocator, timings in one.timings.items()
        },
    }
