"""Images of other cameras are reprojected as by Python, or resized, or refused."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from ffpose.errors import DataError
from ffpose.geometry import Camera, DistortedCamera
from ffpose.imaging.preprocessing import Preprocessing
from ffpose.inference.load import load
from ffpose.inference.prediction import camera_beside
from ffpose.onnx.metadata import sealed
from onboard_program import CAMERA, PILLOW, SIZE, assert_same, expected, picture, png, projections

LENS = (-0.3, 0.1, 0.01, -0.005, 0.02)

CAMERAS = {
    "the model's": CAMERA,
    "the model's, but for a little": replace(CAMERA, fx=CAMERA.fx * 1.0009),
    "the view's": Camera(64, 48, 50.0, 50.0, 32.0, 24.0),
    "narrow": Camera(90, 70, 211.7, 220.3, 40.2, 33.9),
    "wide": Camera(100, 51, 30.1, 29.2, 51.3, 24.4),
    "flat": Camera(300, 20, 230.0, 21.0, 140.0, 11.0),
    "upright": Camera(33, 260, 20.5, 201.0, 15.0, 120.0),
    "aside": Camera(80, 60, 62.5, 62.5, -7.3, 66.6),
    "at a whole pixel": Camera(128, 96, 50.0, 50.0, 72.0, 40.0),
    "coarse": Camera(7, 5, 6.2, 6.0, 3.4, 2.2),
    "with a lens": DistortedCamera(128, 96, 100.0, 100.0, 64.0, 48.0, LENS),
    "narrow with a lens": DistortedCamera(90, 70, 111.7, 120.3, 40.2, 33.9, LENS),
}


@pytest.mark.skipif(PILLOW < 13, reason="Pillow resized tall images across first")
@pytest.mark.parametrize("camera", CAMERAS.values(), ids=CAMERAS)
@pytest.mark.parametrize(
    ("mode", "interpolation"), [("resize", "bicubic"), ("center_crop", "bilinear")]
)
def test_images_of_another_camera_are_reprojected_as_by_python(
    run, folder, tmp_path, mode, interpolation, camera
):
    how = Preprocessing(SIZE, mode, interpolation=interpolation)
    graph, file = tmp_path / "model.onnx", tmp_path / "camera.json"
    graph.write_bytes(sealed(projections(how)))
    camera.write(file)
    sizes = [(camera.width, camera.height), (2 * camera.width, 2 * camera.height)]
    images = folder({f"{w}.png": png(picture(w, h)) for w, h in sizes})
    other = Image.new("RGB", (camera.width + 1, camera.height))
    (images / "other.png").write_bytes(png(other))
    code, documents, errors = run(graph, "--images", images, "--camera", file)
    assert (code, errors) == (3, ["ffpose-onboard: 1 of 3 images have no pose"])
    estimator = load(graph, camera=camera, threads=1)
    *documents, refused = documents
    for document in documents:
        assert_same(document, expected(estimator, Path(document["image"])), 0)
    shape = f"{camera.width}x{camera.height}, got an image of {camera.width + 1}x{camera.height}"
    assert f"expected the aspect ratio of its camera, {shape}" in refused["error"]


def test_images_of_another_camera_are_refused_unless_asked_for(run, folder, model):
    images = folder({"same.png": png(picture(64, 48)), "wide.png": png(picture(128, 64))})
    code, (same, wide), errors = run(model, "--images", images)
    assert code == 3
    assert "translation_m" in same
    assert list(wide) == ["image", "error"]
    assert "the aspect ratio of its camera, 128x96, got an image of 128x64" in wide["error"]
    assert errors == ["ffpose-onboard: 1 of 2 images have no pose"]
    code, (_, wide), _ = run(model, "--images", images, "--resize")
    assert code == 0
    assert_same(wide, expected(load(model, resize=True, threads=1), images / "wide.png"), 0)


def test_a_camera_beside_the_images_is_to_be_named(run, folder, model):
    """Python's `ffpose predict` takes it: without it the poses would be others."""
    images = folder({"same.png": png(picture(64, 48))})
    beside = images / "camera.json"
    replace(CAMERA, fx=200.0, fy=200.0).write(beside)
    code, documents, (error,) = run(model, "--images", images)
    assert (code, documents) == (1, [])
    assert f"expected --camera {beside}, the camera beside the images, or --resize" in error
    code, (named,), _ = run(model, "--images", images, "--camera", beside)
    wanted = expected(load(model, camera=camera_beside([images / "same.png"])), images / "same.png")
    assert_same(named, wanted, 1e-4)
    code, (resized,), _ = run(model, "--images", images, "--resize")
    assert code == 0
    assert run(model, "--stdin", lines=[images / "same.png"])[1] == [resized]
    assert resized["translation_m"] != named["translation_m"]


