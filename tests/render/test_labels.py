"""Labels are exact: points put through the written labels are found in the written images.

The labels are read and turned into our frame by hand here, by the definition of URSO's own frame
(x right, y up, z forward; JPL quaternion, scalar last), and not by this project's reader.
"""

import csv

import numpy as np
import pytest
from PIL import Image, ImageDraw
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from beacons import LAMPS, RADIUS, beacon_scene
from ffpose.render import SCENES, label, render_layers, write_dataset
from ffpose.render.layers import LAYERS

SIZE = (640, 480)
FX, FY, CX, CY = 320.0, 640.463 / 2, 320.0, 240.0


@pytest.fixture(scope="module", params=SCENES)
def written(request, tmp_path_factory):
    """Name and folder of a set with its layers."""
    folder = tmp_path_factory.mktemp(request.param)
    write_dataset(request.param, folder, 6, seed=2, size=SIZE, labels=LAYERS)
    return request.param, folder


@pytest.fixture(scope="module")
def lamps(tmp_path_factory):
    """Folder of a set of six lamps."""
    folder = tmp_path_factory.mktemp("lamps")
    write_dataset(beacon_scene(), folder, 12, seed=5, size=SIZE)
    return folder


def written_labels(folder):
    with (folder / "gt.csv").open() as file:
        return [{k: float(v) for k, v in row.items()} for row in csv.DictReader(file)]


def to_pixels(row, points):
    """URSO's label applied in URSO's own left-handed frame, then its pinhole camera."""
    x, y, z, s = row["q1"], row["q2"], row["q3"], row["q4"]
    # The JPL matrix is the transpose of Hamilton's for the same numbers.
    jpl = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y + z * s), 2 * (x * z - y * s)],
            [2 * (x * y - z * s), 1 - 2 * (x * x + z * z), 2 * (y * z + x * s)],
            [2 * (x * z + y * s), 2 * (y * z - x * s), 1 - 2 * (x * x + y * y)],
        ]
    )
    mirrored = np.asarray(points, dtype=float) * (1, -1, 1)
    camera = mirrored @ jpl.T + (row["x"], row["y"], row["z"])
    u = CX + FX * camera[:, 0] / camera[:, 2]
    v = CY - FY * camera[:, 1] / camera[:, 2]
    return np.stack([u, v], axis=1), camera[:, 2]


def find_lamp(image, rgb):
    """Centroid and area of the pixels that are bright in this lamp's channels alone."""
    on = np.array(rgb, dtype=bool)
    level = image[..., on].min(axis=-1) - image[..., ~on].max(axis=-1)
    weight = np.clip(level - 90.0, 0, None)
    total = weight.sum()
    if total == 0:
        return None, 0.0
    v, u = np.mgrid[: image.shape[0], : image.shape[1]] + 0.5
    return np.array([(weight * u).sum(), (weight * v).sum()]) / total, (weight > 0).sum()


def written_image(folder, index):
    return np.asarray(Image.open(folder / f"{index}_rgb.png"), dtype=float)


def test_lamps_are_where_the_written_labels_say(lamps):
    found = 0
    for index, row in enumerate(written_labels(lamps)[:8]):
        image = written_image(lamps, index)
        pixels, depth = to_pixels(row, [place for place, _ in LAMPS.values()])
        for n, (_, rgb) in enumerate(LAMPS.values()):
            radius = FX * RADIUS / depth[n]
            gaps = np.linalg.norm(np.delete(pixels, n, axis=0) - pixels[n], axis=1)
            if gaps.min() < 3 * radius + 2:
                continue  # another lamp may hide this one
            center, area = find_lamp(image, rgb)
            assert area > 0.4 * np.pi * radius**2
            assert np.abs(center - pixels[n]).max() < 1.0
            found += 1
    assert found > 25


def drawn_silhouette(row, mesh):
    """The mesh's triangles filled by Pillow on a much finer canvas, read at the pixels' centers."""
    fine = 25
    pixels, _ = to_pixels(row, mesh.vertices)
    corner = np.floor(pixels.min(axis=0)).astype(int)
    width, height = np.ceil(pixels.max(axis=0)).astype(int) - corner
    canvas = Image.new("1", (int(width) * fine, int(height) * fine))
    draw = ImageDraw.Draw(canvas)
    for triangle in np.round((pixels[mesh.faces] - corner) * fine - 0.5):
        draw.polygon([tuple(point) for point in triangle], fill=1)
    drawn = np.zeros((SIZE[1] + 2 * height, SIZE[0] + 2 * width), dtype=bool)
    left, top = np.add(corner, (width, height))
    drawn[top : top + height, left : left + width] = np.asarray(canvas)[
        fine // 2 :: fine, fine // 2 :: fine
    ]
    return drawn[height:-height, width:-width]


@pytest.mark.parametrize("name", ["soyuz_easy", "dragon_hard"])
def test_mask_is_the_silhouette_of_the_written_label(tmp_path, name):
    """A second rasterizer, which knows nothing of rays, fills the same pixels."""
    write_dataset(name, tmp_path, 2, seed=8, size=(64, 48))
    for index, row in enumerate(written_labels(tmp_path)):
        mask = render_layers(name, 8, index, SIZE).mask
        drawn = drawn_silhouette(row, SCENES[name].build().mesh)
        assert mask.sum() > 500
        assert (mask & drawn).sum() >= 0.995 * (mask | drawn).sum()


