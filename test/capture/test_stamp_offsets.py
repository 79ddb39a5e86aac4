"""Clocks that differ are found from the times of arrival; a fast or stalled cell is not blamed."""

from dataclasses import replace

import numpy as np
import pytest
from capture_scenes import MS, SECOND, make_plan

from rotcal_ros.capture.settings import CaptureSettings
from rotcal_ros.capture.stamp_offsets import (
    DOUBT_S,
    OffsetLimits,
    StampOffsets,
    is_clock_rejection,
)

ACCEPTED = make_plan().steps[0].observed((0.1,))
START = 1_700_000_000 * SECOND


def told(*, tracer_s=0.0, table_s=0.0, scale=1.0, stall_s=0.0, many=False, seconds=3.0):
    """Return what is said after streams whose stamps are off by so much (ahead)."""
    offsets = StampOffsets(OffsetLimits(1.0))
    rng = np.random.default_rng(1)
    for stream, period_ms, off_s in (
        ("tracer_length", 5, tracer_s),
        ("joint_states", 20, table_s),
    ):
        sent = START + np.arange(0, round(seconds * 1000), period_ms) * MS
        received = sent + (rng.exponential(0.01, len(sent)) * SECOND).astype(np.int64)
        if stream == "tracer_length":
            late = (sent - START > SECOND) & (sent - START < (1.0 + stall_s) * SECOND)
            received[late] = np.maximum(received[late], START + round((1.0 + stall_s) * SECOND))
        stamps = START + ((sent - START) * scale).astype(np.int64) + round(off_s * SECOND)
        if many:
            offsets.note_many(stream, stamps, received)
        else:
            for pair in zip(stamps.tolist(), received.tolist(), strict=True):
                offsets.note(stream, *pair)
    return offsets.reason_to_reject()


@pytest.mark.parametrize("many", [False, True])
def test_a_clock_that_is_four_seconds_off_is_told_with_its_size_and_its_stream(many):
    text = told(tracer_s=-4.0, many=many)
    assert "stamps of tracer_length are constantly 4.0 s behind those of joint_states" in text
    assert "the stamps of tracer_length" in text
    text = told(table_s=-4.0, many=many)
    assert "tracer_length are constantly 4.0 s ahead of those of joint_states" in text
    assert "the stamps of joint_states" in text


@pytest.mark.parametrize(("off", "setting"), [
    ({"tracer_s": -4.0}, "add -4.00 to topics.length_clock_offset_s"),
    ({"table_s": -4.0}, "add -4.00 to topics.table_clock_offset_s"),
    ({"table_s": 3.0}, "add 3.00 to topics.table_clock_offset_s"),
])  # fmt: skip
def test_an_offset_is_told_with_what_to_state(off, setting):
    assert told(**off).endswith(setting)


def drifting(table, tracer):
    """Return what is reported of a minute whose stamps drift by such shares of the time."""
    offsets, text = StampOffsets(OffsetLimits(1.0)), ""
    for k in range(60 * 50):
        now = START + k * 20 * MS
        offsets.note("joint_states", now + round((now - START) * table), now)
        offsets.note("tracer_length", now + round((now - START) * tracer), now)
        text = offsets.reason_to_reject() if k % 25 == 0 else text
    return text


def test_a_clock_that_drifts_is_told_with_its_rate():
    text = drifting(0.0, 0.02)
    assert "constantly 1.2 s ahead" in text
    assert "it drifts, by +20 ms in a second" in text
    assert "topics.length_clock: sent" in text


@pytest.mark.parametrize(
    "cell",
    [
        {},
        {"tracer_s": 0.4},
        {"tracer_s": 3600.0, "table_s": 3600.0},  # one clock, though not that of this machine
        {"scale": 20.0},
        {"scale": 20.0, "tracer_s": 4.0},  # it cannot be known
        {"stall_s": 1.9},
        {"tracer_s": -4.0, "seconds": 0.4},  # not known yet
    ],
)
def test_one_clock_says_nothing_however_it_runs(cell):
    assert told(**cell) is None


