"""PolarPose: its second look turns with the camera for any weights; candidates; files; export."""

import math

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from ffpose.config import PRESETS, PolarPoseConfig
from ffpose.models import PolarPose, build_network, load_network, polar_pose
from ffpose.models.base import UncertainPose
from ffpose.models.heat_map import Candidates
from ffpose.models.second_look import (
    LOG_SIGMA_LIMITS,
    OFFSET_LIMIT,
    OFFSET_SCALE,
    SecondLookOutput,
    covariances,
    offset_of,
    placed,
    truncation,
)
from ffpose.models.virtual_camera import pyramid, render_virtual
from ffpose.nn.rotations import quaternion_to_matrix
from ffpose.training.config import ObjectLossConfig
from ffpose.training.object_objective import ObjectObjective
from ffpose.training.patches import PatchBatch
from polar_networks import CELL, build_polar

POINTS = torch.tensor([[1.0, -2.0, 14.0], [0.5, 1.0, 20.0], [-6.0, 3.0, 22.0]])


@pytest.fixture
def model():
    return build_polar()


def images(count=3):
    """Images without fine detail, whose interpolation is nearly exact."""
    coarse = torch.rand(count, 3, 12, 16, generator=torch.Generator().manual_seed(1))
    return torch.nn.functional.interpolate(coarse, (96, 128), mode="bicubic")


def looked(model, twist):
    """Offset, attitude and covariances in the camera's frame, and the plain numbers; float64."""
    model, points = model.double(), POINTS.double()
    view = model.view_at(points, torch.full((3,), twist, dtype=torch.float64))
    with torch.no_grad():
        crops = render_virtual(pyramid(images().double()), view, points, model.intrinsics)
        numbers = model.decode(model.encode(crops, view.tan_half_angle))
        matrix = quaternion_to_matrix(model.orientation.decode(numbers.orientation))
    look = placed(numbers, view)
    return {
        "t": view.points_back(look.point),
        "R": view.rotation.mT @ matrix,
        "covariances": torch.stack(covariances(look)),
        "log_sigma": numbers.log_sigma,
        "in_view": numbers.in_view,
    }


@pytest.mark.parametrize("cells", [1, 5])
def test_random_weights_turn_with_the_camera_by_cells_of_the_last_map(model, cells):
    plain, turned = looked(model, 0.3), looked(model, 0.3 + cells * CELL)
    for name, value in plain.items():
        torch.testing.assert_close(turned[name], value, rtol=1e-5, atol=1e-5, msg=name)
    assert plain["log_sigma"].std() > 0.05
    across = plain["covariances"][1]
    spread = torch.linalg.eigvalsh(across)
    assert (spread[:, 2] / spread[:, 0]).min() > 1.2


def test_a_turn_by_a_part_of_a_cell_is_not_one_of_the_symmetry(model):
    """So what turns with whole cells is not constant."""
    plain, turned = looked(model, 0.0), looked(model, CELL / 2)
    assert (plain["in_view"] - turned["in_view"]).abs().max() > 1e-5


def test_logits_are_shifted_by_a_turn(model):
    """Two bins of 15 degrees for a cell of 30."""
    logits = []
    for twist in (0.0, CELL):
        view = model.view_at(POINTS, torch.full((3,), twist))
        with torch.no_grad():
            crops = render_virtual(pyramid(images()), view, POINTS, model.intrinsics)
            raw = model.decode(model.encode(crops, view.tan_half_angle)).orientation
            logits.append(model.orientation.logits(raw).unflatten(1, (24, 50)))
    torch.testing.assert_close(logits[1], logits[0].roll(2, 1), rtol=1e-4, atol=1e-4)
    assert (logits[1] - logits[0]).abs().max() > 0.1


def test_the_polar_view_shows_rays_at_their_angles():
    """A ray to the right is at angle zero, one below at a quarter of a turn."""
    model = build_polar(object_radius_m=5.0)
    view = model.view_at(torch.tensor([[0.0, 0.0, 20.0]]))
    points = torch.tensor([[[2.5, 0.0, 20.0], [0.0, 5.0, 20.0], [-1.0, -1e-6, 20.0]]])
    expected = torch.tensor([[[0.0, 0.5], [0.25, 1.0], [0.5, 0.2]]])
    torch.testing.assert_close(view.places(points), expected, rtol=0, atol=1e-5)


