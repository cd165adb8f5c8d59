"""Tracks of the program and of its C library: those of Python, kept through a restart, in time."""

import ctypes
import hashlib
import json
import re
import shutil
import subprocess
from dataclasses import replace
from threading import Event, Thread
from time import perf_counter
from typing import ClassVar

import numpy as np
import pytest

from benchmarks.__main__ import main
from ffpose.errors import DataError
from ffpose.geometry import Pose, PoseUncertainty
from ffpose.geometry.symmetry import Axis, SymmetryGroup
from ffpose.inference.load import load
from ffpose.onnx.metadata import read_model_metadata, sealed
from ffpose.tracking import Settings, Tracker
from ffpose.tracking.tracker import read_settings
from onboard_program import CAMERA, CRATE, steady

pytest.importorskip("onnx")

HALVES = (slice(0, 7), slice(7, None))


@pytest.fixture
def models(tmp_path):
    """A model X.onnx with the looks of a track, which are ten times as sure, beside it."""
    path = tmp_path / "x.onnx"
    beside = sealed(steady(1e-4, takes_point=True))
    path.with_suffix(".track.onnx").write_bytes(beside)
    path.write_bytes(sealed(steady(1e-3, track_sha256=hashlib.sha256(beside).hexdigest())))
    return path


@pytest.fixture
def frames(tmp_path):
    """Levels of gray, by which the model tells the object's position; level 200 shows none."""
    folder = tmp_path / "frames"
    folder.mkdir()
    levels = [100, 101, 102, 103, 104, 105, 200, 107, 108, 109, 110]
    for place, level in enumerate(levels):
        (folder / f"{place}.pgm").write_bytes(gray(128, 96, level))
    return [folder / f"{place}.pgm" for place in range(len(levels))]


def gray(width, height, level):
    return f"P5 {width} {height} 255\n".encode() + bytes([level]) * (width * height)


def lines_of(frames):
    return [f"{0.5 * (place + 1)} {path}" for place, path in enumerate(frames)]


def pose_of(document):
    said = PoseUncertainty(
        np.array(document["translation_covariance_m2"]),
        np.array(document["rotation_covariance_rad2"]),
        document["in_view"],
        0.5,
        alternative=document["alternative_wxyz"],
        probabilities=document["probabilities"],
    )
    return Pose(document["translation_m"], document["orientation_wxyz"], said)


def test_a_track_is_that_of_python_for_the_same_measurements(run, models, frames):
    lines = [*lines_of(frames), "6.5", "7.0 nowhere.pgm", f"7.5 {frames[-1]}"]
    code, documents, _ = run(models, "--track", lines=lines)
    assert code == 3  # nowhere.pgm
    settings = Settings.of(read_model_metadata(models))
    assert settings == Settings(tails=4, attitude_angle=18)
    tracker = Tracker(settings)
    for document in documents:
        measured = document.get("measured")
        step = tracker.step(document["time"], None if measured is None else pose_of(measured))
        assert (document["reason"], document["accepted"]) == (step.outcome, step.accepted)
        if step.estimate is None:
            assert "translation_m" not in document
            continue
        for name, wanted in {
            "translation_m": step.estimate.t,
            "orientation_wxyz": step.estimate.q,
            "velocity_m_s": step.estimate.v,
            "angular_velocity_deg_s": step.estimate.w,
            "covariance": step.estimate.covariance,
        }.items():
            np.testing.assert_allclose(document[name], wanted, rtol=0, atol=1e-9)
    reasons = ["acquiring"] * 3 + ["accepted"] * 3 + ["flagged"] + ["accepted"] * 4
    assert [each["reason"] for each in documents] == [*reasons, "coasted", "coasted", "accepted"]
    assert "cannot be read" in documents[-2]["error"]
    # it looks where the object is expected, and everywhere after a frame that does not count
    near = [each["measured"]["translation_covariance_m2"][0][0] < 5e-4 for each in documents[:11]]
    assert near == [False] * 4 + [True] * 3 + [False] + [True] * 3


def test_a_state_is_taken_up_again(run, models, frames, tmp_path):
    state = tmp_path / "track.state"
    lines = lines_of(frames)
    whole = run(models, "--track", lines=lines)[1]
    first = run(models, "--track", "--state", state, lines=lines[:6])[1]
    second = run(models, "--track", "--state", state, lines=lines[6:])[1]
    assert [*first, *second] == whole
    assert {path.name for path in tmp_path.glob("*track.*")} == {"track.state", "x.track.onnx"}
    step = Tracker.from_state(state.read_bytes(), models.read_bytes()).step(9, None)
    assert step.outcome == "coasted"
    code, documents, (error,) = run(
        models, "--track", "--state", state, "--settings", settings_file(tmp_path, gate=20)
    )
    assert (code, documents) == (1, [])
    assert "expected one of these settings" in error
    models.write_bytes(sealed(steady(2e-3)))
    models.with_suffix(".track.onnx").unlink()
    code, documents, (error,) = run(models, "--track", "--state", state, lines=lines)
    assert (code, documents) == (1, [])
    assert "state: expected one of this model and camera, got that of another" in error


