"""Frames of a motion: its laws, the light over time, and files that any number of workers write."""

import csv
import json
import re
import shutil
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image
from scipy.spatial.transform import Rotation

from ffpose import cli
from ffpose.datasets import read_records
from ffpose.datasets.csv_set import read_trajectory
from ffpose.geometry import Pose
from ffpose.geometry.trajectory import Trajectory
from ffpose.render import find_scene
from ffpose.render.dataset import sequence_writer
from ffpose.render.dataset.sequence_writer import write_sequence
from ffpose.render.motion import Orbit, sample_motion, sample_orbit
from ffpose.render.sampler import sample_surroundings, visible_share
from ffpose.render.sequence import Sequence, render_frame

SCENE = replace(find_scene("soyuz_hard"), attitude_range_deg=(180.0, 90.0, 180.0))
SIZE = (64, 48)


def rotations(q):
    return Rotation.from_quat(q, scalar_first=True)


@pytest.fixture(scope="module", params=["approach", "tumble", "flyby"])
def motion(request):
    times = np.arange(60) / 2
    return sample_motion(request.param, SCENE, times, np.random.default_rng(1))


def test_motions_stay_in_the_scenes_ranges_and_in_view(motion):
    distance = np.linalg.norm(motion.t, axis=1)
    assert distance.min() >= 8
    assert distance.max() <= 42
    outline = SCENE.build().outline
    for t, q in zip(motion.t, motion.q, strict=True):
        points = rotations(q).apply(outline) + t
        assert visible_share(points, SCENE.camera) >= SCENE.min_visible


def test_a_small_spacecraft_may_be_as_near_as_in_images():
    """A fortieth of a Soyuz, whole in front of the camera but nearer than half a meter."""
    craft = SCENE.build().scaled(1 / 40)
    near = replace(SCENE, craft=craft, distance_m=(0.3, 0.45), lateral_m=0.05)
    motion = sample_motion("tumble", near, np.arange(3) / 2, np.random.default_rng(0))
    depths = rotations(motion.q[0]).apply(craft.outline)[:, 2] + motion.t[0, 2]
    assert 0.03 < depths.min() < 0.5


def test_velocities_are_the_derivatives_of_the_poses(motion):
    np.testing.assert_allclose(np.diff(motion.t, axis=0) * 2, motion.v[1:], atol=1e-9)
    turned = (rotations(motion.q[:-1]).inv() * rotations(motion.q[1:])).as_rotvec() * 2
    np.testing.assert_allclose(turned, (motion.w[1:] + motion.w[:-1]) / 2, atol=2e-4)


def test_a_tumble_keeps_angular_momentum_and_energy():
    craft = SCENE.build()
    motion = sample_motion("tumble", SCENE, np.arange(240) / 2, np.random.default_rng(2))
    points = craft.outline - craft.outline.mean(axis=0)
    inertia = (points**2).sum() * np.eye(3) - points.T @ points
    momentum = rotations(motion.q).apply(motion.w @ inertia)
    np.testing.assert_allclose(momentum, momentum[[0]].repeat(240, 0), rtol=1e-6, atol=1e-6)
    energy = np.einsum("ni,ij,nj->n", motion.w, inertia, motion.w)
    np.testing.assert_allclose(energy, energy[0], rtol=1e-6)


def test_an_orbit_turns_once_in_its_period():
    orbit = sample_orbit(SCENE, 120, np.random.default_rng(3))
    period = 2 * np.pi / orbit.rate
    assert 91 * 60 < period < 94 * 60  # low Earth orbit, 380 to 440 km
    np.testing.assert_allclose(orbit.turn(period), np.eye(3), atol=1e-9)
    quarter = orbit.at(period / 4)
    np.testing.assert_allclose(quarter.nadir, orbit.start.nadir)
    assert abs(quarter.sun @ orbit.normal - orbit.start.sun @ orbit.normal) < 1e-12
    # what the sun lights of the ground stays: directions in the Earth's frame are those of before
    np.testing.assert_allclose(
        quarter.ground @ quarter.sun, orbit.start.ground @ orbit.start.sun, atol=1e-12
    )


def test_a_third_of_the_sequences_crosses_the_shadow():
    def crosses(seed):
        orbit = sample_orbit(SCENE, 120, np.random.default_rng([seed, 8]))
        return orbit.start.eclipsed != orbit.at(120).eclipsed

    assert 12 <= sum(map(crosses, range(60))) <= 30


def test_a_single_instant_has_light_too():
    for seed in range(12):
        orbit = sample_orbit(SCENE, 0, np.random.default_rng([seed, 8]))
        assert orbit.at(0).eclipsed == orbit.start.eclipsed


def met(orbit, seconds, count):
    return {orbit.at(time).eclipsed for time in np.linspace(0, seconds, count)}


