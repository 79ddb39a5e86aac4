"""The capture at its limits, to the nanosecond, and all that it counts and says."""

from dataclasses import replace

import numpy as np
import pytest
from capture_scenes import (
    MS,
    RULES,
    SECOND,
    SETTINGS,
    make_plan,
    make_scene,
    probe_sample,
    replay,
    table_off,
)

from rotcal_ros.capture import Capture
from rotcal_ros.foundation.observations import (
    LengthStatus,
    PointKind,
    TableSample,
    TemperatureSample,
)

PLAN = make_plan()
BEGIN = 150 * MS
"""When the probe of the first step is there; the deadline is 0.6 s later."""


def observed(scene, settings=SETTINGS, plan=PLAN):
    """The only observation; every stream is there before the probe says anything."""
    streams = (*scene.tracer, *scene.table, *scene.temperature, *scene.probe)
    (observation,) = replay(plan, streams, settings)
    return observation


# Deadlines.


@pytest.mark.parametrize(("settle_s", "accepted"), [(0.580999999, True), (0.581, False)])
def test_the_last_reading_may_be_at_the_deadline(settle_s, accepted):
    """At rest from 150 ms + 1 ns; the readings of 731 .. 750 ms are the last twenty in time.

    Settled at 731 ms to the nanosecond the one stamped so counts; a nanosecond later it does not.
    """
    found = observed(make_scene(PLAN, 1), replace(SETTINGS, settle_time_s=settle_s))
    assert found.accepted is accepted
    if accepted:
        assert (found.window_start_ns, found.window_end_ns) == (731 * MS, 750 * MS)
    else:
        assert found.reason.startswith(
            "only 19 of 20 tracer readings in the 0.019 s remaining after settling"
        )


@pytest.mark.parametrize(("timeout_s", "at_rest"), [(0.600000001, True), (0.6, False)])
def test_the_table_may_arrive_at_the_deadline_though_it_helps_nobody(timeout_s, at_rest):
    """The first feedback at rest is stamped 750 ms + 1 ns."""
    scene = make_scene(PLAN, 1)
    scene.edit("table", table_off(50.0), 0, 750 * MS)
    reason = observed(scene, replace(SETTINGS, step_timeout_s=timeout_s)).reason
    if at_rest:
        assert reason == (
            "only 0 of 20 tracer readings in the 0 s remaining after settling; the next is "
            "stamped 0.001 s after settling (another clock?)"
        )
    else:
        assert reason.startswith("table not at rest in position for a whole window within 0.6 s")


def test_readings_of_another_clock_are_told():
    scene = make_scene(PLAN, 1)
    scene.edit("tracer", lambda _: None, 200 * MS, 900 * MS)
    assert observed(scene).reason == (
        "only 0 of 20 tracer readings in the 0.55 s remaining after settling; the next is "
        "stamped 0.7 s after settling (another clock?)"
    )


@pytest.mark.parametrize(("after_ns", "accepted"), [(0, False), (1, True)])
def test_a_window_ends_before_the_next_attempt_begins(after_ns, accepted):
    """The readings of 201 .. 220 ms are the window."""
    scene = make_scene(PLAN, 1)
    scene.probe.append(probe_sample(PLAN.steps[0], 220 * MS + after_ns, attempt=1))
    first, second = replay(PLAN, [*scene.probe, *scene.tracer, *scene.table, *scene.temperature])
    assert (first.accepted, second.accepted) == (accepted, True)
    assert accepted or first.reason.startswith("only 19 of 20 tracer readings in the 0.02 s")


@pytest.mark.parametrize(("pause_s", "accepted"), [(0.01, True), (0.0099, False)])
def test_feedback_every_ten_milliseconds_is_no_silence_of_ten(pause_s, accepted):
    found = observed(make_scene(PLAN, 1), replace(SETTINGS, table_silence_s=pause_s))
    assert found.accepted is accepted


POINTS = make_plan(PointKind.CENTRE, n_points=2)


def two_points(last_ns, more=0):
    scene = make_scene(POINTS, 1)
    scene.probe = [
        probe_sample(POINTS.steps[0], stamp, point=point)
        for point, stamp in enumerate([BEGIN, last_ns, *(last_ns + k + 1 for k in range(more))])
    ]
    return scene


@pytest.mark.parametrize(("after_ns", "accepted"), [(0, True), (1, False)])
def test_the_last_point_may_be_at_the_deadline(after_ns, accepted):
    found = observed(two_points(BEGIN + 600 * MS + after_ns), plan=POINTS)
    assert found.accepted is accepted
    assert found.reason == ("" if accepted else "only 2 of 2 probe points within 0.6 s")
    if accepted:
        assert (found.n_samples, found.n_used) == (2, 2)
        assert (found.window_start_ns, found.window_end_ns) == (BEGIN, BEGIN + 600 * MS)


