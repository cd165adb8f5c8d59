"""The file of decoded frames: what it holds, when it is made anew, and who shares it."""

import errno
import io
import os
import pickle
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from torch.utils.data import DataLoader

from ffpose.datasets import PoseDataset, Record, open_dataset
from ffpose.datasets.cache import MappedFrames, cache_folder, cached_frames
from ffpose.errors import DataError
from ffpose.geometry import Camera, DistortedCamera, Pose
from ffpose.imaging.preprocessing import Preprocessing
from ffpose.imaging.reprojection import Reprojection
from urso_sets import write_set

PREPROCESSING = Preprocessing((24, 32))
CAMERA = Camera(64, 48, 32.0, 32.0, 32.0, 24.0)
LENS = DistortedCamera(64, 48, 32.0, 32.0, 32.0, 24.0, (-0.1, 0.0, 0.0, 0.0, 0.0))


VIEW = CAMERA.cropped(8, 6, 32, 24)


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    """The cache of one test, which does not exist yet."""
    folder = tmp_path / "cache" / "deep"
    monkeypatch.setenv("FFPOSE_CACHE", str(folder))
    return folder


@pytest.fixture
def records(tmp_path):
    """Three images of noise, the last on line 3 of their list."""
    generator = np.random.default_rng(0)
    found = []
    for number in range(3):
        path = tmp_path / f"{number}.png"
        pixels = generator.integers(0, 256, (48, 64, 3), dtype=np.uint8)
        Image.fromarray(pixels).save(path)
        pose, source = Pose((0, 0, 9), (1, 0, 0, 0)), tmp_path / "list.csv"
        found.append(Record(path, path.name, CAMERA, pose, source, number + 1))
    return found


def files(folder):
    return sorted(path.name for path in folder.iterdir())


def decoded(record):
    """What Pillow itself makes of the file."""
    with Image.open(record.image) as image:
        return np.asarray(image.resize((32, 24), Image.Resampling.BILINEAR))


@pytest.fixture
def decodings(monkeypatch):
    """The names of the images that were decoded since."""
    names, decode = [], Record.decode

    def counted(record):
        names.append(record.image.name)
        return decode(record)

    monkeypatch.setattr(Record, "decode", counted)
    return names


def test_the_file_is_an_array_of_the_frames(records, folder):
    frames = cached_frames(records, PREPROCESSING)
    (name,) = files(folder)
    array = np.load(folder / name)  # any program can read it
    assert array.dtype == np.uint8
    assert array.shape == (3, 24, 32, 3)
    for index, record in enumerate(records):
        np.testing.assert_array_equal(array[index], decoded(record))
        np.testing.assert_array_equal(frames[index], decoded(record))
    with pytest.raises(ValueError, match="read-only"):
        frames[0][0, 0, 0] = 1


def test_many_frames_are_written_in_order(records, monkeypatch):
    monkeypatch.setattr("ffpose.imaging.images.WAITING", 2)
    order = [2, 0, 1, 1, 2]
    frames = cached_frames([records[number] for number in order], PREPROCESSING)
    for index, number in enumerate(order):
        np.testing.assert_array_equal(frames[index], decoded(records[number]))


def test_a_second_run_decodes_nothing(records, folder, decodings):
    cached_frames(records, PREPROCESSING)
    assert sorted(decodings) == ["0.png", "1.png", "2.png"]
    decodings.clear()
    cached_frames(records, PREPROCESSING)
    assert decodings == []
    assert len(files(folder)) == 1


def touched(records):
    os.utime(records[1].image, ns=(0, 1))
    return records, PREPROCESSING


def grown(records):
    status = records[1].image.stat()
    with records[1].image.open("ab") as file:
        file.write(b"\0")
    os.utime(records[1].image, ns=(status.st_atime_ns, status.st_mtime_ns))
    return records, PREPROCESSING


@pytest.mark.parametrize(
    "change",
    [
        touched,
        grown,
        lambda records: (records[::-1], PREPROCESSING),
        lambda records: (records[:2], PREPROCESSING),
        lambda records: ([replace(each, lens=LENS) for each in records], PREPROCESSING),
        lambda records: (records, Preprocessing((32, 24))),
        lambda records: (records, Preprocessing((24, 32), "center_crop")),
        lambda records: (records, Preprocessing((24, 32), interpolation="bicubic")),
        lambda records: (records, Reprojection.of(PREPROCESSING, CAMERA, VIEW)),
    ],
)
def test_another_set_or_frame_is_another_file(records, folder, change):
    cached_frames(records, PREPROCESSING)
    changed, preprocessing = change(records)
    cached_frames(changed, preprocessing)
    assert len(files(folder)) == 2


def test_what_the_frame_does_not_depend_on_makes_no_other_file(records, folder):
    cached_frames(records, PREPROCESSING)
    cached_frames(records, Preprocessing((24, 32), mean=(0, 0, 0)))
    assert len(files(folder)) == 1


