"""The command line: one function per command, without logic.

Results that a program may read go to standard output, everything else to standard error. Exit code
0: done; 1: failed, with one line of explanation (``--debug`` shows the traceback); 2: wrong usage;
130: interrupted by Ctrl-C; 141: standard output was closed, as by ``head``; 143: ended by SIGTERM.
Imports are deferred until a command runs, so that ``ffpose --help`` is fast and needs only NumPy.
"""

from __future__ import annotations

import argparse
import errno
import json
import os
import re
import sys
import warnings
from collections.abc import Callable, Sequence
from dataclasses import replace
from importlib.util import find_spec
from io import TextIOWrapper
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, NamedTuple, get_args

from ffpose._internal.files import expect_place, expect_writable
from ffpose._internal.options import advice, check_spelling, is_usage, positionals_first, restyle
from ffpose._internal.signals import exit_on_sigterm
from ffpose.errors import DataError, MissingExtraError, expect, explain, require

if TYPE_CHECKING:
    from jsonargparse import ArgumentParser, Namespace

    from ffpose.onnx.exporter import Exported
    from ffpose.render import Scene
    from ffpose.render.spacecraft.craft import Craft


TRAINED_DEMO = 500
"""Images of a demo that trains: its training takes longer than they do."""

SECONDS, RATE = 120.0, 2.0
"""Length of a rendered motion, and its frames a second, if nobody says otherwise."""

POSE = ("torch", "torchvision", "torchmetrics", "timm", "safetensors", "matplotlib")
"""What the extra [pose] brings and [onnx,render] do not."""


Arguments = dict[str, tuple[Any, Any, str]]
"""By name, the type of an argument or a dict of what argparse takes, its default and its help.

The type bool makes a switch, and an ellipsis for a default one that must be given.
"""


class Command(NamedTuple):
    """A command: one-line summary, arguments, function, and the extra that it needs."""

    summary: str
    arguments: Callable[[], Arguments]
    run: Callable[[Namespace], None]
    extra: str = "pose"


def width_and_height(text: str) -> tuple[int, int]:
    """Return the width and height that ``640x480`` stands for."""
    width, height = map(int, text.split("x"))
    return width, height


def size_type() -> Any:
    """Return the type of a ``WIDTHxHEIGHT`` argument, parsed by `width_and_height`."""
    return require("jsonargparse.typing", "render").restricted_string_type("Size", r"^\d+x\d+$")


def say(text: str) -> None:
    """Print a message on standard error, unless it is closed."""
    if sys.stderr is not None:  # `print` would take standard output
        print(text, file=sys.stderr)


def show(document: dict[str, Any]) -> None:
    """Print one JSON document on standard output."""
    print(json.dumps(document, indent=2))


def declare(parser: ArgumentParser, arguments: Arguments) -> None:
    """Declare arguments, in their order."""
    for name, (kind, default, text) in arguments.items():
        settings = dict(kind) if isinstance(kind, dict) else {"type": kind}
        if kind is bool:
            settings = {"action": "store_true"}
        if default is ...:
            settings |= {"required": True} if name.startswith("-") else {}
        elif default is not None:  # a configuration file takes none
            settings["default"] = default
        parser.add_argument(name, help=text, **settings)


OUT: Arguments = {"--out": (Path, ..., "folder to write")}
JSON: Arguments = {"--json": (bool, False, "print the results as JSON")}
MESH = "your spacecraft: .glb, .gltf, .obj, .ply, .stl"
CAMERA = "JSON file of the images' camera: width, height, fx, fy, cx, cy"
ANY_CAMERA = f"{CAMERA}, distortion if any (default: camera.json beside them, or of the weights)"
WHITE = "level that becomes white in images of more than 8 bits, or percentile such as p99.5"
ANGLES: dict[str, Any] = {"nargs": 3, "type": float, "metavar": ("ROLL", "PITCH", "YAW")}
SYMMETRY: dict[str, Any] = {"metavar": "auto|none|FILE"}
NETWORK = "weights file, exported .onnx graph, folder with one, or a name such as soyuz"
WEIGHTS: Arguments = {
    "weights": (Path, ..., NETWORK),
    "--device": (str, "auto", "of weights; auto: a GPU if there is one, else the CPU"),
}
TAKEN: Arguments = {
    "--camera": (Path, None, ANY_CAMERA),
    "--resize": (bool, False, "resize images of any camera to the network's input"),
    "--white": (float | str, None, WHITE),
}
"""How images were taken that are to be posed."""
LOOKS: Arguments = {
    "--looks": (int, None, "number of second looks, for less latency"),
    "--candidates": (int, None, "number of places looked at first, for less latency"),
}
"""How often a network with a second look looks."""


def demo_arguments() -> Arguments:
    """Return the arguments of `demo`."""
    return {
        "--out": (Path, None, "folder to write (default: runs/demo, or runs/demo-train)"),
        "--train": (bool, False, "train from scratch, in minutes, instead of the shipped weights"),
    }


