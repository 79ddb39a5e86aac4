"""Other readers read our bags, and we read theirs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import zstandard
from bag_samples import STORE, TYPES, Run, encode
from mcap.reader import make_reader
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType, Writer
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import CompressionFormat, CompressionMode, Reader, StoragePlugin
from rosbags.rosbag2 import Writer as RosbagsWriter

from rotcal_ros.bags import names
from rotcal_ros.bags.reader import bag_files, check_files, read_blocks
from rotcal_ros.bags.repair import repair
from rotcal_ros.bags.storage_scan import FileVerdict
from rotcal_ros.foundation.errors import BagError
from rotcal_ros.foundation.observations import TracerSample
from rotcal_ros.recordings.replay import read_recording

FIRST = 300


def messages(run: Run) -> list[tuple[str, bytes]]:
    return [pair for record in run.records[:FIRST] for pair in encode(record)]


def test_rosbags_reads_folder_and_file(run_bag: Path, simulated_run: Run) -> None:
    expected = messages(simulated_run)
    for path in (run_bag, run_bag / "run_0.mcap"):
        with Reader(path) as reader:
            read = [(c.topic.rpartition("/")[2], bytes(data)) for c, _, data in reader.messages()]
            assert sorted(read[: len(expected)]) == sorted(expected)
            assert reader.message_count == len(read)
            assert {c.topic: c.msgtype for c in reader.connections} == {
                f"/cell/{role}": type_name for role, type_name in TYPES.items()
            }
            assert all(c.ext.offered_qos_profiles for c in reader.connections)  # type: ignore[union-attr]


def test_rosbags_anyreader_accepts_definitions_and_hashes(
    run_bag: Path, simulated_run: Run
) -> None:
    sample = next(r for r in simulated_run.records if isinstance(r, TracerSample))
    with AnyReader([run_bag]) as reader:
        wanted = [c for c in reader.connections if c.topic == "/cell/tracer_length"]
        connection, _, data = next(reader.messages(wanted))
        message: Any = reader.deserialize(data, connection.msgtype)
    assert (message.length, message.sequence) == (sample.length, sample.sequence)


def test_mcap_reads_with_crcs_and_ros2_decoder(run_bag: Path, simulated_run: Run) -> None:
    path = run_bag / "run_0.mcap"
    sample = next(r for r in simulated_run.records if isinstance(r, TracerSample))
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()], validate_crcs=True)
        header = reader.get_header()
        assert header.profile == "ros2"
        decoded = next(iter(reader.iter_decoded_messages(topics=["/cell/tracer_length"])))
        assert decoded.decoded_message.length == sample.length
        assert {"configuration.yaml", "definitions.json"} <= {
            attachment.name for attachment in reader.iter_attachments()
        }
        channels = reader.get_summary().channels.values()  # type: ignore[union-attr]
        for channel in channels:
            role = channel.topic.rpartition("/")[2]
            assert channel.metadata["topic_type_hash"] == STORE.hash_rihs01(TYPES[role])
            assert "reliability: reliable" in channel.metadata["offered_qos_profiles"]
    with path.open("rb") as file:
        kinds = [type(r).__name__ for r in StreamReader(file, validate_crcs=True).records]
    assert kinds.count("Message") == len(simulated_run.records) + 32  # 32 orders are two messages
    assert kinds[-1] == "Footer"


def write_mcap(path: Path, run: Run, **options: Any) -> None:
    with path.open("wb") as file:
        writer = Writer(file, **options)
        writer.start(profile="ros2", library="somebody else")
        channels = {}
        for role, type_name in TYPES.items():
            text = STORE.generate_msgdef(type_name, ros_version=2)[0]
            schema = writer.register_schema(type_name, "ros2msg", text.encode())
            channels[role] = writer.register_channel(f"/{role}", "cdr", schema)
        for time, (role, data) in enumerate(messages(run)):
            writer.add_message(channels[role], time, data, time)
        writer.finish()


def read(path: Path) -> tuple[list[tuple[str, bytes]], tuple[FileVerdict, ...]]:
    files = bag_files(path)
    found = [
        (
            scan.channels[int(block.headers["channel"][i])].topic.rpartition("/")[2],
            block.payload(i),
        )
        for scan, block in read_blocks(files)
        if block is not None
        for i in range(len(block))
    ]
    return found, check_files(files)


@pytest.mark.parametrize(
    "options",
    [
        {"use_chunking": False},
        {"use_chunking": False, "enable_crcs": False, "use_statistics": False},
        {"compression": CompressionType.NONE, "chunk_size": 4000},
        {"compression": CompressionType.LZ4, "chunk_size": 4000},
        {"compression": CompressionType.ZSTD},
        {"enable_crcs": False, "repeat_channels": False, "repeat_schemas": False},
    ],
    ids=["unchunked", "bare", "uncompressed", "lz4", "zstd", "no crc"],
)
def test_mcap_files_of_others(options: dict[str, Any], simulated_run: Run, tmp_path: Path) -> None:
    write_mcap(tmp_path / "theirs.mcap", simulated_run, **options)
    found, (verdict,) = read(tmp_path / "theirs.mcap")
    assert found == messages(simulated_run)
    assert verdict.state == "complete"


@pytest.mark.parametrize("options", [{"use_chunking": False}, {"chunk_size": 3000}])
def test_cut_off_files_of_others(
    options: dict[str, Any], simulated_run: Run, tmp_path: Path
) -> None:
    write_mcap(tmp_path / "theirs.mcap", simulated_run, **options)
    data = (tmp_path / "theirs.mcap").read_bytes()
    expected = messages(simulated_run)
    for cut in range(1000, len(data), max(1, len(data) // 40)):
        (tmp_path / "cut.mcap").write_bytes(data[:cut])
        found, (verdict,) = read(tmp_path / "cut.mcap")
        assert found == expected[: len(found)]
        assert verdict.state == "truncated"


@pytest.mark.parametrize("plugin", [StoragePlugin.MCAP, StoragePlugin.SQLITE3])
@pytest.mark.parametrize("with_metadata", [True, False])
def test_bags_written_by_rosbags(
    plugin: StoragePlugin, with_metadata: bool, simulated_run: Run, tmp_path: Path
) -> None:
    folder = tmp_path / "theirs"
    with RosbagsWriter(folder, version=9, storage_plugin=plugin) as writer:
        connections = {
            role: writer.add_connection(f"/{role}", type_name, typestore=STORE)
            for role, type_name in TYPES.items()
        }
        for time, (role, data) in enumerate(messages(simulated_run)):
            writer.write(connections[role], time, data)
    if not with_metadata:
        (folder / "metadata.yaml").unlink()
    found, (verdict,) = read(folder)
    assert found == messages(simulated_run)
    assert verdict.state == "complete"


@pytest.mark.parametrize("plugin", [StoragePlugin.MCAP, StoragePlugin.SQLITE3])
@pytest.mark.parametrize("mode", [CompressionMode.FILE, CompressionMode.MESSAGE])
@pytest.mark.parametrize("with_metadata", [True, False])
def test_compressed_bags_are_read_and_repaired_for_everybody(
    plugin: StoragePlugin, mode: CompressionMode, with_metadata: bool, simulated_run: Run,
    tmp_path: Path,
) -> None:  # fmt: skip
    writer = RosbagsWriter(tmp_path / "zipped", version=9, storage_plugin=plugin)
    writer.set_compression(mode, CompressionFormat.ZSTD)
    expected = [pair for pair in messages(simulated_run) if pair[0] == names.TRACER_LENGTH]
    with writer:
        connection = writer.add_connection(
            "/tracer_length", TYPES[names.TRACER_LENGTH], typestore=STORE
        )
        for time, (_, data) in enumerate(expected):
            writer.write(connection, time, data)
    if not with_metadata:
        (tmp_path / "zipped" / "metadata.yaml").unlink()
    found, (verdict,) = read(tmp_path / "zipped")
    assert found == expected
    assert verdict.describe() == "complete"
    repair(tmp_path / "zipped", tmp_path / "good")
    with Reader(tmp_path / "good") as reader:
        assert [bytes(data) for _, _, data in reader.messages()] == [data for _, data in expected]


def test_a_broken_packed_message_is_counted(simulated_run: Run, tmp_path: Path) -> None:
    whole = [zstandard.compress(data) for _, data in messages(simulated_run)[2:5]]
    with (tmp_path / "a.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start()
        channel = writer.register_channel("/a", "cdr", 0)
        for data in (whole[0], whole[1][:-3], whole[2]):
            writer.add_message(channel, 0, data, 0)
        writer.finish()
    found, (verdict,) = read(tmp_path / "a.mcap")
    assert found == [
        ("a", data) for _, data in (messages(simulated_run)[2], messages(simulated_run)[4])
    ]
    assert (verdict.state, verdict.messages, verdict.lost) == ("damaged", 2, 1)


def test_a_compression_that_nobody_here_knows_is_named(simulated_run: Run, tmp_path: Path) -> None:
    write_mcap(tmp_path / "a.mcap", simulated_run)
    stated = "  compression_format: lz9\n  compression_mode: MESSAGE\n"
    (tmp_path / "metadata.yaml").write_text(f"rosbag2_bagfile_information:\n{stated}")
    with pytest.raises(BagError, match="one by one as 'lz9'"):
        read(tmp_path)


def test_a_cut_file_that_was_compressed_as_a_whole(simulated_run: Run, tmp_path: Path) -> None:
    write_mcap(tmp_path / "a.mcap", simulated_run, chunk_size=3000)
    packed = zstandard.compress((tmp_path / "a.mcap").read_bytes())
    (tmp_path / "b.mcap.zstd").write_bytes(packed[: len(packed) * 3 // 4])
    found, (verdict,) = read(tmp_path / "b.mcap.zstd")
    expected = messages(simulated_run)
    assert verdict.state == "truncated"
    assert found == expected[: len(found)]
    (tmp_path / "c.mcap.zstd").write_bytes(b"no zstd")
    with pytest.raises(BagError, match="cannot be unpacked"):
        read(tmp_path / "c.mcap.zstd")


def test_the_ending_may_be_in_capitals(simulated_run: Run, tmp_path: Path) -> None:
    write_mcap(tmp_path / "THEIRS.MCAP", simulated_run)
    assert bag_files(tmp_path) == (tmp_path / "THEIRS.MCAP",)
    assert read(tmp_path / "THEIRS.MCAP")[0] == messages(simulated_run)


def test_files_are_read_in_the_order_of_their_numbers(tmp_path: Path) -> None:
    for number in (10, 2, 0, 1):
        (tmp_path / f"session_{number}.mcap").write_bytes(b"")
    assert [p.name for p in bag_files(tmp_path)] == [
        f"session_{number}.mcap" for number in (0, 1, 2, 10)
    ]


def test_bag_of_something_else_holds_no_configuration(simulated_run: Run, tmp_path: Path) -> None:
    write_mcap(tmp_path / "theirs.mcap", simulated_run)
    with pytest.raises(BagError, match="holds no configuration") as refused:
        read_recording(tmp_path / "theirs.mcap")
    assert "`rotcal solve BAG --setup SETUP.yaml -o RESULT.json`" in str(refused.value)


def test_a_folder_around_a_bag_and_a_file_that_is_none_get_a_hint(tmp_path):
    (tmp_path / "run" / "bag").mkdir(parents=True)
    with pytest.raises(BagError, match=r"no \.mcap or \.db3 file in the folder; name another$"):
        bag_files(tmp_path / "run")
    (tmp_path / "run" / "bag" / "bag_0.mcap").write_bytes(b"")
    with pytest.raises(BagError, match=r"did you mean .*run/bag"):
        bag_files(tmp_path / "run")
    (tmp_path / "table.xlsx").write_bytes(b"PK")
    with pytest.raises(BagError, match="a plain table is text with commas"):
        bag_files(tmp_path / "table.xlsx")
