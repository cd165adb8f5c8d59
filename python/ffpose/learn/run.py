"""The command's work: plan, render, train, calibrate, test, export; resumable at any time."""

from __future__ import annotations

import json
import math
import shlex
import shutil
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ffpose import __version__
from ffpose._internal.files import held, read_json, same_place, sha256, write_json
from ffpose._internal.machine import cores
from ffpose._internal.seeds import CHOICES, TRAINING, matching
from ffpose._internal.zoo import resolve_initial
from ffpose.errors import DataError, expect
from ffpose.evaluation.card.measurement import measure
from ffpose.evaluation.evaluate import Evaluation, evaluate
from ffpose.evaluation.report.page import write_report
from ffpose.evaluation.report.plots import write_evaluation_figures
from ffpose.evaluation.report.results import write_results
from ffpose.geometry import Camera, DistortedCamera
from ffpose.geometry.symmetry import SymmetryGroup
from ffpose.learn.plan import (
    BEYOND,
    DEFAULT_CAMERA,
    DEFAULT_INIT,
    NETWORK,
    Speed,
    TrainingPlan,
    default_distances,
    image_size,
    plan_trainings,
    replanned,
    training,
    training_processes,
    whole_seconds,
)
from ffpose.learn.speed import measure_speed
from ffpose.models import build_network
from ffpose.models.weights import copy_weights, load_weights
from ffpose.onnx.metadata import read_model_metadata
from ffpose.onnx.pose_graph import export_weights
from ffpose.render import SCENES, SceneFile, Up
from ffpose.render.dataset.writer import write_dataset
from ffpose.render.inspection import find_doubts, is_y_up
from ffpose.render.renderer import MAX_SIDE, MIN_SIDE
from ffpose.render.spacecraft.craft import bounding_sphere
from ffpose.render.symmetry import Symmetries, find_symmetries
from ffpose.training import TrainConfig
from ffpose.training.checkpoint import RunFolder
from ffpose.training.engine import TrainResult, train
from ffpose.training.processes import Processes, joined

RECORD, SYMMETRY = "learn.json", "symmetry.json"
WEIGHTS, GRAPH = "best.safetensors", "model.onnx"

TEST_IMAGES = 300
CARD_IMAGES = 60

TEST_SIDE = 1280
"""Greatest side of test images; those of a large sensor would take longer than the training."""

NEAR_SHOWN = 3
"""Number of symmetries that are told and not folded; ``symmetry.json`` has all."""

TOLD_MODULO = 0.8
"""Ratio of the mean attitude error modulo what is not folded to that without, relative to a
constant pose's, below which it is told."""

POOR = 0.1
"""Share of a constant pose's errors above which one of attitude or position is called poor."""

CONFUSED = 0.1
"""Share of images that are off by one turn, above a constant pose's, from which it is told."""

Say = Callable[[str], None]


