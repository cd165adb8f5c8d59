"""Poses and their uncertainty, in the conventions of `ffpose.geometry`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from ffpose._internal import urso
from ffpose.arrays import canonical_quaternion
from ffpose.errors import expect
from ffpose.geometry.camera import Camera
from ffpose.geometry.rotations import (
    FloatArray,
    real_array,
    rotation_matrix,
    unit_quaternion,
)

POSE_COLUMNS = ("tx", "ty", "tz", "qw", "qx", "qy", "qz")
"""Names of a pose's numbers in tables: translation in meters, and quaternion."""

Target = Literal["object", "camera"]
"""What labels and networks locate: the object in the camera frame, or the camera in the world."""


@dataclass(frozen=True, slots=True, eq=False)
class PoseUncertainty:
    """Predicted uncertainty of a pose: distribution of its errors, a second mode, object in view.

    The errors of translation and rotation have multivariate t distributions: with ν degrees of
    freedom and ``d² = eᵀ C⁻¹ e``, ``d² ν / (3 (ν - 2))`` is F-distributed with 3 and ν degrees of
    freedom, whose quantiles give the confidence regions. Equality is by value.

    Attributes:
        translation_covariance: ``(3, 3)`` square meters, camera frame; float64.
        rotation_covariance: ``(3, 3)`` square radians, covariance of the rotation vector ``r``,
            camera frame, with ``R_true = exp([r]x) @ R_predicted``, where ``R_predicted`` is the
            pose's rotation or that of ``alternative``, the one that is near; float64.
        in_view: Probability that the object is in the image at all.
        in_view_threshold: Probability below which the object counts as not in view; None where the
            network has none.
        degrees_of_freedom: Of the errors of translation and of rotation, above 2 each; None for
            Gaussian errors, whose ``d²`` is chi-square distributed with 3 degrees of freedom.
        alternative: Second most likely orientation ``(4,)``, as `Pose.q`; None where none is known.
        probabilities: Of the true orientation being near the pose's, and near ``alternative``.

    Raises:
        TypeError: A covariance does not hold real numbers.
        ValueError: A shape is wrong, a value not finite, a probability outside 0…1, or degrees of
            freedom of 2 or less.
    """

    translation_covariance: FloatArray
    rotation_covariance: FloatArray
    in_view: float
    in_view_threshold: float | None = None
    degrees_of_freedom: tuple[float, float] | None = None
    alternative: FloatArray | None = None
    probabilities: tuple[float, float] = (1.0, 0.0)

    def __post_init__(self) -> None:
        for name in ("translation_covariance", "rotation_covariance"):
            matrix = real_array(name, getattr(self, name), 3)
            expect(matrix.shape == (3, 3), name, "shape (3, 3)", matrix.shape)
            matrix.setflags(write=False)
            object.__setattr__(self, name, matrix)
        expect(0 <= self.in_view <= 1, "in_view", "a probability", self.in_view)
        threshold = self.in_view_threshold
        usable = threshold is None or 0 <= threshold <= 1
        expect(usable, "in_view_threshold", "a probability", threshold)
        degrees = self.degrees_of_freedom or ()
        expect(all(n > 2 for n in degrees), "degrees_of_freedom", "above 2 each", degrees)
        shares = self.probabilities
        expect(all(0 <= p <= 1 for p in shares), "probabilities", "in 0…1", shares)
        if self.alternative is not None:
            q = canonical_quaternion(unit_quaternion(self.alternative))
            expect(q.shape == (4,), "alternative", "shape (4,)", q.shape)
            q.setflags(write=False)
            object.__setattr__(self, "alternative", q)

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, PoseUncertainty):
            return NotImplemented
        return self._values() == other._values()

    def __hash__(self) -> int:
        return hash(self._values())

    def _values(self) -> tuple[Any, ...]:
        covariances = np.ravel((self.translation_covariance, self.rotation_covariance)).tolist()
        other = None if self.alternative is None else tuple(self.alternative.tolist())
        in_view = (self.in_view, self.in_view_threshold)
        return (*covariances, *in_view, self.degrees_of_freedom, other, self.probabilities)