@pytest.mark.parametrize("more", [1, 3])
def test_points_beyond_those_planned_are_left_out_and_counted(more):
    capture = Capture(POINTS, SETTINGS, RULES)
    found = [o for r in two_points(BEGIN + MS, more).probe for o in capture.feed(r)]
    assert found == []
    (attempt,) = capture._pending
    assert len(attempt.samples) == 2
    assert capture.counts["probe"] == {"received": 2 + more, "duplicates": more}
    capture.feed(probe_sample(POINTS.steps[0], BEGIN + 9 * MS, point=1))
    assert capture.counts["probe"]["duplicates"] == more + 1


def test_a_point_that_is_refused_refuses_the_attempt_with_the_first_reason():
    scene = two_points(BEGIN + MS)
    scene.probe[1] = replace(scene.probe[1], target=7)
    assert observed(scene, plan=POINTS).reason.startswith("probe reports CENTRE at target 7")


# Silence, other clocks, temperature.


@pytest.mark.parametrize(("after_ns", "rejected"), [(0, False), (1, True)])
def test_a_stream_may_be_behind_by_the_tolerance(after_ns, rejected):
    """The tracer is silent; the table comes to 0.4 s after the probe's begin."""
    capture = Capture(PLAN, replace(SETTINGS, clock_tolerance_s=0.4), RULES)
    temperature = TemperatureSample(BEGIN, "air", 20.0)
    assert capture.feed(temperature) == ()
    assert capture.feed(probe_sample(PLAN.steps[0], BEGIN)) == ()
    assert capture.feed(TableSample(BEGIN + MS, 0.0, 0.0)) == ()
    found = capture.feed(TableSample(BEGIN + 400 * MS + after_ns, 0.0, 0.0))
    words = "tracer readings are 0.4 s behind the other streams, allowed 0.4 s: silent, or "
    words += "stamped by another clock; none has come yet"
    assert [o.reason for o in found] == ([words] if rejected else [])


@pytest.mark.parametrize(("after_ns", "found"), [(0, 21.5), (1, None)])
def test_a_temperature_may_be_away_by_the_tolerance(after_ns, found):
    """The first observation takes the first temperature after its begin."""
    scene = make_scene(PLAN, 1)
    scene.temperature = [TemperatureSample(BEGIN + 500 * MS + after_ns, "air", 21.5)]
    observation = observed(scene, replace(SETTINGS, clock_tolerance_s=0.5))
    assert observation.accepted
    assert observation.temperature_c == found


def test_a_temperature_at_the_very_stamp_counts_and_the_one_after_does_not():
    """The second step begins at 1150 ms and reads the temperature 0.3 s before that."""
    for shift, expected in ((0, 2.0), (1, 1.0)):
        scene = make_scene(PLAN, 2)
        stamps = [BEGIN, 840 * MS, 850 * MS + shift, 900 * MS]
        scene.temperature = [
            TemperatureSample(stamp, "air", float(k)) for k, stamp in enumerate(stamps)
        ]
        _, second = replay(PLAN, scene.by_stamp())
        assert second.temperature_c == expected


def test_nothing_to_remark_when_every_temperature_comes():
    capture = Capture(PLAN, SETTINGS, RULES)
    for record in make_scene(PLAN, 3).by_stamp():
        capture.feed(record)
    assert capture.remarks() == ()


# Memory, numbers, words.


def test_the_run_goes_into_the_observations():
    for run in (0, 3):
        capture = Capture(PLAN, SETTINGS, RULES, *([run] if run else []))
        found = [o for r in make_scene(PLAN, 1).by_stamp() for o in capture.feed(r)]
        assert [o.run for o in found] == [run]


def test_what_is_waited_for_and_how_long_already():
    """Table feedback has come to 990 ms + 1 ns, the tracer has said nothing since 150 ms."""
    capture = Capture(PLAN, SETTINGS, RULES)
    scene = make_scene(PLAN, 1)
    for record in (*scene.temperature, *scene.table, *scene.probe):
        capture.feed(record)
    assert capture.waiting_for == (
        "table position 0, target 0: waiting for tracer readings, now 0.84 s behind the other "
        "streams"
    )
    for record in scene.tracer:
        capture.feed(record)
    assert capture.waiting_for is None


