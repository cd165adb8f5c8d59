import json
import os
import re
import shlex
import shutil
import subprocess
import sys
import warnings
from contextlib import redirect_stdout
from io import StringIO
from types import SimpleNamespace

import numpy as np
import pytest
from PIL import Image

from ffpose import __version__
from ffpose.cli import COMMANDS, build_parser, main, width_and_height
from ffpose.models import FilterformerPose
from option_words import options_of
from studies.table import read_results
from tiny_runs import MODEL_FIELDS, write_set


@pytest.fixture(scope="module")
def image_set(tmp_path_factory):
    return write_set(tmp_path_factory.mktemp("cli") / "set")


@pytest.fixture(scope="module")
def trained(image_set, tmp_path_factory):
    out = tmp_path_factory.mktemp("cli") / "run"
    assert main(train_words(image_set, out)) == 0
    return out


def train_words(image_set, out, *more):
    return [
        *("train", "--model", "tiny", "--data.kind", "urso", "--data.root", str(image_set)),
        *("--epochs", "1", "--seed", "3", "--out", str(out), "--backbone-weights", "none"),
        *("--batch-size", "4", *options_of(MODEL_FIELDS), *more),
    ]


def data_words(image_set):
    return ["--data.kind", "urso", "--data.root", str(image_set)]


def test_train_leaves_what_it_promises(trained):
    names = {path.name for path in trained.iterdir()}
    promised = {"config.yaml", "results.csv", "last.safetensors", "best.safetensors", "curves.png"}
    assert promised <= names


@pytest.mark.slow
def test_train_again_from_its_own_config_and_resume(trained, image_set, tmp_path, capsys):
    again = ["train", "--config", str(trained / "config.yaml"), "--out", str(tmp_path / "again")]
    assert main(again) == 0
    assert main(again) == 1
    assert "holds a training run" in capsys.readouterr().err
    assert main([*again, "--resume", "--epochs", "2"]) == 0
    assert len(read_results(tmp_path / "again/results.csv")) == 2
    first = read_results(tmp_path / "again/results.csv")[0]
    assert first["train_loss"] == read_results(trained / "results.csv")[0]["train_loss"]


def test_pretrained_weights_that_cannot_be_had_are_one_line(
    image_set, tmp_path, monkeypatch, capsys
):
    import huggingface_hub
    from huggingface_hub import constants

    monkeypatch.setattr(constants, "HF_HUB_OFFLINE", True)
    monkeypatch.setattr(huggingface_hub, "try_to_load_from_cache", lambda *_, **__: None)
    assert main(train_words(image_set, tmp_path / "run", "--backbone-weights", "auto")) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert "--backbone-weights none starts from random weights" in line
    assert not (tmp_path / "run").exists()


