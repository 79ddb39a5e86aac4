"""The capture as a whole: what is observed, and that the order of arrival does not matter."""

from __future__ import annotations

from dataclasses import replace
from itertools import permutations
from math import fsum, sqrt

import numpy as np
import pytest
from capture_scenes import (
    MS,
    RULES,
    SECOND,
    SETTINGS,
    Scene,
    length_of,
    make_plan,
    make_scene,
    probe_sample,
    replay,
    table_off,
)
from hypothesis import given, settings
from hypothesis import strategies as st

from rotcal_ros.capture import Capture, CaptureSettings
from rotcal_ros.capture import streams as streams_module
from rotcal_ros.foundation.errors import ConfigurationError
from rotcal_ros.foundation.observations import LengthStatus, PointKind

PLAN = make_plan()


def test_window_is_the_first_readings_after_rest_and_settling():
    scene = make_scene(PLAN, 1)
    (observation,) = replay(PLAN, scene.by_stamp())
    # probe at 150 ms; the first feedback at rest after it at 150 ms + 1 ns; settled 50 ms later
    expected = [s for s in scene.tracer if s.stamp_ns >= 200 * MS + 1][:20]
    lengths = [s.length for s in expected]
    mean = fsum(lengths) / 20
    scatter = sqrt(fsum((v - mean) ** 2 for v in lengths) / 19)
    assert observation.accepted, observation.reason
    assert observation.mean == (mean,)
    assert observation.scatter == pytest.approx((scatter,), rel=1e-12)
    assert observation.std == pytest.approx((scatter / sqrt(20),), rel=1e-12)
    assert observation.window_start_ns == expected[0].stamp_ns
    assert observation.window_end_ns == expected[-1].stamp_ns
    assert (observation.n_samples, observation.n_used) == (20, 20)
    assert observation.table_angle_measured == observation.table_angle == 0.0
    assert (observation.step, observation.attempt, observation.kind) == (0, 0, 1)


def test_temperature_is_the_last_one_a_lag_before_the_probe_arrived():
    scene = make_scene(PLAN, 2)
    _, second = replay(PLAN, scene.by_stamp())
    assert second.temperature_c == pytest.approx(20 + 0.8)  # at 800 ms: the last before 850 ms


def test_temperatures_from_before_the_first_probe_sample_change_nothing():
    scene = make_scene(PLAN, 2)
    found = replay(PLAN, scene.by_stamp())
    assert found[0].temperature_c == pytest.approx(20.2)  # the first one after 150 ms
    scene.temperature = [t for t in scene.temperature if t.stamp_ns >= 150 * MS]
    assert replay(PLAN, scene.by_stamp()) == found


def test_without_an_early_temperature_the_first_one_is_taken():
    scene = make_scene(PLAN, 1)
    scene.temperature = [t for t in scene.temperature if t.stamp_ns >= 300 * MS]
    (observation,) = replay(PLAN, scene.by_stamp())
    assert observation.temperature_c == pytest.approx(20.3)


def test_feedback_a_full_turn_away_is_the_same_place():
    scene = make_scene(PLAN, 1)
    scene.table = [replace(s, angle=s.angle - 4 * np.pi) for s in scene.table]
    (observation,) = replay(PLAN, scene.by_stamp())
    assert observation.accepted
    assert observation.table_angle_measured == pytest.approx(0.0, abs=1e-14)


def test_table_that_leaves_during_the_window_starts_it_again():
    scene = make_scene(PLAN, 1)
    scene.edit("table", table_off(25.0), 215 * MS, 225 * MS)
    (observation,) = replay(PLAN, scene.by_stamp())
    assert observation.accepted
    # the feedback at 220 ms is off, that at 230 ms is at rest again, 50 ms of settling follow
    assert observation.window_start_ns == 281 * MS


def test_pause_of_the_table_feedback_starts_the_window_again():
    scene = make_scene(PLAN, 1)
    scene.edit("table", lambda _: None, 200 * MS, 330 * MS)
    (observation,) = replay(PLAN, scene.by_stamp())
    assert observation.window_start_ns == 381 * MS


