"""``python -m benchmarks onboard GRAPH SEQUENCE``: a frame's time in the program that flies.

Two processes of ``ffpose-onboard``, one thread each, are given the frames of a sequence in turn, so
that neither has a quieter machine: one poses each frame alone, the other tracks. A frame's time is
that from its line to its answer, files read and decoded included. Frames in which the track
searched the whole image, until it was there and after those that did not correct it, are counted
and left out of its median.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np

from ffpose.onnx import get_library_path
from ffpose.tracking.frames import read_frames

PROGRAM = Path("target/onboard/release/ffpose-onboard")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command line."""
    parser.add_argument("graph", type=Path, help="graph of `ffpose export --track`")
    parser.add_argument("sequence", type=Path, help="folder of `ffpose render approach`")
    text = "what `make onboard` builds (default: %(default)s)"
    parser.add_argument("--program", type=Path, default=PROGRAM, help=text)


def run(options: argparse.Namespace) -> None:
    """Measure, and print the results as JSON."""
    frames = read_frames(options.sequence)
    command = [options.program, "--model", options.graph, "--runtime", _runtime(), "--threads", "1"]
    command += ["--operators", get_library_path()]
    with ExitStack() as stack:
        alone = stack.enter_context(_started([*command, "--stdin"]))
        tracked = stack.enter_context(_started([*command, "--track"]))
        whole, look, searched, expects = [], [], 0, False
        for frame in frames:
            milliseconds, answer = _ask(alone, str(frame.image))
            if "error" in answer:
                raise ValueError(f"{frame.image}: {answer['error']}")
            whole.append(milliseconds)
            milliseconds, answer = _ask(tracked, f"{frame.time} {frame.image}")
            if expects:
                look.append(milliseconds)
            searched += not expects
            expects = answer["accepted"] and "translation_m" in answer
    if not look:
        raise ValueError(f"{options.sequence}: expected a track, got none of {len(frames)} frames")
    medians = {"alone": float(np.median(whole)), "with_a_track": float(np.median(look))}
    print(
        json.dumps(
            {
                "milliseconds": medians,
                "ratio": medians["with_a_track"] / medians["alone"],
                "frames": len(frames),
                "searched_whole": searched,
            },
            indent=1,
        )
    )


def _runtime() -> Path:
    """Return ONNX Runtime's library, that of Python's package.

    Raises:
        ValueError: The package has none for other programs.
    """
    import onnxruntime

    found = sorted((Path(onnxruntime.__file__).parent / "capi").glob("libonnxruntime.*"))
    if not found:
        raise ValueError("onnxruntime: expected a library for other programs, got none")
    return found[0]


@contextmanager
def _started(command: list[Any]) -> Iterator[subprocess.Popen[str]]:
    """Start a process that answers lines, and end it."""
    pipe = subprocess.PIPE
    with subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True) as process:
        assert process.stdin is not None
        try:
            yield process
        finally:
            with suppress(BrokenPipeError):  # of a line that an ended program has not read
                process.stdin.close()


def _ask(process: subprocess.Popen[str], line: str) -> tuple[float, dict[str, Any]]:
    """Return the milliseconds from a line to its answer, and the answer.

    Raises:
        ValueError: The process has ended; standard error says why.
    """
    assert process.stdin is not None
    assert process.stdout is not None
    begin = time.perf_counter()
    with suppress(BrokenPipeError):  # of a program that has said why; its answer is empty
        process.stdin.write(line + "\n")
        process.stdin.flush()
    answer = process.stdout.readline()
    milliseconds = 1e3 * (time.perf_counter() - begin)
    if not answer:
        raise ValueError(f"{line}: expected an answer, got the end of the program")
    return milliseconds, json.loads(answer)
