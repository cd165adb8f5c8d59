"""A track through the images of a sequence."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

from ffpose._internal.files import atomic_write
from ffpose.errors import explain
from ffpose.geometry import Pose
from ffpose.inference.estimator import PoseEstimator
from ffpose.inference.prediction import Failure, predict
from ffpose.tracking.frames import Frame
from ffpose.tracking.tracker import Step, Tracker

AXES = "xyz"
COLUMNS = (
    "time",
    *(f"t{axis}" for axis in AXES),
    *(f"q{axis}" for axis in ("w", *AXES)),
    *(f"{kind}{axis}" for kind in "vw" for axis in AXES),
    *(f"sd_{kind}{axis}" for kind in "tvrw" for axis in AXES),
    "accepted",
    "reason",
)
"""Columns of ``trajectory.csv``: meters, m/s along the camera's axes, deg/s along the object's, and
standard deviations of the errors, ``sd_rx`` to ``sd_rz`` in degrees about the object's axes."""


class Followed(NamedTuple):
    """A frame of a sequence with its pose and the track after it.

    Attributes:
        frame: Image and time.
        alone: The pose of the image alone, or of a look where the object was expected; None where
            it has none.
        step: What the tracker made of it.
        reason: The step's outcome, or why the image has no pose.
    """

    frame: Frame
    alone: Pose | None
    step: Step
    reason: str


def follow(
    estimator: PoseEstimator, frames: Iterable[Frame], tracker: Tracker
) -> Iterator[Followed]:
    """Pose each frame and track the object through them, frame by frame.

    An image that cannot be used is coasted over.

    Args:
        estimator: A network with uncertainty. If its single look was opened, it looks where the
            object is expected, and searches a whole frame where that is not known
            (`Tracker.expected`).
        frames: The frames, in the order of their times.
        tracker: The tracker; it goes on from where it is.

    Raises:
        ValueError: The network has no uncertainty or locates the camera, or a time is not later
            than the tracker's.
    """
    if estimator.metadata.locates == "camera":
        raise ValueError("weights: expected some that locate an object, got ones of a camera")
    for frame in frames:
        point = None if estimator.near is None else tracker.expected(frame.time)
        (answer,) = predict(estimator, [frame.image], point=point)
        alone = None if isinstance(answer, Failure) else answer.pose
        step = tracker.step(frame.time, alone)
        reason = explain(answer.error) if isinstance(answer, Failure) else step.outcome
        yield Followed(frame, alone, step, reason)


def write_trajectory(followed: Sequence[Followed], path: Path) -> None:
    """Write ``trajectory.csv``: a row of `COLUMNS` for each frame; no numbers without a track."""
    with (
        atomic_write(path) as temporary,
        temporary.open("w", newline="", encoding="utf-8") as file,
    ):
        table = csv.writer(file, lineterminator="\n")
        table.writerow(COLUMNS)
        for each in followed:
            one = each.step.estimate
            numbers: list[float] | list[str] = [""] * (len(COLUMNS) - 3)
            if one is not None:
                vectors = (one.t, one.q, one.v, one.w, one.standard_deviations)
                numbers = [float(number) for vector in vectors for number in vector]
            table.writerow([each.frame.time, *numbers, int(each.step.accepted), each.reason])
