"""A clock is set while the streams run: nothing of before counts for what comes behind it."""

from dataclasses import replace

import numpy as np
import pytest
from capture_scenes import MS, RULES, SECOND, SETTINGS, make_plan, make_scene

from rotcal_ros.capture import Capture
from rotcal_ros.capture.streams import Stream
from rotcal_ros.capture.window import Beam
from rotcal_ros.foundation.observations import (
    ProbeSample,
    TableSample,
    TemperatureSample,
    TracerSample,
)

PLAN = make_plan()


def shifted(records, from_ns, by_ns, kinds=None):
    """Set the clock of all streams, or of those of some kinds, from a time on."""
    return [
        replace(r, stamp_ns=r.stamp_ns + by_ns)
        if r.stamp_ns >= from_ns and (kinds is None or isinstance(r, kinds))
        else r
        for r in records
    ]


def captured(records, settings=SETTINGS):
    capture = Capture(PLAN, settings, RULES)
    return [o for record in records for o in capture.feed(record)], capture


@pytest.mark.parametrize("by_s", [-3600, -45, -1])
def test_behind_a_clock_set_back_the_windows_are_those_of_an_unset_clock(by_s):
    """Steps begin every second; the clock is set back in the pause behind the third."""
    scene = make_scene(PLAN, 9)
    expected, _ = captured(scene.by_stamp())
    assert all(o.accepted for o in expected)
    at_ns, by_ns = 3 * SECOND - 200 * MS, by_s * SECOND
    found, capture = captured(shifted(scene.by_stamp(), at_ns, by_ns))
    counts = capture.counts
    assert counts["tracer"]["set_back"] == counts["table"]["set_back"] == 1
    assert found[:3] == expected[:3]
    late = [o for o in found if o.step >= 5]
    assert [o.step for o in late] == [5, 6, 7, 8]
    for observation, true in zip(late, expected[5:], strict=True):
        assert observation.accepted, observation.reason
        assert observation.window_start_ns == true.window_start_ns + by_ns
        assert observation.window_end_ns == true.window_end_ns + by_ns
        assert (observation.mean, observation.std) == (true.mean, true.std)
        assert observation.segment == true.segment


@pytest.mark.parametrize(
    ("by_ns", "settings", "words"),
    [
        (-45 * SECOND, SETTINGS, "went back by 45 s"),
        # a clock set ahead in the settling time is no settling
        (SECOND, replace(SETTINGS, table_silence_s=3.0, step_timeout_s=3.0), "jump ahead by 1 s"),
    ],
)
def test_an_attempt_under_way_is_rejected_with_the_reason(by_ns, settings, words):
    scene = make_scene(PLAN, 9)
    (third,) = [r.stamp_ns for r in scene.probe if r.step == 3]
    found, _ = captured(shifted(scene.by_stamp(), third + 20 * MS, by_ns), settings)
    reason = next(o.reason for o in found if o.step == 3)
    assert reason.startswith(f"the stamps of the tracer readings {words}")


@pytest.mark.parametrize("early_ms", [-30, -5, 5, 30])
def test_the_order_in_which_the_streams_follow_does_not_matter(early_ms):
    """The tracer's messages come a little before or behind those of the others."""
    scene = make_scene(PLAN, 9)
    records = sorted(
        scene.by_stamp(), key=lambda r: r.stamp_ns - early_ms * MS * hasattr(r, "length")
    )
    at_ns = 3 * SECOND - 200 * MS
    usual, _ = captured(shifted(scene.by_stamp(), at_ns, -45 * SECOND))
    other, _ = captured(shifted(records, at_ns, -45 * SECOND))
    assert [o for o in other if o.accepted] == [o for o in usual if o.accepted]