@dataclass(frozen=True)
class LearnConfig:
    """What to learn, and how long.

    Attributes:
        mesh: Mesh file of the spacecraft.
        out: Folder to write.
        minutes: Budget, wall time.
        mesh_scale: Meters per unit of the mesh.
        camera: Camera of the images.
        distance_m: Least and greatest distance; None for `ffpose.learn.plan.default_distances`.
        attitude_range_deg: Limits of the absolute roll, pitch and yaw, degrees.
        processes: Processes that render and prepare batches, and of which up to four train
            together, on GPUs one each; 0 for one a core. Under ``torchrun`` its processes train.
        seed: Seed of everything.
        device: "auto" (a GPU if there is one) or a device that torch knows.
        test_images: Number of images of the test, which have `test_size`.
        card_images: Number of images of each condition of the card; 0 for no card.
        mesh_up: Axis of the mesh file that becomes the object's z.
        mesh_center: Whether the origin is moved to the middle of the bounding sphere.
        mesh_two_sided: Whether the back of one-sided surfaces is shown.
        symmetry: What labels and errors are modulo: "auto" for the turns that leave the look the
            same within the sensor's noise, "none", or a file (`ffpose.geometry.symmetry`).
        init: Weights that the first training starts from, of the same architecture: a file, a
            shipped name, or "none" for random ones.
    """

    mesh: Path
    out: Path
    minutes: float = 60.0
    mesh_scale: float = 1.0
    camera: Camera = DEFAULT_CAMERA
    distance_m: tuple[float, float] | None = None
    attitude_range_deg: tuple[float, float, float] = (180.0, 90.0, 180.0)
    processes: int = 0
    seed: int = 0
    device: str = "auto"
    test_images: int = TEST_IMAGES
    card_images: int = CARD_IMAGES
    mesh_up: Up = "z"
    mesh_center: bool = False
    mesh_two_sided: bool = False
    symmetry: str = "auto"
    init: str = DEFAULT_INIT

    def __post_init__(self) -> None:
        expect(0 < self.minutes < math.inf, "minutes", "more than 0", self.minutes)
        expect(self.seed in TRAINING, "seed", f"0 to {TRAINING.stop - 1}", self.seed)
        name = self.mesh.stem
        if name in SCENES or "+" in name:
            raise ValueError(
                f"mesh: expected a file name without + that is no built-in set's, got"
                f" {self.mesh.name}; the set of its images has this name"
            )
        if isinstance(self.camera, DistortedCamera):
            raise ValueError(
                "camera: expected one without distortion, got a distorted one; leave out the key"
                " distortion here, and give the whole file to ffpose predict --camera"
            )
        if self.distance_m is not None:
            near, far = self.distance_m
            expect(0 < near < far, "distance", "0 < near < far", self.distance_m)
        expect(self.processes >= 0, "processes", "0 or more", self.processes)
        expect(self.test_images >= 1, "test_images", "1 or more", self.test_images)
        size = test_size(self.camera)
        fits = all(MIN_SIDE <= side <= MAX_SIDE for side in size)
        expect(fits, "camera", f"width and height within {MIN_SIDE}…{MAX_SIDE}", size)


def test_size(camera: Camera) -> tuple[int, int]:
    """Return the size of a camera's test images: its own, or a part of exactly its aspect ratio.

    A greater side than `TEST_SIDE` is divided by the least number that makes it that or smaller, if
    one up to twice that divides both sides.
    """
    width, height = camera.width, camera.height
    least = math.ceil(max(width, height) / TEST_SIDE)
    both = (n for n in range(least, 2 * least + 1) if width % n == height % n == 0)
    part = next(both, 1)
    return width // part, height // part


def learn(config: LearnConfig, say: Say = lambda _: None) -> dict[str, Any]:
    """Learn to pose a spacecraft from its mesh, and write all that its user needs.

    The folder gets ``best.safetensors`` and ``model.onnx`` (either is what `ffpose.load` opens, and
    so is the folder), ``report.html``, ``results.json``, ``card.md``, ``scene.json`` (the images,
    for ``ffpose render``), ``symmetry.json`` (what was folded, and what nearly looks the same) and
    the two trainings' folders. What an interrupted run finished is not repeated.

    Args:
        config: What to learn.
        say: Function that is called with messages on the progress.

    Returns:
        The summary of the test, with the constant pose's beside (`Evaluation.summary`); nothing in
        a process of ``torchrun`` that does not lead, and only trains.

    Raises:
        FileNotFoundError: There is no such mesh, or there are no such initial weights.
        ValueError: A number is out of range, the mesh has no attitude (as a sphere) or is flat, or
            the folder holds a run with other settings.
        ffpose.DataError: The mesh, the initial weights, or a file of an interrupted run cannot be
            used.
        OSError: The folder cannot be written, another process is at work in it, or the disk is
            full.
    """
    with joined(config.device) as group:
        if group.leads:
            with ExitStack() as folder, _leading(group) as train_together:
                return _learn(config, say, folder, group.world, train_together)
        while (training := group.same(None)) is not None:
            train(training, resume=True)
        return {}


@contextmanager
def _leading(group: Processes) -> Iterator[Callable[[TrainConfig], TrainResult]]:
    """Give a training by all processes of a group, and end the others with the block."""
    free = True

    def train_together(config: TrainConfig) -> TrainResult:
        nonlocal free
        group.same(config)
        free = False  # where a training fails, it does in all
        result = train(config, resume=True)
        free = True
        return result

    try:
        yield train_together
    finally:
        if free:
            group.same(None)


