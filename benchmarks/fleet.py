"""A fleet of bags through a real Dask cluster whose workers are killed at random.

usage: fleet.py [--bags 10000] [--folder out/fleet] [--kill-every 5] [--seconds 0] [--compare 500]
       fleet.py --ratio [--bags 60]      two workers against one, in turns

Says what was lost (nothing), how the memory of the parent grew, and what 100,000 bags would take.
"""

import argparse
import json
import random
import signal
import statistics
import subprocess
import sys
import threading
import time
from contextlib import contextmanager, suppress
from pathlib import Path
from tempfile import TemporaryDirectory

import psutil

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "packages" / "rotcal_history" / "test" / "fleet"))
from fleet_bags import configuration_text, write_bag  # noqa: E402

from rotcal_history.database import ParkHistory, result_of  # noqa: E402
from rotcal_history.fleet.batch_solving import BagJob  # noqa: E402
from rotcal_history.fleet.workers import run_on_cores  # noqa: E402
from rotcal_ros.methods.configuration import parse_configuration  # noqa: E402

TABLES = 50
FUTURE = 100_000
SOLVER = run_on_cores.__module__
"""What the command of a process that solves names."""


def generated(folder: Path, bags: int) -> Path:
    """Return the folder with at least ``bags`` bags; what is there stays."""
    for seed in range(bags):
        bag = folder / f"table_{seed % TABLES:03}" / f"run_{seed:06}"
        if not bag.exists():
            write_bag(bag, seed)
    return folder


@contextmanager
def cluster(folder: Path):
    """A scheduler and two workers of one thread, each under a nanny; gives address and process."""
    file = folder / "scheduler.json"
    file.unlink(missing_ok=True)
    local = ["--host", "127.0.0.1", "--no-dashboard"]
    log = (folder / "dask.log").open("w")
    python = [sys.executable, "-m"]
    scheduler = subprocess.Popen(
        [*python, "distributed.cli.dask_scheduler", "--port", "0", "--scheduler-file", str(file),
         *local],
        stdout=log, stderr=log,
    )  # fmt: skip
    while not file.exists():
        time.sleep(0.1)
    workers = subprocess.Popen(
        [*python, "distributed.cli.dask_worker", "--scheduler-file", str(file), "--nworkers", "2",
         "--nthreads", "1", *local, "--local-directory", str(folder / "dask")],
        stdout=log, stderr=log,
    )  # fmt: skip
    try:
        yield json.loads(file.read_text())["address"], workers
    finally:
        for process in (workers, scheduler):
            process.terminate()
        for process in (workers, scheduler):
            with suppress(subprocess.TimeoutExpired):  # of a nanny without its worker
                process.wait(20)
            process.kill()


class Disturbance(threading.Thread):
    """Kills a Dask worker or the process that solves for it, again and again."""

    def __init__(self, workers: subprocess.Popen, every_s: float, seed: int = 1) -> None:
        super().__init__(daemon=True)
        self.kills = {"worker": 0, "solving process": 0}
        self.ended = threading.Event()
        self._workers, self._every_s = workers, every_s
        self._random = random.Random(seed)

    def run(self) -> None:
        while not self.ended.wait(self._random.expovariate(1 / self._every_s)):
            with suppress(psutil.Error, IndexError):
                below = psutil.Process(self._workers.pid).children(recursive=True)
                solving = [p for p in below if SOLVER in p.cmdline()]
                kind = self._random.choice(list(self.kills))
                owners = [p.parent() for p in solving]
                victim = self._random.choice(solving if kind == "solving process" else owners)
                if victim.pid != self._workers.pid:
                    victim.kill()
                    self.kills[kind] += 1


