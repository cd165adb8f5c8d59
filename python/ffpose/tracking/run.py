"""``ffpose track``: from images and times to a trajectory, a report and an overlay."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from ffpose.errors import DataError
from ffpose.inference.estimator import PoseEstimator
from ffpose.tracking.follow import Followed, follow, write_trajectory
from ffpose.tracking.frames import Frame
from ffpose.tracking.report import write_overlay, write_report
from ffpose.tracking.tracker import Settings, Tracker

TRAJECTORY, REPORT, OVERLAY = "trajectory.csv", "report.html", "overlay.webp"


def run(
    estimator: PoseEstimator,
    frames: list[Frame],
    out: Path,
    *,
    settings: Settings | None = None,
    title: str = "Track",
    said: Callable[[Followed], None] = lambda followed: None,
) -> list[Followed]:
    """Track the object through frames, and write `TRAJECTORY`, `REPORT` and `OVERLAY`.

    Whatever ends the run, Ctrl-C included, the frames until then are in the trajectory.

    Args:
        estimator: A network with uncertainty.
        frames: The frames, in the order of their times.
        out: Folder to write to; created if it does not exist.
        settings: Of the tracker; None for those of the network (`Settings.of`).
        title: Heading of the report.
        said: Called with each frame as it is done.

    Raises:
        ValueError: The network has no uncertainty or locates the camera.
        DataError: There was no track in any frame, or images cannot be used; the files are written.
    """
    out.mkdir(parents=True, exist_ok=True)
    followed: list[Followed] = []
    try:
        settings = settings or Settings.of(estimator.metadata)
        for each in follow(estimator, frames, Tracker(settings)):
            followed.append(each)
            said(each)
    finally:
        write_trajectory(followed, out / TRAJECTORY)
    write_report(followed, out / REPORT, title)
    if estimator.camera is not None:
        write_overlay(followed, estimator.camera, out / OVERLAY)
    lost = [each for each in followed if each.alone is None]
    if lost:
        first = f"the first: {lost[0].reason}"
        raise DataError(f"{len(lost)} of {len(followed)} images have no pose; {first}")
    if all(each.step.estimate is None for each in followed):
        flagged = sum(bool(each.alone and each.alone.flagged) for each in followed)
        poses = len(followed) - flagged
        rest = "the others' poses do not agree" if poses else "none has a pose"
        if 0 < poses < settings.agreeing:
            rest = f"a track needs {settings.agreeing} poses that agree, got {poses}"
        raise DataError(f"no track: of {len(followed)} frames {flagged} are flagged, and {rest}")
    return followed
