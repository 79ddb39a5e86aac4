"""When a goal is given up: never where what was measured can still be solved."""

import asyncio
from dataclasses import replace
from types import SimpleNamespace

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("rotcal_msgs")

from rotcal_ros.methods import prepare
from rotcal_ros.methods.configuration import dump_configuration, parse_configuration
from rotcal_ros.methods.continuation import Continuation
from rotcal_ros.nodes.planner.cell_links import CellLinks
from rotcal_ros.nodes.planner.goal_watch import Codes, GoalError, StepInterruptedError
from rotcal_ros.nodes.planner.measuring import GoalMeasurement
from rotcal_ros.nodes.planner.progress import GoalProgress
from rotcal_ros.planning.settings import PlannerSettings

PLAN = {"table_step_deg": 60.0, "table_positions": 4, "box_points": [2, 2, 2]}
CALIBRATION = prepare(
    parse_configuration(dump_configuration("tracer_multistation", {"plan": PLAN}))
)
STEPS = len(CALIBRATION.plan.steps)
LIMIT = PlannerSettings().max_failed_steps


class Cell(SimpleNamespace):
    """Links to a cell that answers at once and captures all steps but those of ``failing``."""

    def __init__(self, failing, calibration=CALIBRATION):
        super().__init__(failing=set(failing), observations={}, receipts={}, ordered=[])
        self.plan = calibration.plan
        self.node = SimpleNamespace(now_ns=lambda: 0)
        self.health = SimpleNamespace(values=lambda _: {})

    def publish_choice(self, _):
        pass

    def last_accepted(self, attempts):
        return CellLinks.last_accepted(self, attempts)

    def order(self, command):
        key = (command.step, command.attempt)
        self.ordered.append(key)
        for step in self.plan.passed_from(command.step):
            found = replace(self.plan.steps[step].observed((0.1,)), attempt=command.attempt)
            if step in self.failing:
                found = replace(found, accepted=False, reason="the table is not at rest")
            key = (step, command.attempt)
            self.observations[key], self.receipts[key] = found, 0


class Watch(SimpleNamespace):
    def tell(self, *_):
        pass

    def clock_jumps(self):
        return 0

    def wait_out_stop(self):
        pass

    async def wait_for_slow_nodes(self):
        pass

    async def wait(self, condition, _):
        return condition()

    wait_for_machine = wait


def measured(failing, steps=range(STEPS), earlier=(), **planner):
    """Measure ``steps`` after the observations of ``earlier`` steps; return the cell, the goal."""
    observed = tuple(CALIBRATION.plan.steps[k].observed((0.1,)) for k in earlier)
    run = int(bool(observed))
    left = tuple(steps)
    continuation = Continuation(
        CALIBRATION.configuration.plan_id, run, left[0], (), left, observed
    )
    cell, progress = Cell(failing), GoalProgress(STEPS)
    watch = Watch(settings=PlannerSettings(**planner), links=cell, progress=progress, owed=None)
    asyncio.run(GoalMeasurement(CALIBRATION, continuation, watch).measure_all())
    return cell, progress


def test_the_last_steps_may_fail_and_what_was_measured_is_kept():
    failing = range(STEPS - LIMIT, STEPS)
    _, progress = measured(failing)
    assert progress.skipped == list(failing)
    assert progress.accepted == list(range(STEPS - LIMIT))


def test_a_resumed_goal_whose_few_steps_fail_again_keeps_what_the_first_one_measured():
    failing = range(STEPS - LIMIT, STEPS)
    _, progress = measured(failing, failing, earlier=range(STEPS - LIMIT))
    assert progress.skipped == list(failing)


def test_the_steps_of_earlier_runs_count_on_the_screen_as_in_the_outcome():
    """A policy's progress began anew with 0 of those that were left, beside a log with all."""
    left = range(STEPS - 3, STEPS)
    _, progress = measured((), left, earlier=range(STEPS - 3), policy="until_goal")
    assert (progress.ended, len(progress.accepted)) == (STEPS, 3)
    assert progress.step == progress.total >= progress.ended
    assert len(progress.earlier.union(progress.accepted)) == STEPS


@pytest.mark.parametrize("first", [0, 7])
def test_a_goal_is_given_up_where_steps_are_left(first):
    with pytest.raises(GoalError, match=r"given up: .* failed") as refusal:
        measured(range(first, first + LIMIT))
    assert refusal.value.code == Codes.TOO_FEW_OBSERVATIONS


def test_a_goal_of_which_nothing_was_captured_is_given_up_with_the_reason():
    steps = range(LIMIT)
    with pytest.raises(GoalError, match="the table is not at rest"):
        measured(steps, steps)


TURNING = prepare(
    parse_configuration(
        "method: table_balls\nballs_m: [[0.15, 0.0, 0.08]]\nmeasure: displacement\n"
        "closing: false\ntable_step_deg: 90.0\ntable_positions: 4\nturning_deg_s: [5.0, -5.0]\n"
    )
)


def turned(failing=(), stopped_before=None):
    """Return the orders (step, attempt) of two runs of a table that turns.

    ``stopped_before``: the order before which there is an emergency stop, once.
    """
    cell, progress = Cell(failing, TURNING), GoalProgress(8)
    watch = Watch(
        settings=PlannerSettings(max_attempts=2), links=cell, progress=progress, owed=None
    )
    goal = GoalMeasurement(TURNING, TURNING.first_run(), watch)
    stops = [stopped_before]

    def wait_out_stop():
        if len(cell.ordered) == stops[0]:
            stops.clear()
            stops.append(None)
            raise StepInterruptedError("emergency stop")

    async def resumed(*_):
        pass

    watch.wait_out_stop, goal.operator.have_done = wait_out_stop, resumed
    asyncio.run(goal.measure_all())
    return cell.ordered


def test_one_order_makes_a_turn_and_a_turn_is_made_again_as_a_whole():
    assert turned() == [(0, 0), (4, 0)]
    assert turned(failing=[2]) == [(0, 0), (0, 1), (4, 0)]


def test_a_turn_is_made_again_after_a_stop():
    assert turned(stopped_before=1) == [(0, 0), (4, 2)]
