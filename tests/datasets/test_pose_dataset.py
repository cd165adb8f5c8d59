"""The torch side of a dataset: samples, batches, cache and augmentation."""

import json
from dataclasses import asdict

import numpy as np
import pytest
import torch
from PIL import Image
from torch.utils.data import DataLoader

from ffpose.datasets import PoseDataset, Sample, open_dataset
from ffpose.geometry import Camera, Pose
from ffpose.imaging.preprocessing import Preprocessing
from ffpose.imaging.transforms import Augmentation
from urso_sets import POSES, SPLITS, write_set

SIZE = (24, 32)


@pytest.fixture
def root(tmp_path):
    return write_set(tmp_path)


def read(root, augmentation=None, cache=False, **preprocessing):
    return open_dataset(
        "urso", root, "train", Preprocessing(SIZE, **preprocessing), augmentation, cache
    )


def assert_same(one, other):
    for a, b in zip(one, other, strict=True):
        torch.testing.assert_close(a, b, rtol=0, atol=0)


def test_a_sample_holds_image_label_and_index(root):
    sample = read(root)[1]
    assert sample.image.shape == (3, *SIZE)
    assert {tensor.dtype for tensor in sample[:3]} == {torch.float32}
    expected = torch.tensor(POSES[SPLITS["train"][1]])
    torch.testing.assert_close(torch.cat([sample.translation, sample.orientation]), expected)
    assert sample.index == 1
    # URSO's camera is of 1280x960: 40 pixels to one along both axes.
    expected = [16, 640.463 / 40, 16, 12]
    np.testing.assert_allclose(sample.intrinsics, expected, rtol=1e-12)


def test_the_image_is_what_the_preprocessing_makes_of_the_file(root):
    dataset = read(root)
    assert_same([dataset[0].image], [dataset.preprocessing(dataset.load_image(0))])


def test_indices_count_from_the_end_and_stop(root):
    dataset = read(root)
    assert_same(dataset[-1], dataset[1])
    assert len(dataset) == 2
    with pytest.raises(IndexError):
        dataset[2]


@pytest.mark.parametrize("mode", ["resize", "center_crop"])
def test_the_cache_changes_nothing_but_needs_no_file(root, mode):
    plain = list(read(root, mode=mode))
    cached = read(root, cache=True, mode=mode)
    for image in (root / "images").iterdir():
        image.unlink()
    for index in range(2):
        assert_same(cached[index], plain[index])


def test_augmentation_is_drawn_anew_and_repeats_under_a_seed(root):
    dataset = read(root, Augmentation(roll=180.0), cache=True)
    torch.manual_seed(0)
    first, second = dataset[0], dataset[0]
    assert not torch.equal(first.image, second.image)
    assert not torch.equal(first.orientation, second.orientation)
    torch.manual_seed(0)
    assert_same(dataset[0], first)


def test_the_cache_stays_as_it_was_under_augmentation(root):
    dataset = read(root, Augmentation(), cache=True)
    for _ in range(3):
        dataset[0]
    dataset.augmentation = None
    assert_same(dataset[0], read(root)[0])


@pytest.mark.parametrize("workers", [0, 2])
@pytest.mark.parametrize("cache", [False, True])
def test_a_loader_gives_batches_of_samples(root, workers, cache):
    loader = DataLoader(read(root, cache=cache), batch_size=2, num_workers=workers)
    (batch,) = loader
    assert isinstance(batch, Sample)
    assert batch.image.shape == (2, 3, *SIZE)
    assert batch.index.tolist() == [0, 1]
    assert batch.intrinsics.shape == (2, 4)
    expected = np.stack([POSES[name] for name in SPLITS["train"]])
    np.testing.assert_allclose(torch.cat(batch[1:3], dim=1).numpy(), expected, rtol=1e-6)


@pytest.mark.parametrize("crop", ["random_crop", "turned_crop"])
def test_a_crop_needs_room(root, crop):
    with pytest.raises(ValueError, match=rf"{crop} expects .*'center_crop', got 'resize'"):
        read(root, Augmentation(**{crop: True}))
    dataset = read(root, Augmentation(**{crop: True}), mode="center_crop")
    assert dataset[0].image.shape == (3, *SIZE)


