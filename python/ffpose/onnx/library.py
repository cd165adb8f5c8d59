"""The C library with the operator ``ffpose::SpectralFilter`` for ONNX Runtime."""

from __future__ import annotations

import sys
from importlib import resources
from pathlib import Path

NAMES = {"darwin": "libffpose_ort.dylib", "win32": "ffpose_ort.dll"}
"""By `sys.platform`; elsewhere `ELF_NAME`."""

ELF_NAME = "libffpose_ort.so"


def get_library_path() -> str:
    """Return the absolute path of the library, for ``SessionOptions.register_custom_ops_library``.

    Raises:
        FileNotFoundError: This installation holds no library.
    """
    folder = Path(str(resources.files("ffpose"))) / "onnx"
    path = (folder / NAMES.get(sys.platform, ELF_NAME)).absolute()
    if not path.is_file():
        raise FileNotFoundError(
            f"expected the library of the custom operator at {path}, got none: install a"
            " wheel that holds it, or export standard operators alone with --filter matmul"
        )
    return str(path)
