"""The raw streams of a bag as Parquet, against what rosbags reads."""

from pathlib import Path

import pytest
from rosbags.highlevel import AnyReader

pytest.importorskip("pyarrow")
import pyarrow as pa
import pyarrow.parquet as parquet
from click.testing import CliRunner

from rotcal_ros.bags.parquet import write_topics
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
