"""Recording and reading, side by side with the well-known ways.

Environment: ROTCAL_BENCH_SECONDS (length of each recorder run, default 10; 60 for the record),
ROTCAL_BENCH_GB (size of the large bag, default 0.2; 2 for the record).
"""

import json
import os
import shutil
import struct
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import yaml
from mcap_ros2.reader import read_ros2_messages
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

sys.path.insert(0, str(Path(__file__).parents[1] / "test" / "bags"))
from bag_samples import CONFIGURATION, START_NS, encode, open_writer, simulate, writer_settings

from rotcal_history.fleet.batch_solving import BagJob
from rotcal_history.fleet.workers import run_on_cores
from rotcal_ros.bags.decode import Decoder
from rotcal_ros.bags.reader import bag_files, check_files, read_blocks
from rotcal_ros.bags.settings import WriterSettings
from rotcal_ros.foundation.observations import LengthStatus, TracerSample
from rotcal_ros.methods import prepare
from rotcal_ros.methods.configuration import dump_configuration, parse_configuration

SECONDS = float(os.environ.get("ROTCAL_BENCH_SECONDS", "10"))
GIGABYTES = float(os.environ.get("ROTCAL_BENCH_GB", "0.2"))
READINGS = 100_000
READINGS_PER_IMAGE = 10_000
BAGS = 20
TOPIC = "/cell/tracer_length"


def solvable(table_positions: int, box_points: list[int]) -> str:
    """Return a configuration of the sample's cell with so many steps that it can be solved."""
    plan = {
        "table_step_deg": 45.0,
        "table_positions": table_positions,
        "box_points": box_points,
        "box_centre_m": [0.0, 0.0, 0.6],
    }
    groups = yaml.safe_load(CONFIGURATION)["/**"]["ros__parameters"]
    del groups["method"]
    return dump_configuration(
        "tracer_multistation", {**groups, "plan": plan, "solver": {"variant": "station"}}
    )


SOLVABLE, LONGER = solvable(5, [3, 2, 2]), solvable(8, [4, 3, 2])


@dataclass(frozen=True)
class Row:
    """One measurement: ``rate`` in ``unit``, ``ratio`` against the way named first.

    ``lost`` messages are those sent but not recorded, ``noticed`` those that the recorder counted.
    ``growth_mb`` is how much memory grew once the process was warm.
    """

    name: str
    rate: float
    unit: str
    ratio: float | None = None
    lost: int | None = None
    noticed: int | None = None
    cpu_percent: float | None = None
    memory_mb: float | None = None
    growth_mb: float | None = None
    load: float = 0.0


def row(name: str, rate: float, unit: str, **values) -> Row:
    return Row(name, rate, unit, load=os.getloadavg()[0], **values)


def readings(folder: Path, count: int) -> Path:
    """Write a bag of tracer readings."""
    writer, channels = open_writer(folder, WriterSettings(min_free_bytes=0))
    generator = np.random.default_rng(1)
    with writer:
        for number, length in enumerate(generator.normal(size=count).tolist()):
            stamp = START_NS + number * 1_000_000
            sample = TracerSample(stamp, number, length, 1e-7, LengthStatus.OK)
            ((role, data),) = encode(sample)
            writer.write(channels[role], data, stamp, stamp)
    return folder


def our_way(folder: Path) -> np.ndarray:
    wanted = ("header.stamp.sec", "header.stamp.nanosec", "sequence", "length", "status")
    parts, decoder = [], None
    for scan, block in read_blocks(bag_files(folder)):
        if block is not None:
            channel = scan.channels[int(block.headers["channel"][0])]
            decoder = decoder or Decoder(channel)
            for columns in decoder.columns(block, wanted):
                values = [columns.stamp_ns(), *(columns.values[n] for n in wanted[2:])]
                parts.append(np.column_stack(values))
    return np.concatenate(parts)


def plain_row(message) -> tuple:
    stamp = message.header.stamp
    stamp_ns = stamp.sec * 10**9 + stamp.nanosec
    return stamp_ns, message.sequence, message.length, message.status


def rosbags_way(folder: Path) -> np.ndarray:
    with AnyReader([folder], default_typestore=get_typestore(Stores.ROS2_KILTED)) as reader:
        found = [
            plain_row(reader.deserialize(data, connection.msgtype))
            for connection, _, data in reader.messages()
        ]
    return np.array(found, np.float64)


def mcap_way(folder: Path) -> np.ndarray:
    (file,) = bag_files(folder)
    return np.array([plain_row(m.ros_msg) for m in read_ros2_messages(str(file))], np.float64)


