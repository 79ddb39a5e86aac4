"""Points of a laser tracker: kind, station and target must be those of the plan."""

from __future__ import annotations

from dataclasses import replace
from itertools import permutations

import pytest
from capture_scenes import make_plan, make_scene, replay

from rotcal_ros.observations import PointKind
from rotcal_ros.planning.plan import Plan

KINDS = (PointKind.DIRECT, PointKind.MIRRORED, PointKind.NEST)


def tracker_plan(kind: PointKind) -> Plan:
    plan = make_plan(kind)
    return replace(plan, steps=tuple(replace(step, station=2) for step in plan.steps))


def scene_of(plan: Plan):
    scene = make_scene(plan, 1)
    scene.probe = [replace(sample, station=2) for sample in scene.probe]
    return scene


@pytest.mark.parametrize("kind", KINDS)
def test_the_station_goes_into_the_observation(kind):
    plan = tracker_plan(kind)
    (observation,) = replay(plan, scene_of(plan).by_stamp())
    assert observation.accepted, observation.reason
    assert (observation.kind, observation.station) == (kind, 2)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("order", list(permutations(range(4))))
def test_the_order_of_arrival_does_not_matter(kind, order):
    plan = tracker_plan(kind)
    scene = scene_of(plan)
    expected = replay(plan, scene.by_stamp())
    streams = scene.streams()
    assert replay(plan, [r for number in order for r in streams[number]]) == expected


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"station": 1}, "probe reports station 1, the plan says station 2"),
        ({"kind": PointKind.MIRRORED}, "probe reports MIRRORED at target 0, the plan says DIRECT"),
        ({"target": 5}, "probe reports DIRECT at target 5, the plan says DIRECT at target 0"),
        ({"position": (float("nan"), 0.0, 0.0)}, "probe position is not finite"),
    ],
)
def test_a_point_that_is_not_the_planned_one_is_rejected(changes, reason):
    plan = tracker_plan(PointKind.DIRECT)
    scene = scene_of(plan)
    scene.probe = [replace(scene.probe[0], **changes)]
    (observation,) = replay(plan, scene.by_stamp())
    assert not observation.accepted
    assert observation.reason.startswith(reason)
