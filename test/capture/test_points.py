"""Steps that only the probe measures."""

from dataclasses import replace
from itertools import permutations

import numpy as np
import pytest
from capture_scenes import MS, SETTINGS, make_plan, make_scene, probe_sample, replay, table_off

from rotcal_ros.capture import Capture, CaptureRules
from rotcal_ros.capture.decisions import decide_by_points
from rotcal_ros.capture.window import ReducedWindow
from rotcal_ros.foundation.observations import PointKind

KINDS = [PointKind.CENTRE, PointKind.DIRECT, PointKind.MIRRORED, PointKind.NEST]


@pytest.mark.parametrize("kind", KINDS)
def test_one_point_is_its_own_mean(kind):
    plan = make_plan(kind)
    (observation,) = replay(plan, make_scene(plan, 1).by_stamp())
    assert observation.accepted, observation.reason
    assert observation.mean == plan.steps[0].position
    assert observation.std == (1e-6, 2e-6, 3e-6)
    assert (observation.n_samples, observation.n_used, observation.kind) == (1, 1, kind)
    assert observation.table_angle_measured == 0.0


def scene_of_points(plan, n=4):
    scene = make_scene(plan, 1)
    rng = np.random.default_rng(3)
    offsets = 1e-6 * rng.standard_normal((n, 3))
    scene.probe = []
    for point in range(n):
        sample = probe_sample(plan.steps[0], (150 + 20 * point) * MS, point=point)
        position = tuple(np.array(plan.steps[0].position) + offsets[point])
        scene.probe.append(replace(sample, position=position))
    return scene, np.array(plan.steps[0].position) + offsets


def test_repeated_points_give_mean_and_deviation():
    plan = make_plan(PointKind.CENTRE, n_points=4)
    scene, positions = scene_of_points(plan)
    (observation,) = replay(plan, scene.by_stamp())
    assert observation.accepted
    assert observation.mean == pytest.approx(positions.mean(axis=0), abs=1e-15)
    scatter = positions.std(axis=0, ddof=1)
    assert observation.scatter == pytest.approx(scatter, rel=1e-9)
    assert observation.std == pytest.approx(scatter / 2, rel=1e-9)
    assert observation.n_used == 4


@pytest.mark.parametrize("order", list(permutations(range(4))))
def test_points_do_not_depend_on_the_order_of_arrival(order):
    plan = make_plan(PointKind.CENTRE, n_points=4)
    scene, _ = scene_of_points(plan)
    expected = replay(plan, scene.by_stamp())
    streams = scene.streams()
    assert replay(plan, [r for number in order for r in streams[number]]) == expected


def test_missing_points_are_rejected_after_the_deadline():
    plan = make_plan(PointKind.CENTRE, n_points=5)
    scene, _ = scene_of_points(plan, n=4)
    settings = replace(SETTINGS, clock_tolerance_s=0.2)
    (observation,) = replay(plan, scene.by_stamp(), settings)
    assert observation.reason == "only 4 of 5 probe points within 0.6 s"


def test_table_off_at_a_point_is_rejected():
    plan = make_plan(PointKind.CENTRE, n_points=4)
    scene, _ = scene_of_points(plan)
    scene.edit("table", table_off(30.0), 175 * MS, 185 * MS)
    (observation,) = replay(plan, scene.by_stamp())
    assert not observation.accepted
    assert observation.reason == (
        "table not at rest in position during the probe points: up to 30 arcsec off (allowed 20)"
    )


def test_a_method_brings_its_own_way_to_make_one_value():
    """Rules of a method with nothing but a reducer: it gets samples, step and settings."""
    plan = make_plan(PointKind.CENTRE, n_points=4)
    scene, _ = scene_of_points(plan)
    seen = []

    def last(samples, step, settings):
        seen.append((len(samples), step, settings))
        return ReducedWindow(mean=samples[-1].position, n_used=1, reason="for once")

    capture = Capture(plan, SETTINGS, CaptureRules({PointKind.CENTRE: decide_by_points(last)}))
    (found,) = [o for record in scene.by_stamp() for o in capture.feed(record)]
    assert seen == [(4, plan.steps[0], SETTINGS)]
    assert found.mean == scene.probe[-1].position
    assert (found.accepted, found.reason, found.n_samples) == (False, "for once", 4)
