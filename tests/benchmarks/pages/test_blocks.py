"""Blocks of the pages from data files that are written by hand."""

import pytest

from benchmarks.filter.cases import CHANNELS_FIRST, COMPILED, MATRICES, TORCH
from benchmarks.model.contenders import CUSTOM, INT8, OPENVINO, PLAIN
from benchmarks.model.networks import BEFORE, FFT, SDPA
from benchmarks.pages.blocks import BLOCKS
from benchmarks.pages.documents import Figures
from ffpose.bench.filter import OURS

ABOUT = {
    "ffpose": "1.2.3",
    "torch": "2.99",
    "instruction_set": "avx2",
    "mkl_code": "vectorized",
    "cores": 2,
}
LINE = "*1 thread; a machine, 2 cores, AVX2; ffpose 1.2.3, torch 2.99, MKL's vector code*"


def figures(results, threads=(1,), **more):
    fields = {"machine": "a machine", "note": "", "quick": False} | more
    return Figures(**fields, threads=threads, environment=ABOUT, results=results)


def mean(group, value, worst, best_layout, threads=1, work="forward"):
    return {
        "isa": "avx2",
        "threads": threads,
        "group": group,
        "work": work,
        "geometric_mean_ratio": value,
        "worst_ratio": worst,
        "best_layout_geometric_mean_ratio": best_layout,
        "best_layout_worst_ratio": best_layout / 2,
    }


def case(size, work="forward", **ratio):
    fields = {"kind": "grid", "size": size, "batch": 1, "work": work, "threads": 1}
    return {"case": fields, "ratio": ratio}


FILTER = {
    "geometric_means": [
        mean("grid, batch 1", 11.46, 6.84, 9.0),
        mean("tokens", 3.0, 2.0, 3.0),
        mean("few channels", 2.0, 1.5, 1.04, work="forward+backward"),
        mean("grid, batch 1", 99.0, 98.0, 97.0, threads=2),
    ],
    "results": [
        case([7, 7, 2], **{TORCH: 5.0, CHANNELS_FIRST: 4.0, MATRICES: 2.0}),
        case([7, 7, 2], **{TORCH: 9.0}, work="recorded"),
    ],
    "notes": [f"{COMPILED} is not measured: no compiler"],
    "overheads": [
        {"work": "forward", "call": 1.0, "torch_call": 8.0},
        {"work": "recorded", "call": 1.0, "torch_call": 4.0},
    ],
    "bfloat16_over_float32": [{"isa": "avx2", "value": 0.5}, {"isa": "avx2", "value": 0.98}],
    "times_a_copy": [],
    "gain_of_threads": [
        {"isa": "scalar", "threads": 2, "value": 7.0},
        {"isa": "avx2", "threads": 2, "value": 1.5},
        {"isa": "avx2", "threads": 16, "value": 9.0},
    ],
    "vector_code": {
        "results": [
            case([7, 7, 2], **{TORCH: 3.0, CHANNELS_FIRST: 2.5}),
            case([7, 7, 2], **{TORCH: 8.0}, work="recorded"),
        ]
    },
}


def shown(name, **files):
    return BLOCKS[name](files.__getitem__).splitlines()


def test_the_range_of_means_is_over_torch_in_its_best_layout():
    (line,) = shown("speedup", filter=figures(FILTER, (1, 2)))
    assert line == (
        "1.0 (few channels) to 9.0 times (grids) as fast as `torch.fft` in its better layout"
    )


def test_means_are_of_one_thread_with_the_smallest_in_parentheses():
    header, _, grid, tokens, few, *_, line = shown("filter", filter=figures(FILTER, (1, 2)))
    assert header.count("best layout") == 2
    assert grid == "| grids 7×7×512 to 56×56×64, batch 1 | 11.5 (6.8) | – | 9.0 (4.5) | – |"
    assert tokens.endswith("| 3.0 (2.0) | – | 3.0 (1.5) | – |")
    assert few.endswith("| – | 2.0 (1.5) | – | 1.0 (0.5) |")
    assert line == LINE
    assert len(shown("filter-short", filter=figures(FILTER))) == 2 + 2 + 2


def test_a_quick_measurement_says_so_and_names_its_sizes():
    found = shown(
        "filter",
        filter=figures(
            {**FILTER, "geometric_means": FILTER["geometric_means"][:1]}, quick=True, note="a note"
        ),
    )
    assert found[2].startswith("| grid 14×14×256, batch 1 |")
    assert "(`--quick`); a note*" in found[-1]


def test_threads_have_rows_of_their_own():
    found = shown("filter-sets", filter=figures(FILTER, (1, 2)))
    assert found[2] == "| grids 7×7×512 to 56×56×64, batch 1, 1 thread | 9.0 (4.5) | – |"
    assert found[-3] == "| grids 7×7×512 to 56×56×64, batch 1, 2 threads | 97.0 (48.5) | – |"


