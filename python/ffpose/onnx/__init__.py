"""Deployment: export of networks as ONNX graphs, and inference without torch.

* `export` writes any module with spectral filters as an ONNX graph; needs the extra ``[export]``.
* `ffpose.onnx.backends` opens them in ONNX Runtime or OpenVINO; torch is never imported.
  `ffpose.load` gives poses from images by the graphs of ``ffpose export``.
* `get_library_path` gives the library with the operator ``ffpose::SpectralFilter``, which the
  graphs of ``filter="custom"`` call.

Importing this module imports NumPy alone.
"""

from typing import TYPE_CHECKING, Any

from ffpose.onnx.library import get_library_path

if TYPE_CHECKING:
    from ffpose.onnx.exporter import Exported, export

__all__ = ["Exported", "export", "get_library_path"]


def __getattr__(name: str) -> Any:
    """Import the exporter, and so torch, only when it is asked for."""
    if name in ("Exported", "export"):
        from ffpose.onnx import exporter

        return getattr(exporter, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
