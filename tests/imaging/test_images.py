"""Image files: what becomes RGB, and what is refused."""

import os
import struct
import sys
import zlib

import numpy as np
import pytest
from PIL import Image, ImageOps, features

from ffpose.errors import DataError
from ffpose.imaging.images import MAX_PIXELS, find_images, open_image, read_rgb, to_rgb

RAMP = np.arange(12).reshape(3, 4)


def written(folder, pixels, name="picture.png"):
    Image.fromarray(pixels).save(folder / name)
    return folder / name


def test_eight_bits_a_channel_keep_their_values(tmp_path):
    color = np.stack([RAMP, 2 * RAMP, 255 - RAMP, 40 + RAMP], axis=2).astype(np.uint8)
    for kept in (color, color[..., :3]):
        found = read_rgb(written(tmp_path, kept))
        assert found.mode == "RGB"
        np.testing.assert_array_equal(found, color[..., :3])
    gray = np.asarray(read_rgb(written(tmp_path, RAMP.astype(np.uint8))))
    np.testing.assert_array_equal(gray, np.repeat(RAMP[..., None], 3, axis=2))
    bits = np.asarray(read_rgb(written(tmp_path, RAMP % 2 == 0)))
    np.testing.assert_array_equal(bits, 255 * np.repeat(RAMP[..., None] % 2 == 0, 3, axis=2))


@pytest.mark.parametrize(
    ("pixels", "name", "mode"),
    [
        ((RAMP * 5000).astype(np.uint16), "deep.png", r"I;16, and no white level \(white\)"),
        ((RAMP / 11).astype(np.float32), "real.tiff", "F"),
    ],
)
def test_other_pixels_are_refused_not_clipped(tmp_path, pixels, name, mode):
    with pytest.raises(DataError, match=rf"{name}: expected pixels of mode L, .*, got {mode}$"):
        read_rgb(written(tmp_path, pixels, name))


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"none\.png"):
        read_rgb(tmp_path / "none.png")


@pytest.mark.parametrize("content", [b"", b"not an image", b"\x89PNG\r\n\x1a\n broken"])
def test_a_broken_image_is_named(tmp_path, content):
    path = tmp_path / "broken.png"
    path.write_bytes(content)
    with pytest.raises(DataError, match=r"broken\.png: cannot be read as an image"):
        read_rgb(path)


def png(bits, kind, width, height, data=b"", interlaced=0):
    """A PNG by its specification: the header's last three bytes are the only methods there are."""

    def chunk(name, content):
        crc = zlib.crc32(name + content)
        return struct.pack(">I", len(content)) + name + content + struct.pack(">I", crc)

    header = struct.pack(">IIBBBBB", width, height, bits, kind, 0, 0, interlaced)
    ramp = bytes(level for level in range(256) for _ in range(3))
    palette = ((b"PLTE", ramp),) if kind == 3 else ()
    parts = ((b"IHDR", header), *palette, (b"IDAT", zlib.compress(data)), (b"IEND", b""))
    return b"\x89PNG\r\n\x1a\n" + b"".join(chunk(*part) for part in parts)


