"""The raw streams of a bag as Parquet, against what rosbags reads."""

from pathlib import Path

import numpy as np
import pytest
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

pytest.importorskip("pyarrow")
import pyarrow as pa
import pyarrow.parquet as parquet
from click.testing import CliRunner

from rotcal_ros.bags import parquet as module
from rotcal_ros.bags.parquet import write_topics
from rotcal_ros.bags.settings import WriterSettings
from rotcal_ros.bags.writer import BagWriter
from rotcal_ros.cli.main import rotcal
from rotcal_ros.foundation.errors import BagError

BAG = Path(__file__).parents[2] / "examples" / "data" / "ball_plate_bag"


def test_each_message_is_a_row_with_the_values_that_rosbags_reads(tmp_path):
    written = {t.topic: t for t in write_topics(BAG, tmp_path / "out")}
    with AnyReader([BAG]) as reader:
        messages = [
            (c.topic, time, reader.deserialize(data, c.msgtype))
            for c, time, data in reader.messages()
        ]
    joints = [(time, m) for topic, time, m in messages if topic == "/cell/joint_states"]
    table = parquet.read_table(written["/cell/joint_states"].path)
    assert table.schema.field("header.stamp").type == pa.int64()
    assert table["log_time_ns"].to_pylist() == [time for time, _ in joints]
    assert table["header.stamp"].to_pylist() == [
        m.header.stamp.sec * 10**9 + m.header.stamp.nanosec for _, m in joints
    ]
    assert table["position"].to_pylist() == [m.position.tolist() for _, m in joints]
    assert table["name"].to_pylist() == [m.name for _, m in joints]
    points = [m for topic, _, m in messages if topic == "/cell/probe_point"]
    table = parquet.read_table(written["/cell/probe_point"].path)
    assert table["position"].to_pylist() == [m.position.tolist() for m in points]
    assert table["tip_radius"].to_pylist() == [m.tip_radius for m in points]
    assert sum(t.messages for t in written.values()) == len(messages)


def test_the_verb_tells_files_and_needs_a_new_folder(tmp_path):
    arguments = ["bag", "parquet", str(BAG), "-o", str(tmp_path / "out")]
    answer = CliRunner().invoke(rotcal, arguments)
    assert answer.exit_code == 0
    assert "583 messages of /cell/joint_states" in answer.output
    with pytest.raises(BagError, match="name a new folder"):
        write_topics(BAG, tmp_path / "out")


FIELDS = (
    "uint8[] blob\nfloat32[3] fixed\nbool[] flags\nint64[<=4] few\nstring[] words\nInner[] inner\n"
    "char one\n" + "=" * 80 + "\nMSG: demo_msgs/Inner\nuint16[] numbers\nstring name\n"
)


def written(folder, count):
    """Write messages with lists of all kinds and lengths; return the bag, and what is in it."""
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(FIELDS, "demo_msgs/msg/Outer"))
    outer, inner = (store.types[f"demo_msgs/msg/{name}"] for name in ("Outer", "Inner"))
    messages = [
        outer(
            blob=np.arange(k * 7, dtype=np.uint8),
            fixed=np.array([k, 0.5, -1.0], np.float32),
            flags=np.array([True, False] * (k % 2)),
            few=np.arange(k % 5, dtype=np.int64) - 2,
            words=["a", ""][: k % 3],
            inner=[inner(np.arange(k, dtype=np.uint16), f"n{k}")] * (k % 2),
            one=65 + k,
        )
        for k in range(count)
    ]
    with BagWriter(folder, WriterSettings(min_free_bytes=0)) as writer:
        channel = writer.channel("/demo", "demo_msgs/msg/Outer", FIELDS)
        for time, message in enumerate(messages):
            data = bytes(store.serialize_cdr(message, "demo_msgs/msg/Outer"))
            writer.write(channel, data, time, time)
    return folder, messages


def test_lists_of_numbers_are_converted_all_at_once(tmp_path, monkeypatch):
    bag, messages = written(tmp_path / "bag", 9)
    converted = []
    plain = module._value
    monkeypatch.setattr(
        module, "_value", lambda value, *rest: converted.append(value) or plain(value, *rest)
    )
    (topic,) = write_topics(bag, tmp_path / "out")
    table = parquet.read_table(topic.path)
    for name in ("blob", "fixed", "flags", "few"):
        assert table[name].to_pylist() == [getattr(m, name).tolist() for m in messages], name
    assert table["words"].to_pylist() == [m.words for m in messages]
    assert table["one"].to_pylist() == [m.one for m in messages]
    assert table["inner"].to_pylist() == [
        [{"numbers": i.numbers.tolist(), "name": i.name} for i in m.inner] for m in messages
    ]
    assert not any(value is m.blob or (np.ndim(value) == 0 and isinstance(value, np.uint8))
                   for value in converted for m in messages)  # fmt: skip
