import pytest

from ffpose.bench.filter.cases import Case
from ffpose.bench.filter.figures import geometric_mean, operations, traffic


def test_geometric_mean_by_hand():
    assert geometric_mean([1.0, 2.0, 4.0]) == pytest.approx(2.0)
    assert geometric_mean([3.0, 12.0]) == pytest.approx(6.0)


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
