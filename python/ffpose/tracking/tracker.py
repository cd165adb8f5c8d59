"""The tracker of ``crates/ffpose-track``, which the onboard program runs too.

A multiplicative extended Kalman filter (Lefferts, Markley and Shuster, *Journal of Guidance,
Control, and Dynamics* 5(5), 1982; Markley, *ibid.* 26(2), 2003) over position, velocity, attitude
and angular velocity. A network's errors repeat while the object shows the same side, and are
considered beside them (Schmidt), not estimated: first-order Gauss-Markov processes in the angle
turned, not in time.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, fields
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from ffpose import _rust
from ffpose._internal.files import read_json, shortened
from ffpose.errors import DataError
from ffpose.geometry import FloatArray, Pose
from ffpose.geometry.symmetry import IDENTITY, SymmetryGroup

if TYPE_CHECKING:
    from ffpose.inference.estimator import Description

INFINITE = "inf"
"""What stands for infinity in settings of JSON files and metadata."""

Outcome = Literal["accepted", "switched", "gated", "flagged", "coasted", "acquiring", "lost"]
"""What became of a frame.

``"accepted"``: it corrected the track. ``"switched"``: another attitude hypothesis leads from now
on, because the frame supports it, or because no frame has supported the one before
(`Step.accepted` tells which). ``"gated"``: its pose is too far from the predicted one.
``"flagged"``: it shows no spacecraft. ``"coasted"``: there was no pose. ``"acquiring"``: there is
no track yet. ``"lost"``: the track went too long without a frame that it could believe, or too many
views contradicted it.
"""


@dataclass(frozen=True)
class Settings:
    """What a tracker expects of the motion and of the network's errors, and how it decides.

    Attributes:
        acceleration: White acceleration of the relative motion, m/s² per √Hz.
        angular_acceleration: White angular acceleration, deg/s² per √Hz.
        asymmetry: Uncertainty of a free body's angular acceleration, as a share of the square of
            its angular velocity, white over the time in which it turns by a radian: about 0.12
            while the inertia is unknown, or the relative error of a known inertia.
        inertia: Moments and products about the object's axes, ``(xx, yy, zz, xy, xz, yz)`` of any
            unit: the object turns as a free rigid body does, a sphere at a constant angular
            velocity.
        velocity: Standard deviation of each component of a velocity not yet seen, m/s.
        rate: Standard deviation of each component of an angular velocity not yet seen, deg/s.
        position_angle: Angle turned at which the correlation of the position's errors has fallen
            to 1/e, degrees.
        attitude_angle: The same of the attitude's errors.
        position_noise: Share of the position's variance that is new in each frame, above 0 to 1.
        attitude_noise: The same of the attitude's variance.
        gate: Squared Mahalanobis distance, of six degrees of freedom, above which a frame is not
            believed; infinite for no gate.
        tails: Degrees of freedom of the errors' tails; frames far off count less. Infinite for
            Gaussian errors.
        said_views: Weight of the network's own covariances against the NIS of the frames, by which
            the covariance of a track (`Estimate.covariance`) is scaled: they count as much as so
            many independent views. Infinite: they alone count.
        ordinary_nis: Mean `Step.nis` of frames whose errors are as large as the network says. It is
            below six, as the part of an error that is new in each frame is inflated.
        agreeing: Frames in agreement that make a track.
        coasting: Seconds without a believed frame after which the track is lost, whether there were
            steps without a pose in that time or no steps.
        orbital_rate: The orbit's angular velocity, deg/s along the camera's axes, of a camera that
            keeps its attitude to the Earth: position and velocity then move as Clohessy and
            Wiltshire's equations say, and it is against the stars, not the camera, that a free
            object turns. Zero for straight lines.
        zenith: Unit vector away from the Earth along the camera's axes; counts with an orbital rate
            alone.
    """

    acceleration: float = 1e-4
    angular_acceleration: float = 0.001
    asymmetry: float = 0.12
    inertia: tuple[float, float, float, float, float, float] = (1.0, 1.0, 1.0, 0.0, 0.0, 0.0)
    velocity: float = 0.3
    rate: float = 5.0
    position_angle: float = 20.0
    attitude_angle: float = 15.0
    position_noise: float = 0.2
    attitude_noise: float = 0.3
    gate: float = 60.0
    tails: float = 3.0
    said_views: float = 3.0
    ordinary_nis: float = 2.0
    agreeing: int = 4
    coasting: float = 10.0
    orbital_rate: tuple[float, float, float] = (0.0, 0.0, 0.0)
    zenith: tuple[float, float, float] = (0.0, -1.0, 0.0)

    @classmethod
    def of(cls, network: Description, settings: Mapping[str, Any] | None = None) -> Settings:
        """Return what a network's metadata says of its errors, but for fields of ``settings``.

        In both ``"inf"`` stands for infinity, for which JSON has no number.

        Raises:
            ValueError: ``tracking`` or ``settings`` has a field that is none.
        """
        told: dict[str, Any] = {}
        for source, given in (("tracking", network.tracking), ("settings", settings)):
            told |= {
                name: math.inf if value == INFINITE else value
                for name, value in (given or {}).items()
            }
            if unknown := sorted(told.keys() - {field.name for field in fields(cls)}):
                raise ValueError(f"{source}: expected fields of Settings, got {', '.join(unknown)}")
        degrees = network.config.degrees_of_freedom
        if degrees is not None:
            told = {"tails": min(degrees), **told}
        return cls(**told)


def read_settings(path: Path | None, network: Description) -> Settings:
    """Return the settings of a network, with what a JSON file says in place of its own.

    Raises:
        FileNotFoundError: The file does not exist.
        DataError: It is no JSON object of fields of `Settings`, finite numbers or ``"inf"``.
    """
    if path is None:
        return Settings.of(network)
    told = read_json(path)
    try:
        if not isinstance(told, dict):
            raise ValueError(f"expected a JSON object, got {type(told).__name__}")
        for name, value in told.items():
            numbers = value if isinstance(value, list) else [value]
            if value != INFINITE and not all(_is_number(number) for number in numbers):
                expected = f'finite numbers, or "{INFINITE}" for infinity'
                raise ValueError(f"{name}: expected {expected}, got {shortened(value)}")
        settings = Settings.of(network, told)
        Tracker(settings)
    except (OverflowError, TypeError, ValueError) as error:
        raise DataError(str(error), path) from error
    return settings


def _is_number(value: object) -> bool:
    """Return whether a value of a JSON file is a number of JSON's own: Python takes others too."""
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


