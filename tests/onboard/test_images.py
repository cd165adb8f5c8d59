"""Images of all kinds become the network's input as in Python, and others an error of their own."""

import json
import re
import zlib
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from ffpose.errors import DataError
from ffpose.imaging.images import image_files
from ffpose.imaging.preprocessing import Preprocessing
from ffpose.inference.load import load
from ffpose.onnx.metadata import sealed
from onboard_program import (
    PILLOW,
    SIZE,
    assert_same,
    expected,
    jpeg,
    pgm,
    picture,
    png,
    png_of_chunks,
    projections,
)


@pytest.mark.parametrize("interpolation", ["bilinear", "bicubic"])
@pytest.mark.parametrize("mode", ["resize", "center_crop"])
def test_the_input_is_that_of_python_to_the_bit(run, folder, tmp_path, mode, interpolation):
    graph = tmp_path / "model.onnx"
    preprocessing = Preprocessing(SIZE, mode, interpolation=interpolation)
    graph.write_bytes(sealed(projections(preprocessing)))
    sizes = [(128, 96), (64, 48), (333, 201), (20, 17), (1, 2)]
    if PILLOW >= 13:  # before, tall images were resized across first
        sizes += [(9, 400), (128, 300), (120, 160), (120, 161)]
    files = {f"{w}x{h}.png": png(picture(w, h)) for w, h in sizes}
    files |= {f"{kind}.png": png(picture(mode=kind)) for kind in ("L", "LA", "P", "RGBA", "1")}
    images = folder(files)
    code, documents, errors = run(graph, "--images", images, "--resize")
    assert (code, errors) == (0, [])
    assert [d["image"] for d in documents] == sorted(str(images / name) for name in files)
    estimator = load(graph, resize=True, threads=1)
    for document in documents:
        assert_same(document, expected(estimator, Path(document["image"])), 0)


def numbered(data):
    """Return a JPEG file of R, G, B with the names 1, 2, 3 of YCbCr; Adobe's marker tells."""
    header, scan = data.index(b"\xff\xc0") + 10, data.index(b"\xff\xda") + 5
    changed = bytearray(data)
    changed[header : header + 7 : 3] = changed[scan : scan + 5 : 2] = b"\1\2\3"
    assert [data[scan], changed[scan]] == [ord("R"), 1]
    return bytes(changed)


def test_a_jpeg_is_decoded_as_by_python_but_for_rounding(run, folder, model):
    smooth = picture(16, 12).resize((128, 96), Image.Resampling.BICUBIC)
    gray, rgb = smooth.convert("L"), jpeg(smooth, keep_rgb=True)
    images = folder(
        {
            "baseline.jpg": jpeg(smooth),
            "gray.jpeg": jpeg(gray),
            "progressive.JPG": jpeg(smooth, progressive=True),
            "trailer.jpg": jpeg(smooth) + b"trailer \xff\xda",
            "whole.jpg": jpeg(smooth, subsampling=0),
            "rgb.jpg": rgb,
            "rgb_by_number.jpg": numbered(rgb),
        }
    )
    code, documents, _ = run(model, "--images", images)
    assert code == 0
    estimator = load(model, threads=1)
    for document in documents:
        path = Path(document["image"])
        assert_same(document, expected(estimator, path), 0.01 if "gray" in path.name else 0.1)


def test_a_folder_has_the_images_that_it_has_for_python(run, folder, model):
    names = ("b.PNG", "a.jpeg", "c.jpg", "B.pgm", "d.ppm", "png", "labels.csv", ".png", "._c.jpg")
    images = folder(dict.fromkeys(names, b""))
    _, documents, _ = run(model, "--images", images)
    assert [document["image"] for document in documents] == [
        str(image) for image in image_files(images, "images")
    ]
    assert len(documents) == 4


@pytest.mark.parametrize("white", [4095, 900.5, "p99.5", "p50", "p100"])
def test_gray_images_of_many_levels_are_read_as_by_python(run, folder, tmp_path, white):
    graph = tmp_path / "model.onnx"
    decoding = json.dumps({"undistorted": False, "white": white})
    graph.write_bytes(sealed(projections(decoding=decoding)))
    rng = np.random.default_rng(0)
    levels = rng.integers(0, 4096, (96, 128), np.uint16)
    files = {
        "a.png": png(Image.fromarray(levels)),
        "b.pgm": pgm(levels, 4095),
        "c.pgm": pgm(levels, 65_535),
        "d.PGM": pgm(levels, 1023),  # most levels are above white
        "e.pgm": pgm(levels % 256, 255),
        "f.pgm": pgm(levels % 150, 100),
        "g.png": png(picture()),
        "h.jpg": jpeg(picture(mode="L")),
    }
    images = folder(files)
    code, documents, errors = run(graph, "--images", images)
    assert (code, errors) == (0, [])
    assert [Path(document["image"]).name for document in documents] == list(files)
    estimator = load(graph, threads=1)
    for document in documents:
        tolerance = 0.01 if document["image"].endswith("jpg") else 0
        assert_same(document, expected(estimator, Path(document["image"])), tolerance)


