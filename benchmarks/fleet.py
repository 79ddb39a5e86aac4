"""A fleet of bags through a real Dask cluster whose workers are killed at random.

usage: fleet.py [--bags 10000] [--folder out/fleet] [--kill-every 5] [--seconds 0] [--compare 500]
       fleet.py --ratio [--bags 60]      two workers against one, in turns
       fleet.py --overview [--bags 100000]      the overview of that many, after a run

Says what was lost (nothing), how the memory of the parent grew, and what 100,000 bags would take.
For the overview the dataset of the run is multiplied: each copy stands for further tables.
"""

import argparse
import json
import math
import random
import resource
import shutil
import signal
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager, suppress
from multiprocessing import get_context
from pathlib import Path

import psutil
import pyarrow.compute as compute
import pyarrow.parquet as parquet

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "test" / "extensions" / "fleet"))
from fleet_bags import configuration_text, write_bag  # noqa: E402

from rotcal_ros.extensions.fleet.batch_solving import Job  # noqa: E402
from rotcal_ros.extensions.fleet.overview import connected, write_overview  # noqa: E402
from rotcal_ros.extensions.fleet.results_dataset import parts  # noqa: E402
from rotcal_ros.extensions.fleet.workers import on_all_cores  # noqa: E402
from rotcal_ros.methods.configuration import parse_configuration  # noqa: E402

TABLES = 50
FUTURE = 100_000
SOLVER = on_all_cores.__module__
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
                   str(setup), "-o", str(output), "--scheduler", address]  # fmt: skip
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
    """Compare the dataset with bags solved alone, undisturbed; count what is not there."""
    with connected(output / "results.parquet") as connection:
        counted = connection.execute(
            "SELECT count(*), count(*) FILTER (error IS NOT NULL), count(DISTINCT source) "
            "FROM bags"
        ).fetchone()
        sources = [row[0] for row in connection.execute("SELECT source FROM bags").fetchall()]
        chosen = random.Random(2).sample(sorted(sources), min(compare, len(sources)))
        different = []
        with tempfile.TemporaryDirectory() as cache:
            jobs = [Job(source, configuration, cache) for source in chosen]
            for outcome in on_all_cores(jobs, 2):
                rows = connection.execute(
                    "SELECT component, deviation, std FROM rows WHERE source = ? "
                    "ORDER BY component, angle_rad", [outcome.source],
                ).fetchall()  # fmt: skip
                result = outcome.deviations()
                expected = [
                    (name, deviation, std)
                    for name in sorted(result.components)
                    for _, deviation, std in sorted(
                        zip(result.angles, result.deviations[name], result.std[name], strict=True)
                    )
                ]
                if rows != expected:
                    different.append(outcome.source)
    return {
        "bags": counted[0],
        "distinct": counted[2],
        "without_result": counted[1],
        "compared": len(chosen),
        "different": len(different),
    }


def enlarged(dataset: Path, bags: int, folder: Path) -> Path:
    """Write a dataset of so many bags into the new ``folder``: copies of one, as other tables."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    with connected(dataset) as connection:
        (there,) = connection.execute("SELECT count(DISTINCT source) FROM rows").fetchone()
    for copy in range(math.ceil(bags / there)):
        for path in parts(dataset):
            table = parquet.read_table(path, partitioning=None)
            for name in ("source", "table", "session"):
                column = table.schema.get_field_index(name)
                other = compute.binary_join_element_wise(table[name], f" {copy}", "")
                table = table.set_column(column, name, other)
            parquet.write_table(table, folder / f"{path.stem}-{copy}.parquet", compression="zstd")
    return folder


def pages(output: Path, text: str) -> dict:
    """Write the overview in a process of its own; return what it takes and how large it is."""
    with ProcessPoolExecutor(1, get_context("spawn")) as alone:
        return alone.submit(_pages, output, text).result()


def _pages(output: Path, text: str) -> dict:
    counts = write_overview(output / "results.parquet", text, output / "overview.html")
    used = resource.getrusage(resource.RUSAGE_SELF)
    files = [output / "overview.html", *(output / "overview").iterdir()]
    return {
        "overview_processor_seconds": round(used.ru_utime + used.ru_stime, 2),
        "overview_peak_mb": round(used.ru_maxrss / 1e3),
        "bags": counts.bags,
        "overview_files": len(files),
        "largest_page_kb": round(
            max(f.stat().st_size for f in files if f.suffix == ".html") / 1e3
        ),
        "search_index_kb": round((output / "overview" / "bags.js").stat().st_size / 1e3),
        "dataset_mb": round(
            sum(f.stat().st_size for f in (output / "results.parquet").iterdir()) / 1e6, 2
        ),
        "tables": len(counts.tables),
        "alarms": len(counts.alarms),
    }


def ratio(folder: Path, bags: int, rounds: int = 3) -> dict:
    """Solve the same bags with one and with two workers in turns."""
    fleet = generated(folder / "bags", bags)
    configuration = parse_configuration(configuration_text())
    sources = sorted(str(p.parent) for p in fleet.glob("*/*/bag_0.mcap"))[:bags]
    seconds: dict[int, list[float]] = {1: [], 2: []}
    for _ in range(rounds):
        for workers, taken in seconds.items():
            with tempfile.TemporaryDirectory() as cache:
                begin = time.monotonic()
                jobs = [Job(source, configuration, cache) for source in sources]
                assert not any(outcome.error for outcome in on_all_cores(jobs, workers))
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
    parser.add_argument("--overview", action="store_true", help="of so many bags")
    arguments = parser.parse_args()
    arguments.folder = arguments.folder.absolute()
    arguments.folder.mkdir(parents=True, exist_ok=True)
    if arguments.ratio:
        print(json.dumps(ratio(arguments.folder, arguments.bags), indent=1))
        return
    if arguments.overview:
        output = arguments.folder / "overview"
        enlarged(arguments.folder / "results" / "results.parquet", arguments.bags,
                 output / "results.parquet")  # fmt: skip
        print(json.dumps(pages(output, configuration_text()), indent=1))
        return
    begin = time.monotonic()
    bags = generated(arguments.folder / "bags", arguments.bags)
    print(f"{arguments.bags} bags there after {time.monotonic() - begin:.0f} s", flush=True)
    text = configuration_text()
    setup, output = arguments.folder / "setup.yaml", arguments.folder / "results"
    setup.write_text(text)
    seen = disturbed(arguments, bags, setup, output)
    print(json.dumps(seen, indent=1), flush=True)
    seen |= pages(output, text)
    seen |= lost(output, parse_configuration(text), arguments.compare)
    (arguments.folder / "figures.json").write_text(json.dumps(seen, indent=1))
    print(json.dumps(seen, indent=1))


if __name__ == "__main__":
    main()
