"""Whichever stream comes last: the decision comes with the very record that makes it possible."""

from dataclasses import replace

import pytest
from capture_scenes import MS, RULES, SETTINGS, make_plan, make_scene, probe_sample, table_off

from rotcal_ros.capture import Capture
from rotcal_ros.foundation.observations import LengthStatus, PointKind

PLAN = make_plan()


def decided_at(scene, last, settings=SETTINGS, plan=PLAN):
    """Feed all other streams, then ``last``; return stamp and reason of the first decision."""
    capture = Capture(plan, settings, RULES)
    for name in ("probe", "temperature", "table", "tracer"):
        if name != last:
            for record in getattr(scene, name):
                assert capture.feed(record) == ()
    for record in getattr(scene, last):
        if found := capture.feed(record):
            return record.stamp_ns, found[0].reason
    return None, ""


@pytest.mark.parametrize(
    ("last", "stamp_ns"),
    [("tracer", 220 * MS), ("table", 220 * MS + 1), ("temperature", 200 * MS)],
)
def test_a_good_window(last, stamp_ns):
    """Readings of 201 .. 220 ms, feedback every 10 ms and 1 ns, temperatures every 100 ms.

    The first observation takes the temperature after the probe came at 150 ms.
    """
    assert decided_at(make_scene(PLAN, 1), last) == (stamp_ns, "")


def test_a_bad_window_is_decided_as_soon():
    scene = make_scene(PLAN, 1)
    scene.edit("tracer", lambda r: replace(r, status=LengthStatus.BEAM_BROKEN), 0, 900 * MS)
    stamp_ns, reason = decided_at(scene, "tracer")
    assert stamp_ns == 220 * MS
    assert reason.startswith("only 0 of 20 readings usable")


def test_too_few_readings_wait_for_the_deadline_and_no_longer():
    """Nine readings before a gap and six after it, up to the deadline at 750 ms."""
    scene = make_scene(PLAN, 1)
    scene.edit("tracer", lambda _: None, 210 * MS, 745 * MS)
    stamp_ns, reason = decided_at(scene, "tracer")
    assert stamp_ns == 750 * MS
    assert reason.startswith("only 15 of 20 tracer readings")


def test_a_table_that_never_arrives_is_decided_at_the_deadline():
    scene = make_scene(PLAN, 1)
    scene.edit("table", table_off(50.0), 0, 900 * MS)
    stamp_ns, reason = decided_at(scene, "table")
    assert stamp_ns == 750 * MS + 1
    assert reason.startswith("table not at rest in position")


def test_a_table_that_leaves_is_waited_for_once_more():
    """Off at 220 ms, at rest again at 230 ms: the window is 281 .. 300 ms."""
    scene = make_scene(PLAN, 1)
    scene.edit("table", table_off(25.0), 215 * MS, 225 * MS)
    assert decided_at(scene, "table") == (300 * MS + 1, "")
    assert decided_at(scene, "tracer") == (300 * MS, "")


POINTS = make_plan(PointKind.NEST, n_points=2)


def test_points_are_decided_with_the_feedback_past_the_last_one():
    scene = make_scene(POINTS, 1)
    scene.probe.append(probe_sample(POINTS.steps[0], 400 * MS, point=1))
    assert decided_at(scene, "table", plan=POINTS) == (400 * MS + 1, "")
    assert decided_at(scene, "probe", plan=POINTS) == (400 * MS, "")


def test_points_that_are_missing_may_come_late_by_the_tolerance():
    """The deadline is at 750 ms, and 0.2 s later nobody waits any longer."""
    scene = make_scene(POINTS, 1)
    scene.tracer = []  # it would be ahead
    settings = replace(SETTINGS, clock_tolerance_s=0.2)
    stamp_ns, reason = decided_at(scene, "table", settings, POINTS)
    assert stamp_ns == 950 * MS + 1
    assert reason == "only 1 of 2 probe points within 0.6 s"


def test_points_that_are_missing_are_given_up_with_the_next_attempt():
    scene = make_scene(POINTS, 1)
    scene.probe.append(probe_sample(POINTS.steps[0], 300 * MS, attempt=1))
    stamp_ns, reason = decided_at(scene, "probe", plan=POINTS)
    assert stamp_ns == 300 * MS
    assert reason == "only 1 of 2 probe points within 0.15 s"