def test_deep_images_that_python_refuses_are_refused(run, folder, tmp_path, model):
    graph = tmp_path / "model.onnx"
    decoding = {"undistorted": False, "white": "p50"}
    graph.write_bytes(sealed(projections(decoding=json.dumps(decoding))))
    header = (128).to_bytes(4) + (96).to_bytes(4) + bytes([16, 2, 0, 0, 0])
    rows = zlib.compress(bytes((1 + 6 * 128) * 96))
    levels = np.full((96, 128), 700, np.uint16)
    files = {
        "color.png": (png_of_chunks(IHDR=header, IDAT=rows, IEND=b""), "got several of 16"),
        "cut.pgm": (pgm(levels, 4095)[:-1], "expected 24576 bytes of pixels, got 24575"),
        "dark.pgm": (pgm(0 * levels, 4095), "expected a level above 0"),
        "header.pgm": (b"P5 128 96 70000 ", "expected a level of white from 1 to 65535"),
    }
    images = folder({name: data for name, (data, _) in files.items()})
    (images / "good.pgm").write_bytes(pgm(levels, 4095))
    code, documents, _ = run(graph, "--images", images)
    assert code == 3
    estimator = load(graph, threads=1)
    for document in documents:
        image = Path(document["image"])
        if image.name == "good.pgm":
            assert_same(document, expected(estimator, image), 0)
            continue
        assert files[image.name][1] in document["error"]
        with pytest.raises(DataError):
            estimator(image)
    code, (document,), _ = run(model, "--stdin", lines=[images / "good.pgm"])
    assert code == 3
    assert "the model's weights state none" in document["error"]


def test_bad_images_are_told_and_the_loop_goes_on(run, folder, model):
    whole, photo = png(picture()), jpeg(picture())
    deep = png(Image.fromarray(np.full((96, 128), 40_000, np.uint16)))
    altered = bytearray(whole)
    altered[len(whole) // 2] ^= 1
    header = (128).to_bytes(4) + (96).to_bytes(4) + bytes([8, 0, 0, 0, 0])
    rows = zlib.compress(bytes(129 * 96))
    rows = rows[:-1] + bytes([rows[-1] ^ 1])  # zlib's own checksum, Adler-32
    files = {
        "a_cut.png": (whole[: len(whole) // 2], "damaged PNG"),
        "b_cut.jpg": (photo[:-30], "damaged JPEG file: it is cut short"),
        "c_text.png": (b"no image", 'expected a PNG, JPEG or PGM .* begins with "no image"'),
        "d_empty.jpeg": (b"", "expected a PNG, JPEG or PGM file"),
        "e_deep.png": (deep, "expected 8 bits a channel, got more, .* weights state none"),
        "f_print.jpg": (jpeg(picture(mode="CMYK")), "expected gray or color of RGB or YCbCr"),
        "g_altered.png": (bytes(altered), "damaged PNG"),
        "h_good.png": (whole, None),
        "h_zlib.png": (png_of_chunks(IHDR=header, IDAT=rows, IEND=b""), "damaged PNG"),
    }
    images = folder({name: data for name, (data, _) in files.items()})
    (images / "labels.csv").write_text("not an image, and not meant as one")
    (images / "i_folder.png").mkdir()
    code, documents, errors = run(model, "--images", images)
    assert code == 3
    assert errors == ["ffpose-onboard: 9 of 10 images have no pose"]
    for document, (name, (_, message)) in zip(documents[:-1], files.items(), strict=True):
        assert document["image"] == str(images / name)
        assert (message is None) == ("error" not in document)
        assert message is None or re.search(message, document["error"]), document
    assert documents[-1]["error"] == "expected a regular file, got a folder"

    lines = [images / "h_good.png", "/nowhere/a.png", "", images / "h_good.png"]
    code, (first, missing, empty, last), _ = run(model, "--stdin", lines=[*lines, ""])
    assert (code, first) == (3, last)
    assert "cannot be read: No such file" in missing["error"]
    assert (empty["image"], "error" in empty) == ("", True)


def test_a_large_image_is_refused_by_its_header(run, folder, model):
    files = {"long.png": png(picture(65_536, 1)), "wide.png": bytearray(png(picture(4, 4)))}
    files["wide.png"][16:24] = (60_000).to_bytes(4) * 2
    files["wide.png"][29:33] = zlib.crc32(files["wide.png"][12:29]).to_bytes(4)
    code, (long, wide), _ = run(model, "--images", folder(files), "--resize")
    assert code == 3
    limits = "expected an image of 1 to 65535 pixels a side and at most 89478485 in all"
    assert long["error"] == f"{limits}, got 65536x1"
    assert wide["error"] == f"{limits}, got 60000x60000"


def test_a_panic_of_a_decoder_is_the_error_of_its_image(run, folder, model):
    header = (4).to_bytes(4) + (3).to_bytes(4) + bytes([8, 3, 0, 0, 0])
    rows = zlib.compress(bytes(5 * 3))
    # Four bytes are no palette: png 0.18.1 takes three of the one that is left, and panics.
    torn = png_of_chunks(IHDR=header, PLTE=b"\x07" * 4, IDAT=rows, IEND=b"")
    images = folder({"a.png": png(picture()), "b.png": torn, "c.png": png(picture())})
    code, (first, second, third), errors = run(model, "--images", images, "--resize")
    assert (code, errors[-1]) == (3, "ffpose-onboard: 1 of 3 images have no pose")
    assert first | {"image": ""} == third | {"image": ""}
    assert "got a panic, a bug of this program: range end index 3" in second["error"]