def demo(options: Namespace) -> None:
    """Predict the poses of unseen images, and write a report.

    Without the extra [pose] the shipped graph poses fewer images, and the report is a gallery.
    """
    missing = [package for package in POSE if find_spec(package) is None]
    if missing and options.train:
        raise MissingExtraError.of(missing[0], "pose,render")
    out = options.out or Path("runs/demo-train" if options.train else "runs/demo")
    expect_writable(out)
    if missing:
        from ffpose.demo.gallery import run as run_gallery

        document = run_gallery(out)
    else:
        from ffpose.demo.config import DemoConfig
        from ffpose.demo.run import run

        config = DemoConfig(images=TRAINED_DEMO, train=True) if options.train else DemoConfig()
        document = run(out, config)
    for name in ("median_translation_error_m", "median_rotation_error_deg"):
        baseline = document.get("mean_pose_baseline", {}).get(name)
        beside = "" if baseline is None else f" (mean pose: {baseline:.3f})"
        print(f"{name}: {document[name]:.3f}{beside}")
    print(out / "report.html")


def mesh_arguments() -> Arguments:
    """Return the arguments that mend a mesh."""
    from ffpose.render import Up

    up = "axis of the mesh file that becomes the object's z (glTF files have y up)"
    return {
        "--mesh-up": ({"choices": get_args(Up)}, "z", up),
        "--mesh-scale": (float, 1.0, "meters per unit of the mesh"),
        "--mesh-center": (bool, False, "move the origin to the middle of the bounding sphere"),
        "--mesh-two-sided": (bool, False, "show the back of one-sided surfaces"),
    }


def expect_no_mesh(options: Namespace) -> None:
    """Raise a ValueError if one of `mesh_arguments` is not at its default."""
    for option, (_, default, _) in mesh_arguments().items():
        name = option.removeprefix("--")
        if options[name.replace("-", "_")] != default:
            raise ValueError(f"{name}: expected with a mesh, got none")


def craft_of(options: Namespace) -> Craft:
    """Return the spacecraft of the mesh that a command takes."""
    from ffpose.render import load_craft

    return load_craft(
        options.mesh,
        options.mesh_scale,
        options.mesh_up,
        center=options.mesh_center,
        two_sided=options.mesh_two_sided,
    )


def render_arguments() -> Arguments:
    """Return the arguments of `render`."""
    from ffpose.render.layers import LABELS
    from ffpose.render.scene import Renderer

    scene = "soyuz_easy, soyuz_hard, dragon_hard, or a scene.json of ffpose learn; "
    within = "scene of a motion: a set (default: soyuz_hard) or a scene.json"
    row = "CSV file of time,tx,ty,tz,qw,qx,qy,qz: render one frame of the scene for each row"
    labels = {"nargs": "+", "choices": list(LABELS)}
    angles = "largest absolute angles, degrees; 180 90 180 for all attitudes"
    renderer = "renderer of the spacecraft; mitsuba is a path tracer, 20 times slower"
    return {
        "scene": (str, ..., f"{scene}or a motion: approach, tumble, flyby"),
        "--scene": ({"dest": "within"}, None, within),
        **OUT,
        "--count": (int, None, "number of images of a scene"),
        "--start": (int, 0, "index of the first image"),
        "--seconds": (float, None, f"length of a motion (default: {SECONDS:g})"),
        "--rate": (float, None, f"frames per second of a motion (default: {RATE:g})"),
        "--drop": (float, None, "share of a motion's frames that are left out (default: 0)"),
        "--trajectory": (Path, None, row),
        "--seed": (int, 0, "seed of the set"),
        "--size": (size_type(), None, "WIDTHxHEIGHT in pixels, as 640x480"),
        "--workers": (int, 1, "processes that render"),
        "--layers": (bool, False, "write mask, depth and keypoints too"),
        "--labels": (labels, [], "write these layers too"),
        "--camera": (Path, None, CAMERA),
        "--mesh": (Path, None, "own spacecraft: .obj, .stl, .ply, .glb, .gltf"),
        **mesh_arguments(),
        "--attitude-range": (ANGLES, None, angles),
        "--eclipse-rate": (float, None, "share in the Earth's shadow (default: as in orbit)"),
        "--motion": (float, 0.0, "largest motion blur, pixels of an image 1280 wide"),
        "--jpeg": (int, 0, "JPEG quality 1-100; 0 is none"),
        "--randomize": (float, 0.0, "domain randomization, 0-1"),
        "--renderer": ({"choices": get_args(Renderer)}, "ffpose", renderer),
    }


def render(options: Namespace) -> None:
    """Render images of a scene, or the frames of a motion, with exact labels."""
    expect_writable(options.out)
    if options.mesh is None:
        expect_no_mesh(options)
    from ffpose.render.motion import KINDS

    if options.scene in KINDS or options.trajectory is not None:
        render_motion(options)
    else:
        render_set(options)