@pytest.mark.parametrize(("away", "accepted"), [(0.125, True), (np.nextafter(0.125, 1.0), False)])
def test_the_probe_may_be_away_by_its_tolerance(away, accepted):
    scene = make_scene(PLAN, 1)
    scene.probe = [replace(scene.probe[0], position=(0.0, away, 1.0))]
    found = observed(scene, replace(SETTINGS, probe_tolerance_m=0.125))
    assert found.accepted is accepted
    assert accepted or found.reason == (
        f"probe is 0.125 m from target 0: reported {(0.0, away, 1.0)}, planned (0.0, 0.0, 1.0), "
        "allowed 0.125 m"
    )


def test_other_points_than_reflectors_may_be_anywhere():
    plan = make_plan(PointKind.NEST)
    scene = make_scene(plan, 1)
    scene.probe = [replace(scene.probe[0], position=(9.0, 9.0, 9.0))]
    assert observed(scene, plan=plan).accepted


def fed(*records, settings=SETTINGS):
    capture = Capture(PLAN, settings, RULES)
    reasons = [o.reason for record in records for o in capture.feed(record)]
    return capture, reasons


def probes(n, **changes):
    """``n`` attempts at step 4, a millisecond apart, each with its own mistake."""
    return [
        replace(probe_sample(PLAN.steps[4], BEGIN + k * MS, attempt=k), **changes)
        for k in range(n)
    ]


@pytest.mark.parametrize(
    ("changes", "name", "words"),
    [
        ({"step": 9}, "unknown_step", None),
        ({"step": -1}, "unknown_step", None),
        ({"position": (np.inf, 0.0, 0.0)}, "non_finite", "probe position is not finite: (inf, 0"),
        ({"target": 7}, "off_plan", "probe reports REFLECTOR at target 7, the plan says REFLECT"),
        ({"kind": PointKind.NEST}, "off_plan", "probe reports NEST at target 1, the plan says R"),
        ({"station": 5}, "off_plan", "probe reports station 5, the plan says station 0"),
        ({"position": (0.0, 0.0, 0.0)}, "implausible", "probe is 1.0198 m from target 1: report"),
        ({"attempt": 0}, "duplicates", None),
    ],
)
def test_probe_samples_that_are_wrong_are_counted_one_by_one(changes, name, words):
    capture, reasons = fed(*probes(3, **changes))
    expected = {"received": 3, name: 2 if name == "duplicates" else 3}
    assert capture.counts["probe"] == expected
    if words is None:
        assert reasons == []
    else:
        assert len(reasons) == 3
        assert all(reason.startswith(words) for reason in reasons)


def test_answers_to_earlier_attempts_are_counted_one_by_one():
    late = [probe_sample(PLAN.steps[0], BEGIN + k * MS, attempt=0) for k in (9, 10, 11)]
    capture, _ = fed(*(probe_sample(PLAN.steps[0], BEGIN + k * MS, attempt=k) for k in (0, 1)),
                     *late)  # fmt: skip
    assert capture.counts["probe"] == {"received": 5, "duplicates": 3}


def test_stamps_that_go_back_or_stand_are_counted_one_by_one():
    stamps = [BEGIN, BEGIN, BEGIN - 250 * MS, BEGIN - 500 * MS]
    capture, reasons = fed(*(probe_sample(PLAN.steps[k], stamp) for k, stamp in enumerate(stamps)))
    assert capture.counts["probe"] == {"received": 4, "backwards": 3}
    assert reasons == []  # the first one still waits
    first, *others = [a.rejected for a in capture._pending]
    assert first is None
    assert [str(error)[: len("probe stamps go backwards: 0.25 s")] for error in others] == [
        "probe stamps go backwards: 0 s be", "probe stamps go backwards: 0.25 s",
        "probe stamps go backwards: 0.25 s",
    ]  # fmt: skip


def test_commands_are_counted_and_compared_with_the_plan():
    """The first and the last step are in the plan, the ones beside them are not."""
    good = [PLAN.steps[k].command(attempt) for k, attempt in ((0, 0), (8, 2), (0, 1))]
    off = [replace(good[0], table_angle=0.1), replace(good[1], target=0)]
    unknown = [replace(good[0], step=step) for step in (-1, 9, 10)]
    capture, _ = fed(*good, *off, *unknown)
    assert capture.counts["command"] == {
        "received": 8, "off_plan": 2, "unknown_step": 3, "unanswered": 4,
    }  # fmt: skip
    texts = capture.remarks()
    assert texts[0] == (
        f"the command for step 0 is not the plan's: found {off[0]}, expected {good[0]}"
    )
    assert texts[1].endswith(f"found {off[1]}, expected {good[1]}")
    assert texts[2:] == tuple(
        f"a command for step {step}, which is not in the plan: it has the steps 0 to 8"
        for step in (-1, 9, 10)
    )


