"""The sets' distributions are those that the paper's section 4.1 states."""

import math
from dataclasses import replace

import numpy as np
import pytest

from ffpose.geometry import DistortedCamera, rotation_matrix
from ffpose.render import SCENES, Scene, find_scene, label
from ffpose.render.sampler import meets_earth, sample_surroundings
from ffpose.render.spacecraft.decoys import build_decoy


def angles(pose):
    """Roll, pitch, yaw in degrees from the matrix Rz(yaw) Ry(pitch) Rx(roll)."""
    r = rotation_matrix(pose.q)
    return np.degrees(
        [math.atan2(r[2, 1], r[2, 2]), -math.asin(r[2, 0]), math.atan2(r[1, 0], r[0, 0])]
    )


@pytest.mark.parametrize(
    ("name", "far", "lateral"),
    [("soyuz_easy", 22, 12), ("soyuz_hard", 42, 22), ("dragon_hard", 42, 22)],
)
def test_poses_fill_the_stated_ranges_and_stay_in_them(name, far, lateral):
    poses = [label(name, 11, index) for index in range(250)]
    t = np.array([pose.t for pose in poses])
    distance = np.linalg.norm(t, axis=1)
    assert distance.min() >= 8
    assert distance.max() <= far
    assert np.histogram(distance, 4, (8, far))[0].min() > 30
    assert np.hypot(t[:, 0], t[:, 1]).max() <= lateral
    roll, pitch, yaw = np.array([angles(pose) for pose in poses]).T
    assert np.abs(pitch).max() <= 60
    assert pitch.min() < -50
    assert pitch.max() > 50
    for angle in (roll, yaw):
        assert np.histogram(angle, 6, (-180, 180))[0].min() > 20


def test_target_is_mostly_in_frame():
    scene = SCENES["soyuz_easy"]
    for index in range(50):
        pose = label(scene, 4, index)
        u, v = pose.project(scene.build().mesh.vertices, scene.camera).T
        inside = (u >= 0) & (u <= 1280) & (v >= 0) & (v <= 960)
        assert inside.mean() > 0.8


def test_narrow_attitudes_are_kept():
    scene = replace(SCENES["soyuz_easy"], attitude_range_deg=(30, 20, 10))
    found = np.abs([angles(label(scene, 0, index)) for index in range(100)])
    assert (found.max(axis=0) <= (30, 20, 10)).all()
    assert (found.max(axis=0) > (25, 15, 8)).all()


@pytest.mark.parametrize("rate", [0.0, 0.5, 1.0])
def test_eclipse_comes_at_the_stated_rate(rate):
    scene = replace(SCENES["soyuz_easy"], eclipse_rate=rate)
    rng = np.random.default_rng(0)
    around = [sample_surroundings(scene, rng) for _ in range(200)]
    assert abs(np.mean([a.eclipsed for a in around]) - rate) <= 0.1
    for a in around:
        assert a.eclipsed == meets_earth(a.sun, a.nadir, a.altitude)


def test_at_dusk_the_sun_is_seen_from_the_orbit_and_low_for_the_ground_below():
    scene = SCENES["soyuz_hard"]
    rng = np.random.default_rng(0)
    around = [sample_surroundings(scene.at_dusk(), rng) for _ in range(200)]
    heights = np.degrees([np.arcsin(-a.sun @ a.nadir) for a in around])
    assert not any(meets_earth(a.sun, a.nadir, a.altitude) for a in around)
    assert heights.max() <= 3  # the horizon is 20 degrees below that of the ground
    assert -21 < heights.min() < -18
    assert heights.max() > 2
    for index in range(5):
        one, other = label(scene, 7, index), label(scene.at_dusk(), 7, index)
        np.testing.assert_array_equal(one.vector, other.vector)


def test_sets_keep_their_parameters_but_at_dusk():
    scene = SCENES["soyuz_hard"]
    assert "dusk" not in scene.parameters()
    assert scene.at_dusk().parameters() == scene.parameters() | {"eclipse_rate": 0.0, "dusk": True}


