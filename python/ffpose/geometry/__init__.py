"""Cameras, poses and quaternions, and the conventions of the whole package.

All other modules follow these conventions, and convert data in other conventions on entry.

* **Camera frame**: x right, y down, z forward (that of OpenCV), right-handed, in meters.
* **Pose**: transforms points to the camera frame, ``p_camera = R(q) @ p_object + t``.
* **Quaternion**: Hamilton's, scalar first ``(w, x, y, z)``, unit norm. ``q`` and ``-q`` are the
  same rotation; a `Pose` stores the canonical one, whose first nonzero component is positive:
  ``w > 0``, or for a half turn ``w = 0`` and ``x > 0``, and so on
  (`ffpose.arrays.canonical_quaternion`).
* **Flat vector**: ``[tx, ty, tz, qw, qx, qy, qz]``.
* **Pixels**: continuous coordinates ``(u, v)``, u to the right and v downward. The image covers
  ``[0, width] x [0, height]``, so the center of the top left pixel is ``(0.5, 0.5)`` and a resize
  is a plain scaling.

`ffpose._internal.urso` says how the labels of URSO convert.
"""

from ffpose.geometry.camera import CAMERA_FILE, URSO_CAMERA, Camera, DistortedCamera
from ffpose.geometry.pose import (
    POSE_COLUMNS,
    Pose,
    PoseUncertainty,
    Target,
    camera_pose,
    poses,
    standard_deviations,
)
from ffpose.geometry.rotations import FloatArray, rotation_matrix

__all__ = [
    "CAMERA_FILE",
    "POSE_COLUMNS",
    "URSO_CAMERA",
    "Camera",
    "DistortedCamera",
    "FloatArray",
    "Pose",
    "PoseUncertainty",
    "Target",
    "camera_pose",
    "poses",
    "rotation_matrix",
    "standard_deviations",
]
