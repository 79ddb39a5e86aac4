"""A bag in which another robot was recorded as well: its messages cost nothing, and no option."""

from __future__ import annotations

import functools
import tracemalloc
from dataclasses import replace

import pytest
from bag_samples import CONFIGURATION, START_NS, floats, serialised
from rearranged import Kept, by_topic, run_messages, write_mcap, write_sqlite

from rotcal_ros.foundation.errors import BagError
from rotcal_ros.nodes.player.replayed_bag import ReplayedBag
from rotcal_ros.recordings.inputs import MeasurementInput
from rotcal_ros.recordings.replay import read_recording

FIRST = START_NS + 2_000_000
PLAN = serialised(
    "rotcal_msgs/msg/CalibrationPlan", stamp_ns=FIRST, plan_id="", method="tracer_multistation",
    configuration=CONFIGURATION, total_steps=32, start_index=0, run=0,
)  # fmt: skip
JOINTS = serialised(
    "sensor_msgs/msg/JointState", stamp_ns=FIRST, name=[f"joint_{n}" for n in range(6)],
    position=floats(range(6)), velocity=floats(range(6)), effort=floats([]),
)  # fmt: skip
PATH = serialised("nav_msgs/msg/Path", stamp_ns=FIRST, poses=[])
TEXT = serialised("std_msgs/msg/String", data="seen")


@functools.cache
def ours() -> list[Kept]:
    """Return the messages of our cell, its plan among them."""
    plan = Kept("/cell/plan", "rotcal_msgs/msg/CalibrationPlan", PLAN, FIRST, FIRST)
    return [plan, *run_messages()]


def robot(count: int, namespace: str = "/robot") -> list[Kept]:
    """Return what a mobile robot publishes, the path of its navigation among it."""
    found = []
    last = run_messages()[-1].log_ns
    for n in range(count):
        now = FIRST + (last - FIRST) * n // count
        found += [
            Kept(f"{namespace}/joint_states", "sensor_msgs/msg/JointState", JOINTS, now, now),
            Kept("/plan", "nav_msgs/msg/Path", PATH, now, now),
            Kept(f"{namespace}/observation", "std_msgs/msg/String", TEXT, now, now),
        ]
    return found


def mixed(*parts: list[Kept]) -> list[Kept]:
    return sorted((m for part in parts for m in part), key=lambda m: m.log_ns)


@pytest.fixture(scope="module")
def expected(tmp_path_factory: pytest.TempPathFactory):
    return read_recording(write_mcap(tmp_path_factory.mktemp("a") / "a.mcap", ours())).observations


@pytest.mark.slow
@pytest.mark.parametrize("attached", [CONFIGURATION, ""])
@pytest.mark.parametrize("order", [mixed, lambda *parts: by_topic(mixed(*parts))])
def test_the_cell_with_a_plan_is_meant(attached, order, expected, tmp_path):
    messages = order(ours(), robot(500))
    path = write_mcap(tmp_path / "a.mcap", messages, configuration=attached)
    assert read_recording(path).observations == expected
    assert (
        MeasurementInput(path, changes=("solver.max_rejected_share=0.3",)).read().observations
        == expected
    )


@pytest.mark.slow
def test_where_the_plan_is_an_attachment_the_cell_with_messages_of_ours_is_meant(tmp_path):
    alone = read_recording(write_mcap(tmp_path / "a.mcap", run_messages())).observations
    both = write_mcap(tmp_path / "b.mcap", mixed(run_messages(), robot(500)))
    assert read_recording(both).observations == alone
    instruments = ("tracer_length", "probe_point", "joint_states")
    second = [
        replace(m, topic=m.topic.replace("/cell/", "/second/"))
        for m in run_messages()
        if m.topic.endswith(instruments)
    ]
    with pytest.raises(BagError, match="say which cell is meant"):
        read_recording(write_mcap(tmp_path / "c.mcap", mixed(run_messages(), second)))


@pytest.mark.slow
def test_in_sqlite_too(expected, tmp_path):
    path = write_sqlite(tmp_path / "a.db3", mixed(ours(), robot(50)))
    assert read_recording(path).observations == expected


def test_two_cells_with_a_plan_must_be_told_apart(expected, tmp_path):
    other = [replace(m, topic=m.topic.replace("/cell/", "/second/")) for m in ours()]
    path = write_mcap(tmp_path / "a.mcap", mixed(ours(), other))
    with pytest.raises(BagError, match="say which cell is meant"):
        read_recording(path)
    assert MeasurementInput(path, namespace="/second").read().observations == expected


def test_what_is_replayed_is_the_cell_as_well(tmp_path):
    bag = ReplayedBag.read(write_mcap(tmp_path / "a.mcap", mixed(ours(), robot(50))))
    assert bag.namespace == "/cell"
    assert len(bag.accepted) == 32


def peak_of(path) -> int:
    tracemalloc.start()
    read_recording(path)
    ReplayedBag.read(path)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return peak


@pytest.mark.slow
def test_memory_does_not_grow_with_the_messages_of_others(tmp_path):
    few, many = (
        write_mcap(tmp_path / f"{n}.mcap", mixed(ours(), robot(n)), chunk_size=100_000)
        for n in (200, 6_000)
    )
    assert many.stat().st_size > 1.1 * few.stat().st_size
    assert peak_of(many) < 1.15 * peak_of(few)
