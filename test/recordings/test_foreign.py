"""A bag of somebody else's cell: other names, bare numbers, points without steps."""

import math

import pytest
import yaml
from bag_samples import CONFIGURATION, START_NS, STORE, serialised, simulate

from rotcal_ros.bags.settings import WriterSettings
from rotcal_ros.bags.writer import BagWriter
from rotcal_ros.foundation.observations import ProbeSample, TableSample, TracerSample
from rotcal_ros.methods.configuration import dump_configuration, parse_configuration
from rotcal_ros.recordings.replay import read_recording

NAMES = {
    "tracer_length": "/etalon/distance_mm",
    "joint_states": "/rotary/angle_deg",
    "probe_point": "/cmm/position",
    "length_unit_m": 1e-3,
    "angle_span_s": 0.02,  # the cell stands for hardly longer than a window takes
    "angle_unit_rad": math.pi / 180.0,
}
GROUPS = yaml.safe_load(CONFIGURATION)["/**"]["ros__parameters"]
GROUPS.pop("method")
GROUPS["simulation"].pop("table")  # one that comes to rest slowly enough to be seen
CAPTURE = {**GROUPS["capture"], "temperature_expected": False, "velocity_tolerance_deg_s": 0.05}
SETUP = parse_configuration(
    dump_configuration("tracer_multistation", {**GROUPS, "capture": CAPTURE, "topics": NAMES})
)


@pytest.fixture(scope="module")
def run():
    return simulate(dump_configuration("tracer_multistation", GROUPS))


@pytest.fixture(scope="module")
def foreign(run, tmp_path_factory):
    """The run of the simulated cell, sent by another one; log times are the stamps."""
    folder = tmp_path_factory.mktemp("foreign") / "bag"
    types = {
        "/etalon/distance_mm": "std_msgs/msg/Float64",
        "/rotary/angle_deg": "std_msgs/msg/Float64",
        "/cmm/position": "geometry_msgs/msg/PointStamped",
    }
    with BagWriter(folder, WriterSettings(min_free_bytes=0)) as writer:
        channels = {
            topic: writer.channel(topic, name, STORE.generate_msgdef(name, ros_version=2)[0])
            for topic, name in types.items()
        }

        def write(topic, data, stamp_ns):
            writer.write(channels[topic], data, stamp_ns, stamp_ns)

        for r in run.records:
            if isinstance(r, TracerSample):
                data = serialised("std_msgs/msg/Float64", data=r.length * 1e3)
                write("/etalon/distance_mm", data, r.stamp_ns)
            elif isinstance(r, TableSample):
                data = serialised("std_msgs/msg/Float64", data=math.degrees(r.angle))
                write("/rotary/angle_deg", data, r.stamp_ns)
            elif isinstance(r, ProbeSample):
                point = STORE.types["geometry_msgs/msg/Point"](*r.position)
                data = serialised(
                    "geometry_msgs/msg/PointStamped", stamp_ns=r.stamp_ns, point=point
                )
                write("/cmm/position", data, r.stamp_ns)
    return folder


@pytest.mark.slow
def test_bare_numbers_give_the_observations_of_the_full_messages(run, foreign):
    found = read_recording(foreign, configuration=SETUP).observations
    accepted = {o.step: o for o in found if o.accepted}
    expected = {o.step: o for o in run.observations if o.accepted}
    assert len(expected) == 32
    assert accepted.keys() == expected.keys()
    for step, o in expected.items():
        # The same readings or, where the table's rest is seen later, ones of the same rest.
        assert accepted[step].mean[0] == pytest.approx(o.mean[0], abs=6 * o.std[0])
        assert accepted[step].probe_position == o.probe_position


@pytest.mark.slow
def test_stamps_are_the_log_times(foreign):
    first = read_recording(foreign, configuration=SETUP).observations[0]
    assert first.window_start_ns > START_NS
