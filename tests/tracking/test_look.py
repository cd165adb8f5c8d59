"""The single look where a track expects the object: that of the network, and unbiased."""

import numpy as np
import pytest
import torch
from PIL import Image

from benchmarks.look import measured
from ffpose.cli import main
from ffpose.geometry import Pose, PoseUncertainty
from ffpose.geometry.symmetry import IDENTITY
from ffpose.inference.load import load
from ffpose.models import build_network
from ffpose.models.second_look import placed
from ffpose.models.virtual_camera import pyramid, render_virtual
from ffpose.tracking import Settings, Tracker
from ffpose.tracking.follow import follow
from ffpose.tracking.frames import Frame
from polar_networks import build_polar

ONE_LOOK = {"looks": 1, "candidates": 1, "degrees_of_freedom": (5.0, 4.0)}


@pytest.fixture(scope="module")
def weights(tmp_path_factory):
    path = tmp_path_factory.mktemp("look") / "small.safetensors"
    build_polar(**ONE_LOOK).save_pretrained(path)
    return path


def picture():
    pixels = np.random.default_rng(0).integers(0, 256, (12, 16, 3), dtype=np.uint8)
    return Image.fromarray(pixels).resize((128, 96), Image.Resampling.BICUBIC)


def test_it_is_the_second_look_alone(weights):
    """Of the network's parts the view of the point counts: another frame with this view agrees."""
    estimator = load(weights, track=True, device="cpu", warm_up=0)
    network = estimator.session.model
    x = estimator.preprocess(picture())[None]
    point = np.array([[1.0, -0.5, 14.0]])
    got = estimator.run(x, point)
    where = torch.from_numpy(point.astype(np.float32))
    view = network.view_at(where)
    images = torch.from_numpy(x)
    with torch.inference_mode():
        crop = render_virtual(pyramid(images), view, where, network.intrinsics)
        output = network.decode(network.encode(crop, view.tan_half_angle))
        wanted = network._pose(placed(output, view))
    np.testing.assert_allclose(got["in_view"], wanted.in_view, atol=1e-6)
    np.testing.assert_allclose(got["orientation"], wanted.orientation, atol=1e-5)
    assert np.linalg.norm(got["translation"] - estimator.run(x)["translation"]) > 1e-3


def test_points_that_are_none(weights):
    estimator = load(weights, track=True, device="cpu", warm_up=0)
    x = estimator.preprocess(picture())[None]
    for points in (np.zeros((2, 3)), np.full((1, 3), np.nan)):
        with pytest.raises(ValueError, match=r"points: expected finite numbers of shape \(1, 3\)"):
            estimator.run(x, points)
    for point in ([0, 0, 0], [1, 2, 0], [0, 0, -5], [0, 0, 1e-30], [0, 0, 1e-60], [1, 0, 1e30]):
        points = np.array([[0.0, 0.0, 9.0], point])
        with pytest.raises(ValueError, match=r"points: expected in front of the camera, .* got \["):
            estimator.run(np.concatenate([x, x]), points)
    with pytest.raises(ValueError, match=r"points: expected an estimator of ffpose.load"):
        load(weights, device="cpu", warm_up=0).run(x, np.ones((1, 3)))


def test_other_networks_have_no_single_look(tmp_path, capsys):
    path = tmp_path / "frame.safetensors"
    build_network("tiny", backbone_weights="none").save_pretrained(path)
    assert load(path, track=True, device="cpu", warm_up=0).near is None
    out = str(tmp_path / "frame.onnx")
    assert main(["export", str(path), "--out", out, "--track"]) == 2
    assert "track: expected weights of a PolarPose" in capsys.readouterr().err


def test_a_track_looks_where_the_object_is_expected(tmp_path):
    """While frames correct it; after one that does not, the whole frame is searched."""
    points = []

    class Estimator:
        class metadata:
            locates, config = "object", None
            symmetry = IDENTITY

        near, camera, white = True, None, None

        def preprocess(self, path):
            return np.full((3, 1, 1), float(path.stem), np.float32)

        def estimate(self, inputs, where=None):
            points.append(None if where is None else where[0])
            frame = inputs[0, 0, 0, 0]
            in_view = 0.0 if frame == 6 else 1.0
            sure = PoseUncertainty(1e-4 * np.eye(3), 1e-4 * np.eye(3), in_view, 0.5)
            return [Pose([0, 0, 20 - 0.1 * frame], [1, 0, 0, 0], sure)]

    frames = [Frame(tmp_path / f"{number}.png", number, None) for number in range(10)]
    list(follow(Estimator(), frames, Tracker(Settings(agreeing=2))))
    assert [point is None for point in points] == [n in (0, 1, 7) for n in range(10)]
    np.testing.assert_allclose(points[5], [0, 0, 19.5], atol=0.05)


def test_a_pose_that_a_tracker_cannot_take_is_coasted_over(tmp_path):
    """float32 rounds a covariance of condition 1e9 to one without an inverse."""
    turn = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
    thin = (turn @ np.diag([1e4, 1e-5, 1e-5]) @ turn.T).astype(np.float32).astype(float)
    assert np.linalg.eigvalsh(thin)[0] < 0

    class Estimator:
        class metadata:
            locates, config = "object", None
            symmetry = IDENTITY

        near = camera = white = None

        def preprocess(self, path):
            return np.full((3, 1, 1), float(path.stem), np.float32)

        def estimate(self, inputs, where=None):
            translation = thin if inputs[0, 0, 0, 0] == 6 else 1e-4 * np.eye(3)
            sure = PoseUncertainty(translation, 1e-4 * np.eye(3), 1, 0.5)
            return [Pose([0, 0, 20], [1, 0, 0, 0], sure)]

    frames = [Frame(tmp_path / f"{number}.png", number, None) for number in range(10)]
    followed = list(follow(Estimator(), frames, Tracker(Settings(agreeing=2))))
    *_, before, failed, after = followed[:8]
    assert before.step.outcome == after.step.outcome == "accepted"
    assert (failed.step.outcome, failed.step.time, failed.alone) == ("coasted", 6, None)
    assert failed.reason == "position_covariance: expected a positive definite matrix"
    again = follow(Estimator(), [*frames, frames[3]], Tracker(Settings(agreeing=2)))
    with pytest.raises(ValueError, match="time: expected later than 9"):
        list(again)


@pytest.mark.slow
def test_the_measured_offset_follows_the_true_one():
    """Displaced by one and two standard deviations along each axis, on images of its kind."""
    pytest.importorskip("embreex")
    estimator = load("soyuz", track=True, device="cpu", threads=1, warm_up=0)
    assert abs(measured(estimator, "soyuz_hard", images=60)["all"] - 1) <= 0.05
