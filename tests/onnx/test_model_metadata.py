"""What an exported graph says of itself, against onnx's own reader; what is altered is refused."""

import json
import math
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ffpose.config import PRESETS
from ffpose.errors import DataError
from ffpose.geometry import URSO_CAMERA
from ffpose.imaging.preprocessing import Preprocessing
from ffpose.onnx.metadata import ModelMetadata, read_model, read_model_metadata, sealed
from ffpose.onnx.records import read_entries

onnx = pytest.importorskip("onnx")

METADATA = ModelMetadata(
    PRESETS["polar"],
    Preprocessing((384, 512), interpolation="bicubic"),
    "matmul",
    URSO_CAMERA,
    0.25,
    64 * "a",
)


def graph_bytes(entries):
    """An ONNX file with these entries: one node that gives its input."""
    shape = ["batch", 3]
    ends = [
        onnx.helper.make_tensor_value_info(name, onnx.TensorProto.FLOAT, shape) for name in "xy"
    ]
    node = onnx.helper.make_node("Identity", ["x"], ["y"])
    model = onnx.helper.make_model(onnx.helper.make_graph([node], "g", ends[:1], ends[1:]))
    onnx.helper.set_model_props(model, entries)
    return model.SerializeToString()


@pytest.mark.parametrize("white", [None, 4095.0, "p99.5"])
@pytest.mark.parametrize("undistorted", [False, True])
def test_entries_say_how_images_were_decoded(undistorted, white):
    metadata = replace(METADATA, undistorted=undistorted, white=white)
    assert ModelMetadata.from_entries(metadata.to_entries()) == metadata


def test_infinite_settings_of_a_track_are_a_word():
    entries = replace(METADATA, tracking={"gate": math.inf, "tails": 3.0}).to_entries()
    assert json.loads(entries["tracking"]) == {"gate": "inf", "tails": 3.0}


@pytest.mark.parametrize("locates", ["object", "camera"])
def test_entries_say_what_the_network_locates(locates):
    metadata = replace(METADATA, locates=locates)
    assert ModelMetadata.from_entries(metadata.to_entries()) == metadata
    with pytest.raises(ValueError, match="locates: expected one of"):
        ModelMetadata.from_entries(metadata.to_entries() | {"locates": "ship"})


FILE = sealed(graph_bytes(METADATA.to_entries()))


@pytest.fixture
def written(tmp_path):
    def write(data):
        path = tmp_path / "model.onnx"
        path.write_bytes(data)
        return path

    return write


@pytest.mark.parametrize(
    "metadata",
    [METADATA, replace(METADATA, camera=None, in_view_threshold=None, weights_sha256=None)],
)
def test_what_is_written_is_read(metadata, written):
    assert read_model_metadata(written(sealed(graph_bytes(metadata.to_entries())))) == metadata


def test_a_file_is_read_once(written, monkeypatch):
    path, reads = written(FILE), []
    read = type(path).read_bytes
    monkeypatch.setattr("pathlib.Path.read_bytes", lambda self: reads.append(self) or read(self))
    metadata, data = read_model(path)
    assert (metadata, data, reads) == (METADATA, FILE, [path])


def external(*numbers):
    """A tensor whose data are in another file, within messages that are fields of these numbers."""
    entry = onnx.StringStringEntryProto(key="location", value="w.bin").SerializeToString()
    message = b"\x42\x01w" + bytes([13 << 3 | 2, len(entry)]) + entry
    for number in numbers:
        key = [number << 3 | 2] if number < 16 else [number << 3 & 0x7F | 0x82, number >> 4]
        message = bytes([*key, len(message)]) + message
    return message


@pytest.mark.parametrize(
    "numbers",
    [
        (5, 7),  # an initializer
        (1, 15, 7),  # the values of a sparse one
        (5, 5, 1, 7),  # a constant
        (5, 6, 5, 1, 7),  # an initializer of a branch
        (5, 5, 1, 11, 5, 1, 7),  # a constant of one of several
        (5, 5, 7, 25),  # a constant of a function
    ],
)
def test_weights_in_other_files_are_refused(numbers, written):
    plain = graph_bytes(METADATA.to_entries())
    with pytest.raises(DataError, match=r"all weights in this file.* tensor 'w' with external"):
        read_model(written(sealed(plain + external(*numbers))))
    read_model(written(sealed(plain + external(9, *numbers))))  # as raw data of another tensor


def test_onnx_reads_the_same_entries_and_the_graph():
    model = onnx.load_from_string(FILE)
    onnx.checker.check_model(model, full_check=True)
    assert {entry.key: entry.value for entry in model.metadata_props} == dict(read_entries(FILE))


@given(st.integers(0, len(FILE) - 1), st.integers(1, 255))
def test_a_changed_byte_is_refused(place, change):
    altered = bytearray(FILE)
    altered[place] ^= change
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("pathlib.Path.is_file", lambda self: True)
        patch.setattr("pathlib.Path.read_bytes", lambda self: bytes(altered))
        with pytest.raises(DataError, match=r"^model\.onnx: "):
            read_model_metadata("model.onnx")


@given(st.integers(0, len(FILE) - 1))
def test_a_file_that_is_cut_short_is_refused(length):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("pathlib.Path.is_file", lambda self: True)
        patch.setattr("pathlib.Path.read_bytes", lambda self: FILE[:length])
        with pytest.raises(DataError, match=r"^model\.onnx: "):
            read_model_metadata("model.onnx")


def test_the_errors_say_what_is_wrong(written, tmp_path):
    with pytest.raises(DataError, match="one without its metadata"):
        read_model_metadata(written(graph_bytes({"author": "someone else"})))
    with pytest.raises(DataError, match="altered: expected its SHA-256 in it"):
        read_model_metadata(written(graph_bytes(METADATA.to_entries())))
    middle = len(FILE) // 4  # in the value of an entry
    altered = FILE[:middle] + bytes([FILE[middle] ^ 1]) + FILE[middle + 1 :]
    with pytest.raises(DataError, match=r"altered: expected SHA-256 \w{64}, got \w{64}"):
        read_model_metadata(written(altered))
    with pytest.raises(DataError, match="altered: expected SHA-256"):
        read_model_metadata(written(FILE + graph_bytes({})))
    newer = METADATA.to_entries() | {"ffpose_format": "3", "ffpose_version": "9.9"}
    with pytest.raises(DataError, match=r"format 2, .* got format 3, written by ffpose 9\.9"):
        read_model_metadata(written(sealed(graph_bytes(newer))))
    other = METADATA.to_entries() | {"quaternion_order": "xyzw"}
    with pytest.raises(DataError, match=r"quaternion_order: expected .*'wxyz'.*, got 'xyzw'"):
        read_model_metadata(written(sealed(graph_bytes(other))))
    with pytest.raises(DataError, match="expected an ONNX file"):
        read_model_metadata(written(b"\x89PNG\r\n\x1a\n"))
    with pytest.raises(FileNotFoundError, match="model: expected a file"):
        read_model_metadata(tmp_path / "nowhere.onnx")
