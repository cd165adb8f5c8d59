"""The first look's heat map: places and distances there and back, and several peaks."""

import math

import pytest
import torch

from ffpose.config import PolarPoseConfig
from ffpose.models.heat_map import HeatMap

CONFIG = PolarPoseConfig(
    image_size=(96, 128), camera=(100.0, 110.0, 60.0, 50.0), first_stride=4, first_reduction=4
)
FX, FY, CX, CY = CONFIG.camera
ROWS, COLUMNS = CONFIG.heat_grid
MIDDLE = math.sqrt(8 * 42)


@pytest.fixture(scope="module")
def heat_map():
    torch.manual_seed(0)
    return HeatMap(CONFIG, 8)


def at_pixel(u, v, distance):
    ray = torch.tensor([(u - CX) / FX, (v - CY) / FY, 1.0])
    return ray / ray.norm() * distance


def peaks(*places):
    """Logits and distances whose labels are those of points, each of a weight; by hand."""
    p, distances = torch.full((ROWS, COLUMNS), 1e-9), torch.zeros(ROWS, COLUMNS)
    for u, v, distance, weight in places:
        column, row = u / 128 * COLUMNS - 0.5, v / 96 * ROWS - 0.5
        for i in (math.floor(row), math.floor(row) + 1):
            for j in (math.floor(column), math.floor(column) + 1):
                p[i, j] += weight * (1 - abs(row - i)) * (1 - abs(column - j))
                distances[i, j] = math.log(distance / MIDDLE)
    return p.log()[None], distances[None]


def test_sizes(heat_map):
    assert (ROWS, COLUMNS) == (12, 16)
    logits, distances = heat_map(torch.randn(3, 8, 6, 8))
    assert logits.shape == distances.shape == (3, 12, 16)


def test_a_peak_gives_its_place_within_a_cell_and_its_distance(heat_map):
    for u, v, distance in ((70.3, 33.1, 12.0), (20.0, 80.0, 40.0), (64.0, 48.0, 9.0)):
        logits, distances = peaks((u, v, distance, 1.0))
        found = heat_map.candidates(logits, distances, 1)
        torch.testing.assert_close(
            found.points[0, 0], at_pixel(u, v, distance), rtol=1e-4, atol=1e-3
        )
        assert found.log_mass.item() == pytest.approx(0, abs=1e-4)


def test_two_peaks_are_two_candidates_the_likelier_first(heat_map):
    one, two = (30.0, 20.0, 10.0, 0.3), (100.0, 70.0, 30.0, 0.7)
    found = heat_map.candidates(*peaks(one, two), 2)
    expected = torch.stack([at_pixel(*two[:3]), at_pixel(*one[:3])])
    torch.testing.assert_close(found.points[0], expected, rtol=1e-4, atol=1e-3)
    torch.testing.assert_close(found.log_mass[0].exp(), torch.tensor([0.7, 0.3]), atol=1e-4, rtol=0)


def test_a_second_candidate_of_one_peak_has_no_weight(heat_map):
    found = heat_map.candidates(*peaks((70.0, 30.0, 10.0, 1.0)), 2)
    assert found.log_mass[0, 1] < -12
    assert found.points.isfinite().all()


def test_a_second_candidate_is_finite_where_all_else_has_no_probability_in_float32(heat_map):
    logits = torch.full((1, ROWS, COLUMNS), -200.0)
    logits[0, 5, 5] = 200.0
    found = heat_map.candidates(logits, torch.zeros_like(logits), 2)
    assert found.points.isfinite().all()
    assert found.log_mass[0].tolist() == pytest.approx([0, math.log(1e-12)])


def test_distances_are_kept_near_those_of_training(heat_map):
    logits, _ = peaks((70.0, 30.0, 10.0, 1.0))
    for relative, distance in ((50.0, 84.0), (-50.0, 4.0)):
        found = heat_map.candidates(logits, torch.full_like(logits, relative), 1)
        assert found.points.norm().item() == pytest.approx(distance, rel=1e-5)


@pytest.mark.parametrize("place", [(70.3, 33.1), (3.0, 50.0), (127.0, 95.0), (-40.0, 50.0)])
def test_the_loss_is_least_at_the_label(heat_map, place):
    """The label by hand is the least: the entropy of four cells. Outside is at the border."""
    inside = (min(max(place[0], 4.0), 124.0), min(max(place[1], 4.0), 92.0))
    padded = peaks((*inside, 12.0, 1.0)) if 4 < inside[0] < 124 and 4 < inside[1] < 92 else None
    point = at_pixel(*place, 12.0)[None]
    logits = torch.zeros(1, ROWS, COLUMNS).requires_grad_()
    truth = torch.full((1, ROWS, COLUMNS), math.log(12 / MIDDLE))
    loss = heat_map.loss(logits, truth, point, 0.05)
    assert loss.item() == pytest.approx(math.log(ROWS * COLUMNS) / 10)
    (slope,) = torch.autograd.grad(loss, logits)
    label = 1 / (ROWS * COLUMNS) - 10 * slope[0]
    assert label.sum().item() == pytest.approx(1)
    columns, rows = (torch.arange(COLUMNS) + 0.5) * 8, (torch.arange(ROWS) + 0.5) * 8
    u, v = (label.sum(0) * columns).sum(), (label.sum(1) * rows).sum()
    torch.testing.assert_close(torch.stack([u, v]), torch.tensor(inside), rtol=1e-4, atol=1e-3)
    if padded is not None:
        torch.testing.assert_close(label, padded[0][0].exp(), atol=1e-5, rtol=0)


def test_an_error_of_the_distance_costs_hubers(heat_map):
    logits, distances = peaks((70.3, 33.1, 12.0, 1.0))
    point = at_pixel(70.3, 33.1, 12.0)[None]
    least = heat_map.loss(logits, distances, point, 0.05)
    wrong = heat_map.loss(logits, distances + 0.3, point, 0.05)
    assert (wrong - least).item() == pytest.approx(0.3 - 0.025, rel=1e-4)
