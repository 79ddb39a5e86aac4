"""Bad input: counted, or rejected with the reason in words and numbers; never a wrong number."""

import re
from dataclasses import replace

import numpy as np
import pytest
from capture_scenes import (
    MS,
    RULES,
    SECOND,
    SETTINGS,
    length_of,
    make_plan,
    make_scene,
    probe_sample,
    replay,
    table_off,
)

from rotcal_ros.capture import Capture, CaptureSettings
from rotcal_ros.foundation.observations import LengthStatus, PointKind

PLAN = make_plan()
IMPATIENT = replace(SETTINGS, clock_tolerance_s=3.0)


def reasons_of(scene, settings=SETTINGS):
    return [o.reason for o in replay(PLAN, scene.by_stamp(), settings)]


def counts_of(records, settings=SETTINGS):
    capture = Capture(PLAN, settings, RULES)
    for record in records:
        capture.feed(record)
    return capture.counts


def test_undisturbed_streams_count_nothing():
    counts = counts_of(make_scene(PLAN, 2).by_stamp())
    assert counts == {
        "tracer": {"received": 3000},
        "table": {"received": 300},
        "temperature": {"received": 30},
        "probe": {"received": 2},
        "command": {"received": 0},
    }


def test_too_many_broken_readings_are_rejected_and_a_few_are_left_out():
    scene = make_scene(PLAN, 1)
    scene.edit("tracer", _status(LengthStatus.BEAM_BROKEN), 201 * MS, 205 * MS)
    (observation,) = replay(PLAN, scene.by_stamp())
    assert (observation.accepted, observation.n_used) == (True, 16)
    scene.edit("tracer", _status(LengthStatus.UNSTABLE), 205 * MS, 206 * MS)
    (observation,) = replay(PLAN, scene.by_stamp())
    assert observation.reason == (
        "only 15 of 20 readings usable: 4 beam broken, 1 unstable by its own status; "
        "expected at least 80%"
    )
    assert (observation.mean, observation.std, observation.n_used) == ((), (), 15)


def _status(status):
    return lambda r: replace(r, status=status)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_non_finite_readings_are_counted_and_never_used(value):
    scene = make_scene(PLAN, 1)
    clean = replay(PLAN, scene.by_stamp())[0]
    scene.edit("tracer", lambda r: replace(r, length=value), 203 * MS, 205 * MS)
    (observation,) = replay(PLAN, scene.by_stamp())
    assert observation.accepted
    assert observation.n_used == 18
    assert observation.mean[0] == pytest.approx(clean.mean[0], abs=1e-7)
    assert counts_of(scene.by_stamp())["tracer"]["non_finite"] == 2


def test_unknown_status_is_not_taken_for_good():
    scene = make_scene(PLAN, 1)
    scene.edit("tracer", _status(LengthStatus.UNKNOWN), 0, SECOND)
    assert "20 of unknown status" in reasons_of(scene)[0]


def test_noisy_window():
    scene = make_scene(PLAN, 1)
    for k in range(200, 230):
        bump = 5e-6 * (-1) ** k
        scene.edit("tracer", _longer(bump), k * MS, (k + 1) * MS)
    assert reasons_of(scene)[0].startswith("unstable: standard deviation 5.1")


def test_drifting_window():
    scene = make_scene(PLAN, 1)
    for k in range(200, 230):
        scene.edit("tracer", _longer((k - 200) * 0.2e-6), k * MS, (k + 1) * MS)
    reason = reasons_of(scene)[0]
    assert reason.startswith("drifting: +3.")  # 19 steps of 0.2 um, and the noise
    assert reason.endswith("um over the window, allowed 2 um")


def _longer(by):
    return lambda r: replace(r, length=r.length + by)


def test_millimetres_beyond_every_plausible_length():
    scene = make_scene(PLAN, 1)
    scene.tracer = [replace(s, length=1000 * s.length + 1000) for s in scene.tracer]
    (reason,) = reasons_of(scene)
    assert "20 implausibly long" in reason
    assert "plausible are 20 m (millimetres instead of metres?)" in reason


def test_millimetres_that_look_plausible_contradict_the_plan():
    scene = make_scene(PLAN, 7)
    scene.tracer = [replace(s, length=10 * s.length) for s in scene.tracer]  # hectometres, say
    assert all(o.accepted for o in replay(PLAN, scene.by_stamp()))
    scene = make_scene(PLAN, 7)
    scene.tracer = [replace(s, length=500 * s.length) for s in scene.tracer]
    settings = replace(SETTINGS, max_length_m=1000.0, max_std_m=1.0, max_drift_m=1.0)
    found = replay(PLAN, scene.by_stamp(), settings)
    assert [o.accepted for o in found] == [True, True, True] + [False] * 4
    change = 500 * (length_of(PLAN.steps[3]) - length_of(PLAN.steps[0]))
    assert found[3].reason.startswith(f"implausible: length changed by {change:.3f}"[:-2])
    assert "which are 0.2 m apart (millimetres instead of metres?)" in found[3].reason


