"""What is rendered and trained in a budget of minutes, chosen from the mesh and measured speed.

Two trainings share the budget: a sixth of it goes to a first one, so that there is an answer early,
and the rest to a second, on more views, that starts from the first one's weights. Each has as many
views as are rendered in three tenths of its share; those of the second begin with the first one's.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import torch

from ffpose._internal.seeds import TRAINING, matching
from ffpose.geometry import Camera
from ffpose.models.base import find_device
from ffpose.training import DataConfig, TrainConfig
from ffpose.training.config import MUON, ObjectLossConfig, PatchAugmentation

DEFAULT_CAMERA = Camera(512, 384, 256.0, 256.0, 256.0, 192.0)
"""A pinhole camera of 90 degrees."""

NETWORK: Final = "polar"

DEFAULT_INIT = "generic"
"""Shipped weights that a training starts from. They have learned from 64 spacecraft at once, by
``python -m studies.generic``: what holds for so many holds for another, and saves a part of the
budget."""

NEAR_DIAMETERS, FAR_DIAMETERS = 1.5, 8.0
"""Default distances, in diameters of the spacecraft's bounding sphere."""

ROOM_IN_VIEW = 1.2
"""Least default distance relative to that at which the bounding sphere fills a narrow camera's
view."""

VIEW_MARGIN = 1.1
"""Radius of the virtual camera's view relative to that sphere's."""

BEYOND = (0.7, 1.4)
"""Training sees distances beyond the nearest and farthest by these factors."""

FIRST_SHARE, RENDER_SHARE = 1 / 6, 0.3
"""Shares of the budget: of the first training; of rendering in each, were nothing rendered
before."""

HELD_BACK_VIEWS, HELD_BACK_S, MOST_HELD_BACK = 9000, 120.0, 0.12
"""What is held back of the budget for images that validate, calibrate and test, and for the report
and the graph: the time of so many views and so many seconds, and at most such a share of it."""

LEAST_VIEWS, MOST_VIEWS = 200, 48_000

ROOM_SHARE = 0.5
"""Share of the disk's free space that the views may take."""

LEAST_HELD_OUT, MOST_HELD_OUT = 8, 200
"""Validation images, and images of each kind that calibrate: a fortieth of the views, within."""

HELD_OUT_VIEWS, VALIDATED, STARTED_S = 14, 0.5, 30.0
"""Views in whose time an image held out of each kind is rendered, that of another spacecraft among
them; the speed of validation relative to training's; and seconds to start the processes of a
training and to calibrate it."""

LEAST_EPOCHS, MOST_EPOCHS = 4, 150

BATCH, LEAST_BATCH = 32, 8
"""Samples of a step, over all processes; and of each of them, by which batch norm normalizes."""

LEAST_PIXELS = 5
"""Pixels of the first look that the bounding sphere covers at the farthest, or more."""

FIRST_STRIDES = (8, 4, 2)
"""Factors by which the first look's frame is smaller than the network's input."""

KINDS = {
    "count": 0.44,
    "cut": 0.1,
    "randomized": 0.2,
    "dusk": 0.08,
    "empty": 0.06,
    "decoys": 0.12,
}
"""Shares of the views: plain, cut by the border, randomized, in the light of a low sun, without the
spacecraft, of other spacecraft."""

SHOWN_SHARE = 1 - KINDS["empty"] - KINDS["decoys"]
"""Share of the views that make an epoch: some of them are replaced by those without the
spacecraft."""


@dataclass(frozen=True)
class Speed:
    """What this machine does with all processes together, and what a view takes.

    Attributes:
        views: Rendered views per second.
        samples: Training samples per second.
        view_bytes: Bytes of a stored view.
    """

    views: float
    samples: float
    view_bytes: int = 0


