"""The objective of a second look: each term by hand, and which samples and weights it counts."""

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from ffpose.geometry.symmetry import Axis, SymmetryGroup
from ffpose.models.second_look import SecondLookOutput
from ffpose.nn.orientation import QuaternionHead
from ffpose.training.config import ObjectLossConfig
from ffpose.training.object_objective import ObjectObjective, heatmap_loss
from ffpose.training.patches import PatchBatch

COUNT, CHANNELS, GRID, KEYPOINTS = 5, 3, (2, 3), 7
NONE = ObjectLossConfig(**dict.fromkeys(vars(ObjectLossConfig()), 0.0))


@pytest.fixture(autouse=True)
def _seed():
    torch.manual_seed(0)


@pytest.fixture
def batch():
    """Five samples, of which the first shows nothing; two have a frame."""
    coordinates = torch.rand(COUNT, 4, 2 * GRID[0], 2 * GRID[1]) * 2 - 1
    coordinates[:, 3] = (coordinates[:, 3] > 0).float()
    return PatchBatch(
        frames=torch.zeros(2, 3, 4, 4),
        translation=torch.randn(2, 3),
        crops=torch.zeros(COUNT, 3, 4, 4),
        tan_half_angle=torch.ones(COUNT),
        orientation=torch.nn.functional.normalize(torch.randn(COUNT, 4), dim=1),
        offset=torch.randn(COUNT, 3),
        coordinates=coordinates,
        keypoints=torch.rand(COUNT, KEYPOINTS, 2) * 1.6 - 0.3,
        present=torch.arange(COUNT) > 0,
        index=torch.arange(COUNT),
    )


class Answers:
    """Stands for a network: gives what it was told to."""

    def __init__(self, batch):
        self.object_backbone = SimpleNamespace(channels=(CHANNELS,))
        self.config = SimpleNamespace(object_grid=GRID)
        self.orientation = QuaternionHead()
        self.first = torch.zeros(())
        self.feature_map = torch.randn(COUNT, CHANNELS, *GRID)
        self.numbers = SecondLookOutput(
            orientation=batch.orientation.clone().requires_grad_(),
            offset=batch.offset.clone().requires_grad_(),
            log_sigma=torch.zeros(COUNT, 6).requires_grad_(),
            in_view=torch.zeros(COUNT).requires_grad_(),
            shear=torch.zeros(COUNT, 4),
        )

    def first_loss(self, frames, translation):
        assert len(frames) == len(translation)
        return self.first

    def encode(self, crops, tan_half_angle):
        return self.feature_map

    def decode(self, feature_map):
        return self.numbers


def loss(answers, batch, **weights):
    return ObjectObjective(answers, replace(NONE, **weights))(answers, batch)


def test_the_truth_costs_nothing_but_its_uncertainty(batch):
    answers = Answers(batch)
    terms = loss(answers, batch, location=1, offset=1, orientation=1)
    assert [float(each.detach()) for each in terms] == pytest.approx([0, 0, 0], abs=1e-6)
    doubt = loss(answers, batch, sigma=1, in_view=1).total  # sigma is one: its log, and coins
    assert doubt.item() == pytest.approx(math.log(2), abs=1e-6)


def huber(error):
    """By hand, per Huber's formula with the quadratic below 0.05."""
    error = np.abs(np.asarray(error, np.float64))
    return np.where(error < 0.05, error**2 / 0.1, error - 0.025).mean()


def test_position_terms_by_hand(batch):
    answers = Answers(batch)
    answers.first = torch.tensor(1.5)
    with torch.no_grad():
        answers.numbers.offset.add_(torch.tensor([0.02, -1.0, 0.3]))
    assert loss(answers, batch, location=7).total.item() == pytest.approx(7 * 1.5)
    assert loss(answers, batch, offset=3).total.item() == pytest.approx(
        3 * huber([0.02, 1, 0.3]), rel=1e-4
    )


def test_likelihood_by_hand(batch):
    """Both errors as t distributed; the rotation's as SciPy's vector in the virtual frame."""
    answers = Answers(batch)
    truth = Rotation.from_quat(batch.orientation.numpy().astype(np.float64), scalar_first=True)
    vectors = np.random.default_rng(0).normal(size=(COUNT, 3))
    wrong = (Rotation.from_rotvec(-vectors) * truth).as_quat(scalar_first=True)  # true = exp(r) R
    with torch.no_grad():
        answers.numbers.orientation.copy_(torch.from_numpy(wrong))
        answers.numbers.offset.sub_(torch.tensor([0.1, 0.2, 0.3]))
        answers.numbers.log_sigma.normal_()
    log_sigma = answers.numbers.log_sigma.detach().numpy().astype(np.float64)
    residual = np.concatenate([np.tile([0.1, 0.2, 0.3], (COUNT, 1)), vectors], axis=1)
    far = ((residual / np.exp(log_sigma)) ** 2).reshape(COUNT, 2, 3).sum(-1)
    expected = (3.5 * np.log1p(far / 4).sum(-1) + log_sigma.sum(-1))[1:].mean() / 6
    assert loss(answers, batch, sigma=2).total.item() == pytest.approx(2 * expected, rel=1e-4)


