"""The child process of a benchmark: ``python -m ffpose.bench.filter.worker``.

Instruction set, allocator and thread pools are fixed for the life of a process, so each setting has
a process of its own. The worker reads a `Request` as JSON from standard input, and writes one JSON
document per line to standard output: first its environment and peaks, then each `Measurement`.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

from ffpose.bench.filter.cases import Case
from ffpose.bench.filter.measure import measure
from ffpose.bench.machine import environment, measure_peak


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
