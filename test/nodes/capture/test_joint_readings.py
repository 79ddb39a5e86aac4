"""Which joints the capture reports, and with which angles."""

import pytest

pytest.importorskip("rclpy")

from sensor_msgs.msg import JointState

from rotcal_ros.nodes.capture.instrument_streams import JointReadings
from rotcal_ros.nodes.runtime.beat_values import MOST_JOINTS


def feedback(count, angle, velocity=0.5):
    names = [f"joint_{k}" for k in range(count)]
    return JointState(name=names, position=[angle] * count, velocity=[velocity] * count)


@pytest.mark.parametrize("count", [1, MOST_JOINTS, MOST_JOINTS + 1, 200])
def test_however_many_joints_there_are_each_that_is_told_is_the_latest(count):
    joints = JointReadings()
    joints.note(feedback(count, 0.1), "")
    joints.note(feedback(count, 0.2), "")
    told = joints.values()
    assert len(told) == min(count, MOST_JOINTS)
    assert set(told.values()) == {"0.200000000 0.500000000"}
    assert next(iter(told)) == "joint.joint_0"


def test_the_chosen_joint_is_told_even_as_the_last_of_many():
    joints = JointReadings()
    joints.note(feedback(200, 0.1), "")
    joints.note(feedback(200, 0.2), "joint_199")
    joints.note(feedback(200, 0.3), "joint_199")
    assert joints.values()["joint.joint_199"] == "0.300000000 0.500000000"
    assert len(joints.values()) == MOST_JOINTS + 1


def test_a_joint_without_velocity_has_none():
    joints = JointReadings()
    joints.note(JointState(name=["a"], position=[0.1]), "a")
    assert joints.values() == {"joint.a": "0.100000000 nan"}