def chosen_scene(options: Namespace, name: str) -> Scene:
    """Return the scene that the arguments of `render` describe."""
    from ffpose.geometry import Camera
    from ffpose.render import Randomization, find_scene

    limits = options.attitude_range
    scene = find_scene(name, None if limits is None else tuple(limits))
    sensor = replace(scene.sensor, motion_px=options.motion, jpeg_quality=options.jpeg)
    return replace(
        scene,
        sensor=sensor,
        eclipse_rate=scene.eclipse_rate if options.eclipse_rate is None else options.eclipse_rate,
        randomization=Randomization.of_strength(options.randomize),
        camera=Camera.read(options.camera) if options.camera else scene.camera,
        craft=craft_of(options) if options.mesh else scene.craft,
        renderer=options.renderer,
    )


def render_set(options: Namespace) -> None:
    """Render images of a scene, in URSO's layout."""
    from ffpose.render.dataset.writer import write_dataset
    from ffpose.render.layers import LAYERS

    for option, value in {
        "--scene": options.within,
        "seconds": options.seconds,
        "rate": options.rate,
        "drop": options.drop,
    }.items():
        if value is not None:
            raise ValueError(f"{option}: expected for a motion's frames, got it for a scene")
    if options.count is None:
        raise ValueError("count: expected --count N, the number of images of a scene")
    written = write_dataset(
        chosen_scene(options, options.scene),
        options.out,
        options.count,
        options.seed,
        start=options.start,
        size=None if options.size is None else width_and_height(options.size),
        workers=options.workers,
        labels=[*options.labels, *(LAYERS if options.layers else ())],
        progress=True,
    )
    say(f"{written.folder}: {written.rendered} images in {written.seconds:.1f} s")
    if not written.closed:
        say("the folder has images of other runs too: one run over all images writes the labels")


def render_motion(options: Namespace) -> None:
    """Render the frames of a motion, as a csv set with times."""
    from ffpose.datasets.csv_set import read_trajectory
    from ffpose.render.dataset.sequence_writer import write_sequence
    from ffpose.render.sequence import Sequence

    for name in ("count", "start", "labels", "layers", "motion"):
        if options[name]:
            raise ValueError(f"{name}: expected for a scene's images, got it for a motion's frames")
    size = None if options.size is None else width_and_height(options.size)
    if options.trajectory is not None:
        for name in ("seconds", "rate"):
            if options[name] is not None:
                raise ValueError(f"{name}: expected without --trajectory, whose times it has")
        if options.within is not None:
            raise ValueError("scene: expected SCENE --trajectory FILE, got --scene too")
        scene = chosen_scene(options, options.scene)
        motion = read_trajectory(options.trajectory)
        sequence = Sequence.along(scene, motion, options.seed, size)
    else:
        scene = chosen_scene(options, options.within or "soyuz_hard")
        seconds = SECONDS if options.seconds is None else options.seconds
        rate = RATE if options.rate is None else options.rate
        sequence = Sequence.of_kind(options.scene, scene, seconds, rate, options.seed, size)
    drop = options.drop or 0.0
    written = write_sequence(sequence, options.out, drop=drop, workers=options.workers)
    say(f"{written.folder}: {written.rendered} frames in {written.seconds:.1f} s")


def train_arguments() -> Arguments:
    """Return the arguments of `train` but for those of `declare_fields`."""
    from ffpose.training import configs

    names = ", ".join(configs.names())
    text = f"YAML file, such as config.yaml of a run, or the name of one in the package: {names}"
    return {
        "--config": ({"action": "config"}, None, text),
        "--resume": (bool, False, "resume the run in --out; begin one where there is none"),
    }


def train(options: Namespace) -> None:
    """Train a network on labeled images or rendered scenes."""
    expect_writable(options.out)
    from ffpose.training.options import to_config

    fields = vars(options)
    resume = fields.pop("resume")
    del fields["config"]  # it has become fields
    config = to_config(fields)
    from ffpose._internal.figures import save_figure
    from ffpose.evaluation.report.plots import training_curves
    from ffpose.training.checkpoint import RunFolder
    from ffpose.training.engine import train as run

    saved = RunFolder(config.out).state
    if resume and not saved.exists():
        say(f"{config.out}: no run to resume, a new one begins")
    try:
        result = run(config, resume=resume)
    except KeyboardInterrupt:
        if saved.exists():
            say(f"ffpose: finished epochs are saved in {config.out}; continue with --resume")
        raise
    if result.leads:
        save_figure(training_curves(result.history), result.folder.curves)
        say(f"best epoch {result.best_epoch}: {result.folder.best}")


def data_arguments(*, required: bool = True) -> Arguments:
    """Return the arguments that choose a command's images."""
    default = ... if required else None
    kinds = "urso, speed, speedplus, cambridge, sevenscenes or csv"
    return {
        "--data.kind": (str, default, f"layout of the image set: {kinds}"),
        "--data.root": (Path, default, "folder of the image set"),
        "--data.undistort": (bool, False, "undistort images of cameras with distortion"),
        "--data.white": (float | str, None, WHITE),
    }


