"""`ffpose track` on a small sequence: its files, and frames, times and states that are none."""

import csv

import numpy as np
import pytest
from PIL import Image
from scipy.spatial.transform import Rotation

from ffpose.cli import main
from ffpose.config import NetworkConfig
from ffpose.datasets.csv_set import read_trajectory
from ffpose.errors import DataError
from ffpose.geometry import Camera, Pose, PoseUncertainty
from ffpose.geometry.symmetry import IDENTITY
from ffpose.tracking import Settings, Step, Tracker
from ffpose.tracking.errors import track_errors
from ffpose.tracking.follow import (
    COLUMNS,
    OVERLAY,
    REPORT,
    TRAJECTORY,
    Followed,
    follow,
    run,
    write_trajectory,
)
from ffpose.tracking.frames import Frame, read_frames
from ffpose.tracking.report import write_overlay

CAMERA = Camera(64, 48, 60.0, 60.0, 32.0, 24.0)
SAID = np.diag([0.01, 0.01, 0.04]), 1e-3 * np.eye(3)


class Estimator:
    """A network that reads the pose from the brightness of the frame: its number."""

    class metadata:
        locates = "object"
        config, tracking = NetworkConfig(), None
        symmetry = IDENTITY

    camera = CAMERA
    near = white = None

    def __init__(self, poses):
        self.poses = poses

    def preprocess(self, path):
        with Image.open(path) as image:
            if image.size != (64, 48):
                raise ValueError(f"image: expected 64x48, got {image.size}")
            return np.full((3, 48, 64), image.getpixel((0, 0))[0], np.float32)

    def estimate(self, inputs, points=None):
        return [self.poses[int(one[0, 0, 0])] for one in inputs]


def pose(step, in_view=1.0):
    turn = Rotation.from_rotvec([0, 0.02 * step, 0])
    said = PoseUncertainty(*SAID, in_view, 0.5)
    return Pose([0.1, 0, 20 - 0.05 * step], turn.as_quat(scalar_first=True), said)


def frames(folder, count, time=lambda step: step / 2):
    folder.mkdir(exist_ok=True)
    for step in range(count):
        Image.new("RGB", (64, 48), (step, 0, 0)).save(folder / f"{step}.png")
    truth = [Pose(pose(step).t, pose(step).q) for step in range(count)]
    return [Frame(folder / f"{step}.png", time(step), truth[step]) for step in range(count)]


def rows(out):
    with (out / "trajectory.csv").open(encoding="utf-8") as file:
        return list(csv.DictReader(file))


def test_a_row_for_each_frame_and_the_other_files(tmp_path):
    poses = [pose(step, 0.01 if step in (20, 21) else 1.0) for step in range(30)]
    out = tmp_path / "out"
    run(Estimator(poses), frames(tmp_path / "set", 30), out)
    table = rows(out)
    assert tuple(table[0]) == COLUMNS
    assert [row["reason"] for row in table[:4]] == ["acquiring"] * 3 + ["accepted"]
    assert [row["reason"] for row in table[19:23]] == ["accepted", "flagged", "flagged", "accepted"]
    assert [row["accepted"] for row in table[19:23]] == ["1", "0", "0", "1"]
    assert table[0]["tx"] == ""
    assert table[20]["tx"] != ""
    last = {name: float(table[-1][name]) for name in COLUMNS if name != "reason"}
    assert last["time"] == 14.5
    assert abs(last["tz"] - (20 - 0.05 * 29)) < 0.1
    assert abs(last["vz"] + 0.1) < 0.05
    assert abs(last["wy"] - np.degrees(0.04)) < 1
    assert all(last[name] > 0 for name in COLUMNS if name.startswith("sd_"))
    page = (out / "report.html").read_text(encoding="utf-8")
    assert page.count("data:image/png;base64") == 3
    with Image.open(out / "overlay.webp") as overlay:
        assert overlay.size == (480, 360)
        assert overlay.n_frames > 1  # frames that look the same are one


