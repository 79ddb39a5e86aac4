"""Calibrations beside a busy machine, with nodes that stand still: every one has to end well.

usage: python scripts/soak.py [--minutes 60] [--busy 4 10 25] [--methods tracer ...] [--seed 1]
                              [--set plan.table_positions=36]

Each method is measured once in peace; then, until the time is up, again and again beside
``busy`` processes per core, while a node at random is stopped (SIGSTOP) for 2 s every few seconds.
A session is good when it ends by itself with the verdict ok, its result is that of the quiet one
within their noise, and no confirmed observation is missing in its bag. The memory of every node is
reported, and how it grows. Exit code 1 where a session was not good; figures as JSON in
out/soak.json.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np

from rotcal_ros.foundation.machine_load import core_count, describe_load
from rotcal_ros.foundation.node_names import EXECUTABLES
from rotcal_ros.foundation.plugins import node_module
from rotcal_ros.foundation.results import Result
from rotcal_ros.recordings.replay import read_recording

ROOT = Path(__file__).parents[1]
NODE_OF = {node_module(name): name for name in EXECUTABLES}
STOP_S, EVERY_S = 2.0, (3.0, 8.0)
MOST = 5.0
"""Largest difference of two results, in its own standard deviations: of some 30 values."""
SESSIONS = {
    "tracer": ("tracer_paper", "plan.table_positions=9", "plan.box_points=[3, 2, 3]",
               "simulation.time_scale=8.0", "solver.length_std_m=8.0e-8"),
    "ball_plate": ("ball_plate_demo", "plan.plate.grid=12", "simulation.plate.grid=12",
                   "plan.plate.ball_steps=[0, 1, 3, 5, 8, 9]", "plan.rounds=1",
                   "simulation.plate.ball_steps=[0, 1, 3, 5, 8, 9]"),
    "plane_mirror": ("plane_mirror_demo",),
    "tracer_six": ("tracer_six_demo", "plan.table_positions=6", "plan.table_step_deg=60.0",
                   "plan.box_points=[3, 2, 2]"),
    "tracer_turning": ("tracer_turning_demo",),
    "table_balls": ("table_balls_demo",),
    "angle_comparison": ("angle_comparison_demo",),
}  # fmt: skip
"""Method -> configuration and changes that make its plan short."""


@contextmanager
def busy(per_core: int) -> Iterator[None]:
    """Keep so many processes per core busy."""
    code = "while True: pass"
    made = [subprocess.Popen([sys.executable, "-c", code]) for _ in range(per_core * core_count())]
    try:
        yield
    finally:
        for process in made:
            process.kill()
            process.wait()


class Nodes:
    """The nodes of a session: stops them at random, and follows their memory."""

    def __init__(self, parent: int, generator: random.Random, *, stops: bool) -> None:
        self._parent, self._generator, self._stops = parent, generator, stops
        self.stopped = 0
        self.memory: dict[str, list[tuple[float, float]]] = {}
        self._ended = threading.Event()
        self._threads = [threading.Thread(target=t) for t in (self._follow, self._stop)]
        for thread in self._threads:
            thread.start()

    def end(self) -> None:
        """Leave the nodes alone."""
        self._ended.set()
        for thread in self._threads:
            thread.join()

    def found(self) -> dict[str, int]:
        """Return name -> process id."""
        found = {}
        for folder in Path("/proc").glob("[0-9]*"):
            with suppress(OSError, IndexError):
                stat = (folder / "stat").read_text().rpartition(")")[2].split()
                module = (folder / "cmdline").read_bytes().split(b"\0")[2].decode()
                if int(stat[1]) == self._parent and module in NODE_OF:
                    found[NODE_OF[module]] = int(folder.name)
        return found

    def _stop(self) -> None:
        while self._stops and not self._ended.wait(self._generator.uniform(*EVERY_S)):
            nodes = self.found()
            if not nodes:
                continue
            pid = nodes[self._generator.choice(sorted(nodes))]
            with suppress(ProcessLookupError):
                os.kill(pid, signal.SIGSTOP)
                self.stopped += 1
                self._ended.wait(STOP_S)
                os.kill(pid, signal.SIGCONT)

    def _follow(self) -> None:
        while not self._ended.wait(1.0):
            for name, pid in self.found().items():
                with suppress(OSError, IndexError, StopIteration):
                    lines = Path(f"/proc/{pid}/status").read_text().splitlines()
                    kilobytes = next(line for line in lines if line.startswith("VmRSS")).split()[1]
                    at = time.monotonic(), int(kilobytes) / 1024
                    self.memory.setdefault(name, []).append(at)


def command_of(method: str, more: Sequence[str] = ()) -> list[str]:
    """Return the command that calibrates, but for its folder."""
    name, *changes = *SESSIONS[method], *more
    sets = [part for change in changes for part in ("--set", change)]
    return [sys.executable, "-m", "rotcal_ros.cli.main", "run", f"config/{name}.yaml", *sets,
            "--yes", "--json", "--no-report", "--no-export", "--no-page"]  # fmt: skip


def session(
    method: str, folder: Path, per_core: int, generator: random.Random, more: list[str]
) -> dict[str, Any]:
    """Calibrate once, with ``more`` changed settings; return what came of it."""
    command = [*command_of(method, more), "-o", str(folder)]
    begin = time.monotonic()
    with busy(per_core):
        process = subprocess.Popen(
            command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        nodes = Nodes(process.pid, generator, stops=per_core > 0)
        out, err = process.communicate()
        loaded = describe_load()
        nodes.end()
    found: dict[str, Any] = {
        "method": method, "busy_per_core": per_core, "seconds": round(time.monotonic() - begin),
        "machine": loaded, "stops": nodes.stopped, "code": process.returncode,
        "memory": {n: growth(samples) for n, samples in nodes.memory.items() if len(samples) > 1},
    }  # fmt: skip
    if process.returncode:
        return found | {"error": (out + err).strip().splitlines()[-1:]}
    answer = json.loads(out)
    accepted = {o.step for o in read_recording(folder / "bag").recorded if o.accepted}
    return found | {
        "verdict": answer["verdict"],
        "confirmed": answer["n_used"],
        "confirmed_lost": answer["n_used"] - len(accepted),
        "waited": (folder / "log" / "planner.log").read_text().count("waiting for"),
    }


def growth(samples: list[tuple[float, float]]) -> dict[str, float]:
    """Return the memory of a node in MB at half time and at the end, and the growth per hour.

    That is of the second half without its last fifth, in which all is solved.
    """
    half = samples[len(samples) // 2 :]
    at_s, megabytes = np.array(half[: max(3, len(half) * 4 // 5)]).T
    slope = np.polyfit(at_s - at_s[0], megabytes, 1)[0] if len(at_s) > 2 else 0.0
    found = {"half_mb": megabytes[0], "end_mb": samples[-1][1], "mb_per_hour": slope * 3600.0}
    return {name: round(float(value), 1) for name, value in found.items()}


def difference(first: Path, second: Path) -> float:
    """Return the largest difference of two results, in its standard deviations."""
    one, two = (Result.from_dict(json.loads(p.read_text())) for p in (first, second))
    worst = 0.0
    for name, values in one.deviations.items():
        std = np.hypot(one.std[name], two.std[name])
        known = std > 0.0
        off = np.abs(values - two.deviations[name])[known] / std[known]
        worst = max(worst, float(off.max(initial=0.0)))
    return worst


def is_good(found: dict[str, Any]) -> bool:
    """Return whether a session ended as it must."""
    return bool(
        found["code"] == 0 and found["verdict"] == "ok" and found["confirmed_lost"] == 0
        and found.get("difference", 0.0) <= MOST
    )  # fmt: skip


def main() -> int:
    """Soak, and say what came of it."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--minutes", type=float, default=60.0)
    parser.add_argument("--busy", type=int, nargs="+", default=[4, 10, 25])
    parser.add_argument("--methods", nargs="+", default=list(SESSIONS), choices=list(SESSIONS))
    parser.add_argument("--set", action="append", default=[], metavar="GROUP.NAME=VALUE")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--json", type=Path, default=ROOT / "out" / "soak.json")
    asked = parser.parse_args()
    generator, begin = random.Random(asked.seed), time.monotonic()
    done: list[dict[str, Any]] = []
    with tempfile.TemporaryDirectory(prefix="soak") as place:
        rounds = [0, *asked.busy]
        while len(rounds) and (time.monotonic() - begin < 60.0 * asked.minutes or rounds[0] == 0):
            per_core = rounds.pop(0)
            rounds += [per_core] if per_core else []
            for method in asked.methods:
                if per_core and time.monotonic() - begin > 60.0 * asked.minutes:
                    break
                folder = Path(place) / f"{method}_{len(done)}"
                found = session(method, folder, per_core, generator, asked.set)
                quiet = Path(place) / f"{method}_quiet.json"
                if found["code"] == 0 and not per_core:
                    quiet.write_bytes((folder / "result.json").read_bytes())
                elif found["code"] == 0 and quiet.exists():
                    found["difference"] = difference(quiet, folder / "result.json")
                done.append(found)
                print(json.dumps(found), flush=True)
    asked.json.parent.mkdir(exist_ok=True)
    asked.json.write_text(json.dumps(done, indent=1))
    good = sum(map(is_good, done))
    print(f"{good} of {len(done)} sessions ended well, {sum(f['stops'] for f in done)} stops")
    return 0 if good == len(done) else 1


if __name__ == "__main__":
    sys.exit(main())