def test_spikes_are_left_out():
    scene = make_scene(PLAN, 1)
    clean = [s for s in scene.tracer if s.stamp_ns >= 201 * MS][:20]
    scene.edit("tracer", lambda r: replace(r, length=r.length + 2e-5), 215 * MS, 217 * MS)
    (observation,) = replay(PLAN, scene.by_stamp())
    good = [s.length for s in clean if not 215 * MS <= s.stamp_ns < 217 * MS]
    assert observation.accepted
    assert observation.n_used == 18
    assert observation.mean[0] == fsum(good) / 18


def test_second_attempt_is_an_observation_of_its_own():
    scene = make_scene(PLAN, 1)
    scene.edit("tracer", lambda r: replace(r, status=LengthStatus.BEAM_BROKEN), 0, 300 * MS)
    scene.probe.append(probe_sample(PLAN.steps[0], 400 * MS, attempt=1))
    first, second = replay(PLAN, scene.by_stamp())
    assert (first.attempt, first.accepted) == (0, False)
    assert first.reason.startswith("only 0 of 20 readings usable: 20 beam broken")
    assert (second.attempt, second.accepted) == (1, True)


def troubled_scene() -> Scene:
    """Nine steps: good, restarted, blocked, gap, away, never there, mixed, NaN, retried."""
    scene = make_scene(PLAN, 9)
    at = [k * SECOND for k in range(9)]
    scene.edit("table", table_off(30.0), at[1] + 210 * MS, at[1] + 240 * MS)
    scene.edit("tracer", _broken, at[2], at[2] + 900 * MS)
    scene.edit("tracer", lambda _: None, at[3] + 215 * MS, at[3] + 219 * MS)
    scene.probe[4] = replace(scene.probe[4], position=(0.0, 0.0, 0.5))
    scene.edit("table", table_off(50.0), at[5], at[5] + 900 * MS)
    scene.edit("tracer", lambda r: replace(r, length=float("nan")), at[7], at[7] + SECOND)
    scene.probe.append(probe_sample(PLAN.steps[8], at[8] + 500 * MS, attempt=1))
    return scene


def _broken(record):
    return replace(record, status=LengthStatus.BEAM_BROKEN, length=float("nan"))


SCENE = troubled_scene()
EXPECTED = replay(PLAN, SCENE.by_stamp())


def test_the_troubled_scene_holds_every_kind_of_outcome():
    outcomes = [(o.step, o.attempt, o.accepted) for o in EXPECTED]
    bad = {2, 3, 4, 5, 7}
    assert outcomes == [(k, 0, k not in bad) for k in range(9)] + [(8, 1, True)]
    reasons = {o.step: o.reason for o in EXPECTED if not o.accepted}
    assert reasons[3] == "4 tracer readings lost in the window (sequence 4213 to 4218)"
    assert reasons[4].startswith("probe is 0.538516 m from target 1")
    assert "50 arcsec off the commanded 57.2958 deg" in reasons[5]
    assert "20 not a finite number" in reasons[7]


@pytest.mark.parametrize("order", list(permutations(range(4))))
def test_one_stream_after_the_other_gives_the_same_bits(order):
    streams = SCENE.streams()
    records = [record for number in order for record in streams[number]]
    assert replay(PLAN, records) == EXPECTED


@pytest.mark.slow
@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), burst=st.sampled_from([1.0, 20.0, 500.0]))
def test_any_interleaving_gives_the_same_bits(seed, burst):
    rng = np.random.default_rng(seed)
    left = [list(reversed(stream)) for stream in SCENE.streams()]
    records = []
    while any(left):
        stream = left[rng.choice([i for i in range(4) if left[i]])]
        count = min(len(stream), 1 + int(rng.exponential(burst)))
        records.extend(stream.pop() for _ in range(count))
    assert replay(PLAN, records) == EXPECTED


@pytest.mark.slow
@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), size=st.sampled_from([3, 50, 3000]))
def test_blocks_of_readings_give_the_same_bits(seed, size):
    rng = np.random.default_rng(seed)
    capture, found, block = Capture(PLAN, SETTINGS, RULES), [], []

    def feed_block():
        if block:
            columns = [np.array(c) for c in zip(*block, strict=True)]
            found.extend(capture.feed_tracer(*columns))
            block.clear()

    for record in SCENE.by_stamp():
        if record in SCENE.probe:
            found.extend(capture.feed(record))
        elif hasattr(record, "length"):
            block.append((record.stamp_ns, record.sequence, record.length, record.status))
            if rng.integers(size) == 0:
                feed_block()
        else:
            found.extend(capture.feed(record))
    feed_block()
    assert tuple(found) == EXPECTED


