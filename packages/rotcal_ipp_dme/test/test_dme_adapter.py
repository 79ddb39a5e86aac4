"""When the adapter stops its machine, which orders wait, and which are dropped; no graph."""

import asyncio
from collections import Counter
from types import SimpleNamespace

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("rotcal_msgs")

from builtin_interfaces.msg import Time
from rotcal_msgs.msg import CalibrationPlan, ProbeTarget, TableAngle
from std_msgs.msg import Header

from rotcal_ipp_dme import node as dme_adapter
from rotcal_ipp_dme.node import LOOKS_FIRST, DmeAdapter
from rotcal_ros.capture.messages import OrderPairing
from rotcal_ros.capture.publishers import RUN, unique_run_name
from rotcal_ros.foundation.observations import Approach, Command, PointKind
from rotcal_ros.nodes.runtime.liveness import SecondNodeError

ORDER = Command(1, 0, 0.5, Approach.POSITIVE, PointKind.SURFACE, 0, (0.1, 0.0, 0.0))


def plan(number):
    """Return the announcement of the ``number``-th run."""
    return CalibrationPlan(header=Header(stamp=Time(sec=number)), plan_id=f"plan {number}")


FIRST, SECOND = plan(1), plan(2)


class Driver:
    """Notes what it is told."""

    def __init__(self):
        self.busy, self.client = False, SimpleNamespace(blocked="")
        self.told, self.aborted = [], []

    def begin(self, stopped=""):
        self.told.append(stopped or "begin")

    def order(self, command, step):
        self.told.append((command.step, step))

    def forget(self):
        self.told.append("forget")

    def abort(self, why):
        self.aborted.append(why)


class Adapter(DmeAdapter):
    """An adapter whose health and machine are the test's, and that is no node."""

    def __init__(self):
        self.planner = {}
        self.given = {}
        self.health = SimpleNamespace(
            concerns={},
            alarms={},
            lost={},
            refused=None,
            values=lambda _name: self.planner,
            beat=lambda: None,
        )
        self._driver, self._orders = Driver(), OrderPairing()
        self._stop = SimpleNamespace(
            why="", check_stop=lambda: "", refuses=lambda _step: bool(self._stop.why)
        )
        self._plan = self._early = None
        self._run = self._served = None
        self._looks = 0
        self._loading = False
        self.listening = Counter()

    def __del__(self):
        pass

    def take_orders(self, obey):
        self.listening["orders"] += 1
        return OrderPairing()

    def offer(self, _kind, name, _serve):
        self.listening[name] += 1

    def _complain(self, _text):
        pass

    @property
    def orders(self):
        return [told for told in self._driver.told if isinstance(told, tuple)]

    def work_for(self, announced):
        """Hear the planner's beat while it works for a plan; None: for none."""
        self.planner = {} if announced is None else {RUN: unique_run_name(announced)}
        self._watch()


@pytest.fixture
def made(monkeypatch):
    """Return an adapter; a plan's step is its name and index."""

    def calibration_of(message):
        if message.plan_id == "wrong":
            raise ValueError(message.plan_id)
        name = message.plan_id
        return SimpleNamespace(plan=SimpleNamespace(step=lambda index: f"{name}, step {index}"))

    monkeypatch.setattr(dme_adapter.announced_plan, "calibration_from_message", calibration_of)
    return Adapter()


def test_a_calibration_that_ends_in_the_middle_of_a_step_stops_the_machine_once(made):
    made.work_for(FIRST)
    made._driver.busy = True
    made.work_for(FIRST)
    assert made._driver.aborted == []
    made.work_for(None)
    made.work_for(None)
    assert made._driver.aborted == ["the calibration ended in the middle of a step"]


def test_one_calibration_behind_the_other_stops_the_machine_too(made):
    made.work_for(FIRST)
    made._driver.busy = True
    made.work_for(SECOND)
    assert len(made._driver.aborted) == 1


def test_a_calibration_that_ends_between_two_steps_stops_nothing(made):
    made.work_for(FIRST)
    made.work_for(None)
    assert made._driver.aborted == []


def test_a_lost_planner_stops_the_machine_once_and_another_node_does_not(made):
    made.work_for(FIRST)
    made._driver.busy = True
    made._node_lost("recorder")
    assert made._driver.aborted == []
    made._node_lost("planner")
    made.health.lost["planner"] = 2.0
    made._watch()
    assert made._driver.aborted == ["the planner was lost in the middle of a step"]


def test_an_adapter_that_is_deactivated_stops_the_machine_and_keeps_its_session(made):
    made.work_for(FIRST)
    made._driver.busy = True
    made.deactivated()
    assert made._driver.aborted == ["the adapter was deactivated in the middle of a step"]
    assert made._driver.told == ["forget"]


def test_why_nothing_moves_stands_in_the_diagnostics_until_it_is_cleared(made):
    made._driver.client.blocked = "PtMeas: error 1006"
    made._watch()
    assert made.health.concerns["blocked"].startswith("PtMeas: error 1006; once that is corrected")
    made._driver.client.blocked = ""
    made._watch()
    assert made.health.concerns == {}


