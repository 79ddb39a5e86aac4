"""A tracer at 1 kHz and life speed, planner to capture to solver: losses and latency.

Once without the operator's page, once with three viewers of it.

Environment: ROTCAL_BENCH_LIFE_S (seconds of measuring, default 60; 612 for the record).

The latency of an observation is the time from when the last reading of its window was published
until the observation was, by the clock that the middleware stamps both with. It holds the wait
for the next feedback of the table (100 Hz), which must show that the table was still at rest.
"""

import os
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from threading import Thread
from urllib.request import urlopen

import numpy as np

from rotcal_ros.bags.decode import Decoder
from rotcal_ros.bags.reader import bag_files, check_files, read_blocks
from rotcal_ros.foundation.units import NANOSECOND

ROOT = Path(__file__).parents[1]
SECONDS = float(os.environ.get("ROTCAL_BENCH_LIFE_S", "60"))
TRACER, OBSERVATION = "/cell/tracer_length", "/cell/observation"
DEADLINE_S = 60.0
VIEWERS = 3
QUICK_MACHINE = (
    "plan.box_points=[5, 5, 5]",
    "plan.order=targets_per_station",
    "capture.settle_time_s=0.1",
    "capture.window_samples=200",
    "simulation.probe.speed_m_s=2.0",
    "simulation.probe.acceleration_m_s2=20.0",
    "simulation.probe.settling_time_s=0.01",
    "simulation.probe.report_delay_s=0.02",
)
"""1500 steps of 0.6 s, so that ten minutes give a thousand latencies."""


@dataclass(frozen=True)
class Row:
    """Latencies in ms at percentiles.

    ``lost`` readings, of those that the tracer numbered; ``noticed`` are all that the recorder
    counted.
    """

    name: str
    seconds: float
    observations: int
    readings: int
    lost: int
    noticed: int
    median_ms: float
    p99_ms: float
    largest_ms: float


def measured(output: Path, viewers: int) -> Path:
    """Let the cell run for the time, with its page watched, and cancel it; return the bag."""
    command = [
        sys.executable,
        "-m",
        "rotcal_ros.cli.main",
        "run",
        str(ROOT / "config/tracer_simulated.yaml"),
    ]
    command += ["--output", str(output), "--no-report", "--no-export"]
    command += [] if viewers else ["--no-page"]
    command += [part for change in QUICK_MACHINE for part in ("--set", change)]
    with (output.parent / "log").open("w") as log:
        run = subprocess.Popen(command, stdout=log, stderr=log)
        for _ in range(viewers):
            Thread(target=watch, args=(Path(log.name),), daemon=True).start()
        time.sleep(SECONDS)
        run.terminate()  # cancels like Ctrl-C, which a shell may have told us to ignore
        run.wait(DEADLINE_S)
    return output / "bag"


def watch(log: Path) -> None:
    """Take what the page sends to a browser, until it ends."""
    while not (found := re.search(r"page: (http://\S+)", log.read_text())):
        time.sleep(0.1)
    with urlopen(f"{found[1]}/events") as stream, suppress(OSError):
        while stream.read(1000):
            pass


def fields(bag: Path, topic: str, wanted: tuple[str, ...]) -> dict[str, np.ndarray]:
    """Return integer fields of all messages of a topic, and when they were published (ns)."""
    parts: dict[str, list[np.ndarray]] = {name: [] for name in (*wanted, "published")}
    decoder = None
    for scan, block in read_blocks(bag_files(bag)):
        if block is None:
            continue
        (number,) = (n for n, c in scan.channels.items() if c.topic == topic)
        decoder = decoder or Decoder(scan.channels[number])
        chosen = block.select(block.headers["channel"] == number)
        for found in decoder.columns(chosen, wanted):
            parts["published"].append(chosen.headers["publish_time"][found.rows])
            for name in wanted:
                parts[name].append(found.values[name])
    return {name: np.concatenate(arrays).astype(np.int64) for name, arrays in parts.items()}


def stamps_ns(found: dict[str, np.ndarray], name: str) -> np.ndarray:
    """Return the stamps of field ``name``."""
    return found[f"{name}.sec"] * 10**9 + found[f"{name}.nanosec"]


def rows() -> Iterator[Row]:
    """Yield the measurements."""
    yield row("1 kHz tracer at life speed", 0)
    yield row(f"the same, with {VIEWERS} pages open", VIEWERS)


def row(name: str, viewers: int) -> Row:
    """Return one measurement."""
    with tempfile.TemporaryDirectory(prefix="rotcal_bench_") as folder:
        bag = measured(Path(folder) / "out", viewers)
        (verdict,) = check_files(bag_files(bag))
        readings = fields(bag, TRACER, ("header.stamp.sec", "header.stamp.nanosec", "sequence"))
        observed = fields(bag, OBSERVATION, ("window_end.sec", "window_end.nanosec"))
        stamps, ends = stamps_ns(readings, "header.stamp"), stamps_ns(observed, "window_end")
        last = np.searchsorted(stamps, ends)
        assert np.array_equal(stamps[last], ends), "a window ends with a reading that is not there"
        latency_ms = (observed["published"] - readings["published"][last]) * NANOSECOND * 1e3
        gaps = int((np.diff(readings["sequence"]) - 1).sum())
        return Row(
            name,
            float(np.ptp(stamps) * NANOSECOND),
            len(ends),
            len(stamps),
            gaps,
            sum(verdict.losses_recorded.values()),
            *map(float, np.percentile(latency_ms, (50, 99, 100))),
        )


if __name__ == "__main__":
    print(*rows(), sep="\n")