@pytest.mark.parametrize("begin", [-900, -300, 0, 149])
def test_it_does_not_matter_when_the_capture_began_to_listen(begin):
    records = [r for r in SCENE.by_stamp() if r.stamp_ns >= begin * MS]
    assert replay(PLAN, records) == EXPECTED


def test_positions_told_unasked_change_nothing():
    unasked = [replace(p, kind=PointKind.UNKNOWN, stamp_ns=p.stamp_ns - MS) for p in SCENE.probe]
    records = sorted([*SCENE.by_stamp(), *unasked], key=lambda r: r.stamp_ns)
    assert replay(PLAN, records) == EXPECTED


@pytest.mark.slow
@settings(max_examples=10, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_asking_for_counts_changes_nothing(seed):
    rng = np.random.default_rng(seed)
    capture, found = Capture(PLAN, SETTINGS, RULES), []
    for record in SCENE.by_stamp():
        found.extend(capture.feed(record))
        if rng.integers(30) == 0:
            assert capture.counts
    assert tuple(found) == EXPECTED


@pytest.mark.parametrize("asking", [False, True])
def test_decided_as_soon_as_the_streams_have_passed_the_window(asking):
    capture = Capture(PLAN, SETTINGS, RULES)
    for record in make_scene(PLAN, 1).by_stamp():
        found = capture.feed(record)
        if asking:
            assert capture.counts
        if found:
            assert record.stamp_ns == 220 * MS + 1  # the first feedback past the window's end
            return
    pytest.fail("no observation")


@pytest.mark.parametrize("silent", ["tracer", "table"])
def test_a_silent_stream_is_noticed_by_the_others(silent):
    capture = Capture(PLAN, replace(SETTINGS, clock_tolerance_s=0.4), RULES)
    scene = make_scene(PLAN, 1)
    scene.edit(silent, lambda _: None, 100 * MS, SECOND)
    for record in scene.by_stamp():
        for observation in capture.feed(record):
            assert "behind the other streams, allowed 0.4 s" in observation.reason
            assert 490 * MS <= record.stamp_ns <= 510 * MS + 1
            return
    pytest.fail("no observation")


def test_memory_is_bounded(monkeypatch):
    monkeypatch.setattr(streams_module, "CAPACITY", 2000)
    capture = Capture(PLAN, SETTINGS, RULES)
    scene = make_scene(PLAN, 9)
    found = [o for record in scene.by_stamp() for o in capture.feed(record)]
    assert all(o.accepted for o in found)
    assert len(found) == 9
    for stream in capture._streams.by_name().values():
        assert len(stream._stamps) <= 4000


def test_a_window_that_memory_has_let_go_is_rejected(monkeypatch):
    monkeypatch.setattr(streams_module, "CAPACITY", 1100)
    scene = make_scene(PLAN, 5)
    found = replay(PLAN, [*scene.tracer, *scene.table, *scene.temperature, *scene.probe])
    assert [o.accepted for o in found] == [False, False, False, True, True]
    assert "have left memory" in found[0].reason


def test_settling_that_leaves_no_time_is_a_wrong_configuration():
    with pytest.raises(ConfigurationError, match="leaves no time for a window"):
        Capture(PLAN, CaptureSettings(settle_time_s=30.0, step_timeout_s=30.0), RULES)


def test_waiting_for_names_the_stream():
    capture = Capture(PLAN, SETTINGS, RULES)
    scene = make_scene(PLAN, 1)
    assert capture.waiting_for is None
    for record in [*scene.temperature, *scene.table, scene.probe[0]]:
        capture.feed(record)
    assert capture.waiting_for.startswith(
        "table position 0, target 0: waiting for tracer readings"
    )


def test_station_and_indices_come_from_the_plan():
    observations = replay(PLAN, make_scene(PLAN, 5).by_stamp())
    for o in observations:
        step = PLAN.steps[o.step]
        assert (o.table_position, o.target, o.kind) == (
            step.table_position,
            step.target,
            step.kind,
        )
        assert o.kind is PointKind.REFLECTOR
        assert o.mean[0] == pytest.approx(length_of(step), abs=1.5e-7)