def test_a_pose_of_each_image_whatever_the_weights(model):
    pose = model(images())
    assert isinstance(pose, UncertainPose)
    assert pose.translation.shape == (3, 3)
    torch.testing.assert_close(pose.orientation.norm(dim=1), torch.ones(3))
    for covariance in (pose.translation_covariance, pose.rotation_covariance):
        assert (torch.linalg.eigvalsh(covariance) > 0).all()
    assert ((pose.in_view > 0) & (pose.in_view < 1)).all()
    torch.testing.assert_close(pose.alternative.norm(dim=1), torch.ones(3))
    assert pose.probabilities.shape == (3, 2)
    with pytest.raises(ValueError, match=r"images: expected shape \(B, 3, 96, 128\)"):
        model(torch.zeros(1, 3, 96, 100))


CANDIDATES = torch.tensor(
    [[[2.0, 0.0, 20.0], [-2.0, 1.0, 15.0]], [[1.0, 1.0, 12.0], [0.0, 0.0, 30.0]]]
)


def looked_at(model, monkeypatch, in_view, log_mass, shift=0.0):
    """Let a look at each of two candidates say how likely it is and where it finds the object.

    Args:
        model: A network with two candidates.
        monkeypatch: As it is.
        in_view: ``(2, 2)``, by image and candidate, logits; of other places 3.
        log_mass: ``(2, 2)``, of the first look.
        shift: Offset that looks at the first candidate say, in `OFFSET_SCALE`; others zero.

    Returns:
        The points of each look ``(B, 3)`` in order, and the poses.
    """
    logits, places = torch.tensor(in_view), []
    monkeypatch.setattr(
        model.translation_branch,
        "candidates",
        lambda *_: Candidates(CANDIDATES, torch.tensor(log_mass)),
    )
    look, decode = model._second_look, model.decode

    def at(levels, points, *number):
        places.append(points)
        return look(levels, points, *number)

    def said(feature_map):
        numbers, points = decode(feature_map), places[-1]
        same = (points[:, None] - CANDIDATES).norm(dim=-1) < 1e-3
        offset = torch.zeros_like(numbers.offset)
        offset[:, 2] = torch.where(same[:, 0], shift, 0.0)
        in_view = torch.where(same.any(1), (logits * same).sum(1), 3.0)
        return numbers._replace(offset=offset, in_view=in_view)

    monkeypatch.setattr(polar_pose, "FARTHER", 1.0)  # or no offset is another place there
    monkeypatch.setattr(model, "_second_look", at)
    monkeypatch.setattr(model, "decode", said)
    return places, model(images(2))


@pytest.mark.parametrize(
    ("in_view", "log_mass", "kept"),
    [
        ([[5.0, -5.0], [-5.0, 5.0]], [[0.0, 0.0], [0.0, 0.0]], [0, 1]),
        ([[9.0, 9.0], [9.0, 9.0]], [[-1.0, -3.0], [-0.5, -2.0]], [0, 0]),
        ([[-6.0, 6.0], [3.0, 3.5]], [[-0.2, -2.0], [-0.2, -2.0]], [1, 0]),
    ],
)
def test_the_likelier_candidate_is_kept(model, monkeypatch, in_view, log_mass, kept):
    _, pose = looked_at(model, monkeypatch, in_view, log_mass)
    expected = CANDIDATES[torch.arange(2), torch.tensor(kept)]
    torch.testing.assert_close(pose.translation, expected, rtol=1e-5, atol=1e-4)


def test_a_candidate_that_cannot_be_the_likelier_is_not_looked_at(model, monkeypatch):
    """The first image's first candidate is seen; the second's is not, and its other one might be.

    Where it is not looked at, the look goes to where the object was found: e^(1/4) times as far.
    """
    seen = [[5.0, 5.0], [-6.0, -9.0]]
    places, pose = looked_at(model, monkeypatch, seen, [[-0.1, -3.0], [-0.1, -3.0]], shift=1.0)
    farther = CANDIDATES[:, 0] * math.exp(1 / OFFSET_SCALE)
    assert len(places) == 3
    torch.testing.assert_close(places[0], CANDIDATES[:, 0])
    torch.testing.assert_close(places[1], torch.stack([farther[0], CANDIDATES[1, 1]]))
    # Nor was it at the second one: the first is kept, at which a last look is where it says.
    torch.testing.assert_close(places[2], farther, rtol=1e-5, atol=1e-4)
    torch.testing.assert_close(pose.translation, farther, rtol=1e-5, atol=1e-4)


