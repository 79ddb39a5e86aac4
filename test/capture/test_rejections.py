"""Why attempts were rejected: said once per kind, the commonest first, and when to give up."""

from dataclasses import replace

import pytest
from capture_scenes import make_plan

from rotcal_ros.capture.rejections import (
    FailedSteps,
    MostFrequentReason,
    Rejections,
    TooManyFailedError,
    reason_kind,
)
from rotcal_ros.capture.window import BEAM_BROKEN
from rotcal_ros.foundation.language import phrase

ACCEPTED = make_plan().steps[0].observed((0.1,))


def rejected(reason, step=0, attempt=0):
    """A policy measures steps in any order: the number of one, here 600 and more, says nothing."""
    return replace(
        ACCEPTED, step=600 + step, table_position=step, target=7, attempt=attempt,
        accepted=False, reason=reason,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("one", "other"),
    [
        ("only 3 of 20 readings usable", "only 17 of 20 readings usable"),
        ("drifting: +2.5 um, allowed 2 um", "drifting: +1e-07 um, allowed 2 um"),
        ("1.2e+03 arcsec off", "7 arcsec off"),
    ],
)
def test_a_kind_is_a_reason_without_its_numbers(one, other):
    assert reason_kind(one) == reason_kind(other)
    assert reason_kind(one) != reason_kind("the table moved")


def test_a_kind_is_a_code_with_the_names_in_it():
    def off(target, why, far):
        return phrase("{0} at target {1}, {2:.3g} m off", phrase(why), target, far)

    assert reason_kind(off(1, "gone", 0.1)) == reason_kind(off(22, "gone", 3.0))
    assert reason_kind(off(1, "gone", 0.1)) != reason_kind(off(1, "turned", 0.1))


def test_the_commonest_reason_with_its_latest_example():
    found = MostFrequentReason.of(["table 3 off", "beam broken", "table 4 off"])
    assert found == MostFrequentReason("table 4 off", 2, 3)
    assert found.describe() == "2 of 3 like this: table 4 off"
    assert MostFrequentReason.of([]) is None


def test_a_new_kind_is_told_at_once_and_a_known_one_now_and_then():
    rejections = Rejections()
    lines = [
        rejections.note(rejected(reason, step, attempt), now_s)
        for now_s, step, attempt, reason in (
            (0.0, 4, 0, "beam broken"),
            (1.0, 4, 1, "beam broken"),
            (2.0, 4, 2, "drifting: 3 um"),
            (9.0, 5, 0, "beam broken"),
            (10.5, 5, 1, "beam broken"),
        )
    ]
    assert lines == [
        "table position 4, target 7 rejected: beam broken",
        None,
        "table position 4, target 7 (attempt 3) rejected: drifting: 3 um",
        None,
        "table position 5, target 7 (attempt 2) rejected: beam broken "
        "(and 2 more like this since the last line)",
    ]


def test_three_running_are_an_alarm_and_an_accepted_one_ends_it():
    rejections = Rejections()
    alarms = []
    for number in range(3):
        rejections.note(rejected("beam broken", attempt=number), 0.0)
        alarms.append(rejections.is_alarming)
    assert alarms == [False, False, True]
    assert rejections.describe() == "3 attempts rejected in a row, 3 of 3 like this: beam broken"
    rejections.note(ACCEPTED, 1.0)
    assert not rejections.is_alarming
    assert rejections.describe() is None


def given_up_at(limit, reasons):
    failed = FailedSteps(limit)
    for step, why in enumerate(reasons):
        failed.note(step, why)
        try:
            failed.check()
        except TooManyFailedError as error:
            return step, str(error)
    return None


def test_so_many_steps_running_and_the_calibration_is_given_up_with_the_commonest_reason():
    step, text = given_up_at(3, [(), ("a 1", "a 2"), ("b", "a 3"), ("a 4", "a 5")])
    assert step == 3
    assert "3 steps running failed" in text
    assert "5 of 6 like this: a 5" in text
    assert "rotcal run --resume" in text
    assert "planner.max_failed_steps = 3" in text


def test_a_captured_step_between_them_begins_the_count_anew_and_0_is_for_ever():
    assert given_up_at(3, [("a",), ("a",), (), ("a",), ("a",)]) is None
    assert given_up_at(0, [("a",)] * 1000) is None


def test_a_fixture_in_the_beam_may_hide_ten_times_as_many():
    broken = phrase("{0} {1}", 20, phrase(BEAM_BROKEN))
    hidden = (phrase("only {0} of {1} readings usable: {2}", 0, 20, broken),)
    assert given_up_at(3, [hidden] * 29) is None
    assert given_up_at(3, [hidden] * 40)[0] == 29
    assert given_up_at(3, [hidden, hidden, ("a",), hidden, ("a",), ("a",)])[0] == 5
