"""What a live cell costs a processor, and how soon an answer is there, in peace and beside load.

A simulated cell at life speed sends 200 lengths and 50 table angles a second. ``latency``: from
the arrival of the last reading of a window to its observation, and from that of the last reading
of a goal to the final deviations, both by the log times of the bag. ``share``: of one core, by
processor time, once while nobody measures and once from the first to the last step of a goal.

Environment: ROTCAL_BENCH_GOALS (goals in each situation, default 3; 10 for the record),
ROTCAL_BENCH_BUSY (busy processes beside, default 4).
"""

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

from rotcal_ros.foundation.node_names import NODES
from rotcal_ros.foundation.plugins import node_module
from rotcal_ros.foundation.units import NANOSECOND
from rotcal_ros.methods.configuration import changed, read_configuration
from rotcal_ros.sessions.processes import node_environment

ROOT = Path(__file__).parents[1]
GOALS = int(os.environ.get("ROTCAL_BENCH_GOALS", "3"))
BUSY = int(os.environ.get("ROTCAL_BENCH_BUSY", "4"))
CHANGES = (
    "simulation.time_scale=1.0",
    "plan.table_positions=9",
    "plan.box_points=[2, 2, 2]",
    "planner.preflight_timeout_s=60.0",
)
"""72 steps; a goal takes some 30 s."""
IDLE_S = 10.0
LENGTH, OBSERVATION, DEVIATIONS = "/cell/tracer_length", "/cell/observation", "/cell/deviations"


@dataclass(frozen=True)
class Row:
    """One measurement: latencies in ms of ``count`` events, or percent of a core."""

    name: str
    count: int | None = None
    median_ms: float | None = None
    p99_ms: float | None = None
    share_percent: float | None = None


@contextmanager
def busy(count: int) -> Iterator[None]:
    """Keep so many processes busy."""
    made = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(count)]
    try:
        yield
    finally:
        for process in made:
            process.kill()
            process.wait()


class Cell:
    """The nodes of a cell, each a process; its sessions lie in ``folder``."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.file = folder, folder / "cell.yaml"
        paper = read_configuration(ROOT / "config" / "tracer_paper.yaml")
        self.file.write_text(changed(paper, CHANGES).text)
        self._environment = os.environ | node_environment()
        place = ["-p", f"recorder.folder:={json.dumps(str(folder / 'sessions'))}"]
        self._nodes = {
            name: self._started(
                name, "--params-file", str(self.file), *place * (name == "recorder")
            )
            for name in (*NODES, "simulated_cell")
        }

    def _started(self, node: str, *arguments: str) -> subprocess.Popen[str]:
        command = [sys.executable, "-m", node_module(node), "--ros-args"]
        with (self.folder / f"{node}.log").open("a") as log:
            return subprocess.Popen(
                [*command, "-r", "__ns:=/cell", *arguments], env=self._environment, text=True,
                stdin=subprocess.PIPE, stdout=subprocess.PIPE if node == "client" else log,
                stderr=log, cwd=self.folder,
            )  # fmt: skip

    def times(self) -> dict[str, float]:
        """Return the processor time of each node of the suite so far, s, and the time (wall)."""
        found = {"": time.monotonic()}
        for name in NODES:
            stat = Path(f"/proc/{self._nodes[name].pid}/stat").read_text().rpartition(")")[2]
            ticks = sum(map(int, stat.split()[11:13]))
            found[name] = ticks / os.sysconf("SC_CLK_TCK")
        return found

    def goal(self) -> tuple[dict[str, float], dict[str, float]]:
        """Calibrate once; return the times of the first and of the last accepted step."""
        client = self._started("client", "-p", f"configuration_file:={json.dumps(str(self.file))}")
        told: list[dict[str, float]] = []
        assert client.stdout is not None
        for event in map(json.loads, client.stdout):
            if event["event"] == "feedback" and event["accepted"] > 0:
                told = [*told[:1], self.times()]
            if event["event"] in ("result", "refused"):
                assert event.get("error_code") == 0, event
        client.wait()
        return told[0], told[-1]

    def end(self) -> None:
        """End all nodes."""
        for process in self._nodes.values():
            process.terminate()
        for process in self._nodes.values():
            process.wait(60)


def shares(before: dict[str, float], after: dict[str, float]) -> dict[str, float]:
    """Return the percent of a core that each node took."""
    seconds = after[""] - before[""]
    return {name: 100.0 * (after[name] - before[name]) / seconds for name in NODES}


def latencies(bag: Path) -> tuple[list[float], float]:
    """Return the latencies (ms) of all observations, and that of the final deviations."""
    arrived, observed, deviations_ns = {}, [], 0
    topics, last_ns = [LENGTH, OBSERVATION, DEVIATIONS], 0
    with next(bag.glob("*.mcap")).open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        for _, channel, message, value in reader.iter_decoded_messages(
            topics, log_time_order=False
        ):
            if channel.topic == LENGTH:
                arrived[stamp_ns(value.header.stamp)] = message.log_time
            elif channel.topic == OBSERVATION and value.n_samples:
                observed.append((stamp_ns(value.window_end), message.log_time))
            elif channel.topic == DEVIATIONS and value.final:
                deviations_ns = message.log_time
    spent = []
    for end_ns, log_ns in observed:
        if end_ns in arrived:
            spent.append((log_ns - arrived[end_ns]) * NANOSECOND * 1e3)
            last_ns = max(last_ns, arrived[end_ns])
    return spent, (deviations_ns - last_ns) * NANOSECOND * 1e3


def stamp_ns(stamp: Any) -> int:
    """Return a stamp of ROS in nanoseconds."""
    return int(stamp.sec) * 10**9 + int(stamp.nanosec)


def latency(name: str, values: list[float]) -> Row:
    """Return the row of some latencies in ms."""
    return Row(name, len(values), *(float(np.percentile(values, q)) for q in (50, 99)))


def shared(name: str, found: list[dict[str, float]]) -> Iterator[Row]:
    """Yield the mean share of every node and of all."""
    each = {node: float(np.mean([one[node] for one in found])) for node in NODES}
    for node, share in {"all nodes": sum(each.values()), **each}.items():
        yield Row(f"{name}, {node}", len(found), share_percent=share)


def situation(words: str, folder: Path) -> Iterator[Row]:
    """Yield what a cell costs and how soon it answers."""
    folder.mkdir()
    cell = Cell(folder)
    try:
        measuring = [shares(*cell.goal()) for _ in range(GOALS)]
        yield from shared(f"measuring{words}", measuring)
        time.sleep(IDLE_S / 2.0)
        before = cell.times()
        time.sleep(IDLE_S)
        yield from shared(f"idle{words}", [shares(before, cell.times())])
    finally:
        cell.end()
    observations, deviations = [], []
    for bag in sorted((folder / "sessions").glob("*/bag")):
        told, final = latencies(bag)
        observations += told
        deviations.append(final)
    yield latency(f"last reading to observation{words}", observations)
    yield latency(f"last reading to final deviations{words}", deviations)


def rows() -> Iterator[Row]:
    """Yield the measurements, in peace and beside busy processes."""
    with tempfile.TemporaryDirectory(prefix="rotcal_bench_") as place:
        yield from situation("", Path(place) / "peace")
        with busy(BUSY):
            yield from situation(f", beside {BUSY} busy", Path(place) / "busy")