@pytest.mark.parametrize("looks", [2, 4])
def test_looks_are_turned_by_equal_parts_of_a_cell(looks, monkeypatch):
    model = build_polar(looks=looks)
    twists, view_at = [], model.view_at
    monkeypatch.setattr(
        model,
        "view_at",
        lambda points, twist=None: twists.append(twist) or view_at(points, twist),
    )
    model(images(2))
    assert twists[0] is None
    expected = torch.arange(1, looks + 1) * CELL / (looks + 1)
    torch.testing.assert_close(torch.stack(twists[1:], dim=1), expected.expand(2, -1))


def quaternions(rotation):
    return torch.from_numpy(np.atleast_2d(rotation.as_quat(scalar_first=True)))


def pose_at(rotation, translation):
    zeros, unsure = torch.zeros(1, 3, 3), torch.zeros(1)
    found = torch.tensor([translation], dtype=torch.float64)
    q = quaternions(rotation)
    return UncertainPose(found, q, zeros, zeros, unsure, q, unsure)


HERE, ELSEWHERE = torch.ones(1, dtype=torch.bool), torch.zeros(1, dtype=torch.bool)


@pytest.mark.parametrize("signs", [(1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0)])
def test_the_pose_is_the_mean_of_looks_that_agree(signs):
    """SciPy's mean of rotations; of the positions the last two's."""
    away = [[0, 0, 0], [0, 12, 0], [5, 4, -8]]
    looks = Rotation.random(rng=3) * Rotation.from_rotvec(away, degrees=True)
    others = [(sign * quaternions(looks[i]), HERE) for i, sign in enumerate(signs)]
    before = torch.tensor([[1.0, 2.0, 20.0]], dtype=torch.float64)
    mean = polar_pose._mean(before, others, pose_at(looks[2], [1.2, 2.2, 21.0]))
    error = Rotation.from_quat(mean.orientation[0].numpy(), scalar_first=True) * looks.mean().inv()
    assert np.degrees(error.magnitude()) < 0.01  # a cube of their angles
    torch.testing.assert_close(mean.translation[0].tolist(), [1.1, 2.1, 20.5])


@pytest.mark.parametrize(("angle", "same"), [(16, HERE), (3, ELSEWHERE)])
def test_looks_that_do_not_agree_or_are_of_another_place_do_not_count(angle, same):
    ends = Rotation.from_rotvec([[0, 0, 0], [angle, 0, 0]], degrees=True)
    last = pose_at(ends[1], [1.2, 2.2, 21.0])
    before = torch.tensor([[1.0, 2.0, 20.0]], dtype=torch.float64)
    mean = polar_pose._mean(before, [(quaternions(ends[0]), same)], last)
    assert mean.translation.equal(last.translation)
    torch.testing.assert_close(mean.orientation, last.orientation)


TURNS = Rotation.from_rotvec([[0, 0, 0], [4, 0, 0], [9, 0, 0], [0, 5, 1], [0, 0, 7]], degrees=True)
"""Attitudes that the looks find, in order; all within 15 degrees of each other."""


@pytest.mark.parametrize(
    ("in_view", "looks", "counted"),
    [
        ([9.0, 9.0], 2, [0, 1, 2]),
        ([9.0, 9.0], 4, [0, 1, 2, 3, 4]),
        ([-6.0, 6.0], 2, [1, 2]),
        ([-6.0, -9.0], 2, [0, 2]),
    ],
    ids=["no rival", "no rival, more looks", "the rival is kept", "the rival is not kept"],
)
def test_the_attitude_is_the_mean_of_the_looks_at_what_is_kept(
    monkeypatch, in_view, looks, counted
):
    """SciPy's mean of the attitudes that looks find, each look its own."""
    model, taken = build_polar(looks=looks), []
    decode, pose = model.decode, model._pose

    def numbered(feature_map):
        taken.append(len(taken))
        numbers = decode(feature_map)
        return numbers._replace(orientation=torch.full_like(numbers.orientation, taken[-1]))

    def attitude(look):
        return quaternions(TURNS).float()[look.output.orientation[:, 0].long()]

    monkeypatch.setattr(model, "decode", numbered)
    monkeypatch.setattr(model, "_orientations", lambda looks: map(attitude, looks))
    monkeypatch.setattr(model, "_pose", lambda look: replaced(pose, look, attitude))
    log_mass = [[-0.1, -3.0], [-0.1, -3.0]]
    _, found = looked_at(model, monkeypatch, [in_view, in_view], log_mass)
    assert len(taken) == looks + 1
    expected = TURNS[counted].mean()
    for q in found.orientation.numpy():
        error = Rotation.from_quat(q, scalar_first=True) * expected.inv()
        assert np.degrees(error.magnitude()) < 0.01


