"""Instruments that speak when they are asked: no pause is too long, one reading is a window."""

from dataclasses import replace

import pytest
from capture_scenes import MS, RULES, SECOND, SETTINGS, length_of, make_plan, make_scene

from rotcal_ros.capture import Capture
from rotcal_ros.foundation.observations import LengthStatus, TracerSample

PLAN = make_plan()
ONE = replace(SETTINGS, window_samples=1, clock_tolerance_s=0.3)
PACE = 40
"""The steps are so many seconds apart: far beyond the tolerance of clocks."""


def observed(shots, settings=ONE, *, single_shot=True, steps=3):
    """Feed a scene whose steps are far apart, with ``shots`` of (step, ms after its begin)."""
    scene = make_scene(PLAN, steps)
    scene.tracer = [
        TracerSample(k * SECOND + ms * MS, i, length_of(PLAN.steps[k]), 0.0, LengthStatus.OK)
        for i, (k, ms) in enumerate(shots)
    ]
    moved = [
        replace(r, stamp_ns=r.stamp_ns + (PACE - 1) * SECOND * (r.stamp_ns // SECOND))
        for r in scene.by_stamp()
    ]
    # the table goes on reporting where it is
    last = [r for r in scene.table if 0 <= r.stamp_ns // SECOND < steps]
    fill = [
        replace(r, stamp_ns=r.stamp_ns % SECOND + k * PACE * SECOND + s * SECOND)
        for k in range(steps)
        for s in range(1, PACE)
        for r in last[k * 100 + 20 : k * 100 + 100 : 5]
    ]
    records = sorted((*moved, *fill), key=lambda r: r.stamp_ns)
    capture = Capture(PLAN, settings, RULES, single_shot=single_shot)
    return [o for record in records for o in capture.feed(record)]


def test_a_reading_alone_is_a_window():
    found = observed([(k, 300) for k in range(3)])
    assert [o.accepted for o in found] == [True] * 3, [o.reason for o in found]
    assert [o.mean[0] for o in found] == [length_of(step) for step in PLAN.steps[:3]]
    assert {(o.std, o.scatter, o.n_used) for o in found} == {((0.0,), (0.0,), 1)}


def test_bursts_are_windows_too():
    settings = replace(ONE, window_samples=5)
    found = observed([(k, 300 + i) for k in range(3) for i in range(8)], settings)
    assert [o.n_used for o in found] == [5, 5, 5]
    assert all(o.accepted for o in found)


def test_a_stream_that_is_not_said_to_be_single_shot_is_lost():
    found = observed([(k, 300) for k in range(3)], single_shot=False)
    assert not any(o.accepted for o in found[1:])


def test_a_shot_before_the_end_of_settling_is_told():
    found = observed([(k, 160) for k in range(3)])
    assert [o.accepted for o in found] == [False] * 3
    assert "taken too early (capture.settle_time_s)" in found[0].reason


def test_a_shot_that_does_not_come_says_what_to_do():
    found = observed([(0, 300)])
    assert [o.accepted for o in found] == [True, False, False]
    assert "length_trigger" in found[1].reason


@pytest.mark.parametrize("settled", [False, True])
def test_the_instrument_is_asked_once_the_table_has_settled(settled):
    scene = make_scene(PLAN, 1)
    scene.tracer = []
    capture = Capture(PLAN, ONE, RULES, single_shot=True)
    until_ns = (215 if settled else 150) * MS
    for record in scene.by_stamp():
        if record.stamp_ns <= until_ns:
            capture.feed(record)
    assert capture.asks_for_length is settled