@pytest.mark.parametrize("by_s", [-45, -3])
@pytest.mark.parametrize("late", [TracerSample, TableSample, (TracerSample, TableSample)])
def test_air_of_the_new_clock_that_comes_before_the_streams_is_not_forgotten(late, by_s):
    """The air is read once a second; the streams that show the jump come 1.2 s late."""
    scene = make_scene(PLAN, 9)
    scene.temperature = [t for t in scene.temperature if t.stamp_ns % SECOND == 100 * MS]
    scene.temperature = [
        replace(t, temperature_c=20.0 + n / 10) for n, t in enumerate(scene.temperature)
    ]
    at_ns = 3 * SECOND - 200 * MS
    records = sorted(scene.by_stamp(), key=lambda r: r.stamp_ns + 1200 * MS * isinstance(r, late))
    usual, _ = captured(shifted(scene.by_stamp(), at_ns, by_s * SECOND))
    other, _ = captured(shifted(records, at_ns, by_s * SECOND))
    behind = [o for o in other if o.step >= 4]
    assert all(o.accepted for o in behind)
    assert len({o.temperature_c for o in behind}) > 1
    assert behind == [o for o in usual if o.step >= 4]


@pytest.mark.parametrize("by_s", [-45, -3])
@pytest.mark.parametrize("kind", [TemperatureSample, ProbeSample])
def test_what_comes_late_from_before_the_clock_was_set_back_changes_nothing(kind, by_s):
    """The air is read once a second, the clock set back just after it and a probe sample."""
    scene = make_scene(PLAN, 9)
    scene.temperature = [t for t in scene.temperature if t.stamp_ns % SECOND == 100 * MS]
    at_ns = 3 * SECOND + 170 * MS
    usual = shifted(scene.by_stamp(), at_ns, by_s * SECOND)
    behind = next(n for n, r in enumerate(scene.by_stamp()) if r.stamp_ns >= at_ns)
    late = [r for r in usual[:behind] if isinstance(r, kind)][-1]
    records = [r for r in usual if r is not late]
    records.insert(behind + 400, late)
    (expected, _), (found, _) = captured(usual), captured(records)
    accepted = [o for o in expected if o.accepted]
    assert [o.step for o in accepted] == [0, 1, 2, 5, 6, 7, 8]
    assert [o for o in found if o.accepted] == accepted


def test_a_probe_whose_clock_alone_is_set_back_measures_nothing_of_the_past():
    """Else the table's rest of the same angle, 45 s ago, would do."""
    scene = make_scene(PLAN, 9)
    records = shifted(scene.by_stamp(), 5 * SECOND, -45 * SECOND, ProbeSample)
    settings = replace(SETTINGS, clock_tolerance_s=10.0)
    found, _ = captured(records, settings)
    late = [o for o in found if o.step >= 5]
    assert len(late) == 4
    assert not any(o.accepted for o in late)
    assert all("behind" in o.reason or "backwards" in o.reason for o in late)


def fed(stamps):
    stream = Stream(1, 100 * SECOND)
    for stamp in stamps:
        stream.stage(stamp, (float(stamp),))
    stream.flush()
    return stream


def test_a_stream_begins_anew_with_the_first_sample_behind_the_jump():
    new = [50 * SECOND + 10 * k * MS for k in range(30)]
    stream = fed([*(100 * SECOND + 10 * k * MS for k in range(50)), *new])
    assert stream.stamps.tolist() == new
    assert stream.counts.set_back == 1
    assert stream.counts.backwards == 0
    assert stream.set_back_ns == 50 * SECOND + 490 * MS
    assert stream.forgotten == new[0] - 1


def test_belated_samples_set_no_clock_back():
    old = [100 * SECOND + 10 * k * MS for k in range(50)]
    belated = [stamp - SECOND for stamp in old[:10]]  # 90 ms of them
    stream = fed([*old, *belated, old[-1] + 10 * MS])
    assert stream.counts.set_back == 0
    assert stream.counts.backwards == 10


def test_the_zero_of_a_beam_outlives_a_set_clock_and_not_a_new_start():
    def segments(*sequence_from):
        beam = Beam(silence_s=1.0, fastest=10.0)
        ends = []
        for run, first in enumerate(sequence_from):
            stamps = (100 - 50 * run) * SECOND + 10 * MS * np.arange(100)
            n = np.ones(100, dtype=bool)
            beam.follow(stamps, first + np.arange(100.0), np.full(100, 0.5), n, ~n)
            ends.append(beam.segment(100 * SECOND, int(stamps[5]), int(stamps[9]), 0))
        return ends

    assert segments(0, 100) == [0, 0]
    assert segments(5000, 0) == [0, 2]