@pytest.mark.parametrize("seconds", [120, 3000, 9000])
def test_shadows_are_those_at_many_times(seconds):
    rng, found = np.random.default_rng(4), []
    for _ in range(40):
        start = sample_surroundings(SCENE, rng)
        normal = np.cross(start.nadir, rng.standard_normal(3))
        orbit = Orbit(start, normal / np.linalg.norm(normal))
        found.append(orbit.shadows(seconds))
        assert found[-1] == met(orbit, seconds, 200)
    assert {False} in found
    assert {False, True} in found


@pytest.mark.parametrize(("rate", "seconds"), [(0.0, 600), (0.0, 6000), (1.0, 600)])
def test_where_all_or_no_images_are_in_the_shadow_no_sequence_crosses_it(rate, seconds):
    scene = replace(SCENE, eclipse_rate=rate)
    for seed in range(12):
        orbit = sample_orbit(scene, seconds, np.random.default_rng([seed, 8]))
        assert met(orbit, seconds, 100) == {rate == 1}


def test_what_is_longer_than_the_shadow_leaves_it():
    """Half an orbit: no place of the shadow is opposite another."""
    orbit = sample_orbit(replace(SCENE, eclipse_rate=1.0), 2770, np.random.default_rng(0))
    assert met(orbit, 2770, 100) == {False, True}


def test_a_steady_motion_between_the_poses_of_a_file(tmp_path):
    path = tmp_path / "motion.csv"
    turn = Rotation.from_rotvec([0, 0.1, 0])
    rows = ["qw,qx,qy,qz,tx,ty,tz,time"]
    for step in range(3):
        q = (turn**step).as_quat(scalar_first=True)
        rows.append(",".join(map(str, [*q, 1, step, 20, 10 + 2 * step])))
    path.write_text("\n".join(rows) + "\n")
    motion = read_trajectory(path)
    np.testing.assert_allclose(motion.w, [[0, 0.05, 0]] * 3, atol=1e-12)
    np.testing.assert_allclose(motion.pose(1, 0.5).t, [1, 1.25, 20])
    half = rotations(motion.pose(0, 1.0).q)
    np.testing.assert_allclose(half.as_rotvec(), [0, 0.05, 0], atol=1e-12)


def short(seed=5, frames=4):
    return Sequence.of_kind("tumble", SCENE, frames / 2, 2, seed, SIZE)


def test_files_are_a_csv_set_with_times_and_the_same_for_any_workers(tmp_path):
    sequence = short()
    write_sequence(sequence, tmp_path / "one")
    write_sequence(sequence, tmp_path / "two", workers=2)
    names = sorted(path.name for path in (tmp_path / "one").iterdir())
    for name in names:
        assert (tmp_path / "one" / name).read_bytes() == (tmp_path / "two" / name).read_bytes()
    records = read_records("csv", tmp_path / "one", "frames")
    assert [record.time for record in records] == [0, 0.5, 1, 1.5]
    for index, record in enumerate(records):
        np.testing.assert_allclose(record.pose.vector, sequence.pose(index).vector, rtol=1e-14)
    assert records[0].camera == sequence.camera
    again = write_sequence(sequence, tmp_path / "one")
    assert (again.rendered, again.kept) == (0, 4)


def test_frames_of_another_version_are_not_completed(tmp_path, monkeypatch):
    write_sequence(short(), tmp_path)
    next(iter(tmp_path.glob("frame-*.png"))).unlink()
    monkeypatch.setattr(sequence_writer, "versions_of", lambda _: {"ffpose": "0.0.1"})
    with pytest.raises(ValueError, match=r"same sequence as before, got another in \['versions"):
        write_sequence(short(), tmp_path)