def test_attitudes_modulo_a_symmetry_continue_the_track(run, models, frames, tmp_path):
    """A network that learned canonical labels, which change between two frames that look alike."""
    models.with_suffix(".track.onnx").unlink()
    plain = sealed(steady(1e-3, turned=106))
    group = SymmetryGroup((Axis((0, 0, 1), 2), Axis((1, 0, 0), 2)))
    models.write_bytes(plain)
    documents = run(models, "--track", lines=lines_of(frames))[1]
    assert [each["reason"] for each in documents[7:]] == ["gated"] * 4
    models.write_bytes(sealed(steady(1e-3, turned=106, symmetry=group)))
    documents = run(models, "--track", lines=lines_of(frames))[1]
    tracker = Tracker(Settings.of(read_model_metadata(models)), symmetry=group)
    for document in documents:
        step = tracker.step(document["time"], pose_of(document["measured"]))
        assert document["reason"] == step.outcome
        if step.estimate is not None:
            np.testing.assert_allclose(document["orientation_wxyz"], step.estimate.q, atol=1e-9)
            np.testing.assert_allclose(document["orientation_wxyz"], [1, 0, 0, 0], atol=1e-9)
            np.testing.assert_allclose(document["covariance"], step.estimate.covariance, atol=1e-9)
    measured = [each["measured"]["orientation_wxyz"] for each in documents]
    assert measured == [[1, 0, 0, 0]] * 6 + [[0, 0, 0, 1]] * 5
    assert [each["reason"] for each in documents[7:]] == ["accepted"] * 4
    state = ["--track", "--state", tmp_path / "track.state"]
    parts = [run(models, *state, lines=lines_of(frames)[part])[1] for part in HALVES]
    assert [*parts[0], *parts[1]] == documents


def test_looks_that_a_model_was_exported_with_must_be_there(run, models, opened, library):
    beside = models.with_suffix(".track.onnx")
    beside.unlink()
    refusal = f"{beside}: expected this file, a track's looks that {models} was exported with"
    code, documents, (error,) = run(models, "--track")
    assert (code, documents) == (1, [])
    assert refusal in error
    assert opened()[0] == 2
    assert refusal.encode() in library.ffpose_error()
    with pytest.raises(FileNotFoundError, match=r"expected .*x\.track\.onnx, a track's looks"):
        load(models, track=True)
    assert run(models, "--stdin")[0] == 0  # which needs none
    load(models)


def test_looks_that_were_changed_on_purpose_are_refused(run, models, opened, library):
    """The digest of X.onnx covers X.track.onnx, which it records the digest of."""

    def digest(path):
        return hashlib.sha256(path.read_bytes()).hexdigest()

    def starts(message, *arguments):
        code, _, errors = run(models, "--track", *arguments)
        assert (code, " ".join(errors)) == (0, "") if message is None else code == 1
        assert message is None or message in errors[0]

    beside = models.with_suffix(".track.onnx")
    starts(None, "--sha256", digest(models))
    assert opened(sha256=digest(models).encode())[0] == 0
    beside.write_bytes(sealed(steady(1e-5, takes_point=True)))
    other = f"{beside}: expected SHA-256 {read_model_metadata(models).track_sha256} (of the model"
    for arguments in ((), ("--sha256", digest(models))):
        starts(other, *arguments)
    assert opened(sha256=digest(models).encode())[0] == 2
    assert other.encode() in library.ffpose_error()
    with pytest.raises(DataError, match="expected SHA-256"):
        load(models, track=True)
    # an earlier export records none, and its digest is of itself alone
    models.write_bytes(sealed(steady(1e-3)))
    starts(None)
    load(models, track=True)
    starts("expected a model that records the SHA-256 of these looks", "--sha256", digest(models))
    # of no weights that are known
    for path, graph in ((models, {}), (beside, {"takes_point": True})):
        path.write_bytes(sealed(steady(1e-3, weights_sha256=None, **graph)))
    starts("expected a track's looks of the weights of the model beside it")
    with pytest.raises(DataError, match="expected the single looks of the weights of"):
        load(models, track=True)


