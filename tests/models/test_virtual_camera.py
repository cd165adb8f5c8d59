"""The virtual camera: one homography, the least rotation, zero where the camera sees nothing."""

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from ffpose.geometry import Camera
from ffpose.geometry.warping import sample_planes
from ffpose.models.virtual_camera import (
    chosen,
    pyramid,
    pyramid_level,
    render_virtual,
    source_pixels,
    turn_to,
)

CAMERA = Camera(320, 240, 150.0, 145.0, 150.0, 125.0)
INTRINSICS = torch.tensor([CAMERA.fx, CAMERA.fy, CAMERA.cx, CAMERA.cy], dtype=torch.float64)
SIZE, WIDTH = (6, 12), 10
"""Radii and angles; diameter of the outermost ring, pixels."""


@pytest.fixture
def generator():
    return np.random.default_rng(0)


def directions(generator, count, most_deg):
    """Unit vectors ``(count, 3)`` up to an angle from the z axis; the last at that angle."""
    angle = np.radians(np.append(generator.uniform(0, most_deg, count - 1), most_deg))
    around = generator.uniform(0, 2 * np.pi, count)
    return np.stack(
        [np.sin(angle) * np.cos(around), np.sin(angle) * np.sin(around), np.cos(angle)], axis=-1
    )


def points_ahead(generator, count, most_deg=60):
    return torch.from_numpy(directions(generator, count, most_deg)) * torch.from_numpy(
        generator.uniform(5, 40, (count, 1))
    )


def turned_views(generator, count, most_deg=60):
    points = points_ahead(generator, count, most_deg)
    twist = torch.from_numpy(generator.uniform(-np.pi, np.pi, count))
    return points, turn_to(points, 3.0, SIZE, WIDTH, twist)


def test_rotation_and_quaternion_of_a_camera_are_one(generator):
    views = [turned_views(generator, 50)[1] for _ in range(2)]
    taken = torch.from_numpy(generator.random(50) < 0.5)
    for view in (views[0], views[0].of(taken), chosen(taken, *views)):
        expected = Rotation.from_quat(view.quaternion.numpy(), scalar_first=True).as_matrix()
        np.testing.assert_allclose(view.rotation.numpy(), expected, atol=1e-12)
    assert torch.equal(view.quaternion[taken], views[0].quaternion[taken])
    assert torch.equal(view.quaternion[~taken], views[1].quaternion[~taken])


def test_the_target_is_in_the_middle_and_the_radius_at_the_edge(generator):
    points, view = turned_views(generator, 20)
    middle = view.points(points)
    expected = torch.zeros(20, 3, dtype=torch.float64)
    expected[:, 2] = points.norm(dim=-1)
    torch.testing.assert_close(middle, expected, rtol=0, atol=1e-12)
    edge = middle - torch.tensor([3.0, 0.0, 0.0])  # three meters to the left
    u = view.focal * edge[:, 0] / edge[:, 2] + WIDTH / 2
    torch.testing.assert_close(u, torch.zeros_like(u), rtol=0, atol=1e-12)


def test_a_twist_turns_the_scene_about_the_viewing_ray(generator):
    points = points_ahead(generator, 20)
    twist = generator.uniform(-np.pi, np.pi, 20)
    plain, twisted = (
        turn_to(points, 3.0, SIZE, WIDTH, angles).rotation.numpy()
        for angles in (None, torch.from_numpy(twist))
    )
    expected = np.zeros((20, 3))
    expected[:, 2] = twist
    between = Rotation.from_matrix(twisted) * Rotation.from_matrix(plain).inv()
    np.testing.assert_allclose(between.as_rotvec(), expected, atol=1e-12)


