"""FilterformerPose with a second look: shapes, frames, bad first looks, gradients, graphs."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from ffpose.models import CONFIGS, FilterformerPose, PosePrediction, load_network
from ffpose.models.base import UncertainPose
from ffpose.models.second_look import OFFSET_LIMIT, SecondLookOutput
from ffpose.training.config import ObjectLossConfig
from ffpose.training.object_objective import ObjectObjective
from ffpose.training.patches import PatchBatch

FIELDS = {
    "image_size": (48, 64),
    "camera": (60.0, 62.0, 33.0, 23.0),
    "backbone": "compact_resnet_narrow",
    "translation_reduction": 8,
    "orientation_reduction": 8,
    "dim": 16,
    "depth": 1,
    "heads": 2,
    "feed_forward": 16,
    "head_hidden": 16,
    "translation_mlp_dim": 8,
    "orientation_mlp_dim": 8,
    "orientation_view": "object",
    "orientation_head": "bins",
    "bins": 300,
    "bins_degree": 2,
    "object_backbone": "compact_resnet_narrow",
    "object_size": (16, 24),
    "object_radius_m": 5.0,
    "first_stride": 2,
}
HEADS = ("quaternion", "6d", "bins")


@pytest.fixture(autouse=True)
def _seed():
    torch.manual_seed(0)


def build(**fields):
    return FilterformerPose.from_config("tiny", backbone_weights="none", **(FIELDS | fields))


@pytest.fixture(scope="module")
def model():
    torch.manual_seed(0)
    return build().eval()


def assert_a_whole_pose(pose, count):
    shapes = [tuple(each.shape) for each in pose]
    several = [(count, 3), (count, 4), (count, 3, 3), (count, 3, 3), (count,)]
    assert shapes == [*several, (count, 4), (count, 2)]
    assert all(each.isfinite().all() for each in pose)
    assert (pose.translation[:, 2] > 0).all()
    torch.testing.assert_close(pose.orientation.norm(dim=1), torch.ones(count))
    for covariance in (pose.translation_covariance, pose.rotation_covariance):
        torch.testing.assert_close(covariance, covariance.mT)
        assert (torch.linalg.eigvalsh(covariance.double()) > 0).all()
    assert ((pose.in_view >= 0) & (pose.in_view <= 1)).all()


@pytest.mark.parametrize(
    "fields",
    [
        *({"orientation_head": head} for head in HEADS),
        {"pooling": "flatten", "depth": 0},
        {"pooling": "flatten", "orientation_head": "6d"},
        {"pooling": "mean", "looks": 1, "filter": "tokens", "doubt_sigma": (9.0, 9.0)},
        {"first_stride": 1, "image_size": (50, 70), "object_size": (17, 30)},
    ],
)
def test_every_reading_poses(fields):
    model = build(**fields).eval()
    with torch.no_grad():
        pose = model(torch.randn(2, 3, *model.config.image_size))
    assert isinstance(pose, UncertainPose)
    assert_a_whole_pose(pose, 2)


def test_pictures_of_nothing(model):
    black, white = torch.full((2, 3, 48, 64), -2.0), torch.full((2, 3, 48, 64), 2.0)
    for images in (black, white, 100 * torch.randn(3, 3, 48, 64), torch.zeros(0, 3, 48, 64)):
        with torch.no_grad():
            assert_a_whole_pose(model(images), len(images))


def test_images_do_not_mix(model):
    images = torch.randn(3, 3, 48, 64)
    together = model(images)
    for got, expected in zip(model(images[1:2]), together, strict=True):
        torch.testing.assert_close(got, expected[1:2], rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("head", HEADS)
def test_the_frame_view_takes_every_head(head):
    fields = {"orientation_view": "frame", "camera": None, "orientation_head": head}
    model = build(**fields).eval()
    assert model.object_backbone is None
    pose = model(torch.randn(2, 3, 48, 64))
    assert isinstance(pose, PosePrediction)
    assert (pose.translation.shape, pose.orientation.shape) == ((2, 3), (2, 4))
    torch.testing.assert_close(pose.orientation.norm(dim=1), torch.ones(2))
    if head != "bins":  # regression begins about no rotation
        assert (pose.orientation[:, 0].abs() > 0.7).all()


def fixed(model, first, second, monkeypatch):
    """Let both looks of a network give these numbers, whatever they see."""
    monkeypatch.setattr(model, "locate", lambda frames: first)
    monkeypatch.setattr(model, "decode", lambda feature_map: second)
    return model(torch.zeros(len(first), 3, 48, 64))


def numbers(model, count, offset=(0.0, 0.0, 0.0), log_sigma=(0.0,) * 6):
    """Return equal outputs of the second look for each image."""
    return SecondLookOutput(
        torch.randn(1, model.orientation.features).expand(count, -1),
        torch.tensor(offset).expand(count, 3),
        torch.tensor(log_sigma).expand(count, 6),
        torch.zeros(count),
    )


def least_rotations(rays):
    """SciPy's least rotations from the z axis to rays ``(N, 3)``."""
    rays = rays / np.linalg.norm(rays, axis=-1, keepdims=True)
    axis = np.cross([0, 0, 1], rays)
    sine = np.linalg.norm(axis, axis=-1, keepdims=True)
    return Rotation.from_rotvec(axis / sine * np.arctan2(sine, rays[:, 2:]))


