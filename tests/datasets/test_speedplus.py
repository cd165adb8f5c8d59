"""The SPEED+ reader on a set made by hand: three domains, and a camera with distortion."""

import json

import numpy as np
import pytest
from PIL import Image

from ffpose.datasets import Decoding, list_splits, open_dataset
from ffpose.errors import DataError
from ffpose.geometry import Camera, DistortedCamera
from ffpose.imaging.preprocessing import Preprocessing
from ffpose.imaging.transforms import Augmentation
from speedplus_sets import CAMERA, write_speedplus

PREPROCESSING = Preprocessing(size=(24, 32))


@pytest.fixture
def root(tmp_path):
    return write_speedplus(tmp_path)


def read(root, split="train", **options):
    return open_dataset("speedplus", root, split, PREPROCESSING, **options)


def test_splits_are_the_domains(root):
    assert list_splits("speedplus", root) == ["train", "val", "lightbox", "sunlamp"]
    assert read(root, "all").names == [
        "synthetic/images/img000001.jpg",
        "synthetic/images/img000002.jpg",
        "lightbox/images/img000001.jpg",
        "sunlamp/images/img000001.jpg",
    ]


def test_the_origin_is_projected_through_the_lens(root):
    """At (1, -0.5, 4): x = 0.25, y = -0.125, r² = 0.078125."""
    x, y, r2 = 0.25, -0.125, 0.078125
    k1, k2, p1, p2, k3 = CAMERA["distCoeffs"]
    radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
    u = 96 + 298.857 * (x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x))
    v = 60 + 298.834 * (y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y)
    record = read(root).records[0]
    np.testing.assert_allclose(record.pose.project([0, 0, 0], record.camera), [u, v], rtol=1e-12)


def test_undistorted_images_are_those_of_a_pinhole(root):
    image = np.zeros((120, 192), np.uint8)
    camera = read(root).camera
    u, v = camera.project([1.0, -0.5, 4.0])
    rows, columns = np.mgrid[:120, :192] + 0.5
    image = np.rint(255 * np.exp(-((columns - u) ** 2 + (rows - v) ** 2) / 8)).astype(np.uint8)
    Image.fromarray(image).save(root / "synthetic/images/img000001.jpg", quality=98)
    dataset = read(root, decoding=Decoding(undistort=True))
    pinhole = (192, 120, 298.857, 298.834, 96.0, 60.0)
    assert dataset.camera == Camera(*pinhole)
    seen = np.asarray(dataset.load_image(0))[..., 0].astype(float)
    seen[seen < 20] = 0
    found = np.array([(seen * columns).sum(), (seen * rows).sum()]) / seen.sum()
    np.testing.assert_allclose(found, [96 + 298.857 / 4, 60 - 298.834 / 8], atol=0.1)


def test_a_camera_with_distortion_cannot_be_turned(root):
    with pytest.raises(ValueError, match="cameras without distortion"):
        read(root, augmentation=Augmentation(roll=10))
    turned = read(root, augmentation=Augmentation(roll=10), decoding=Decoding(undistort=True))
    assert turned[0].image.shape == (3, 24, 32)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"ppx": None}, "expected the key ppx"),
        ({"ppx": 0}, "ppx: expected a positive number"),
        ({"distCoeffs": [0, 0, 0, 0]}, "distCoeffs: expected 5 numbers"),
        ({"Nu": 192.5}, "Nu: expected a whole number"),
        ({"Nu": -3}, "expected a positive size"),
        ({"fx": 0.0176}, r"fx / ppx: expected 298\.857 as in cameraMatrix"),
        ({"ccy": 61}, r"ccy: expected 60"),
        ({"cameraMatrix": [[1, 0, 0], [0, 1, 0]]}, "cameraMatrix: expected three rows"),
        ({"cameraMatrix": [[1, 0], [0, 1], [0, 0]]}, "cameraMatrix row 0: expected 3 numbers"),
        ({"cameraMatrix": [[298.857, 1, 96], [0, 298.834, 60], [0, 0, 1]]}, "expected .fx 0 cx"),
        ({"cameraMatrix": [[float("nan"), 0, 96], [0, 1, 60], [0, 0, 1]]}, "finite number"),
    ],
)
def test_a_bad_camera_is_named(root, changes, words):
    values = {key: value for key, value in (CAMERA | changes).items() if value is not None}
    (root / "camera.json").write_text(json.dumps(values))
    with pytest.raises(DataError, match=rf"camera\.json: .*{words}"):
        read(root)


def test_a_set_without_camera_or_split_is_not_found(root):
    (root / "sunlamp/test.json").unlink()
    with pytest.raises(FileNotFoundError, match=r"sunlamp/test\.json, got no such file"):
        read(root, "sunlamp")
    (root / "camera.json").unlink()
    with pytest.raises(FileNotFoundError, match=r"camera\.json"):
        read(root)


def test_an_unlabeled_domain_is_not_opened_as_labeled(root):
    (root / "sunlamp/test.json").write_text('[{"filename": "img000001.jpg"}]')
    with pytest.raises(DataError, match=r"sunlamp/test\.json:1: .*expected a label"):
        read(root, "sunlamp")


def test_the_camera_has_the_published_order_of_coefficients(root):
    assert isinstance(read(root).camera, DistortedCamera)
    assert read(root).camera.distortion == tuple(CAMERA["distCoeffs"])