def test_shadow_is_a_matter_of_the_horizon():
    nadir = np.array([0.0, 0.0, 1.0])
    altitude = 0.0628  # 400 km: the horizon lies asin(1/1.0628) = 70.2° from nadir
    for degrees, dark in ((0, True), (69, True), (71, False), (180, False)):
        sun = np.array([np.sin(np.radians(degrees)), 0, np.cos(np.radians(degrees))])
        assert meets_earth(sun, nadir, altitude) is dark


@pytest.mark.parametrize(
    "wrong",
    [
        {"distance_m": (0.0, 5.0)},
        {"distance_m": (9.0, 8.0)},
        {"distance_m": (9.0, math.inf)},
        {"lateral_m": -1.0},
        {"attitude_range_deg": (180.0, 100.0, 180.0)},
        {"min_visible": 1.5},
        {"max_visible": 0.8},  # less than the least
        {"eclipse_rate": -0.1},
        {"lamp": math.nan},
        {"camera": DistortedCamera(64, 48, 60, 60, 32, 24, (0.1, 0, 0, 0, 0))},  # no pinhole
    ],
)
def test_absurd_ranges_are_refused(wrong):
    fields = {"name": "x", "craft": "soyuz", "distance_m": (8.0, 9.0), "lateral_m": 5.0} | wrong
    with pytest.raises(ValueError, match=next(iter(wrong))):
        Scene(**fields)


def test_contradicting_ranges_are_one_error():
    scene = Scene("x", "soyuz", (2.0, 2.5), 0.1, min_visible=1.0)
    with pytest.raises(ValueError, match="found no pose"):
        label(scene, 0, 0)


def eclipse_share_of_a_year():
    """Mean over the year of the part of a circular orbit at 410 km, 51.6 degrees, without sun."""
    rng = np.random.default_rng(0)
    season, node = rng.uniform(0, 2 * np.pi, (2, 100_000))
    tilt, inclination = np.radians([23.44, 51.6])
    sun = [np.cos(season), np.sin(season) * np.cos(tilt), np.sin(season) * np.sin(tilt)]
    normal = np.array([np.sin(inclination) * np.sin(node), -np.sin(inclination) * np.cos(node)])
    out_of_plane = (np.array(sun[:2]) * normal).sum(axis=0) + sun[2] * np.cos(inclination)
    shadow = np.sqrt(1 - (6371 / (6371 + 410)) ** 2) / np.sqrt(1 - out_of_plane**2)
    return np.where(shadow < 1, np.arccos(np.minimum(shadow, 1)) / np.pi, 0).mean()


@pytest.mark.parametrize("name", SCENES)
def test_sets_are_eclipsed_and_backlit_as_often_as_an_orbit(name):
    rng = np.random.default_rng(1)
    drawn = [sample_surroundings(SCENES[name], rng) for _ in range(4000)]
    eclipsed = np.array([around.eclipsed for around in drawn])
    # Three standard deviations of a share of a third among 4000.
    assert abs(eclipsed.mean() - eclipse_share_of_a_year()) < 0.0225
    sun = np.array([around.sun for around in drawn])[~eclipsed]
    assert abs((sun[:, 2] > 0).mean() - 0.5) < 0.03


@pytest.mark.parametrize("radius", [0.06, 5.0, 60.0])
def test_in_the_place_of_a_spacecraft_of_a_file_are_others_of_its_size(radius):
    """As spacecraft of a file may be, from a picosatellite to a station."""
    soyuz = find_scene("soyuz_easy").build()
    craft = soyuz.scaled(radius / soyuz.radius)
    scene = Scene("own", craft, (2.1 * radius, 22.4 * radius), 16 * radius)
    for index in range(10):
        for stranger in (build_decoy(0, index), "dragon"):
            other = scene.with_stranger(stranger)
            assert 0.2 * radius < other.build().radius < 3 * radius
            label(other, 0, index)
    distances = [np.linalg.norm(label(scene, 0, index).t) for index in range(60)]
    assert min(distances) < 5 * radius


def test_those_that_come_with_ffpose_are_replaced_by_others_as_they_are():
    decoy = build_decoy(0, 3)
    assert find_scene("soyuz_easy").with_stranger(decoy).build() is decoy
    assert (
        find_scene("soyuz_easy").with_stranger("dragon").build()
        is find_scene("dragon_hard").build()
    )