@pytest.mark.parametrize(
    ("bits", "kind"), [(1, 0), (4, 0), (8, 0), (16, 0), (8, 2), (8, 3), (8, 6)]
)
@pytest.mark.parametrize("level", [0, 255])
def test_a_png_file_that_lacks_rows_is_refused(tmp_path, bits, kind, level):
    """Its zlib stream ends properly: Pillow alone leaves the rows black, and says nothing."""
    path = tmp_path / "short.png"
    row = b"\0" + bytes([level]) * -(-13 * bits * {0: 1, 2: 3, 3: 1, 6: 4}[kind] // 8)
    white = 65535 if bits == 16 else None
    path.write_bytes(png(bits, kind, 13, 9, 9 * row))
    pixels = np.asarray(read_rgb(path, white))
    np.testing.assert_array_equal(pixels, np.full((9, 13, 3), level))
    for missing in (1, len(row), 5 * len(row), 9 * len(row)):
        path.write_bytes(png(bits, kind, 13, 9, (9 * row)[:-missing]))
        with pytest.raises(DataError, match=r"short\.png: (expected|cannot be read as an image)"):
            read_rgb(path, white)


@pytest.mark.parametrize(("width", "height"), [(13, 9), (1, 1), (1, 9), (2, 2), (5, 1), (8, 8)])
def test_an_interlaced_png_file_that_lacks_rows_is_refused(tmp_path, width, height):
    """Adam7, by the specification's own drawing of which pass a pixel of 8x8 is in."""
    drawing = (
        *("16462646", "77777777", "56565656", "77777777"),
        *("36463646", "77777777", "56565656", "77777777"),
    )
    rows = b""
    for each in "1234567":
        for y in range(height):
            columns = sum(drawing[y % 8][x % 8] == each for x in range(width))
            rows += (b"\0" + b"\x80" * columns) if columns else b""
    path = tmp_path / "laced.png"
    path.write_bytes(png(8, 0, width, height, rows, interlaced=1))
    np.testing.assert_array_equal(read_rgb(path), np.full((height, width, 3), 128))
    path.write_bytes(png(8, 0, width, height, rows[:-1], interlaced=1))
    with pytest.raises(DataError, match=rf"expected pixels of {height} rows, got fewer|cannot be"):
        read_rgb(path)


@pytest.mark.parametrize(("kind", "channels"), [(2, 3), (4, 2), (6, 4)])
@pytest.mark.parametrize("white", [None, 4095, "p99"])
def test_channels_of_sixteen_bits_are_refused_not_cut(tmp_path, kind, channels, white):
    path = tmp_path / "deep.png"
    path.write_bytes(png(16, kind, 1, 1, b"\0" + b"\x12\xff" * channels))
    with (
        pytest.raises(DataError, match=r"deep\.png: expected 8 bits per channel.*got more than 8"),
        open_image(path) as image,
    ):
        to_rgb(image, path, white)
    path.write_bytes(png(8, kind, 1, 1, b"\0" + b"\x12" * channels))
    assert read_rgb(path).getpixel((0, 0)) == (0x12, 0x12, 0x12)


@pytest.mark.parametrize("order", ["<", ">"])
def test_color_tiff_of_sixteen_bits_is_refused(tmp_path, order):
    """One pixel by the specification of TIFF 6.0; its three depths lie behind the tags."""
    path, values = tmp_path / "deep.tiff", (0x1234, 0x5678, 0x9ABC)
    depths = 8 + 2 + 9 * 12 + 4
    tags = (
        (256, 3, 1, 1), (257, 3, 1, 1), (258, 3, 3, depths), (259, 3, 1, 1), (262, 3, 1, 2),
        (273, 4, 1, depths + 6), (277, 3, 1, 3), (278, 3, 1, 1), (279, 4, 1, 6),
    )  # fmt: skip
    content = (b"II" if order == "<" else b"MM") + struct.pack(f"{order}HIH", 42, 8, len(tags))
    for tag, kind, count, value in tags:
        form = "HHIH2x" if (kind, count) == (3, 1) else "HHII"
        content += struct.pack(order + form, tag, kind, count, value)
    path.write_bytes(content + struct.pack(f"{order}I3H3H", 0, 16, 16, 16, *values))
    with pytest.raises(DataError, match=r"deep\.tiff: .*got more than 8 in mode RGB"):
        read_rgb(path)


def plain_levels(levels, maxval):
    return f"P2 {len(levels)} 1 {maxval}\n{' '.join(map(str, levels))}\n".encode()


def binary_levels(levels, maxval):
    return f"P5 {len(levels)} 1\n# 12 bits\n{maxval}\n".encode() + struct.pack(
        f">{len(levels)}H", *levels
    )


@pytest.mark.parametrize("form", [plain_levels, binary_levels])
@pytest.mark.parametrize("maxval", [1023, 4095, 4096, 65534, 65535])
def test_white_is_a_level_of_the_file_whatever_its_maxval(tmp_path, form, maxval):
    """Levels as they stand in the file are compared, 1020 as white among others of the range."""
    path = tmp_path / "levels.pgm"
    levels = [0, 204, 205, 510, 1000, 1023, *range(0, maxval, 37), maxval]
    path.write_bytes(form(levels, maxval))
    for white in (1020, maxval):
        with open_image(path) as image:
            found = np.asarray(to_rgb(image, path, white))[0, :, 0]
        expected = np.rint(np.minimum(np.array(levels) / white, 1) * 255)
        np.testing.assert_array_equal(found, expected)


@pytest.mark.skipif(not features.check("jpg_2000"), reason="this Pillow has no JPEG 2000")
def test_jpeg_2000_has_eight_bits_or_sixteen_of_gray(tmp_path):
    """Pillow shifts the levels of other bit depths to 16 bits, or keeps 8 bits of them."""
    path = tmp_path / "deep.jp2"
    Image.fromarray(np.full((64, 64), 1000, np.uint16)).save(path)
    assert read_rgb(path, 2000).getpixel((5, 5)) == (128, 128, 128)
    depth = path.read_bytes().rfind(b"\xff\x4f\xff\x51") + 42  # ISO/IEC 15444-1, A.5.1: Ssiz
    data = bytearray(path.read_bytes())
    assert data[depth] == 15
    data[depth] = 11
    path.write_bytes(data)
    with pytest.raises(DataError, match=r"deep\.jp2: expected .* got 12 in mode I;16"):
        read_rgb(path, 2000)
    Image.new("RGB", (64, 64), (9, 80, 200)).save(path)
    assert read_rgb(path).getpixel((5, 5)) == (9, 80, 200)


def test_color_of_more_than_eight_bits_in_ppm_is_refused(tmp_path):
    path = tmp_path / "deep.ppm"
    path.write_bytes(b"P6 1 1 4095\n" + struct.pack(">3H", 100, 200, 4095))
    with pytest.raises(DataError, match=r"deep\.ppm: .*got more than 8 in mode RGB"):
        read_rgb(path)


@pytest.mark.filterwarnings("ignore::PIL.Image.DecompressionBombWarning")
@pytest.mark.parametrize("height", [MAX_PIXELS // 1000 + 1, 10**7])
def test_an_image_too_large_for_the_memory_is_refused_by_its_header(tmp_path, height):
    path = tmp_path / "bomb.png"
    path.write_bytes(png(8, 0, 1000, height))
    words = (
        rf"bomb\.png: expected an image of at most {MAX_PIXELS:,} pixels, got {1000 * height:,}$"
    )
    with pytest.raises(DataError, match=words), open_image(path):
        pytest.fail("opened")


def test_pixels_are_as_stored_whatever_a_viewer_is_told(tmp_path):
    """An EXIF orientation of 6 is shown turned by a quarter; the calibration is of the file's."""
    told = Image.Exif()
    told[0x0112] = 6
    Image.new("RGB", (32, 16), (200, 0, 0)).save(tmp_path / "turned.jpg", exif=told)
    with Image.open(tmp_path / "turned.jpg") as image:
        assert ImageOps.exif_transpose(image).size == (16, 32)
    assert read_rgb(tmp_path / "turned.jpg").size == (32, 16)


def test_a_tiff_whose_levels_pillow_takes_for_others_is_refused(tmp_path):
    """White is 0 where TIFF 6.0's tag 262 is 0: Pillow inverts images of 8 bits, not of 16."""
    black, white = (struct.pack("<HHII", 262, 3, 1, level) for level in (1, 0))
    for dtype, name in ((np.uint16, "deep.tiff"), (np.uint8, "gray.tiff")):
        levels = RAMP.astype(dtype)
        path = written(tmp_path, levels, name)
        stored = path.read_bytes()
        assert stored.count(black) == 1
        path.write_bytes(stored.replace(black, white))
    assert (np.asarray(read_rgb(path))[..., 0] == 255 - levels).all()
    with pytest.raises(DataError, match="expected level 0 to be black, got a TIFF of more than"):
        read_rgb(tmp_path / "deep.tiff", white=4095)
    Image.fromarray(levels).save(path, tiffinfo={339: 2})  # of -128 to 127
    with pytest.raises(DataError, match="expected levels from 0 to 255, got a TIFF of levels with"):
        read_rgb(path)


def test_a_fits_file_is_refused(tmp_path):
    """Levels of 16 bits are stored less 32,768 (FITS 4.0, table 11): Pillow leaves that out."""
    axes = {"SIMPLE": "T", "BITPIX": 16, "NAXIS": 2, "NAXIS1": 4, "NAXIS2": 3, "BZERO": 32768}
    cards = [f"{name:<8}= {value:>20}".ljust(80) for name, value in axes.items()]
    header = "".join([*cards, "END"]).ljust(2880).encode()
    stored = (RAMP - 32768).astype(">i2").tobytes()
    (tmp_path / "a.fits").write_bytes(header + stored.ljust(2880, b"\0"))
    with pytest.raises(DataError, match="expected levels as they are, as in PNG or TIFF, got FITS"):
        read_rgb(tmp_path / "a.fits", white=11)


@pytest.mark.parametrize("turned", [3, 6])
def test_a_tiff_that_pillow_would_turn_is_refused(turned, tmp_path):
    """By half a turn its size is that of the file."""
    path = tmp_path / "turned.tiff"
    Image.new("RGB", (32, 16), (200, 0, 0)).save(path, tiffinfo={0x0112: turned})
    with pytest.raises(DataError, match="expected pixels as they are stored, got a TIFF to be tur"):
        read_rgb(path)
    Image.new("RGB", (32, 16), (200, 0, 0)).save(path, tiffinfo={0x0112: 1})
    assert read_rgb(path).size == (32, 16)


@pytest.mark.skipif(sys.platform == "win32", reason="there are no named pipes")
def test_what_is_no_regular_file_is_refused_at_once(tmp_path):
    os.mkfifo(tmp_path / "pipe.png")
    (tmp_path / "folder.png").mkdir()
    for kind in ("pipe", "folder"):
        with pytest.raises(DataError, match=rf"{kind}\.png: expected a regular file, got a {kind}"):
            read_rgb(tmp_path / f"{kind}.png")


def test_a_folder_in_a_folder_of_images_is_none_whatever_its_name(tmp_path):
    (tmp_path / "a.png").mkdir()
    (tmp_path / "b.png").write_bytes(png(8, 0, 2, 2))
    (tmp_path / "._b.png").write_bytes(b"what macOS leaves")
    assert find_images([tmp_path]) == [tmp_path / "b.png"]


def test_the_warning_as_an_error_says_the_same(tmp_path):
    path = tmp_path / "bomb.png"
    path.write_bytes(png(8, 0, 1000, 100_000))
    with pytest.raises(DataError, match=r"at most 89,478,485 pixels, got 100,000,000$"):
        read_rgb(path)