def rotations(q):
    return Rotation.from_quat(q.detach().numpy().astype(np.float64), scalar_first=True)


def test_one_view_of_the_object_is_turned_with_the_camera(model, monkeypatch):
    """Equal outputs in five directions: position and attitude rotate with the viewing ray."""
    first = torch.tensor(
        [[0.1, 0.2, 0.0], [-0.5, 0.3, 0.1], [0.4, -0.3, 0.5], [-0.4, -0.3, -0.5], [0.01, 0.0, 0.0]]
    )
    second = numbers(model, 5, log_sigma=(-3.0, -2.0, -1.0, -3.0, -2.0, -1.0))
    pose = fixed(model, first, second, monkeypatch)
    t = pose.translation.numpy()
    np.testing.assert_allclose(t[:, :2] / t[:, 2:], first[:, :2], rtol=1e-5)
    middle = math.sqrt(8 * 42)  # of the default range of distances
    np.testing.assert_allclose(np.linalg.norm(t, axis=-1), middle * first[:, 2].exp(), rtol=1e-5)

    seen = rotations(model.orientation.decode(second.orientation))
    turn = least_rotations(t.astype(np.float64))
    assert ((turn * seen).inv() * rotations(pose.orientation)).magnitude().max() < 1e-5

    for covariance in (pose.translation_covariance, pose.rotation_covariance):
        alike = turn.inv().as_matrix() @ covariance.numpy() @ turn.as_matrix()
        distance = 1 if covariance is pose.rotation_covariance else np.linalg.norm(t, axis=-1)
        # Lateral sigmas count in parts of the view's five meters, the distance in its logarithm.
        in_view = alike / np.reshape(distance, (-1, 1, 1)) ** 2
        assert np.abs(in_view[:, ~np.eye(3, dtype=bool)]).max() < 1e-4 * in_view.max()
    variances = pose.rotation_covariance.diagonal(dim1=1, dim2=2).sum(-1)
    torch.testing.assert_close(
        variances, torch.full((5,), math.exp(-6) + math.exp(-4) + math.exp(-2))
    )


