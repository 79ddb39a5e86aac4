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
from rotcal_ros.foundation.observations import (
    Command,
    ProbeSample,
    TableSample,
    TemperatureSample,
    TracerSample,
)

MESSAGES = Path(__file__).parents[2] / "msg_defs" / "msg"
TYPES = {
    names.PROBE_POINT: "rotcal_msgs/msg/ProbePoint",
    names.JOINT_STATES: "sensor_msgs/msg/JointState",
    names.TEMPERATURE: "sensor_msgs/msg/Temperature",
    names.TRACER_LENGTH: "rotcal_msgs/msg/TracerLength",
    names.TABLE_ANGLE: "rotcal_msgs/msg/TableAngle",
    names.PROBE_TARGET: "rotcal_msgs/msg/ProbeTarget",
}
START_NS = 1_700_000_000_000_000_000

store = get_typestore(Stores.ROS2_KILTED)
for kind in TYPES.values():
    if kind.startswith("rotcal_msgs"):
        text = (MESSAGES / f"{kind.rpartition('/')[2]}.msg").read_text()
        store.register(get_types_from_msg(text, kind))


def messages(record):
    """Yield topic, frame and fields of the messages that carry a record or an order."""
    if isinstance(record, TemperatureSample):
        fields = {"temperature": record.temperature_c, "variance": 0.0}
        yield names.TEMPERATURE, record.sensor, fields
    elif isinstance(record, TableSample):
        values = {"position": record.angle, "velocity": record.velocity}
        arrays = {name: np.array([value]) for name, value in values.items()}
        fields = {"name": ["table"], **arrays, "effort": np.zeros(0)}
        yield names.JOINT_STATES, "machine", fields
    elif isinstance(record, TracerSample):
        yield names.TRACER_LENGTH, "tracer", {**plain(record), "status": int(record.status)}
    elif isinstance(record, ProbeSample):
        yield names.PROBE_POINT, "machine", {**plain(record), "kind": int(record.kind)}
    elif isinstance(record, Command):
        order = {"step": record.step, "attempt": record.attempt}
        table = {"angle": record.table_angle, "approach": int(record.approach)}
        turn = {"turn_speed": 0.0, "turn_begin": 0.0, "turn_end": 0.0, "turn_anew": False}
        yield names.TABLE_ANGLE, "table_base", order | table | turn
        where = {name: plain(record)[name] for name in ("target", "station", "position")}
        fields = order | where | {"kind": int(record.kind), "approach": np.zeros(3)}
        yield names.PROBE_TARGET, "machine", fields


def plain(record):
    """Return the fields of a record but its stamp, tuples as arrays."""
    fields = {name: getattr(record, name) for name in record.__slots__ if name != "stamp_ns"}
    return {name: np.array(v) if isinstance(v, tuple) else v for name, v in fields.items()}


def serialised(topic, stamp_ns, frame, fields):
    """Return the bytes of a message with its header."""
    stamp = store.types["builtin_interfaces/msg/Time"](*divmod(stamp_ns, 10**9))
    header = store.types["std_msgs/msg/Header"](stamp, frame)
    kind = TYPES[topic]
    return bytes(store.serialize_cdr(store.types[kind](header=header, **fields), kind))


def write_bag(folder, configuration, timed=None):
    """Write the raw streams of the simulated cell; the configuration goes with them.

    ``timed`` are other records, each after its time in ns.
    """
    if timed is None:
        records = rc.simulate_records(configuration)
        moved = (replace(record, stamp_ns=record.stamp_ns + START_NS) for record in records)
        timed = ((record.stamp_ns, record) for record in moved)
    rows = [(time, *message) for time, record in timed for message in messages(record)]
    settings = WriterSettings(min_free_bytes=0)
    # With a clock that stands still the bag is the same whenever it is made.
    with BagWriter(folder, settings, ros_distro="kilted", clock=lambda: START_NS) as writer:
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
            if any(row[1] == topic for row in rows)
        }
        for time, topic, frame, fields in rows:
            writer.write(channels[topic], serialised(topic, time, frame, fields), time, time)
