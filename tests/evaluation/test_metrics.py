"""Pose errors against SciPy, numbers worked out by hand, and the accumulated against the whole."""

import math

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from ffpose.evaluation.metrics import PoseError, pose_error

IDENTITY = torch.tensor([[1.0, 0.0, 0.0, 0.0]])


def batch(count=8, seed=0, dtype=torch.float64):
    rng = np.random.default_rng(seed)
    t = rng.normal(loc=[0, 0, 20], size=(count, 3))
    t_hat = t + rng.normal(size=(count, 3))
    q, q_hat = (Rotation.random(count, rng=rng).as_quat(scalar_first=True) for _ in range(2))
    return tuple(torch.from_numpy(array).to(dtype) for array in (t_hat, q_hat, t, q))


def turned_by(degrees):
    half = math.radians(degrees) / 2
    return torch.tensor([[math.cos(half), 0.0, math.sin(half), 0.0]], dtype=torch.float64)


def test_errors_are_scipys():
    t_hat, q_hat, t, q = (tensor.numpy() for tensor in batch(50))
    errors = pose_error(*map(torch.from_numpy, (t_hat, q_hat, t, q)))
    true, predicted = (Rotation.from_quat(a, scalar_first=True) for a in (q, q_hat))
    angle = (true.inv() * predicted).magnitude()
    distance = np.linalg.norm(t - t_hat, axis=1)
    np.testing.assert_allclose(errors.translation_m, distance)
    np.testing.assert_allclose(errors.rotation_deg, np.degrees(angle))
    np.testing.assert_allclose(errors.esa_score, distance / np.linalg.norm(t, axis=1) + angle)


def test_one_sample_by_hand():
    t = torch.tensor([[0.0, 0.0, 10.0]], dtype=torch.float64)
    t_hat = torch.tensor([[3.0, 4.0, 10.0]], dtype=torch.float64)
    errors = pose_error(t_hat, turned_by(90), t, IDENTITY.double())
    assert float(errors.translation_m) == pytest.approx(5)
    assert float(errors.rotation_deg) == pytest.approx(90)
    assert float(errors.esa_score) == pytest.approx(0.5 + math.pi / 2)
    assert float(errors.speed_plus_score) == pytest.approx(0.5 + math.pi / 2)


@pytest.mark.parametrize(
    ("offset", "degrees", "score"),
    [
        (0.0217, 0.168, 0.0),  # 0.00217 of 10 m and 0.168 degrees: below both limits
        (0.0218, 0.168, 0.00218),
        (0.0217, 0.170, math.radians(0.170)),
        (0.0218, 0.170, 0.00218 + math.radians(0.170)),
    ],
)
def test_the_speed_plus_score_drops_each_part_by_itself(offset, degrees, score):
    t = torch.tensor([[0.0, 0.0, 10.0]], dtype=torch.float64)
    t_hat = t + torch.tensor([[offset, 0.0, 0.0]], dtype=torch.float64)
    errors = pose_error(t_hat, turned_by(degrees), t, IDENTITY.double())
    assert float(errors.speed_plus_score) == pytest.approx(score, abs=1e-12)


def test_the_parts_are_those_about_the_true_viewing_ray():
    """By hand: 90 degrees about y, seen along y, is a turn in the plane of the image."""
    along, across = torch.tensor([[0.0, 9.0, 0.0]]), torch.tensor([[0.0, 0.0, 9.0]])
    for t, in_plane, out_of_plane in ((along, 90, 0), (across, 0, 90)):
        elsewhere = t + torch.tensor([[5.0, 0.0, 0.0]])  # the predicted ray does not count
        errors = pose_error(elsewhere, turned_by(90), t, IDENTITY)
        assert float(errors.in_plane_deg) == pytest.approx(in_plane)
        assert float(errors.out_of_plane_deg) == pytest.approx(out_of_plane)
        assert float(errors.relative_translation) == pytest.approx(5 / 9)


def test_a_camera_at_the_origin_of_its_world_has_the_errors_that_need_no_ray():
    metric = PoseError("camera")
    metric.update(torch.tensor([[3.0, 4.0, 0.0]]), turned_by(90), torch.zeros(1, 3), IDENTITY)
    assert {name: float(value) for name, value in metric.compute().items()} == pytest.approx(
        {
            "mean_translation_error_m": 5,
            "median_translation_error_m": 5,
            "mean_rotation_error_deg": 90,
            "median_rotation_error_deg": 90,
        }
    )
    with pytest.raises(ValueError, match="above zero"):
        PoseError().update(torch.zeros(1, 3), IDENTITY, torch.zeros(1, 3), IDENTITY)


def test_both_signs_are_one_pose():
    t_hat, q_hat, t, q = batch()
    both = pose_error(t_hat, q_hat, t, q), pose_error(t_hat, -q_hat, t, q)
    for one, other in zip(*both, strict=True):
        torch.testing.assert_close(one, other)