@dataclass(frozen=True, eq=False)
class Estimate:
    """Motion of the object at the time of a frame.

    Attributes:
        t: Position ``(3,)``, meters, camera frame.
        q: Unit quaternion ``(w, x, y, z)`` ``(4,)`` from the object's to the camera's axes.
        v: Velocity ``(3,)``, m/s along the camera's axes; with ``camera_rate`` that against a
            camera that does not turn.
        w: Angular velocity relative to the camera ``(3,)``, deg/s along the object's axes.
        covariance: ``(12, 12)`` of the errors of position (m), velocity (m/s), attitude (rad, the
            vector ``r`` along the object's axes with ``R_true = R exp([r]x)``) and angular velocity
            (rad/s).
    """

    t: FloatArray
    q: FloatArray
    v: FloatArray
    w: FloatArray
    covariance: FloatArray

    @property
    def pose(self) -> Pose:
        """Position and orientation."""
        return Pose(self.t, self.q)

    @property
    def standard_deviations(self) -> FloatArray:
        """``(12,)``: meters, m/s, degrees and deg/s, in the order of the covariance."""
        deviations = np.sqrt(np.diag(self.covariance))
        deviations[6:] = np.degrees(deviations[6:])
        return deviations


@dataclass(frozen=True, eq=False)
class Step:
    """Outcome of a step of the tracker, and the estimate after it.

    Attributes:
        time: Its time, seconds.
        outcome: What became of it.
        accepted: Whether the frame corrected the track that leads.
        estimate: The motion at its time; None without a track.
        nis: Normalized innovation squared: the squared Mahalanobis distance of the frame's pose
            from the prediction of the track that led before, six degrees of freedom. None if no
            track led before, none leads now, or there is no pose.
        mode: Which of the frame's orientations that track was compared with, 0 or 1; None as above.
    """

    time: float
    outcome: Outcome
    accepted: bool
    estimate: Estimate | None
    nis: float | None
    mode: int | None


