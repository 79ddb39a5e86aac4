"""Lengths of a table that turns: the cubic through readings, and what makes it no length."""

from dataclasses import replace

import numpy as np
import pytest
from capture_scenes import MS, SECOND

from rotcal_ros.capture import Capture, CaptureRules, CaptureSettings
from rotcal_ros.capture.decisions import decide_length
from rotcal_ros.capture.passage import FittedCurve
from rotcal_ros.foundation.observations import (
    Approach,
    LengthStatus,
    PointKind,
    TableSample,
    TracerSample,
    Turn,
)
from rotcal_ros.planning.plan import Plan, Step

DEG, UM = np.pi / 180.0, 1e-6
TARGET = (0.45, 0.1, 0.6)
SPEED = 12.0  # deg/s
START = 1000 * SECOND
SETTINGS = CaptureSettings(temperature_expected=False)
RULES = CaptureRules({PointKind.REFLECTOR: decide_length})


def plan_of(count=20, begin=0.0, speed=SPEED, passing=0.5):
    """Return a plan of one turn past ``count`` angles a degree apart."""
    angles = [(begin + k) * DEG for k in range(count)]
    ends = [angles[0] - 5.0 * DEG, angles[-1] + 5.0 * DEG]
    sense = 1 if speed > 0 else -1
    turn = Turn(*ends[::sense], speed * DEG)
    side = Approach.POSITIVE if speed > 0 else Approach.NEGATIVE
    steps = tuple(
        Step(index, k, angles[k], side, PointKind.REFLECTOR, 0, TARGET, turn=turn,
             passing=passing * DEG)
        for index, k in enumerate(list(range(count))[::sense])
    )  # fmt: skip
    return Plan("test", tuple(angles), (TARGET,), steps)


def distance(angle):
    """From a tracer 65 mm off the axis, m; its zero is at 0.3 m."""
    x, y = 0.065 * np.cos(angle + 0.4), 0.065 * np.sin(angle + 0.4)
    return np.sqrt((TARGET[0] - x) ** 2 + (TARGET[1] - y) ** 2 + (TARGET[2] - 0.2) ** 2) - 0.3


