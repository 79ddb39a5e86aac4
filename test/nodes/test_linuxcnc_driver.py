"""What the driver tells of the table, from lines of its agent, without ROS nodes."""

from types import SimpleNamespace

import pytest

pytest.importorskip("rotcal_msgs")

from rotcal_ros.nodes.linuxcnc_driver import LinuxCncDriver


def reading(stamp_ns, motor_deg, obeying):
    return {
        "stamp_ns": stamp_ns, "angle_deg": motor_deg, "motor_deg": motor_deg,
        "actual_deg": None, "obeying": obeying, "errors": [],
    }  # fmt: skip


def test_a_table_that_has_an_order_and_has_not_begun_to_move_is_not_told_to_be_at_rest():
    """It stands at 30 deg, where it is sent from the other side: by 32 deg and back."""
    told = []
    driver = SimpleNamespace(
        _last=None, _motor_deg=0.0, _joint="table", _positions=SimpleNamespace(publish=told.append)
    )
    motor = [(30.0, False), (30.0, True), (30.0, True), (32.0, True), (30.0, True), (30.0, False)]
    for number, (angle, obeying) in enumerate(motor, start=1):
        LinuxCncDriver._publish(driver, reading(number * 10_000_000, angle, obeying))
    speeds = [message.velocity[0] for message in told]
    assert [message.header.stamp.nanosec for message in told] == [
        number * 10_000_000 for number in (1, 4, 5, 6)
    ]
    assert [speed == 0.0 for speed in speeds] == [True, False, False, True]