@pytest.mark.parametrize(
    ("delays", "is_told"), [((4.0,) * 4, True), ((4.0, 1.5, 3.0, 2.2), False)]
)
def test_probe_points_are_held_against_the_table_as_they_come(delays, is_told):
    offsets = StampOffsets(OffsetLimits(1.0))
    for number in range(200):
        now = START + number * 20 * MS
        offsets.note("joint_states", now, now)
        if number % 50 == 49:
            offsets.note("probe_point", now - round(delays[number // 50] * SECOND), now)
    reason = offsets.reason_to_reject()
    assert (reason is not None) == is_told
    assert reason is None or "stamps of probe_point are constantly 4.0 s behind" in reason


def test_what_is_measured_meanwhile_is_rejected_with_the_reason():
    offsets = StampOffsets(OffsetLimits(1.0))
    assert offsets.check_clocks(ACCEPTED) == ACCEPTED
    for number in range(200):
        now = START + number * 20 * MS
        offsets.note("joint_states", now, now)
        offsets.note("tracer_length", now - 4 * SECOND, now)
    reason = offsets.reason_to_reject()
    assert reason
    assert offsets.check_clocks(ACCEPTED) == replace(ACCEPTED, accepted=False, reason=reason)
    beaten = replace(ACCEPTED, accepted=False, reason="beam broken")
    assert offsets.check_clocks(beaten) == beaten


@pytest.mark.parametrize("others", [[], [f"other_{letter}" for letter in "zyxwvutsr"]])
def test_of_streams_that_are_all_off_every_process_names_the_same(others):
    """The order of a set of texts is another one in every process."""
    offsets = StampOffsets(OffsetLimits(1.0))
    for now in range(START, START + 3 * SECOND, 50 * MS):
        offsets.note("joint_states", now, now)
        offsets.note("tracer_length", now - 4 * SECOND, now)
        for stream in ("probe_point", *others):
            offsets.note(stream, now + 3 * SECOND, now)
    first = min(["probe_point", *others])
    assert f"stamps of {first} are constantly 3.0 s ahead" in offsets.reason_to_reject()


def test_a_table_whose_clock_drifts_is_told_the_rate_of_its_own_clock():
    """The table's stamps run 2 % slow: its clock falls behind by 20 ms in a second."""
    text = drifting(-0.02, 0.0)
    assert "the stamps of joint_states" in text
    assert "it drifts, by -20 ms in a second" in text
    assert "topics.table_clock: sent" in text


def test_single_shots_of_a_bag_are_held_against_the_table_as_live_ones():
    offsets = StampOffsets(OffsetLimits(1.0))
    for second in range(10):
        now = START + second * SECOND + np.arange(0, 1000, 20) * MS
        offsets.note_many("joint_states", now, now)
        offsets.note_many("tracer_length", now[40:41] - 4 * SECOND, now[40:41])
    assert "stamps of tracer_length are constantly 4.0 s behind" in offsets.reason_to_reject()


def offsets_of(off_s, *, seconds, many, scale=1.0, ahead_s=2.0):
    offsets = StampOffsets(OffsetLimits(2.0, ahead_s))
    for second in range(seconds):
        now = START + second * SECOND + np.arange(0, 1000, 20) * MS
        stamps = START + ((now - START) * scale).astype(np.int64)
        for stream, at in (
            ("joint_states", stamps), ("tracer_length", stamps + round(off_s * SECOND))
        ):  # fmt: skip
            if many:
                offsets.note_many(stream, at, now)
            else:
                for pair in zip(at.tolist(), now.tolist(), strict=True):
                    offsets.note(stream, *pair)
    return offsets


def doubted(*arguments, **keywords):
    offsets = offsets_of(*arguments, **keywords)
    assert offsets.reason_to_reject() is None
    return offsets.doubt()


@pytest.mark.parametrize("many", [False, True])
def test_a_lasting_offset_below_the_limit_is_told_with_what_to_state(many):
    text = doubted(1.5, seconds=4, many=many)
    assert "tracer_length are constantly 1.50 s ahead of those of joint_states" in text
    assert "nothing is rejected for so little" in text
    assert text.endswith("add 1.50 to topics.length_clock_offset_s")
    assert doubted(0.19, seconds=4, many=many) is None
    assert doubted(1.5, seconds=1, many=many) is None  # it may be over in a moment
    assert doubted(1.5, seconds=4, many=many, scale=20.0) is None


@pytest.mark.parametrize("many", [False, True])
def test_lengths_said_to_be_later_by_more_than_settling_are_rejected_once_that_lasts(many):
    settings = CaptureSettings(settle_time_s=0.5)
    allowed_s = OffsetLimits.of(settings).ahead_s
    assert allowed_s == 0.5
    offsets = offsets_of(0.8, seconds=4, many=many, ahead_s=allowed_s)
    text = offsets.reason_to_reject()
    assert "tracer_length are constantly 0.80 s ahead of those of joint_states" in text
    assert "more than the 0.5 s of settling (capture.settle_time_s)" in text
    assert text.endswith("add 0.80 to topics.length_clock_offset_s")
    assert is_clock_rejection(text)
    assert offsets.doubt() is None
    assert offsets_of(0.8, seconds=1, many=many, ahead_s=allowed_s).reason_to_reject() is None
    assert doubted(0.4, seconds=4, many=many, ahead_s=allowed_s)
    # what is said to be earlier was taken in the same rest
    assert "0.80 s behind" in doubted(-0.8, seconds=4, many=many, ahead_s=allowed_s)


def test_an_estimate_is_not_trusted_below_what_arrivals_tell():
    assert OffsetLimits.of(CaptureSettings(settle_time_s=0.01)).ahead_s == DOUBT_S


def test_what_is_asked_may_answer_late_and_a_probe_knows_no_settling():
    offsets = StampOffsets(OffsetLimits(2.0, 0.5))
    for second in range(10):
        now = START + second * SECOND + np.arange(0, 1000, 20) * MS
        offsets.note_many("joint_states", now, now)
        offsets.note_many("probe_point", now + round(0.8 * SECOND), now)
        offsets.note("tracer_length", int(now[0]) + round(0.8 * SECOND), int(now[0]))
    assert offsets.reason_to_reject() is None
    assert "stamps of probe_point are constantly 0.80 s ahead" in offsets.doubt()
