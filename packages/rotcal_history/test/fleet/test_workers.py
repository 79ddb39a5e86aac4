"""Workers that die, hang or are killed: each costs one try of one bag, and nothing else."""

import os
import subprocess
import sys
from pathlib import Path

import deadly_work
import psutil
import pytest

from rotcal_history.fleet.batch_solving import BagJob
from rotcal_history.fleet.workers import run_on_cores

HERE = Path(__file__).parent


@pytest.fixture(autouse=True)
def _workers_find_the_work(monkeypatch):
    monkeypatch.setenv("PYTHONPATH", f"{HERE}:{os.environ.get('PYTHONPATH', '')}")


def jobs(folder, *sources):
    return [BagJob(source, None, str(folder)) for source in sources]


@pytest.mark.slow
def test_each_bag_that_kills_its_worker_is_set_aside_and_costs_nobody_else(tmp_path):
    deadly = ["segfault", "exit", "hang", "once", "killed"]
    names = [*(f"good_{n}" for n in range(3)), *deadly, *(f"good_{n}" for n in range(3, 6))]
    outcomes = run_on_cores(jobs(tmp_path, *names), 2, 1.0, deadly_work.work)
    errors = {outcome.source: outcome.error for outcome in outcomes}
    assert set(errors) == set(names)
    assert errors.pop("segfault") == "set aside: the worker crashed 2 times (SIGSEGV) on this bag"
    assert errors.pop("exit") == "set aside: the worker crashed 2 times (exit code 7) on this bag"
    assert errors.pop("hang").startswith("set aside: not done after 1 s")
    assert not any(errors.values())


@pytest.mark.slow
def test_no_process_is_left_behind_when_the_reader_stops_early(tmp_path):
    others = psutil.Process().children()  # of earlier tests, such as a server of forks
    running = run_on_cores(jobs(tmp_path, "good", "hang_1", "hang_2"), 2, 60.0, deadly_work.work)
    assert next(running).source == "good"
    mine = [process for process in psutil.Process().children() if process not in others]
    assert mine
    running.close()
    _, alive = psutil.wait_procs(mine, timeout=10)
    assert not alive


def test_jobs_are_taken_as_they_are_needed(tmp_path):
    taken = []

    def endless():
        while True:
            taken.append(len(taken))
            yield from jobs(tmp_path, f"good_{len(taken)}")

    running = run_on_cores(endless(), 2, work=deadly_work.work)
    for _ in range(10):
        next(running)
    running.close()
    assert len(taken) <= 10 + 4 * 2


@pytest.mark.slow
def test_a_worker_outlives_neither_its_supervisor_nor_the_bag_that_hangs(tmp_path):
    script = (
        "import deadly_work\n"
        "from rotcal_history.fleet.batch_solving import BagJob\n"
        "from rotcal_history.fleet.workers import run_on_cores\n"
        f"jobs = [BagJob('good', None, {str(tmp_path)!r})] * 10**6\n"
        "for outcome in run_on_cores(jobs, 1, 1.0, deadly_work.work):\n"
        "    print(outcome.source, flush=True)\n"
    )
    parent = subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE)
    assert parent.stdout.readline() == b"good\n"
    children = psutil.Process(parent.pid).children()
    parent.kill()
    parent.wait()
    parent.stdout.close()
    _, alive = psutil.wait_procs(children, timeout=10)
    assert not alive