def reading(folder: Path) -> Iterator[Row]:
    bag, rates, expected = readings(folder / "bag", READINGS), {}, None
    for name, way in (
        ("rosbags", rosbags_way),
        ("mcap-ros2-support", mcap_way),
        ("ours", our_way),
    ):
        times = []
        for _ in range(3):
            begin = time.perf_counter()
            values = way(bag)
            times.append(time.perf_counter() - begin)
        expected = values if expected is None else expected
        assert np.array_equal(values, expected), f"{name} reads other values"
        rates[name] = READINGS / min(times)
        ratio = (
            min(rates["ours"] / r for r in rates.values() if r != rates["ours"])
            if name == "ours"
            else None
        )
        yield row(f"decoding into arrays, {name}", rates[name], "messages/s", ratio=ratio)


def cell_bag(folder: Path, configuration: str, size: float) -> Path:
    """Write a solvable run, then readings with camera images between them up to ``size`` bytes.

    Every reading is another one, so that there is something to unpack and to decode.
    """
    writer, channels = open_writer(folder, writer_settings(chunk_bytes=1 << 20), configuration)
    run = simulate(configuration)
    messages = [pair for record in run.records for pair in encode(record)]
    ((role, data),) = encode(TracerSample(START_NS, 0, 0.5, 1e-7, LengthStatus.OK))
    reading, image = bytearray(data), np.random.default_rng(2).bytes(1 << 21)
    length_at = data.index(struct.pack("<d", 0.5))
    with writer:
        for number, (role_, data_) in enumerate(messages):
            writer.write(channels[role_], data_, START_NS + number, START_NS + number)
        camera = writer.channel("/cell/image", "demo_msgs/msg/Blob", "uint8[] data\n")
        number, generator = len(messages), np.random.default_rng(3)
        while writer.path.stat().st_size < size:
            for length in generator.normal(0.5, 1e-6, READINGS_PER_IMAGE).tolist():
                now = START_NS + number * 1_000_000
                struct.pack_into("<iI", reading, 4, *divmod(now, 10**9))
                struct.pack_into("<d", reading, length_at, length)
                writer.write(channels[role], bytes(reading), now, now)
                number += 1
            writer.write(camera, image, now, now)
    return folder


def large(folder: Path) -> Iterator[Row]:
    """Solve a bag whose readings go on for hours behind the last step."""
    bag = cell_bag(folder / "bag", SOLVABLE, GIGABYTES * 1e9)
    size = sum(file.stat().st_size for file in bag_files(bag))
    code = (
        "import sys, resource, pathlib\n"
        "from rotcal_ros.cli.main import rotcal\n"
        "try: rotcal(['solve', sys.argv[1], '--json'], standalone_mode=False)\n"
        "except SystemExit: pass\n"
        "print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024, file=sys.stderr)\n"
    )
    begin = time.perf_counter()
    done = subprocess.run([sys.executable, "-c", code, str(bag)], capture_output=True, text=True)
    seconds = time.perf_counter() - begin
    memory = float(done.stderr.strip().splitlines()[-1])
    assert '"verdict"' in done.stdout, done.stderr
    (verdict,) = check_files(bag_files(bag))
    readings_ = verdict.topics[TOPIC].messages / 1e6
    yield row(
        f"solving a bag of {size / 1e9:.2f} GB with {readings_:.1f} million readings",
        size / 1e6 / seconds,
        "MB/s",
        memory_mb=memory,
    )


def many(folder: Path) -> Iterator[Row]:
    """The same twenty bags with one worker and with two."""
    configuration = parse_configuration(LONGER)
    steps = len(prepare(configuration).plan.steps)
    original = cell_bag(folder / "original", LONGER, 0.0)
    for number in range(BAGS):
        shutil.copytree(original, folder / str(number) / "bag")
    seconds = {}
    for workers in (1, 2):
        jobs = []
        for number in range(BAGS):
            cache = folder / f"cache_{workers}_{number}"  # else the first result would do for all
            cache.mkdir()
            jobs.append(BagJob(str(folder / str(number) / "bag"), configuration, str(cache)))
        begin = time.perf_counter()
        outcomes = list(run_on_cores(jobs, workers))
        seconds[workers] = time.perf_counter() - begin
        assert not any(outcome.error or outcome.cached for outcome in outcomes), outcomes[0].error
        yield row(
            f"reprocessing {BAGS} bags of {steps} steps, workers: {workers}",
            BAGS / seconds[workers],
            "bags/s",
            ratio=seconds[1] / seconds[workers],
        )


def rows() -> Iterator[Row]:
    """Measure everything; the live part only where ROS 2 is."""
    for part in (reading, large, many):
        with tempfile.TemporaryDirectory(prefix="rotcal_bench_") as folder:
            yield from part(Path(folder))
    try:
        import rclpy  # noqa: F401
        from live_recording import rows as live
    except ImportError:
        return
    for values in live(SECONDS):
        yield row(**values)


if __name__ == "__main__":
    for measured in rows():
        print(json.dumps(asdict(measured)), flush=True)
