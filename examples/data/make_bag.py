"""Write a bag of the simulated cell without ROS, as a recorder of your own could."""

from dataclasses import replace
from pathlib import Path

import numpy as np
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

import rotcal_ros as rc
from rotcal_ros.bags import names
from rotcal_ros.bags.rosbag2_metadata import OfferedQos, qos_text
from rotcal_ros.bags.settings import WriterSettings
from rotcal_ros.bags.writer import BagWriter
from rotcal_ros.foundation.observations import ProbeSample, TableSample, TemperatureSample

MESSAGE = Path(__file__).parents[2] / "msg_defs" / "msg" / "ProbePoint.msg"
POINT = "rotcal_msgs/msg/ProbePoint"
TYPES = {
    names.PROBE_POINT: POINT,
    names.JOINT_STATES: "sensor_msgs/msg/JointState",
    names.TEMPERATURE: "sensor_msgs/msg/Temperature",
}
START_NS = 1_700_000_000_000_000_000

store = get_typestore(Stores.ROS2_KILTED)
store.register(get_types_from_msg(MESSAGE.read_text(), POINT))


def message(record):
    """Return the topic and the fields of the message that carries a record."""
    if isinstance(record, TemperatureSample):
        return names.TEMPERATURE, {"temperature": record.temperature_c, "variance": 0.0}
    if isinstance(record, TableSample):
        values = {"position": record.angle, "velocity": record.velocity}
        arrays = {name: np.array([value]) for name, value in values.items()}
        return names.JOINT_STATES, {"name": ["table"], **arrays, "effort": np.zeros(0)}
    fields = {name: getattr(record, name) for name in ProbeSample.__slots__ if name != "stamp_ns"}
    fields |= {name: np.array(fields[name]) for name in ("position", "position_std")}
    return names.PROBE_POINT, fields | {"kind": int(record.kind)}


def serialised(topic, record, fields):
    """Return the bytes of a message with its header."""
    stamp = store.types["builtin_interfaces/msg/Time"](*divmod(record.stamp_ns, 10**9))
    header = store.types["std_msgs/msg/Header"](stamp, getattr(record, "sensor", "machine"))
    kind = TYPES[topic]
    return bytes(store.serialize_cdr(store.types[kind](header=header, **fields), kind))


def write_bag(folder, configuration):
    """Write the raw streams of the simulated cell; the configuration goes with them."""
    settings = WriterSettings(min_free_bytes=0)
    with BagWriter(folder, settings, ros_distro="kilted") as writer:
        writer.attach(names.CONFIGURATION, "application/yaml", configuration.text.encode())
        channels = {
            topic: writer.channel(
                f"/cell/{topic}",
                kind,
                store.generate_msgdef(kind, ros_version=2)[0],
                store.hash_rihs01(kind),
                qos_text([OfferedQos(depth=10)]),
            )
            for topic, kind in TYPES.items()
        }
        for original in rc.simulate_records(configuration):
            record = replace(original, stamp_ns=original.stamp_ns + START_NS)
            topic, fields = message(record)
            data = serialised(topic, record, fields)
            writer.write(channels[topic], data, record.stamp_ns, record.stamp_ns)
