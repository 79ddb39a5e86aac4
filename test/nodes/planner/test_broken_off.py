"""A goal that a lost node broke off goes on: with what is owed, from where, in which bag."""

import asyncio
from dataclasses import replace
from types import SimpleNamespace

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("rotcal_msgs")

from rotcal_ros.methods import prepare
from rotcal_ros.methods.configuration import dump_configuration, parse_configuration
from rotcal_ros.methods.continuation import Continuation, Recorded
from rotcal_ros.nodes.planner import node
from rotcal_ros.nodes.planner.goal_watch import Codes, GoalError
from rotcal_ros.nodes.planner.measuring import GoalMeasurement
from rotcal_ros.nodes.planner.node import GoalBag, GoalRun
from rotcal_ros.nodes.planner.progress import GoalProgress
from rotcal_ros.planning.plan import Pause
from rotcal_ros.planning.settings import PlannerSettings

GROUP = {"table_step_deg": 60.0, "table_positions": 4, "box_points": [2, 2, 2]}
PLAIN = prepare(parse_configuration(dump_configuration("tracer_multistation", {"plan": GROUP})))
LOST = GoalError(Codes.NODE_LOST, "node capture was ended", in_another_run=True)
PLAN_ID = PLAIN.configuration.plan_id


class Checked:
    """A calibration with a pause before step 2, which steps 2 to 4 check."""

    def __init__(self, complaints, last=4):
        pauses = (Pause(2, last, "mount the mirror"),)
        self.plan = replace(PLAIN.plan, pauses=pauses)
        self.complaints = complaints

    def check(self, _observations):
        return [self.complaints.pop(0)] if self.complaints else []

    def __getattr__(self, name):
        return getattr(PLAIN, name)


class Cell(SimpleNamespace):
    """Links to a cell, the watch of a goal and its person; all is noted in ``done``.

    ``fails`` is how often work is done until the next time breaks off.
    """

    def __init__(self, fails):
        super().__init__(done=[], fails=fails, observations={}, receipts={}, owed=None)
        self.settings, self.progress = PlannerSettings(), GoalProgress(len(PLAIN.plan.steps))
        self.node, self.links = SimpleNamespace(now_ns=lambda: 0), self

    async def have_done(self, work="", _move=None):
        self.done.append(work)
        if self.fails == 0:
            self.fails = -1
            raise LOST
        self.fails -= 1

    def last_accepted(self, attempts):
        return next((self.observations[a] for a in attempts if a in self.observations), None)

    def order(self, command):
        self.done.append(command.step)
        key = (command.step, command.attempt)
        self.observations[key] = PLAIN.plan.steps[command.step].observed((0.1,))
        self.receipts[key] = 0

    def clock_jumps(self):
        return 0

    def nothing(self, *_):
        pass

    wait_out_stop = tell = publish_choice = nothing

    async def wait_for_slow_nodes(self):
        pass

    async def wait(self, condition, _):
        return condition()

    wait_for_machine = wait


def run_of(calibration, cell, steps, run=0):
    """Measure ``steps``; return what was asked for (texts) and ordered (steps)."""
    continuation = Continuation(PLAN_ID, run, steps[0], (), tuple(steps), ())
    measuring = GoalMeasurement(calibration, continuation, cell)
    measuring.operator, cell.done = cell, []
    try:
        asyncio.run(measuring.measure_all())
    except GoalError:
        cell.done.append("lost")
    return cell.done


@pytest.mark.parametrize("last", [1, 4])
def test_work_that_nobody_has_confirmed_is_asked_for_before_another_run_moves(last):
    calibration, cell = Checked([], last), Cell(fails=0)
    assert run_of(calibration, cell, range(6)) == [0, 1, "mount the mirror", "lost"]
    assert run_of(calibration, cell, range(2, 6), 1) == ["mount the mirror", 2, 3, 4, 5]
    assert cell.owed is None


def test_a_complaint_is_still_to_be_put_right_when_its_steps_were_accepted():
    calibration, cell = Checked(["nest 2 has moved"]), Cell(fails=1)
    text = "not right yet: nest 2 has moved; correct it (mount the mirror)"
    assert run_of(calibration, cell, range(6)) == [0, 1, "mount the mirror", 2, 3, 4, text, "lost"]
    assert run_of(calibration, cell, [5], 1) == [text, 2, 3, 4, 5]