@dataclass(frozen=True, slots=True, init=False, eq=False)
class Pose:
    """Position and orientation of an object: ``p_camera = R(q) @ p_object + t``.

    Equality is exact and by value: two poses are equal, and have equal hashes, if translation,
    rotation and uncertainty are equal. ``q`` and ``-q`` make equal poses.

    Attributes:
        t: Translation ``(3,)``, meters, camera frame; read-only float64.
        q: Orientation ``(4,)``, Hamilton quaternion ``(w, x, y, z)`` with unit norm and canonical
            sign; read-only float64.
        uncertainty: Uncertainty of a prediction; None for a label, or if the network has none.

    Examples:
        >>> Pose([1, 2, 10], [-0.6, 0.8, 0, 0]).q.tolist() == [0.6, -0.8, 0, 0]
        True
        >>> Pose([1, 2, 10], [0, 0, 0, -1]) == Pose([1, 2, 10], [0, 0, 0, 1])
        True
    """

    t: FloatArray
    q: FloatArray
    uncertainty: PoseUncertainty | None

    def __init__(
        self, t: ArrayLike, q: ArrayLike, uncertainty: PoseUncertainty | None = None
    ) -> None:
        """Check and store a pose; the sign of q is made canonical.

        Raises:
            TypeError: The values are not real numbers.
            ValueError: Wrong shape, a value that is not finite, or a quaternion whose norm is
                farther than `QUATERNION_TOLERANCE` from one; a closer one is normalized.
        """
        translation = real_array("translation", t, 3)
        quaternion = unit_quaternion(q)
        if translation.ndim != 1 or quaternion.ndim != 1:
            raise ValueError(
                "pose: expected translation (3,) and quaternion (4,), "
                f"got {translation.shape} and {quaternion.shape}"
            )
        for name, array in (("t", translation), ("q", canonical_quaternion(quaternion))):
            array.setflags(write=False)
            object.__setattr__(self, name, array)
        object.__setattr__(self, "uncertainty", uncertainty)

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Pose):
            return NotImplemented
        return bool((self.vector == other.vector).all()) and self.uncertainty == other.uncertainty

    def __hash__(self) -> int:
        return hash((*self.vector.tolist(), self.uncertainty))

    @classmethod
    def from_vector(cls, vector: ArrayLike) -> Pose:
        """Build a pose from ``[tx, ty, tz, qw, qx, qy, qz]``, meters and a unit quaternion.

        Raises:
            ValueError: There are not seven finite numbers, or the quaternion's norm is not one.
        """
        array = real_array("pose vector", vector, 7)
        return cls(array[..., :3], array[..., 3:])

    @classmethod
    def from_urso(
        cls, *, x: float, y: float, z: float, q1: float, q2: float, q3: float, q4: float
    ) -> Pose:
        """Build a pose from a row of URSO's labels, of a left-handed camera frame.

        In meters ``x`` is to the right, ``y`` up and ``z`` the depth; the quaternion ``q1`` ...
        ``q4`` is JPL's, its scalar last.

        Raises:
            ValueError: A number is not finite, or the quaternion's norm is not one.

        Examples:
            >>> from ffpose.geometry import URSO_CAMERA
            >>> pose = Pose.from_urso(x=2, y=1, z=10, q1=0, q2=0, q3=0, q4=1)
            >>> pose.project([0.0, 0.0, 0.0], URSO_CAMERA).round(2).tolist()
            [768.0, 415.95]
        """
        return cls(*urso.from_label(x, y, z, q1, q2, q3, q4))

    def to_urso(self) -> dict[str, float]:
        """Return this pose as a row of URSO's labels: x, y, z, q1, q2, q3, q4."""
        row = urso.to_label(self.t.tolist(), self.q.tolist())
        return dict(zip(urso.COLUMNS, row, strict=True))

    @property
    def flagged(self) -> bool | None:
        """Whether the object counts as not in view; None where the network does not say."""
        said = self.uncertainty
        if said is None or said.in_view_threshold is None:
            return None
        return said.in_view < said.in_view_threshold

    @property
    def vector(self) -> FloatArray:
        """Flat vector ``(7,)``, ``[tx, ty, tz, qw, qx, qy, qz]``."""
        return np.concatenate([self.t, self.q])

    @property
    def rotation(self) -> FloatArray:
        """Rotation matrix ``(3, 3)`` from the object frame to the camera frame."""
        return rotation_matrix(self.q)

    @property
    def camera_center(self) -> FloatArray:
        """Center of the camera in the object's frame ``(3,)``, meters: ``-R(q)ᵀ t``.

        Examples:
            >>> camera_pose([1, 2, 3], [0, 0, 0, 1]).camera_center.tolist()
            [1.0, 2.0, 3.0]
        """
        return np.asarray(-self.rotation.T @ self.t)

    def transform(self, points: ArrayLike) -> FloatArray:
        """Transform points of the object ``(..., 3)`` to the camera frame, meters."""
        return real_array("points", points, 3) @ self.rotation.T + self.t

    def project(self, points: ArrayLike, camera: Camera) -> FloatArray:
        """Project points of the object ``(..., 3)`` to pixels ``(..., 2)``, as `Camera.project`."""
        return camera.project(self.transform(points))


