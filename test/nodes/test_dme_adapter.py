"""When the adapter stops its machine, and which orders wait, without ROS nodes."""

from types import SimpleNamespace

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("rotcal_msgs")

from rotcal_ros.nodes.dme_adapter import DmeAdapter
from rotcal_ros.observations import Approach, Command, PointKind

ORDER = Command(1, 0, 0.5, Approach.POSITIVE, PointKind.SURFACE, 0, (0.1, 0.0, 0.0))


def adapter(*, busy, blocked=""):
    """Return what the adapter's methods use of it; ``planner`` is what that says it does."""
    made = SimpleNamespace(
        planner="calibrating: step 3 of 9", aborted=[], ordered=[], _calibrating=False,
        _plan=None, _early=None,
        health=SimpleNamespace(concerns={}, state=lambda _name: made.planner),
    )  # fmt: skip
    made._driver = SimpleNamespace(
        busy=busy,
        client=SimpleNamespace(blocked=blocked),
        order=lambda command, step: made.ordered.append((command, step)),
    )
    made._abort = made.aborted.append
    return made


def test_a_calibration_that_ends_in_the_middle_of_a_step_stops_the_machine_once():
    made = adapter(busy=True)
    DmeAdapter._watch(made)
    assert made.aborted == []
    made.planner = "ready"
    DmeAdapter._watch(made)
    DmeAdapter._watch(made)
    assert made.aborted == ["the calibration ended in the middle of a step"]


def test_a_calibration_that_ends_between_two_steps_stops_nothing():
    made = adapter(busy=False)
    DmeAdapter._watch(made)
    made.planner = "ready"
    DmeAdapter._watch(made)
    assert made.aborted == []


def test_a_lost_planner_stops_the_machine_and_another_node_does_not():
    made = adapter(busy=True)
    DmeAdapter._node_lost(made, "recorder")
    assert made.aborted == []
    DmeAdapter._node_lost(made, "planner")
    assert made.aborted == ["the planner fell silent in the middle of a step"]


def test_why_nothing_moves_stands_in_the_diagnostics_until_it_is_cleared():
    made = adapter(busy=False, blocked="PtMeas: error 1006")
    DmeAdapter._watch(made)
    assert made.health.concerns == {"dme": "PtMeas: error 1006"}
    made._driver.client.blocked = ""
    DmeAdapter._watch(made)
    assert made.health.concerns == {}


def test_an_order_waits_for_its_plan():
    made = adapter(busy=False)
    DmeAdapter._obey(made, ORDER)
    assert (made.ordered, made._early) == ([], ORDER)
    made._plan = SimpleNamespace(step=lambda index: f"step {index}")
    DmeAdapter._obey(made, ORDER)
    assert made.ordered == [(ORDER, "step 1")]
