"""What the driver reports of the table, from lines of its agent, without ROS nodes."""

from types import SimpleNamespace

import pytest

pytest.importorskip("rotcal_msgs")

from rotcal_ros.nodes.adapters import linuxcnc_driver
from rotcal_ros.nodes.adapters.linuxcnc_driver import LinuxCncDriver


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


class Agent(SimpleNamespace):
    """An agent that ends when it is told to, or never by itself."""

    def poll(self):
        return self.code

    def wait(self, timeout):
        raise AssertionError(f"the node would not beat for {timeout} s")

    def terminate(self):
        self.code = -15


@pytest.mark.parametrize("obeys", [True, False])
def test_the_end_of_the_agent_is_waited_for_in_turns_and_brought_about_at_last(monkeypatch, obeys):
    now = [100.0]
    monkeypatch.setattr(linuxcnc_driver, "time", SimpleNamespace(monotonic=lambda: now[0]))
    agent = Agent(code=None)
    agent.stdin = SimpleNamespace(close=lambda: setattr(agent, "code", 0 if obeys else None))
    driver = SimpleNamespace(_agent=agent, _ending_s=None)
    assert not LinuxCncDriver.stopped(driver)
    LinuxCncDriver.begin_stop(driver)
    assert LinuxCncDriver.stopped(driver) == obeys
    now[0] += linuxcnc_driver.END_TIMEOUT_S + 0.1
    assert LinuxCncDriver.stopped(driver)
    assert agent.code == (0 if obeys else -15)


def test_an_order_to_turn_on_is_refused():
    """It moves the table alone: no nest would follow."""
    logged, sent = [], []
    driver = SimpleNamespace(
        _stop=SimpleNamespace(refuses=lambda _step: False), _complaints=0,
        _agent=SimpleNamespace(stdin=SimpleNamespace(write=sent.append)),
        get_logger=lambda: SimpleNamespace(error=logged.append),
    )  # fmt: skip
    LinuxCncDriver._obey(driver, SimpleNamespace(step=3, turn_speed=-0.5))
    assert not sent
    assert driver._complaints == 1
    assert "ordered to turn on at -28.6479 deg/s" in logged[0]