@pytest.fixture
def beacon(tmp_path):
    """A CSV set whose only image shows a bright spot where its label has the object's origin."""
    camera = Camera(640, 480, 900.0, 880.0, 310.0, 255.0)
    pose = Pose([0.3, -0.2, 8.0], [0.5, 0.5, -0.5, 0.5])
    u, v = pose.project([0, 0, 0], camera)
    x, y = np.arange(640) + 0.5, np.arange(480) + 0.5
    spot = 255 * np.exp(-((x - u) ** 2 + (y[:, None] - v) ** 2) / (2 * 12**2))
    Image.fromarray(spot.astype(np.uint8)).save(tmp_path / "0.png")
    (tmp_path / "camera.json").write_text(json.dumps(asdict(camera)))
    row = ",".join(map(str, ["0.png", *pose.vector]))
    (tmp_path / "train.csv").write_text(f"image,tx,ty,tz,qw,qx,qy,qz\n{row}\n")
    return tmp_path


def seen_and_labeled(sample):
    """The pixel of the spot, and that to which label and intrinsics project the origin."""
    plane = sample.image[0] - sample.image[0].min()
    rows, columns = torch.meshgrid(*(torch.arange(n) + 0.5 for n in plane.shape), indexing="ij")
    seen = [float((plane * axis).sum() / plane.sum()) for axis in (columns, rows)]
    x, y, z = sample.translation.double().tolist()
    fx, fy, cx, cy = sample.intrinsics.tolist()
    return np.array(seen), np.array([fx * x / z + cx, fy * y / z + cy])


@pytest.mark.parametrize("crop", ["random_crop", "turned_crop"])
def test_a_crop_shows_the_object_where_label_and_intrinsics_have_it(beacon, crop):
    still = dict.fromkeys(("brightness", "contrast", "saturation", "noise", "blur"), 0.0)
    preprocessing = Preprocessing((96, 128), "center_crop")
    plain = open_dataset("csv", beacon, "train", preprocessing)[0]
    dataset = open_dataset(
        "csv", beacon, "train", preprocessing, Augmentation(**still, **{crop: True})
    )
    shifts = []
    for seed in range(8):
        torch.manual_seed(seed)
        sample = dataset[0]
        seen, labeled = seen_and_labeled(sample)
        np.testing.assert_allclose(seen, labeled, atol=0.1)
        shifts.append(np.abs(seen - seen_and_labeled(plain)[0]).max())
        same = {"random_crop": "translation", "turned_crop": "intrinsics"}[crop]
        assert torch.equal(getattr(sample, same), getattr(plain, same))
    assert max(shifts) > 4


def test_all_is_every_split_in_order(root):
    names = [
        name
        for split in ("train", "val", "test")
        for name in open_dataset("urso", root, split, Preprocessing(SIZE)).names
    ]
    whole = open_dataset("urso", root, "all", Preprocessing(SIZE))
    assert whole.names == names
    assert len(whole) == len(whole.poses) == sum(map(len, SPLITS.values()))


def test_all_is_what_there_is(root):
    for split in ("train", "val"):
        (root / f"{split}_images.csv").unlink()
    whole = open_dataset("urso", root, "all", Preprocessing(SIZE))
    assert whole.names == open_dataset("urso", root, "test", Preprocessing(SIZE)).names


def test_unknown_kinds_and_splits_list_the_known(root):
    with pytest.raises(ValueError, match=r"one of \['cambridge', .*'urso'\], got 'blender'"):
        open_dataset("blender", root, "train", Preprocessing())
    with pytest.raises(ValueError, match=r"expected one of \('train', 'val', 'test', 'all'\)"):
        open_dataset("urso", root, "validation", Preprocessing())


def test_a_data_set_is_not_empty(root):
    with pytest.raises(ValueError, match="at least one record"):
        PoseDataset([], Preprocessing())
