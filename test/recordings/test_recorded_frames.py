"""Static transforms of a bag, held against what the bag is solved to."""

import numpy as np
import pytest
from bag_samples import START_NS, STORE, encode, open_writer, serialised

from rotcal_ros.bags import names
from rotcal_ros.recordings.replay import read_recording
from rotcal_ros.recordings.topics import Topics

KIND = "tf2_msgs/msg/TFMessage"


def transform(parent, child, *translation):
    types = STORE.types
    header = types["std_msgs/msg/Header"](types["builtin_interfaces/msg/Time"](0, 0), parent)
    place = types["geometry_msgs/msg/Vector3"](*translation)
    turn = types["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0)
    moved = types["geometry_msgs/msg/Transform"](place, turn)
    return types["geometry_msgs/msg/TransformStamped"](header, child, moved)


def bag_with(folder, run, *messages):
    writer, channels = open_writer(folder)
    with writer:
        definition = STORE.generate_msgdef(KIND, ros_version=2)[0]
        topic = writer.channel(names.TF_STATIC, KIND, definition)
        for transforms in messages:
            data = serialised(KIND, transforms=[transform(*t) for t in transforms])
            writer.write(topic, data, START_NS, START_NS)
        for number, record in enumerate(run.records):
            for role, data in encode(record):
                writer.write(channels[role], data, START_NS + number, START_NS + number)
    return folder


def test_a_conflict_in_a_bag_is_a_warning_of_its_result(tmp_path, simulated_run):
    bag = bag_with(
        tmp_path / "bag",
        simulated_run,
        [("world", "machine", 1.0, 0.0, 0.0), ("machine", "table_base", 0.0, 0.0, 0.0)],
        [("world", "table_base", 1.2, 0.0, 0.0)],  # stated again: 0.2 m off the axis
    )
    recording = read_recording(bag)
    assert [frame.child for frame in recording.frames] == ["machine", "table_base"]
    (text,) = [text for text in recording.solve().warnings if "tf has" in text]
    assert "table_base in machine at (0.2000, 0.0000, 0.0000) m" in text
    off = float(text.split("m, ")[1].split(" mm")[0])
    assert off == pytest.approx(200.0, abs=1.0)
    again = read_recording(bag, topics=Topics(namespace="/cell"))  # frames are of all cells
    assert again.frames == recording.frames


@pytest.mark.slow
def test_frames_that_agree_leave_the_result_as_it_is_to_the_last_bit(
    tmp_path, simulated_run, run_bag
):
    bag = bag_with(tmp_path / "bag", simulated_run, [("machine", "table_base", 0.0, 0.0, 0.3)])
    with_frames, without = read_recording(bag).solve(), read_recording(run_bag).solve()
    assert not [text for text in with_frames.warnings if "tf has" in text]
    assert np.array_equal(with_frames.deviations["ECC"], without.deviations["ECC"])