def test_sets_of_the_same_names_do_not_meet(records, tmp_path, folder):
    """An archive may give all its files one time, and pixels without compression one size."""
    other = tmp_path / "other"
    other.mkdir()
    shutil.copy2(records[0].image, other)
    copy = replace(records[0], image=other / "0.png")
    cached_frames(records[:1], PREPROCESSING)
    cached_frames([copy], PREPROCESSING)
    assert len(files(folder)) == 2


@pytest.mark.parametrize(
    "damage",
    [
        lambda path: path.write_bytes(path.read_bytes()[:-1]),
        lambda path: path.write_bytes(path.read_bytes() + b"\0"),
        lambda path: path.write_bytes(b""),
        lambda path: path.write_bytes(b"no array at all"),
        lambda path: np.save(path, np.zeros((3, 24, 32, 4), np.uint8)),
        lambda path: np.save(path, np.zeros((3, 24, 32, 3), np.float32)),
    ],
)
def test_a_damaged_file_is_made_anew(records, folder, damage):
    path = cached_frames(records, PREPROCESSING).path
    before = path.read_bytes()
    damage(path)
    frames = cached_frames(records, PREPROCESSING)
    assert path.read_bytes() == before
    np.testing.assert_array_equal(frames[2], decoded(records[2]))


def test_it_travels_as_a_path(records):
    frames = cached_frames(records, PREPROCESSING)
    sent = pickle.dumps(frames)
    assert len(sent) < 1000 < sum(frame.nbytes for frame in frames)
    got = pickle.loads(sent)
    assert isinstance(got, MappedFrames)
    np.testing.assert_array_equal(got[1], frames[1])


@pytest.mark.parametrize("method", ["fork", pytest.param("spawn", marks=pytest.mark.slow)])
def test_workers_map_the_file_however_they_start(tmp_path, method):
    root = write_set(tmp_path / "set")
    plain = open_dataset("urso", root, "train", PREPROCESSING)
    expected = [plain[index].image for index in range(2)]
    cached = open_dataset("urso", root, "train", PREPROCESSING, cache=True)
    for image in (root / "images").iterdir():
        image.unlink()
    loader = DataLoader(cached, batch_size=1, num_workers=1, multiprocessing_context=method)
    for batch, image in zip(loader, expected, strict=True):
        np.testing.assert_array_equal(batch.image[0], image)


def test_a_data_set_travels_without_its_frames(records):
    large = Preprocessing((480, 640))
    dataset = PoseDataset(records, large, cache=True)
    assert len(pickle.dumps(dataset)) < 10_000 < 3 * 480 * 640 * 3


def test_an_image_that_cannot_be_used_leaves_nothing(records, folder):
    content = records[2].image.read_bytes()
    records[2].image.write_bytes(content[: len(content) // 2])
    with pytest.raises(DataError, match=r"list\.csv:3: .*2\.png: cannot be read as an image"):
        cached_frames(records, PREPROCESSING)
    assert files(folder) == []


def test_an_image_that_is_gone_is_named(records):
    records[1].image.unlink()
    with pytest.raises(DataError, match=r"list\.csv:2: .*1\.png: no such file"):
        cached_frames(records, PREPROCESSING)


def test_a_faster_process_whose_file_cannot_be_replaced_is_as_good(records, folder, monkeypatch):
    """As on Windows, where that process maps it."""

    def refuse(written, target):
        shutil.copy(written, target)
        raise PermissionError(errno.EACCES, "mapped", str(target))

    monkeypatch.setattr(Path, "replace", refuse)
    np.testing.assert_array_equal(cached_frames(records, PREPROCESSING)[2], decoded(records[2]))
    assert len(files(folder)) == 1


def test_a_cache_larger_than_the_disk_is_refused_at_once(records, folder, monkeypatch, decodings):
    room = shutil.disk_usage("/")._replace(free=3 * 24 * 32 * 3 - 1)
    monkeypatch.setattr("shutil.disk_usage", lambda path: room)
    with pytest.raises(OSError, match=r"frames of 3 images .FFPOSE_CACHE names another") as caught:
        cached_frames(records, PREPROCESSING)
    assert caught.value.errno == errno.ENOSPC
    assert decodings == []


def test_a_disk_that_fills_up_is_an_error_and_leaves_nothing(records, folder, monkeypatch):
    class FullDisk(io.BytesIO):
        def write(self, data):
            if self.tell() > 2000:
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            return super().write(data)

    monkeypatch.setattr("pathlib.Path.open", lambda path, mode: FullDisk())
    with pytest.raises(OSError, match=r"frames of 3 images .* need 0\.0 GB") as caught:
        cached_frames(records, PREPROCESSING)
    assert caught.value.filename == str(folder)
    assert files(folder) == []


def test_without_the_variable_it_lies_in_the_users_cache(monkeypatch, tmp_path):
    monkeypatch.delenv("FFPOSE_CACHE")
    monkeypatch.setenv("HOME", str(tmp_path))
    assert cache_folder() == tmp_path / ".cache" / "ffpose"
