"""``ffpose track``: from images and times to a trajectory, a report and an overlay."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

from ffpose._internal.files import write_csv
from ffpose.errors import DataError, explain
from ffpose.geometry import POSE_COLUMNS, Pose
from ffpose.inference.estimator import PoseEstimator
from ffpose.inference.prediction import Failure, axis_length, predict
from ffpose.tracking.frames import Frame
from ffpose.tracking.report import write_overlay, write_report
from ffpose.tracking.tracker import Settings, Step, Tracker

TRAJECTORY, REPORT, OVERLAY = "trajectory.csv", "report.html", "overlay.webp"
AXES = "xyz"
COLUMNS = (
    "time",
    *POSE_COLUMNS,
    *(f"{kind}{axis}" for kind in "vw" for axis in AXES),
    *(f"sd_{kind}{axis}" for kind in "tvrw" for axis in AXES),
    "accepted",
    "reason",
)
"""Columns of ``trajectory.csv``: meters, m/s along the camera's axes, deg/s along the object's, and
standard deviations of the errors, ``sd_rx`` to ``sd_rz`` in degrees about the object's axes."""


class Followed(NamedTuple):
    """A frame of a sequence with its pose, the track after it and the step's outcome.

    ``alone`` is the pose of the image alone, or of a look where the object was expected; None where
    it has none, and ``reason`` says why.
    """

    frame: Frame
    alone: Pose | None
    step: Step
    reason: str


def follow(
    estimator: PoseEstimator, frames: Iterable[Frame], tracker: Tracker
) -> Iterator[Followed]:
    """Pose each frame and track the object through them, frame by frame, in the order of times.

    An image that cannot be used is coasted over, and so is a pose whose covariances the tracker
    refuses, as rounding can leave them without an inverse. If the network's single look was opened,
    it looks where the object is expected, and searches a whole frame where that is not known
    (`Tracker.expected`). The tracker goes on from where it is.

    Raises:
        ValueError: The network has no uncertainty or locates the camera, the tracker is not of its
            symmetry, or a time is not later than the tracker's.
    """
    if estimator.metadata.locates == "camera":
        raise ValueError("weights: expected some that locate an object, got ones of a camera")
    told, own = estimator.metadata.symmetry, tracker.symmetry
    if not (told.has(own.rotations) and own.has(told.rotations)):
        raise ValueError(f"tracker: expected one of symmetry {told}, got {own}")
    return _steps(estimator, frames, tracker)


def _steps(
    estimator: PoseEstimator, frames: Iterable[Frame], tracker: Tracker
) -> Iterator[Followed]:
    for frame in frames:
        point = None if estimator.near is None else tracker.expected(frame.time)
        (answer,) = predict(estimator, [frame.image], point=point)
        alone = None if isinstance(answer, Failure) else answer.pose
        try:
            step = tracker.step(frame.time, alone)
            reason = explain(answer.error) if isinstance(answer, Failure) else step.outcome
        except ValueError as error:
            if alone is None or alone.uncertainty is None:
                raise
            step = tracker.step(frame.time, None)  # where the time is wrong it is refused again
            alone, reason = None, str(error)
        yield Followed(frame, alone, step, reason)


def write_trajectory(followed: Sequence[Followed], path: Path) -> None:
    """Write ``trajectory.csv``: a row of `COLUMNS` for each frame; no numbers without a track."""
    write_csv(path, [COLUMNS, *map(_row, followed)])


def _row(followed: Followed) -> list[object]:
    one = followed.step.estimate
    numbers: list[float] | list[str] = [""] * (len(COLUMNS) - 3)
    if one is not None:
        vectors = (one.t, one.q, one.v, one.w, one.standard_deviations)
        numbers = [float(number) for vector in vectors for number in vector]
    return [followed.frame.time, *numbers, int(followed.step.accepted), followed.reason]


def run(
    estimator: PoseEstimator,
    frames: list[Frame],
    out: Path,
    *,
    settings: Settings | None = None,
    title: str = "Track",
) -> list[Followed]:
    """Track the object through frames, and write `TRAJECTORY`, `REPORT` and `OVERLAY` to a folder.

    Whatever exception ends the run, the frames until then are in the trajectory; without a frame no
    file is written. Ctrl-C is one, and in a command SIGTERM is (`ffpose.cli.main`). Settings are
    those of the network (`Settings.of`) unless given.

    Raises:
        ValueError: The network has no uncertainty or locates the camera.
        DataError: There was no track in any frame, or images cannot be used; the files are written.
    """
    settings = settings or Settings.of(estimator.metadata)
    steps = follow(estimator, frames, Tracker(settings, symmetry=estimator.metadata.symmetry))
    out.mkdir(parents=True, exist_ok=True)
    followed: list[Followed] = []
    try:
        followed.extend(steps)  # those before an exception stay
    finally:
        if followed:
            write_trajectory(followed, out / TRAJECTORY)
    write_report(followed, out / REPORT, title, estimator.metadata.symmetry)
    if estimator.camera is not None:
        axis_m = axis_length(estimator.metadata.config)
        write_overlay(followed, estimator.camera, out / OVERLAY, estimator.white, axis_m)
    lost = [each for each in followed if each.alone is None]
    if lost:
        first = f"the first: {lost[0].reason}"
        raise DataError(f"{len(lost)} of {len(followed)} images have no pose; {first}")
    if all(each.step.estimate is None for each in followed):
        flagged = sum(bool(each.alone and each.alone.flagged) for each in followed)
        poses = len(followed) - flagged
        gaps = (b.frame.time - a.frame.time for a, b in pairwise(followed))
        if not poses:
            rest = "none has a pose"
        elif poses < settings.agreeing:
            rest = f"a track needs {settings.agreeing} poses that agree, got {poses}"
        elif min(gaps, default=0.0) > settings.coasting:
            rest = (
                f"all are more than {settings.coasting:g} s apart, after which a track is lost:"
                " settings want a larger coasting"
            )
        else:
            rest = "the others' poses do not agree"
        raise DataError(f"no track: of {len(followed)} frames {flagged} are flagged, and {rest}")
    return followed