def test_frames_that_are_damaged_are_rendered_again(tmp_path):
    write_sequence(short(), tmp_path)
    paths = sorted(tmp_path.glob("frame-*.png"))
    whole = [path.read_bytes() for path in paths]
    paths[0].write_bytes(b"")
    paths[1].write_bytes(whole[1][: len(whole[1]) // 2])
    Image.new("RGB", (8, 8)).save(paths[2])
    again = write_sequence(short(), tmp_path)
    assert (again.rendered, again.kept) == (3, 1)
    assert [path.read_bytes() for path in paths] == whole


def test_a_sequence_larger_than_the_disk_leaves_the_folder_as_it_was(tmp_path, monkeypatch):
    room = shutil.disk_usage(tmp_path)._replace(free=100)
    with monkeypatch.context() as patch:
        patch.setattr("shutil.disk_usage", lambda path: room)
        with pytest.raises(OSError, match="4 frames need at least"):
            write_sequence(short(), tmp_path / "new")
    assert not (tmp_path / "new").exists()
    assert write_sequence(short(6, frames=1), tmp_path / "new").rendered == 1


def test_dropped_frames_leave_the_others_as_they_are(tmp_path):
    sequence = short(frames=30)
    written = write_sequence(sequence, tmp_path / "some", drop=0.8)
    assert 2 <= written.rendered < 14
    with (tmp_path / "some/frames.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == written.rendered
    last = round(float(rows[-1]["time"]) * 2)
    with Image.open(tmp_path / "some" / rows[-1]["image"]) as image:
        np.testing.assert_array_equal(np.asarray(image), render_frame(sequence, last))


def test_a_trajectory_without_a_pose_is_refused():
    with pytest.raises(ValueError, match="trajectory: expected at least one pose"):
        Sequence.along(SCENE, Trajectory.through(np.array([]), []))


def test_fast_motion_blurs_and_a_rolling_shutter_shears():
    """A far sideways motion smears the outline along it; nothing else of the frame changes."""
    still = Trajectory.through(np.array([0.0]), [Pose([0, 0, 15], [1, 0, 0, 0])])
    moving = replace(still, v=np.array([[30.0, 0, 0]]))
    frames = []
    for trajectory, readout in ((still, 0.0), (moving, 0.0), (moving, 0.05)):
        sequence = Sequence.along(SCENE, trajectory, 3, SIZE)
        sequence = replace(sequence, exposure_s=0.05, readout_s=readout)
        frames.append(render_frame(sequence, 0).astype(float).mean(axis=2))
    assert np.abs(frames[1] - frames[0]).mean() > 1
    assert np.abs(frames[2] - frames[1]).mean() > 0.3


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("time,tx\n1,2\n", r"motion\.csv:1: expected the columns time, tx, .*, got time, tx"),
        ("time,tx,ty,tz,qw,qx,qy,qz\n", "expected at least one row"),
        ("time,tx,ty,tz,qw,qx,qy,qz\n0,0,0,9,1,0,0,0\n0,0,0,9,1,0,0,0\n", r":3: time: expected"),
        ("time,tx,ty,tz,qw,qx,qy,qz\nnan,0,0,9,1,0,0,0\n", r":2: time: expected a finite"),
        ("time,tx,ty,tz,qw,qx,qy,qz\n0,0,0,9,0,0,0,0\n", r":2: .*norm"),
        ("time,tx,ty,tz,qw,qx,qy,qz\n0,0,0,,1,0,0,0\n", r":2: tz: expected a finite"),
    ],
)
def test_files_that_are_no_motion(tmp_path, capsys, text, message):
    path = tmp_path / "motion.csv"
    path.write_text(text)
    out = str(tmp_path / "out")
    assert cli.main(["render", "soyuz_hard", "--trajectory", str(path), "--out", out]) == 1
    assert re.search(message, capsys.readouterr().err)


@pytest.mark.parametrize(
    ("options", "code", "message"),
    [
        (["soyuz_hard"], 2, "count: expected --count N"),
        (["soyuz_hard", "--seconds", "9"], 2, "seconds: expected for a motion's frames"),
        (["soyuz_hard", "--rate", "2"], 2, "rate: expected for a motion's frames"),
        (["soyuz_hard", "--drop", "0"], 2, "drop: expected for a motion's frames"),
        (["soyuz_hard", "--scene", "soyuz_easy"], 2, "scene: expected for a motion's frames"),
        (["soyuz_hard", "--mesh-scale", "2"], 2, "mesh-scale: expected with a mesh, got none"),
        (["soyuz_hard", "--mesh-up", "y"], 2, "mesh-up: expected with a mesh, got none"),
        (["approach", "--mesh-center"], 2, "mesh-center: expected with a mesh, got none"),
        (["approach", "--mesh-two-sided"], 2, "mesh-two-sided: expected with a mesh, got none"),
        (["soyuz_hard", "--trajectory", "t.csv", "--rate", "1"], 2, "rate: expected without"),
        (["soyuz_hard", "--trajectory", "t.csv", "--scene", "dragon_hard"], 2, "got --scene too"),
        (["approach", "--count", "3"], 2, "count: expected for a scene's images"),
        (["approach", "--start", "5"], 2, "start: expected for a scene's images"),
        (["approach", "--rate", "0"], 1, "expected seconds in 0…100000 and rate in 0…1000"),
        (["approach", "--drop", "1"], 2, "drop: expected a share"),
        (["approach", "--seconds", "9000"], 1, "found no motion of"),
        (["approach", "--scene", "moon"], 2, "scene: expected one of soyuz_easy"),
    ],
)
def test_options_that_contradict_themselves(tmp_path, capsys, options, code, message):
    assert cli.main(["render", *options, "--out", str(tmp_path / "out")]) == code
    assert message in capsys.readouterr().err


def test_another_sequence_or_other_files_are_not_overwritten(tmp_path):
    write_sequence(short(frames=1), tmp_path / "one")
    with pytest.raises(ValueError, match=r"same sequence as before, got another in \['poses"):
        write_sequence(short(6, frames=1), tmp_path / "one")
    (tmp_path / "one/sequence.json").write_text(json.dumps([]))
    with pytest.raises(ValueError, match="expected the parameters of a sequence"):
        write_sequence(short(frames=1), tmp_path / "one")
    (tmp_path / "other").mkdir()
    (tmp_path / "other/notes.txt").write_text("mine")
    with pytest.raises(ValueError, match="files without sequence"):
        write_sequence(short(frames=1), tmp_path / "other")
