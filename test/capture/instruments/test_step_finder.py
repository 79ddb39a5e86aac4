"""Positions without steps: whichever stream arrives first, each becomes the step it stands at."""

import math
from dataclasses import replace
from itertools import permutations

import pytest

from rotcal_ros.capture import CaptureSettings
from rotcal_ros.capture.instruments.steps import Order, Position, StepFinder
from rotcal_ros.foundation.observations import Approach, PointKind, ProbeSample, TableSample, Turn
from rotcal_ros.planning.plan import Plan, Step

MS = 1_000_000
SETTINGS = CaptureSettings()


def plan_of(kind=PointKind.REFLECTOR, n_points=1, diameter=0.0):
    steps = tuple(
        Step(
            index=k, table_position=k, table_angle=angle, approach=Approach.POSITIVE, kind=kind,
            target=0, position=(1.0, 0.0, 0.0), n_points=n_points, ball_diameter=diameter,
        )
        for k, angle in enumerate((0.0, 1.0, 2.0))
    )  # fmt: skip
    return Plan(method="test", table_angles=(0.0, 1.0, 2.0), targets=(), steps=steps)


def answers(finder, records):
    found = (r for record in records for r in finder.understood(record))
    return [(s.step, s.attempt, s.stamp_ns, s.point) for s in found if isinstance(s, ProbeSample)]


def table(begin_ms, end_ms, angle, speed=0.0):
    return [TableSample(t * MS, angle, speed) for t in range(begin_ms, end_ms, 10)]


def turning_plan():
    """Return a plan whose table passes all angles in one turn."""
    plan, turn = plan_of(PointKind.READING), Turn(-1.0, 3.0, 0.5)
    return replace(plan, steps=tuple(replace(s, turn=turn, passing=0.1) for s in plan.steps))


