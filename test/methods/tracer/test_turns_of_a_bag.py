"""Bags that hold lengths and angles of a table that turned, and no orders: turns are found."""

import numpy as np
import pytest
from other_messages import write_messages
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore
from turning_scene import assert_true, turning_scene

from rotcal_ros.foundation.errors import BagError, ConfigurationError, DataError
from rotcal_ros.recordings.inputs import MeasurementInput

START_NS = 1_700_000_000_000_000_000
SOLVER = "solver: {length_std_m: 8.0e-8, error_motion_std_m: 0.0}\n"


@pytest.fixture(scope="module")
def scene():
    return turning_scene(41, angles=36, speeds_deg_s=(120.0, -120.0), window_deg=1.02)


def streams_of(scene):
    """Return stamps (s) and lengths (m), and, of a slower feedback, stamps and angles (rad)."""
    every = np.concatenate(scene.readings)
    last = every[-1, 0]
    shown = np.arange(-0.5, last, 1.0 / 250.0) + 0.7e-3  # never where a length was read
    angle = np.interp(shown, every[:, 0], every[:, 1])
    return every[:, 0], every[:, 2], shown, np.deg2rad(angle)


def setup(scene, folder, topics, more=""):
    path = folder / "setup.yaml"
    targets = scene.nominal.ravel().tolist()
    path.write_text(
        f"method: tracer_multistation\ntopics: {{{topics}}}\n{more}"
        f"plan: {{tracer_m: {scene.place.round(3).tolist()}, table_positions: 36, "
        f"table_step_deg: 10, passing_deg: 1.02, targets_m: {targets}}}\n{SOLVER}"
    )
    return path


def ros_bag(scene, folder, pause=(0.0, 0.0)):
    """Write a bag by rosbags: JointState in degrees that wrap, lengths in mm as Float64.

    The feedback says nothing within ``pause`` (s).
    """
    store = get_typestore(Stores.ROS2_HUMBLE)
    types, (read, length, shown, angle) = store.types, streams_of(scene)
    joint, number = "sensor_msgs/msg/JointState", "std_msgs/msg/Float64"
    rows = [
        *((t, "length", 1e3 * x) for t, x in zip(read, length, strict=True)),
        *(
            (t, "angle", np.rad2deg(a) % 360.0)
            for t, a in zip(shown, angle, strict=True)
            if not pause[0] < t < pause[1]
        ),
    ]
    with Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        of = {
            "length": writer.add_connection("/laser/distance", number, typestore=store),
            "angle": writer.add_connection("/cell/joint_states", joint, typestore=store),
        }
        none = np.zeros(0)
        for t, what, value in sorted(rows, key=lambda row: row[0]):
            at = START_NS + round(t * 1e9)
            if what == "length":
                data = store.serialize_cdr(types[number](value), number)
            else:
                stamp = types["builtin_interfaces/msg/Time"](*divmod(at, 10**9))
                header = types["std_msgs/msg/Header"](stamp, "")
                places = np.array([0.3, value])
                message = types[joint](header, ["tilt", "table"], places, none, none)
                data = store.serialize_cdr(message, joint)
            writer.write(of[what], at, data)
    return folder


JOINT = "cell: {joint: table}\n"
RENAMED = "tracer_length: /laser/distance, length_unit: mm, angle_unit: deg"


@pytest.fixture(scope="module")
def bag(scene, tmp_path_factory):
    return ros_bag(scene, tmp_path_factory.mktemp("turns") / "bag")


def test_a_bag_of_rosbags_with_a_slower_feedback_that_wraps(scene, bag, tmp_path):
    measured = MeasurementInput(bag, setup(scene, tmp_path, RENAMED, JOINT)).read()
    assert measured.configuration.plan.turning_deg_s == pytest.approx((120.0, -120.0), rel=1e-5)
    assert_true(scene, measured, 2e-9)
    assert min(o.window_start_ns for o in measured.observations) > START_NS