@pytest.mark.parametrize("posed", [[], [6], [0, 5, 9]])
def test_true_poses_may_be_known_for_some_frames_or_none(tmp_path, monkeypatch, posed):
    """As a user brings a sequence: images, and a file of their times."""
    sequence, out = frames(tmp_path / "set", 12), tmp_path / "out"
    header, empty = "image,time", ""
    if posed:
        header, empty = header + ",tx,ty,tz,qw,qx,qy,qz", ",,,,,,,"
    lines = [header]
    for step, one in enumerate(sequence):
        values = [*one.pose.t, *one.pose.q] if step in posed else []
        lines.append(f"{step}.png,{one.time}" + ("".join(f",{v}" for v in values) or empty))
    (tmp_path / "times.csv").write_text("\n".join(lines) + "\n")
    network = Estimator([pose(step) for step in range(12)])
    monkeypatch.setattr("ffpose.inference.load.load", lambda *_, **__: network)
    words = ["track", "soyuz", tmp_path / "set", "--times", tmp_path / "times.csv", "--out", out]
    assert main(list(map(str, words))) == 0
    assert {path.name for path in out.iterdir()} == {TRAJECTORY, REPORT, OVERLAY}
    page = (out / REPORT).read_text(encoding="utf-8")
    assert page.count("data:image/png;base64") == 3
    assert ("Errors, true minus estimated" in page) == (len(posed) > 1)
    assert [row["reason"] for row in rows(out)[3:]] == ["accepted"] * 9


def test_the_true_velocity_of_one_pose_is_not_known(tmp_path):
    sequence = [
        one._replace(pose=one.pose if one.time == 5 else None) for one in frames(tmp_path, 20)
    ]
    network = Estimator([pose(step) for step in range(20)])
    measured = track_errors(list(follow(network, sequence, Tracker())))
    seen = np.isfinite(measured.errors[10])
    assert seen.tolist() == 2 * [*3 * [True], *3 * [False]]
    assert not np.isfinite(measured.nees).any()
    assert not np.isfinite(np.delete(measured.errors, 10, 0)).any()


def test_an_image_that_cannot_be_used_is_coasted_over_and_told(tmp_path):
    sequence = frames(tmp_path / "set", 12)
    (tmp_path / "set/6.png").unlink()
    Image.new("RGB", (48, 48)).save(tmp_path / "set/8.png")
    with pytest.raises(DataError, match=r"2 of 12 images have no pose; the first: .*6\.png"):
        run(Estimator([pose(step) for step in range(12)]), sequence, tmp_path / "out")
    table = rows(tmp_path / "out")
    assert "6.png" in table[6]["reason"]
    assert "48x48" not in table[6]["reason"]
    assert "expected 64x48" in table[8]["reason"]
    assert table[6]["tx"] != ""
    assert table[6]["accepted"] == "0"


def test_an_empty_sky_has_no_track(tmp_path):
    poses = [pose(step, 0.0) for step in range(8)]
    with pytest.raises(DataError, match="no track: of 8 frames 8 are flagged"):
        run(Estimator(poses), frames(tmp_path / "set", 8), tmp_path / "out")
    assert [row["tx"] for row in rows(tmp_path / "out")] == [""] * 8


def test_fewer_poses_than_must_agree_are_no_track(tmp_path):
    poses = [pose(step, 1.0 if step else 0.0) for step in range(3)]
    message = "of 3 frames 1 are flagged, and a track needs 4 poses that agree, got 2$"
    with pytest.raises(DataError, match=message):
        run(Estimator(poses), frames(tmp_path / "set", 3), tmp_path / "out")
    message = "of 1 frames 0 are flagged, and a track needs 3 poses that agree, got 1$"
    with pytest.raises(DataError, match=message):
        run(
            Estimator([pose(0)]),
            frames(tmp_path / "one", 1),
            tmp_path / "out",
            settings=Settings(agreeing=3),
        )


def test_frames_that_are_too_far_apart_are_told(tmp_path):
    poses, sequence = (
        [pose(step) for step in range(6)],
        frames(tmp_path / "set", 6, lambda s: 20 * s),
    )
    with pytest.raises(DataError, match=r"flagged, and all are more than 10 s apart, .* coasting$"):
        run(Estimator(poses), sequence, tmp_path / "out")
    settings = Settings(coasting=50)
    run(Estimator(poses), sequence, tmp_path / "out", settings=settings)