def camera_pose(center: ArrayLike, q: ArrayLike) -> Pose:
    """Return the pose of the world in the frame of a camera.

    Args:
        center: Center of the camera in the world ``(3,)``, meters.
        q: Unit quaternion ``(4,)``, ``(w, x, y, z)``, from the world to the camera frame.

    Raises:
        TypeError: The values are not real numbers.
        ValueError: As `Pose`.

    Example:
        >>> camera_pose([0, 0, -4], [1, 0, 0, 0]).transform([0.0, 0.0, 0.0]).tolist()
        [0.0, 0.0, 4.0]
    """
    still = Pose(center, q)  # checks both
    return Pose(-rotation_matrix(still.q) @ still.t, still.q)


def standard_deviations(t: FloatArray, uncertainty: PoseUncertainty) -> tuple[float, float, float]:
    """Return the standard deviations of the distance and of the rotation's two parts.

    Along the viewing ray ``u`` to ``t``: ``sqrt(uᵀ C u)`` of the translation, meters, and of the
    rotation vector, which is the rotation in plane, degrees; and out of plane, the root mean square
    length of the rotation vector across the ray, ``sqrt(trace C - uᵀ C u)``, degrees.
    """
    ray = t / np.linalg.norm(t)
    distance = np.sqrt(ray @ uncertainty.translation_covariance @ ray)
    along = ray @ uncertainty.rotation_covariance @ ray
    across = np.trace(uncertainty.rotation_covariance) - along
    return float(distance), *np.degrees(np.sqrt([along, across])).tolist()


def poses(
    translation: ArrayLike,
    orientation: ArrayLike,
    translation_covariance: ArrayLike | None = None,
    rotation_covariance: ArrayLike | None = None,
    in_view: ArrayLike | None = None,
    alternative: ArrayLike | None = None,
    probabilities: ArrayLike | None = None,
    *,
    locates: Target = "object",
    in_view_threshold: float | None = None,
    degrees_of_freedom: tuple[float, float] | None = None,
) -> list[Pose]:
    """Return the poses of a batch, as a network gives it.

    Args:
        translation: ``(B, 3)``, as `Pose`; from a network that locates the camera, its center.
        orientation: ``(B, 4)``, as `Pose`.
        translation_covariance: ``(B, 3, 3)``, as `PoseUncertainty`; None where the network has no
            uncertainty, and so the next two.
        rotation_covariance: ``(B, 3, 3)``, as `PoseUncertainty`.
        in_view: ``(B,)``, as `PoseUncertainty`.
        alternative: ``(B, 4)``, as `PoseUncertainty`; None, as the next, where none is known.
        probabilities: ``(B, 2)``, as `PoseUncertainty`.
        locates: What the network locates. Where it is the camera, the poses are those of the world
            in the camera frame (`camera_pose`).
        in_view_threshold: Of the network, as `PoseUncertainty`.
        degrees_of_freedom: Of the network, as `PoseUncertainty`.

    Raises:
        TypeError: As `Pose`.
        ValueError: As `Pose` and `PoseUncertainty`: a value that is not finite, for one.
    """
    rows = zip(np.asarray(translation), np.asarray(orientation), strict=True)
    if translation_covariance is None or rotation_covariance is None or in_view is None:
        pose = Pose if locates == "object" else camera_pose
        return [pose(t, q) for t, q in rows]
    count = len(np.asarray(in_view))
    others = [None] * count if alternative is None else np.asarray(alternative)
    shares = np.tile([1.0, 0.0], (count, 1)) if probabilities is None else probabilities
    uncertainties = (
        PoseUncertainty(t, r, p, in_view_threshold, degrees_of_freedom, other, (first, second))
        for t, r, p, other, (first, second) in zip(
            np.asarray(translation_covariance),
            np.asarray(rotation_covariance),
            np.asarray(in_view, np.float64).tolist(),
            others,
            np.asarray(shares, np.float64).tolist(),
            strict=True,
        )
    )
    return [Pose(t, q, u) for (t, q), u in zip(rows, uncertainties, strict=True)]