@dataclass(frozen=True)
class TrainingPlan:
    """One of the two trainings.

    Attributes:
        name: Name of its folder.
        views: Number of rendered views.
        epochs: Number of passes over them.
        rendered: Those of the views that the training before has rendered.
    """

    name: str
    views: int
    epochs: int
    rendered: int = 0

    @property
    def held_out(self) -> int:
        """Number of validation images, and of images of each kind that calibrate."""
        return min(MOST_HELD_OUT, max(LEAST_HELD_OUT, self.views // 40))

    def seconds(self, speed: Speed) -> float:
        """Return what rendering and training take."""
        rendering = (self.views - self.rendered) / speed.views
        return rendering + self.epochs * SHOWN_SHARE * self.views / speed.samples

    def seconds_besides(self, speed: Speed) -> float:
        """Return what it takes besides, of the time held back: start, validation, calibration."""
        validation = self.epochs * self.held_out / (VALIDATED * speed.samples)
        return STARTED_S + HELD_OUT_VIEWS * self.held_out / speed.views + validation


def plan_trainings(
    minutes: float, speed: Speed, room: float = math.inf
) -> tuple[TrainingPlan, TrainingPlan]:
    """Return the two trainings that fit into a budget of wall time.

    The views of both take at most `ROOM_SHARE` of ``room``, the disk's free bytes.

    Examples:
        >>> first, second = plan_trainings(60, Speed(views=30, samples=400))
        >>> first
        TrainingPlan(name='first', views=3857, epochs=37, rendered=0)
        >>> second
        TrainingPlan(name='second', views=25035, epochs=40, rendered=3857)
    """
    seconds = _training_seconds(minutes, speed)
    whole = FIRST_SHARE * seconds
    most = MOST_VIEWS
    if speed.view_bytes:
        most = min(most, int(ROOM_SHARE * room / 2 / speed.view_bytes))
    besides = _plan("first", whole, speed, 0, most).seconds_besides(speed)
    whole -= min(besides, whole / 2)  # so that its answer is there after its share of the budget
    first = _plan("first", whole, speed, 0, most)
    return first, _plan("second", seconds - whole, speed, first.views, most)


def _training_seconds(minutes: float, speed: Speed) -> float:
    """Return the part of a budget that both trainings have."""
    held_back = HELD_BACK_VIEWS / speed.views + HELD_BACK_S
    return 60 * minutes - min(held_back, MOST_HELD_BACK * 60 * minutes)


def _plan(name: str, seconds: float, speed: Speed, rendered: int, most: int) -> TrainingPlan:
    least = max(LEAST_VIEWS, rendered)
    planned = max(min(RENDER_SHARE * seconds * speed.views, most), least)
    trained = seconds - (planned - rendered) / speed.views
    passes = trained * speed.samples / (SHOWN_SHARE * planned)
    epochs = min(max(int(passes), LEAST_EPOCHS), MOST_EPOCHS)
    # A part of an epoch that is left is spent on more views.
    each = 1 / speed.views + epochs * SHOWN_SHARE / speed.samples
    views = (seconds + rendered / speed.views) / each
    return TrainingPlan(name, int(max(min(views, most), least)), epochs, rendered)


def replanned(
    second: TrainingPlan, first: TrainingPlan, minutes: float, speed: Speed, spent: float
) -> TrainingPlan:
    """Return a smaller second training, where the first took longer than planned.

    ``spent`` is how many seconds it took, all in all, and the rest is taken to go as slowly;
    ``minutes`` and ``speed`` are what was planned with.

    Examples:
        >>> speed = Speed(views=30, samples=400)
        >>> first, second = plan_trainings(40, speed)
        >>> second
        TrainingPlan(name='second', views=16686, epochs=40, rendered=2471)
        >>> spent = first.seconds(speed) + first.seconds_besides(speed)
        >>> replanned(second, first, 40, speed, spent) == second
        True
        >>> replanned(second, first, 40, speed, 2 * spent)
        TrainingPlan(name='second', views=5865, epochs=44, rendered=2471)
    """
    slower = max(1.0, spent / (first.seconds(speed) + first.seconds_besides(speed)))
    slowed = replace(speed, views=speed.views / slower, samples=speed.samples / slower)
    held_back = 60 * minutes - _training_seconds(minutes, speed)
    left = 60 * minutes - slower * (held_back + first.seconds(speed))
    smaller = _plan(second.name, left, slowed, first.views, second.views)
    return smaller if smaller.seconds(speed) < second.seconds(speed) else second


def default_distances(reach_m: float, camera: Camera) -> tuple[float, float]:
    """Return the default least and greatest distance, meters.

    They are `NEAR_DIAMETERS` and `FAR_DIAMETERS`; for a camera whose view the spacecraft does not
    fit into at the least, both are as many times as far as it needs. ``reach_m`` is the radius of
    the bounding sphere, or what stands for it.

    Examples:
        >>> default_distances(1.0, DEFAULT_CAMERA)
        (3.0, 16.0)
        >>> near, far = default_distances(1.0, Camera(512, 512, 2000.0, 2000.0, 256.0, 256.0))
        >>> round(near, 1), round(far, 1)
        (9.5, 50.4)
    """
    across = min(camera.cx, camera.width - camera.cx) / camera.fx
    slope = min(across, min(camera.cy, camera.height - camera.cy) / camera.fy)
    near, far = 2 * reach_m * NEAR_DIAMETERS, 2 * reach_m * FAR_DIAMETERS
    fits = ROOM_IN_VIEW * reach_m * math.hypot(1, slope) / slope if slope > 0 else near
    farther = max(1.0, fits / near)
    return near * farther, far * farther


def whole_seconds(plans: tuple[TrainingPlan, TrainingPlan], speed: Speed) -> float:
    """Return what a whole run takes, with all that is held back for."""
    held_back = HELD_BACK_VIEWS / speed.views + HELD_BACK_S
    return sum(plan.seconds(speed) for plan in plans) + held_back


def image_size(camera: Camera) -> tuple[int, int]:
    """Return height and width of the network's input: 512 wide, of the camera's shape."""
    return 64 * max(1, round(8 * camera.height / camera.width)), 512


def first_stride(radius_m: float, farthest_m: float, camera: Camera) -> int:
    """Return the factor by which the first look's frame is smaller than the network's input.

    ``radius_m`` is the greatest distance of the spacecraft's surface from its origin.

    Examples:
        >>> [first_stride(1, farthest, DEFAULT_CAMERA) for farthest in (12, 24, 100)]
        [8, 4, 2]
    """
    _, width = image_size(camera)
    pixels = 2 * radius_m / farthest_m * camera.fx * width / camera.width
    fits = [stride for stride in FIRST_STRIDES if pixels >= stride * LEAST_PIXELS]
    return max(fits, default=min(FIRST_STRIDES))


def training_processes(device: str, processes: int) -> int:
    """Return how many of ``processes`` train together: one for each GPU, on a CPU all.

    At most so many that each has `LEAST_BATCH` samples of a step; the others prepare batches.
    """
    most = min(processes, BATCH // LEAST_BATCH)
    if find_device(device).type != "cuda":
        return most
    return 1 if ":" in device else min(most, torch.cuda.device_count())  # as cuda:1


def training(
    out: Path,
    scene: Path,
    radius_m: float,
    distance_m: tuple[float, float],
    camera: Camera,
    plan: TrainingPlan,
    *,
    attitude_range_deg: tuple[float, float, float],
    seed: int,
    processes: int,
    device: str,
    init: Path | None,
    symmetry: Path | None = None,
    world: int | None = None,
) -> TrainConfig:
    """Return the configuration of one of the two trainings of a run, whose folder is ``out``.

    ``scene`` is the file of the set (`ffpose.render.scene_file`), ``radius_m`` the greatest
    distance of the spacecraft's surface from its origin, ``distance_m`` the least and greatest from
    the camera. Of the ``processes``, which render and prepare batches, ``world`` train together;
    None for `training_processes`. The rest is as of `ffpose.training.TrainConfig`.
    """
    counts: dict[str, Any] = {name: max(1, round(KINDS[name] * plan.views)) for name in KINDS}
    world = world or training_processes(device, processes)
    return TrainConfig(
        data=DataConfig(
            "scenes",
            out / "views",
            scene=str(scene),
            distance=BEYOND,
            validation=plan.held_out,
            calibration=plan.held_out,
            workers=processes,
            seed=matching(TRAINING, seed),
            attitude_range_deg=attitude_range_deg,
            **counts,
        ),
        out=out / plan.name,
        model=NETWORK,
        model_fields={
            "image_size": image_size(camera),
            "first_stride": first_stride(radius_m, BEYOND[1] * distance_m[1], camera),
            "object_radius_m": VIEW_MARGIN * radius_m,
            "distance_m": distance_m,
        },
        backbone_weights="none",
        epochs=plan.epochs,
        batch_size=max(LEAST_BATCH, BATCH // world),
        processes=world,
        init=init,
        ema=0.998,
        autocast="bfloat16",
        weights_dtype="float16",
        optimizer=replace(MUON, warmup_epochs=0.5),
        object_loss=ObjectLossConfig(angle=5.0, offset=5.0),
        views=PatchAugmentation(empty=0.15, jpeg=0.1, monochrome=0.2, frames=0.4),
        seed=seed,
        device=device,
        symmetry=symmetry,
    )
