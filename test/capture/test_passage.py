"""A table that turns passes its angles: what becomes of the readings on both sides of them.

One order begins a turn; a machine may name each angle of it, as for an order of its own, or not.
"""

from dataclasses import replace

import numpy as np
import pytest
from capture_scenes import MS, SECOND

from rotcal_ros.capture import Capture, CaptureRules, CaptureSettings
from rotcal_ros.capture.passage import decide_passage
from rotcal_ros.foundation.observations import Approach, PointKind, ProbeSample, TableSample, Turn
from rotcal_ros.planning.plan import Plan, Step

DEG = np.pi / 180
UM = 1e-6
ANGLES_DEG = (0.0, 30.0, 60.0)
RULES = CaptureRules({PointKind.READING: decide_passage})
SETTINGS = CaptureSettings(
    position_tolerance_arcsec=5.0, clock_tolerance_s=2.0, step_timeout_s=5.0,
    temperature_expected=False,
)  # fmt: skip
START = 1000 * SECOND
SLOPE = np.array([30.0, -50.0, 8.0]) * UM  # per radian, about another value at every angle


def turning_plan(speed_deg=20.0):
    """Return a plan that passes three angles, one way or the other, from 10 deg before."""
    sense = int(np.sign(speed_deg))
    begin, end = np.array([-10.0, 70.0][::sense]) * DEG
    turn = Turn(float(begin), float(end), speed_deg * DEG)
    steps = tuple(
        Step(
            index=k, table_position=position, table_angle=ANGLES_DEG[position] * DEG,
            approach=Approach.POSITIVE, kind=PointKind.READING, target=0, position=(0.1, 0.0, 0.0),
            turn=turn, passing=1.0 * DEG,
        )
        for k, position in enumerate(range(3)[::sense])
    )  # fmt: skip
    return Plan("test", tuple(np.array(ANGLES_DEG) * DEG), ((0.1, 0.0, 0.0),), steps)


def table(speed_deg, since_ns=START, rate_hz=100.0, lasting_s=6.0, shape=lambda time_s: 0.0):
    """Return feedback of a table that turns evenly from 10 deg before, but for ``shape`` (rad)."""
    begin = (-10.0 if speed_deg > 0 else 70.0) * DEG
    times = np.arange(0.0, lasting_s, 1.0 / rate_hz)
    return [
        TableSample(since_ns + round(t * SECOND), begin + speed_deg * DEG * t + shape(t), np.nan)
        for t in times.tolist()
    ]


def value_at(angle):
    """Return what the nest reads at an angle, rad: a straight line near each of the three."""
    nearest = DEG * min(ANGLES_DEG, key=lambda each: abs(each * DEG - angle))
    return np.array([3.0, -2.0, 1.0]) * UM * (1.0 + nearest) + SLOPE * (angle - nearest)


def readings(plan, answers, speed_deg, since_ns=START, rate_hz=200.0, noise=None, shape=None):
    """Return readings of a nest; ``answers``: (from s on, step, attempt), as they were ordered."""
    begin = (-10.0 if speed_deg > 0 else 70.0) * DEG
    samples = []
    for number, t in enumerate(np.arange(0.0021, 5.5, 1.0 / rate_hz).tolist()):
        _, index, attempt = max(each for each in answers if each[0] <= t)
        angle = begin + speed_deg * DEG * t + (shape(t) if shape else 0.0)
        place = value_at(angle) + (noise[number] if noise is not None else 0.0)
        step = plan.steps[index]
        samples.append(
            step.command(attempt).answered(since_ns + round(t * SECOND), number, tuple(place))
        )
    return samples


def captured(plan, *streams, settings=SETTINGS):
    capture = Capture(plan, settings, RULES)
    records = sorted((r for stream in streams for r in stream), key=lambda r: r.stamp_ns)
    return [o for record in records for o in capture.feed(record)]


IN_TURN = ((0.0, 0, 0), (0.8, 1, 0), (2.3, 2, 0))


