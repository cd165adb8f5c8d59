"""The JSON document of `ffpose bench model NETWORK`; times in seconds, memory in bytes."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from ffpose.bench.machine import environment

if TYPE_CHECKING:
    from ffpose.bench.model.deployment import DeploymentResults


def make_document(results: DeploymentResults) -> dict[str, Any]:
    """Return all measurements of a deployment, with the ratios of p50 to the baseline's."""
    baseline = results.baseline
    return {
        "network": results.network,
        "baseline": baseline,
        "notes": list(results.notes),
        "environment": environment(),
        "results": [
            {
                "batch": case.batch,
                "threads": case.threads,
                "latencies": {name: asdict(each) for name, each in case.latencies.items()},
                "ratio": {
                    name: each.p50 / case.latencies[baseline].p50
                    for name, each in case.latencies.items()
                },
                "largest_difference": dict(case.differences),
            }
            for case in results.cases
        ],
        "image_file_to_pose": [
            {
                "threads": threads,
                "latencies": {
                    name: {stage: asdict(each) for stage, each in by_stage.items()}
                    for name, by_stage in by_name.items()
                },
            }
            for threads, by_name in results.stages.items()
        ],
        "cold_starts": {name: asdict(start) for name, start in results.starts.items()},
    }
