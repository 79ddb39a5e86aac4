"""The node of a tracker by plug-in hears the table as the capture does; without a network."""

import pytest

rclpy = pytest.importorskip("rclpy")
pytest.importorskip("rotcal_msgs")

from sensor_msgs.msg import JointState  # noqa: E402
from std_msgs.msg import Float64  # noqa: E402

from rotcal_ros.foundation.observations import Approach, Command, PointKind  # noqa: E402
from rotcal_ros.foundation.units import DEGREE  # noqa: E402
from rotcal_ros.nodes.instrument_driver import node as instrument_driver  # noqa: E402
from rotcal_ros.nodes.instrument_driver.instrument import Place, Tracker  # noqa: E402

pytestmark = pytest.mark.ros
ORDER = Command(3, 1, 30 * DEGREE, Approach.POSITIVE, PointKind.DIRECT, 2, (1.0, 2.0, 3.0), 1)
GIVEN = {
    "autostart": "false",
    "topics.joint_states": "/theirs/angle",
    "topics.angle_unit": "deg",
    "cell.joint": "rotary",
}


class Finder(Tracker):
    def connect(self):
        """Be there."""

    def measure(self, near, timeout_s):
        return Place(near)

    def close(self):
        """Be away."""


@pytest.fixture
def table(monkeypatch):
    monkeypatch.setattr(instrument_driver, "make_instrument", lambda _: Finder())
    given = [word for name, value in GIVEN.items() for word in ("-p", f"{name}:={value}")]
    rclpy.init(args=["--ros-args", "-r", "__ns:=/cell", *given])
    node = instrument_driver.InstrumentDriverNode()
    node.trigger_configure()
    yield node._table
    node.destroy_node()
    rclpy.shutdown()


def batch(*messages):
    """Return messages that were sent 0.1 s one after the other."""
    return [
        (message, {"source_timestamp": 10**18 + n * 10**8, "received_timestamp": 0})
        for n, message in enumerate(messages)
    ]


def test_a_table_that_speaks_otherwise_is_understood_and_why_it_is_waited_for_is_told(table):
    where = "(/theirs/angle, joint rotary)"
    assert table.why_not(ORDER) == f"no feedback of the table has come {where}"
    silent = [JointState(name=["rotary"], position=[value]) for value in (30.0, 31.0)]
    for second, message in enumerate(silent):
        message.header.stamp.sec = second
    table.receive("sensor_msgs/msg/JointState", batch(*silent))
    assert table.why_not(ORDER) == f"the table moves {where}"
    degrees = [Float64(data=value) for value in [390.0] * 20 + [31.0]]
    table.receive("std_msgs/msg/Float64", batch(*degrees[:-1]))
    assert table.why_not(ORDER) is None
    table.receive("std_msgs/msg/Float64", batch(*degrees)[-1:])
    assert table.why_not(ORDER) == f"the table moves {where}"