def test_a_symmetric_attitude_is_no_error(batch):
    """Half a turn about z is the same look; what is beyond it counts, by hand."""
    answers, half = Answers(batch), Rotation.from_rotvec((0, 0, np.pi))
    truth = Rotation.from_quat(batch.orientation.numpy().astype(np.float64), scalar_first=True)
    wrong = truth * half * Rotation.from_rotvec((0.2, 0, 0))
    with torch.no_grad():
        q = torch.from_numpy(wrong.as_quat(scalar_first=True)).float()
        answers.numbers.orientation.copy_(q)
    group = SymmetryGroup((Axis((0, 0, 1), 2),))
    objective = ObjectObjective(answers, replace(NONE, angle=1.0), symmetry=group)
    assert objective(answers, batch).total.item() == pytest.approx(np.sin(0.1), abs=1e-4)
    plain = ObjectObjective(answers, replace(NONE, angle=1.0))
    assert plain(answers, batch).total.item() > 0.9
    assert "rotations" not in objective.state_dict()


def test_likelihood_teaches_the_sigmas_alone(batch):
    """What is wrong is told by the other terms; a large error must not pull harder for it."""
    answers = Answers(batch)
    with torch.no_grad():
        answers.numbers.offset.add_(2)
    loss(answers, batch, sigma=1).total.backward()
    assert answers.numbers.log_sigma.grad[1:].abs().min() > 0
    for name in ("offset", "orientation"):
        grad = getattr(answers.numbers, name).grad
        assert grad is None or not grad.any()


def test_presence_counts_every_sample(batch):
    answers = Answers(batch)
    with torch.no_grad():
        answers.numbers.in_view.copy_(torch.tensor([2.0, -1.0, 0.0, 1.0, 3.0]))
    p = 1 / (1 + np.exp(-np.array([2.0, -1.0, 0.0, 1.0, 3.0])))
    expected = -np.mean([np.log(1 - p[0]), *np.log(p[1:])])
    assert loss(answers, batch, in_view=4).total.item() == pytest.approx(4 * expected, rel=1e-5)


def zeros(layer):
    torch.nn.init.zeros_(layer.weight)
    torch.nn.init.zeros_(layer.bias)
    return layer


def test_dense_terms_by_hand(batch):
    """A convolution of zeros says coordinate 0 and an even chance everywhere."""
    answers = Answers(batch)
    truth = batch.coordinates[1:].numpy().astype(np.float64)
    mask = truth[:, 3]
    expected = {
        "coordinates": (np.abs(truth[:, :3]) * mask[:, None]).sum() / (3 * mask.sum() + 1),
        "mask": math.log(2),
    }
    for name, value in expected.items():
        objective = ObjectObjective(answers, replace(NONE, **{name: 2.0}))
        zeros(objective.dense["coordinates"])
        assert objective(answers, batch).total.item() == pytest.approx(2 * value, rel=1e-5)


def test_dense_places_are_quarters_of_their_cell(batch):
    """The mask's logits are the features of the quarters' own channels, four a cell."""
    answers = Answers(batch)
    objective = ObjectObjective(answers, replace(NONE, mask=1.0))
    assert objective.cells == (2 * GRID[0], 2 * GRID[1])
    last = zeros(objective.dense["coordinates"])
    with torch.no_grad():
        last.bias[12:].copy_(torch.tensor([50.0, -50.0, -50.0, 50.0]))
    quarters = torch.tensor([[1.0, 0.0], [0.0, 1.0]]).repeat(*GRID)  # rows of each cell
    coordinates = batch.coordinates.clone()
    coordinates[:, 3] = quarters
    right = batch._replace(coordinates=coordinates)
    assert objective(answers, right).total.item() == pytest.approx(0, abs=1e-6)
    coordinates = coordinates.clone()
    coordinates[:, 3] = 1 - quarters
    wrong = batch._replace(coordinates=coordinates)
    assert objective(answers, wrong).total.item() == pytest.approx(50)