def test_a_clock_that_jumps_does_not_block_a_track(run, models, frames, tmp_path):
    state = tmp_path / "track.state"
    lines = lines_of(frames[:6])
    reasons = ["acquiring"] * 3 + ["accepted"] * 3
    first = run(models, "--track", "--state", state, lines=[*lines, f"1e300 {frames[0]}"])[1]
    assert [each["reason"] for each in first] == [*reasons, "lost"]
    later = [f"{10 + place / 2} {path}" for place, path in enumerate(frames[:6])]
    second = run(models, "--track", "--state", state, lines=later)[1]
    assert [each["reason"] for each in second] == reasons
    # set back where a track leads: told, until it is reset
    code, third, _ = run(models, "--track", "--state", state, lines=[lines[0], "reset", *lines])
    assert code == 3
    assert "time: expected later than 12.5 s" in third[0]["error"]
    assert third[1] == {"image": "", "accepted": False, "reason": "reset"}
    assert third[2:] == run(models, "--track", lines=lines)[1]


def test_a_state_that_cannot_be_written_is_told_before_frames(run, models, frames, tmp_path):
    state = tmp_path / "none" / "track.state"
    code, documents, (error,) = run(models, "--track", "--state", state, lines=lines_of(frames))
    assert (code, documents) == (1, [])
    assert f"{state}: cannot be written" in error
    state = tmp_path / "track.state"
    assert run(models, "--track", "--state", state)[0] == 0
    assert Tracker.from_state(state.read_bytes(), models.read_bytes()).time is None


def test_a_state_of_another_camera_is_refused(run, models, frames, tmp_path, opened, library):
    """Its position is of images that were reprojected otherwise."""
    files = {}
    for name, focal in {"wide": 40.0, "narrow": 70.0}.items():
        files[name] = tmp_path / f"{name}.json"
        replace(CAMERA, fx=focal, fy=focal).write(files[name])
    ways = {
        "own": (),
        "wide": ("--camera", files["wide"]),
        "narrow": ("--camera", files["narrow"]),
        "resized": ("--resize",),
    }
    states = {name: tmp_path / f"{name}.state" for name in ways}
    for name, words in ways.items():
        lines = lines_of(frames)[:6]
        assert run(models, "--track", "--state", states[name], *words, lines=lines)[0] == 0
    for name, words in ways.items():
        fields = {"camera": bytes(files[name])} if name in files else {"resize": name == "resized"}
        _, handle = opened(**fields)
        for other, state in states.items():
            code, _, errors = run(models, "--track", "--state", state, *words)
            assert code == (name != other), (name, other)
            assert name == other or "expected one of this model and camera" in errors[0]
            assert library.ffpose_restore(handle, bytes(state)) == (0 if name == other else 2)


def test_a_model_without_uncertainty_has_poses_alone(run, frames, tmp_path, opened, library):
    path = tmp_path / "alone.onnx"
    path.write_bytes(sealed(steady(1e-3, sure=False)))
    told = "expected a model that predicts uncertainty"
    code, documents, (error,) = run(path, "--track", lines=lines_of(frames))
    assert (code, documents) == (1, [])
    assert told in error
    assert run(path, "--stdin", lines=frames[:1])[0] == 0
    code, handle = opened(model=bytes(path))
    levels = np.full((96, 128), 100, np.uint8)
    assert (code, ask(library, handle, levels)[0]) == (0, 0)
    for image in (levels, None):
        assert move(library, handle, image, 1.0)[0] == 2
        assert library.ffpose_error().startswith(told.encode())


def settings_file(folder, **settings):
    path = folder / "settings.json"
    path.write_text(json.dumps(settings))
    return path


def test_what_is_no_track_is_told(run, models, frames, tmp_path):
    lines = [f"1 {frames[0]}", "now b.pgm", f"1 {frames[0]}", "reset a.pgm"]
    code, documents, _ = run(models, "--track", lines=lines)
    assert code == 3
    errors = [each.get("error") for each in documents]
    assert errors[3] == 'time: expected seconds before the path, got "reset"'
    assert errors[1] == 'time: expected seconds before the path, got "now"'
    assert errors[2] == "time: expected later than 1 s, the frame before, got 1 s"
    for text, message in [
        ('{"speed": 1}', "speed: expected a setting of the tracker"),
        ('{"gate": -1}', "settings.json: gate: expected a number above 0, got -1"),
        ('{"gate": 20, "gate": 30}', 'settings.json: .* each key once, got "gate" twice'),
        ('{"gate": true}', "gate: expected a number, got true"),
        ('{"gate": Infinity}', "settings.json: (gate: expected finite|expected a JSON object)"),
        ('{"gate": 1e999}', "settings.json: (gate: expected finite|expected a JSON object)"),
        ('{"gate": "-inf"}', "gate: expected .*-inf"),
        ('{"rate": "inf"}', "rate: expected a finite number above 0, got inf"),
        ("[20]", "settings.json: expected a JSON object"),
    ]:
        settings = tmp_path / "settings.json"
        settings.write_text(text)
        code, _, (error,) = run(models, "--track", "--settings", settings)
        assert code == 1
        assert re.search(message, error), error
        with pytest.raises(DataError):
            read_settings(settings, read_model_metadata(models))
    code, _, (error,) = run(models.with_suffix(".track.onnx"), "--stdin")
    assert code == 1
    assert "expected a model of whole frames" in error


