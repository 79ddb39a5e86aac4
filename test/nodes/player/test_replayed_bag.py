"""What of a bag is replayed, with which quality of service; names that the recorder noted."""

import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

from rotcal_ros.foundation.machine_load import load_scaled_timeout

pytest.importorskip("rclpy")
pytest.importorskip("rotcal_msgs")

from rclpy.qos import DurabilityPolicy, ReliabilityPolicy

from rotcal_ros.bags import names
from rotcal_ros.bags.rosbag2_metadata import OfferedQos, qos_text
from rotcal_ros.bags.settings import WriterSettings
from rotcal_ros.bags.writer import BagWriter
from rotcal_ros.foundation.errors import BagError
from rotcal_ros.nodes.player.node import offered_qos
from rotcal_ros.nodes.player.replayed_bag import ReplayedBag
from rotcal_ros.nodes.runtime.message_types import importable_type

GOLDEN = Path(__file__).parents[2] / "golden" / "tracer" / "bag"


def test_streams_orders_and_plan_are_replayed_and_outputs_are_not():
    bag = ReplayedBag.read(GOLDEN)
    kept = {topic.rpartition("/")[2] for topic in bag.channels}
    assert kept == {
        names.PLAN, names.TRACER_LENGTH, names.JOINT_STATES, names.TEMPERATURE, names.TABLE_ANGLE,
        names.PROBE_TARGET, names.PROBE_POINT, names.TABLE_IN_FORCE, names.STEP_CHOICE,
    }  # fmt: skip
    assert "/cell/observation" in bag.left_out
    assert "/diagnostics" in bag.left_out
    assert bag.namespace == "/cell"
    assert bag.seconds == pytest.approx(62.35, abs=0.01)
    assert len(bag.accepted) == 63
    everything = ReplayedBag.read(GOLDEN, everything=True)
    assert everything.left_out == {}


def test_a_bag_with_nothing_to_publish_is_named(tmp_path):
    settings = WriterSettings(min_free_bytes=0)
    with BagWriter(tmp_path / "empty", settings):
        pass
    with pytest.raises(BagError, match="holds no messages: there is nothing to replay"):
        ReplayedBag.read(tmp_path / "empty")
    with BagWriter(tmp_path / "outputs", settings) as writer:
        channel = writer.channel("/cell/heartbeat", "a/msg/B", "uint8 x\n")
        writer.write(channel, b"\0\1\0\0\1", 1, 1)
    with pytest.raises(BagError, match="/cell/heartbeat; --all publishes that too"):
        ReplayedBag.read(tmp_path / "outputs")
    with pytest.raises(BagError, match="does not exist"):
        ReplayedBag.read(tmp_path / "nothing")


def test_the_recorded_quality_of_service_is_offered_again():
    latched = offered_qos(qos_text([OfferedQos(depth=1, durability="transient_local")]))
    assert latched.durability == DurabilityPolicy.TRANSIENT_LOCAL
    assert (latched.reliability, latched.depth) == (ReliabilityPolicy.RELIABLE, 1)
    loose = offered_qos(qos_text([OfferedQos(reliability="best_effort", lifespan_ns=5 * 10**8)]))
    assert (loose.reliability, loose.durability) == (
        ReliabilityPolicy.BEST_EFFORT, DurabilityPolicy.VOLATILE
    )  # fmt: skip
    assert loose.lifespan.nanoseconds == 5 * 10**8
    two = qos_text([OfferedQos(), OfferedQos(reliability="best_effort")])
    assert offered_qos(two).reliability == ReliabilityPolicy.BEST_EFFORT
    assert offered_qos("").reliability == ReliabilityPolicy.RELIABLE


def test_a_type_is_published_where_it_is_defined_as_it_was_recorded(monkeypatch):
    monkeypatch.setenv("AMENT_PREFIX_PATH", os.environ.get("AMENT_PREFIX_PATH") or sys.prefix)
    channels = ReplayedBag.read(GOLDEN).channels
    plan = channels["/cell/plan"]
    assert importable_type(plan.type_name, plan.type_hash).__name__ == "CalibrationPlan"
    other = plan.type_hash[:-1] + ("0" if plan.type_hash[-1] != "0" else "1")
    with pytest.raises(BagError, match="is defined differently here and in the bag"):
        importable_type(plan.type_name, other)
    with pytest.raises(BagError, match="is not installed here"):
        importable_type("no_such_msgs/msg/Thing", "")


@pytest.mark.parametrize("rate", ["0", "-1", "nan", "1e9", "fast"])
def test_a_pace_that_is_none_is_refused(rate):
    done = subprocess.run(
        [sys.executable, "-m", "rotcal_ros.cli.main", "replay", str(GOLDEN), "--rate", rate],
        capture_output=True, text=True, timeout=load_scaled_timeout(60.0),
    )  # fmt: skip
    assert done.returncode == 2
    assert "'--rate'" in done.stderr


def test_topics_that_are_taken_when_they_are_sent_are_named():
    kinds = {
        "/etalon": "std_msgs/msg/Float64",
        "/cell/joint_states": "sensor_msgs/msg/JointState",
        "/cell/probe_point": "geometry_msgs/msg/PointStamped",
        "/cell/other": "std_msgs/msg/Float64",
    }
    channels = {topic: SimpleNamespace(type_name=kind) for topic, kind in kinds.items()}
    bag = ReplayedBag((), channels)
    bag.called.topics = {names.TRACER_LENGTH: "/etalon"}
    assert bag.taken_when_sent() == ["/etalon"]
    bag.configuration = "/**: {ros__parameters: {method: ball_plate, topics: {probe_clock: sent}}}"
    assert bag.taken_when_sent() == ["/cell/probe_point", "/etalon"]