def written_keypoints(folder, index):
    with (folder / f"{index}_keypoints.csv").open() as file:
        return list(csv.DictReader(file))


def test_silhouette_and_depth_agree_with_the_written_labels(written):
    name, folder = written
    craft = SCENES[name].build()
    seen = 0
    for index, row in enumerate(written_labels(folder)):
        mask = np.asarray(Image.open(folder / f"{index}_mask.png")) > 0
        depth = np.asarray(Image.open(folder / f"{index}_depth.png")) / 1000
        assert (mask == (depth > 0)).all()
        outline, depths = to_pixels(row, craft.mesh.vertices)
        if (outline >= 0).all() and (outline <= SIZE).all():
            rows, columns = np.nonzero(mask)
            box = [columns.min(), rows.min(), columns.max() + 1, rows.max() + 1]
            # Thin antennas may slip between pixel centers, so the box may fall short by one.
            assert (
                np.abs(box - np.concatenate([outline.min(axis=0), outline.max(axis=0)])).max() < 2
            )
        inside = depth[mask]
        assert depths.min() - 1e-3 < inside.min()
        assert inside.max() < depths.max() + 1e-3
        pixels, z = to_pixels(row, list(craft.keypoints.values()))
        for n, point in enumerate(written_keypoints(folder, index)):
            assert np.hypot(*(pixels[n] - (float(point["u"]), float(point["v"])))) < 1e-6
            assert float(point["depth"]) == pytest.approx(z[n])
            seen += int(point["visible"])
    assert seen > 4


def test_mask_covers_what_differs_from_the_background(lamps):
    """Where the mask says spacecraft the image shows it: bright lamps lie inside the mask only."""
    image, layers = written_image(lamps, 0), render_layers(beacon_scene(), 5, 0, SIZE)
    for _, rgb in LAMPS.values():
        center, area = find_lamp(image, rgb)
        if area > 9:
            assert layers.mask[int(center[1]), int(center[0])]


def solve_pose(points, pixels):
    """The pose that puts points (N, 3) on pixels (N, 2): linear transform, then least squares.

    It knows the camera and nothing of this project. Returns the rotation matrix and translation.
    """
    rays = (pixels - (CX, CY)) / (FX, FY)
    homogeneous = np.column_stack([points, np.ones(len(points))])
    zero = np.zeros_like(homogeneous)
    rows = [
        np.hstack([homogeneous, zero, -rays[:, :1] * homogeneous]),
        np.hstack([zero, homogeneous, -rays[:, 1:] * homogeneous]),
    ]
    matrix = np.linalg.svd(np.concatenate(rows))[2][-1].reshape(3, 4)
    u, s, vt = np.linalg.svd(matrix[:, :3])
    sign = np.sign(np.linalg.det(u @ vt))
    start = np.concatenate(
        [Rotation.from_matrix(sign * u @ vt).as_rotvec(), sign * matrix[:, 3] / s.mean()]
    )

    def misses(pose):
        seen = Rotation.from_rotvec(pose[:3]).apply(points) + pose[3:]
        return (seen[:, :2] / seen[:, 2:] - rays).ravel()

    found = least_squares(misses, start, x_scale="jac", xtol=1e-15, ftol=1e-15, gtol=1e-15).x
    return Rotation.from_rotvec(found[:3]), found[3:]


def test_pnp_on_the_written_keypoints_gives_the_label_back(written):
    name, folder = written
    craft = SCENES[name].build()
    for index in range(6):
        rows = written_keypoints(folder, index)
        pixels = np.array([[float(row["u"]), float(row["v"])] for row in rows])
        rotation, translation = solve_pose(
            np.array([craft.keypoints[row["name"]] for row in rows]), pixels
        )
        pose = label(name, 2, index)
        truth = Rotation.from_quat(pose.q, scalar_first=True)
        assert np.degrees((rotation * truth.inv()).magnitude()) < 0.01
        assert np.linalg.norm(translation - pose.t) < 1e-3


def test_pose_solved_from_the_picture_alone_is_near_the_label(lamps):
    """Lamps found in the image itself, no layer: what is left is their centroid's error."""
    scene, places = beacon_scene(), np.array([place for place, _ in LAMPS.values()])
    errors = []
    for index in range(12):
        image, pose = written_image(lamps, index), label(scene, 5, index)
        centers = [find_lamp(image, rgb) for _, rgb in LAMPS.values()]
        if min(area for _, area in centers) < 20:
            continue  # hidden, wholly or in part
        rotation, translation = solve_pose(places, np.array([center for center, _ in centers]))
        truth = Rotation.from_quat(pose.q, scalar_first=True)
        errors.append(
            (
                np.degrees((rotation * truth.inv()).magnitude()),
                np.linalg.norm(translation - pose.t) / np.linalg.norm(pose.t),
            )
        )
    assert len(errors) >= 3
    assert (np.median(errors, axis=0) < (1.0, 0.01)).all()
