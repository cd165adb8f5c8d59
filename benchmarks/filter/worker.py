"""The child process of a benchmark: ``python -m benchmarks.filter.worker``.

Instruction set, allocator and thread pools are fixed for the life of a process, so each setting has
a process of its own. The worker reads a `Request` as JSON from standard input, and writes one JSON
document per line to standard output: first its environment and peaks, then each `Measurement`. The
results of a case's contenders are compared before they are timed in turn.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Self

import torch

from benchmarks.filter.cases import COPY, HALF, Case
from benchmarks.filter.rivals import contenders, in_our_layout
from benchmarks.machine import environment, measure_peak
from benchmarks.timing import WARM_UP, Contender, Timing, interleave
from ffpose.bench.filter import OURS
from ffpose.inference.in_torch import torch_threads

APART = 1e-3
"""Largest difference of float32 results, relative to the largest value, that counts as equal."""


@dataclass(frozen=True)
class Measurement:
    """Timings of a case by contender, and the largest difference of rivals' results from ours."""

    case: Case
    timings: Mapping[str, Timing]
    largest_difference: float

    @classmethod
    def from_json(cls, fields: dict[str, Any]) -> Self:
        """Rebuild a measurement from JSON fields."""
        timings = {name: Timing(**timing) for name, timing in fields["timings"].items()}
        return cls(Case.from_json(fields["case"]), timings, fields["largest_difference"])


def measure(case: Case, seconds: float) -> Measurement:
    """Measure ``case`` for about ``seconds`` per contender.

    Raises:
        RuntimeError: A rival's result or gradient differs from ours.
    """
    with torch_threads(case.threads), torch.set_grad_enabled(case.work != "forward"):
        taking_part = contenders(case)
        difference = _largest_difference(case, taking_part)
        timings = interleave(taking_part, seconds, warmup_seconds=min(WARM_UP, seconds))
        return Measurement(case, timings, difference)


def _largest_difference(case: Case, taking_part: Mapping[str, Contender]) -> float:
    ours = _results(taking_part[OURS])
    largest = 0.0
    for name in set(taking_part) - {OURS, COPY, HALF}:
        results = in_our_layout(name, case, _results(taking_part[name]))
        for mine, theirs in zip(ours, results, strict=True):
            difference = float((mine - theirs).abs().max() / theirs.abs().max())
            if not difference < APART:
                raise RuntimeError(f"{case.label}: {name} differs from ffpose by {difference:.1e}")
            largest = max(largest, difference)
    return largest


def _results(contender: Contender) -> tuple[torch.Tensor, ...]:
    """Return the results of a call: the filtered images, or both gradients."""
    result: Any = contender.call()
    return tuple(map(torch.as_tensor, result if isinstance(result, tuple) else (result,)))


@dataclass(frozen=True)
class Request:
    """Request to a child: the cases, and the seconds for each of their contenders."""

    cases: Sequence[Case]
    seconds: float


def main() -> None:
    """Read the request from standard input, measure, and write the results."""
    fields = json.load(sys.stdin)
    request = Request([Case.from_json(each) for each in fields["cases"]], fields["seconds"])
    threads = sorted({case.threads for case in request.cases})
    peaks = [asdict(measure_peak(count)) for count in threads]
    _write({"environment": environment(), "peaks": peaks})
    for case in request.cases:
        _write(asdict(measure(case, request.seconds)))


def _write(document: dict[str, Any]) -> None:
    print(json.dumps(document), flush=True)


if __name__ == "__main__":
    try:
        main()
    except KeyboardInterrupt:
        sys.exit(130)  # the parent, interrupted too, tells the user
