"""The paper's experiment, live: how long until the deviations are there; cold start."""

import json
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from mcap.reader import make_reader

from rotcal_ros.foundation.units import NANOSECOND

ROOT = Path(__file__).parents[1]
BIN = Path(sys.executable).parent
REPEATS = 7


@dataclass(frozen=True)
class Row:
    """One measurement; an opponent, where there is one, was timed in the same run."""

    name: str
    ours_s: float
    opponent: str | None = None
    opponent_s: float | None = None
    ratio: float | None = None


def best_time(*command: str) -> float:
    """Return the shortest of several wall times of a command, s."""
    times = []
    for _ in range(REPEATS):
        begin = time.perf_counter()
        subprocess.run(command, check=True, capture_output=True)
        times.append(time.perf_counter() - begin)
    return min(times)


def best_processor_time(*command: str) -> float:
    """Return the least of several processor times (user and system) of a command, s."""
    times = []
    for _ in range(REPEATS):
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        subprocess.run(command, check=False, capture_output=True)  # the verdict is an exit code
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        times.append(after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime)
    return min(times)


def solving(bag: Path) -> Iterator[Row]:
    """Yield what solving the recorded experiment again takes; numpy alone is the floor."""
    floor = best_processor_time(sys.executable, "-c", "import numpy, scipy.special, scipy.linalg")
    for source in ("streams", "observations"):
        command = (str(BIN / "rotcal"), "solve", str(bag), "--from", source, "--json")
        ours = best_processor_time(*command)
        name = f"rotcal solve of its bag from {source}, processor time"
        yield Row(name, ours, "loading numpy and scipy", floor, floor / ours)


def last_observation_to_deviations(bag: Path) -> float:
    """Return the seconds from the last observation to the final deviations, as recorded."""
    last = {"/cell/observation": 0, "/cell/deviations": 0}
    with next(bag.glob("*.mcap")).open("rb") as file:
        for _, channel, message in make_reader(file).iter_messages(topics=list(last)):
            last[channel.topic] = message.log_time
    return (last["/cell/deviations"] - last["/cell/observation"]) * NANOSECOND


def rows() -> Iterator[Row]:
    """Yield the measurements."""
    ours = best_time(str(BIN / "rotcal"), "--help")
    other = best_time(str(BIN / "colcon"), "--help")
    yield Row("cold start of rotcal --help", ours, "colcon --help", other, other / ours)
    with tempfile.TemporaryDirectory() as folder:
        output = Path(folder) / "demo"
        command = [
            str(BIN / "rotcal"),
            "run",
            str(ROOT / "config" / "tracer_paper.yaml"),
            "--json",
        ]
        command += ["--no-report", "--no-export", "--output", str(output)]
        done = subprocess.run(command, check=True, capture_output=True, text=True)
        yield Row("the paper's experiment live, 704 steps", json.loads(done.stdout)["seconds"])
        yield Row(
            "last observation to the published deviations",
            last_observation_to_deviations(output / "bag"),
        )
        yield from solving(output / "bag")
