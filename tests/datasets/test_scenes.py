"""Rendered scenes as a dataset: kept, shared, and refused where they are damaged."""

import errno
import os
import sys
import time

import numpy as np
import pytest

from ffpose.datasets.scenes import open_frames, rendered_patches
from ffpose.errors import DataError
from ffpose.imaging.patches import LABELS, PatchSpec
from ffpose.imaging.preprocessing import Preprocessing
from ffpose.render import find_scene, label, patches
from ffpose.render.dataset import manifest

ALL = (180.0, 90.0, 180.0)
COUNT, SEED = 3, 7


@pytest.fixture(scope="module")
def scene():
    return find_scene("soyuz_easy", ALL)


@pytest.fixture(scope="module")
def spec(scene):
    return PatchSpec(scene.camera.resized(64, 48), 4, 32, 6.6)


@pytest.fixture
def rendered(monkeypatch):
    """The indices of the views that were rendered since."""
    indices, render = [], patches.render_patches

    def counted(scene, seed, index, spec, content="object"):
        indices.append(index)
        return render(scene, seed, index, spec, content)

    monkeypatch.setattr(patches, "render_patches", counted)
    return indices


def opened(root, scene, spec, **changes):
    options = {"seed": SEED, "count": COUNT, "workers": 0} | changes
    return rendered_patches(root, scene, spec=spec, **options)


def test_views_hold_the_scenes_poses(tmp_path, scene, spec):
    arrays = opened(tmp_path, scene, spec)
    assert {name: (array.shape, array.dtype) for name, array in arrays.items()} == spec.shapes(
        COUNT
    )
    for index, row in enumerate(arrays["labels"]):
        np.testing.assert_array_equal(row[:7], label(scene, SEED, index).vector)
        assert row[LABELS.index("object")] == 1
    assert not any(array.flags.writeable for array in arrays.values())


def test_what_was_rendered_once_is_not_rendered_again(tmp_path, scene, spec, rendered):
    first = opened(tmp_path, scene, spec)
    assert rendered == [0, 1, 2]
    again = opened(tmp_path, scene, spec)
    assert rendered == [0, 1, 2]
    for name, array in first.items():
        np.testing.assert_array_equal(again[name], array)
    (folder,) = tmp_path.iterdir()  # and nothing unfinished beside it
    assert folder.name.startswith("views-")


@pytest.mark.parametrize("change", [{"seed": 8}, {"content": "empty"}, {"content": "decoy"}])
def test_other_views_lie_elsewhere(tmp_path, scene, spec, rendered, change):
    opened(tmp_path, scene, spec)
    other = opened(tmp_path, scene, spec, **change)
    assert len(rendered) > COUNT
    assert len(list(tmp_path.iterdir())) == 2
    assert (other["labels"][:, LABELS.index("object")] == ("content" not in change)).all()


def test_more_scenes_begin_with_those_that_are_there(tmp_path, scene, spec, rendered):
    alone = opened(tmp_path / "alone", scene, spec, count=5)
    rendered.clear()
    opened(tmp_path / "grown", scene, spec, count=2)
    (folder,) = (tmp_path / "grown").iterdir()
    folder.with_name(f"{folder.name}.bak").mkdir()  # somebody's, and none of ours
    grown = opened(tmp_path / "grown", scene, spec, count=5)
    assert rendered == [0, 1, 2, 3, 4]
    for name, array in alone.items():
        np.testing.assert_array_equal(grown[name], array)


def test_fewer_scenes_are_the_first_of_more(tmp_path, scene, spec, rendered):
    more = opened(tmp_path, scene, spec)
    rendered.clear()
    fewer = opened(tmp_path, scene, spec, count=2)
    assert rendered == []
    assert len(list(tmp_path.iterdir())) == 1
    for name, array in fewer.items():
        np.testing.assert_array_equal(array, more[name][:2])


def test_a_damaged_folder_of_fewer_scenes_is_named(tmp_path, scene, spec):
    opened(tmp_path, scene, spec, count=1)
    (folder,) = tmp_path.iterdir()
    (folder / "labels.npy").unlink()
    with pytest.raises(DataError, match=folder.name):
        opened(tmp_path, scene, spec, count=2)


def test_other_attitudes_and_another_look_lie_elsewhere(tmp_path, scene, spec):
    narrow = find_scene("soyuz_easy", (10.0, 10.0, 10.0))
    opened(tmp_path, scene, spec, count=1)
    opened(tmp_path, narrow, spec, count=1)
    opened(tmp_path, scene, PatchSpec(spec.camera, 4, 32, 7.0), count=1)
    assert len(list(tmp_path.iterdir())) == 3