def _learn(
    config: LearnConfig,
    say: Say,
    folder: ExitStack,
    world: int,
    train_together: Callable[[TrainConfig], TrainResult],
) -> dict[str, Any]:
    """Do what `learn` does; ``folder`` holds the run's, from the start or where it is made."""
    began = time.monotonic()
    if there := config.out.is_dir():
        folder.enter_context(held(config.out))
    processes = config.processes or cores()
    radius, scene_file = _inspected(config)
    scene = scene_file.scene()
    record = _Record.open(config, scene.build().name)
    initial = _initial(config.init)
    symmetries = find_symmetries(scene.build()) if record.plans is None else None
    group = SymmetryGroup.chosen(config.symmetry)
    config.out.mkdir(parents=True, exist_ok=True)
    if not there:
        folder.enter_context(held(config.out))
    folds = config.out / SYMMETRY
    if symmetries is not None:
        group = symmetries.group if group is None else group
        found = symmetries.to_json()
        group.write(folds, same=found["same"], near=found["near"])
    else:
        group = SymmetryGroup.read(folds)
    path = config.out / "scene.json"
    scene_file.write(path)

    def configured(plan: TrainingPlan, init: Path | None = None) -> TrainConfig:
        made = training(
            config.out.resolve(),
            path.resolve(),
            radius,
            scene_file.distance_m,
            config.camera,
            plan,
            attitude_range_deg=config.attitude_range_deg,
            seed=config.seed,
            processes=processes,
            device=config.device,
            init=init,
            symmetry=folds.resolve() if len(group) > 1 else None,
            world=record.world,
        )
        return made if record.autocast is None else replace(made, autocast=record.autocast)

    if world == 1:
        world = record.world or training_processes(config.device, processes)
    before = record.world or world
    expect(world == before, "processes", f"{before} that train, as before", world)
    record.world = world
    if symmetries is not None:
        say("measuring the speed of this machine")
        speed, record.autocast = measure_speed(
            configured(TrainingPlan("first", 1000, 1), initial), scene
        )
        free = shutil.disk_usage(config.out).free
        record.plans, record.speed = plan_trainings(config.minutes, speed, free), speed
        record.write(config.out)
        say(_planned(config, radius, scene_file, record, processes, group, symmetries))
    assert record.plans is not None
    assert record.speed is not None
    first, second = record.plans
    rendering = time.monotonic()
    early = train_together(configured(first, initial))
    if not (config.out / WEIGHTS).exists():
        copy_weights(early.folder.best, config.out / WEIGHTS)
        spent = (time.monotonic() - began) / 60
        say(f"a first answer after {spent:.1f} minutes: {_validated(early)}")
    if not RunFolder(config.out / second.name).config.exists():
        spent = max(time.monotonic() - rendering, early.seconds)
        smaller = replanned(second, first, config.minutes, record.speed, spent)
        if smaller != second:
            second = smaller
            say(f"slower than planned: second training {_told(second)}")
            record.plans = (first, second)
            record.write(config.out)
    final = train_together(configured(second, early.folder.best))
    copy_weights(final.folder.best, config.out / WEIGHTS)
    evaluation = _tested(config, scene_file, _unfolded(folds, group), processes, say)
    summary = evaluation.summary()
    _report(config, evaluation, final, radius, scene_file)
    if not _exported(config.out):
        say("exporting, and checking the graph against torch")
        export_weights(config.out / WEIGHTS, config.out / GRAPH)
    if config.card_images > 0:
        say(f"card: {config.card_images} images of each condition")
        measure(
            config.out / WEIGHTS,
            str(path),
            count=config.card_images,
            workers=processes,
            device=config.device,
            size=test_size(config.camera),
            out=config.out,
        )
    say(str(config.out / "report.html"))
    say(verdict(summary))
    return summary