def learn_arguments() -> Arguments:
    """Return the arguments of `learn`."""
    init = "weights to start from: a name such as generic, a file, or none for random ones"
    distance = {"nargs": 2, "type": float, "metavar": ("NEAR", "FAR")}
    apart = "meters; 1.5 to 8 diameters of the spacecraft by default"
    one = "attitudes that count as one: auto (equal within sensor noise), none, or a JSON file"
    return {
        "mesh": (Path, ..., MESH),
        **OUT,
        "--minutes": (float, 60.0, "budget of the whole run, wall time; more is better"),
        "--camera": (Path, None, CAMERA),
        "--init": (str, "generic", init),
        "--processes": (int, 0, "processes that render and train; 0 for one for each core"),
        "--seed": (int, 0, "seed of all random numbers"),
        "--device": (str, "auto", "auto, cpu, cuda"),
        **mesh_arguments(),
        "--distance": (distance, None, apart),
        "--attitude-range": (ANGLES, [180.0, 90.0, 180.0], "largest absolute angles, degrees"),
        "--symmetry": (SYMMETRY, "auto", one),
    }


def learn(options: Namespace) -> None:
    """Learn to pose your own spacecraft from its mesh, test it, and write a report."""
    from ffpose.geometry import Camera
    from ffpose.learn.plan import DEFAULT_CAMERA
    from ffpose.learn.run import LearnConfig
    from ffpose.learn.run import learn as run

    expect_writable(options.out)
    values = vars(options)
    values["camera"] = Camera.read(options.camera) if options.camera else DEFAULT_CAMERA
    distance, angles = values.pop("distance"), values.pop("attitude_range")
    values |= {"distance_m": distance and tuple(distance), "attitude_range_deg": tuple(angles)}
    run(LearnConfig(**values), say)


def evaluate_arguments() -> Arguments:
    """Return the arguments of `evaluate`."""
    empty = "folder of images without the object, which should be flagged"
    reproject = "reproject images of a camera other than the weights' to the network's view"
    modulo = "what errors are measured modulo: auto (as in training), none, or a JSON file"
    return {
        **WEIGHTS,
        **data_arguments(),
        **OUT,
        "--data.split": (str, "test", "a split of the set, or all"),
        "--empty": (Path, None, empty),
        "--reproject": (bool, False, reproject),
        **JSON,
        "--symmetry": (SYMMETRY, "auto", modulo),
    }


def evaluate(options: Namespace) -> None:
    """Measure the errors of a network on labeled images, beside those of the mean pose."""
    from ffpose.datasets import Decoding
    from ffpose.evaluation.evaluate import evaluate as run
    from ffpose.evaluation.report.plots import write_evaluation_figures
    from ffpose.evaluation.report.results import format_table, write_results
    from ffpose.geometry.symmetry import SymmetryGroup

    expect_writable(options.out)
    data = options.data
    apart = options.out.resolve() != data.root.resolve()  # a table of results would be a split
    expect(apart, "out", "another folder than that of the images", options.out)
    evaluation = run(
        options.weights,
        data.kind,
        data.root,
        data.split,
        reproject=options.reproject,
        decoding=Decoding(data.undistort, data.white),
        device=options.device,
        empty=options.empty,
        symmetry=SymmetryGroup.chosen(options.symmetry),
    )
    write_results(evaluation, options.out)
    write_evaluation_figures(evaluation, options.out)
    if options.json:
        show(evaluation.summary())
    else:
        print(format_table(evaluation.summary()))


def predict_arguments() -> Arguments:
    """Return the arguments of `predict`."""
    images = "image files, folders of PNG, JPEG and PGM files, and patterns such as 'set/*/*.png'"
    return {
        **WEIGHTS,
        "images": ({"nargs": "+"}, ..., images),
        "--json": (bool, False, "print a line of JSON for each image"),
        "--batch": (int, 1, "images computed together"),
        "--overlay": (Path, None, "folder for images with the axes drawn"),
        **TAKEN,
    }


def predict(options: Namespace) -> None:
    """Print the pose of the spacecraft in each image, as soon as it is known.

    An image that cannot be used is reported, the others are still processed, and the exit code is
    1. Images of another camera than the weights' (--camera, or camera.json beside them) are
    reprojected; --resize takes them as they are.
    """
    from ffpose.geometry import Camera
    from ffpose.imaging.images import find_images
    from ffpose.inference.load import load
    from ffpose.inference.prediction import (
        Failure,
        camera_beside,
        expect_axes,
        expect_distinct_overlays,
        write_overlay,
    )
    from ffpose.inference.prediction import predict as run

    images = find_images(options.images)
    if options.overlay is not None:
        expect_writable(options.overlay)
        expect_distinct_overlays(images, options.overlay)
    named = options.camera and Camera.read(options.camera)
    estimator = load(
        options.weights,
        camera=named or (None if options.resize else camera_beside(images)),
        resize=options.resize,
        white=options.white,
        device=options.device,
        warm_up=0,
    )
    told = estimator.metadata
    if options.overlay is not None:
        expect_axes(estimator)
    elif named is not None and told.camera is None and not told.undistorted:
        raise ValueError("camera: expected with --overlay, for these weights know no camera")
    failures = []
    for answer in run(estimator, images, batch=options.batch):
        if options.json:
            print(json.dumps(answer.to_dict()), flush=True)
        if isinstance(answer, Failure):
            failures.append(answer)
            if len(images) > 1:
                say(f"ffpose: {answer}")
            continue
        if not options.json:
            print(answer, flush=True)
        if options.overlay is not None:
            say(str(write_overlay(answer, options.overlay)))
    if failures and len(images) == 1:
        raise failures[0].error
    if failures:
        raise DataError(f"{len(failures)} of {len(images)} images have no pose")


