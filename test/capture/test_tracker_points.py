"""Points of a laser tracker: kind, station and target must be those of the plan."""

from __future__ import annotations

from dataclasses import replace
from itertools import permutations

import pytest
from capture_scenes import make_plan, make_scene, replay

from rotcal_ros.foundation.observations import PointKind
from rotcal_ros.methods.plane_mirror.method import TrackerCheck
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


@pytest.mark.slow
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


def observed(kind, mean, target=1, **changes):
    plan = tracker_plan(kind)
    (observation,) = replay(plan, scene_of(plan).by_stamp())
    return replace(observation, mean=mean, target=target, **changes)


def checked(*observations):
    check = TrackerCheck()
    return [check(observation).reason for observation in observations]


def test_an_image_is_farther_than_its_reflector():
    near, far = (1.0, 0.5, 0.0), (2.5, 0.1, 0.1)
    direct, mirrored = PointKind.DIRECT, PointKind.MIRRORED
    assert checked(observed(direct, near), observed(mirrored, far)) == ["", ""]
    _, exchanged = checked(observed(direct, far), observed(mirrored, near))
    assert exchanged.startswith("the mirrored point is 1.1180 m away, the direct one 2.5040 m")
    assert exchanged.endswith("direct and mirrored exchanged")
    _, twice = checked(observed(direct, far), observed(mirrored, (2.5, 0.1, 0.1002)))
    assert twice.startswith("the mirrored point is 0.200 mm from the direct one")
    # Another reflector, another station: nothing to compare with.
    assert checked(observed(direct, far), observed(mirrored, near, target=2)) == ["", ""]
    assert checked(observed(direct, far), observed(mirrored, near, station=1)) == ["", ""]


def test_two_nests_are_never_in_one_place():
    nest, here, there = PointKind.NEST, (1.0, 0.5, 0.0), (1.0, 0.5, 0.4)
    reasons = checked(
        observed(nest, here),
        observed(nest, here, target=2),
        observed(nest, there, target=2),
        observed(nest, (1.001, 0.5, 0.0)),  # measured again: replaces the first
        observed(nest, here, target=2, station=1),
    )
    assert reasons[1] == (
        "nest 2 is 0.000 mm from where nest 1 was measured: reflector on the wrong nest"
    )
    assert [reasons[i] for i in (0, 2, 3, 4)] == [""] * 4