def test_a_camera_that_cannot_be_used_is_told_in_one_line(run, tmp_path, model):
    file, unknown = tmp_path / "camera.json", tmp_path / "model.onnx"
    unknown.write_bytes(sealed(projections(view=None)))
    CAMERA.write(file)
    wrong = tmp_path / "wrong.json"
    wrong.write_text('{"width": 128, "height": 96}')
    for graph, camera, message in [
        (unknown, file, "expected a model that knows the camera of its input"),
        (model, tmp_path / "nowhere.json", "nowhere.json: cannot be read: No such file"),
        (model, wrong, "wrong.json: camera: expected the keys width, height, fx, fy, cx, cy"),
    ]:
        code, documents, errors = run(graph, "--stdin", "--camera", camera)
        assert (code, documents, len(errors)) == (1, [], 1)
        assert message in errors[0]
    code, _, errors = run(model, "--stdin", "--camera", file, "--resize")
    assert (code, len(errors)) == (2, 1)
    assert "expected --camera or --resize, got both" in errors[0]


FIELDS = '"width": 128, "height": 96, "fx": 100, "fy": 100, "cx": 64, "cy": 48'
NO_LENS = '"distortion": [0, 0, 0, 0, 0]'
ACCEPTED = {
    "plain": f"{{{FIELDS}}}",
    "a byte order mark": f"\ufeff{{{FIELDS}}}\n",
    "white space": f" \t\r\n{{{FIELDS}}}\n",
    "an escaped name": f"{{{FIELDS}}}".replace('"cy"', r'"c\u0079"'),
    "fractions of zero": f"{{{FIELDS}}}".replace("128", "1.28e2").replace("96", "96.0"),
    "a large size": f"{{{FIELDS}}}".replace("128", "9007199254740991"),
    "a center outside": f"{{{FIELDS}}}".replace("64", "-6.4e300"),
    "a lens": f'{{{FIELDS}, "distortion": [-0.3, 0.1, 1e-2, -5E-3, 0]}}',
    "no lens": f"{{{FIELDS}, {NO_LENS}}}",
    "a long whole number": f"{{{FIELDS}}}".replace('"cx": 64', f'"cx": 1{"0" * 300}'),
}
REFUSED = {
    "empty": "",
    "no object": "[128, 96, 100, 100, 64, 48]",
    "null": "null",
    "two objects": f"{{{FIELDS}}}{{}}",
    "two byte order marks": f"\ufeff\ufeff{{{FIELDS}}}",
    "a comment": f"{{{FIELDS}}} // mine",
    "another white space": f"{{{FIELDS}}}\u00a0",
    "a trailing comma": f"{{{FIELDS},}}",
    "a missing key": f"{{{FIELDS}}}".replace(', "cy": 48', ""),
    "another key": f'{{{FIELDS}, "skew": 0}}',
    "a key twice": f'{{{FIELDS}, "cy": 48}}',
    "a key twice, escaped": f'{{{FIELDS}, "c\\u0079": 48}}',
    "a lens twice": f"{{{FIELDS}, {NO_LENS}, {NO_LENS}}}",
    "no width": f"{{{FIELDS}}}".replace("128", "0"),
    "a negative height": f"{{{FIELDS}}}".replace("96", "-96"),
    "a fraction": f"{{{FIELDS}}}".replace("128", "128.5"),
    "a size beyond floats": f"{{{FIELDS}}}".replace("128", "9007199254740993"),
    "a huge size": f"{{{FIELDS}}}".replace("128", "1e300"),
    "a size of 400 digits": f"{{{FIELDS}}}".replace("128", f"1{'0' * 400}"),
    "a string": f"{{{FIELDS}}}".replace("128", '"128"'),
    "true": f"{{{FIELDS}}}".replace("64", "true"),
    "no number": f"{{{FIELDS}}}".replace("64", "NaN"),
    "infinity": f"{{{FIELDS}}}".replace("64", "-Infinity"),
    "beyond floats": f"{{{FIELDS}}}".replace("64", "1e400"),
    "a focal length of zero": f"{{{FIELDS}}}".replace('"fx": 100', '"fx": 1e-400'),
    "a negative focal length": f"{{{FIELDS}}}".replace('"fy": 100', '"fy": -100'),
    "a lens of null": f'{{{FIELDS}, "distortion": null}}',
    "a lens of four": f'{{{FIELDS}, "distortion": [0, 0, 0, 0]}}',
    "a lens of six": f'{{{FIELDS}, "distortion": [0, 0, 0, 0, 0, 0]}}',
    "a lens with false": f'{{{FIELDS}, "distortion": [0.1, false, 0, 0, 0]}}',
    "a lens of strings": f'{{{FIELDS}, "distortion": ["0", "0", "0", "0", "0"]}}',
    "a nested lens": f'{{{FIELDS}, "distortion": [[0, 0, 0, 0, 0]]}}',
    "a lens that folds": f'{{{FIELDS}, "distortion": [-1, 0, 0, 0, 0]}}',
    "a tangential lens that folds": f'{{{FIELDS}, "distortion": [0, 0, 1.5, 0, 0]}}',
}