def replaced(pose, look, attitude):
    blank = look.output._replace(orientation=torch.zeros_like(look.output.orientation))
    return pose(look._replace(output=blank))._replace(orientation=attitude(look))


def test_one_candidate_and_one_look_are_one_view(tmp_path):
    model = build_polar()
    model.save_pretrained(tmp_path / "polar.safetensors")
    quick = load_network(tmp_path / "polar.safetensors", looks=1, candidates=1)
    assert isinstance(quick, PolarPose)
    views = []
    quick.object_backbone.register_forward_hook(lambda _, inputs, __: views.append(len(inputs[0])))
    quick(images(2))
    assert views == [2]
    model.object_backbone.register_forward_hook(lambda _, inputs, __: views.append(len(inputs[0])))
    model(images(2))
    assert views[1:] == [2, 2, 2]


def test_weights_there_and_back(model, tmp_path):
    expected = model(images())
    model.variance_scales.copy_(torch.tensor([1.5, 2.5]))
    model.save_pretrained(tmp_path / "polar.safetensors")
    loaded = load_network(tmp_path / "polar.safetensors")
    assert loaded.config == model.config
    got = loaded(images())
    for name in ("translation", "orientation", "in_view", "alternative", "probabilities"):
        assert torch.equal(getattr(got, name), getattr(expected, name))
    torch.testing.assert_close(got.translation_covariance, 1.5 * expected.translation_covariance)
    torch.testing.assert_close(got.rotation_covariance, 2.5 * expected.rotation_covariance)


def test_no_table_is_saved(model):
    """Of buffers only what training or calibration changes."""
    saved = set(model.state_dict()) - {name for name, _ in model.named_parameters()}
    kept = ("running_mean", "running_var", "num_batches_tracked", "variance_scales")
    assert all(name.endswith(kept) for name in saved)


def test_images_do_not_mix(model):
    together = model(images())
    for got, expected in zip(model(images()[1:2]), together, strict=True):
        torch.testing.assert_close(got, expected[1:2], rtol=1e-4, atol=1e-4)


def test_what_weights_depend_on_is_not_changed_as_they_are_loaded(model, tmp_path):
    path = tmp_path / "look.safetensors"
    model.save_pretrained(path)
    message = r"that may change after training \(looks, candidates\), got look \(did"
    with pytest.raises(ValueError, match=message):
        load_network(path, look=1)
    with pytest.raises(ValueError, match="looks: expected a whole number, at least 1, got 0"):
        load_network(path, looks=0)
    once = build_network("tiny", backbone_weights="none", image_size=(64, 64))
    once.save_pretrained(path)
    with pytest.raises(ValueError, match=r"\(this network has none\), got looks"):
        load_network(path, looks=1)


def least_rotations(rays):
    """SciPy's least rotations from the z axis to rays ``(N, 3)``."""
    rays = rays / np.linalg.norm(rays, axis=-1, keepdims=True)
    axis = np.cross([0, 0, 1], rays)
    sine = np.linalg.norm(axis, axis=-1, keepdims=True)
    return Rotation.from_rotvec(axis / sine * np.arctan2(sine, rays[:, 2:]))


def told(model, offset, log_sigma=(0.0,) * 6):
    """Equal outputs of the second look for each of `POINTS`."""
    return SecondLookOutput(
        torch.randn(1, model.orientation_branch.mix.out_features * 12).expand(3, -1),
        torch.tensor(offset).expand(3, 3),
        torch.tensor(log_sigma).expand(3, 6),
        torch.zeros(3),
        torch.zeros(3, 4),
    )