def test_what_was_done_before_an_interruption_is_written(tmp_path):
    class Stopped(Estimator):
        def estimate(self, inputs, points=None):
            if inputs[0, 0, 0, 0] == 7:
                raise KeyboardInterrupt
            return super().estimate(inputs)

    poses = [pose(step) for step in range(12)]
    with pytest.raises(KeyboardInterrupt):
        run(Stopped(poses), frames(tmp_path / "set", 12), tmp_path / "out")
    assert len(rows(tmp_path / "out")) == 7


class OfCameras(Estimator):
    class metadata(Estimator.metadata):
        locates = "camera"


class Unsure(Estimator):
    def estimate(self, inputs, points=None):
        return [Pose(one.t, one.q) for one in super().estimate(inputs)]


class Interrupted(Estimator):
    def estimate(self, inputs, points=None):
        raise KeyboardInterrupt


@pytest.mark.parametrize(
    ("network", "error", "message"),
    [
        (OfCameras, ValueError, "expected some that locate an object, got ones of a camera"),
        (Unsure, ValueError, "pose: expected one with uncertainty, got one without"),
        (Interrupted, KeyboardInterrupt, None),
    ],
)
def test_a_run_without_a_frame_leaves_what_an_earlier_one_wrote(tmp_path, network, error, message):
    sequence, out = frames(tmp_path / "set", 12), tmp_path / "out"
    poses = [pose(step) for step in range(12)]
    run(Estimator(poses), sequence, out)
    before = {path.name: path.read_bytes() for path in out.iterdir()}
    with pytest.raises(error, match=message):
        run(network(poses), sequence, out)
    assert {path.name: path.read_bytes() for path in out.iterdir()} == before


def test_a_trajectory_is_a_motion_where_there_is_a_track(tmp_path):
    poses, path = [pose(step) for step in range(12)], tmp_path / TRAJECTORY
    followed = list(follow(Estimator(poses), frames(tmp_path / "set", 12), Tracker()))
    write_trajectory(followed, path)
    motion = read_trajectory(path)
    np.testing.assert_array_equal(motion.times, np.arange(3, 12) / 2)
    tracked = [each.step.estimate for each in followed[3:]]
    np.testing.assert_array_equal(motion.t, [one.t for one in tracked])
    np.testing.assert_allclose(motion.q, [one.q for one in tracked], rtol=1e-14)
    write_trajectory(followed[:3], path)
    with pytest.raises(DataError, match=r"csv: expected at least one row with a pose, got none"):
        read_trajectory(path)


def test_an_overlay_has_no_more_frames_than_fit_in_memory(tmp_path, monkeypatch):
    read = []

    def read_rgb(path, white):
        read.append(int(path.stem))
        return Image.new("RGB", (64, 48))

    monkeypatch.setattr("ffpose.tracking.report.read_rgb", read_rgb)
    network = Estimator([pose(step) for step in range(12)])
    followed = list(follow(network, frames(tmp_path / "set", 12), Tracker()))
    for most, shown in ((12, range(12)), (11, range(0, 12, 2)), (4, range(0, 12, 3))):
        monkeypatch.setattr("ffpose.tracking.report.MOST_PICTURES", most)
        read.clear()
        write_overlay(followed, CAMERA, tmp_path / OVERLAY)
        assert read == list(shown)


@pytest.mark.parametrize(
    ("outcome", "accepted"),
    [("accepted", True), ("switched", True), ("switched", False), ("gated", False)],
)
def test_a_border_marks_frames_that_did_not_correct_the_track(tmp_path, outcome, accepted):
    estimate = Tracker(Settings(agreeing=1)).step(0, pose(0)).estimate
    step = Step(0.0, outcome, accepted, estimate, None, None)
    (black,) = frames(tmp_path / "set", 1)
    write_overlay([Followed(black, None, step, outcome)], CAMERA, tmp_path / OVERLAY)
    with Image.open(tmp_path / OVERLAY) as overlay:
        corner = np.asarray(overlay.convert("RGB"))[1, 1]
    assert (corner.max() > 128) == (not accepted)