@pytest.mark.slow
def test_evaluate_prints_one_json_document(trained, image_set, tmp_path, capsys):
    words = ["evaluate", str(trained / "best.safetensors"), *data_words(image_set)]
    assert main([*words, "--out", str(tmp_path), "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["images"] == 6
    assert document == json.loads((tmp_path / "results.json").read_text())
    assert (tmp_path / "worst.png").exists()
    assert not (tmp_path / "reliability.png").exists()  # this network does not give a covariance


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn")
def test_evaluate_prints_a_table(trained, image_set, tmp_path, capsys):
    words = ["evaluate", str(trained / "best.safetensors"), *data_words(image_set)]
    assert main([*words, "--out", str(tmp_path)]) == 0
    assert "median_translation_error_m" in capsys.readouterr().out


def test_predict(trained, image_set, tmp_path, capsys):
    images = [str(image_set / f"{index}_rgb.png") for index in (0, 1)]
    words = ["predict", str(trained / "best.safetensors"), *images]
    assert main(words) == 0
    assert len(capsys.readouterr().out.splitlines()) == 2
    assert main([*words, "--json", "--overlay", str(tmp_path)]) == 0
    entries = map(json.loads, capsys.readouterr().out.splitlines())
    assert [entry["image"] for entry in entries] == images
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "0_rgb_pose.png",
        "1_rgb_pose.png",
    ]


def test_predict_takes_folders_and_patterns(trained, image_set, tmp_path, capsys):
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        shutil.copy(image_set / "0_rgb.png", tmp_path / name / "7.png")
    (tmp_path / "a" / "labels.csv").write_text("")
    words = ["predict", str(trained / "best.safetensors"), "--json", "--device", "cpu"]
    assert main([*words, str(tmp_path / "a"), str(tmp_path / "**" / "*.png")]) == 0
    entries = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    found = [str(tmp_path / name / "7.png") for name in ("a", "a", "b")]
    assert [entry["image"] for entry in entries] == found
    assert main([*words, str(tmp_path / "*.jpg")]) == 1
    assert "images: expected files that match" in capsys.readouterr().err


def test_a_damaged_image_alone_has_its_line_too(trained, tmp_path, capsys):
    broken = tmp_path / "broken.png"
    broken.write_bytes(b"cut off")
    assert main(["predict", str(trained / "best.safetensors"), str(broken), "--json"]) == 1
    said = capsys.readouterr()
    entry = json.loads(said.out)
    assert said.err == f"ffpose: {entry['error']}\n"
    assert entry["image"] == str(broken)
    assert "cannot be read as an image" in entry["error"]


def test_too_many_pixels_are_told_once(trained, tmp_path, capsys):
    """Pillow would warn of what our own limit refuses."""
    header = b"P5 10000 10000 255\n"
    (tmp_path / "huge.pgm").write_bytes(header)
    with warnings.catch_warnings(record=True, action="always") as warned:
        assert main(["predict", str(trained / "best.safetensors"), f"{tmp_path}/huge.pgm"]) == 1
    assert not [each for each in warned if "Image size" in str(each.message)]
    (line,) = capsys.readouterr().err.splitlines()
    assert "expected an image of at most 89,478,485 pixels, got 100,000,000" in line


def test_predict_goes_on_after_an_image_that_cannot_be_used(trained, image_set, tmp_path, capsys):
    broken, missing = tmp_path / "broken.png", tmp_path / "missing.png"
    broken.write_bytes(b"cut off")
    good = [str(image_set / f"{index}_rgb.png") for index in (0, 1)]
    words = [
        "predict",
        str(trained / "best.safetensors"),
        good[0],
        str(broken),
        str(missing),
        good[1],
    ]
    assert main([*words, "--json", "--batch", "3"]) == 1
    said = capsys.readouterr()
    entries = [json.loads(line) for line in said.out.splitlines()]
    assert [entry["image"] for entry in entries] == words[2:]
    assert ["error" in entry for entry in entries] == [False, True, True, False]
    assert entries[0] | {"image": ""} != entries[3] | {"image": ""}
    first, second, last = said.err.splitlines()
    assert str(broken) in first
    assert str(missing) in second
    assert last == "ffpose: 2 of 4 images have no pose"
    assert main(words) == 1
    assert len(capsys.readouterr().out.splitlines()) == 2


def test_predict_draws_with_the_camera_it_is_given(trained, image_set, tmp_path):
    """The axes' origin is where the printed translation is, by fx x / z + cx."""
    camera = {"width": 64, "height": 48, "fx": 8.0, "fy": 8.0, "cx": 12.0, "cy": 40.0}
    (tmp_path / "camera.json").write_text(json.dumps(camera))
    image = image_set / "0_rgb.png"
    words = ["predict", str(trained / "best.safetensors"), str(image), "--json"]
    words += ["--overlay", str(tmp_path), "--camera", str(tmp_path / "camera.json")]
    with redirect_stdout(StringIO()) as said:
        assert main(words) == 0
    x, y, z = json.loads(said.getvalue())["translation_m"]
    plain, drawn = (
        np.asarray(Image.open(path), int) for path in (image, tmp_path / "0_rgb_pose.png")
    )
    changed = np.argwhere((drawn != plain).any(axis=2))
    origin = [8 * y / z + 40, 8 * x / z + 12]
    assert np.abs(changed + 0.5 - origin).max(axis=1).min() < 1.5
    assert np.abs(changed + 0.5 - origin).max() < 8  # axes of 2 m at 8 m and more


def test_predict_refuses_overlays_of_one_name_before_it_computes(trained, image_set, capsys):
    words = ["predict", str(trained / "best.safetensors"), str(image_set / "0_rgb.png")]
    assert main([*words, "b/0_rgb.png", "--overlay", "ov"]) == 2
    said = capsys.readouterr()
    assert said.out == ""
    assert "expected images of distinct names, got" in said.err


def test_predict_refuses_overlays_over_its_images(trained, image_set, tmp_path, capsys):
    for name in ("a.png", "a_pose.png"):
        (tmp_path / name).write_bytes((image_set / "0_rgb.png").read_bytes())
    words = ["predict", str(trained / "best.safetensors"), str(tmp_path)]
    assert main([*words, "--overlay", str(tmp_path / ".")]) == 2
    said = capsys.readouterr()
    assert said.out == ""
    assert f"expected a folder without the images, got {tmp_path}" in said.err
    assert (tmp_path / "a_pose.png").read_bytes() == (image_set / "0_rgb.png").read_bytes()


@pytest.fixture
def square(tmp_path):
    """An image and its camera, of another shape than the set's."""
    Image.new("RGB", (60, 60), (90, 80, 70)).save(tmp_path / "square.png")
    camera = {"width": 30, "height": 30, "fx": 40.0, "fy": 40.0, "cx": 15.0, "cy": 15.0}
    (tmp_path / "square.json").write_text(json.dumps(camera))
    return tmp_path


def test_predict_asks_for_the_camera_of_another_image(trained, square, capsys):
    words = ["predict", str(trained / "best.safetensors"), str(square / "square.png")]
    assert main(words) == 1
    said = capsys.readouterr()
    assert said.out == ""
    (line,) = said.err.splitlines()
    assert line.startswith(f"ffpose: {square / 'square.png'}: expected the aspect ratio of")
    assert "Camera(width=64, height=48, fx=32.0, fy=32.02315" in line
    assert "60x60" in line
    for more in (["--camera", str(square / "square.json")], ["--resize"]):
        assert main([*words, *more]) == 0
        assert "t = (" in capsys.readouterr().out


def test_predict_takes_the_camera_that_lies_beside_the_images(trained, image_set, square, capsys):
    words = ["predict", str(trained / "best.safetensors"), str(square / "square.png"), "--json"]
    assert main([*words, "--camera", str(square / "square.json")]) == 0
    expected = capsys.readouterr().out
    (square / "camera.json").write_bytes((square / "square.json").read_bytes())
    assert main(words) == 0
    assert capsys.readouterr().out == expected
    assert main([*words, "--resize"]) == 0
    assert capsys.readouterr().out != expected
    assert main([*words, str(image_set / "0_rgb.png")]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "camera: expected one beside all images, got Camera(width=30" in line


def test_predict_takes_one_camera_or_a_resize(trained, square, capsys):
    words = ["predict", str(trained / "best.safetensors"), str(square / "square.png")]
    assert main([*words, "--resize", "--camera", str(square / "square.json")]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("ffpose predict: camera: expected one to reproject from, or resize;")
    assert line.endswith("see ffpose predict --help")


def test_a_camera_is_nothing_to_weights_without(square, capsys):
    weights = square / "w.safetensors"
    FilterformerPose.from_config("tiny", backbone_weights="none").save_pretrained(weights)
    words = ["predict", str(weights), str(square / "square.png"), "--camera"]
    assert main([*words, str(square / "square.json")]) == 2
    assert "camera: expected with --overlay, for these weights" in capsys.readouterr().err
    assert main([*words, str(square / "square.json"), "--overlay", str(square / "ov")]) == 0


@pytest.mark.usefixtures("undrawn")
def test_weights_of_the_package_go_by_name(trained, image_set, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("ffpose._internal.zoo.FOLDER", tmp_path)
    shutil.copy(trained / "best.safetensors", tmp_path / "soyuz.safetensors")
    images = [str(image_set / "0_rgb.png")]
    assert main(["predict", str(trained / "best.safetensors"), *images, "--json"]) == 0
    expected = capsys.readouterr().out
    assert main(["predict", "soyuz", *images, "--json"]) == 0
    assert capsys.readouterr().out == expected
    assert main(["predict", "soyuz", *images, "--json", *images]) == 0
    assert capsys.readouterr().out == 2 * expected
    words = ["evaluate", "soyuz", *data_words(image_set), "--out", str(tmp_path / "e")]
    assert main(words) == 0
    assert main(["predict", "dragon", *images]) == 1
    assert "a name (one of soyuz), got dragon" in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn")
def test_evaluate_refuses_a_set_of_another_camera(image_set, tmp_path, capsys):
    fields = {"image_size": (64, 64), "depth": 1, "dim": 16, "heads": 2}
    fields["camera"] = (32.0, 32.0, 32.0, 32.0)
    model = FilterformerPose.from_config("tiny", backbone_weights="none", **fields)
    model.save_pretrained(tmp_path / "w.safetensors")
    words = ["evaluate", str(tmp_path / "w.safetensors"), *data_words(image_set)]
    words += ["--out", str(tmp_path / "out")]
    assert main(words) == 1
    assert "expected images of the weights' camera, Camera(" in capsys.readouterr().err
    assert main([*words, "--reproject"]) == 0


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn")
def test_inspect(image_set, tmp_path, capsys):
    words = ["inspect", *data_words(image_set), "--out", str(tmp_path)]
    assert main(words) == 0
    assert "train: 10 images" in capsys.readouterr().out
    assert main([*words, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["splits"]["test"]["images"] == 6


def test_inspect_mends_no_set(image_set, tmp_path, capsys):
    words = ["inspect", *data_words(image_set), "--mesh-center", "--out", str(tmp_path)]
    assert main(words) == 2
    assert "mesh-center: expected with a mesh, got none" in capsys.readouterr().err


@pytest.mark.parametrize("words", ["", "craft.obj --data.undistort", "craft.obj --data.white 4095"])
def test_inspect_takes_a_mesh_or_a_set(words, tmp_path, capsys):
    assert main(["inspect", *words.split(), "--out", str(tmp_path)]) == 2
    assert "mesh: expected a mesh file, or --data.kind and" in capsys.readouterr().err


def test_render_writes_images(tmp_path):
    words = ["render", "soyuz_easy", "--out", str(tmp_path), "--count", "2", "--size", "64x48"]
    assert main(words) == 0
    assert (tmp_path / "1_rgb.png").exists()


def test_render_takes_a_mesh_a_camera_and_a_shard(tmp_path, capsys):
    (tmp_path / "camera.json").write_text(
        '{"width": 80, "height": 60, "fx": 90.0, "fy": 90.0, "cx": 40.0, "cy": 30.0}'
    )
    (tmp_path / "wedge.obj").write_text(
        "v 0 0 0\nv 900 0 0\nv 0 700 0\nv 0 0 500\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n"
    )
    words = ["render", "soyuz_easy", "--out", str(tmp_path / "set"), "--count", "2", "--start", "4"]
    words += ["--camera", str(tmp_path / "camera.json"), "--layers", "--labels", "coordinates"]
    words += ["--mesh", str(tmp_path / "wedge.obj"), "--mesh-scale", "0.001"]
    words += ["--motion", "4", "--jpeg", "80", "--randomize", "0.3", "--eclipse-rate", "0.34"]
    words += ["--attitude-range", "10", "90", "20"]
    assert main(words) == 0, capsys.readouterr().err
    names = {path.name for path in (tmp_path / "set").iterdir()}
    assert {"4_rgb.png", "5_rgb.png", "5_mask.png", "5_depth.png", "5_coordinates.png"} <= names
    manifest = json.loads((tmp_path / "set/manifest.json").read_text())
    assert manifest["parameters"]["scene"]["camera"]["fx"] == 90
    assert manifest["parameters"]["scene"]["craft"].startswith("wedge.obj sha256:")
    assert manifest["parameters"]["scene"]["sensor"]["jpeg_quality"] == 80
    assert manifest["parameters"]["scene"]["attitude_range_deg"] == [10, 90, 20]
    assert manifest["parameters"]["coordinates_limit_m"] == 0.9


def test_render_says_when_a_shard_leaves_the_set_open(tmp_path, capsys):
    words = ["render", "soyuz_easy", "--out", str(tmp_path), "--count", "1", "--size", "64x48"]
    assert main(words) == 0
    assert "other runs" not in capsys.readouterr().err
    assert main([*words, "--start", "1"]) == 0
    assert "images of other runs too: one run over all" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (["render", "soyuz_easy", "--out", "x", "--count", "1", "--camera", "no.json"], "no.json"),
        (["render", "soyuz_easy", "--out", "x", "--count", "1", "--mesh", "no.obj"], "no.obj"),
        (["predict", "none.safetensors", "a.png"], "none.safetensors"),
        (["inspect", "--data.kind", "urso", "--data.root", "none", "--out", "x"], "none"),
        (["evaluate", "w", "--data.kind", "urso", "--data.root", "s", "--out", "file"], "the file"),
        (["inspect", "--data.kind", "urso", "--data.root", "file", "--out", "x"], "the file"),
        (["render", "soyuz_easy", "--out", "file", "--count", "1"], "the file"),
        (["train", "--data.kind", "urso", "--data.root", "s", "--out", "file"], "the file"),
        (["demo", "--out", "file/demo"], "the file"),
    ],
)
def test_failed_work_is_one_line_and_code_1(words, line, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").write_text("")
    assert main(words) == 1
    said = capsys.readouterr()
    assert said.out == ""
    assert len(said.err.splitlines()) == 1
    assert line in said.err


PLACES = {"file/x": "expected a folder, got the file"}
if sys.platform == "linux":
    PLACES["/proc/x"] = "expected a folder that can be written to, got /proc"
FILES = [
    (["export", "soyuz", "--out"], ".onnx"),
    (["calibrate", "soyuz", "--out"], ".safetensors"),
    (["bench", "filter", "--plot"], ".png"),
]
FOLDERS = [
    ["card", "soyuz", "--scene", "soyuz_easy", "--out"],
    ["card", "soyuz", "--scene", "soyuz_easy", "--images"],
    ["render", "soyuz_easy", "--count", "1", "--out"],
    ["evaluate", "soyuz", "--data.kind", "urso", "--data.root", "s", "--out"],
    ["learn", "mesh.obj", "--out"],
    ["track", "soyuz", "frames", "--out"],
    ["train", "--data.kind", "urso", "--data.root", "s", "--out"],
    ["inspect", "mesh.obj", "--out"],
]


def expect_refused(words, line, folder, capsys):
    (folder / "file").write_text("")
    assert main(words) == 1
    (said,) = capsys.readouterr().err.splitlines()
    assert said.startswith(f"ffpose: {line}")
    assert [path.name for path in folder.iterdir()] == ["file"]


@pytest.mark.parametrize(("place", "line"), PLACES.items())
@pytest.mark.parametrize(("words", "suffix"), [*FILES, *((words, "") for words in FOLDERS)])
def test_a_place_that_cannot_be_written_is_told_before_the_work(
    words, suffix, place, line, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    expect_refused([*words, place + suffix], line, tmp_path, capsys)


@pytest.mark.parametrize(("words", "suffix"), FILES)
def test_a_folder_that_is_missing_is_told_before_the_work(
    words, suffix, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    line = f"expected an existing folder for nodir/x{suffix}, got nodir"
    expect_refused([*words, f"nodir/x{suffix}"], line, tmp_path, capsys)


def test_debug_shows_the_traceback(tmp_path):
    with pytest.raises(FileNotFoundError):
        main(["predict", str(tmp_path / "none.safetensors"), "a.png", "--debug"])


RENDER = ["render", "soyuz_easy", "--out", "x", "--count", "1"]


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (["predict", "soyuz", "a.png", "--batch", "0"], "batch: expected at least 1, got 0"),
        (["predict", "soyuz", "a.png", "--device", "abacus"], "device: expected auto, or"),
        (
            ["card", "soyuz", "--scene", "soyuz_easy", "--final", "--seed", "1000005"],
            "seed: expected",
        ),
        (["card", "soyuz", "--scene", "soyuz_easy", "--count", "0"], "count: expected at"),
        (["render", "soyuz_easy", "--out", "x", "--count", "1", "--size", "9x9"], "16…8192"),
        (["render", "no_such_set", "--out", "x", "--count", "1"], "no_such_set"),
        ([*RENDER, "--jpeg", "101"], "jpeg_quality: expected 0…100, got 101"),
        ([*RENDER, "--motion", "-1"], "motion_px: expected 0…200"),
        ([*RENDER, "--randomize", "2"], "randomize: expected a number from 0 to 1, got 2.0"),
        ([*RENDER, "--attitude-range", "9", "99", "9"], "attitude_range_deg: expected (roll, pi"),
    ],
)
def test_a_value_that_cannot_be_is_wrong_usage(words, line, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(words) == 2
    (said,) = capsys.readouterr().err.splitlines()
    assert line in said
    assert said.endswith(f"see ffpose {words[0]} --help")


@pytest.mark.parametrize(
    "words",
    [
        [],
        ["no_such_command"],
        ["render", "soyuz_easy"],
        ["render", "soyuz_easy", "--out", "x", "--count", "many"],
        ["render", "soyuz_easy", "--out", "x", "--count", "1", "--size", "640"],
        ["train", "--out", "x"],
        ["train", "--data.kind", "urso", "--data.root", "x", "--out", "x", "--epochs", "few"],
        ["bench", "everything"],
    ],
)
def test_wrong_usage_is_code_2(words, capsys):
    with pytest.raises(SystemExit) as leaving:
        main(words)
    assert leaving.value.code == 2
    assert capsys.readouterr().out == ""


def test_no_command_shows_all_commands(capsys):
    with pytest.raises(SystemExit) as leaving:
        main([])
    said = capsys.readouterr()
    assert (leaving.value.code, said.out) == (2, "")
    shown = re.findall(r"^    (\w+)\s", said.err, re.MULTILINE)
    assert shown == [*COMMANDS, "info"]


def test_an_unknown_model_is_refused_before_anything_heavy_is_loaded(tmp_path):
    words = ["train", "--model", "huge", *data_words(tmp_path), "--out", str(tmp_path / "run")]
    code = (
        "import sys\n"
        "from ffpose.cli import main\n"
        f"try: main({words})\n"
        "except SystemExit as leaving: print(leaving.code, 'torch' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.stdout == "2 False\n"
    (line,) = done.stderr.splitlines()
    assert all(name in line for name in ("base", "small", "tiny", "huge"))


@pytest.mark.parametrize(
    ("option", "meant"), [("--batch-sise", "--batch-size"), ("--epoch", "--epochs")]
)
def test_an_unknown_option_is_one_line_with_what_was_meant(option, meant, image_set, capsys):
    with pytest.raises(SystemExit) as leaving:
        main(["train", *data_words(image_set), "--out", "x", option, "4"])
    assert leaving.value.code == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert f"unrecognized arguments: {option} 4 (did you mean {meant}?)" in line


@pytest.mark.parametrize(
    ("text", "meant"),
    [
        (
            "data: {holdot: 5}",
            "Group 'data' does not accept option 'holdot' (did you mean data.hold",
        ),
        ("batch_sise: 3", "Option 'batch_sise' is not accepted (did you mean batch_size?)"),
    ],
)
def test_an_unknown_field_of_a_config_is_one_line_with_what_was_meant(
    text, meant, tmp_path, capsys
):
    (tmp_path / "run.yaml").write_text(text)
    with pytest.raises(SystemExit) as leaving:
        main(["train", "--config", str(tmp_path / "run.yaml"), "--out", "x"])
    assert leaving.value.code == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert meant in line


@pytest.mark.parametrize("workers", [0, 1])
def test_a_broken_image_is_one_line_whoever_reads_it(workers, tmp_path, capsys):
    root = write_set(tmp_path / "set")
    (root / "10_rgb.png").write_bytes(b"cut off")
    words = train_words(root, tmp_path / "run", "--data.workers", str(workers))
    assert main(words) == 1
    last = capsys.readouterr().err.splitlines()[-1]
    assert last.startswith(f"ffpose: {root / 'val_images.csv'}:1: {root / '10_rgb.png'}: cannot")
    assert "Traceback" not in last


POSE = ("torch", "torchvision", "torchmetrics", "timm", "safetensors", "matplotlib")
BOTH = ("jsonargparse", "PIL", "rich", *POSE, "embreex")


@pytest.mark.parametrize(
    ("missing", "words", "extra"),
    [
        (BOTH, ["render", "soyuz_easy", "--out", "x", "--count", "1"], "render"),
        (BOTH, ["inspect", "--data.kind", "urso", "--data.root", "x", "--out", "x"], "pose"),
        (BOTH, ["demo"], "onnx,render"),
        (BOTH, ["predict", "soyuz", "x.png"], "onnx"),
        (POSE, ["inspect", "--data.kind", "urso", "--data.root", "x", "--out", "x"], "pose"),
        (POSE, ["demo", "--train", "--out", "x"], "pose,render"),
        (POSE, ["bench", "filter"], "pose"),
    ],
)
def test_a_command_names_the_extra_that_it_needs(missing, words, extra, tmp_path):
    done = without(missing, words, tmp_path)
    assert done.returncode == 1
    (line,) = done.stderr.splitlines()
    assert f"pip install 'ffpose[{extra}]'" in line


@pytest.mark.parametrize("words", [["--help"], ["--version"], ["info"]])
def test_help_needs_no_extra(words, tmp_path):
    done = without(BOTH, words, tmp_path)
    assert done.returncode == 0, done.stderr


def without(missing, words, folder):
    """Run a command where packages are missing: None in their place stops an import."""
    code = (
        "import sys\n"
        f"sys.modules.update(dict.fromkeys({missing}))\n"
        "from ffpose.cli import main\n"
        f"sys.exit(main({words}))"
    )
    call = [sys.executable, "-c", code]
    return subprocess.run(call, capture_output=True, text=True, check=False, cwd=folder)


@pytest.mark.parametrize("command", [*COMMANDS, "info"])
def test_every_command_explains_itself(command, capsys):
    with pytest.raises(SystemExit) as leaving:
        main([command, "--help"])
    assert leaving.value.code == 0
    assert command in capsys.readouterr().out


def test_version(capsys):
    with pytest.raises(SystemExit):
        main(["--version"])
    assert __version__ in capsys.readouterr().out


@pytest.mark.parametrize("name", COMMANDS)
def test_help_shows_no_default_that_is_nothing(name):
    text = build_parser(name).format_help()
    assert not re.findall(r"<class|default: (?:null|False)\)| \(\)", text)


def test_help_loads_nothing_heavy():
    code = (
        "import sys\n"
        "from ffpose.cli import main\n"
        "try: main(['--help'])\n"
        "except SystemExit: pass\n"
        "heavy = {'torch', 'matplotlib', 'timm', 'PIL', 'embreex'} & set(sys.modules)\n"
        "sys.exit(', '.join(heavy) or 0)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (
            ["evaluate", "w", "--data.kind", "csv", "--data.root", "s", "--out", "s"],
            "out: expected",
        ),
        (["render", "a.glb", "--out", "x", "--count", "1"], "soyuz_easy, .*; a mesh is --mesh's"),
        (["render", "soyuz_easy", "--out", "x", "--count", "1", "--size", "3"], "WIDTHxHEIGHT"),
    ],
)
def test_what_cannot_be_meant_is_wrong_usage(words, text, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    try:
        code = main(words)
    except SystemExit as error:
        code = error.code
    assert code == 2
    assert re.search(text, capsys.readouterr().err)


def test_interruption_is_said_and_code_130(monkeypatch, capsys, tmp_path):
    def interrupt(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr("ffpose.render.dataset.writer.write_dataset", interrupt)
    assert main(["render", "soyuz_easy", "--out", str(tmp_path), "--count", "1"]) == 130
    assert "interrupted" in capsys.readouterr().err


TERMINATED = """
import signal, sys
from importlib import import_module
from itertools import count
from ffpose.cli import main

place, name, turn, *words = sys.argv[1:]
module, calls = import_module(place), count(1)
function = getattr(module, name)

def terminated(*args, **options):
    if next(calls) == int(turn):
        signal.raise_signal(signal.SIGTERM)
    return function(*args, **options)

setattr(module, name, terminated)
sys.exit(main(words))
"""


def terminate(place, name, turn, words, **environment):
    """Run a command that gets SIGTERM in one of its calls of a function."""
    command = [sys.executable, "-c", TERMINATED, place, name, str(turn), *map(str, words)]
    environment = {**os.environ, **environment}
    done = subprocess.run(command, capture_output=True, text=True, env=environment, check=False)
    assert (done.returncode, done.stderr) == (143, "")


@pytest.mark.skipif(sys.platform == "win32", reason="SIGTERM ends a process at once")
def test_a_terminated_track_keeps_what_it_has(tmp_path):
    (tmp_path / "set").mkdir()
    for number in range(5):
        Image.new("RGB", (64, 48)).save(tmp_path / f"set/{number}.png")
    times = "".join(f"{number}.png,{number}\n" for number in range(5))
    (tmp_path / "times.csv").write_text(f"image,time\n{times}")
    words = ["track", "soyuz", tmp_path / "set", "--times", tmp_path / "times.csv", "--whole"]
    words += ["--device", "cpu", "--out", tmp_path / "out"]
    terminate("ffpose.tracking.follow", "predict", 4, words)
    lines = (tmp_path / "out/trajectory.csv").read_text().splitlines()
    assert [line.split(",")[0] for line in lines] == ["time", "0.0", "1.0", "2.0"]


def test_a_track_of_the_folder_at_hand_has_its_name(tmp_path, monkeypatch):
    (tmp_path / "tumble").mkdir()
    monkeypatch.chdir(tmp_path / "tumble")
    Image.new("RGB", (64, 48)).save("0.png")
    (tmp_path / "tumble/frames.csv").write_text("image,time\n0.png,0\n")
    estimator, titles = SimpleNamespace(near=None, metadata=None), []
    monkeypatch.setattr("ffpose.inference.load.load", lambda *_, **__: estimator)
    monkeypatch.setattr("ffpose.tracking.tracker.read_settings", lambda *_: None)
    run = "ffpose.tracking.follow.run"
    monkeypatch.setattr(run, lambda *_, title, **__: titles.append(title) or [])
    assert main(["track", "soyuz", ".", "--out", "out"]) == 0
    assert titles == ["tumble, tracked by soyuz"]


@pytest.mark.skipif(sys.platform == "win32", reason="SIGTERM ends a process at once")
def test_a_terminated_export_leaves_nothing(tmp_path):
    place = tmp_path / "temporary"
    place.mkdir()
    words = ["export", "soyuz", "--out", tmp_path / "soyuz.onnx"]
    terminate("ffpose.onnx.pose_graph", "write_graph", 1, words, TMPDIR=str(place))
    assert list(tmp_path.rglob("*")) == [place]


def test_an_interrupted_training_says_how_to_continue(image_set, monkeypatch, capsys, tmp_path):
    def interrupt(config, *, resume):
        if resume:
            (config.out / "state.pt").touch()  # what the end of the first epoch leaves
        raise KeyboardInterrupt

    monkeypatch.setattr("ffpose.training.engine.train", interrupt)
    words = train_words(image_set, tmp_path)
    assert main(words) == 130
    assert capsys.readouterr().err == "ffpose: interrupted; files already written are complete\n"
    assert main([*words, "--resume"]) == 130
    said = capsys.readouterr().err
    assert said.startswith(f"{tmp_path}: no run to resume, a new one begins\n")
    assert f"finished epochs are saved in {tmp_path}; continue with --resume" in said
    assert main([*words, "--resume"]) == 130
    assert "a new one begins" not in capsys.readouterr().err


@pytest.mark.skipif(sys.platform == "win32", reason="closed by a POSIX shell")
def test_a_closed_standard_output_is_one_line():
    call = f"{shlex.quote(sys.executable)} -m ffpose.cli predict soyuz none.png >&-"
    done = subprocess.run(["sh", "-c", call], capture_output=True, text=True, check=False)
    expected = "ffpose: expected an open standard output, got a closed one\n"
    assert (done.returncode, done.stderr) == (1, expected)


@pytest.mark.skipif(sys.platform != "linux", reason="there is no /dev/full")
@pytest.mark.parametrize("words", ["info", "info --json", "predict soyuz none.png --json"])
def test_results_that_find_no_room_are_one_line(words):
    call = f"{shlex.quote(sys.executable)} -m ffpose.cli {words} > /dev/full"
    done = subprocess.run(["sh", "-c", call], capture_output=True, text=True, check=False)
    expected = "ffpose: [Errno 28] No space left on device\n"
    assert (done.returncode, done.stderr) == (1, expected)


def test_width_and_height():
    assert width_and_height("640x480") == (640, 480)


@pytest.mark.slow
def test_a_reader_that_leaves_ends_the_command_in_silence(trained, image_set):
    """As ``ffpose predict ... | head -n 1``: code 141, a shell's for SIGPIPE."""
    call = [sys.executable, "-m", "ffpose.cli", "predict", str(trained / "best.safetensors")]
    call += [str(image_set), str(image_set), "--json"]
    with subprocess.Popen(call, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as child:
        assert json.loads(child.stdout.readline())["image"]
        child.stdout.close()
        errors = child.stderr.read()
    assert (child.returncode, errors) == (141, b"")