def _initial(init: str) -> Path | None:
    """Return the initial weights, a file or a name, once they are known to fit the network.

    A name stays one: an interrupted run goes on where ffpose is installed in another place.
    """
    if init == "none":
        return None
    load_weights(resolve_initial(init), build_network(NETWORK, backbone_weights="none"))
    path = Path(init)
    return path.resolve() if path.is_file() else path


def _inspected(config: LearnConfig) -> tuple[float, SceneFile]:
    """Return the spacecraft's radius about its origin in meters, and the set of its images."""
    name = config.mesh.stem
    unknown = SceneFile(
        name,
        config.mesh,
        config.mesh_scale,
        (1.0, 2.0),
        config.attitude_range_deg,
        config.camera,
        config.mesh_up,
        config.mesh_center,
        config.mesh_two_sided,
    )
    mesh = unknown.scene().build().mesh
    vertices = mesh.vertices[np.unique(mesh.faces)]
    radius = float(np.linalg.norm(vertices, axis=1).max())
    center, size = bounding_sphere(vertices)
    # Where the origin is outside of the sphere, the camera keeps clear of the spacecraft still.
    reach = max(size, (size + float(np.linalg.norm(center))) / 2)
    distance = config.distance_m or default_distances(reach, config.camera)
    return radius, replace(unknown, distance_m=distance)


def _planned(
    config: LearnConfig,
    radius: float,
    scene: SceneFile,
    record: _Record,
    processes: int,
    group: SymmetryGroup,
    symmetries: Symmetries,
) -> str:
    """Return the table of what was chosen."""
    near, far = scene.distance_m
    rows, columns = image_size(config.camera)
    camera, speed, plans = config.camera, record.speed, record.plans
    assert plans is not None
    assert speed is not None
    angles = ", ".join(f"{angle:g}" for angle in config.attitude_range_deg)
    by = f"{processes} processes" if processes > 1 else "1 process"
    nearer, farther = BEYOND
    lines = {
        "spacecraft": f"{config.mesh.name}, within {radius:.3g} m of its origin",
        "distances": f"{near:.3g} to {far:.3g} m; {nearer} and {farther} times these in training",
        "camera": f"{camera.width} x {camera.height}, fx {camera.fx:.1f}",
        "network": f"{NETWORK}, on {columns} x {rows} pixels",
        "starts from": "random weights" if config.init == "none" else f"weights {config.init}",
        "attitudes": f"roll, pitch, yaw within {angles} degrees",
        "symmetry": _folded(group),
        "speed": f"{speed.views:.0f} views/s, {speed.samples:.0f} samples/s, {by}",
        "first training": _told(plans[0]),
        "second training": _told(plans[1]),
        "budget": f"{config.minutes:g} minutes",
    }
    whole = whole_seconds(plans, speed) / 60
    if whole > 1.05 * config.minutes:
        lines["budget"] += f"; training, tests, card and graph may take {whole:.0f}"
    # Those that are not folded, as --symmetry says otherwise, are told too.
    others = [*(symmetries.same if len(group) == 1 else []), *symmetries.near[:NEAR_SHOWN]]
    found = find_doubts(scene.scene().build(), y_up=is_y_up(config.mesh, config.mesh_up))
    told = [("not folded", each) for each in others] + [("doubtful", each) for each in found]
    return "\n".join(f"{name:16}{text}" for name, text in [*lines.items(), *told])


def _told(plan: TrainingPlan) -> str:
    return f"{plan.views} views, {plan.epochs} epochs"


def _folded(group: SymmetryGroup) -> str:
    return "none" if len(group) == 1 else f"{group}: attitudes of one look are one"


def _validated(result: TrainResult) -> str:
    row = result.history[result.best_epoch - 1]
    return (
        f"median errors of {float(row['val_median_rotation_error_deg']):.1f} degrees and"
        f" {float(row['val_median_translation_error_m']):.2g} m on validation images"
    )


