"""Fast spectral filters, and satellite pose from one image.

This top-level module needs only NumPy; importing it does not import torch. `load` opens a network,
which then gives the pose of the spacecraft in an image. The filter is `spectral_filter` of arrays,
a differentiable operator in `ffpose.ops` and a layer in `ffpose.nn`; networks are in
`ffpose.models`, the renderer in `ffpose.render`, training in `ffpose.training` and, from a mesh
alone, `ffpose.learn`, deployment in `ffpose.onnx`, tracking in `ffpose.tracking`, and the
conventions of frames, quaternions and pixels in `ffpose.geometry`.
"""

# Before NumPy, which ends the process on a processor that `_rust` refuses in a sentence.
from ffpose import _rust as _rust
from ffpose.arrays import (
    __version__,
    normalize_quaternion,
    quaternion_to_euler,
    rotation_error,
    spectral_filter,
    translation_error,
)
from ffpose.errors import DataError
from ffpose.geometry import Camera, Pose
from ffpose.inference.load import load

__all__ = [
    "Camera",
    "DataError",
    "Pose",
    "__version__",
    "load",
    "normalize_quaternion",
    "quaternion_to_euler",
    "rotation_error",
    "spectral_filter",
    "translation_error",
]