def test_lost_readings_in_the_window():
    scene = make_scene(PLAN, 1)
    scene.edit("tracer", lambda _: None, 210 * MS, 212 * MS)
    assert reasons_of(scene) == ["2 tracer readings lost in the window (sequence 1208 to 1211)"]
    assert counts_of(scene.by_stamp())["tracer"]["lost"] == 2


def test_sequence_wraps_at_32_bits_without_a_gap():
    scene = make_scene(PLAN, 1)
    shift = (1 << 32) - 1210
    scene.tracer = [replace(s, sequence=(s.sequence + shift) % (1 << 32)) for s in scene.tracer]
    assert reasons_of(scene) == [""]
    assert "lost" not in counts_of(scene.by_stamp())["tracer"]


def test_two_publishers_on_the_tracer_topic():
    scene = make_scene(PLAN, 1)
    other = [replace(s, stamp_ns=s.stamp_ns + 500, sequence=s.sequence + 77) for s in scene.tracer]
    scene.tracer = sorted(scene.tracer + other, key=lambda s: s.stamp_ns)
    (reason,) = reasons_of(scene)
    assert "two publishers on the topic?" in reason
    assert counts_of(scene.by_stamp())["tracer"]["out_of_order"] > 1000


def test_duplicates_are_dropped():
    scene = make_scene(PLAN, 2)
    expected = replay(PLAN, scene.by_stamp())
    records = [r for record in scene.by_stamp() for r in (record, record)]
    assert replay(PLAN, records) == expected
    counts = counts_of(records)
    assert counts["tracer"] == {"received": 6000, "duplicates": 3000}
    assert counts["table"]["duplicates"] == 300
    assert counts["probe"]["duplicates"] == 2


def test_stamps_going_backwards_are_dropped():
    scene = make_scene(PLAN, 1)
    expected = replay(PLAN, scene.by_stamp())
    records = scene.by_stamp()
    late = [replace(r, stamp_ns=r.stamp_ns - SECOND) for r in records if hasattr(r, "length")]
    records[700:700] = late[600:650]
    assert replay(PLAN, records) == expected
    assert counts_of(records)["tracer"]["backwards"] == 50


def test_a_second_publisher_with_another_clock_does_no_harm():
    scene = make_scene(PLAN, 1)
    expected = replay(PLAN, scene.by_stamp())
    epoch = 1_700_000_000 * SECOND
    records = []
    for record in scene.by_stamp():
        records.append(record)
        if hasattr(record, "velocity"):
            records.append(replace(record, stamp_ns=record.stamp_ns + epoch, angle=1.0))
    assert replay(PLAN, records) == expected
    assert counts_of(records)["table"]["foreign_clock"] == 200


def test_a_stream_may_pause():
    scene = make_scene(PLAN, 3)
    pause = 500 * SECOND
    for name in ("tracer", "table", "probe", "temperature"):
        scene.edit(name, lambda r: replace(r, stamp_ns=r.stamp_ns + pause), SECOND, 10 * SECOND)
    assert [o.accepted for o in replay(PLAN, scene.by_stamp(), IMPATIENT)] == [True] * 3


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("tracer", "tracer readings are .* behind the other streams"),
        ("table", "table feedbacks are .* behind the other streams"),
    ],
)
def test_a_silent_stream_rejects_the_step(name, text):
    scene = make_scene(PLAN, 6)
    scene.edit(name, lambda _: None, SECOND, 100 * SECOND)
    found = replay(PLAN, scene.by_stamp(), IMPATIENT)
    assert found[0].accepted
    assert not found[1].accepted
    assert re.search(text, found[1].reason)
    assert found[1].reason.endswith("allowed 3 s: silent, or stamped by another clock")


@pytest.mark.parametrize("name", ["tracer", "table", "probe"])
@pytest.mark.parametrize("shift_s", [-1e9, -40.0, 40.0, 1e9])
def test_another_clock_never_gives_an_observation(name, shift_s):
    scene = make_scene(PLAN, 4)
    shift = round(shift_s) * SECOND
    moved = [replace(r, stamp_ns=r.stamp_ns + shift) for r in getattr(scene, name)]
    records = scene.by_stamp()
    by_old = {id(old): new for old, new in zip(getattr(scene, name), moved, strict=True)}
    found = replay(PLAN, [by_old.get(id(r), r) for r in records], IMPATIENT)
    assert found
    assert not any(o.accepted for o in found)
    assert all("clock" in o.reason or "have left memory" in o.reason for o in found)


def test_a_temperature_that_never_comes_is_told():
    capture = Capture(PLAN, IMPATIENT, RULES)
    records = [r for r in make_scene(PLAN, 5).by_stamp() if not hasattr(r, "sensor")]
    found = [o for record in records for o in capture.feed(record)]
    assert found
    assert all(o.accepted and o.temperature_c is None for o in found)
    assert capture.remarks()[0] == "table position 0, target 0: no temperature came in time"


@pytest.mark.parametrize("shift_s", [-1e9, 1e9])
def test_a_temperature_from_another_clock_is_left_out(shift_s):
    scene = make_scene(PLAN, 5)
    records = [
        replace(r, stamp_ns=r.stamp_ns + round(shift_s) * SECOND) if hasattr(r, "sensor") else r
        for r in scene.by_stamp()
    ]
    found = replay(PLAN, records, IMPATIENT)
    assert found
    assert all(o.accepted and o.temperature_c is None for o in found)