def test_one_view_of_the_object_is_turned_with_the_camera(model):
    """Equal outputs in three directions: position, attitude, covariances turn with the ray."""
    output = told(model, (1.0, -0.5, 0.4), (-3.0, -3.0, -1.0, -3.0, -3.0, -1.0))
    pose = model._pose(placed(output, model.view_at(POINTS)))
    turn = least_rotations(POINTS.numpy().astype(np.float64))
    # A quarter of the image's width is half its radius of 6.6 meters, at the distance.
    distance = POINTS.norm(dim=1).double().numpy()
    x, y = (part / 2 * model.config.object_radius_m / distance for part in (1.0, -0.5))
    ray = np.stack([x, y, np.ones(3)], axis=-1)
    ray *= (distance * np.exp(0.1) / np.linalg.norm(ray, axis=-1))[:, None]
    np.testing.assert_allclose(pose.translation.detach(), turn.apply(ray), rtol=1e-5)
    seen, found = (
        Rotation.from_quat(q.detach().double().numpy(), scalar_first=True)
        for q in (model.orientation.decode(output.orientation), pose.orientation)
    )
    assert ((turn * seen).inv() * found).magnitude().max() < 1e-4
    alike = turn.inv().as_matrix() @ pose.rotation_covariance.detach().numpy() @ turn.as_matrix()
    expected = np.broadcast_to(np.diag(np.exp([-6, -6, -2])), (3, 3, 3))
    np.testing.assert_allclose(alike, expected, atol=1e-6)


@pytest.mark.parametrize("number", [0.0, 1e30, -1e30, OFFSET_LIMIT])
def test_wild_looks_give_a_pose_in_front(model, monkeypatch, number):
    wild = told(model, (number, -number, number), (2.0,) * 6)
    monkeypatch.setattr(model, "decode", lambda feature_map: wild)
    pose = model(images())
    assert all(each.isfinite().all() for each in pose)
    assert (pose.translation[:, 2] > 0).all()
    for covariance in (pose.translation_covariance, pose.rotation_covariance):
        assert (torch.linalg.eigvalsh(covariance.double()) > 0).all()


@pytest.mark.parametrize("wild", [1e30, -1e30])
def test_a_wild_first_look_gives_a_pose_in_front(model, monkeypatch, wild):
    rows, columns = model.config.heat_grid
    maps = torch.zeros(3, 1, rows, columns), torch.full((3, 1, rows, columns), wild)
    maps[0][:, :, 0, -1] = abs(wild)
    shapes = [part.shape for part in model.locate(torch.zeros(3, 3, 24, 32))]
    monkeypatch.setattr(
        model, "locate", lambda _: [m.view(s) for m, s in zip(maps, shapes, strict=True)]
    )
    pose = model(images())
    assert all(each.isfinite().all() for each in pose)
    assert (pose.translation[:, 2] > 0).all()


def test_pictures_of_nothing(model):
    black = torch.full((2, 3, 96, 128), -2.0)
    for pictures in (black, -black, 100 * torch.randn(3, 3, 96, 128), torch.zeros(0, 3, 96, 128)):
        pose = model(pictures)
        assert len(pose.in_view) == len(pictures)
        assert all(each.isfinite().all() for each in pose)


def test_log_deviations_stay_within_their_limits(model):
    head = model.orientation_branch
    feature_map = torch.randn(2, 12, *model.config.object_grid)
    for bias, limit in zip((-1e9, 1e9), LOG_SIGMA_LIMITS, strict=True):
        with torch.no_grad():
            head.scalars[-1].bias.fill_(bias)
            log_sigma = head(feature_map).log_sigma
        assert torch.equal(log_sigma, torch.full((2, 6), limit))


@pytest.mark.slow
def test_autocast_leaves_the_geometry_in_float32(model, monkeypatch):
    """With the same outputs of the learned parts the poses are the same bit for bit."""
    recorded, within = {}, []

    def record(name, part):
        def called(*args):
            within.append(torch.is_autocast_enabled("cpu"))
            return recorded.setdefault((name, len(within)), part(*args))

        return called

    for name in ("locate", "encode", "decode"):
        monkeypatch.setattr(model, name, record(name, getattr(model, name)))
    with torch.no_grad():
        for predict in (model, lambda some: model.predict_near(some, POINTS)):
            within.clear()
            recorded.clear()
            plain = predict(images())
            assert not any(within)
            within.clear()
            with torch.autocast("cpu", torch.bfloat16):
                half = predict(images())
                assert torch.is_autocast_enabled("cpu")
            assert all(within)
            for ours, expected in zip(half, plain, strict=True):
                assert torch.equal(ours, expected)


