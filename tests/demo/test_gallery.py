"""The demo where torch is not installed."""

import json
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import ffpose
from ffpose import cli
from ffpose.demo import gallery
from ffpose.render import find_scene, label

pytest.importorskip("onnxruntime")

WITHOUT_TORCH = """
import sys
for name in ("torch", "torchvision", "torchmetrics", "timm", "safetensors", "matplotlib"):
    sys.modules[name] = None
from pathlib import Path
from ffpose.demo.gallery import run
run(Path(sys.argv[1]), images=3)
"""


@pytest.mark.slow
def test_images_are_posed_and_shown_without_torch(tmp_path):
    command = [sys.executable, "-c", WITHOUT_TORCH, str(tmp_path)]
    subprocess.run(command, capture_output=True, check=True)
    document = json.loads((tmp_path / "report.json").read_text())
    estimate = ffpose.load("soyuz", backend="onnxruntime")
    found = [estimate(tmp_path / f"images/{n}_rgb.png") for n in range(3)]
    scene = replace(find_scene(gallery.SCENE), attitude_range_deg=gallery.ALL_ATTITUDES)
    truth = [label(scene, gallery.SEED, n) for n in range(3)]
    meters = [np.linalg.norm(a.t - b.t) for a, b in zip(found, truth, strict=True)]
    degrees = [
        2 * np.degrees(np.arccos(min(1, abs(a.q @ b.q)))) for a, b in zip(found, truth, strict=True)
    ]
    assert document["images"] == 3
    assert document["median_translation_error_m"] == pytest.approx(np.median(meters), abs=1e-4)
    assert document["median_rotation_error_deg"] == pytest.approx(np.median(degrees), abs=1e-2)
    page = (tmp_path / "report.html").read_text()
    shown = [float(value) for value in re.findall(r"<figcaption>[\d.]+ m, ([\d.]+)°", page)]
    np.testing.assert_allclose(shown, np.sort(degrees), atol=0.06)
    assert page.count('<img src="data:image/jpeg;base64,') == 3


def test_the_command_shows_a_gallery_where_torch_is_not(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(cli, "find_spec", lambda name: None)
    errors = {"median_translation_error_m": 0.25, "median_rotation_error_deg": 2.0}
    asked = []
    monkeypatch.setattr(gallery, "run", lambda out: asked.append(out) or errors)
    assert cli.main(["demo", "--out", str(tmp_path)]) == 0
    assert asked == [Path(tmp_path)]
    assert capsys.readouterr().out.splitlines() == [
        *("median_translation_error_m: 0.250", "median_rotation_error_deg: 2.000"),
        str(tmp_path / "report.html"),
    ]
