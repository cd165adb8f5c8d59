"""What the pages show of the data files of networks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from benchmarks.model.contenders import (
    CUSTOM,
    INT8,
    OPENVINO,
    PLAIN,
    TORCH,
    TORCH_ALONE,
    WITHOUT,
)
from benchmarks.model.networks import BEFORE, FFT, SDPA
from benchmarks.model.pipeline import STAGES, TOTAL
from benchmarks.output import in_threads
from benchmarks.pages.documents import Figures
from benchmarks.pages.markdown import NOTHING, Source, measured_on, milliseconds, table
from ffpose.bench.filter import OURS

NETWORKS = ("soyuz", "base", "small", "gfnet")
WEIGHTS = ("soyuz", "base")
"""Networks of which whole images are measured."""

Latencies = Mapping[str, Mapping[str, float]]


def _cases(figures: Figures) -> dict[int, Latencies]:
    """Return the latencies by number of threads."""
    return {each["threads"]: each["latencies"] for each in figures.results["results"]}


def _first(figures: Figures) -> tuple[int, Latencies]:
    return min(_cases(figures).items())


def _runtime(latencies: Mapping[str, Any]) -> str:
    return CUSTOM if CUSTOM in latencies else PLAIN


def _share(latencies: Latencies, name: str) -> str:
    baseline = next(iter(latencies.values()))
    return f"{latencies[name]['p50'] / baseline['p50']:.2f}" if name in latencies else NOTHING


def _pair(latency: Mapping[str, float]) -> str:
    return f"{milliseconds(latency['p50'])} ({milliseconds(latency['p95'])})"


def shares(source: Source) -> str:
    """Return each network's share of the time of torch alone, in the runtimes it is deployed in."""
    rows = []
    for network in NETWORKS:
        threads, latencies = _first(source(network))
        names = (TORCH, _runtime(latencies), INT8, OPENVINO)
        rows.append([f"`{network}`", *(_share(latencies, name) for name in names)])
    header = [
        f"share of the time of {TORCH_ALONE}, {in_threads(threads)}",
        *("PyTorch with ffpose", "ONNX Runtime", "int8", "OpenVINO"),
    ]
    return f"{table(header, rows)}\n\n{measured_on(source(NETWORKS[0]), [threads])}"


def latencies(source: Source, name: str) -> str:
    """Return p50 and p95 of all contenders, for each number of threads, and their shares."""
    figures = source(name)
    cases = _cases(figures)
    header = ["p50 (p95), ms"]
    for threads in cases:
        header += [in_threads(threads), "share"]
    rows = []
    for contender in _first(figures)[1]:
        label = f"{contender}, which computes something else" if contender == WITHOUT else contender
        row = [label]
        for found in cases.values():
            row += [_pair(found[contender]), _share(found, contender)]
        rows.append(row)
    notes = [note for note in figures.results["notes"] if "is not measured" in note]
    return "\n".join([table(header, rows), "", measured_on(figures, list(cases)), *_listed(notes)])


def _listed(notes: Sequence[str]) -> list[str]:
    return ["", *(f"- {note}" for note in notes)] if notes else []


def which_network(source: Source) -> str:
    """Return the latencies of the pose networks side by side."""
    rows = []
    for network in ("base", "small", "soyuz"):
        threads, latencies = _first(source(network))
        names = (next(iter(latencies)), _runtime(latencies), OPENVINO)
        cells = (_pair(latencies[name]) if name in latencies else NOTHING for name in names)
        rows.append([f"`{network}`", *cells])
    header = [f"p50 (p95), ms, {in_threads(threads)}", TORCH_ALONE, "ONNX Runtime", "OpenVINO"]
    return f"{table(header, rows)}\n\n{measured_on(source('base'), [threads])}"


def stages(source: Source) -> str:
    """Return how long each stage from image file to pose takes."""
    rows = []
    for network in WEIGHTS:
        case = source(network).results["image_file_to_pose"][0]
        for contender, found in case["latencies"].items():
            cells = (milliseconds(found[stage]["p50"]) for stage in (*STAGES, TOTAL))
            rows.append([f"`{network}`, {contender}", *cells])
    header = [f"image file to pose, p50, ms, {in_threads(case['threads'])}", *STAGES, TOTAL]
    return f"{table(header, rows)}\n\n{measured_on(source(WEIGHTS[0]), [case['threads']])}"


def starts(source: Source) -> str:
    """Return how long a new process takes to its first pose, and its memory."""
    figures = source("soyuz")
    rows = [
        [name, f"{start['seconds']:.2g}", f"{start['peak_bytes'] / 1e6:.0f}"]
        for name, start in figures.results["cold_starts"].items()
    ]
    header = ["new process to the first pose of `soyuz`", "seconds", "peak memory, MB"]
    return f"{table(header, rows)}\n\n{measured_on(figures, [max(figures.threads)])}"


def int8(source: Source) -> str:
    """Return in words what int8 brings to the shipped network."""
    figures = source("soyuz")
    threads, found = _first(figures)
    if INT8 not in found:
        return "int8 was not measured on this machine"
    runtime = _runtime(found)
    wide, narrow = found[runtime]["p50"], found[INT8]["p50"]
    shares = figures.results["operator_shares"]
    convolutions = (
        sum(share for name, share in shares[each].items() if "Conv" in name)
        for each in (runtime, INT8)
    )
    before, after = (f"{100 * share:.0f} %" for share in convolutions)
    return (
        f"{narrow / wide:.2f} of the time in ONNX Runtime ({milliseconds(narrow)} ms of"
        f" {milliseconds(wide)}, p50, {in_threads(threads)}; {_share(found, INT8)} of PyTorch's)."
        f" Convolutions take {before} of the time of the graph's nodes, and {after} in int8"
    )


def views(source: Source) -> str:
    """Return the share of the time of the shipped network with fewer looks and candidates."""
    figures = source("views")
    found = figures.results["latencies"]
    shipped = list(found.values())[-1]["p50"]
    shares = {name: each["p50"] / shipped for name, each in found.items()}
    looks, counts = (list(dict.fromkeys(part)) for part in zip(*map(str.split, found), strict=True))
    rows = [[look, *(f"{shares[f'{look} {count}']:.2f}" for count in counts)] for look in looks]
    header = ["looks ↓ candidates →", *counts]
    return f"{table(header, rows)}\n\n{measured_on(figures, [1])}"


def attention(source: Source) -> str:
    """Return how many times as fast as each baseline networks are in inference and training."""
    figures = source("attention")
    header = ["their time over ours, batch 1", "ffpose, ms", BEFORE, SDPA, FFT]
    rows = [
        [
            f"`{case['model']}`, {case['task']}, {in_threads(case['threads'])}",
            milliseconds(each["timings"][OURS]["median"]),
            *(f"{each['ratio'][name]:.2f}" for name in (BEFORE, SDPA, FFT)),
        ]
        for each in figures.results["results"]
        for case in (each["case"],)
    ]
    return f"{table(header, rows)}\n\n{measured_on(figures, figures.threads)}"
