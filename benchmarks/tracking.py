"""``python -m benchmarks tracking WEIGHTS --out DIR``: tracks against frames posed alone.

Renders sequences of approaches, tumbles and flybys, a tenth of their frames lost, and follows each
by looks where the object is expected, or with ``--whole`` by whole frames. Sequences, poses of
whole frames and results are kept in the folder, so that the command goes on where it was stopped.
"""

from __future__ import annotations

import argparse
import json
import pickle
import sys
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np

from ffpose._internal.files import atomic_write, sha256
from ffpose._internal.seeds import CHOICES
from ffpose._internal.zoo import resolve
from ffpose.geometry import Camera, FloatArray, Pose
from ffpose.inference.load import load
from ffpose.inference.prediction import Failure, predict
from ffpose.render import find_scene
from ffpose.render.dataset.sequence_writer import write_sequence
from ffpose.render.motion import KINDS, inertia
from ffpose.render.scene import Scene
from ffpose.render.sequence import Sequence as Frames
from ffpose.tracking import Settings, Tracker
from ffpose.tracking.errors import NEES_BOUNDS, SETTLED_S, TrackErrors, track_errors
from ffpose.tracking.follow import Followed, follow
from ffpose.tracking.frames import Frame, read_frames

DROP = 0.1
KNOWN = 0.003
"""`Settings.asymmetry` of an inertia that is known."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command line."""
    parser.add_argument("weights", help="as for ffpose.load")
    parser.add_argument("--out", type=Path, required=True, help="folder to write or to continue")
    parser.add_argument("--scene", default="soyuz_hard", help="set within whose ranges they stay")
    parser.add_argument(
        "--attitude-range", nargs=3, type=float, help="ROLL PITCH YAW, degrees (default: scene's)"
    )
    parser.add_argument("--sequences", type=int, default=20)
    parser.add_argument("--first", type=int, default=0, help="number of the first sequence")
    parser.add_argument("--seconds", type=float, default=120.0)
    parser.add_argument("--rate", type=float, default=2.0, help="frames a second")
    parser.add_argument("--size", default="512x384", help="WIDTHxHEIGHT of the frames")
    parser.add_argument("--settings", default="{}", help="of the tracker, as JSON")
    parser.add_argument(
        "--inertia", action="store_true", help="tell the tracker the spacecraft's, exactly"
    )
    parser.add_argument("--whole", action="store_true", help="track by the poses of whole frames")


def run(options: argparse.Namespace) -> None:
    """Measure, and print the results as JSON."""
    scene = find_scene(options.scene)
    if options.attitude_range:
        scene = replace(scene, attitude_range_deg=tuple(options.attitude_range))
    width, height = map(int, options.size.split("x"))
    told = json.loads(options.settings)
    if options.inertia:
        told = {"inertia": moments(scene), "asymmetry": KNOWN} | told
    estimator = load(options.weights, threads=1, track=True, warm_up=0)
    settings = Settings.of(estimator.metadata, told)
    symmetry = estimator.metadata.symmetry
    measured = []
    for number in range(options.first, options.first + options.sequences):
        kind = KINDS[number % len(KINDS)]
        folder = options.out / f"{number:02d}-{kind}"
        if not (folder / "frames.csv").exists():
            frames = Frames.of_kind(
                kind,
                scene,
                options.seconds,
                options.rate,
                CHOICES.start + 32_000 + number,
                (width, height),
            )
            write_sequence(frames, folder, drop=DROP)
        sequence = read_frames(folder)
        poses = predicted(options.weights, folder, sequence)
        if options.whole:
            followed = of_poses(sequence, poses, Tracker(settings, symmetry=symmetry))
        else:
            camera = Camera.read(folder / "camera.json")
            estimator = load(options.weights, camera=camera, threads=1, track=True, warm_up=0)
            looked = follow(estimator, sequence, Tracker(settings, symmetry=symmetry))
            followed = [one._replace(alone=pose) for one, pose in zip(looked, poses, strict=True)]
        measured.append(track_errors(followed, symmetry))
        summary = {"sequence": folder.name, **measured[-1].summary()}
        print(json.dumps(summary), file=sys.stderr, flush=True)
    document = {"settings": asdict(settings), **together(measured)}
    with atomic_write(options.out / "tracking.json") as path:
        path.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")
    print(json.dumps(document, indent=1))