def test_a_bag_of_mcaps_own_library_with_a_broken_beam(scene, tmp_path):
    read, length, shown, angle = streams_of(scene)
    fifth = slice(*(np.searchsorted(read, [scene.readings[4][k, 0] for k in (0, -1)])))
    broken = slice(fifth.start + 1025, fifth.start + 1040)
    length = length.copy()
    length[broken.stop : fifth.stop + 1] += 3e-3
    dark = set(range(broken.start, broken.stop))
    rows = [
        *(
            (
                "/cell/tracer_length",
                {"beam": {"distance": "NaN" if k in dark else x}},
                START_NS + round(t * 1e9),
            )
            for k, (t, x) in enumerate(zip(read.tolist(), length.tolist(), strict=True))
        ),
        *(
            ("/cell/joint_states", {"axis": {"position": a}}, START_NS + round(t * 1e9))
            for t, a in zip(shown.tolist(), angle.tolist(), strict=True)
        ),
    ]
    bag = tmp_path / "cell.mcap"
    write_messages(bag, "json", sorted(rows, key=lambda row: row[2]))
    fields = (
        "length_field: beam.distance, angle_field: axis.position, length_clock: sent, "
        "table_clock: sent"
    )
    measured = MeasurementInput(bag, setup(scene, tmp_path, fields)).read()
    refused = [o for o in measured.observations if not o.accepted]
    assert [(o.target, o.station) for o in refused] == [(2, 0)]
    assert "beam broken" in refused[0].reason
    of_turn = [o for o in measured.observations if (o.target, o.station) == (2, 0)]
    assert len({o.segment for o in of_turn if o.accepted}) == 2
    assert measured.solve().verdict == "ok"


def test_what_the_bag_leaves_open_is_asked_for(scene, bag, tmp_path):
    with pytest.raises(DataError, match="has the joints tilt, table"):
        MeasurementInput(bag, setup(scene, tmp_path, RENAMED)).read()
    with pytest.raises(DataError, match=r"nothing was read on .*tracer_length.*/laser/distance"):
        MeasurementInput(bag, setup(scene, tmp_path, "angle_unit: deg", JOINT)).read().solve()
    with pytest.raises(BagError, match="holds no configuration"):
        MeasurementInput(bag).read()
    path = setup(scene, tmp_path, RENAMED, JOINT)
    text = path.read_text()
    path.write_text(text.replace(", targets_m", "} #"))
    with pytest.raises(ConfigurationError, match="needs the places of its targets"):
        MeasurementInput(bag, path).read()


def test_an_angle_at_which_the_feedback_paused_is_refused(scene, tmp_path):
    at = float(np.interp(-200.0, -scene.readings[1][:, 1], scene.readings[1][:, 0]))
    bag = ros_bag(scene, tmp_path / "bag", (at - 0.03, at + 0.03))
    more = JOINT + "capture: {table_silence_s: 0.05}\n"
    measured = MeasurementInput(bag, setup(scene, tmp_path, RENAMED, more)).read()
    refused = [o for o in measured.observations if not o.accepted]
    assert [(o.target, o.station, o.table_position) for o in refused] == [(0, 1, 20)]
    assert "feedback paused" in refused[0].reason


def plain_rows(scene, angle_message):
    read, length, shown, angle = streams_of(scene)
    return sorted(
        [
            *(("/cell/tracer_length", {"distance": x}, START_NS + round(t * 1e9))
              for t, x in zip(read.tolist(), length.tolist(), strict=True)),
            *(("/cell/joint_states", angle_message(a), START_NS + round(t * 1e9))
              for t, a in zip(shown.tolist(), angle.tolist(), strict=True)),
        ],
        key=lambda row: row[2],
    )  # fmt: skip


PLAIN = "length_field: distance, angle_field: at, length_clock: sent, table_clock: sent"


def test_a_bag_that_breaks_off_says_so_where_turns_are_missing(scene, tmp_path):
    bag = tmp_path / "cell.mcap"
    write_messages(bag, "json", plain_rows(scene, lambda a: {"at": a}))
    bag.write_bytes(bag.read_bytes()[: bag.stat().st_size * 3 // 5])
    with pytest.raises(DataError, match=r"found \d turns.*cell\.mcap.*truncated at byte"):
        MeasurementInput(bag, setup(scene, tmp_path, PLAIN)).read()


def test_of_a_list_of_angles_it_is_asked_which_one_is_the_tables(scene, tmp_path):
    bag = tmp_path / "cell.mcap"
    write_messages(bag, "json", plain_rows(scene, lambda a: {"at": [0.3, a]}))
    with pytest.raises(
        BagError, match=r"at is a list of numbers: say which of them .* as at\.0 for"
    ):
        MeasurementInput(bag, setup(scene, tmp_path, PLAIN)).read()
    second = PLAIN.replace("at,", "at.1,")
    measured = MeasurementInput(bag, setup(scene, tmp_path, second)).read()
    assert_true(scene, measured, 2e-9)