def test_an_exported_network_takes_batches_of_any_size():
    """With one look, as further ones repeat it; shipped networks are exported with all of them."""
    model = build_polar(looks=1, candidates=1)
    shapes = ({0: torch.export.Dim("batch")},)
    program = torch.export.export(model, (images(2),), dynamic_shapes=shapes).module()
    for count in (1, 3):
        for got, expected in zip(program(images(count)), model(images(count)), strict=True):
            torch.testing.assert_close(got, expected, rtol=1e-3, atol=1e-4)


def test_the_objective_trains_every_weight():
    model = build_polar().train()
    objective = ObjectObjective(model, ObjectLossConfig(keypoints=1.0), 3)
    assert objective.cells == (4, 24)
    both = torch.nn.ModuleList([model, objective])
    t = POINTS[torch.arange(4) % 3]
    view = model.view_at(t + 0.1)
    coordinates = torch.rand(4, 4, *objective.cells) * 2 - 1
    coordinates[:, 3] = (coordinates[:, 3] > 0).float()
    batch = PatchBatch(
        frames=torch.randn(2, 3, 24, 32),
        translation=t[:2],
        crops=torch.randn(4, 3, 16, 96),
        tan_half_angle=view.tan_half_angle,
        orientation=torch.nn.functional.normalize(torch.randn(4, 4), dim=1),
        offset=offset_of(view.points(t), view),
        coordinates=coordinates,
        keypoints=torch.rand(4, 3, 2),
        present=torch.arange(4) > 0,
        index=torch.arange(4),
    )
    before = {name: value.clone() for name, value in both.named_parameters()}
    optimizer = torch.optim.Adam(both.parameters(), 1e-3)
    losses = []
    for _ in range(30):
        optimizer.zero_grad()
        terms = objective(model, batch)
        terms.total.backward()
        losses.append(terms.total.item())
        assert all(p.grad.isfinite().all() for p in both.parameters())
        optimizer.step()
    assert not [name for name, value in both.named_parameters() if torch.equal(value, before[name])]
    assert losses[-1] < 0.8 * losses[0]


def test_turned_attitudes_are_scipys(model):
    """The attitude of a turned camera is that of the first, turned about the axis."""
    attitudes = []
    for twist in (0.0, 2 * CELL):
        view = model.view_at(POINTS, torch.full((3,), twist))
        with torch.no_grad():
            crops = render_virtual(pyramid(images()), view, POINTS, model.intrinsics)
            q = model.orientation.decode(
                model.decode(model.encode(crops, view.tan_half_angle)).orientation
            )
        attitudes.append(Rotation.from_quat(q.double().numpy(), scalar_first=True))
    turn = Rotation.from_rotvec([0, 0, 2 * CELL])
    assert ((turn * attitudes[0]).inv() * attitudes[1]).magnitude().max() < 1e-4