@pytest.mark.parametrize("answers", [IN_TURN[:1], IN_TURN])
@pytest.mark.parametrize("speed_deg", [20.0, -20.0])
def test_a_straight_line_is_read_where_the_table_passes(speed_deg, answers):
    plan = turning_plan(speed_deg)
    found = captured(plan, table(speed_deg), readings(plan, answers, speed_deg))
    assert [o.step for o in found] == [0, 1, 2]
    for o in found:
        assert o.accepted, o.reason
        assert np.array(o.mean) == pytest.approx(value_at(o.table_angle), abs=1e-13)
        assert max(o.std) < 1e-13
        assert o.n_used == 20  # 2 deg at 20 deg/s, 200 a second
        times = np.arange(o.window_start_ns, o.window_end_ns + 1, 5 * MS) - START
        begin = (-10.0 if speed_deg > 0 else 70.0) * DEG
        mean = np.mean(begin + speed_deg * DEG * times / SECOND)
        assert o.table_angle_measured == pytest.approx(mean, abs=1e-9)
        middle = 0.5 * (o.window_start_ns + o.window_end_ns)
        passed_s = abs(o.table_angle / DEG - (-10.0 if speed_deg > 0 else 70.0)) / 20.0
        assert (middle - START) / SECOND == pytest.approx(passed_s, abs=0.01)


def test_the_stated_std_is_that_of_the_line_at_the_angle():
    """By numpy's polyfit of the same readings over the true angles."""
    plan, speed = turning_plan(), 20.0
    noise = 0.4 * UM * np.random.default_rng(5).standard_normal((2000, 3))
    read = readings(plan, IN_TURN, speed, noise=noise)
    for o in captured(plan, table(speed), read):
        away = np.array([-10.0 * DEG + speed * DEG * (r.stamp_ns - START) / SECOND for r in read])
        away -= o.table_angle
        near = np.abs(away) < 1.0 * DEG
        for axis in range(3):
            values = np.array([r.position[axis] for r in read])[near]
            (_, at_zero), covariance = np.polyfit(away[near] / DEG, values / UM, 1, cov=True)
            assert o.mean[axis] == pytest.approx(at_zero * UM, abs=1e-10)
            assert o.std[axis] == pytest.approx(np.sqrt(covariance[1, 1]) * UM, rel=1e-6)


def test_what_arrives_late_or_early_changes_nothing():
    plan, speed = turning_plan(), 20.0
    noise = 0.4 * UM * np.random.default_rng(6).standard_normal((2000, 3))
    streams = table(speed), readings(plan, IN_TURN, speed, noise=noise)
    in_time = captured(plan, *streams)
    capture = Capture(plan, SETTINGS, RULES)
    late = [(r.stamp_ns + 700 * MS * isinstance(r, TableSample), r) for s in streams for r in s]
    again = [o for _, r in sorted(late, key=lambda each: each[0]) for o in capture.feed(r)]
    assert again == in_time
    early = [(r.stamp_ns + 700 * MS * isinstance(r, ProbeSample), r) for s in streams for r in s]
    capture = Capture(plan, SETTINGS, RULES)
    assert [
        o for _, r in sorted(early, key=lambda each: each[0]) for o in capture.feed(r)
    ] == in_time


def test_another_attempt_asks_for_another_turn():
    plan, speed, again = turning_plan(), 20.0, START + 10 * SECOND
    spoiled = readings(plan, ((0.0, 0, 0), (0.8, 1, 0)), speed)
    del spoiled[395]  # one that was lost at 30 deg
    second = readings(plan, ((0.0, 1, 1),), speed, since_ns=again)
    resting = [TableSample(START + 6 * SECOND + k * 10 * MS, -10.0 * DEG, 0.0) for k in range(400)]
    found = captured(plan, table(speed), resting, table(speed, again), spoiled, second)
    assert [(o.step, o.attempt, o.accepted) for o in found] == [
        (0, 0, True), (1, 0, False), (2, 0, True), (1, 1, True), (2, 1, True)
    ]  # fmt: skip
    assert found[1].reason.startswith("1 readings lost while the table passed")
    assert found[3].window_start_ns > again