def test_the_offset_is_added_where_the_camera_was_turned(monkeypatch):
    model = build(looks=1).eval()
    first = torch.tensor([[0.2, -0.1, 0.1], [-0.3, 0.2, -0.2]])
    offset = (1.0, -0.5, 0.4)
    pose = fixed(model, first, numbers(model, 2, offset), monkeypatch)
    distance = math.sqrt(8 * 42) * np.exp(first[:, 2].numpy().astype(np.float64))
    # A quarter of the image's width is half its radius of five meters, at the distance.
    x, y = offset[0] / 2 * 5 / distance, offset[1] / 2 * 5 / distance
    ray = np.stack([x, y, np.ones(2)], axis=-1)
    ray *= (distance * np.exp(0.1) / np.linalg.norm(ray, axis=-1))[:, None]
    looked = np.concatenate([first[:, :2], np.ones((2, 1))], axis=1).astype(np.float64)
    expected = least_rotations(looked).apply(ray)
    np.testing.assert_allclose(pose.translation, expected, rtol=1e-5)


def test_the_second_turn_goes_to_what_the_first_found(monkeypatch):
    """Where the looks find no more offset, the object is in the middle and stays."""
    model = build(looks=3).eval()
    views = []
    answers = [numbers(model, 1, (1.0, 1.0, 0.5)), *2 * [numbers(model, 1)]]
    monkeypatch.setattr(model, "locate", lambda frames: torch.tensor([[0.2, 0.1, 0.0]]))
    monkeypatch.setattr(model, "encode", lambda seen: seen)
    monkeypatch.setattr(
        model, "decode", lambda seen: (views.append(seen), answers[len(views) - 1])[1]
    )
    model(torch.rand(1, 3, 48, 64))
    assert len(views) == 3
    torch.testing.assert_close(views[2], views[1], rtol=1e-4, atol=1e-4)
    assert (views[1] - views[0]).abs().max() > 0.01


def test_location_and_located_are_inverse(model):
    points = torch.tensor([[1.0, -2.0, 12.0], [-6.0, 3.0, 20.0], [0.0, 0.0, 41.0]])
    torch.testing.assert_close(model.located(model.location(points)), points)
    expected = torch.tensor([[1 / 12, -1 / 6, 0.5 * math.log(149 / 336)]])
    torch.testing.assert_close(model.location(points[:1]), expected)


WILD = [
    [1e30, 0.0, 0.0],
    [-1e30, 1e30, 0.0],
    [0.0, -1e30, 1e30],
    [0.1, 0.1, -1e30],
    [-50.0, -50.0, 50.0],
]


def test_a_first_look_out_of_the_frame_is_brought_to_its_border(model):
    points = model.located(torch.tensor(WILD))
    assert points.isfinite().all()
    fx, fy, cx, cy = FIELDS["camera"]
    u, v = points[:, 0] / points[:, 2] * fx + cx, points[:, 1] / points[:, 2] * fy + cy
    torch.testing.assert_close(u[:3], torch.tensor([64.0, 0.0, 33.0]), rtol=0, atol=1e-3)
    torch.testing.assert_close(v[:3], torch.tensor([23.0, 48.0, 0.0]), rtol=0, atol=1e-3)
    near, far = model.config.distance_m
    torch.testing.assert_close(points[2:4].norm(dim=1), torch.tensor([2 * far, near / 2]))


@pytest.mark.parametrize("second", [0.0, 1e30, -1e30, OFFSET_LIMIT])
def test_wild_looks_give_a_pose_in_front(model, monkeypatch, second):
    count = len(WILD)
    wild = numbers(model, count, (second, -second, second), (2.0,) * 6)
    assert_a_whole_pose(fixed(model, torch.tensor(WILD), wild, monkeypatch), count)


def test_numbers_beyond_their_limits_are_clamped(model):
    feature_map = model.encode(torch.randn(2, 3, 16, 24))
    small = model.orientation_branch.head.small
    with torch.no_grad():
        bias = small.bias.clone()
        small.bias.copy_(torch.full_like(bias, 1e9))
        high = model.decode(feature_map)
        small.bias.copy_(torch.full_like(bias, -1e9))
        low = model.decode(feature_map)
        small.bias.copy_(bias)
    assert torch.equal(high.log_sigma, torch.full((2, 6), 1.5))
    assert torch.equal(low.log_sigma, torch.full((2, 6), -6.0))


KEYPOINTS = 3