def test_tiny_angles_do_not_vanish_in_float32():
    q_hat = turned_by(1e-4).float()
    errors = pose_error(torch.ones(1, 3), q_hat, torch.ones(1, 3), IDENTITY)
    assert float(errors.rotation_deg) == pytest.approx(1e-4, rel=1e-3)


def test_means_and_medians():
    metric = PoseError()
    t = torch.tensor([[0.0, 0.0, 10.0]] * 4)
    t_hat = t + torch.tensor([[1.0, 0, 0], [2.0, 0, 0], [4.0, 0, 0], [9.0, 0, 0]])
    q_hat = torch.cat([turned_by(angle) for angle in (10, 20, 30, 80)])
    metric.update(t_hat, q_hat, t, IDENTITY.repeat(4, 1))
    values = {name: float(value) for name, value in metric.compute().items()}
    scores = 0.4 + math.radians(35)
    assert values == pytest.approx(
        {
            "mean_translation_error_m": 4,
            "median_translation_error_m": 3,
            "mean_relative_translation_error": 0.4,
            "median_relative_translation_error": 0.3,
            "mean_rotation_error_deg": 35,
            "median_rotation_error_deg": 25,
            "mean_in_plane_error_deg": 0,  # the turns are about y, the viewing ray is z
            "median_in_plane_error_deg": 0,
            "mean_out_of_plane_error_deg": 35,
            "median_out_of_plane_error_deg": 25,
            "esa_score": scores,
            "speed_plus_score": scores,
        }
    )


def test_batches_add_up_to_the_whole():
    tensors = batch(10)
    whole, parts = PoseError(), PoseError()
    whole.update(*tensors)
    for part in zip(*(tensor.split([1, 4, 5]) for tensor in tensors), strict=True):
        parts.update(*part)
    assert whole.compute() == parts.compute()
    parts.reset()
    parts.update(*tensors)
    assert whole.compute() == parts.compute()


def test_processes_add_up_to_the_whole():
    tensors = batch(10)
    here, there = (tuple(t[part] for t in tensors) for part in (slice(3), slice(3, None)))
    other = PoseError()
    other.update(*there)
    remote = iter([torch.cat(getattr(other, name)) for name in other._defaults])
    metric = PoseError(
        dist_sync_fn=lambda state, group: [state, next(remote)],
        distributed_available_fn=lambda: True,
    )
    metric.update(*here)
    whole = PoseError()
    whole.update(*tensors)
    torch.testing.assert_close(metric.compute(), whole.compute())


@pytest.mark.filterwarnings("ignore:The ``compute`` method")
def test_a_process_without_samples_adds_none():
    tensors, sent = batch(3), []
    other = PoseError()
    other.update(*tensors)
    remote = iter([torch.cat(getattr(other, name)) for name in other._defaults])

    def gather(state, group):
        sent.append(state.dtype)  # torch gathers tensors of one dtype alone
        return [state, next(remote)]

    empty = PoseError(dist_sync_fn=gather, distributed_available_fn=lambda: True)
    assert empty.compute() == other.compute()
    assert set(sent) == {torch.float64}


def test_half_precision_is_read_exactly():
    tensors = batch(dtype=torch.bfloat16)
    exact = pose_error(*(tensor.double() for tensor in tensors))
    for one, other in zip(pose_error(*tensors), exact, strict=True):
        assert torch.equal(one, other)


def test_no_samples_have_no_mean():
    metric = PoseError()
    metric.update(*(tensor[:0] for tensor in batch()))
    with pytest.raises(ValueError, match="at least one sample"):
        metric.compute()


@pytest.mark.parametrize(("place", "name"), list(enumerate(["t_hat", "q_hat", "t", "q"])))
@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_what_is_not_finite_is_an_error_not_a_figure(place, name, value):
    tensors = batch()
    tensors[place][3, 1] = value
    metric = PoseError()
    with pytest.raises(ValueError, match=f"^{name} must be finite, got .* in row 3"):
        metric.update(*tensors)


def test_a_zero_quaternion_has_no_angle():
    tensors = batch()
    tensors[1][2] = 0
    with pytest.raises(ValueError, match=r"^q_hat must have a norm above zero.* in row 2"):
        pose_error(*tensors)


@pytest.mark.parametrize("place", range(4))
def test_shapes_are_not_broadcast(place):
    tensors = list(batch())
    tensors[place] = tensors[place][:1]
    with pytest.raises(ValueError, match=r"must have shape \(\d, \d\), got"):
        pose_error(*tensors)


def test_integers_are_no_poses():
    t_hat, q_hat, t, q = batch()
    with pytest.raises(TypeError, match=r"t: expected a floating dtype, got torch\.int64"):
        pose_error(t_hat, q_hat, t.long(), q)


def test_arrays_are_no_tensors():
    t_hat, q_hat, t, q = batch()
    with pytest.raises(TypeError, match=r"q: expected a torch\.Tensor, got ndarray"):
        pose_error(t_hat, q_hat, t, q.numpy())
