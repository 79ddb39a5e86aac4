"""Feedback that can never be in position says what is wrong with it: no velocity, degrees."""

from dataclasses import replace
from math import degrees, nan, pi

import pytest
from capture_scenes import RULES, SECOND, SETTINGS, make_plan, make_scene, replay

from rotcal_ros.capture import Capture
from rotcal_ros.planning.table_feedback import looks_like_degrees

PLAN = make_plan()
ANGLE = 0.5  # of step 1, rad


def at_step_1(change):
    """Return the streams of the first two steps with all feedback changed."""
    scene = make_scene(PLAN, 2)
    scene.edit("table", change, -SECOND, 2 * SECOND)
    return scene.by_stamp()


def test_feedback_without_velocity_is_named():
    first, second = replay(PLAN, at_step_1(lambda r: replace(r, velocity=nan)))
    for observation in (first, second):
        assert not observation.accepted
        assert "the feedback has no velocity: publish it beside the position" in observation.reason


def test_a_velocity_that_a_driver_withholds_is_not_called_missing():
    """As table_adapter does until its joint has begun to obey."""
    scene = make_scene(PLAN, 2)
    scene.edit("table", lambda r: replace(r, velocity=nan), SECOND, 2 * SECOND)
    first, second = replay(PLAN, scene.by_stamp())
    assert first.accepted
    assert "the ordered motion has not begun" in second.reason
    assert "no velocity" not in second.reason


def test_degrees_are_named():
    first, second = replay(PLAN, at_step_1(lambda r: replace(r, angle=degrees(r.angle))))
    assert first.accepted  # zero is zero in any unit
    assert "it says 28.6479 where 0.5 rad = 28.6479 deg was commanded: degrees?" in second.reason


@pytest.mark.parametrize("turns", [-2, 0, 1])
def test_degrees_count_full_turns_too(turns):
    assert looks_like_degrees(degrees(ANGLE) + 360.0 * turns, ANGLE)
    assert not looks_like_degrees(ANGLE, ANGLE)
    assert not looks_like_degrees(degrees(ANGLE) + 1.0, ANGLE)


def test_a_table_that_is_not_in_position_is_told_long_before_the_attempt_is_given_up():
    patient = replace(SETTINGS, step_timeout_s=30.0)
    capture = Capture(PLAN, patient, RULES)
    scene = make_scene(PLAN, 6)
    scene.probe = scene.probe[:2]  # nothing follows step 1
    at_rest = {"angle": degrees(ANGLE), "velocity": 0.0}
    scene.edit("table", lambda r: replace(r, **at_rest), SECOND, 7 * SECOND)
    said, hopeless = {}, {}
    for record in scene.by_stamp():
        capture.feed(record)
        said[record.stamp_ns // SECOND] = capture.current_fault()
        hopeless[record.stamp_ns // SECOND] = capture.why_unmeasurable()
    assert said[3] is None
    assert "table position 1, target 0: table not at rest in position" in said[5]
    assert "degrees?" in said[5]
    assert hopeless[1] is None
    assert hopeless[3].startswith("table position 1, target 0: it says 28.6479 where 0.5 rad")


@pytest.mark.parametrize(
    ("feedback", "since_ns", "words"),
    [
        ({"angle": degrees(ANGLE), "velocity": 0.0}, SECOND, "degrees?"),
        ({"angle": ANGLE, "velocity": nan}, -SECOND, "no velocity"),
        ({"angle": ANGLE, "velocity": nan}, SECOND, None),
        ({"angle": ANGLE * pi / 180.0, "velocity": 0.0}, SECOND, "radians, not degrees"),
        ({"angle": ANGLE, "velocity": 0.0}, SECOND, None),
        ({"angle": 2.0, "velocity": 0.0}, SECOND, None),
    ],
)
def test_only_what_no_patience_mends_is_hopeless(feedback, since_ns, words):
    """A table that stands elsewhere may still come; one that is reported wrongly never does.

    One that had a velocity before has not begun to obey its order, as table_adapter says.
    """
    capture = Capture(PLAN, replace(SETTINGS, step_timeout_s=30.0), RULES)
    scene = make_scene(PLAN, 6)
    scene.probe = scene.probe[:2]
    scene.edit("table", lambda r: replace(r, **feedback), since_ns, 7 * SECOND)
    for record in scene.by_stamp():
        capture.feed(record)
    hopeless = capture.why_unmeasurable()
    assert (words is None) == (hopeless is None)
    assert words is None or words in hopeless


@pytest.mark.parametrize(("stood", "named"), [(0.0, True), (-ANGLE, False)])
def test_a_table_of_the_wrong_sign_is_named_at_the_first_attempt(stood, named):
    """Unless it has stood there since before the order: then it may just not have begun."""
    capture = Capture(PLAN, replace(SETTINGS, step_timeout_s=30.0), RULES)
    scene = make_scene(PLAN, 6)
    scene.probe = scene.probe[:2]
    scene.edit("table", lambda r: replace(r, angle=stood, velocity=0.0), -SECOND, SECOND)
    scene.edit("table", lambda r: replace(r, angle=-ANGLE, velocity=0.0), SECOND, 7 * SECOND)
    ordered = False
    for record in scene.by_stamp():
        if record.stamp_ns >= SECOND // 2 and not ordered:
            ordered = True
            capture.feed(PLAN.steps[1].command(0))
        capture.feed(record)
    if named:
        assert "says -28.6479 deg where +28.6479 deg was commanded: is a sign wrong?" in (
            capture.why_unmeasurable()
        )
    else:
        assert capture.why_unmeasurable() is None