def _unfolded(path: Path, folded: SymmetryGroup) -> tuple[SymmetryGroup, ...]:
    """Return the symmetry groups, exact and near, that are not folded; each has the folded one."""
    found = read_json(path)
    same, near = ([_axis(each) for each in found.get(name, [])] for name in ("same", "near"))
    groups = [folded]
    for axes in (same, *([axis] for axis in near)):
        try:
            group = SymmetryGroup.from_json([*folded.to_json(), *axes])
        except ValueError:
            continue  # in no group with what is folded
        if not any(each.has(group.rotations) and group.has(each.rotations) for each in groups):
            groups.append(group)
    return tuple(groups[1 : 1 + NEAR_SHOWN])


def _axis(told: dict[str, Any]) -> dict[str, Any]:
    return {name: told.get(name) for name in ("axis", "fold")}


def _tested(
    config: LearnConfig,
    scene: SceneFile,
    unfolded: tuple[SymmetryGroup, ...],
    processes: int,
    say: Say,
) -> Evaluation:
    """Evaluate the weights on images of seeds that nothing before has rendered."""
    say(f"testing on {config.test_images} unseen images")
    images = config.out / "test-images"
    written = write_dataset(
        scene.scene(),
        images,
        config.test_images,
        matching(CHOICES, config.seed),
        size=test_size(config.camera),
        workers=processes,
    )
    evaluation = evaluate(
        config.out / WEIGHTS,
        "urso",
        written.folder,
        "all",
        device=config.device,
        unfolded=unfolded,
    )
    write_results(evaluation, config.out)
    write_evaluation_figures(evaluation, config.out)
    return evaluation


def _exported(out: Path) -> bool:
    """Return whether the graph in a run's folder is of the weights there."""
    try:
        metadata = read_model_metadata(out / GRAPH)
    except (FileNotFoundError, DataError):
        return False
    return metadata.weights_sha256 == sha256(out / WEIGHTS)


def verdict(summary: dict[str, Any]) -> str:
    """Return the result in a sentence or two, and where it is poor what to change."""
    sources = summary, summary["mean_pose_baseline"]
    error, constant = (source["median_rotation_error_deg"] for source in sources)
    meters, constant_m = (source["median_translation_error_m"] for source in sources)
    modulo = ""
    if (plain := summary.get("without_symmetry")) is not None:
        without = plain["median_rotation_error_deg"]
        modulo = f" modulo symmetry ({without:.0f} without regard to it)"
    text = (
        f"median errors {error:.2f} degrees{modulo} and {meters:.3g} m on {summary['images']}"
        f" unseen images, of which {summary['share_over_30_deg']:.0%} are more than 30 degrees off;"
        f" a constant pose has {constant:.0f} degrees and {constant_m:.3g} m"
    )
    for each in summary.get("modulo_unfolded", []):
        constants = summary["mean_pose_baseline"], each["mean_pose_baseline"]
        whole, of_group = (source["mean_rotation_error_deg"] for source in constants)
        own, modulo_it = (source["mean_rotation_error_deg"] for source in (summary, each))
        if modulo_it * whole < TOLD_MODULO * of_group * own:  # no ratios: errors may be zero
            text += (
                f"; modulo {SymmetryGroup.from_json(each['axes'])}, which is not folded,"
                f" {each['median_rotation_error_deg']:.2f} degrees (a constant pose"
                f" {constants[1]['median_rotation_error_deg']:.0f})"
            )
    confusion = summary["confusion"]
    if confusion["share"] - summary["mean_pose_baseline"]["confusion"]["share"] >= CONFUSED:
        turn = np.array(confusion["rotation_vector_deg"])
        angle = float(np.linalg.norm(turn))
        axis = ", ".join(f"{value:.2f}" for value in turn / angle)
        text += (
            f"; {confusion['share']:.0%} are taken for what is seen after a turn by {angle:.0f}"
            f" degrees about ({axis}): more minutes may tell the two apart, and --symmetry FILE"
            " folds them"
        )
        if (modes := summary.get("uncertainty", {}).get("modes")) is not None:
            known = 1 - modes["share_over_30_deg_of_both"] / modes["share_over_30_deg"]
            text += (
                f"; in {known:.0%} of those more than 30 degrees off the second attitude that"
                " poses tell is right"
            )
    if error <= POOR * constant and meters <= POOR * constant_m:
        return text
    return (
        f"POOR: {text}. What helps: more --minutes, in another folder and from these weights"
        " (--init); nearer --distance; a narrower --attitude-range where the mission has one; the"
        " mesh's units and origin (ffpose inspect)"
    )


