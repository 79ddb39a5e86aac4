"""A machine that does not echo its orders is reported at once, live and from the bag."""

from dataclasses import replace

import pytest
from capture_scenes import MS, RULES, SECOND, SETTINGS, make_plan, make_scene, probe_sample

from rotcal_ros.capture import Capture
from rotcal_ros.capture.capture import OrderAnswers
from rotcal_ros.foundation.observations import PointKind, TableSample

PLAN = make_plan()


def order(step, attempt=0):
    return PLAN.steps[step].command(attempt)


def answer(step, attempt=0, kind=PointKind.REFLECTOR):
    return replace(probe_sample(PLAN.steps[step], 0, attempt), kind=kind)


def test_an_echo_answers_an_order_whichever_comes_first():
    answers = OrderAnswers()
    answers.order(order(0))
    assert "step 0, attempt 0: no point on probe_point" in answers.unanswered_order()
    assert answers.current_fault() is None
    answers.receive(answer(0))
    answers.receive(answer(1))  # faster than its order
    answers.order(order(1))
    assert answers.unanswered_order() is None
    assert answers.current_fault() is None
    assert answers.unanswered == 0


def test_an_unasked_point_answers_nothing():
    answers = OrderAnswers()
    answers.order(order(0))
    answers.receive(answer(0, kind=PointKind.UNKNOWN))
    assert answers.unanswered_order()
    assert not answers.current_fault()


def test_who_echoes_something_else_is_told_both():
    answers = OrderAnswers()
    answers.order(order(0, attempt=1))
    answers.receive(answer(0, attempt=0))
    assert "step 0, attempt 1: no point" in answers.current_fault()
    assert "names step 0, attempt 0: the machine must echo both" in answers.current_fault()
    answers.order(order(0, attempt=2))
    assert answers.unanswered == 1
    assert answers.current_fault() is None


def test_the_capture_counts_what_was_not_answered_and_says_it():
    capture = Capture(PLAN, SETTINGS, RULES)
    for step in range(3):  # the machine says step 0, attempt 0 every time
        capture.feed(order(step))
        capture.feed(probe_sample(PLAN.steps[0], (1 + step) * SECOND))
        if step == 0:
            for record in make_scene(PLAN, 1, start_ns=SECOND - 150 * MS).by_stamp():
                if record != probe_sample(PLAN.steps[0], SECOND):
                    capture.feed(record)
    assert capture.counts["command"] == {"received": 3, "unanswered": 1}
    assert capture.counts["probe"]["duplicates"] == 2
    assert "names step 0, attempt 0" in capture.current_fault()
    assert "names step 0, attempt 0" in capture.waiting_for


@pytest.mark.parametrize(
    ("moves_s", "turns_s", "told_s"),
    [(0.0, 0.0, 3), (0.0, 5.0, 8), (6.0, 0.0, 9), (60.0, 0.0, None)],
)
def test_a_machine_that_never_answers_is_told_once_table_and_probe_have_stood(
    moves_s, turns_s, told_s
):
    """Not while the one or the other is still on its way."""
    capture, step, said = Capture(PLAN, SETTINGS, RULES), PLAN.steps[1], {}
    away = step.table_angle + 0.5
    capture.feed(TableSample(0, away, 0.0))
    capture.feed(order(1))
    for t in range(1, 121):
        now_s = 0.1 * t
        turned = now_s >= turns_s
        capture.feed(TableSample(t * SECOND // 10, step.table_angle if turned else away, 0.0))
        place = (step.position[0] + 0.01 * max(0.0, moves_s - now_s), *step.position[1:])
        unasked = replace(answer(1, kind=PointKind.UNKNOWN), stamp_ns=t * SECOND // 10)
        capture.feed(replace(unasked, position=place))
        assert capture.counts  # a beat
        said[t // 10] = capture.current_fault()
    first = min((s for s, text in said.items() if text), default=None)
    assert first == told_s
    assert told_s is None or "table and probe stand still" in said[11]
