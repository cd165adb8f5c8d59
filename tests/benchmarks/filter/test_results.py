import pytest

from benchmarks.filter.cases import CHANNELS_FIRST, COMPILED, COPY, HALF, MATRICES, TORCH, Case
from benchmarks.filter.children import Opening, Setting
from benchmarks.filter.report import print_tables
from benchmarks.filter.results import (
    bring_together,
    gains_of_threads,
    group_means,
    half_over_single,
    operations,
    over_copy,
    overheads,
    traffic,
)
from benchmarks.filter.worker import Measurement
from benchmarks.machine import Peak, environment
from benchmarks.timing import Timing
from ffpose.bench.filter import OURS

GRID = (14, 14, 256)


def measured(case, allocator="default", **medians):
    timings = {name: Timing(median, median, median, 5, 1) for name, median in medians.items()}
    return Setting("avx2", allocator), Measurement(case, timings, 1e-7)


def of(size, ours, torch, batch=1, **more):
    case = Case("grid", size, batch, **more)
    return measured(case, **{OURS: ours, TORCH: torch})


def test_each_side_gets_the_allocator_that_suits_it():
    case = Case("grid", GRID, 1)
    (one,) = bring_together(
        [
            measured(case, **{OURS: 2.0, TORCH: 12.0}),
            measured(case, "kept", **{OURS: 3.0, TORCH: 9.0}),
        ]
    )
    assert one.best(OURS).median == 2.0
    assert one.best(TORCH).median == 9.0
    assert one.ratio() == 4.5
    assert one.default_ratio() == 6.0


def test_means_of_groups_and_the_worst_of_each():
    means = group_means(
        bring_together(
            [
                of(GRID, 1.0, 4.0),
                of((28, 28, 256), 1.0, 9.0),
                of(GRID, 1.0, 5.0, batch=8),
                of((10, 10, 96), 2.0, 3.0, batch=8),
                of((7, 7, 32), 1.0, 100.0),
            ]
        )
    )
    found = {mean.group: (mean.mean, mean.worst.ratio(), mean.worst.case.size) for mean in means}
    assert found == {
        "grid, batch 1": (pytest.approx(6.0), 4.0, GRID),
        "grid, batch 8 and 32": (pytest.approx(5.0), 5.0, GRID),
        "other sizes": (pytest.approx(1.5), 1.5, (10, 10, 96)),
    }


def test_means_over_the_layout_that_suits_torch_best():
    names = (OURS, TORCH, CHANNELS_FIRST)
    cases = [
        Case("grid", GRID, 1, contenders=names),
        Case("grid", (7, 7, 512), 1, contenders=names),
    ]
    (mean,) = group_means(
        bring_together(
            [
                measured(cases[0], **{OURS: 1.0, TORCH: 8.0, CHANNELS_FIRST: 2.0}),
                measured(cases[1], **{OURS: 1.0, TORCH: 8.0, CHANNELS_FIRST: 9.0}),
            ]
        )
    )
    assert (mean.mean, mean.best_layout_mean) == (pytest.approx(8.0), pytest.approx(4.0))
    assert mean.best_layout_worst.case == cases[0]


def test_the_column_of_a_rival_that_is_left_out_says_so(capsys):
    with_matrices = Case("grid", GRID, 1, contenders=(OURS, TORCH, MATRICES))
    together = bring_together([measured(with_matrices, **{OURS: 1.0, TORCH: 2.0, MATRICES: 3.0})])
    opening = Opening(Setting("avx2", "default"), environment(), (Peak(1, 1e9, 1e9),))
    print_tables([opening], together, [f"{COMPILED} is not measured: no compiler"])
    (row,) = [line for line in capsys.readouterr().out.splitlines() if "3.00" in line]
    assert "not measured" in row


def test_what_is_near_the_limit():
    case = Case("grid", GRID, 32, contenders=(OURS, TORCH, HALF, COPY))
    together = bring_together([measured(case, **{OURS: 3.0, TORCH: 9.0, HALF: 2.7, COPY: 2.0})])
    assert [value for _, value in over_copy(together)] == [pytest.approx(1.5)]
    assert [value for _, value in half_over_single(together)] == [pytest.approx(0.9)]


def test_two_threads_are_held_against_one_where_there_is_work():
    together = bring_together(
        [
            of(GRID, 300e-6, 1.0),
            of(GRID, 150e-6, 1.0, threads=2),
            of((7, 7, 512), 100e-6, 1.0),
            of((7, 7, 512), 90e-6, 1.0, threads=2),
        ]
    )
    gains = gains_of_threads(together)
    assert [(one.case.size, value) for one, value in gains] == [(GRID, pytest.approx(2.0))]


def test_overhead_is_what_does_not_grow_with_the_batch():
    small = (7, 7, 32)
    (overhead,) = overheads(
        bring_together([of(small, 5e-6, 50e-6), of(small, 37e-6, 1.0, batch=33)])
    )
    assert overhead.arithmetic == pytest.approx(1e-6)
    assert (overhead.call, overhead.torch_call) == (5e-6, 50e-6)


def test_operations_by_hand():
    # 16 points: a transform is 2.5 · 16 · 4 = 160; half spectrum 4 · 3 = 12 numbers.
    assert operations(Case("grid", (4, 4, 1), 1)) == 2 * 160 + 6 * 12
    assert operations(Case("grid", (4, 4, 5), 2)) == 10 * (2 * 160 + 6 * 12)
    assert operations(Case("tokens", (4, 4), 3, "forward+backward")) == 3 * (4 * 160 + 20 * 12)
    # 8 points: 2.5 · 8 · 3 = 60; half spectrum 5 numbers.
    assert operations(Case("sequence", (8, 2), 1)) == 2 * (2 * 60 + 6 * 5)


def test_traffic_by_hand():
    # x and y 2 · 4 · 4 · 3 floats each, weight 4 · 3 · 3 · 2 floats.
    assert traffic(Case("grid", (4, 4, 3), 2)) == 4 * (2 * 96 + 72)
    assert traffic(Case("grid", (4, 4, 3), 2, "forward+backward")) == 4 * (5 * 96 + 3 * 72)
    assert traffic(Case("sequence", (8, 2), 1)) == 4 * (2 * 16 + 5 * 2 * 2)
