"""Image files: what becomes RGB, and what is refused."""

import numpy as np
import pytest
from PIL import Image

from ffpose.errors import DataError
from ffpose.images import read_rgb

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


@pytest.mark.parametrize(
    ("pixels", "name", "mode"),
    [
        ((RAMP * 5000).astype(np.uint16), "deep.png", "I;16"),
        ((RAMP / 11).astype(np.float32), "real.tiff", "F"),
        (RAMP % 2 == 0, "bits.png", "1"),
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