def test_poses_come_back_from_the_virtual_frame(generator):
    t, view = turned_views(generator, 50)
    attitudes = Rotation.random(50, rng=generator).as_matrix()
    keypoints = generator.normal(size=(50, 3))
    there = view.rotation.numpy() @ attitudes
    # One keypoint, by the pose in the virtual frame and by the point in the camera's.
    by_pose = (there @ keypoints[..., None])[..., 0] + view.points(t).numpy()
    in_camera = (attitudes @ keypoints[..., None])[..., 0] + t.numpy()
    np.testing.assert_allclose(
        by_pose, view.points(torch.from_numpy(in_camera)).numpy(), atol=1e-12
    )
    torch.testing.assert_close(view.points_back(view.points(t)), t, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(view.rotation.mT.numpy() @ there, attitudes, atol=1e-12)


def pixel_grid(size):
    height, width = size
    v, u = np.meshgrid(np.arange(height) + 0.5, np.arange(width) + 0.5, indexing="ij")
    return np.stack([u, v, np.ones_like(u)], axis=-1)  # (h, w, 3)


def rings(size, width):
    """Places ``(radii, angles, 3)`` of a polar image's pixels, (u, v, 1) about its center."""
    radii, angles = size
    radius = (np.arange(radii)[:, None] + 0.5) / radii * width / 2
    angle = (np.arange(angles) + 0.5) / angles * 2 * np.pi
    u, v = radius * np.cos(angle), radius * np.sin(angle)
    return np.stack([u, v, np.ones_like(u)], axis=-1)


def view_rays(view, i, size=SIZE, width=WIDTH):
    """The rays of a view's pixels, virtual camera's frame, of depth one."""
    focal = float(view.focal[i].detach())
    return rings(size, width) / (focal, focal, 1)


def test_pixels_lie_where_the_homography_takes_them(generator):
    _, view = turned_views(generator, 20)
    pixels = source_pixels(view, INTRINSICS).numpy()
    for i in range(20):
        back = CAMERA.matrix @ view.rotation[i].numpy().T
        mapped = view_rays(view, i) @ back.T
        np.testing.assert_allclose(pixels[i], mapped[..., :2] / mapped[..., 2:], rtol=1e-9)


def test_a_keypoint_has_one_pixel_both_ways(generator):
    _, view = turned_views(generator, 20)
    depth = generator.uniform(1, 50, (20, *SIZE, 1))
    for i in range(20):
        in_camera = (view_rays(view, i) * depth[i]) @ view.rotation[i].numpy()  # R^T of each
        np.testing.assert_allclose(
            source_pixels(view, INTRINSICS)[i].numpy(), CAMERA.project(in_camera), rtol=1e-9
        )


def test_each_view_may_have_a_camera_of_its_own(generator):
    _, view = turned_views(generator, 3)
    cameras = INTRINSICS * torch.tensor([[1.0], [0.5], [2.0]], dtype=torch.float64)
    together = source_pixels(view, cameras)
    torch.testing.assert_close(together[1], source_pixels(view, INTRINSICS)[1] / 2)
    torch.testing.assert_close(together[2], source_pixels(view, INTRINSICS)[2] * 2)


def test_sampling_a_pixels_center_gives_the_pixel():
    image = torch.rand(2, 3, 5, 7, dtype=torch.float64)
    u, v = torch.from_numpy(pixel_grid((5, 7))).unbind(-1)[:2]
    u, v = u.expand(2, 5, 7), v.expand(2, 5, 7)
    torch.testing.assert_close(sample_planes(image, u, v), image)
    between = (image[..., :-1] + image[..., 1:]) / 2
    torch.testing.assert_close(sample_planes(image, u[..., :-1] + 0.5, v[..., :-1]), between)
    assert not sample_planes(image, u + 100, v + 100).any()


@pytest.mark.parametrize(
    ("ratio", "level"),
    [(0.1, 0), (1.0, 0), (1.59, 0), (1.61, 1), (3.19, 1), (3.21, 2), (6.41, 3), (1000.0, 3)],
)
def test_levels_double_from_a_pixel_and_six_tenths(ratio, level):
    """``ratio`` pixels of the image a pixel of the virtual camera, kept over 0.8 of the level's."""
    focal, distance = CAMERA.fx / ratio, 20.0
    for degrees, more in ((0, 0), (60, 1)):  # off the axis a pinhole image is 1 / cos larger
        ray = torch.tensor([[np.sin(np.radians(degrees)), 0.0, np.cos(np.radians(degrees))]])
        view = turn_to(ray * distance, WIDTH / 2 * distance / focal, SIZE, WIDTH)
        expected = min(level + more, 3) if ratio > 0.8 else 0
        assert pyramid_level(view, ray * distance, INTRINSICS).tolist() == [expected]


def pattern(x, y):
    return np.stack([np.sin(3 * x) + np.cos(2 * y), x - y, x * y])


def drawn():
    grid = pixel_grid((CAMERA.height, CAMERA.width))
    image = pattern((grid[..., 0] - CAMERA.cx) / CAMERA.fx, (grid[..., 1] - CAMERA.cy) / CAMERA.fy)
    return torch.from_numpy(image)[None]


@pytest.mark.parametrize("level", [0, 1, 2, 3])
def test_a_look_shows_the_pattern_along_its_rays(generator, level):
    """An error of half a pixel of the level would be some fifty times the tolerance."""
    count, size, width = 6, (6, 16), 12
    points = points_ahead(generator, count, 25)
    twist = torch.from_numpy(generator.uniform(-np.pi, np.pi, count))
    # Ten degrees to the left edge at level 3; the focal length doubles with each finer level.
    view = turn_to(points, 1.0, size, width, twist)
    view = view._replace(focal=torch.full((count,), CAMERA.fx / 1.1 / 2**level).double())
    assert pyramid_level(view, points, INTRINSICS).tolist() == [level] * count
    seen = render_virtual(
        pyramid(drawn().expand(count, -1, -1, -1)), view, points, INTRINSICS
    ).numpy()
    for i in range(count):
        rays = view_rays(view, i, size, width) @ view.rotation[i].numpy()
        x, y = rays[..., 0] / rays[..., 2], rays[..., 1] / rays[..., 2]
        margin = 2**level  # the last half pixel of the level fades to the black outside
        u, v = x * CAMERA.fx + CAMERA.cx, y * CAMERA.fy + CAMERA.cy
        inside = (u > margin) & (u < CAMERA.width - margin)
        inside &= (v > margin) & (v < CAMERA.height - margin)
        assert inside.mean() > 0.3
        np.testing.assert_allclose(
            seen[i][:, inside], pattern(x, y)[:, inside], atol=2.5e-4 * 4**level
        )


def test_a_batch_of_all_levels_is_its_images_one_by_one(generator):
    points, view = turned_views(generator, 8, 50)
    finer = torch.tensor([0.5, 1, 2, 2, 4, 4, 7, 50]) * points[:, 2] / view.distance
    view = view._replace(focal=INTRINSICS[0] / 4 / finer)
    assert set(pyramid_level(view, points, INTRINSICS / 4).tolist()) == {0, 1, 2, 3}
    images = torch.from_numpy(generator.uniform(size=(8, 3, 60, 80)))
    together = render_virtual(pyramid(images), view, points, INTRINSICS / 4)
    for i in range(8):
        one = slice(i, i + 1)
        alone = view._replace(
            rotation=view.rotation[one], focal=view.focal[one], distance=view.distance[one]
        )
        torch.testing.assert_close(
            render_virtual(pyramid(images[one]), alone, points[one], INTRINSICS / 4), together[one]
        )


def test_rays_behind_the_camera_see_nothing():
    """The view is turned 80 degrees to the right, and half of it is behind the image plane."""
    points = torch.tensor([[np.sin(np.radians(80)), 0.0, np.cos(np.radians(80))]]).float() * 10
    points.requires_grad_()
    view = turn_to(points, 8.0, (8, 32), 16)
    wide = torch.tensor([4.0, 4.0, 32.0, 32.0])  # sees 83 degrees off its axis
    seen = render_virtual(pyramid(torch.ones(1, 1, 64, 64)), view, points, wide)
    x = view_rays(view, 0, (8, 32), 16)[..., 0]
    behind = np.cos(np.radians(80)) - x * np.sin(np.radians(80)) <= 0
    assert 0.2 <= behind.mean() <= 0.8
    assert not seen[0, 0][behind].any()
    assert (seen[0, 0][~behind] > 0.5).any()
    seen.sum().backward()
    assert points.grad.isfinite().all()


def test_gradients_reach_the_point_that_is_looked_at(generator):
    points = points_ahead(generator, 2, 20).requires_grad_()
    image = drawn().expand(2, -1, -1, -1)

    def seen(p):
        return render_virtual(pyramid(image), turn_to(p, 3.0, (2, 6), 4), p, INTRINSICS)

    assert torch.autograd.gradcheck(seen, points, eps=1e-7, atol=1e-5)
    assert torch.autograd.grad(seen(points).sum(), points)[0].abs().min() > 0


class Look(torch.nn.Module):
    def forward(self, images, points):
        return render_virtual(
            pyramid(images), turn_to(points, 3.0, (4, 16), 8), points, INTRINSICS.float() / 4
        )


def test_it_exports_for_batches_of_any_size(generator):
    def inputs(count):
        images = torch.from_numpy(generator.uniform(size=(count, 3, 60, 80))).float()
        return images, points_ahead(generator, count).float()

    batch = torch.export.Dim("batch")
    shapes = ({0: batch}, {0: batch})
    program = torch.export.export(Look(), inputs(2), dynamic_shapes=shapes).module()
    for count in (1, 2, 5):
        images, points = inputs(count)
        torch.testing.assert_close(program(images, points), Look()(images, points))
