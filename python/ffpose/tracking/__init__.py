"""A spacecraft's motion from the poses of its images: `docs/tracking.md` explains it."""

from ffpose.tracking.tracker import Estimate, Settings, Step, Tracker

__all__ = ["Estimate", "Settings", "Step", "Tracker"]