@pytest.mark.parametrize(
    "damage",
    [
        lambda path: path.unlink(),
        lambda path: path.write_bytes(b""),
        lambda path: path.write_bytes(path.read_bytes()[:-1]),
        lambda path: path.write_bytes(b"no array at all"),
    ],
)
def test_a_damaged_folder_is_named_with_what_to_do(tmp_path, scene, spec, damage):
    opened(tmp_path, scene, spec, count=1)
    (folder,) = tmp_path.iterdir()
    damage(folder / "windows.npy")
    with pytest.raises(DataError, match=r"expected patches, remove the folder to make them anew"):
        opened(tmp_path, scene, spec, count=1)


def test_a_rendering_that_is_killed_leaves_no_views(tmp_path, scene, spec, monkeypatch):
    def kill(*_, **__):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(patches, "render_patches", kill)
        with pytest.raises(KeyboardInterrupt):
            opened(tmp_path, scene, spec)
    assert list(tmp_path.iterdir()) == []
    assert len(opened(tmp_path, scene, spec)["labels"]) == COUNT


def test_leftovers_are_removed_after_a_day_and_not_before(tmp_path, scene, spec):
    old, young = tmp_path / ".ffpose-old", tmp_path / ".ffpose-young"
    for folder, hours in ((old, 25), (young, 23)):
        folder.mkdir()
        os.utime(folder, (time.time() - hours * 3600,) * 2)
    opened(tmp_path, scene, spec, count=1)
    assert not old.exists()
    assert young.exists()


def test_a_full_disk_is_met_before_anything_is_rendered(tmp_path, scene, spec, rendered):
    with pytest.raises(
        OSError, match=r"patches of 100000000000 images need at least [\d.]+ GB"
    ) as met:
        opened(tmp_path, scene, spec, count=10**11)
    assert met.value.errno == errno.ENOSPC
    assert rendered == []


@pytest.mark.skipif(sys.platform != "linux", reason="needs posix_fallocate")
def test_views_have_their_room_before_the_first_is_rendered(tmp_path, scene, spec, monkeypatch):
    """A mapped file that finds no room later would kill the process."""
    render, blocks = patches.render_patches, []

    def measured(*arguments, **options):
        files = [path.stat() for path in tmp_path.glob(".ffpose-*/*/*.npy")]
        blocks.append([512 * each.st_blocks >= each.st_size for each in files])
        return render(*arguments, **options)

    monkeypatch.setattr(patches, "render_patches", measured)
    opened(tmp_path, scene, spec, count=2)
    assert blocks[0] == [True] * len(spec.shapes(2))


@pytest.mark.parametrize("quiet", [True, False])
def test_a_bar_shows_the_rendering_of_views(tmp_path, scene, spec, monkeypatch, capsys, quiet):
    monkeypatch.setenv("FORCE_COLOR", "1")  # as on a terminal
    opened(tmp_path, scene, spec, quiet=quiet)
    assert ("rendering views" in capsys.readouterr().err) != quiet


def test_another_process_that_was_faster_is_not_in_the_way(tmp_path, scene, spec, monkeypatch):
    render = patches.render_patches

    def slowly(*arguments, **options):
        with monkeypatch.context() as patch:
            patch.setattr(patches, "render_patches", render)
            opened(tmp_path, scene, spec, count=1)  # the other process
        return render(*arguments, **options)

    monkeypatch.setattr(patches, "render_patches", slowly)
    assert len(opened(tmp_path, scene, spec, count=1)["labels"]) == 1
    assert len(list(tmp_path.iterdir())) == 1


def test_whole_images_are_of_the_scenes_from_the_first_on(tmp_path, scene):
    found = open_frames(tmp_path, scene, SEED, 4, Preprocessing((48, 64)), workers=0)
    expected = [label(scene, SEED, number).vector for number in range(4)]
    order = np.argsort([int(name.split("_")[0]) for name in found.names])
    np.testing.assert_allclose(found.poses[order], expected, atol=1e-6)
    assert found[0].image.shape == (3, 48, 64)


def test_an_unknown_set_lists_the_known():
    with pytest.raises(ValueError, match=r"scene: expected one of soyuz_easy, .*, got 'mir'"):
        find_scene("mir", ALL)


def test_images_of_other_packages_lie_elsewhere(tmp_path, scene, monkeypatch):
    """Their bytes may differ, and a set is not continued by another version."""
    open_frames(tmp_path, scene, SEED, 1, Preprocessing((48, 64)), workers=0)
    monkeypatch.setattr(manifest, "package_versions", lambda *names: dict.fromkeys(names, "0"))
    open_frames(tmp_path, scene, SEED, 1, Preprocessing((48, 64)), workers=0)
    assert len(list(tmp_path.iterdir())) == 2