def track_arguments() -> Arguments:
    """Return the arguments of `track`."""
    times = "CSV file of image,time (seconds), perhaps with poses (default: frames.csv there)"
    return {
        **WEIGHTS,
        "images": (Path, ..., "folder of the frames"),
        **OUT,
        "--times": (Path, None, times),
        **TAKEN,
        "--whole": (bool, False, "search each frame as a whole, not where the track expects it"),
        "--settings": (Path, None, "JSON file of fields of ffpose.tracking.Settings"),
    }


def track(options: Namespace) -> None:
    """Track a spacecraft through the frames of a sequence: position, attitude, velocities."""
    from ffpose.geometry import CAMERA_FILE, Camera
    from ffpose.inference.load import load
    from ffpose.tracking.follow import TRAJECTORY
    from ffpose.tracking.follow import run as run_track
    from ffpose.tracking.frames import read_frames
    from ffpose.tracking.tracker import read_settings

    expect_writable(options.out)
    frames = read_frames(options.images, options.times)
    beside = options.images / CAMERA_FILE
    path = options.camera or (beside if beside.is_file() and not options.resize else None)
    estimator = load(
        options.weights,
        camera=None if path is None else Camera.read(path),
        resize=options.resize,
        white=options.white,
        device=options.device,
        track=not options.whole,
        warm_up=0,
    )
    settings = read_settings(options.settings, estimator.metadata)
    if estimator.near is None and not options.whole:
        say("each frame is searched as a whole: no single look (ffpose export --track)")
    title = f"{options.images.absolute().name}, tracked by {options.weights.absolute().name}"
    followed = run_track(estimator, frames, options.out, settings=settings, title=title)
    accepted = sum(each.step.accepted for each in followed)
    say(f"{options.out / TRAJECTORY}: {len(followed)} frames, {accepted} accepted")


def inference_fields(options: Namespace) -> dict[str, Any]:
    """Return the fields of a network that `LOOKS` change."""
    return {name: options[name] for name in ("looks", "candidates") if options[name] is not None}


def export_arguments() -> Arguments:
    """Return the arguments of `export`."""
    filters = "filters by ffpose's operator, or by standard ones alone"
    track = "write the single look of a track too, X.track.onnx beside X.onnx"
    return {
        "weights": (Path, ..., "weights, or a name such as soyuz"),
        "--out": (Path, ..., "ONNX file to write"),
        "--filter": ({"choices": ["custom", "matmul"]}, "custom", filters),
        **LOOKS,
        "--track": (bool, False, track),
        "--int8": (bool, False, "convolutions and matrix products in 8 bits"),
        "--calibrate": (Path, None, "folder of typical images, unlabeled; with --int8"),
    }


def export(options: Namespace) -> None:
    """Write a network as an ONNX graph, and check it against torch on random images.

    With --int8, the differences of poses from float32 on the calibration images are printed too.
    """
    from ffpose._internal.files import atomic_write, sha256
    from ffpose.imaging.images import image_files
    from ffpose.inference.int8 import quantize_graph
    from ffpose.inference.source import TRACK_SUFFIX
    from ffpose.onnx.pose_graph import expect_graph_name, export_weights

    if options.int8 != (options.calibrate is not None):
        raise ValueError("int8: expected with --calibrate DIR, both or neither, got one")
    if options.int8 and options.track:
        raise ValueError("track: expected without --int8, got both")
    expect_graph_name(options.out)
    expect_place(options.out)
    images = image_files(options.calibrate, "calibrate") if options.int8 else []
    with TemporaryDirectory(prefix="ffpose-export-") as folder:
        path = Path(folder) / "float32.onnx" if options.int8 else options.out
        fields = inference_fields(options)
        beside = options.out.with_suffix(TRACK_SUFFIX)
        track = Path(folder) / beside.name
        if options.track:
            tell(export_weights(options.weights, track, options.filter, takes_point=True, say=say))
            fields["track_sha256"] = sha256(track)
        tell(export_weights(options.weights, path, options.filter, say=say, **fields))
        if options.track:  # not before the graph that it belongs to is there
            with atomic_write(beside) as temporary:
                temporary.write_bytes(track.read_bytes())
        if options.int8:
            quantized = quantize_graph(path, options.out, images, say=say)
            print(*quantized.lines(), sep="\n")
            say(f"int8: {quantized.bytes / 1e6:.1f} MB, {quantized.nodes} nodes")
    say(str(options.out))


def tell(exported: Exported) -> None:
    """Print how much a graph differs from torch, its size and how it computes filters."""
    for name, difference in exported.differences.items():
        print(f"largest difference of {name}: {difference:.2g}")
    say(f"{exported.path.name}: {exported.bytes / 1e6:.1f} MB, filters: {exported.filter}")


