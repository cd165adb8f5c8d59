"""Files of binary glTF: a header and one buffer."""

import json
import struct


def write_glb(path, header, blob):
    """Write a header and a buffer, which it names already, as a ``.glb`` file; return its path."""
    text = json.dumps(header).encode()
    text += b" " * (-len(text) % 4)
    path.write_bytes(
        struct.pack("<4sII", b"glTF", 2, 28 + len(text) + len(blob))
        + struct.pack("<I4s", len(text), b"JSON")
        + text
        + struct.pack("<I4s", len(blob), b"BIN\0")
        + blob
    )
    return path