@pytest.mark.parametrize(
    ("fields", "text"),
    [
        ({"camera": None}, "camera: the second look needs it, got None"),
        ({"camera": (1.0, 2.0)}, r"camera: expected 4 numbers, got \(1.0, 2.0\)"),
        ({"camera": (1.0, math.nan, 0.0, 0.0)}, "camera: expected finite numbers, got"),
        ({"camera": (0.0, 60.0, 32.0, 24.0)}, "camera: expected fx > 0 and fy > 0, got"),
        ({"first_stride": 5}, r"first_stride: .* divisor of image_size \(96, 128\), got 5"),
        ({"distance_m": (20.0, 10.0)}, r"distance_m: expected 0 < near < far, got \(20.0, 10.0\)"),
        ({"distance_m": (1.0, math.inf)}, "distance_m: expected 0 < near"),
        ({"distance_m": (0.0, 10.0)}, "distance_m: expected 0 < near"),
        ({"first_stride": 0}, "first_stride: expected a whole number, at least 1, got 0"),
        ({"distance_scale": 0.0}, "distance_scale: expected above 0, got 0"),
        ({"truncation_distance": math.nan}, "truncation_distance: expected a finite number"),
        ({"truncation_sigma": (-1.0, 0.0)}, "truncation_sigma: expected 0 or more each"),
        ({"look_slope": (0.0, 1.0)}, "look_slope: expected above 0 each"),
        ({"doubt_sigma": (0.0, -1.0)}, "doubt_sigma: expected 0 or more each"),
        ({"degrees_of_freedom": (4.0, 2.0)}, "degrees_of_freedom: expected above 2 and up to 1000"),
        ({"degrees_of_freedom": (4.0,)}, "degrees_of_freedom: expected 2 numbers"),
        ({"object_radius_m": 0.0}, "object_radius_m: expected above 0, got 0"),
        ({"object_size": (0, 96)}, r"object_size: expected whole numbers.* got \(0, 96\)"),
        ({"object_size": (16.5, 96)}, r"object_size: expected whole numbers.* got \(16.5, 96\)"),
        ({"object_size": (20, 96)}, "object_size: expected radii and angles that are multiples of"),
        ({"object_size": (16, 88)}, "multiples of 8 and 16, got"),
        ({"channels": (4, 8)}, "channels: expected 3 numbers"),
        ({"channels": (4, 0, 8)}, "channels: expected whole numbers, at least 1"),
        ({"blocks": (1, -1)}, "blocks: expected whole numbers, at least 0"),
        ({"angles": 30}, "angles: expected a multiple of 12, .* got 30"),
        ({"bins_width_deg": 0.0}, "bins_width_deg: expected above 0, got 0"),
        ({"candidates": 0}, "candidates: expected a whole number, at least 1, got 0"),
        ({"candidates": 17}, "candidates: expected at most 16, got 17"),
        ({"looks": 100000}, "looks: expected at most 16, got 100000"),
        ({"image_size": (12, 16)}, "image_size: expected each at least 16"),
    ],
)
def test_refused_fields(fields, text):
    with pytest.raises(ValueError, match=text):
        build_polar(**fields)


def test_heads_of_attention_share_the_channels_evenly():
    with pytest.raises(ValueError, match="channels: expected a multiple of the 4 heads, got 10"):
        build_polar(mixer="attention", channels=(4, 8, 10))


def test_points_of_another_shape_are_refused(model):
    with pytest.raises(ValueError, match=r"points: expected shape \(B, 3\), got \(3,\)"):
        model.predict_near(images(), POINTS[0])


def test_the_last_map_has_cells_of_fifteen_degrees():
    config = PolarPoseConfig()
    assert (config.object_grid, config.heat_grid) == ((4, 24), (12, 16))
    assert config.free_fields == ("looks", "candidates")


def test_both_modes_are_those_of_the_last_view_in_the_cameras_frame():
    model = build_polar(looks=1, candidates=1)
    levels, shown = pyramid(images()), images()
    with torch.no_grad():
        maps = model.locate(torch.nn.functional.avg_pool2d(shown, model.config.first_stride))
        points = model.translation_branch.candidates(*maps, 1)[0].flatten(0, 1)
        view = model.view_at(points)
        crops = render_virtual(levels, view, points, model.intrinsics)
        numbers = model.decode(model.encode(crops, view.tan_half_angle))
        modes, pose = model.orientation.modes(numbers.orientation), model(shown)
    turn = view.rotation.mT
    for got, expected in ((pose.orientation, modes[0]), (pose.alternative, modes[1])):
        torch.testing.assert_close(
            quaternion_to_matrix(got), turn @ quaternion_to_matrix(expected), rtol=0, atol=1e-5
        )
    torch.testing.assert_close(pose.probabilities, modes.probabilities)


@pytest.mark.parametrize(
    ("position", "share"),
    [
        ((0.0, 0.0, 20.0), 0.0),  # 20 m within each side
        ((-20.0, 0.0, 20.0), 0.5),  # on the left border
        ((0.0, 15.0, 20.0), 0.5),  # on the lower one
        ((19.0, 0.0, 20.0), 0.25),  # 1 m of 2 within
        ((20.0, 15.0, 20.0), 0.75),  # in a corner
        ((19.0, 15.5, 20.0), 1 - 0.75 * 0.375),
        ((21.0, 0.0, 20.0), 0.75),
        ((40.0, 0.0, 20.0), 1.0),
    ],
)
def test_truncation_is_the_share_of_a_view_beyond_the_frame(position, share):
    """Of a view of 2 m to each side, in an image with a field of view of 90 by 74 degrees."""
    config = PRESETS["polar"].with_fields(
        {"image_size": (384, 512), "camera": (256.0, 256.0, 256.0, 192.0), "object_radius_m": 2.0}
    )
    assert truncation(torch.tensor([position]), config).item() == pytest.approx(share)


