"""Bags as ROS 2 Lyrical writes them: its types, and its names of files."""

import json
from pathlib import Path

import pytest
from click.testing import CliRunner
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from rotcal_ros.bags import names
from rotcal_ros.bags.reader import bag_files, read_blocks
from rotcal_ros.cli.main import rotcal

ROOT = Path(__file__).parents[2]
BAG = ROOT / "test" / "golden" / "tracer_six" / "bag"
OTHER_THERE = "lifecycle_msgs/msg/TransitionEvent"
"""Lyrical has defined it anew; no calibration reads it."""


def lyrical_name(number):
    return f"{number}_table_2026_05_23-10_{number:02}_00.mcap"


@pytest.mark.parametrize(
    "stems",
    [
        [lyrical_name(number).removesuffix(".mcap") for number in range(12)],
        ["bag", "bag_0", "bag_2", "bag_10"],
        ["a2", "a10", "b1"],
    ],
)
def test_files_are_read_in_the_order_of_the_numbers_in_their_names(tmp_path, stems):
    for stem in stems:
        (tmp_path / f"{stem}.mcap").touch()
    assert [file.stem for file in bag_files(tmp_path)] == stems


def as_lyrical(source, target):
    """Write a bag again with the common types of Lyrical, in one file that is named as there."""
    store = get_typestore(Stores.ROS2_LYRICAL)
    with (
        AnyReader([source]) as reader,
        Writer(target, version=9, storage_plugin=StoragePlugin.MCAP) as writer,
    ):
        taken = [c for c in reader.connections if c.msgtype != OTHER_THERE]
        for connection in taken:
            types = get_types_from_msg(connection.msgdef.data, connection.msgtype)
            store.register({n: t for n, t in types.items() if n.startswith("rotcal_msgs/")})
        written = {c.id: writer.add_connection(c.topic, c.msgtype, typestore=store) for c in taken}
        for connection, timestamp, data in reader.messages(taken):
            writer.write(written[connection.id], timestamp, data)
    (file,) = target.glob("*.mcap")
    metadata = target / "metadata.yaml"
    metadata.write_text(metadata.read_text().replace(file.name, lyrical_name(0)))
    file.rename(file.with_name(lyrical_name(0)))


@pytest.mark.slow
def test_a_bag_of_its_types_gives_the_same_deviations(tmp_path):
    bag = tmp_path / "bag"
    as_lyrical(BAG, bag)
    scan = [scan for scan, _ in read_blocks(bag_files(BAG))][-1]
    setup = tmp_path / "setup.yaml"
    setup.write_bytes(scan.attachments[names.CONFIGURATION].data)
    run = CliRunner().invoke(rotcal, ["solve", str(bag), "--setup", str(setup), "--json"])
    assert run.exit_code == 0, run.output
    solved, stored = json.loads(run.stdout), json.loads((BAG.parent / "result.json").read_text())
    assert solved["angles_rad"] == stored["angles_rad"]
    for name, values in stored["deviations"].items():
        assert solved["deviations"][name] == pytest.approx(values, rel=1e-6, abs=1e-12)