def test_settings_may_be_infinite(run, models, frames, tmp_path):
    """No gate, Gaussian errors, the network's own covariances, and a track that never ends."""
    names = ("gate", "tails", "said_views", "coasting")
    settings = settings_file(tmp_path, **dict.fromkeys(names, "inf"))
    state = tmp_path / "track.state"
    words = ("--track", "--settings", settings, "--state", state)
    assert run(models, *words, lines=lines_of(frames))[0] == 0
    read = read_settings(settings, read_model_metadata(models))
    assert [getattr(read, name) for name in names] == [np.inf] * 4
    models.write_bytes(sealed(steady(1e-3, tracking=dict.fromkeys(names, np.inf))))
    models.with_suffix(".track.onnx").unlink()
    assert Settings.of(read_model_metadata(models)).gate == np.inf
    gray_far = tmp_path / "far.pgm"
    gray_far.write_bytes(gray(128, 96, 10))
    lines = [*lines_of(frames)[:6], f"99 {gray_far}"]
    assert run(models, "--track", lines=lines)[1][-1]["reason"] == "accepted"


@pytest.fixture(scope="session")
def example(program, tmp_path_factory):
    """The example in C, linked with the library."""
    if not shutil.which("cc"):
        pytest.skip("no C compiler is installed")
    path = tmp_path_factory.mktemp("c") / "track"
    library = program.parent
    command = ["cc", "-std=c11", "-Wall", "-Wextra", "-Werror", "-O1", "-o", path]
    command += [CRATE / "examples/track.c", f"-I{CRATE / 'include'}", f"-L{library}"]
    subprocess.run([*command, "-lffpose_onboard", f"-Wl,-rpath,{library}"], check=True)
    return path


@pytest.fixture
def call(example, runtime):
    def call(model, frames, seconds="0", state="-"):
        words = [example, model, runtime, "-", seconds, state, *frames]
        done = subprocess.run(words, capture_output=True, text=True, check=False)
        return done.returncode, [line.split() for line in done.stdout.splitlines()], done.stderr

    return call


def test_the_library_for_c_gives_the_tracks_of_the_program(call, run, models, frames, tmp_path):
    state = tmp_path / "c.state"
    code, rows, errors = call(models, [*frames[:8], "-", *frames[9:]], state=state)
    assert (code, errors) == (0, "")
    lines = lines_of(frames)
    lines[8] = lines[8].split()[0]
    documents = run(models, "--track", lines=lines)[1]
    names = ["accepted", "switched", "gated", "coasted", "flagged", "acquiring", "lost"]
    assert [names[int(row[1])] for row in rows] == [each["reason"] for each in documents]
    for row, document in zip(rows[3:], documents[3:], strict=True):
        wanted = [*document["translation_m"], document["covariance"][0][0]]
        np.testing.assert_array_equal([float(number) for number in row[3:]], wanted)
    assert Tracker.from_state(state.read_bytes(), models.read_bytes()).time == 5.5


def test_a_run_that_is_late_is_ended_and_the_track_coasts(call, frames, tmp_path):
    path = tmp_path / "slow.onnx"
    path.write_bytes(sealed(steady(1e-3, rounds=60)))
    code, rows, _ = call(path, frames[:2], seconds="0.01")
    assert code == 0
    assert [row[0] for row in rows] == ["1", "1"]
    code, rows, _ = call(path, [frames[0], "-"], seconds="1000")
    assert [row[0] for row in rows] == ["0", "0"]


def test_errors_for_c_are_codes_and_sentences(call, models, frames, tmp_path):
    code, _, errors = call(tmp_path / "none.onnx", frames)
    assert code == 1
    assert "cannot be read" in errors
    other = tmp_path / "other.pgm"
    other.write_bytes(gray(96, 96, 100))
    empty = tmp_path / "empty.pgm"
    empty.write_bytes(gray(0, 0, 0))
    of_16_bits, of_7_bits = tmp_path / "16.pgm", tmp_path / "7.pgm"
    of_16_bits.write_bytes(b"P5 128 96 65535\n" + bytes(2 * 128 * 96))
    of_7_bits.write_bytes(b"P5 128 96 127\n" + bytes(128 * 96))
    images = [other, frames[0], empty, "nowhere.pgm", of_16_bits, of_7_bits]
    code, rows, errors = call(models, images, state="/nowhere/at/all/x.state")
    assert code == 1
    assert "x.state: cannot be written" in errors
    assert [row[0] for row in rows] == ["2", "0", "2", "3", "3", "3"]
    assert "96x96" in " ".join(rows[0])
    assert "at most 89478485" in " ".join(rows[2])