def test_no_temperature_is_expected():
    scene = make_scene(PLAN, 1)
    scene.temperature = []
    (observation,) = replay(PLAN, scene.by_stamp(), replace(SETTINGS, temperature_expected=False))
    assert observation.accepted
    assert observation.temperature_c is None


def test_non_finite_temperature_is_dropped():
    scene = make_scene(PLAN, 1)
    scene.edit("temperature", lambda r: replace(r, temperature_c=np.nan), 150 * MS, 350 * MS)
    (observation,) = replay(PLAN, scene.by_stamp())
    assert observation.temperature_c == pytest.approx(20.4)
    assert counts_of(scene.by_stamp())["temperature"] == {"received": 20, "non_finite": 2}


def test_table_never_in_position_says_how_far():
    scene = make_scene(PLAN, 1)
    scene.edit("table", table_off(-37.5), 0, SECOND)
    assert reasons_of(scene) == [
        "table not at rest in position for a whole window within 0.6 s: the last feedback is "
        "-37.5 arcsec off the commanded 0.0000 deg (allowed 20) at 0 deg/s (allowed 0.02)"
    ]


@pytest.mark.parametrize("field", ["angle", "velocity"])
def test_feedback_that_is_no_number_is_not_in_position(field):
    scene = make_scene(PLAN, 1)
    scene.edit("table", lambda r: replace(r, **{field: np.nan}), 0, SECOND)
    (reason,) = reasons_of(scene)
    assert reason.startswith("table not at rest in position")
    assert counts_of(scene.by_stamp())["table"]["non_finite"] == 100


def test_too_few_readings_before_the_deadline():
    scene = make_scene(PLAN, 1)
    scene.edit("tracer", lambda _: None, 210 * MS, 900 * MS)
    assert reasons_of(scene) == [
        "only 9 of 20 tracer readings in the 0.55 s remaining after settling"
    ]


def test_next_attempt_ends_the_one_before():
    scene = make_scene(PLAN, 1)
    scene.probe.append(probe_sample(PLAN.steps[0], 215 * MS, attempt=1))
    first, second = replay(PLAN, scene.by_stamp())
    assert first.reason.startswith("only 14 of 20 tracer readings")
    assert second.accepted


def test_probe_elsewhere_or_of_another_kind():
    scene = make_scene(PLAN, 3)
    scene.probe[0] = replace(scene.probe[0], position=(0.0, 0.0, np.nan))
    scene.probe[1] = replace(scene.probe[1], target=2)
    scene.probe[2] = replace(scene.probe[2], kind=PointKind.NEST)
    reasons = reasons_of(scene)
    assert reasons[0].startswith("probe position is not finite")
    assert reasons[1] == (
        "probe reports REFLECTOR at target 2, the plan says REFLECTOR at target 0"
    )
    assert "reports NEST" in reasons[2]


def test_probe_stamps_going_backwards():
    scene = make_scene(PLAN, 3)
    records = scene.by_stamp()
    broken = [replace(r, stamp_ns=-SECOND) if r is scene.probe[1] else r for r in records]
    found = replay(PLAN, broken)
    assert found[1].reason.startswith("probe stamps go backwards: 1.15 s before")
    assert [o.accepted for o in found] == [True, False, True]


def test_steps_that_are_not_in_the_plan_are_counted_and_told():
    capture = Capture(PLAN, SETTINGS, RULES)
    capture.feed(replace(probe_sample(PLAN.steps[0], 0), step=9))
    capture.feed(replace(PLAN.steps[0].command(0), step=12))
    capture.feed(replace(PLAN.steps[0].command(0), table_angle=0.1))
    capture.feed(PLAN.steps[0].command(0))
    assert capture.counts["probe"] == {"received": 1, "unknown_step": 1}
    assert capture.counts["command"] == {"received": 3, "unknown_step": 1, "off_plan": 1}
    texts = capture.remarks()
    assert "probe sample for step 9, which is not in the plan: it has the steps 0 to 8" in texts[0]
    assert "is not the plan's" in texts[2]
    assert capture.remarks() == ()


def test_an_answer_to_an_earlier_attempt_is_a_duplicate():
    scene = make_scene(PLAN, 2)
    scene.probe.append(probe_sample(PLAN.steps[0], 1500 * MS))
    assert len(replay(PLAN, scene.by_stamp())) == 2
    assert counts_of(scene.by_stamp())["probe"]["duplicates"] == 1


def test_a_flood_of_attempts_is_bounded():
    capture = Capture(PLAN, SETTINGS, RULES)
    found = []
    for attempt in range(500):
        found += capture.feed(probe_sample(PLAN.steps[0], attempt * MS, attempt=attempt))
    assert len(found) == 500 - 64
    assert not any(o.accepted for o in found)


def test_defaults_are_in_range():
    settings = CaptureSettings()
    assert Capture(PLAN, settings, RULES).counts["tracer"] == {"received": 0}
