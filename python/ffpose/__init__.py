"""Spectral filters and satellite pose: the part that needs NumPy alone.

Importing ``ffpose`` does not import torch. Tensors and gradients are in `ffpose.ops`, layers in
`ffpose.nn`, the network in `ffpose.models`; the conventions of frames, quaternions and pixels in
`ffpose.geometry`.
"""

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

__all__ = [
    "Camera",
    "DataError",
    "Pose",
    "__version__",
    "normalize_quaternion",
    "quaternion_to_euler",
    "rotation_error",
    "spectral_filter",
    "translation_error",
]