def _report(
    config: LearnConfig,
    evaluation: Evaluation,
    result: TrainResult,
    radius: float,
    scene: SceneFile,
) -> None:
    near, far = scene.distance_m
    write_report(
        config.out / "report.html",
        evaluation,
        title=f"{scene.name}: from an image to a pose",
        subtitle=verdict(evaluation.summary()) + ".",
        history=result.history,
        facts={
            "spacecraft": f"{config.mesh.name}, within {radius:.3g} m of its origin",
            "distances": f"{near:.3g} to {far:.3g} m",
            "budget": f"{config.minutes:g} minutes",
            "symmetry": _folded(evaluation.symmetry),
            "epochs": f"{len(result.history)}, the best is {result.best_epoch}",
            "ffpose": __version__,
        },
        command=shlex.join(_command(config)),
    )


def _command(config: LearnConfig) -> list[str]:
    """Return the command with all options that change the result."""
    plain = LearnConfig(config.mesh, config.out)
    words = ["ffpose", "learn", str(config.mesh), "--out", str(config.out)]
    words += ["--minutes", f"{config.minutes:g}"]
    names = ("mesh_scale", "mesh_up", "mesh_center", "mesh_two_sided", "symmetry", "init", "seed")
    for name in (*names, "distance_m", "attitude_range_deg"):
        value = getattr(config, name)
        if value != getattr(plain, name):
            words += ["--" + name.removesuffix("_m").removesuffix("_deg").replace("_", "-")]
            if value is not True:
                words += map(str, value if isinstance(value, tuple) else [value])
    return words if config.camera == plain.camera else [*words, "--camera", "FILE"]


@dataclass
class _Record:
    """``learn.json``: the settings of a folder's run, and what was planned from the speed.

    An interrupted run goes on with ``world`` processes that train, on any number of cores.
    """

    settings: dict[str, Any]
    plans: tuple[TrainingPlan, TrainingPlan] | None = None
    autocast: Any = None
    speed: Speed | None = None
    world: int | None = None

    @classmethod
    def open(cls, config: LearnConfig, spacecraft: str) -> _Record:
        """Open a folder's record, or begin one; ``spacecraft`` names the mesh with its contents.

        Raises:
            ValueError: The folder's run has other settings, or a file that it read has changed.
            ffpose.DataError: The record cannot be used.
        """
        settings = json.loads(json.dumps(asdict(config), default=str))
        for name in ("out", "processes", "device"):
            del settings[name]
        settings["spacecraft"] = spacecraft
        for name in ("symmetry", "init"):
            if (path := Path(settings[name])).is_file():
                settings[f"{name}_sha256"] = sha256(path)
        path = config.out / RECORD
        if not path.exists():
            for name in (WEIGHTS, GRAPH):
                if (config.out / name).exists():
                    raise ValueError(
                        f"out: expected a folder of ffpose learn, or none yet, got {config.out},"
                        f" which has another's {name}"
                    )
            return cls(settings)
        found = read_json(path)
        try:
            there, planned = found["settings"], found["plans"]
            one, two = (TrainingPlan(**each) for each in planned)
            autocast, speed = found["autocast"], Speed(**found["speed"])
        except (KeyError, TypeError, ValueError) as error:
            remedy = "remove the folder, or write to another"
            raise DataError(f"expected the record of a run: {error}; {remedy}", path) from error
        # Contents tell a file, by whatever path it is reached.
        names = ("symmetry", "init")
        hashed = {name for name in names if f"{name}_sha256" in settings.keys() & there} | {"mesh"}
        for name, value in settings.items():
            if name in there and name not in hashed and not same_place(there[name], value):
                raise ValueError(
                    f"out: expected {name} {there[name]} as the run in {config.out}, got"
                    f" {value}; remove the folder, or write to another"
                )
        return cls(settings, (one, two), autocast, speed, found.get("world"))

    def write(self, out: Path) -> None:
        write_json(out / RECORD, asdict(self), 1)