def inspect_arguments() -> Arguments:
    """Return the arguments of `inspect`."""
    mesh = {"nargs": "?", "type": Path}
    return {
        "mesh": (mesh, None, f"{MESH}; else --data.kind and --data.root"),
        **mesh_arguments(),
        **data_arguments(required=False),
        **OUT,
        "--json": (bool, False, "print the summary as JSON"),
    }


def inspect(options: Namespace) -> None:
    """Describe and draw a mesh, or count, check and draw a set of images.

    Of a mesh: its size, materials, twelve views, and what may be wrong with it, each with the
    option that fixes it. Of a set, every label is checked and every image decoded, some 5 ms for
    640x480 pixels and one core. The first file that cannot be used is named, with the line that
    lists it.
    """
    from ffpose.datasets import Decoding
    from ffpose.datasets.inspection import inspect_folder

    expect_writable(options.out)
    data = options.data
    of_set = any(data[name] for name in ("kind", "root", "undistort", "white"))
    if of_set == (options.mesh is not None):
        raise ValueError("mesh: expected a mesh file, or --data.kind and --data.root")
    if options.mesh is not None:
        inspect_mesh(options)
        return
    expect_no_mesh(options)
    for name in ("kind", "root"):
        if data[name] is None:
            raise ValueError(f"--data.{name}: expected with a set of images")
    decoding = Decoding(data.undistort, data.white)
    summary = inspect_folder(data.kind, data.root, options.out, decoding)
    if options.json:
        show(summary)
        return
    for split, figures in summary["splits"].items():
        failed = sum(len(names) for names in figures["failed"].values())
        print(f"{split}: {figures['images']} images, {failed} failed checks of labels")
    for split, images in summary["unlabeled"].items():
        print(f"{split}: {images} images without labels")
    print(f"{len(summary['shared_images'])} images are in more than one split")


def inspect_mesh(options: Namespace) -> None:
    """Describe and draw a mesh."""
    from ffpose.render.inspection import inspect_mesh as run
    from ffpose.render.inspection import is_y_up

    y_up = is_y_up(options.mesh, options.mesh_up)
    summary = run(craft_of(options), options.out, y_up=y_up)
    if options.json:
        show(summary)
        return
    x, y, z = summary["size_m"]
    print(f"size: {x:.4g} x {y:.4g} x {z:.4g} m (x, y, z), {summary['triangles']} triangles")
    print(
        f"bounding sphere: radius {summary['radius_m']:.4g} m,"
        f" its middle {summary['origin_offset_m']:.3g} m from the origin"
    )
    for number, material in enumerate(summary["materials"]):
        color = " ".join(f"{value:.2f}" for value in material["color"])
        maps = ", ".join(material["textures"]) or "none"
        print(
            f"material {number}: {material['triangles']} triangles, color {color},"
            f" roughness {material['roughness']:.2f}, metal {material['metallic']:.2f},"
            + (f" alpha {material['alpha']:.2f}," if material["alpha"] < 1 else "")
            + f" textures: {maps}"
        )
    for kind, looks in (("same", "the same look"), ("near", "nearly the same look")):
        for each in (summary["symmetry"] or {}).get(kind, []):
            print(f"{looks}: {each['text']}")
    for doubt in summary["doubts"]:
        print(f"doubtful: {doubt}")
    say(str(options.out / "views.png"))


def card_arguments() -> Arguments:
    """Return the arguments of `card`."""
    from ffpose._internal.seeds import CHOICES

    weights = "weights file, a name such as soyuz, or an exported .onnx graph"
    scene = "scenes of the weights: a set such as soyuz_hard, or the scene.json of ffpose learn"
    seeds = f"seed of the scenes, {CHOICES.start} to {CHOICES.stop - 1}"
    final = "render the seed that is kept for published figures, in place of --seed"
    images = "folder that keeps the images, so that an interrupted card is continued"
    out = "folder for card.json and card.md; a card that is there is not measured again"
    return {
        "weights": (Path, ..., weights),
        "--scene": (str, ..., scene),
        "--count": (int, 500, "images per condition"),
        "--size": (size_type(), "640x480", "WIDTHxHEIGHT"),
        "--seed": (int, CHOICES.start, seeds),
        "--final": (bool, False, final),
        "--workers": (int, 1, "processes that render"),
        "--images": (Path, None, images),
        "--mitsuba": (bool, False, "measure on images of the second renderer too, which is slow"),
        "--out": (Path, None, out),
        **JSON,
    }


def card(options: Namespace) -> None:
    """Measure weights for their model card, and say which conditions their training had.

    Errors, coverage of the uncertainty, and how well images without the object are flagged. An
    image takes a third of a second of one core to render, half of them far less.
    """
    from ffpose._internal.seeds import CHOICES
    from ffpose.evaluation.card.measurement import measure
    from ffpose.evaluation.card.tables import format_card

    if options.final and options.seed != CHOICES.start:
        raise ValueError(f"seed: expected none with --final, got {options.seed}")
    for folder in filter(None, (options.images, options.out)):
        expect_writable(folder)
    document = measure(
        options.weights,
        options.scene,
        count=options.count,
        size=width_and_height(options.size),
        seed=options.seed,
        final=options.final,
        workers=options.workers,
        second_renderer=options.mitsuba,
        keep=options.images,
        out=options.out,
        progress=True,
    )
    if options.json:
        show(document)
    else:
        print(format_card(document), end="")