def scene(plan, noise=0.0, lasting_s=None, seed=1):
    """Return the answer, the feedback and the readings of a turn of a plan."""
    turn = plan.steps[0].turn
    lasting = lasting_s or abs((turn.end - turn.begin) / turn.speed)
    rng = np.random.default_rng(seed)
    fed = np.arange(0.0, lasting, 0.01)
    table = [
        TableSample(START + round(t * SECOND), turn.begin + turn.speed * t, turn.speed)
        for t in fed.tolist()
    ]
    read = np.arange(0.0013, lasting, 0.001)
    lengths = distance(turn.begin + turn.speed * read) + noise * rng.standard_normal(len(read))
    tracer = [
        TracerSample(START + round(t * SECOND), k, length, noise, LengthStatus.OK)
        for k, (t, length) in enumerate(zip(read.tolist(), lengths.tolist(), strict=True))
    ]
    return plan.steps[0].command(0).answered(START + MS // 2, 0, TARGET), table, tracer


def captured(plan, answer, table, tracer, settings=SETTINGS):
    capture = Capture(plan, settings, RULES)
    records = sorted([answer, *table, *tracer], key=lambda record: record.stamp_ns)
    return [o for record in records for o in capture.feed(record)]


@pytest.mark.parametrize("speed", [SPEED, -SPEED])
def test_one_answer_makes_a_length_of_every_angle_that_a_turn_passes(speed):
    plan = plan_of(speed=speed)
    found = captured(plan, *scene(plan))
    assert [o.step for o in found] == list(range(20))
    for o in found:
        assert o.accepted, o.reason
        assert o.mean[0] == pytest.approx(distance(o.table_angle), abs=2e-12)
        assert (o.n_used, o.segment, o.attempt) == (83, 0, 0) or o.n_used == 84
        assert o.table_angle_measured == pytest.approx(o.table_angle, abs=0.01 * DEG)


def test_a_straight_line_or_the_mean_would_be_wrong():
    away = np.linspace(-0.5, 0.5, 83) * DEG
    angle = 180.0 * DEG
    lengths = distance(angle + away)
    errors = [
        abs(FittedCurve.through(away, lengths, k).value - distance(angle)) for k in (1, 2, 3)
    ]
    assert errors[0] > 0.2 * UM
    assert errors[2] < 2e-12


def test_the_curve_is_that_of_numpys_polynomials():
    rng = np.random.default_rng(3)
    x, y = rng.uniform(-0.02, 0.03, 60), rng.standard_normal(60)
    for degree in (1, 2, 3):
        curve = FittedCurve.through(x, y, degree)
        scaled, covariance = np.polyfit(x / 0.03, y, degree, cov=True)
        assert curve.value == pytest.approx(scaled[-1], rel=1e-9)
        assert curve.std == pytest.approx(np.sqrt(covariance[-1, -1]), rel=1e-9)
        assert curve.slope == pytest.approx(scaled[-2] / 0.03, rel=1e-9)
        assert curve.at(x) == pytest.approx(np.polyval(scaled, x / 0.03), rel=1e-8, abs=1e-10)
        assert curve.left == pytest.approx(y - curve.at(x), abs=1e-12)


def test_the_stated_scatter_is_that_of_white_readings():
    plan = plan_of(count=200)
    found = captured(plan, *scene(plan, noise=0.2 * UM))
    error = np.array([o.mean[0] - distance(o.table_angle) for o in found])
    std = np.array([o.std[0] for o in found])
    # a cubic has 9/4 of the variance of a mean in its middle
    assert std.mean() == pytest.approx(0.2 * UM * np.sqrt(9.0 / 4.0 / 83.0), rel=0.05)
    assert np.sqrt(np.mean((error / std) ** 2)) == pytest.approx(1.0, abs=0.2)


def test_spikes_and_some_lost_readings_do_no_harm():
    plan = plan_of()
    answer, table, tracer = scene(plan, noise=0.1 * UM)
    usual = captured(plan, answer, table, tracer)
    spoilt = [
        replace(each, length=each.length + 15.0 * UM * (k % 40 == 7))
        for k, each in enumerate(tracer)
        if not 700 <= k < 708
    ]
    found = captured(plan, answer, table, spoilt)
    assert all(o.accepted for o in found), {o.reason for o in found}
    away = np.array([a.mean[0] - b.mean[0] for a, b in zip(found, usual, strict=True)])
    assert np.abs(away).max() < 0.05 * UM


def test_few_readings_are_no_spikes_of_each_other():
    """A cubic through seven comes within nanometres of some of them, by chance."""
    plan = plan_of(count=200)
    answer, table, tracer = scene(plan, noise=0.2 * UM)
    found = captured(plan, answer, table, [
        replace(each, sequence=k) for k, each in enumerate(tracer[::12])
    ])  # fmt: skip
    assert {o.n_samples for o in found} <= {6, 7}
    assert all(o.accepted for o in found), {o.reason for o in found}
    error = np.array([o.mean[0] - distance(o.table_angle) for o in found])
    assert error.std() == pytest.approx(0.2 * UM * np.sqrt(9.0 / 4.0 / 7.0), rel=0.2)


def test_a_beam_that_breaks_is_no_length_and_begins_another_zero():
    plan = plan_of()
    answer, table, tracer = scene(plan)
    begin = 833  # at 5 deg of the turn, angle 5
    broken = [
        replace(each, status=LengthStatus.BEAM_BROKEN, length=np.nan)
        if begin <= k < begin + 150
        else replace(each, length=each.length + 1e-3 * (k >= begin + 150))
        for k, each in enumerate(tracer)
    ]
    found = captured(plan, answer, table, broken)
    assert [o.step for o in found] == list(range(20))
    refused = [o.step for o in found if not o.accepted]
    assert refused == [5, 6, 7]
    assert {o.reason for o in found if not o.accepted} == {"beam broken while the table passed"}
    assert {o.segment for o in found[:5]} == {0}
    assert {o.segment for o in found[8:]} == {2}
    assert found[12].mean[0] == pytest.approx(distance(found[12].table_angle) + 1e-3, abs=2e-12)


def test_too_many_lost_readings_are_told():
    plan = plan_of()
    answer, table, tracer = scene(plan)
    without = [each for k, each in enumerate(tracer) if not 840 <= k < 880]
    found = captured(plan, answer, table, without)
    assert [o.step for o in found if not o.accepted] == [5]
    assert found[5].reason == "34 readings lost while the table passed"  # the others at 6 deg


def test_what_arrives_late_or_in_pieces_changes_no_bit():
    plan = plan_of()
    answer, table, tracer = scene(plan, noise=0.2 * UM)
    usual = captured(plan, answer, table, tracer)
    late = [(r.stamp_ns + 900 * MS * isinstance(r, TableSample), r) for r in (*table, *tracer)]
    capture, found = Capture(plan, SETTINGS, RULES), []
    for _, record in sorted([(answer.stamp_ns, answer), *late], key=lambda each: each[0]):
        found += capture.feed(record)
    assert found == usual
    capture = Capture(plan, SETTINGS, RULES)
    found = list(capture.feed(answer))
    stamps, angles, velocities = (np.array(c) for c in zip(*(
        (s.stamp_ns, s.angle, s.velocity) for s in table), strict=True))  # fmt: skip
    found += capture.feed_table(stamps, angles, velocities)
    rows = [(s.stamp_ns, s.sequence, s.length, int(s.status)) for s in tracer]
    stamps, numbers, lengths, status = (np.array(c) for c in zip(*rows, strict=True))
    for piece in np.array_split(np.arange(len(stamps)), 3):
        found += capture.feed_tracer(stamps[piece], numbers[piece], lengths[piece], status[piece])
    assert found == usual


def test_a_turn_that_is_broken_off_and_made_again_says_nothing_of_what_it_did_not_pass():
    plan = plan_of()
    answer, table, tracer = scene(plan, lasting_s=1.0)  # stops at angle 7
    again_ns = 5 * SECOND

    def later(each):
        return replace(each, stamp_ns=each.stamp_ns + again_ns)

    stopped = [TableSample(START + k * 10 * MS, table[-1].angle, 0.0) for k in range(100, 500)]
    second = [list(map(later, stream)) for stream in scene(plan)[1:]]
    number = len(tracer)
    second[1] = [replace(each, sequence=each.sequence + number) for each in second[1]]
    anew = later(replace(answer, attempt=1, sequence=1))
    capture = Capture(plan, SETTINGS, RULES)
    records = [answer, *table, *stopped, *tracer, anew, *second[0], *second[1]]
    found = [o for r in sorted(records, key=lambda r: r.stamp_ns) for o in capture.feed(r)]
    assert all(o.accepted for o in found), {o.reason for o in found}
    assert [(o.step, o.attempt) for o in found] == [
        *((k, 0) for k in range(7)), *((k, 1) for k in range(20))
    ]  # fmt: skip


def test_an_angle_that_the_run_up_passes_too_counts_when_the_turn_comes_to_it():
    """Of a full circle, ordered from an angle near its end on: 356 deg is -4 deg."""
    whole = plan_of(count=360)
    answer, table, tracer = scene(whole)
    step = whole.steps[356]
    ordered = step.command(3).answered(answer.stamp_ns, 0, TARGET)
    found = captured(whole, ordered, table, tracer)
    assert [o.step for o in found] == [356, 357, 358, 359]
    assert found[0].window_start_ns > START + 29 * SECOND
    assert found[0].mean[0] == pytest.approx(distance(step.table_angle), abs=2e-12)
