"""Which beams are free."""

import numpy as np
import pytest

from rotcal_design.settings import TracerDesignSettings
from rotcal_design.tracer.candidates import beams_cross_box, candidates, make_scene, target_lattice
from rotcal_ros.foundation.errors import ConfigurationError, PlanError


def pairs_of(**settings):
    wanted = TracerDesignSettings(**settings)
    scene = make_scene(wanted)
    lengths = candidates(scene, wanted)
    start, end = scene.stations[lengths.position], scene.targets[lengths.target]
    return scene, lengths, start, end - start


def test_lattice_fills_the_volume_and_keeps_its_distance():
    points = target_lattice(TracerDesignSettings(spacing_m=0.2))
    assert points.min(axis=0) == pytest.approx([-0.6, -0.5, 0.17])
    assert points.max(axis=0) == pytest.approx([0.6, 0.5, 1.02])
    apart = np.linalg.norm(points - points[:, None], axis=2) + 9.0 * np.eye(len(points))
    assert apart.min() >= 0.2 - 1e-12
    flat = target_lattice(TracerDesignSettings(volume_min_m=(0, 0, 1), volume_max_m=(1, 1, 1)))
    assert set(flat[:, 2]) == {1.0}


def test_distance_elevation_and_sectors():
    scene, lengths, _, apart = pairs_of(
        min_elevation_deg=20.0, max_elevation_deg=70.0, min_distance_m=0.4, max_distance_m=0.8,
        blocked_azimuth_deg=(170.0, -170.0), blocked_on_table_deg=(0.0, 30.0),
    )  # fmt: skip
    distance = np.linalg.norm(apart, axis=1)
    assert 0.4 <= distance.min() <= 0.45
    assert 0.75 <= distance.max() <= 0.8
    elevation = np.degrees(np.arctan2(apart[:, 2], np.hypot(apart[:, 0], apart[:, 1])))
    assert 20.0 <= elevation.min() <= 22.0
    assert 68.0 <= elevation.max() <= 70.0
    azimuth = np.degrees(np.arctan2(apart[:, 1], apart[:, 0]))
    assert np.abs(azimuth).max() <= 170.0
    turned = (azimuth - np.degrees(scene.table_angles[lengths.position])) % 360.0
    assert not ((turned > 0.0) & (turned < 30.0)).any()


def test_beams_through_a_box_against_points_along_them():
    rng = np.random.default_rng(2)
    start, end = rng.uniform(-1.0, 1.0, (2, 400, 3))
    end[:50, 0] = start[:50, 0]  # parallel to two sides
    box = np.array([[-0.3, -0.2, -0.4], [0.4, 0.5, 0.1]])
    along = start + np.linspace(0.0, 1.0, 4001)[:, None, None] * (end - start)
    expected = ((along >= box[0]) & (along <= box[1])).all(axis=2).any(axis=0)
    found = beams_cross_box(start, end - start, box)
    assert 60 < expected.sum() < 300
    assert (found != expected).sum() <= 1  # a corner between two points
    assert found[:50].tolist() == expected[:50].tolist()


def test_nothing_is_planned_in_or_behind_a_box():
    box = (0.2, -0.2, 0.0, 0.4, 0.2, 2.0)
    free, blocked = pairs_of(), pairs_of(keep_out_m=box, margin_m=0.05)
    assert len(blocked[0].targets) < len(free[0].targets)
    inside = blocked[0].targets - [0.3, 0.0, 1.0]
    assert (np.abs(inside) >= np.array([0.15, 0.25, 1.05]) - 1e-12).any(axis=1).all()
    _, _, start, apart = blocked
    behind = (start + apart)[:, 0] > 0.45
    crossing = start + apart * ((0.3 - start[:, 0]) / apart[:, 0])[:, None]
    assert (np.abs(crossing[behind, 1]) > 0.2).all()


def test_the_reflector_accepts_beams_within_its_angle():
    _, _, _, apart = pairs_of(reflector_faces="direction", reflector_acceptance_deg=30.0)
    steepness = apart[:, 2] / np.linalg.norm(apart, axis=1)  # it looks down
    assert np.cos(np.radians(30.0)) <= steepness.min() < 0.9
    _, _, start, apart = pairs_of(reflector_faces="axis", reflector_acceptance_deg=5.0)
    facing = [0.0, 0.0, 0.1225] - (start + apart)
    cosine = -(facing * apart).sum(axis=1)
    cosine /= np.linalg.norm(facing, axis=1) * np.linalg.norm(apart, axis=1)
    assert np.degrees(np.arccos(cosine.min())) <= 5.0 + 1e-9


def test_a_blocked_station_is_named():
    with pytest.raises(PlanError, match="station 0 at 0 deg has fewer than 4"):
        pairs_of(blocked_on_table_deg=(0.0, 359.9))
    with pytest.raises(PlanError, match="no target is left"):
        pairs_of(keep_out_m=(-2.0, -2.0, -2.0, 2.0, 2.0, 2.0))
    with pytest.raises(ConfigurationError, match="keep_out_m has 5 numbers, expected 6"):
        TracerDesignSettings(keep_out_m=(0.0,) * 5)