def calibrate_arguments() -> Arguments:
    """Return the arguments of `calibrate` but for those of `declare_fields`."""
    out = "file to write (default: the weights file; of weights by name there is none)"
    return {
        "weights": (Path, ..., "weights file, or a name such as soyuz"),
        "--out": (Path, None, out),
        "--json": (bool, False, "print what was found as JSON"),
    }


def calibrate(options: Namespace) -> None:
    """Calibrate distances, uncertainty and the flag of weights, and record it in their header.

    Its images must not have been used in training or validation; by default they are rendered
    scenes of seeds that are kept for calibration. `train` does the same at its end.
    """
    from ffpose.training.calibrate_weights import calibrate_weights
    from ffpose.training.config import CalibrationImages

    images = CalibrationImages(**vars(options.data))
    found = calibrate_weights(options.weights, images, out=options.out)
    values = {**found._asdict(), "variance_scales": found.variance_scales.tolist()}
    if options.json:
        show(values)
        return
    for name, value in values.items():
        if value is not None:  # found none: that of the weights stays
            print(f"{name}: {value}")


def bench_arguments() -> Arguments:
    """Return the arguments of `bench`."""
    from jsonargparse.typing import PositiveInt

    from ffpose.config import PRESETS

    network = f"with model: {', '.join(PRESETS)}, or weights (default: base; with --quick: tiny)"
    graphs = "graphs to measure in turns with a model, in ONNX Runtime: an older or an int8 one"
    numbers = {"nargs": "+", "type": PositiveInt}
    return {
        "subject": ({"choices": ["filter", "model"]}, ..., "what to measure"),
        "network": ({"nargs": "?"}, None, network),
        "--json": (bool, False, "print every timing as JSON"),
        "--plot": (Path, None, "picture to draw, PNG"),
        "--quick": (bool, False, "fewer and shorter measurements, under a minute"),
        "--batch": (numbers, None, "images per batch (default: 1 8)"),
        "--threads": (numbers, None, "numbers of threads (default: 1, 2, all cores)"),
        "--compare": ({"nargs": "+", "type": Path, "metavar": "GRAPH"}, None, graphs),
        **LOOKS,
    }


def bench(options: Namespace) -> None:
    """Measure the filter against torch.fft, or a network in torch, ONNX Runtime and OpenVINO."""
    if options.subject == "filter":
        for name in ("network", "batch", "threads", "compare", "looks", "candidates"):
            if options[name] is not None:
                raise ValueError(f"{name}: expected with model, got {options[name]} with filter")
        from ffpose.bench.filter import run

        run(options.json, options.plot, options.quick)
        return
    from ffpose.bench.model import run as run_model

    run_model(
        options.network or ("tiny" if options.quick else "base"),
        options.json,
        options.plot,
        options.quick,
        batches=options.batch,
        threads=options.threads,
        compare=options.compare or (),
        **inference_fields(options),
    )


INTERRUPTED, CLOSED = 130, 141
"""Exit codes of a program that a signal ends, 128 and its number: SIGINT's and SIGPIPE's."""

COMMANDS = {
    "demo": Command("predict poses of unseen images", demo_arguments, demo, "onnx,render"),
    "render": Command("render images with exact labels", render_arguments, render, "render"),
    "learn": Command(
        "train a network for your own mesh", learn_arguments, learn, "pose,render,export"
    ),
    "train": Command("train a network on images", train_arguments, train),
    "evaluate": Command("measure a model on labeled images", evaluate_arguments, evaluate),
    "predict": Command("print the pose seen in each image", predict_arguments, predict, "onnx"),
    "track": Command("track a spacecraft through a sequence", track_arguments, track),
    "export": Command("write a network as an ONNX graph", export_arguments, export, "export"),
    "calibrate": Command(
        "calibrate a network's uncertainty", calibrate_arguments, calibrate, "pose,render"
    ),
    "card": Command("measure weights for their model card", card_arguments, card, "pose,render"),
    "inspect": Command("check labeled images, or with [render] a mesh", inspect_arguments, inspect),
    "bench": Command("measure the filter, or the networks", bench_arguments, bench),
}


def overview() -> argparse.ArgumentParser:
    """Return the parser of the first argument, the command; it needs no extra."""
    import ffpose

    parser = argparse.ArgumentParser(
        prog="ffpose", description="Spectral filters, and satellite pose from one image."
    )
    parser.add_argument("--version", action="version", version=f"ffpose {ffpose.__version__}")
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", required=True)
    for name, command in COMMANDS.items():
        commands.add_parser(name, help=f"{command.summary} [{command.extra}]", add_help=False)
    commands.add_parser("info", help="versions, instruction set, threads, extras", add_help=False)
    parser.epilog = "Brackets name the extras that a command needs. Next: ffpose COMMAND --help"
    return parser