def is_read(path):
    try:
        Camera.read(path)
    except DataError:
        return False
    return True


@pytest.mark.parametrize(
    ("text", "accepted"),
    [(text, True) for text in ACCEPTED.values()] + [(text, False) for text in REFUSED.values()],
    ids=[*ACCEPTED, *REFUSED],
)
def test_a_camera_file_is_read_or_refused_by_both(run, tmp_path, model, text, accepted):
    path = tmp_path / "camera.json"
    path.write_text(text, encoding="utf-8")
    code, _, errors = run(model, "--stdin", "--camera", path)
    assert (is_read(path), code == 0) == (accepted, accepted), errors
    assert accepted or (code, len(errors)) == (1, 1)


def test_the_same_lenses_fold_the_image_for_both(run, tmp_path, model):
    path = tmp_path / "camera.json"
    generator = np.random.default_rng(0)
    verdicts = []
    for strength in np.geomspace(0.1, 1.5, 24):
        lens = (strength * generator.normal(size=5) * (1, 1, 0.2, 0.2, 1)).tolist()
        path.write_text(f'{{{FIELDS}, "distortion": {json.dumps(lens)}}}')
        code, _, errors = run(model, "--stdin", "--camera", path)
        assert is_read(path) == (code == 0), lens
        assert code == 0 or "which folds it" in errors[0]
        verdicts.append(code)
    assert 5 <= sum(verdicts) <= 19  # of both kinds


def test_images_are_undistorted_as_those_trained_on(run, folder, tmp_path):
    graph, file = tmp_path / "model.onnx", tmp_path / "camera.json"
    decoding = json.dumps({"undistorted": True, "white": None})
    graph.write_bytes(sealed(projections(decoding=decoding)))
    images = folder({"a.png": png(picture())})
    code, documents, errors = run(graph, "--images", images)
    assert (code, documents, len(errors)) == (1, [], 1)
    assert "expected --camera FILE, whose distortion is taken out" in errors[0]
    camera = CAMERAS["with a lens"]
    camera.write(file)
    code, (document,), _ = run(graph, "--images", images, "--camera", file)
    assert code == 0
    estimator = load(graph, camera=camera, threads=1)
    assert_same(document, expected(estimator, images / "a.png"), 0)


def test_images_with_the_distortion_of_those_trained_on_stay_as_they_are(run, folder, tmp_path):
    """The lens of the camera of the network's view: undistorted only for other networks."""
    file, found = tmp_path / "camera.json", []
    lens = DistortedCamera(64, 48, 50.0, 50.0, 32.0, 24.0, LENS)
    lens.write(file)
    images = folder({"a.png": png(picture(64, 48))})
    for distorted in (True, False):
        graph = tmp_path / f"{distorted}.onnx"
        decoding = {"undistorted": False, "distortion": list(LENS) if distorted else None}
        graph.write_bytes(sealed(projections(decoding=json.dumps(decoding))))
        code, (document,), _ = run(graph, "--images", images, "--camera", file)
        assert code == 0
        assert_same(document, expected(load(graph, camera=lens, threads=1), images / "a.png"), 0)
        _, (as_it_is,), _ = run(graph, "--images", images, "--resize")
        found.append(document["translation_m"] == as_it_is["translation_m"])
    assert found == [True, False]
    CAMERAS["the view's"].write(file)
    code, documents, (error,) = run(tmp_path / "True.onnx", "--images", images, "--camera", file)
    assert (code, documents) == (1, [])
    assert "expected that of training, with the distortion [-0.3, 0.1," in error
