"""Records of protobuf messages, of which ONNX files consist, read without a library.

See https://protobuf.dev/programming-guides/encoding, "Message Structure"; the numbers of fields are
those of onnx.proto.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

METADATA_PROPS = 14
"""Number of the field in ONNX's ModelProto; within an entry, 1 is the key and 2 the value."""

EXTERNAL_DATA = 13
"""Number of the field of a tensor that names the file with its data."""

MAX_DEPTH = 100
"""Protobuf's own limit of messages within messages."""

HOLDERS: Mapping[str, Mapping[int, str]] = {
    "model": {7: "graph", 20: "training", 25: "function"},
    "training": {1: "graph", 2: "graph"},
    "graph": {1: "node", 5: "tensor", 15: "sparse"},
    "node": {5: "attribute"},
    "attribute": {5: "tensor", 6: "graph", 10: "tensor", 11: "graph", 22: "sparse", 23: "sparse"},
    "function": {7: "node", 11: "attribute"},
    "sparse": {1: "tensor", 2: "tensor"},
    "tensor": {},
}
"""The messages that hold tensors, and by number their fields that do."""


def read_entries(data: bytes) -> Iterator[tuple[str, str]]:
    """Yield keys and values of ``metadata_props`` in the bytes of an ONNX file, as `records`."""
    for field, entry in records(memoryview(data)):
        if field == METADATA_PROPS:
            parts = {number: bytes(part).decode() for number, part in records(entry)}
            yield parts.get(1, ""), parts.get(2, "")


def expect_self_contained(message: memoryview, kind: str = "model", depth: int = 0) -> None:
    """Refuse an ONNX file whose weights are not all in its own bytes, which a checksum covers.

    Raises:
        ValueError: A tensor is in another file; or the bytes are no such message, or have too many
            within each other.
    """
    if depth > MAX_DEPTH:
        raise ValueError(f"expected at most {MAX_DEPTH} messages within each other, got more")
    fields = HOLDERS[kind]
    for number, part in records(message):
        if number in fields:
            expect_self_contained(part, fields[number], depth + 1)
        elif kind == "tensor" and number == EXTERNAL_DATA:
            name = bytes(dict(records(message)).get(8, b"")).decode(errors="replace")
            raise ValueError(
                "expected all weights in this file, whose bytes are checked, got tensor"
                f" {name!r} with external data"
            )


def records(data: memoryview) -> Iterator[tuple[int, memoryview]]:
    """Yield number and bytes of each length-delimited field; the others are skipped.

    Raises:
        ValueError: The bytes are not a protobuf message.
    """
    place = 0
    while place < len(data):
        key, place = _varint(data, place)
        field, kind = key >> 3, key & 7
        match kind:
            case 0:
                _, place = _varint(data, place)
            case 1 | 5:
                place += 8 if kind == 1 else 4
            case 2:
                length, place = _varint(data, place)
                if place + length <= len(data):
                    yield field, data[place : place + length]
                place += length
            case _:
                raise ValueError(f"unknown wire type {kind} at byte {place}")
        if field == 0 or place > len(data):
            raise ValueError(f"a record of field {field} ends at byte {place} of {len(data)}")


def _varint(data: memoryview, place: int) -> tuple[int, int]:
    """Return the varint at ``place``, seven bits per byte, and the place after it."""
    value = 0
    for shift in range(0, 70, 7):
        if place >= len(data):
            break
        value |= (data[place] & 0x7F) << shift
        place += 1
        if data[place - 1] < 0x80:
            return value, place
    raise ValueError(f"a number does not end at byte {place}")