def disturbed(arguments: argparse.Namespace, bags: Path, setup: Path, output: Path) -> dict:
    """Run the verb through the cluster under kills; return what was seen of it."""
    memory: list[tuple[float, int, float]] = []
    begin = time.monotonic()
    with cluster(arguments.folder) as (address, workers):
        command = [sys.executable, "-m", "rotcal_ros.cli.main", "reprocess", str(bags), "--setup",
                   str(setup), "-o", str(output), "--serial", "{folder}",
                   "--scheduler", address]  # fmt: skip
        log = (arguments.folder / "reprocess.log").open("w")
        verb = subprocess.Popen(command, cwd=ROOT, stdout=log, stderr=log)
        disturbance = Disturbance(workers, arguments.kill_every)
        disturbance.start()
        process = psutil.Process(verb.pid)
        while verb.poll() is None:
            elapsed = time.monotonic() - begin
            with suppress(psutil.Error):
                done = sum(1 for _ in (output / "cache").glob("*/*.json"))
                memory.append((elapsed, done, process.memory_info().rss / 1e6))
            if arguments.seconds and elapsed > arguments.seconds:
                verb.send_signal(signal.SIGINT)
                verb.wait(60)
            time.sleep(5.0)
        disturbance.ended.set()
        disturbance.join()
    done = memory[-1][1]
    half = [m for m in memory if m[1] > memory[0][1] + 0.1 * (done - memory[0][1])]
    slope = statistics.linear_regression([m[1] for m in half], [m[2] for m in half]).slope
    return {
        "exit_code": verb.returncode,
        "seconds": round(memory[-1][0], 1),
        "bags_done": done,
        "bags_done_before": memory[0][1],
        "bags_per_s": round((done - memory[0][1]) / memory[-1][0], 3),
        "kills": disturbance.kills,
        "parent_mb_first": round(half[0][2], 1),
        "parent_mb_last": round(half[-1][2], 1),
        "parent_kb_per_bag": round(1000 * slope, 3),
        "parent_mb_at_100000": round(half[-1][2] + slope * (FUTURE - done), 1),
    }


def lost(output: Path, configuration, compare: int) -> dict:
    """Compare the history with bags solved alone, undisturbed; count what is not there."""
    with ParkHistory(str(output / "history.db")) as history, TemporaryDirectory() as cache:
        entries = {entry.why: entry.id for entry in history.entries()}
        chosen = random.Random(2).sample(sorted(entries), min(compare, len(entries)))
        jobs = [BagJob(source, configuration, cache) for source in chosen]
        different = [
            outcome.source
            for outcome in run_on_cores(jobs, 2)
            if result_of(history.entry(entries[outcome.source])).to_dict() != outcome.result
        ]
        wrong = history.check()
    return {
        "results": len(entries),
        "damaged": len(wrong),
        "compared": len(chosen),
        "different": len(different),
    }


def ratio(folder: Path, bags: int, rounds: int = 3) -> dict:
    """Solve the same bags with one and with two workers in turns."""
    fleet = generated(folder / "bags", bags)
    configuration = parse_configuration(configuration_text())
    sources = sorted(str(p.parent) for p in fleet.glob("*/*/bag_0.mcap"))[:bags]
    seconds: dict[int, list[float]] = {1: [], 2: []}
    for _ in range(rounds):
        for workers, taken in seconds.items():
            with TemporaryDirectory() as cache:
                begin = time.monotonic()
                jobs = [BagJob(source, configuration, cache) for source in sources]
                assert not any(outcome.error for outcome in run_on_cores(jobs, workers))
                taken.append(time.monotonic() - begin)
    ratios = [one / two for one, two in zip(seconds[1], seconds[2], strict=True)]
    return {"bags": bags, "seconds": seconds, "two_against_one": statistics.median(ratios)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--bags", type=int, default=10_000)
    parser.add_argument("--folder", type=Path, default=Path("out/fleet"))
    parser.add_argument("--kill-every", type=float, default=5.0, metavar="S", help="on average")
    parser.add_argument("--seconds", type=float, default=0.0, help="interrupt after; 0: never")
    parser.add_argument("--compare", type=int, default=500, help="bags solved alone to compare")
    parser.add_argument("--ratio", action="store_true", help="two workers against one")
    arguments = parser.parse_args()
    arguments.folder = arguments.folder.absolute()
    arguments.folder.mkdir(parents=True, exist_ok=True)
    if arguments.ratio:
        print(json.dumps(ratio(arguments.folder, arguments.bags), indent=1))
        return
    begin = time.monotonic()
    bags = generated(arguments.folder / "bags", arguments.bags)
    print(f"{arguments.bags} bags there after {time.monotonic() - begin:.0f} s", flush=True)
    text = configuration_text()
    setup, output = arguments.folder / "setup.yaml", arguments.folder / "results"
    setup.write_text(text)
    seen = disturbed(arguments, bags, setup, output)
    print(json.dumps(seen, indent=1), flush=True)
    seen |= lost(output, parse_configuration(text), arguments.compare)
    (arguments.folder / "figures.json").write_text(json.dumps(seen, indent=1))
    print(json.dumps(seen, indent=1))


if __name__ == "__main__":
    main()