class Words(ctypes.Structure):
    """ffpose_settings."""

    _fields_: ClassVar = [
        *((name, ctypes.c_char_p) for name in ("model", "runtime", "operators", "camera")),
        *((name, ctypes.c_char_p) for name in ("track", "sha256")),
        *((name, ctypes.c_uint32) for name in ("threads", "resize")),
    ]


class Pixels(ctypes.Structure):
    """ffpose_image."""

    _fields_: ClassVar = [
        ("pixels", ctypes.c_void_p),
        *((name, ctypes.c_uint32) for name in ("width", "height", "channels")),
        ("stride", ctypes.c_size_t),
    ]


@pytest.fixture
def library(program):
    found = sorted(program.parent.glob("*ffpose_onboard.*"))
    library = ctypes.CDLL(str(next(path for path in found if path.suffix in {".so", ".dylib"})))
    library.ffpose_error.restype = ctypes.c_char_p
    for name, kinds in {
        "pose": [ctypes.c_void_p, ctypes.c_void_p, ctypes.c_double, ctypes.c_void_p],
        "track": [
            *(ctypes.c_void_p, ctypes.c_double, ctypes.c_void_p),
            *(ctypes.c_double, ctypes.c_void_p),
        ],
        "reset": [ctypes.c_void_p],
        "save": [ctypes.c_void_p, ctypes.c_char_p],
        "restore": [ctypes.c_void_p, ctypes.c_char_p],
        "close": [ctypes.c_void_p],
    }.items():
        getattr(library, f"ffpose_{name}").argtypes = kinds
    return library


@pytest.fixture
def opened(library, runtime, models):
    """Opens a model for C; returns code and handle."""
    handles = []

    def opened(**words):
        given = {"model": bytes(models), "runtime": bytes(runtime), "threads": 1} | words
        handle = ctypes.c_void_p()
        code = library.ffpose_open(ctypes.byref(Words(**given)), ctypes.byref(handle))
        handles.append(handle)
        return code, handle

    yield opened
    for handle in handles:
        library.ffpose_close(handle)


def ask(library, handle, levels, seconds=0.0, **fields):
    """Poses levels of gray ``(h, w)``; returns the code, and the pose's numbers, position first."""
    height, width = levels.shape
    image = Pixels(levels.ctypes.data, width, height, 1, 0)
    for name, value in fields.items():
        setattr(image, name, value)
    pose = Told()
    code = library.ffpose_pose(handle, ctypes.byref(image), seconds, ctypes.byref(pose))
    return code, [np.array(numbers(getattr(pose, name))).tolist() for name, *_ in Told._fields_]


class Told(ctypes.Structure):
    """ffpose_pose_result."""

    _fields_: ClassVar = [
        ("translation_m", ctypes.c_double * 3),
        ("orientation_wxyz", ctypes.c_double * 4),
        ("translation_covariance_m2", ctypes.c_double * 3 * 3),
        ("rotation_covariance_rad2", ctypes.c_double * 3 * 3),
        ("degrees_of_freedom", ctypes.c_double * 2),
        ("alternative_wxyz", ctypes.c_double * 4),
        ("probabilities", ctypes.c_double * 2),
        ("in_view", ctypes.c_double),
        ("is_flagged", ctypes.c_int32),
    ]


class Motion(ctypes.Structure):
    """ffpose_motion."""

    _fields_: ClassVar = [
        ("time", ctypes.c_double),
        *((name, ctypes.c_int32) for name in ("outcome", "has_track", "is_accepted")),
        ("translation_m", ctypes.c_double * 3),
        ("orientation_wxyz", ctypes.c_double * 4),
        ("velocity_m_s", ctypes.c_double * 3),
        ("angular_velocity_deg_s", ctypes.c_double * 3),
        ("covariance", ctypes.c_double * 12 * 12),
        ("nis", ctypes.c_double),
    ]


def numbers(value):
    return np.ctypeslib.as_array(value) if isinstance(value, ctypes.Array) else value


