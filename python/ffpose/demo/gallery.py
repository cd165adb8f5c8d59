"""The demo without torch: rendered images, posed by the graph in the package, on one page."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import numpy as np

from ffpose._internal.figures import jpeg_tag
from ffpose._internal.files import write_json, write_text
from ffpose._internal.seeds import CHOICES
from ffpose.arrays import rotation_error, translation_error
from ffpose.geometry import Camera, Pose
from ffpose.imaging.images import read_rgb
from ffpose.imaging.overlay import TRUTH_COLORS, draw_axes
from ffpose.inference.load import load
from ffpose.render import find_scene, label, write_dataset
from ffpose.render.scene import ALL_ATTITUDES

SHIPPED, SCENE, SEED, SIZE = "soyuz", "soyuz_easy", CHOICES.start, (512, 384)
AXIS_M = 2.0

PAGE = """<!doctype html>
<html lang="en">
<meta charset="utf-8">
<title>From an image to a pose</title>
<style>
  body {{ margin: 2rem auto; max-width: 70rem; padding: 0 1rem;
         font: 16px/1.5 system-ui, sans-serif; }}
  div {{ display: grid; grid-template-columns: repeat(auto-fill, minmax(15rem, 1fr)); gap: .8rem; }}
  figure {{ margin: 0; }} img {{ width: 100%; border-radius: .4rem; }}
</style>
<h1>From an image to a pose</h1>
<p>{subtitle}</p>
<div>
{figures}
</div>
</html>
"""


def run(out: Path, images: int = 60) -> dict[str, Any]:
    """Render unseen images, predict their poses, and write ``report.html`` and ``report.json``.

    Images that are there, in ``images/``, are not rendered again.

    Returns:
        The contents of ``report.json``.

    Raises:
        MissingExtraError: The extra `onnx` or `render` is not installed.
        ValueError: ``out`` holds other images.
    """
    scene = find_scene(SCENE, ALL_ATTITUDES)
    folder = out / "images"
    write_dataset(scene, folder, images, SEED, size=SIZE, workers=2, progress=True)
    paths = [folder / f"{index}_rgb.png" for index in range(images)]
    estimate = load(SHIPPED, backend="onnxruntime")
    began = time.perf_counter()
    found = [estimate(path) for path in paths]
    seconds = (time.perf_counter() - began) / images
    truth = [label(scene, SEED, index) for index in range(images)]
    meters = translation_error(*(np.stack([pose.t for pose in each]) for each in (found, truth)))
    degrees = rotation_error(*(np.stack([pose.q for pose in each]) for each in (found, truth)))
    document = {
        "images": images,
        "median_translation_error_m": float(np.median(meters)),
        "median_rotation_error_deg": float(np.median(degrees)),
        "seconds_per_image": seconds,
    }
    assert estimate.camera is not None
    figures = [
        _figure(
            paths[n], found[n], truth[n], estimate.camera, f"{meters[n]:.2f} m, {degrees[n]:.1f}°"
        )
        for n in np.argsort(degrees).tolist()
    ]
    subtitle = (
        f"{images} rendered images of a Soyuz, none of which was trained on, each posed from the "
        f"image alone in {1e3 * seconds:.0f} ms, decoding included, by the graph that ships with "
        f"ffpose, without torch. Medians: {document['median_rotation_error_deg']:.1f}° and "
        f"{document['median_translation_error_m']:.2f} m. True axes are pale and wide, predicted "
        "ones thin; from the best attitude to the worst."
    )
    page = PAGE.format(subtitle=subtitle, figures="\n".join(figures))
    write_text(out / "report.html", page)
    write_json(out / "report.json", document)
    return document


def _figure(path: Path, found: Pose, truth: Pose, camera: Camera, caption: str) -> str:
    drawn = draw_axes(read_rgb(path), truth, camera, AXIS_M, TRUTH_COLORS, width=6)
    picture = jpeg_tag(draw_axes(drawn, found, camera, AXIS_M, width=2), f"{path.stem}: {caption}")
    return f"<figure>{picture}<figcaption>{caption}</figcaption></figure>"