def test_the_column_of_a_rival_that_is_left_out_says_why():
    header, _, row, *_ = shown("filter-rivals", filter=figures(FILTER))
    assert header.split(" | ")[3] == COMPILED
    assert row == "| grid 7×7×2, batch 1, forward | 5.0 | 4.0 | no compiler | – | 2.0 |"


def test_vector_code_stands_beside_baseline_code():
    _, _, row, empty, *_ = shown("filter-vector-code", filter=figures(FILTER))
    assert empty == ""
    assert row == "| grid 7×7×2, batch 1, forward | 5.0 | 4.0 | 3.0 | 2.5 |"
    (line,) = shown("filter-vector-code", filter=figures({**FILTER, "vector_code": None}))
    assert line.startswith("Not measured here")


def test_limits_by_hand():
    small, half, two = shown("filter-limits", filter=figures(FILTER))
    assert "takes 0.12 of `torch.fft`'s time" in small
    assert "0.25 recording" in small
    assert "takes 0.50 to 0.98 (0.70 in the mean) of float32's time" in half
    assert "calls of more than 200 µs 1.50 to 1.50 (1.50 in the mean) times" in two


def network(*names, p50=0.1, threads=(1,), **more):
    return figures(
        {
            "notes": ["OpenVINO is not measured: why", "quick"],
            "results": [
                {
                    "threads": count,
                    "latencies": {
                        name: {"p50": p50 / (1 + place), "p95": 2 * p50}
                        for place, name in enumerate(names)
                    },
                }
                for count in threads
            ],
            **more,
        },
        threads,
    )


def test_latencies_of_a_network_with_shares_of_the_first():
    found = shown("base", base=network("torch alone", PLAIN, p50=0.0126, threads=(1, 2)))
    assert found[0] == "| p50 (p95), ms | 1 thread | share | 2 threads | share |"
    assert found[3] == f"| {PLAIN} | 6.3 (25) | 0.50 | 6.3 (25) | 0.50 |"
    assert "- OpenVINO is not measured: why" in found
    assert "- quick" not in found


@pytest.mark.parametrize("runtime", [PLAIN, CUSTOM])
def test_int8_in_words(runtime):
    shares = {runtime: {"Conv": 0.5, "FusedConv": 0.1}, INT8: {"QLinearConv": 0.3, "Add": 0.2}}
    (line,) = shown("int8", soyuz=network("torch", runtime, INT8, operator_shares=shares))
    assert line == (
        "0.67 of the time in ONNX Runtime (33 ms of 50, p50, 1 thread; 0.33 of PyTorch's)."
        " Convolutions take 60 % of the time of the graph's nodes, and 30 % in int8"
    )


def test_networks_side_by_side():
    files = {name: network("torch alone", "torch", PLAIN, INT8) for name in ("base", "small")}
    files |= {"soyuz": network("torch", PLAIN, OPENVINO), "gfnet": files["base"]}
    found = shown("networks", **files)
    assert found[2] == "| `soyuz` | 1.00 | 0.50 | – | 0.33 |"
    assert found[3] == "| `base` | 0.50 | 0.33 | 0.25 | – |"
    found = shown("which-network", **files)
    assert found[4] == "| `soyuz` | 100 (200) | 50 (200) | 33 (200) |"


def test_attention_has_each_baseline():
    each = {
        "case": {"model": "tiny", "task": "inference", "threads": 1},
        "timings": {OURS: {"median": 0.0041}},
        "ratio": {BEFORE: 1.5, SDPA: 1.0, FFT: 1.25},
    }
    header, _, row, *_ = shown("attention", attention=figures({"results": [each]}))
    assert header.endswith(f"| {BEFORE} | {SDPA} | {FFT} |")
    assert row == "| `tiny`, inference, 1 thread | 4.1 | 1.50 | 1.00 | 1.25 |"


def test_views_are_shares_of_the_last():
    latencies = {"1 1": {"p50": 1.0}, "1 4": {"p50": 2.0}, "2 1": {"p50": 3.0}, "2 4": {"p50": 4.0}}
    header, _, one, two, *_ = shown("views", views=figures({"latencies": latencies}))
    assert header.endswith("| 1 | 4 |")
    assert (one, two) == ("| 1 | 0.25 | 0.50 |", "| 2 | 0.75 | 1.00 |")


def test_stages_and_starts():
    names = ("decode", "preprocessing", "network", "post", "total")
    stages = {name: {"p50": 0.02} for name in names}
    files = {
        name: network(
            "torch",
            image_file_to_pose=[{"threads": 1, "latencies": {"torch": stages}}],
            cold_starts={"torch": {"seconds": 0.85, "peak_bytes": 154e6}},
        )
        for name in ("base", "soyuz")
    }
    assert shown("stages", **files)[3] == "| `base`, torch | 20 | 20 | 20 | 20 | 20 |"
    assert shown("starts", **files)[2] == "| torch | 0.85 | 154 |"