def test_all_that_the_program_says_is_told_in_c(library, opened, run, frames, tmp_path):
    path = tmp_path / "x.onnx"
    path.write_bytes(sealed(steady(1e-3, rotation=2e-3)))
    poses = run(path, "--stdin", lines=frames)[1]
    motions = run(path, "--track", lines=lines_of(frames))[1]
    names = ["accepted", "switched", "gated", "coasted", "flagged", "acquiring", "lost"]
    _, handle = opened(model=bytes(path))
    for place, frame in enumerate(frames):
        levels = np.frombuffer(frame.read_bytes()[-128 * 96 :], np.uint8).reshape(96, 128)
        image = Pixels(levels.ctypes.data, 128, 96, 1, 0)
        told, document = Told(), poses[place]
        assert library.ffpose_pose(handle, ctypes.byref(image), 0.0, ctypes.byref(told)) == 0
        assert told.is_flagged == document["flagged"]
        for name, *_ in Told._fields_[:-1]:
            np.testing.assert_array_equal(numbers(getattr(told, name)), document[name])
        (code, outcome, motion), document = (
            move(library, handle, levels, (place + 1) / 2),
            motions[place],
        )
        assert (code, names[outcome], motion.time) == (0, document["reason"], document["time"])
        assert motion.is_accepted == document["accepted"]
        assert motion.has_track == ("translation_m" in document)
        for name, *_ in Motion._fields_[4:]:
            wanted = document.get(name)
            wanted = np.nan if wanted is None else wanted
            np.testing.assert_array_equal(numbers(getattr(motion, name)), wanted)
    assert {each["reason"] for each in motions} == {"acquiring", "accepted", "flagged"}


def test_a_late_frame_is_one_that_never_came(library, opened, tmp_path):
    """Late at once, or where the run is ended."""
    path = tmp_path / "slow.onnx"
    path.write_bytes(sealed(steady(1e-3, rounds=10)))
    handles = [opened(model=bytes(path))[1] for _ in range(3)]
    levels, told = np.full((96, 128), 100, np.uint8), []
    for handle, image, seconds in zip(handles, (levels, levels, None), (-1, 0.003, 0), strict=True):
        for time in (1, 2, 3, 4):
            assert move(library, handle, levels + np.uint8(time), time)[0] == 0
        code, outcome, motion = move(library, handle, image, 5.0, seconds)
        assert (code, outcome, motion.has_track) == (0 if image is None else 1, 3, 1)
        told.append([np.array(numbers(getattr(motion, name))) for name, *_ in Motion._fields_])
    for name, *values in zip(Motion._fields_, *told, strict=True):
        for value in values[1:]:
            np.testing.assert_array_equal(value, values[0], err_msg=name[0])
    assert motion.time == 5
    assert motion.translation_m[0] > (levels[0, 0] + 4) / 255  # it moved on


def test_a_run_is_ended_at_its_limit(library, opened, tmp_path):
    """Not waited for: the answer would come many times as late."""
    path = tmp_path / "slow.onnx"
    path.write_bytes(sealed(steady(1e-3, rounds=60)))
    _, handle = opened(model=bytes(path))
    levels = np.full((96, 128), 100, np.uint8)

    def took(seconds, code):
        began = perf_counter()
        assert ask(library, handle, levels, seconds)[0] == code
        return perf_counter() - began

    whole = max(took(0, 0) for _ in range(3))
    assert min(took(whole / 50, 1) for _ in range(3)) < whole / 2


def test_a_closed_handle_and_one_in_another_call_are_errors(library, opened, tmp_path):
    path = tmp_path / "slow.onnx"
    path.write_bytes(sealed(steady(1e-3, rounds=60)))
    _, handle = opened(model=bytes(path))
    levels = np.full((96, 128), 100, np.uint8)
    expected = b"handle: expected one that is open and in no other call, got one "
    done = Event()

    def work():
        while not done.is_set():  # a pose is refused, too, where the other thread rests in a call
            ask(library, handle, levels)

    works = Thread(target=work)
    works.start()
    began = perf_counter()
    while library.ffpose_reset(handle) != 2 and perf_counter() - began < 60:
        pass
    assert library.ffpose_error() == expected + b"in a call of another thread"
    done.set()
    works.join()
    assert ask(library, handle, levels)[0] == 0
    for _ in range(2):
        library.ffpose_close(handle)
        assert ask(library, handle, levels)[0] == 2
        assert library.ffpose_error() == expected + b"that is closed, or none of ffpose_open"
    assert library.ffpose_save(ctypes.c_void_p(12345), b"x.state") == 2


def test_addresses_that_no_value_has_are_refused(library, opened):
    _, handle = opened()
    buffer = ctypes.create_string_buffer(ctypes.sizeof(Motion) + 16)
    place = (ctypes.addressof(buffer) + 7) // 8 * 8 + 1
    assert library.ffpose_track(handle, 1.0, None, 0.0, ctypes.c_void_p(place)) == 2
    told = f"motion: expected an address that is a multiple of 8, got {place:#x}"
    assert library.ffpose_error() == told.encode()
    assert (
        library.ffpose_track(handle, 1.0, ctypes.c_void_p(place), 0.0, ctypes.byref(Motion())) == 2
    )
    assert library.ffpose_error().startswith(b"image: expected an address that is a multiple of 8")


def test_text_for_c_is_as_it_should_be(library, opened):
    _, handle = opened()
    for function in (library.ffpose_save, library.ffpose_restore):
        assert function(handle, b"/nowhere/\xff.state") == 2
        assert library.ffpose_error().startswith(b"path: expected UTF-8, got")
    assert opened(sha256=b"12ab")[0] == 2
    assert library.ffpose_error() == b"settings.sha256: expected 64 hexadecimal digits, got 12ab"


