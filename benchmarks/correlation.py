"""``python -m benchmarks correlation WEIGHTS DIR``: angles over which a network's errors correlate.

Reads the sequences and poses that ``python -m benchmarks tracking WEIGHTS --out DIR`` keeps, and
fits ``share exp(-angle / correlation angle)`` to the correlation of the errors, in the network's
own standard deviations, of frames whose true attitudes are an angle apart; what is new in each
frame is left to the share. With ``--out FILE`` the
weights are written with what was found in their header, where trackers find it.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from safetensors.torch import load_file

from benchmarks.tracking import predicted
from ffpose._internal.zoo import resolve
from ffpose.geometry import FloatArray, Pose
from ffpose.geometry.rotations import conjugate, multiply, rotation_vector
from ffpose.geometry.symmetry import IDENTITY, SymmetryGroup
from ffpose.models import read_metadata
from ffpose.models.weights import write_weights
from ffpose.tracking.frames import read_frames

BINS_DEG = np.array([0, 1, 2, 4, 6, 9, 12, 16, 20, 25, 30, 40, 50, 60.0])
FLIP_DEG = 25.0
"""Errors above are flips, which trackers refuse, and are left out."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command line."""
    parser.add_argument("weights", help="weights file, or a name")
    parser.add_argument("folder", type=Path, help="folder of sequences")
    parser.add_argument("--out", type=Path, help="weights file to write")


def run(options: argparse.Namespace) -> None:
    """Measure, print the angles as JSON, and write them where a file is named."""
    sequences = []
    for folder in sorted(path.parent for path in options.folder.glob("*/frames.csv")):
        frames = read_frames(folder)
        poses = predicted(options.weights, folder, frames)
        pairs = [(one.pose, pose) for one, pose in zip(frames, poses, strict=True)]
        sequences.append([(truth, pose) for truth, pose in pairs if truth and pose])
    path = resolve(options.weights)
    found = correlation_angles(sequences, read_metadata(path).symmetry)
    print(json.dumps(found, indent=1))
    if options.out is not None:
        write_weights(options.out, load_file(path), replace(read_metadata(path), tracking=found))


def correlation_angles(
    sequences: Sequence[Sequence[tuple[Pose, Pose]]], symmetry: SymmetryGroup = IDENTITY
) -> dict[str, float]:
    """Return ``position_angle`` and ``attitude_angle``, degrees, of pairs of true and found poses.

    Errors are to the nearest attitude of the same look by ``symmetry``.

    Raises:
        ValueError: No two frames of a sequence are 1 to 60 degrees apart.
    """
    turned, multiplied = [np.empty(0)], [np.empty((0, 4))]
    for pairs in sequences:
        found = [(truth.q, _error(truth, pose, symmetry)) for truth, pose in pairs]
        kept = [(q, error) for q, error in found if error is not None]
        q = np.array([q for q, _ in kept]).reshape(-1, 4)
        errors = np.array([error for _, error in kept]).reshape(-1, 2, 3)
        one, other = np.triu_indices(len(kept), 1)
        cosines = np.abs((q[one] * q[other]).sum(1))
        turned.append(np.degrees(2 * np.arccos(np.minimum(cosines, 1))))
        sizes = (errors**2).sum(2)
        pairwise = (errors[one] * errors[other]).sum(2)
        multiplied.append(np.concatenate([pairwise, (sizes[one] + sizes[other]) / 2], axis=1))
    angles, table = np.concatenate(turned), np.concatenate(multiplied)
    bins = np.digitize(angles, BINS_DEG) - 1
    places = [place for place in range(1, len(BINS_DEG) - 1) if (bins == place).any()]
    if not places:
        raise ValueError("sequences: expected frames that turn by 1 to 60 degrees, got none")
    middle = np.array([angles[bins == place].mean() for place in places])
    count = np.array([(bins == place).sum() for place in places])
    sums = np.array([table[bins == place].sum(0) for place in places])
    return {
        name: _fitted(middle, sums[:, column] / sums[:, 2 + column], count)
        for column, name in enumerate(("position_angle", "attitude_angle"))
    }


def _error(truth: Pose, pose: Pose, symmetry: SymmetryGroup) -> FloatArray | None:
    """Return errors of position and attitude ``(2, 3)`` in standard deviations; None of a flip.

    Those of the position are along the camera's axes, those of the attitude along the object's.
    """
    said = pose.uncertainty
    nearest = symmetry.nearest(pose.q[None], truth.q[None])[0]
    turn = rotation_vector(multiply(conjugate(nearest), pose.q))
    if said is None or pose.flagged or np.linalg.norm(turn) > np.radians(FLIP_DEG):
        return None
    deviations = [
        np.sqrt(np.trace(part) / 3)
        for part in (said.translation_covariance, said.rotation_covariance)
    ]
    return np.stack([(pose.t - truth.t) / deviations[0], turn / deviations[1]])


def _fitted(angles: FloatArray, correlation: FloatArray, count: FloatArray) -> float:
    """Return the angle whose exponential is nearest to correlations, weighted by their counts."""
    candidates = np.geomspace(1, 200, 400)
    falling = np.exp(-angles / candidates[:, None])
    shares = (falling * correlation) @ count / (falling**2 @ count)
    misses = (shares[:, None] * falling - correlation) ** 2 @ count
    return float(candidates[misses.argmin()])