class Bag:
    def __init__(self, folder):
        self.folder, self.opened = folder, []

    async def open(self, *, goes_on):
        self.opened.append(goes_on)

    async def recorded(self):
        return Recorded(PLAN_ID, 1, tuple(s.observed((0.1,)) for s in PLAIN.plan.steps[20:23]))


def goal(bag, start_index=0):
    node = SimpleNamespace(get_logger=lambda: SimpleNamespace(info=print, warning=print))
    links = SimpleNamespace(node=node, services=None)
    watch = SimpleNamespace(
        links=links, progress=GoalProgress(len(PLAIN.plan.steps)), settings=PlannerSettings(),
        end_run=lambda _: None, required=SimpleNamespace(restart_wait_s=1.0),
    )  # fmt: skip
    made = GoalRun(PLAIN, PLAIN.first_run(start_index), watch)
    made.bag = bag
    return made


def test_a_goal_that_lost_a_node_before_it_had_a_bag_joins_no_older_session():
    run = goal(Bag(None))
    run._begin_anew(LOST)
    assert not run._goes_on
    run = goal(Bag("session"))
    run._begin_anew(LOST)
    assert run._goes_on


def test_what_a_goal_was_to_leave_out_is_left_out_after_a_loss_too():
    run = goal(Bag("session"), start_index=20)
    run._begin_anew(LOST)
    asyncio.run(run._go_on())
    assert run._continuation.start_index == 23
    assert min(run._continuation.steps) >= 20


@pytest.mark.parametrize(
    ("error", "code", "text"),
    [
        (GoalError(Codes.EMERGENCY_STOP, "emergency stop: drive"), Codes.EMERGENCY_STOP, "drive"),
        (GoalError(Codes.TOPIC_MISSING, "no node obeys"), Codes.NODE_LOST, "did not come back"),
    ],
)
def test_a_stop_in_a_later_preflight_is_told_as_what_it_is(monkeypatch, error, code, text):
    async def be_ready(*_):
        raise error

    monkeypatch.setattr(node, "wait_until_ready", be_ready)
    run = goal(Bag(None))
    run._begin_anew(LOST)
    with pytest.raises(GoalError, match=text) as raised:
        asyncio.run(run._solved_in_one_run())
    assert raised.value.code == code


def test_a_goal_canceled_while_the_recorder_opens_the_bag_has_it_closed():
    asked = []

    def recorder(name):
        future = SimpleNamespace(done=lambda: True, result=lambda: None)
        return SimpleNamespace(call_async=lambda _: asked.append(name) or future)

    async def canceled(*_):
        raise GoalError(Codes.CANCELED, "canceled")

    services = SimpleNamespace(
        continue_recording=None, start_recording=None, stop_recording=recorder("stop")
    )
    health = SimpleNamespace(missing=lambda _: [])
    links = SimpleNamespace(services=services, health=health, observations={}, receipts={})
    bag = GoalBag(PLAIN.configuration, SimpleNamespace(links=links, tell=print, call=canceled))
    with pytest.raises(GoalError, match="canceled"):
        asyncio.run(bag.open(goes_on=True))
    asyncio.run(bag.close_after_failure())
    assert asked == ["stop"]


def test_a_later_preflight_has_somebody_resume_before_it_misses_what_is_silent(monkeypatch):
    stop = SimpleNamespace(latched="the gate is open", check_stop=lambda: stop.latched)
    asked = []

    async def have(missing, code, in_vain):
        if missing():
            raise GoalError(code, "; ".join(missing()))

    async def found(missing):
        return not missing()

    class Requests:
        async def have_done(self):
            asked.append(stop.latched)
            stop.latched = None

    def missing(*_):
        return ["silent"] if stop.latched else []

    monkeypatch.setattr(node, "_missing", missing)
    watch = SimpleNamespace(
        preflight=False, stop=stop, have=have, wait_until_found=found, links=None
    )
    asyncio.run(node._have_topics(PLAIN, watch, Requests()))
    assert asked == ["the gate is open"]
