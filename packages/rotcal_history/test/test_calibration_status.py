"""The node that reports the state of a cell's tables."""

import os

import numpy as np
import pytest
from simulated_park import Table, measured

from rotcal_history.database import ParkHistory
from rotcal_ros.foundation.dates import day_of

pytest.importorskip("rclpy")
pytest.importorskip("rotcal_msgs")
pytestmark = pytest.mark.ros

YEARS = np.linspace(0.0, 5.0, 11)


@pytest.fixture
def database(tmp_path):
    """Return a history of a still table and of one that was hit."""
    rng = np.random.default_rng(1)
    with ParkHistory(str(tmp_path / "history.db")) as history:
        for name, jump in (("STAYS", None), ("HIT", (4.8, 5.0 * np.eye(8)[1]))):
            for each in measured(Table(name, np.eye(8)[0], jump=jump), YEARS, rng):
                history.add_result(each)
    return str(tmp_path / "history.db")


def test_statuses_have_verdict_due_and_table_in_force(database):
    from diagnostic_msgs.msg import DiagnosticStatus

    from rotcal_history.node.calibration_status import axis_statuses, machine_outlooks
    from rotcal_history.settings import HistorySettings

    settings = HistorySettings(database=database)
    outlooks = machine_outlooks(settings, "")
    hit, stays = axis_statuses(outlooks, outlooks[0].last_ns)
    assert (hit.name, hit.level) == ("HIT/C", DiagnosticStatus.ERROR)
    assert "jumped" in hit.message
    assert (stays.name, stays.level) == ("STAYS/C", DiagnosticStatus.OK)
    values = {pair.key: pair.value for pair in stays.values}
    assert (values["verdict"], values["table_in_force"]) == ("ok", "unknown")
    assert values["due"] == day_of(outlooks[1].due_ns)
    (late,) = axis_statuses(machine_outlooks(settings, "STAYS"), outlooks[1].due_ns)
    assert late.level == DiagnosticStatus.WARN


def test_a_late_listener_hears_the_latched_status(database, cell):
    import rclpy
    from diagnostic_msgs.msg import DiagnosticArray
    from live_cell import wait_until
    from rclpy.context import Context
    from rclpy.executors import SingleThreadedExecutor

    from rotcal_ros.nodes.runtime.qos import LATCHED

    live = cell()
    arguments = ("-p", f"history.database:={database}", "-p", "serial:=HIT")
    live.start("calibration_status", arguments=arguments)
    live.wait_for_log("calibration_status", "reported: 1 tables")
    heard, context = [], Context()
    rclpy.init(context=context, domain_id=int(os.environ["ROS_DOMAIN_ID"]))
    node = rclpy.create_node("listener", namespace="/cell", context=context)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    node.create_subscription(DiagnosticArray, "calibration_status", heard.append, LATCHED)

    def look():
        executor.spin_once(timeout_sec=0.05)
        return heard

    try:
        wait_until(look, "the status is heard")
    finally:
        node.destroy_node()
        rclpy.shutdown(context=context)
    assert [status.name for status in heard[0].status] == ["HIT/C"]