def test_in_an_emergency_stop_the_machine_is_aborted_and_nothing_is_ordered_or_cleared(made):
    made.work_for(FIRST)
    made._driver.busy, made._run = True, made._planners_run()
    made._plan = SimpleNamespace(step=lambda number: number)
    made._stop.why = "/safety/estop is true"
    made._halt(made._stop.why)
    assert made._driver.aborted == ["emergency stop: /safety/estop is true"]
    ordered = list(made._driver.told)
    made._obey(ORDER)
    assert made._driver.told == ordered
    answer = asyncio.run(made._clear(None, SimpleNamespace(success=False, message="")))
    assert (answer.success, answer.message) == (
        False, "the emergency stop is on: /safety/estop is true"
    )  # fmt: skip
    made._stop.why = ""
    made._obey(ORDER)
    assert len(made._driver.told) == len(ordered) + 1


def test_an_order_waits_for_its_plan(made):
    made.work_for(FIRST)
    made._obey(ORDER)
    assert made.orders == []
    made._take_plan(FIRST)
    assert made.orders == [(1, "plan 1, step 1")]
    made._obey(ORDER)
    assert made.orders == [(1, "plan 1, step 1")] * 2


def test_an_order_is_carried_out_by_the_plan_that_it_is_of_and_by_no_earlier_one(made):
    made._take_plan(FIRST)
    made.work_for(SECOND)
    made._obey(ORDER)
    assert made.orders == []
    made._take_plan(SECOND)
    assert made.orders == [(1, "plan 2, step 1")]


@pytest.mark.parametrize("lost", [False, True])
def test_the_end_of_a_calibration_drops_all_that_waits(made, lost):
    made.work_for(FIRST)
    made._obey(ORDER)
    made._orders.table_angle(TableAngle(step=7))
    if lost:
        made._node_lost("planner")
    else:
        made.work_for(None)
    assert made._driver.told[-1] == "forget"
    made._take_plan(FIRST)
    assert made._orders.probe_target(ProbeTarget(step=7)) is None
    assert made.orders == []


def test_an_order_of_a_plan_that_was_refused_is_not_done_by_the_next_one(made):
    made.work_for(FIRST)
    made._obey(ORDER)
    with pytest.raises(ValueError, match="wrong"):
        made._take_plan(CalibrationPlan(plan_id="wrong"))
    made._take_plan(FIRST)
    made.planner = {RUN: unique_run_name(SECOND)}  # at once: the end of the first was never seen
    made._early = (unique_run_name(FIRST), ORDER)
    made._take_plan(SECOND)
    assert made.orders == []


def test_an_order_that_comes_behind_the_end_moves_nothing(made):
    made.work_for(FIRST)
    made._take_plan(FIRST)
    made.work_for(None)
    made._obey(ORDER)
    made.work_for(SECOND)
    made._take_plan(SECOND)
    assert made.orders == []


def test_a_new_plan_forgets_halves_of_orders(made):
    made._orders.table_angle(TableAngle(step=7))
    made._take_plan(FIRST)
    assert made._orders.probe_target(ProbeTarget(step=7)) is None


def test_a_machine_without_a_planner_obeys_by_the_plan_that_came(made):
    made._take_plan(FIRST)
    made._watch()
    made._obey(ORDER)
    assert made.orders == [(1, "plan 1, step 1")]


def test_the_machine_is_spoken_to_only_when_no_older_adapter_was_heard(made):
    for _ in range(LOOKS_FIRST - 1):
        made._watch()
    assert (made._driver.told, made.listening) == ([], {})
    made._watch()
    made._watch()
    assert made._driver.told == ["begin"]
    assert made.listening == {"orders": 1, "clear_errors": 1}


def test_after_a_stop_no_session_begins_and_no_machine_homes_by_itself(made):
    made._stop.why = "/safety/estop is true"
    made._stop.check_stop = lambda: "/safety/estop is true"
    for _ in range(LOOKS_FIRST):
        made._watch()
    made._stop.why = ""
    made._watch()
    told = "no session was started: emergency stop: /safety/estop is true"
    assert made._driver.told == [told]
    assert made.listening == {"orders": 1, "clear_errors": 1}
    made._driver.client.blocked = told
    made._watch()
    assert made.health.concerns["blocked"].startswith(f"{told}; once that is corrected")


def test_an_adapter_that_is_refused_never_speaks_to_the_machine(made):
    made.health.refused = SecondNodeError("dme_adapter", "/cell", "")
    for _ in range(2 * LOOKS_FIRST):
        made._watch()
    assert (made._driver.told, made.listening) == ([], {})


def test_plans_are_taken_from_the_planner_alone_and_nothing_begins_at_once(made, monkeypatch):
    sources = []
    plans = dme_adapter.announced_plan
    monkeypatch.setattr(plans, "PlanSubscription", lambda *source: sources.append(source))
    monkeypatch.setattr(dme_adapter, "Driver", lambda *_: Driver())
    monkeypatch.setattr(dme_adapter, "EmergencyStop", lambda *_: SimpleNamespace(why=""))
    made.settings = lambda _group, kind: kind()
    made.create_publisher = made.every = lambda *_: None
    made.configure()
    assert sources == [(made, made._take_plan)]
    assert (made._driver.told, made.listening) == ([], {})