TIMES = "image,time\na.png,0\nb.png,0.5\n"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (TIMES.replace("0.5", "0"), r"t\.csv:3: time: expected later than 0\.0 s, .* got 0\.0 s"),
        (TIMES.replace("0.5", "-1"), r"t\.csv:3: time: expected later"),
        (TIMES.replace("0.5", "nan"), r"t\.csv:3: time: expected a finite number"),
        (TIMES.replace("time", "when"), r"t\.csv:1: expected the columns image, time"),
        (
            TIMES.replace("time", "time,tx,ty,tz,qw,qx,qy,qz")
            .replace("0\n", "0,,,,,,,\n")
            .replace("0.5", "0.5,1,2,,1,0,0,0"),
            r"t\.csv:3: tz: expected a finite number, got ''",
        ),
        (TIMES.replace("b.png", "a.png"), r"t\.csv:3: a\.png is on line 2 already"),
        ("image,time\n", r"t\.csv: expected at least one row"),
    ],
)
def test_times_that_are_none(tmp_path, text, message):
    path = tmp_path / "t.csv"
    path.write_text(text)
    with pytest.raises(DataError, match=message):
        read_frames(tmp_path, path)


def test_folders_without_times(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"frames\.csv, or another file as --times"):
        read_frames(tmp_path)


def test_a_column_of_cameras_names_the_folders(tmp_path):
    times, table = tmp_path / "t.csv", "image,time,camera\na.png,0,camera.json\nb.png,1,{}\n"
    for name in ("camera.json", "lens.json"):
        CAMERA.write(tmp_path / name)
    times.write_text(table.format("./camera.json"))
    assert [frame.image.name for frame in read_frames(tmp_path, times)] == ["a.png", "b.png"]
    for name, message in (
        ("lens.json", r"camera: expected camera\.json in each row, .*, got lens\.json: copy it"),
        ("none.json", r"expected .*none\.json, got no such file"),
    ):
        times.write_text(table.format(name))
        with pytest.raises(DataError, match=rf"t\.csv:3: {message}"):
            read_frames(tmp_path, times)


def test_images_that_are_not_listed_are_counted(tmp_path, caplog):
    folder, times = tmp_path / "set", tmp_path / "t.csv"
    frames(folder, 3)
    for name in ("a", "b"):
        frames(folder / name, 2)
    (folder / "notes.txt").touch()
    times.write_text("image,time\n0.png,0\na/1.png,1\n")
    assert len(read_frames(folder, times)) == 2
    told = f"{folder}: 3 images are left out, as {times} does not list them"
    assert caplog.messages == [told]  # 1.png, 2.png and a/0.png
    caplog.clear()
    times.write_text("image,time\n" + "".join(f"b/{step}.png,{step}\n" for step in range(2)))
    for step in range(3):
        (folder / f"{step}.png").unlink()
    read_frames(folder, times)
    assert not caplog.messages


def test_errors_are_those_of_hand_made_tracks():
    """The first frame is believed as it is; the second truth is 1 m and 10 degrees away."""
    tracker = Tracker(Settings(agreeing=1))
    followed = []
    for step in range(3):
        seen = pose(step)
        turn = Rotation.from_quat(seen.q, scalar_first=True)
        true = turn * Rotation.from_rotvec(np.radians([10, 0, 0]) * step)
        truth = Pose(seen.t + np.array([step, 0, 0]), true.as_quat(scalar_first=True))
        taken = tracker.step(step, seen)
        followed.append(Followed(Frame("none", step, truth), seen, taken, taken.outcome))
    measured = track_errors(followed)
    np.testing.assert_allclose(measured.alone, [[0, 0], [1, 10], [2, 20]], atol=1e-9)
    np.testing.assert_allclose(measured.errors[0, :3], 0, atol=1e-12)
    np.testing.assert_allclose(measured.since, [0, 1, 2])