def test_the_uncertainty_grows_with_the_share_that_the_border_cuts_off():
    plain, grown = build_polar(), build_polar(truncation_sigma=(6.0, 2.0))
    points = torch.tensor([[0.0, 0.0, 20.0], [-20.0, 3.0, 21.0], [4.0, 14.0, 20.0]])
    with torch.no_grad():
        got, expected = (each.predict_near(images(), points) for each in (grown, plain))
    cut = truncation(expected.translation, plain.config)[:, None, None]
    assert (cut > 0.1).sum() == 2
    for name, growth in (("translation_covariance", 6), ("rotation_covariance", 2)):
        factor = (1 + growth * cut**2) ** 2
        torch.testing.assert_close(getattr(got, name), factor * getattr(expected, name))


def test_what_the_border_cuts_comes_nearer():
    plain, nearer = build_polar(), build_polar(truncation_distance=0.8)
    points = torch.tensor([[0.0, 0.0, 20.0], [-20.0, 3.0, 21.0], [4.0, 14.0, 20.0]])
    with torch.no_grad():
        got, expected = (each.predict_near(images(), points) for each in (nearer, plain))
    cut = truncation(expected.translation, plain.config)[:, None]
    assert (cut > 0.1).sum() == 2
    torch.testing.assert_close(got.translation, expected.translation * torch.exp(-0.8 * cut**2))
    torch.testing.assert_close(got.translation_covariance, expected.translation_covariance)


def test_the_offset_of_a_look_at_a_point_is_divided_by_its_slopes():
    """Across and along the ray; attitude and covariances in the view stay."""
    plain, mended = build_polar(), build_polar(look_slope=(0.5, 0.8))
    with torch.no_grad():
        got, expected = (each.predict_near(images(), POINTS) for each in (mended, plain))
        view = plain.view_at(POINTS)
        offsets, before = (
            offset_of((view.rotation @ each.translation[:, :, None])[:, :, 0], view)
            for each in (got, expected)
        )
    torch.testing.assert_close(
        offsets, before / torch.tensor([0.5, 0.5, 0.8]), rtol=1e-4, atol=1e-4
    )
    torch.testing.assert_close(got.orientation, expected.orientation)
    torch.testing.assert_close(got.rotation_covariance, expected.rotation_covariance)
    with torch.no_grad():
        whole, other = (each(images()) for each in (mended, plain))
    assert torch.equal(whole.translation, other.translation)


def test_the_uncertainty_grows_with_the_doubt_of_the_attitude():
    """Variances times (1 + k (1 - p))², p being the probability of the attitude; poses stay."""
    plain, grown = build_polar(), build_polar(doubt_sigma=(6.0, 2.0))
    with torch.no_grad():
        got, expected = grown(images()), plain(images())
    doubt = 1 - expected.probabilities[:, 0, None, None]
    assert doubt.min() > 0.01
    for name, growth in (("translation_covariance", 6), ("rotation_covariance", 2)):
        factor = (1 + growth * doubt) ** 2
        torch.testing.assert_close(getattr(got, name), factor * getattr(expected, name))
    for name in ("translation", "orientation", "in_view", "alternative", "probabilities"):
        assert torch.equal(getattr(got, name), getattr(expected, name))


def test_one_look_is_less_certain_of_the_attitude_than_the_mean_of_several():
    """Where several looks make the pose: calibration has scaled the covariance of their mean."""
    points = torch.tensor([[0.0, 1.0, 14.0], [2.0, -1.0, 18.0]])
    once, twice = (build_polar(looks=looks).predict_near(images(2), points) for looks in (1, 2))
    grown = polar_pose.ONE_LOOK_VARIANCE * once.rotation_covariance
    torch.testing.assert_close(twice.rotation_covariance, grown)
    assert twice.translation_covariance.equal(once.translation_covariance)
    assert twice.translation.equal(once.translation)