def move(library, handle, levels, time, seconds=0.0):
    """Moves a track on; returns code, outcome and the motion."""
    motion = Motion()
    image = None
    if levels is not None:
        height, width = levels.shape
        image = ctypes.byref(Pixels(levels.ctypes.data, width, height, 1, 0))
    code = library.ffpose_track(handle, time, image, seconds, ctypes.byref(motion))
    return code, motion.outcome, motion


def test_a_limit_for_c_may_be_any_number(library, opened):
    _, handle = opened()
    levels = np.full((96, 128), 100, np.uint8)
    for seconds in (0, -0.0, 60, 1e18, 1e19, 1e300, np.inf):
        assert ask(library, handle, levels, seconds)[0] == 0, seconds
    for seconds in (1e-9, -1, -np.inf):
        assert ask(library, handle, levels, seconds)[0] == 1, seconds
    assert ask(library, handle, levels, np.nan)[0] == 2
    assert library.ffpose_error() == b"seconds: expected a number, got NaN"


def test_a_limit_below_zero_is_late_before_the_image_is_looked_at(library, opened):
    _, handle = opened()
    square = np.full((96, 96), 100, np.uint8)  # of no camera of the model's
    assert ask(library, handle, square)[0] == 2
    assert ask(library, handle, square, -1)[0] == 1
    assert ask(library, handle, square, 1e-9)[0] == 1
    assert ask(library, handle, square, 0, channels=2)[0] == 2
    assert ask(library, handle, square, -1, channels=2)[0] == 1
    assert move(library, handle, square, 1.0, -1)[:2] == (1, 5)
    assert move(library, handle, square, 2.0, 0)[0] == 2


def test_a_track_for_c_is_reset(library, opened):
    _, handle = opened()
    levels = np.full((96, 128), 100, np.uint8)

    def outcomes(*times):
        return [move(library, handle, levels, time)[:2] for time in times]

    begun = [(0, 5), (0, 5), (0, 5), (0, 0)]
    assert outcomes(1, 2, 3, 4) == begun
    assert outcomes(1)[0][0] == 2
    assert library.ffpose_error().startswith(b"time: expected later than 4 s")
    assert library.ffpose_reset(handle) == 0
    assert outcomes(1, 2, 3, 4) == begun
    assert library.ffpose_reset(None) == 3