def random_batch(model, objective, count=4):
    config = model.config
    rows, columns = (side // config.first_stride for side in config.image_size)
    coordinates = torch.rand(count, 4, *objective.cells) * 2 - 1
    coordinates[:, 3] = (coordinates[:, 3] > 0).float()
    return PatchBatch(
        frames=torch.randn(2, 3, rows, columns),
        translation=torch.randn(2, 3) + torch.tensor([0.0, 0.0, 20.0]),
        crops=torch.randn(count, 3, *config.object_size),
        tan_half_angle=torch.rand(count),
        orientation=torch.nn.functional.normalize(torch.randn(count, 4), dim=1),
        offset=torch.randn(count, 3),
        coordinates=coordinates,
        keypoints=torch.rand(count, KEYPOINTS, 2),
        present=torch.arange(count) > 0,
        index=torch.arange(count),
    )


@pytest.mark.parametrize("fields", [{"orientation_head": head} for head in HEADS])
def test_the_objective_trains_every_weight(fields):
    model = build(**fields)
    objective = ObjectObjective(model, ObjectLossConfig(keypoints=1.0), KEYPOINTS)
    both = torch.nn.ModuleList([model, objective])
    before = {name: value.clone() for name, value in both.named_parameters()}
    optimizer = torch.optim.Adam(both.parameters(), 1e-3)
    for _ in range(3):  # blocks and generated layers start at zero, and open the way for others
        optimizer.zero_grad()
        objective(model, random_batch(model, objective)).total.backward()
        assert all(p.grad.isfinite().all() for p in both.parameters())
        optimizer.step()
    same = [name for name, value in both.named_parameters() if torch.equal(value, before[name])]
    assert not same


def test_weights_there_and_back(model, tmp_path):
    with torch.no_grad():
        model.variance_scales.copy_(torch.tensor([1.5, 2.5]))
    model.save_pretrained(tmp_path / "look.safetensors")
    loaded = FilterformerPose.from_pretrained(tmp_path / "look.safetensors")
    model.variance_scales.fill_(1)
    assert loaded.config == model.config
    images = torch.randn(2, 3, 48, 64)
    got, expected = loaded(images), model(images)
    for name in ("translation", "orientation", "in_view"):
        assert torch.equal(getattr(got, name), getattr(expected, name))
    torch.testing.assert_close(got.translation_covariance, 1.5 * expected.translation_covariance)
    torch.testing.assert_close(got.rotation_covariance, 2.5 * expected.rotation_covariance)


def test_weights_are_loaded_with_fewer_looks(model, tmp_path):
    """One look is one call of the second network at the first position."""
    path = tmp_path / "look.safetensors"
    model.save_pretrained(path)
    quick = FilterformerPose.from_pretrained(path, looks=1)
    assert quick.config == replace(model.config, looks=1)
    calls = []
    quick.object_backbone.register_forward_hook(lambda _, __, maps: calls.append(len(maps[0])))
    found = quick(torch.randn(2, 3, 48, 64))
    assert calls == [2]
    assert found.in_view.shape == (2,)


def test_what_weights_depend_on_is_not_changed_as_they_are_loaded(model, tmp_path):
    path = tmp_path / "look.safetensors"
    model.save_pretrained(path)
    message = r"expected fields that may change after training \(looks\), got look \(did"
    with pytest.raises(ValueError, match=message):
        FilterformerPose.from_pretrained(path, look=1)
    with pytest.raises(ValueError, match="looks: expected a whole number, at least 1, got 0"):
        FilterformerPose.from_pretrained(path, looks=0)
    once = FilterformerPose.from_config("tiny", backbone_weights="none", image_size=(64, 64))
    once.save_pretrained(path)
    with pytest.raises(ValueError, match=r"\(this network has none\), got looks"):
        load_network(path, looks=1)


def test_no_table_is_saved(model):
    assert not [name for name in model.state_dict() if name.startswith("orientation.")]
    assert not {"intrinsics", "translation_mean"} & set(model.state_dict())


@pytest.mark.slow
def test_an_exported_network_takes_batches_of_any_size():
    model = build(looks=1, translation_reduction=4, orientation_reduction=4).eval()
    shapes = ({0: torch.export.Dim("batch")},)
    images = torch.randn(2, 3, 48, 64)
    program = torch.export.export(model, (images,), dynamic_shapes=shapes).module()
    for count in (1, 2, 5):
        images = torch.randn(count, 3, 48, 64)
        got = program(images)
        assert isinstance(got, UncertainPose)
        for each, wanted in zip(got, model(images), strict=True):
            torch.testing.assert_close(each, wanted, rtol=1e-3, atol=1e-4)


@pytest.mark.parametrize(
    ("fields", "text"),
    [
        ({"camera": None}, "camera: the second look needs it, got None"),
        ({"camera": (1.0, 2.0)}, r"camera: expected 4 numbers, got \(1.0, 2.0\)"),
        ({"camera": (1.0, math.nan, 0.0, 0.0)}, "camera: expected finite numbers, got"),
        ({"camera": (0.0, 60.0, 32.0, 24.0)}, "camera: expected fx > 0 and fy > 0, got"),
        ({"first_stride": 5}, r"first_stride: .* divisor of image_size \(48, 64\), got 5"),
        ({"first_stride": 0}, "first_stride: expected a whole number, at least 1, got 0"),
        ({"depth": 0}, "depth: expected a whole number, at least 1, got 0"),
        ({"depth": -1, "pooling": "flatten"}, "depth: expected .* at least 0, got -1"),
        ({"distance_m": (20.0, 10.0)}, r"distance_m: expected 0 < near < far, got \(20.0, 10.0\)"),
        ({"distance_m": (0.0, 10.0)}, "distance_m: expected 0 < near"),
        ({"distance_m": (1.0, math.inf)}, "distance_m: expected 0 < near"),
        ({"doubt_sigma": (0.0, -1.0)}, "doubt_sigma: expected 0 or more each"),
        ({"degrees_of_freedom": (4.0, 2.0)}, "degrees_of_freedom: expected above 2 and up to 1000"),
        ({"degrees_of_freedom": (4.0,)}, "degrees_of_freedom: expected 2 numbers"),
        ({"object_radius_m": 0.0}, "object_radius_m: expected above 0, got 0"),
        ({"object_size": (0, 16)}, r"object_size: expected whole numbers.* got \(0, 16\)"),
        ({"object_size": (16.5, 16)}, r"object_size: expected whole numbers.* got \(16.5, 16\)"),
        ({"orientation_view": "both"}, r"orientation_view: expected one of frame, object"),
        ({"orientation_head": "euler"}, "orientation_head: expected one of .*, got 'euler'"),
        ({"looks": 0}, "looks: expected a whole number, at least 1, got 0"),
        ({"bins": 34}, "bins: expected at least 35, .* of degree 2, got 34"),
        ({"backbone": "compact_resnet", "translation_reduction": 32}, "compact_resnet gives"),
    ],
)
def test_refused_fields(fields, text):
    with pytest.raises(ValueError, match=text):
        build(**fields)


def test_a_second_look_needs_a_second_backbone(model):
    with pytest.raises(ValueError, match=r"object_backbone: expected one .* 'object', got none"):
        FilterformerPose(model.config, model.backbone)
    frame = build(orientation_view="frame")
    with pytest.raises(ValueError, match=r"object_backbone: expected none .* 'frame', got one"):
        FilterformerPose(frame.config, frame.backbone, model.object_backbone)
    with pytest.raises(ValueError, match="expected one with a second look, got one that sees"):
        ObjectObjective(frame, ObjectLossConfig())


def test_the_camera_of_the_input_is_named():
    config = build().config
    camera = config.view_camera
    assert (camera.width, camera.height, camera.fy) == (64, 48, 62.0)
    assert CONFIGS["base"].view_camera is None
    assert (config.first_grid, config.orientation_grid) == ((3, 4), (2, 3))