class Tracker:
    """Position, velocity, attitude and angular velocity from poses and times.

    Args:
        settings: What it expects and how it decides.
        symmetry: Symmetry modulo which the network estimates attitudes (`PoseEstimator.metadata`):
            of the equivalent attitudes a track takes the one nearest to its own. About an axis of
            any angle neither attitude nor angular velocity can be seen, and their standard
            deviations mean nothing.

    Raises:
        ValueError: A setting is out of its range, or the symmetry is of no finite group.

    Examples:
        >>> from ffpose.geometry import PoseUncertainty
        >>> tracker = Tracker(Settings(agreeing=2))
        >>> said = PoseUncertainty(0.01 * np.eye(3), 0.001 * np.eye(3), in_view=1)
        >>> for time in range(20):
        ...     pose = Pose([0, 0, 20 - 0.1 * time], [1, 0, 0, 0], said)
        ...     step = tracker.step(time, pose)
        >>> step.estimate.v.round(2).tolist()
        [0.0, 0.0, -0.1]
    """

    def __init__(
        self, settings: Settings | None = None, *, symmetry: SymmetryGroup = IDENTITY
    ) -> None:
        named = asdict(settings or Settings()).items()
        self._symmetry = symmetry
        self._tracker = _rust.Tracker(
            {name: np.atleast_1d(np.asarray(value, np.float64)).tolist() for name, value in named},
            list(symmetry.axes),
        )

    @property
    def symmetry(self) -> SymmetryGroup:
        """Symmetry modulo which the poses' attitudes are known."""
        return self._symmetry

    @property
    def time(self) -> float | None:
        """Time of the last frame, seconds; None before the first."""
        return self._tracker.time

    def step(
        self,
        time: float,
        pose: Pose | None,
        *,
        camera_rate: ArrayLike = (0.0, 0.0, 0.0),
    ) -> Step:
        """Advance to the time of a frame, and update with its pose.

        Args:
            time: Middle of the exposure, seconds; later than the frame before. Where no track leads
                it may be earlier by more than ``coasting``, and where nothing is followed anything.
            pose: Pose of the object as a network with uncertainty gives it, a second orientation
                included; None for a frame that never came. A flagged one corrects nothing.
            camera_rate: The camera's own angular velocity since the frame before, as a gyro
                measures it ``(3,)``, deg/s along the camera's axes; zero with an orbital rate.

        Raises:
            TypeError: The pose is none.
            ValueError: The time is not later where it must be, the pose has no uncertainty, or a
                covariance is not positive definite; nothing has changed then.
        """
        poses = None if pose is None else _modes(pose)
        if pose is not None and pose.flagged:
            poses = []
        told = self._tracker.step(float(time), poses, _turning(camera_rate))
        estimate = None if told["estimate"] is None else _estimate(told["estimate"])
        rest = told["nis"], told["mode"]
        return Step(float(time), told["outcome"], told["accepted"], estimate, *rest)

    def expected(
        self, time: float, *, camera_rate: ArrayLike = (0.0, 0.0, 0.0)
    ) -> FloatArray | None:
        """Return where to look for the object in a frame at a time ``(3,)``, meters, camera frame.

        None where the whole frame must be searched, as there is no track, or the last frame that
        came did not correct it. Arguments are as for `step`.
        """
        point = self._tracker.expected(float(time), _turning(camera_rate))
        return None if point is None else np.array(point)

    @property
    def alternative(self) -> Estimate | None:
        """Estimate with the next best attitude that frames agreed on; None if there is none."""
        told = self._tracker.alternative()
        return None if told is None else _estimate(told)

    def state(self, model: bytes = b"") -> bytes:
        """Return the tracker as bytes, exact, for `from_state`.

        ``model`` identifies the network, as by the bytes of its file; its digest is kept.
        ``ffpose-onboard`` writes the same into its state files, unless it has ``--camera`` or
        ``--resize``.
        """
        return self._tracker.state(hashlib.sha256(model).digest())

    @classmethod
    def from_state(
        cls, state: bytes, model: bytes = b"", *, symmetry: SymmetryGroup = IDENTITY
    ) -> Tracker:
        """Return the tracker of `state`, which goes on as if it had never stopped.

        The state does not hold the ``symmetry``, which is that of the model.

        Raises:
            ValueError: The bytes are no state, damaged, or of another model.
        """
        tracker, tag = cls.__new__(cls), hashlib.sha256(model).digest()
        tracker._symmetry = symmetry
        tracker._tracker = _rust.Tracker.from_state(state, tag, list(symmetry.axes))
        return tracker

    def __reduce__(self) -> tuple[Callable[[bytes], Tracker], tuple[bytes]]:
        """Copies and pickles are trackers of their own: a copy can look ahead."""
        return partial(type(self).from_state, symmetry=self._symmetry), (self.state(),)


def _turning(camera_rate: ArrayLike) -> list[float]:
    """Return the numbers of an angular velocity in rad/s."""
    turning = np.radians(np.asarray(camera_rate, np.float64))
    if turning.shape != (3,):
        raise ValueError(f"camera_rate: expected shape (3,), got {turning.shape}")
    return [float(each) for each in turning]


def _modes(pose: Pose) -> list[tuple[Any, ...]]:
    """Return position, orientation, covariances and probability of each orientation."""
    if not isinstance(pose, Pose):
        raise TypeError(f"pose: expected a Pose, got {type(pose).__name__}")
    said = pose.uncertainty
    if said is None:
        raise ValueError("pose: expected one with uncertainty, got one without")
    covariances = said.translation_covariance.tolist(), said.rotation_covariance.tolist()
    first, second = (float(share) for share in said.probabilities)
    modes = [(pose.t.tolist(), pose.q.tolist(), *covariances, first)]
    if said.alternative is not None:
        modes.append((pose.t.tolist(), said.alternative.tolist(), *covariances, second))
    return modes


def _estimate(told: dict[str, Any]) -> Estimate:
    return Estimate(
        np.array(told["position"]),
        np.array(told["orientation"]),
        np.array(told["velocity"]),
        np.degrees(told["rate"]),
        np.array(told["covariance"]),
    )