def test_heatmaps_that_know_nothing_cost_the_logarithm_of_their_cells(batch):
    objective = ObjectObjective(Answers(batch), replace(NONE, keypoints=3.0), KEYPOINTS)
    zeros(objective.dense["heatmaps"])
    cells = 4 * GRID[0] * GRID[1]
    total = objective(Answers(batch), batch).total.item()
    assert total == pytest.approx(3 * math.log(cells), rel=1e-5)


def test_heatmaps_are_numpys_cross_entropy_of_what_the_view_shows():
    """The label is what interpolation linear along both sides gives each cell's center.

    The last column is beside the first.
    """
    generator = np.random.default_rng(0)
    rows, columns = 4, 6
    logits = generator.normal(size=(COUNT, KEYPOINTS, rows, columns))
    places = generator.uniform(-0.3, 1.3, (COUNT, KEYPOINTS, 2))
    shown = ((places > 0) & (places < 1)).all(-1)
    assert 0 < shown.sum() < shown.size
    expected = []
    for image, point in zip(*np.nonzero(shown), strict=True):
        u, v = places[image, point] * (columns, rows)
        v = np.clip(v, 0.5, rows - 0.5)
        away = (np.arange(columns) + 0.5 - u + columns / 2) % columns - columns / 2
        across = np.clip(1 - np.abs(away), 0, None)
        down = np.clip(1 - np.abs(np.arange(rows) + 0.5 - v), 0, None)
        label = down[:, None] * across
        assert label.sum() == pytest.approx(1)
        map_ = logits[image, point]
        expected.append(-(label * (map_ - np.log(np.exp(map_).sum()))).sum())
    got = heatmap_loss(torch.from_numpy(logits), torch.from_numpy(places))
    assert got.item() == pytest.approx(np.mean(expected), rel=1e-12)


def test_a_keypoint_on_the_seam_of_a_polar_view_is_shared_by_both_sides():
    """Angles are cyclic: a place in the middle of the seam is half in the last column."""
    logits = torch.randn(1, 1, 4, 6, dtype=torch.float64)
    log_p = logits.flatten().log_softmax(0).unflatten(0, (4, 6))
    for place, first in ((1e-12, 0.5), (0.25 / 6, 0.75), (1 - 0.25 / 6, 0.25)):
        got = heatmap_loss(logits, torch.tensor([[[place, 0.375]]]).double())
        expected = -(first * log_p[1, 0] + (1 - first) * log_p[1, 5])
        torch.testing.assert_close(got, expected)


def test_keypoints_out_of_the_view_teach_nothing():
    logits = torch.randn(2, KEYPOINTS, 4, 6, requires_grad=True)
    loss = heatmap_loss(logits, torch.full((2, KEYPOINTS, 2), -1.0))
    loss.backward()
    assert loss.item() == 0
    assert not logits.grad.any()


def test_samples_without_the_object_teach_only_that(batch):
    weights = vars(ObjectLossConfig(keypoints=1.0))
    answers = Answers(batch)
    objective = ObjectObjective(answers, ObjectLossConfig(**weights), KEYPOINTS)
    expected = objective(answers, batch).total
    other = {
        name: torch.cat((torch.randn_like(getattr(batch, name)[:1]), getattr(batch, name)[1:]))
        for name in ("orientation", "offset", "coordinates", "keypoints")
    }
    torch.testing.assert_close(objective(answers, batch._replace(**other)).total, expected)
    other = {name: value.flip(0) for name, value in other.items()}
    changed = objective(answers, batch._replace(**other)).total
    assert (changed - expected).abs() > 0.1


def test_without_dense_weights_there_is_no_convolution(batch):
    objective = ObjectObjective(Answers(batch), replace(NONE, offset=1.0))
    assert not list(objective.parameters())


def test_half_precision_is_the_networks_alone(batch):
    answers = Answers(batch)
    answers.numbers = SecondLookOutput(*map(torch.randn_like, answers.numbers))
    objective = ObjectObjective(answers, ObjectLossConfig(keypoints=1.0), KEYPOINTS)
    answers.feature_map = answers.feature_map.bfloat16()
    answers.numbers = SecondLookOutput(*(number.bfloat16() for number in answers.numbers))
    with torch.autocast("cpu", torch.bfloat16):
        got = objective(answers, batch).total
    answers.feature_map = answers.feature_map.float()
    answers.numbers = SecondLookOutput(*(number.float() for number in answers.numbers))
    torch.testing.assert_close(got, objective(answers, batch).total, rtol=1e-6, atol=0)


@pytest.mark.parametrize("value", [-1.0, float("nan")])
def test_refused_weights(value):
    with pytest.raises(ValueError, match=f"sigma: expected 0 or more, got {value}"):
        ObjectLossConfig(sigma=value)
