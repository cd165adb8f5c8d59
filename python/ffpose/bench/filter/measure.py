"""Measuring one case: the contenders' results are compared, then they are timed in turn."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Self

import torch

from ffpose.bench.filter.cases import COPY, HALF, OURS, Case
from ffpose.bench.filter.rivals import contenders
from ffpose.bench.timing import Contender, Timing, interleave

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
    before = torch.get_num_threads()
    torch.set_num_threads(case.threads)
    try:
        with torch.set_grad_enabled(case.work != "forward"):
            taking_part = contenders(case)
            difference = _largest_difference(case, taking_part)
            return Measurement(case, interleave(taking_part, seconds), difference)
    finally:
        torch.set_num_threads(before)


def _largest_difference(case: Case, taking_part: Mapping[str, Contender]) -> float:
    ours = _results(taking_part[OURS])
    largest = 0.0
    for name in set(taking_part) - {OURS, COPY, HALF}:
        for mine, theirs in zip(ours, _results(taking_part[name]), strict=True):
            difference = float((mine - theirs).abs().max() / theirs.abs().max())
            if not difference < APART:
                raise RuntimeError(f"{case.label}: {name} differs from ffpose by {difference:.1e}")
            largest = max(largest, difference)
    return largest


def _results(contender: Contender) -> tuple[torch.Tensor, ...]:
    """Return the results of a call: the filtered images, or both gradients."""
    result: Any = contender.call()
    return tuple(map(torch.as_tensor, result if isinstance(result, tuple) else (result,)))