def uneven(t):
    """Return a swing of 20 arcsec, 10 times a second."""
    return 20.0 / 3600.0 * DEG * np.sin(2 * np.pi * 10.0 * t)


@pytest.mark.parametrize(
    ("spoil", "reason"),
    [
        ({"turns_deg": 20.5}, "the table passed at 20.5 deg/s, ordered 20, allowed 1.00% off"),
        ({"turns_deg": 19.5}, "the table passed at 19.5 deg/s, ordered 20, allowed 1.00% off"),
        ({"shape": uneven}, "arcsec off even motion, allowed 5"),
        (
            {"turns_deg": 1.0, "lasting_s": 8.0},
            "the table did not pass 0.0000 deg at about 20 deg/s within 5 s",
        ),
        ({"silent": True}, "the table's feedback paused for 1.11 s while it passed, allowed 1 s"),
        ({"nest_hz": 40.0}, "2 readings before 0.0000 deg and 2 behind it, expected 3"),
        ({"without": range(102, 110)}, "10 readings before 0.0000 deg and 2 behind it, expected"),
        ({"noise": 5.0}, "unstable: readings scatter by"),
        ({"numbers": (100, 1)}, "1 readings lost while the table passed"),
        ({"without": range(99, 104)}, "readings lost: a pause of 0.03 s, usually they are 0.005"),
        ({"value": np.nan}, "a reading is not a finite number"),
    ],
)
def test_a_passage_that_tells_nothing_is_refused_with_its_reason(spoil, reason):
    plan, turns = turning_plan(), spoil.get("turns_deg", 20.0)
    shape = spoil.get("shape", lambda _t: 0.0)
    noise = UM * spoil.get("noise", 0.0) * np.random.default_rng(7).standard_normal((2000, 3))
    read = readings(plan, ((0.0, 0, 0),), turns, rate_hz=spoil.get("nest_hz", 200.0), noise=noise)
    begin, by = spoil.get("numbers", (0, 0))
    read = [replace(r, sequence=r.sequence + by * (k >= begin)) for k, r in enumerate(read)]
    if left_out := spoil.get("without"):  # of an instrument that does not number its readings
        read = [r for k, r in enumerate(read) if k not in left_out]
        read = [replace(r, sequence=k) for k, r in enumerate(read)]
    if "value" in spoil:
        read[100] = replace(read[100], position=(spoil["value"], 0.0, 0.0))
    feedback = table(turns, lasting_s=spoil.get("lasting_s", 2.0), shape=shape)
    if spoil.get("silent"):
        feedback = [f for f in feedback if not 200 * MS < f.stamp_ns - START < 1310 * MS]
    found, *_ = captured(plan, feedback, read)
    assert not found.accepted
    assert reason in found.reason
    # where the table has come to the angle it passes those behind it, too
    assert np.isfinite(found.table_angle_measured) == ("did not pass" not in reason)


def test_an_angle_is_told_as_soon_as_it_is_passed():
    """At 1 deg behind it, after 0.55 s, and the next feedback."""
    plan = turning_plan()
    capture = Capture(plan, SETTINGS, RULES)
    records = [*table(20.0), *readings(plan, ((0.0, 0, 0),), 20.0)]
    told = [
        record.stamp_ns
        for record in sorted(records, key=lambda r: r.stamp_ns)
        if capture.feed(record)
    ]
    assert 0.55 <= (told[0] - START) / SECOND < 0.575


