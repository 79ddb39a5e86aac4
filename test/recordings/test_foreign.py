"""A bag of somebody else's cell: other names, bare numbers, points without steps."""

import math

import pytest
import yaml
from bag_samples import CONFIGURATION, START_NS, STORE, serialised, simulate
from other_messages import write_messages

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


FIELDS = {
    "length_field": "beam.distance", "angle_field": "angle", "position_field": "at",
    "length_clock": "sent", "table_clock": "sent", "probe_clock": "sent",
}  # fmt: skip
OTHER = parse_configuration(
    dump_configuration(
        "tracer_multistation", {**GROUPS, "capture": CAPTURE, "topics": {**NAMES, **FIELDS}}
    )
)
SETUPS = {"ros2": SETUP, "json": OTHER, "protobuf": OTHER}


def sent(records):
    """Topic, fields and time of each message of the instruments, oldest first."""
    for r in records:
        if isinstance(r, TracerSample):
            yield "/etalon/distance_mm", r.length * 1e3, r.stamp_ns
        elif isinstance(r, TableSample):
            yield "/rotary/angle_deg", math.degrees(r.angle), r.stamp_ns
        elif isinstance(r, ProbeSample):
            yield "/cmm/position", r.position, r.stamp_ns


def as_fields(value):
    """A value as the fields of a message of other_bag."""
    if isinstance(value, tuple):
        return {"at": dict(zip("xyz", value, strict=True))}
    return {"beam": {"distance": value}, "angle": value}


def recorded_by_ros(folder, records):
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
        for topic, value, stamp_ns in sent(records):
            if isinstance(value, tuple):
                point = STORE.types["geometry_msgs/msg/Point"](*value)
                data = serialised(types[topic], stamp_ns=stamp_ns, point=point)
            else:
                data = serialised(types[topic], data=value)
            writer.write(channels[topic], data, stamp_ns, stamp_ns)


@pytest.fixture(scope="module", params=SETUPS)
def foreign(request, run, tmp_path_factory):
    """The run of the simulated cell, sent by another one; log times are the stamps."""
    folder = tmp_path_factory.mktemp("foreign") / "bag"
    if request.param == "ros2":
        recorded_by_ros(folder, run.records)
    else:
        rows = ((topic, as_fields(value), t) for topic, value, t in sent(run.records))
        write_messages(folder.with_suffix(".mcap"), request.param, rows)
        folder = folder.with_suffix(".mcap")
    return folder, SETUPS[request.param]


@pytest.mark.slow
def test_bare_numbers_give_the_observations_of_the_full_messages(run, foreign):
    bag, setup = foreign
    found = read_recording(bag, configuration=setup).observations
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
    bag, setup = foreign
    first = read_recording(bag, configuration=setup).observations[0]
    assert first.window_start_ns > START_NS