def plain_help(formatter: type[argparse.HelpFormatter]) -> type[argparse.HelpFormatter]:
    """Return a formatter that names paths as such, and no default that is nothing."""

    class Plain(formatter):  # type: ignore[misc, valid-type]  # known at run time, by the extra
        def _expand_help(self, action: argparse.Action) -> str:
            text = str(super()._expand_help(action)).replace("<class 'Path'>", "path")
            text = re.sub(r",? ?default: (null|False)\)$", ")", text)
            return text.removesuffix(" ()")

    return Plain


def build_parser(name: str) -> ArgumentParser:
    """Return the parser of one command's arguments; a MissingExtraError without its extra."""
    command = COMMANDS[name]
    jsonargparse = require("jsonargparse", command.extra)

    parser: ArgumentParser = jsonargparse.ArgumentParser(
        prog=f"ffpose {name}",
        description=command.run.__doc__,
        formatter_class=plain_help(jsonargparse.DefaultHelpFormatter),
        allow_abbrev=False,
        exit_on_error=False,  # wrong usage is reported in one line
        print_config="--print-config",
    )
    declare_fields(parser, name)
    declare(parser, command.arguments())
    parser.add_argument("--debug", action="store_true", help="show the traceback of an error")
    return parser


def declare_fields(parser: ArgumentParser, name: str) -> None:
    """Declare the fields of a configuration, which `train` and `calibrate` take."""
    if name == "train":
        from ffpose.training.options import add_fields

        add_fields(parser)
    elif name == "calibrate":
        from ffpose.training.config import CalibrationImages

        parser.add_class_arguments(CalibrationImages, "data")
        restyle(parser)


def words_of(name: str, words: Sequence[str]) -> list[str]:
    """Return the words of a command as its parser takes them; an ArgumentError if wrong."""
    if name in ("train", "calibrate"):
        from ffpose.training.options import expect_heeded, read_words

        found = read_words(words)
        expect_heeded(words)
        return found
    check_spelling(words)
    return list(words)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command.

    Args:
        arguments: The command line after ``ffpose``; None takes that of the process.

    Returns:
        The exit code: 0 done, 1 failed, 2 a value that cannot be, 130 interrupted, 141 nobody reads
        the results. Arguments that cannot be parsed raise SystemExit with code 2, and SIGTERM one
        with code 143.
    """
    words = list(sys.argv[1:] if arguments is None else arguments)
    if sys.stdout is None:  # the next file to be opened would have its number, and its text
        say("ffpose: expected an open standard output, got a closed one")
        return 1
    # Pillow's limit, of which `ffpose.imaging.images.open_image` makes an error of its own.
    warnings.filterwarnings("ignore", "Image size .* could be decompression bomb")
    if isinstance(sys.stdout, TextIOWrapper):  # of a code page, on Windows: "±" must not end a run
        sys.stdout.reconfigure(errors="backslashreplace")
    code = 0
    try:
        with exit_on_sigterm():
            code = run_command(words)
            sys.stdout.flush()
    except OSError as error:
        closed = is_closed_pipe(error)
        if not closed and "--debug" in words:
            raise
        if not closed and code == 0:  # as on a full disk; else it was said already
            say(f"ffpose: {explain(error)}")
        # What is left in the buffer finds no room either, and Python would say so as it leaves.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return CLOSED if closed else 1
    except KeyboardInterrupt:
        say("ffpose: interrupted; files already written are complete")
        return INTERRUPTED
    return code


def is_closed_pipe(error: Exception) -> bool:
    """Return whether nobody reads the results; Windows says that the argument is invalid."""
    if not isinstance(error, OSError):
        return False
    invalid = error.errno == errno.EINVAL and error.filename is None
    return isinstance(error, BrokenPipeError) or (sys.platform == "win32" and invalid)


def run_command(words: list[str]) -> int:
    """Run a command, and return its exit code, 0 to 2, as `main`."""
    if not words:
        overview().print_help(sys.stderr)
        raise SystemExit(2)
    name = overview().parse_args(words[:1]).command
    if name == "info":
        from ffpose._internal.info import main as info

        return info(words[1:])
    parser = None
    try:
        parser = build_parser(name)
        given = words_of(name, words[1:])
        if name == "predict":
            flags = {o for a in parser._actions if a.nargs == 0 for o in a.option_strings}
            given = positionals_first(given, flags)
        options = parser.instantiate(parser.parse_args(given))
        del options["debug"]
        COMMANDS[name].run(options)
    except argparse.ArgumentError as error:
        known = [] if parser is None else re.findall(r"--[\w.-]+", parser.format_usage())
        say(f"ffpose {name}: {advice(error.message, known)}; see ffpose {name} --help")
        raise SystemExit(2) from error
    except Exception as error:
        if "--debug" in words or is_closed_pipe(error):
            raise
        if isinstance(error, ModuleNotFoundError) and error.name:  # imported without `require`
            error = MissingExtraError.of(error.name.partition(".")[0], COMMANDS[name].extra)
        if parser is not None and is_usage(error, parser.format_usage()):
            say(f"ffpose {name}: {explain(error)}; see ffpose {name} --help")
            return 2
        say(f"ffpose: {explain(error)}")
    else:
        return 0
    return 1


if __name__ == "__main__":
    sys.exit(main())