def test_while_the_table_turns_every_reading_answers_the_last_order():
    """A reading is no place; one that is no number answers nothing, and is missed."""
    plan = turning_plan()
    turns = [TableSample(t * MS, -1.0 + 0.0005 * t, 0.5) for t in range(0, 900, 10)]
    nest = [Position(t * MS, (1e-6 * t, 0.0, 0.0)) for t in range(5, 400, 20)]
    nest[3] = Position(65 * MS, (math.nan, 0.0, 0.0))
    orders = [ordered(0, 0, 30, plan), ordered(1, 0, 200, plan)]
    records = sorted([*orders, *nest, *turns], key=lambda record: record.stamp_ns)
    found = answers(StepFinder(plan, SETTINGS, ordered=True), records)
    times = [t for t in range(45, 400, 20) if t != 65]
    assert [f[2] // MS for f in found] == times
    assert [f[0] for f in found] == [int(t > 200) for t in times]
    assert [f[3] for f in found] == [*range(7), *range(10)]


def test_a_reading_at_rest_is_no_place():
    plan = plan_of(PointKind.READING)
    records = [ordered(1, 0, 15, plan), Position(40 * MS, (1e-5, 0.0, 0.0)), *table(0, 500, 1.0)]
    assert answers(StepFinder(plan, SETTINGS), records) == [(1, 0, 40 * MS, 0)]


def ordered(step, attempt, stamp_ms, plan):
    return Order(plan.steps[step].command(attempt), stamp_ms * MS)


@pytest.mark.parametrize("late", [*permutations(("order", "probe"))])
def test_streams_that_interleave_otherwise_give_the_same_answer(late):
    plan = plan_of()
    probe = [Position(5 * MS, (1.0, 0.0, 0.0)), Position(212 * MS, (1.0, 0.0, 1e-5))]
    order = [ordered(1, 3, 100, plan)]
    motion = table(0, 200, 0.0) + table(200, 250, 0.5, 1.0) + table(250, 800, 1.0)
    queues = {"order": order, "probe": probe}
    records = [probe[0], *motion[:15]]
    for name in late:
        records += queues[name][-1:]
    found = answers(StepFinder(plan, SETTINGS), [*records, *motion[15:]])
    assert found == [(1, 3, 250 * MS, 0)]


def test_a_second_attempt_is_answered_from_its_order_on():
    plan = plan_of()
    finder = StepFinder(plan, SETTINGS)
    records = [Position(0, (1.0, 0.0, 0.0)), ordered(1, 0, 15, plan), *table(0, 500, 1.0)]
    records += [ordered(1, 1, 505, plan), *table(500, 1000, 1.0)]
    assert answers(finder, records) == [(1, 0, 20 * MS, 0), (1, 1, 510 * MS, 0)]


def test_an_order_by_a_far_off_clock_counts_from_when_it_comes():
    plan = plan_of()
    finder = StepFinder(plan, SETTINGS, ordered=True)
    records = [Position(0, (1.0, 0.0, 0.0)), *table(0, 500, 1.0), ordered(1, 0, 10**9, plan)]
    ((step, attempt, stamp_ns, _),) = answers(finder, [*records, *table(500, 1000, 1.0)])
    assert (step, attempt) == (1, 0)
    assert 480 * MS <= stamp_ns <= 510 * MS


def test_without_orders_the_plan_s_next_step_that_fits():
    finder = StepFinder(plan_of(), SETTINGS)
    records = [Position(0, (1.0, 0.0, 0.0)), *table(0, 300, 0.0), *table(300, 900, 2.0)]
    assert [a[0] for a in answers(finder, records)] == [0, 2]  # step 1 was left out


def test_touches_are_points_of_the_ordered_step_and_travel_is_none():
    plan = plan_of(PointKind.SURFACE, n_points=3, diameter=0.02)
    finder = StepFinder(plan, SETTINGS, tip_radius_m=0.002)
    touch = [(1.012, 0.0, 0.0), (1.0, 0.012, 0.0), (1.0, 0.0, 0.012)]
    places = [(2.0, 0.0, 0.0), touch[0], touch[1], (0.0, 0.0, 0.5), touch[2], touch[2]]
    records = [ordered(2, 0, 0, plan), *table(0, 100, 2.0)]
    for k, at in enumerate(places):
        records += [Position((100 + 20 * k) * MS, at), *table(100 + 20 * k, 120 + 20 * k, 2.0)]
    found = answers(finder, [*records, *table(220, 600, 2.0)])
    assert [(a[0], a[3]) for a in found] == [(2, 0), (2, 1), (2, 2)]
    assert [a[2] for a in found] == [120 * MS, 140 * MS, 180 * MS]


def test_a_probe_that_is_elsewhere_is_told():
    plan = plan_of()
    finder = StepFinder(plan, SETTINGS)
    records = [Position(0, (1000.0, 0.0, 0.0)), ordered(0, 0, 0, plan), *table(0, 3500, 0.0)]
    assert answers(finder, records) == []
    assert "999 m from where it was sent" in finder.current_fault()
    assert "1000 times as far; which is topics.position_unit?" in finder.current_fault()


@pytest.mark.parametrize(("single_shot", "at_ms", "x"), [(False, 200, 1.0), (True, 100, 0.9995)])
def test_a_reflector_within_its_tolerance_has_not_arrived_while_it_moves(single_shot, at_ms, x):
    plan = plan_of()
    finder = StepFinder(plan, SETTINGS, single_shot=single_shot)
    way = [(0, 0.5), (100, 0.9995), (150, 1.0), (200, 1.0), (250, 1.0)]  # ms, m
    records = [ordered(0, 0, 0, plan), *(Position(t * MS, (x, 0.0, 0.0)) for t, x in way)]
    found = [r for s in (*records, *table(0, 900, 0.0)) for r in finder.understood(s)]
    (answer,) = (r for r in found if isinstance(r, ProbeSample))
    assert (answer.stamp_ns, answer.position[0]) == (at_ms * MS, x)


def test_a_reflector_of_which_nothing_more_is_heard_has_arrived():
    plan = plan_of()
    finder = StepFinder(plan, SETTINGS)
    records = [ordered(0, 0, 0, plan), Position(0, (0.0, 0.0, 0.0)), Position(MS, (1.0, 0.0, 0.0))]
    assert answers(finder, [*records, *table(0, 2000, 0.0)]) == [(0, 0, 1010 * MS, 0)]


def test_travel_of_the_probe_is_no_complaint_until_it_stands():
    plan = plan_of()
    finder = StepFinder(plan, SETTINGS)
    answers(finder, [Position(0, (-4.0, 0.0, 0.0)), ordered(0, 0, 0, plan)])
    for t_ms in range(0, 4000, 50):  # on its way for 4 s, and then it stands at -2 m
        answers(finder, [Position(t_ms * MS, (-4.0 + 5e-4 * t_ms, 0.0, 0.0))])
        answers(finder, table(t_ms, t_ms + 50, 0.0))
        assert finder.current_fault() is None
    answers(finder, table(4000, 8000, 0.0))
    assert "m from where it was sent" in finder.current_fault()


def test_a_table_that_never_says_it_is_there_is_named_with_its_unit():
    plan = plan_of()
    finder = StepFinder(plan, SETTINGS)
    records = [Position(0, (1.0, 0.0, 0.0)), ordered(1, 0, 0, plan)]
    answers(finder, [*records, *table(0, 2000, 0.5, 0.1)])
    assert finder.current_fault() is None
    answers(finder, table(2000, 6000, math.radians(1.0)))  # 1 rad, read as degrees
    found = finder.current_fault()
    assert "step 1: the last feedback is" in found
    assert "in position if its 1 are radians, not degrees: see topics.angle_unit" in found


def test_a_position_that_is_no_number_is_none():
    finder = StepFinder(plan_of(), SETTINGS)
    records = [Position(0, (math.nan, 0.0, 0.0)), *table(0, 500, 0.0)]
    assert answers(finder, records) == []