def test_rows_for_c_may_be_apart_but_not_upside_down(library, opened):
    _, handle = opened()
    wide = np.random.default_rng(0).integers(0, 100, (96, 200), np.uint8)
    code, pose = ask(library, handle, np.ascontiguousarray(wide[:, :128]))
    assert code == 0
    assert ask(library, handle, wide, width=128, stride=200) == (code, pose)
    for stride in (127, 2**64 - 128, 2**63 - 1, 2**63 // 96 + 1):
        assert ask(library, handle, wide, width=128, stride=stride)[0] == 2
        assert library.ffpose_error().endswith(f"got {stride}".encode())
    assert ask(library, handle, wide, pixels=None)[0] == 3
    assert library.ffpose_error() == b"image.pixels: expected a pointer, got null"


def test_null_pointers_are_named(library, opened):
    code, handle = opened(model=None)
    assert (code, handle.value) == (3, None)
    assert library.ffpose_error() == b"settings.model: expected a pointer, got null"
    _, handle = opened()
    levels = np.full((96, 128), 100, np.uint8)
    image = ctypes.byref(Pixels(levels.ctypes.data, 128, 96, 1, 0))
    pose = (ctypes.c_double * 40)()
    for name, code in {
        "settings": library.ffpose_open(None, ctypes.byref(handle)),
        "handle": library.ffpose_open(ctypes.byref(Words()), None),
    }.items():
        assert code == 3, name
    assert library.ffpose_error() == b"handle: expected a pointer, got null"
    for words, name in [
        ((None, image, 0.0, pose), "handle"),
        ((handle, None, 0.0, pose), "image"),
        ((handle, image, 0.0, None), "pose"),
    ]:
        assert library.ffpose_pose(*words) == 3
        assert library.ffpose_error() == f"{name}: expected a pointer, got null".encode()
    assert library.ffpose_track(handle, 1.0, image, 0.0, None) == 3
    assert library.ffpose_error() == b"motion: expected a pointer, got null"
    for function in (library.ffpose_save, library.ffpose_restore):
        assert function(handle, None) == 3
        assert library.ffpose_error() == b"path: expected a pointer, got null"
        assert function(None, b"x.state") == 3
        assert library.ffpose_error() == b"handle: expected a pointer, got null"


def compiled(program, folder, text):
    """A program in C++ of this text, linked with the library."""
    if not shutil.which("c++"):
        pytest.skip("no C++ compiler is installed")
    source, path = folder / "host.cc", folder / "host"
    source.write_text(text)
    library = program.parent
    command = ["c++", "-std=c++17", "-pthread", "-o", path, source, f"-I{CRATE / 'include'}"]
    command += [f"-L{library}", "-lffpose_onboard", f"-Wl,-rpath,{library}"]
    subprocess.run(command, check=True)
    return path


def test_a_destructor_of_a_thread_may_call(program, runtime, models, tmp_path):
    """After the thread's own sentence is gone: codes come back, and nothing ends the process."""
    path = compiled(program, tmp_path, LATE)
    done = subprocess.run([path, models, runtime], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (0, "2 1\n0\n2 \n"), done.stderr


LATE = """
#include <cstdio>
#include <cstring>
#include <thread>
#include "ffpose_onboard.h"

struct Owner {
  ffpose *handle = nullptr;
  ~Owner() {
    int code = ffpose_save(handle, "/nowhere/at/all/x.state");
    std::printf("%d %s\\n", code, ffpose_error());
    ffpose_close(handle);
  }
};

int main(int, char **words) {
  std::thread thread([&] {
    static thread_local Owner owner; // made before the library's own, and so destroyed after it
    ffpose_settings settings;
    std::memset(&settings, 0, sizeof settings);
    settings.model = "/nowhere.onnx";
    settings.runtime = words[2];
    settings.threads = 1;
    int code = ffpose_open(&settings, &owner.handle);
    std::printf("%d %d\\n", code, std::strlen(ffpose_error()) > 0);
    settings.model = words[1];
    std::printf("%d\\n", ffpose_open(&settings, &owner.handle));
  });
  thread.join();
  return 0;
}
"""


def test_a_forked_process_may_close_what_it_was_forked_with(program, runtime, models, tmp_path):
    path = compiled(program, tmp_path, FORKED)
    done = subprocess.run([path, models, runtime], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (0, "0 0 0 0 0 0 0 0 "), done.stderr


FORKED = """
#include <cstdio>
#include <sys/wait.h>
#include <unistd.h>
#include "ffpose_onboard.h"

int main(int, char **words) {
  ffpose_settings settings = {};
  settings.model = words[1];
  settings.runtime = words[2];
  settings.threads = 2;
  ffpose *handle = nullptr;
  if (ffpose_open(&settings, &handle) != FFPOSE_OK) return 1;
  for (int child = 0; child < 8; child++) {
    pid_t id = fork();
    if (id == 0) {
      alarm(20); // where it waits, it ends by this signal
      ffpose_motion motion;
      int code = ffpose_track(handle, 1, nullptr, 0, &motion);
      ffpose_close(handle);
      _exit(code);
    }
    int status;
    waitpid(id, &status, 0);
    std::printf("%d ", status);
  }
  ffpose_close(handle);
  return 0;
}
"""


def test_no_more_threads_than_the_program_takes(library, opened):
    code, handle = opened(threads=1025)
    assert (code, handle.value) == (2, None)
    assert library.ffpose_error() == b"settings.threads: expected at most 1024, got 1025"


def test_a_state_of_any_name_is_renamed_from_one_of_its_own(library, opened, tmp_path):
    _, handle = opened()
    folder = tmp_path / "states"
    folder.mkdir()
    names = ["a.state", "a.1", "a.new", "a"]
    for name in names:
        assert library.ffpose_save(handle, bytes(folder / name)) == 0
        before = (folder / name).stat().st_ino
        assert library.ffpose_save(handle, bytes(folder / name)) == 0
        assert (folder / name).stat().st_ino != before  # another file, that was whole before
    assert {path.name for path in folder.iterdir()} == set(names)
    assert library.ffpose_save(handle, bytes(folder)) == 2  # no file can take its place
    assert [path.name for path in tmp_path.glob("*states*")] == ["states"]
    assert library.ffpose_restore(handle, bytes(folder / "a.new")) == 0


def test_the_times_of_frames_alone_and_with_a_track_are_measured(
    program, models, frames, tmp_path, capsys
):
    folder = frames[0].parent
    rows = [f"{path.name},{place / 2}" for place, path in enumerate(frames)]
    (folder / "frames.csv").write_text("\n".join(["image,time", *rows]))
    words = ["onboard", str(models), str(folder), "--program", str(program)]
    assert main(words) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["frames"] == len(frames)
    assert told["searched_whole"] == 4 + 1  # until the track is there, and after the empty frame
    assert 0 < told["ratio"] == told["milliseconds"]["with_a_track"] / told["milliseconds"]["alone"]
    models.write_bytes(sealed(steady(1e-3, sure=False)))
    assert main(words) == 1
    assert "expected an answer, got the end of the program" in capsys.readouterr().err
