"""Conditions say what the pictures show: against the Earth's shader, and what render was given."""

import csv
import json
import math
from dataclasses import replace

import numpy as np
import pytest

from earth import Earth
from ffpose.datasets import read_conditions
from ffpose.render import SCENES, Randomization, label, render, renderer, write_dataset
from ffpose.render.dataset.tables import conditions_of
from ffpose.render.renderer import situation

SIZE = (64, 48)
INDICES = range(40)


def test_the_situation_is_the_one_that_is_rendered(monkeypatch):
    seen = []

    def record(pose, around, *rest):
        seen.append((pose, around))
        return light(pose, around, *rest)

    light = renderer.object_light
    monkeypatch.setattr(renderer, "object_light", record)
    for index in range(3):
        render("soyuz_easy", 4, index, SIZE)
        pose, around, backdrop = situation("soyuz_easy", 4, index)
        assert not backdrop
        np.testing.assert_array_equal(pose.vector, seen[-1][0].vector)
        for ours, drawn in zip(around, seen[-1][1], strict=True):
            np.testing.assert_array_equal(ours, drawn)


def test_earth_is_behind_where_its_shader_hides_the_stars():
    found = []
    for index in INDICES:
        pose, around, _ = situation("soyuz_hard", 2, index)
        ray = (pose.t / np.linalg.norm(pose.t)).astype(np.float32)[:, None]
        earth = Earth(around.nadir, around.altitude, around.sun, around.ground)
        hidden = earth.shade(ray, pixel_angle=1e-6)[1][0] == 0
        assert conditions_of("soyuz_hard", 2, index).earth_behind == hidden
        found.append(hidden)
    assert 5 < sum(found) < 35


def test_sun_angle_is_that_of_the_light():
    lit = []
    for index in INDICES:
        pose, around, _ = situation("soyuz_easy", 2, index)
        found = conditions_of("soyuz_easy", 2, index)
        cosine = around.sun @ pose.t / np.linalg.norm(pose.t)
        assert math.cos(math.radians(found.sun_angle_deg)) == pytest.approx(cosine)
        assert found.eclipsed == around.eclipsed
        assert found.distance_m == pytest.approx(np.linalg.norm(label("soyuz_easy", 2, index).t))
        lit.append(found.sun_angle_deg < 90)
    assert 5 < sum(lit) < 35


def test_a_wall_of_clouds_is_not_the_earth(monkeypatch):
    scene = replace(SCENES["soyuz_easy"], randomization=Randomization(background=0.5))
    walls, backdrop = [], renderer.backdrop
    monkeypatch.setattr(
        renderer, "backdrop", lambda *given: walls.append(index) or backdrop(*given)
    )
    for index in range(10):
        render(scene, 6, index, (16, 16))
    assert 0 < len(walls) < 10
    assert walls == [index for index in range(10) if situation(scene, 6, index).backdrop]
    plain = [conditions_of("soyuz_easy", 6, index).earth_behind for index in range(10)]
    found = [conditions_of(scene, 6, index).earth_behind for index in range(10)]
    assert found == [earth and index not in walls for index, earth in enumerate(plain)]
    assert found != plain


def test_visible_share_is_the_part_of_the_vertices_in_the_frame():
    scene = replace(SCENES["soyuz_easy"], min_visible=0.3)
    shares = []
    for index in INDICES:
        u, v = label(scene, 8, index).project(scene.build().mesh.vertices, scene.camera).T
        inside = (u >= 0) & (u <= 1280) & (v >= 0) & (v <= 960)
        shares.append(conditions_of(scene, 8, index).visible_share)
        assert shares[-1] == pytest.approx(inside.mean(), abs=0.12)
    assert min(shares) < 0.8
    assert max(shares) == 1


def test_a_set_holds_the_conditions_of_its_images(tmp_path):
    write_dataset("soyuz_easy", tmp_path, 3, seed=7, start=4, size=SIZE)
    with (tmp_path / "conditions.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [row["image"] for row in rows] == ["4_rgb.png", "5_rgb.png", "6_rgb.png"]
    for index, row in enumerate(rows, start=4):
        expected = conditions_of("soyuz_easy", 7, index)
        assert tuple(float(row[name]) for name in expected._fields) == expected
    found = read_conditions(tmp_path, ["6_rgb.png"])
    assert found.sun_angle_deg[0] == conditions_of("soyuz_easy", 7, 6).sun_angle_deg


def test_a_set_of_an_older_version_is_carried_on(tmp_path):
    write_dataset("soyuz_easy", tmp_path, 3, seed=7, size=SIZE)
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    (tmp_path / "conditions.csv").unlink()
    manifest = json.loads(before["manifest.json"])
    del manifest["files"]["conditions.csv"]
    (tmp_path / "manifest.json").write_text(json.dumps(manifest))
    done = write_dataset("soyuz_easy", tmp_path, 3, seed=7, size=SIZE)
    assert (done.rendered, done.kept) == (0, 3)
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before
