"""Offline, too, the stream that is at fault is named with what to do."""

from dataclasses import replace

import pytest
from bag_samples import (
    CONFIGURATION,
    START_NS,
    TYPES,
    encode,
    floats,
    open_writer,
    serialised,
)

from rotcal_ros.bags import names
from rotcal_ros.foundation.errors import DataError, RotcalError
from rotcal_ros.foundation.observations import TableSample
from rotcal_ros.recordings.replay import read_recording

NAN = float("nan")


def in_turn(sample):
    """The same joints in changing order."""
    joints = ["arm", "table"], [0.3, sample.angle], [0.0, sample.velocity]
    return tuple(part[::-1] for part in joints) if sample.stamp_ns // 10**7 % 2 else joints


FAULTS = {
    "no position": ("", lambda s: (["table"], [], []), "joint table has no position"),
    "prefix": (
        "table_joint", lambda s: (["left/table_joint"], [s.angle], [s.velocity]),
        "no joint 'table_joint' (cell.joint), it has left/table_joint: name one of these "
        "(is it left/table_joint?)",
    ),
    "prefix too much": (
        "left/table", lambda s: (["arm", "table"], [0.3, s.angle], [0.0, s.velocity]),
        "it has arm, table: name one of these (is it table?)",
    ),
    "changing order": ("", in_turn, "the order of its joints changes"),
    "several": (
        "", lambda s: (["arm", "table"], [0.3, s.angle], [0.0, s.velocity]),
        "has the joints arm, table; the first one, arm, was taken as the table",
    ),
}  # fmt: skip


def recorded(folder, run, joint, states):
    text = CONFIGURATION.replace("    plan:\n", f"    cell: {{joint: '{joint}'}}\n    plan:\n", 1)
    writer, channels = open_writer(folder, configuration=text)
    with writer:
        for number, record in enumerate(run.records):
            now = START_NS + number * 1_000_000
            for role, data in encode(record):
                if isinstance(record, TableSample):
                    listed, position, velocity = states(record)
                    data = serialised(
                        TYPES[role], stamp_ns=record.stamp_ns, name=listed,
                        position=floats(position), velocity=floats(velocity), effort=floats([]),
                    )  # fmt: skip
                if role != names.OBSERVATION:
                    writer.write(channels[role], data, now, now)
    return folder


@pytest.mark.parametrize("fault", FAULTS)
def test_the_joint_at_fault_is_named(fault, simulated_run, tmp_path):
    joint, states, words = FAULTS[fault]
    bag = recorded(tmp_path / "bag", simulated_run, joint, states)
    with pytest.raises(RotcalError) as refused:
        read_recording(bag).solve()
    assert isinstance(refused.value, DataError)
    assert "/cell/joint_states" in str(refused.value)
    assert words in str(refused.value)


@pytest.mark.parametrize("velocity", [[], [NAN]])
def test_a_joint_without_velocity_is_read_by_its_angles(velocity, simulated_run, tmp_path):
    bag = recorded(
        tmp_path / "bag", simulated_run, "table", lambda s: (["table"], [s.angle], velocity)
    )
    setup = read_recording(bag).configuration
    # Over the usual 0.1 s rest is seen too late: the cell stands for hardly longer than a window.
    setup = replace(setup, topics=replace(setup.topics, angle_span_s=0.02))
    found = read_recording(bag, configuration=setup).observations
    accepted = {o.step: o for o in found if o.accepted}
    expected = {o.step: o for o in simulated_run.observations if o.accepted}
    assert accepted.keys() == expected.keys()
    for step, o in expected.items():
        assert accepted[step].mean[0] == pytest.approx(o.mean[0], abs=6 * o.std[0])


@pytest.mark.parametrize("joint", ["table", "left/table_joint"])
def test_a_named_joint_is_found_in_any_order_and_with_its_prefix(joint, simulated_run, tmp_path):
    def states(sample):
        listed, position, velocity = in_turn(sample)
        return [joint if name == "table" else name for name in listed], position, velocity

    bag = recorded(tmp_path / "bag", simulated_run, joint, states)
    assert read_recording(bag).observations == tuple(simulated_run.observations)