def test_a_hundred_remarks_are_kept():
    capture, _ = fed(*(replace(PLAN.steps[0].command(0), step=100 + k) for k in range(150)))
    texts = capture.remarks()
    assert len(texts) == 100
    assert texts[0].startswith("a command for step 150, ")


def test_temperatures_that_are_no_numbers_are_counted_one_by_one():
    samples = [TemperatureSample(k * MS, "air", value) for k, value in
               enumerate([np.nan, 20.0, np.inf, np.nan])]  # fmt: skip
    capture, _ = fed(*samples)
    assert capture.counts["temperature"] == {"received": 4, "non_finite": 3}


def test_no_numbers_in_the_feedback_are_counted_in_every_lot():
    capture = Capture(PLAN, SETTINGS, RULES)
    for k in range(3):
        capture.feed(TableSample(2 * k * MS, np.nan, 0.0))
        capture.feed(TableSample((2 * k + 1) * MS, 0.0, 0.0))
        assert capture.counts["table"] == {"received": 2 * k + 2, "non_finite": k + 1}


@pytest.mark.parametrize(("attempts", "given_up"), [(64, 0), (65, 1), (66, 2)])
def test_sixty_four_attempts_may_wait(attempts, given_up):
    _, reasons = fed(*(probe_sample(PLAN.steps[0], BEGIN + k, attempt=k) for k in range(attempts)))
    assert reasons == ["not decided before 64 later attempts started"] * given_up


@pytest.mark.parametrize(("back_ns", "lost"), [(0, True), (1, True), (-1, False)])
def test_what_memory_has_let_go_is_told_to_the_nanosecond(back_ns, lost):
    """The newest feedback that was forgotten is as old as the first point, or older."""
    plan = make_plan(PointKind.CENTRE)
    scene = make_scene(plan, 1)
    capture = Capture(plan, SETTINGS, RULES)
    table = capture._streams.table
    for record in (*scene.temperature, *scene.table):
        capture.feed(record)
    table.flush()
    table.forgotten = BEGIN + back_ns
    (found,) = capture.feed(scene.probe[0])
    assert found.accepted is not lost
    if lost:
        assert found.reason == "table feedback from the time of the points has left memory"


def test_streams_that_were_fed_late_are_read_to_the_end():
    """All four streams one after the other, the probe first: as by stamp."""
    scene = make_scene(PLAN, 3)
    late = replay(PLAN, (*scene.probe, *scene.temperature, *scene.tracer, *scene.table))
    assert late == replay(PLAN, scene.by_stamp())
    assert [o.window_start_ns for o in late] == [201 * MS + k * SECOND for k in range(3)]


def test_an_attempt_without_a_window_has_no_numbers():
    """It stands where the probe was, at the time at which it came there."""
    (sample,) = probes(1, station=5)
    capture = Capture(PLAN, SETTINGS, RULES)
    (found,) = capture.feed(sample)
    assert (found.n_samples, found.n_used) == (0, 0)
    assert (found.mean, found.std, found.scatter) == ((), (), ())
    assert (found.window_start_ns, found.window_end_ns) == (BEGIN, BEGIN)
    assert (found.step, found.attempt, found.accepted) == (4, 0, False)
    assert found.probe_position == sample.position
    assert found.temperature_c is None
    assert np.isnan(found.table_angle_measured)


def test_one_point_has_the_deviation_that_the_machine_states():
    plan = make_plan(PointKind.NEST)
    found = observed(make_scene(plan, 1), plan=plan)
    assert found.std == found.scatter == (1e-6, 2e-6, 3e-6)
    assert (found.n_samples, found.n_used) == (1, 1)


def test_faults_of_readings_are_counted_over_all_lots():
    capture = Capture(PLAN, SETTINGS, RULES)
    ok, broken, unstable = (int(LengthStatus[n]) for n in ("OK", "BEAM_BROKEN", "UNSTABLE"))
    status = np.array([ok, broken, unstable, unstable, 77, 77, 77, ok, ok, ok])
    length = np.array([1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 30.0, np.nan, np.inf])
    for lot in range(2):
        stamps = (10 * lot + np.arange(10)) * MS
        capture.feed_tracer(stamps, 10 * lot + np.arange(10), length, status)
        assert capture.counts["tracer"] == {
            name: (lot + 1) * n
            for name, n in {"received": 10, "beam_broken": 1, "unstable": 5, "implausible": 1,
                            "non_finite": 2}.items()
        }  # fmt: skip
