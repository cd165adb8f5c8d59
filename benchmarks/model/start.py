"""Child process of `benchmarks.model.pipeline`: from start to first pose, and its peak memory.

``python -m benchmarks.model.start RUNTIME FILE IMAGE THREADS`` prints one JSON document. It
imports what that runtime needs and nothing else, as a program of a user would.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import get_args

import ffpose
from ffpose.inference.source import Backend


def main(runtime: Backend, file: str, image: str, threads: int) -> None:
    """Predict one pose, then print it with this process's peak memory in bytes."""
    estimator = ffpose.load(file, backend=runtime, threads=threads, device="cpu", warm_up=0)
    pose = estimator(image)
    print(json.dumps({"pose": pose.vector.tolist(), "peak": peak_memory()}), flush=True)


def peak_memory() -> int:
    """Return the largest resident size of this process so far, in bytes."""
    status = Path("/proc/self/status")
    if status.exists():  # getrusage on Linux also counts the process that this one was forked from
        for line in status.read_text().splitlines():
            if line.startswith("VmHWM:"):
                return int(line.split()[1]) * 1024
    import resource

    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("runtime", choices=get_args(Backend))
    parser.add_argument("file")
    parser.add_argument("image")
    parser.add_argument("threads", type=int)
    main(**vars(parser.parse_args()))