@pytest.mark.parametrize("rate_deg_s", [-45.0, -20.0, 90.0, 5.0])
def test_a_way_to_the_begin_is_no_passage(rate_deg_s):
    """Back past 0, or fast or slowly past it in the sense of the turn: angles may wrap around."""
    plan = turning_plan()
    back = [
        TableSample(START - SECOND + k * 10 * MS, rate_deg_s * (k / 100 - 0.5) * DEG, 0.0)
        for k in range(100)
    ]
    answered = plan.steps[0].command(0).answered(START - 1100 * MS, 0, (0.0, 0.0, 0.0))
    read = [replace(r, sequence=r.sequence + 1) for r in readings(plan, ((0.0, 0, 0),), 20.0)]
    found, *_ = captured(plan, back, table(20.0), [answered], read)
    assert found.accepted, found.reason
    assert np.array(found.mean) == pytest.approx(value_at(0.0), abs=1e-13)


def test_a_nest_that_falls_silent_ends_the_attempt():
    plan = turning_plan()
    read = [r for r in readings(plan, ((0.0, 0, 0),), 20.0) if r.stamp_ns < START + 500 * MS]
    (found,) = captured(plan, table(20.0), read)
    assert found.reason.startswith("readings beside the table are 2")


def test_what_a_nest_still_sends_for_an_earlier_run_begins_nothing():
    plan, later = turning_plan(), 1_000_000
    read = readings(plan, ((0.0, 0, 0), (0.3, 0, later), (0.8, 1, later), (2.3, 2, later)), 20.0)
    records = sorted([*table(20.0), *read], key=lambda r: r.stamp_ns)
    for heard_from in (0, 150 * MS):
        capture = Capture(plan, SETTINGS, RULES, run=1, first_attempt=later)
        found = [o for r in records if r.stamp_ns >= START + heard_from for o in capture.feed(r)]
        assert [(o.step, o.attempt, o.accepted) for o in found] == [
            (step, later, True) for step in range(3)
        ]


def complaints(plan, *streams, orders):
    """Return what the capture complains about at every whole second since the start.

    ``orders``: (s, step, attempt), as the planner gives them.
    """
    capture, said = Capture(plan, replace(SETTINGS, step_timeout_s=30.0), RULES), {}
    given = [(START + round(t * SECOND), plan.steps[k].command(a)) for t, k, a in orders]
    records = [(r.stamp_ns, r) for stream in streams for r in stream] + given
    for stamp_ns, record in sorted(records, key=lambda each: each[0]):
        capture.feed(record)
        said[(stamp_ns - START) // SECOND] = capture.current_fault()
    return said


def test_a_nest_that_names_an_earlier_order_is_told_after_three_seconds_of_turning():
    """Its first readings after an order may still name the one before: they were on their way."""
    plan = turning_plan()
    again = ((0.0, 0, 0), (0.8, 0, 1))
    sound = readings(plan, ((0.0, 0, 0), (1.1, 0, 1)), 20.0)
    assert not any(complaints(plan, table(20.0), sound, orders=again).values())
    mute = readings(plan, ((0.0, 0, 0),), 20.0)  # names attempt 0 for ever
    said = complaints(plan, table(20.0), mute, orders=again)
    assert not any(said[s] for s in range(3))
    assert "step 0, attempt 1: no point on probe_point answers the order" in said[4]
    assert "names step 0, attempt 0: the machine must echo both" in said[4]


def test_a_table_that_does_not_turn_as_ordered_is_told_after_three_seconds():
    plan, order = turning_plan(), ((0.0, 0, 0),)
    nest = readings(plan, order, 20.0)
    said = complaints(plan, table(1e-9), nest, orders=order)
    assert not any(said[s] for s in range(3))
    assert "the table stands still at -10.0000 deg, it was ordered to turn" in said[4]
    in_degrees = [replace(r, angle=np.degrees(r.angle)) for r in table(20.0)]
    said = complaints(plan, in_degrees, nest, orders=order)
    assert "turns at 20 rad/s where 20 deg/s were ordered: degrees?" in said[4]


def test_a_table_that_passes_the_other_way_is_called_reversed():
    plan = turning_plan()
    back = [replace(r, angle=-r.angle) for r in table(20.0, lasting_s=9.0)]
    (found,) = captured(plan, back, readings(plan, ((0.0, 0, 0),), 20.0))
    assert "it passed it the other way: is a sign wrong?" in found.reason