def predicted(weights: str, folder: Path, sequence: list[Frame]) -> list[Pose | None]:
    """Return the pose of each whole frame, from the folder where those of the file were kept."""
    kept = folder / f"predicted-{sha256(resolve(weights))[:12]}.pickle"
    if not kept.exists():
        estimator = load(weights, camera=Camera.read(folder / "camera.json"), warm_up=0)
        answers = predict(estimator, [frame.image for frame in sequence])
        poses = [None if isinstance(answer, Failure) else answer.pose for answer in answers]
        with atomic_write(kept) as path:
            path.write_bytes(pickle.dumps(poses))
    return list(pickle.loads(kept.read_bytes()))


def of_poses(sequence: list[Frame], poses: list[Pose | None], tracker: Tracker) -> list[Followed]:
    """Track through the poses of whole frames."""
    followed = []
    for one, pose in zip(sequence, poses, strict=True):
        step = tracker.step(one.time, pose)
        followed.append(Followed(one, pose, step, step.outcome))
    return followed


def moments(scene: Scene) -> tuple[float, ...]:
    """Return the inertia by which tumbles of a scene turn, as `Settings` takes it."""
    matrix = inertia(scene.build())
    return (*np.diag(matrix).tolist(), *matrix[[0, 0, 1], [1, 2, 2]].tolist())


def together(measured: list[TrackErrors]) -> dict[str, object]:
    """Return the rows of the table over all sequences; ratios are to the frames alone."""
    tracked = np.concatenate([each.tracked for each in measured])
    alone = np.concatenate([each.alone for each in measured])
    nees = np.concatenate([each.nees for each in measured])
    turned = np.concatenate([each.turned for each in measured])
    since = np.concatenate([each.since for each in measured])
    errors = np.concatenate([each.errors for each in measured])
    there = np.isfinite(nees)
    both = there & np.isfinite(alone[:, 0])
    settled = there & (since >= SETTLED_S)
    inside = (nees[there] >= NEES_BOUNDS[0]) & (nees[there] <= NEES_BOUNDS[1])
    return {
        "frames": len(nees),
        "tracked": int(there.sum()),
        "attitude_ratio_by_degrees_turned": {
            name: _ratio(tracked[:, 1], alone[:, 1], both & (turned >= low) & (turned < high))
            for name, low, high in (
                ("below 10", 0, 10),
                ("10 to 60", 10, 60),
                ("60 to 240", 60, 240),
                ("from 240", 240, np.inf),
            )
        },
        "attitude_median_deg": [_at(tracked[both, 1], 0.5), _at(alone[both, 1], 0.5)],
        "attitude_99_deg": [_at(tracked[both, 1], 0.99), _at(alone[both, 1], 0.99)],
        "attitude_largest_deg": [_at(tracked[there, 1], 1.0), _at(alone[both, 1], 1.0)],
        "position_ratio_median": _ratio(tracked[:, 0], alone[:, 0], both),
        "position_ratio_99": _at(tracked[both, 0], 0.99) / _at(alone[both, 0], 0.99),
        "velocity_median_m_s": _at(np.linalg.norm(errors[settled, 3:6], axis=1), 0.5),
        "rate_median_deg_s": _at(np.linalg.norm(errors[settled, 9:], axis=1), 0.5),
        "nees_inside": float(inside.mean()),
    }


def _at(values: FloatArray, share: float) -> float:
    return float(np.quantile(values, share)) if len(values) else float("nan")


def _ratio(tracked: FloatArray, alone: FloatArray, rows: FloatArray) -> float:
    return _at(tracked[rows], 0.5) / _at(alone[rows], 0.5)
