"""Many bags: found, solved once, in any place, with one bad one among them."""

import json
import os
import socket
import subprocess
import sys
import time
from importlib.metadata import EntryPoint
from pathlib import Path
from types import SimpleNamespace

import deadly_work
import numpy as np
import pytest
import yaml
from bag_samples import CONFIGURATION as SAMPLE
from bag_samples import simulate, write_run
from click.testing import CliRunner

from rotcal_history.fleet import batch_solving, workers
from rotcal_history.fleet.bag_search import find_bags
from rotcal_history.fleet.batch_solving import BagJob, solve_bag
from rotcal_history.fleet.workers import run_on_cluster, run_on_cores
from rotcal_ros.bags import names
from rotcal_ros.cli.main import rotcal
from rotcal_ros.foundation import plugins
from rotcal_ros.foundation.circumstances import Circumstances
from rotcal_ros.foundation.errors import BagError, ConfigurationError
from rotcal_ros.foundation.identity import Identity
from rotcal_ros.foundation.machine_load import load_scaled_timeout
from rotcal_ros.foundation.results import Result
from rotcal_ros.methods.configuration import dump_configuration, parse_configuration
from rotcal_ros.recordings.replay import read_recording

HERE = Path(__file__).parent
SEEDS = (5, 6, 7)
_groups = yaml.safe_load(SAMPLE)["/**"]["ros__parameters"]
_groups.pop("method")
PLAN = {**_groups["plan"], "box_points": [2, 2, 2], "table_positions": 5}
DATED = {"identity": {"measured": "2026-03-31"}}  # simulated clocks give no date
CONFIGURATION = dump_configuration(
    "tracer_multistation", {**_groups, **DATED, "plan": PLAN, "solver": {"variant": "station"}}
)


@pytest.fixture(scope="module")
def fleet(tmp_path_factory):
    """A folder with three sound bags of three runs and one that is no bag at all."""
    folder = tmp_path_factory.mktemp("fleet")
    for seed in SEEDS:
        run = simulate(CONFIGURATION.replace("seed: 5", f"seed: {seed}"))
        write_run(folder / f"run_{seed}" / "bag", run)
    (folder / "torn").mkdir()
    (folder / "torn" / "torn.mcap").write_bytes(b"not a bag")
    (folder / "setup.yaml").write_text(CONFIGURATION)
    return folder


@pytest.fixture
def jobs(fleet, tmp_path):
    configuration = parse_configuration(CONFIGURATION)
    return [BagJob(bag, configuration, str(tmp_path)) for bag in find_bags([str(fleet)])]


def by_source(outcomes):
    return sorted(outcomes, key=lambda outcome: outcome.source)


@pytest.mark.slow
def test_bags_are_found_in_folders_globs_and_lists(fleet):
    all_bags = [str(fleet / f"run_{seed}" / "bag") for seed in SEEDS]
    assert list(find_bags([str(fleet)])) == [*all_bags, str(fleet / "torn")]
    assert list(find_bags([str(fleet / "run_*")])) == all_bags
    assert list(find_bags([str(fleet / "*" / "bag"), all_bags[0]])) == all_bags
    (fleet / "list.txt").write_text("# two of them\nrun_6/bag\n\nrun_5/bag/bag_0.mcap\n")
    assert list(find_bags([str(fleet / "list.txt")])) == [
        all_bags[1], str(fleet / "run_5" / "bag" / "bag_0.mcap")
    ]  # fmt: skip
    with pytest.raises(BagError, match="names no bag"):
        find_bags([str(fleet / "nothing*")])


@pytest.mark.slow
def test_each_outcome_equals_the_bag_solved_alone_and_one_bad_bag_stops_nobody(jobs):
    outcomes = by_source(run_on_cores(jobs, 2))
    assert [bool(outcome.error) for outcome in outcomes] == [False, False, False, True]
    assert "is not an MCAP file" in outcomes[-1].error
    for job, outcome in zip(jobs[:3], outcomes[:3], strict=True):
        assert (
            outcome.result
            == read_recording(Path(job.source), configuration=job.configuration).solve().to_dict()
        )


@pytest.mark.slow
def test_work_that_is_done_is_not_repeated_until_bag_or_configuration_change(jobs, tmp_path):
    first = [solve_bag(job) for job in jobs]
    again = [solve_bag(job) for job in jobs]
    assert [outcome.cached for outcome in again] == [True, True, True, False]
    assert [o.result for o in again] == [o.result for o in first]
    changed = parse_configuration(CONFIGURATION + "\n# another\n")
    assert not solve_bag(BagJob(jobs[0].source, changed, str(tmp_path))).cached


def test_a_fault_is_told_as_ours_but_that_of_a_plug_in_by_its_name(jobs, tmp_path, monkeypatch):
    def fault(*_, **__):
        return 1 / 0

    (tmp_path / "dividing_drive.py").write_text("def write(*_, **__):\n    return 1 / 0\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    plug_in = EntryPoint("broken", "dividing_drive:write", plugins.CONTROLLERS)
    points = {plugins.CONTROLLERS: {"broken": plug_in}}
    monkeypatch.setattr(plugins, "_found", lambda group: points.get(group, {}))
    for work, words in (
        (fault, "ZeroDivisionError while solving, which is a fault of rotcal_ros"),
        (plug_in.load(), "ZeroDivisionError in the controller 'broken' (dividing_drive: "),
    ):
        monkeypatch.setattr(batch_solving, "read_recording", work)
        assert solve_bag(jobs[0]).error.startswith(words)


def test_a_remote_bag_is_fetched_through_fsspec(fleet, jobs, tmp_path):
    fsspec = pytest.importorskip("fsspec")
    memory = fsspec.filesystem("memory")
    for seed in SEEDS:
        memory.put(str(fleet / f"run_{seed}" / "bag" / "bag_0.mcap"), f"/cell/{seed}.mcap")
    remote = find_bags(["memory://cell/*.mcap"])
    assert len(remote) == 3
    outcome = solve_bag(BagJob(remote[0], jobs[0].configuration, str(tmp_path)))
    assert outcome.result == solve_bag(jobs[0]).result


@pytest.mark.slow
def test_the_verb_adds_every_result_to_a_history_and_names_what_has_none(fleet, tmp_path):
    pytest.importorskip("sqlalchemy")
    from rotcal_history.database import ParkHistory, result_of

    arguments = [
        "reprocess", str(fleet), "--setup", str(fleet / "setup.yaml"), "-o", str(tmp_path / "out"),
        "--workers", "2", "--serial", "{folder}", "--json",
    ]  # fmt: skip
    answer = CliRunner().invoke(rotcal, arguments)
    assert answer.exit_code == 1, answer.output
    assert "4 bags: 3 solved (0 of them before), 1 without a result" in answer.stderr
    bags = json.loads(answer.stdout)["bags"]
    first = str(fleet / "run_5" / "bag")  # all were simulated at the same moment: one session
    assert [bag["twin_of"] for bag in bags] == ["", first, first, ""]
    assert (bags[0]["source"], bags[0]["table"]) == (first, "run_5/C")
    assert "is not an MCAP file" in bags[-1]["error"]
    configuration = parse_configuration(CONFIGURATION)
    alone = read_recording(Path(first), configuration=configuration).solve()
    with ParkHistory(str(tmp_path / "out" / "history.db")) as history:
        kept = history.entry(bags[0]["entry"])
        assert result_of(kept).to_dict() == alone.to_dict()
        assert (kept.why, bags[0]["verdict_line"]) == (first, alone.verdict_line)
    again = CliRunner().invoke(rotcal, arguments)
    assert "3 solved (3 of them before)" in again.stderr
    assert json.loads(again.stdout)["bags"] == bags


def test_a_cluster_that_does_not_answer_is_one_sentence(jobs, monkeypatch):
    pytest.importorskip("distributed")
    monkeypatch.setattr(workers, "_SCHEDULER_ANSWERS_S", 1.0)
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"tcp://127.0.0.1:{free.getsockname()[1]}"
        with pytest.raises(ConfigurationError, match="no Dask scheduler answers"):
            list(run_on_cluster(jobs, address))


@pytest.fixture
def cluster(tmp_path, monkeypatch):
    """A real Dask scheduler (address, process) and two real workers, in processes of their own."""
    pytest.importorskip("distributed")
    monkeypatch.setenv("PYTHONPATH", f"{HERE}:{os.environ.get('PYTHONPATH', '')}")
    file = tmp_path / "scheduler.json"
    dask = [sys.executable, "-m", "distributed.cli.dask_scheduler"]
    local = ["--host", "127.0.0.1", "--no-dashboard"]
    command = [*dask, "--port", "0", "--scheduler-file", str(file), *local]
    worker = [
        sys.executable, "-m", "distributed.cli.dask_worker", "--scheduler-file", str(file),
        "--nworkers", "2", "--nthreads", "1", *local, "--local-directory", str(tmp_path / "w"),
    ]  # fmt: skip
    log = (tmp_path / "dask.log").open("w")
    processes = [subprocess.Popen(command, stdout=log, stderr=log)]
    deadline = time.monotonic() + load_scaled_timeout(60)
    while not file.exists():
        assert time.monotonic() < deadline, (tmp_path / "dask.log").read_text()
        time.sleep(0.05)
    processes.append(subprocess.Popen(worker, stdout=log, stderr=log))
    yield json.loads(file.read_text())["address"], processes[0]
    for process in reversed(processes):
        process.terminate()
        process.wait(load_scaled_timeout(30))


@pytest.mark.long
def test_a_dask_cluster_gives_the_same_and_its_death_loses_nothing(cluster, jobs, tmp_path):
    from distributed import Client

    address, scheduler = cluster
    with Client(address) as client:
        client.wait_for_workers(2, timeout=load_scaled_timeout(60))
    outcomes = by_source(run_on_cluster(jobs, address))
    assert [bool(outcome.error) for outcome in outcomes] == [False, False, False, True]
    assert not any(outcome.cached for outcome in outcomes)
    for job, outcome in zip(jobs[:3], outcomes[:3], strict=True):
        assert outcome.result == solve_bag(job).result

    many = (BagJob(f"bag_{n}", jobs[0].configuration, str(tmp_path)) for n in range(10_000))
    running = run_on_cluster(many, address, work=deadly_work.slowly)
    done = {next(running).source for _ in range(4)}
    scheduler.kill()
    with pytest.raises(BagError, match="went away; what was solved is kept, and"):
        done |= {outcome.source for outcome in running}
    assert done <= {path.name for path in tmp_path.glob("bag_*")}


@pytest.mark.parametrize(("recorded", "serial"), [("T-7", "T-7"), ("", "of the set-up")])
def test_a_result_is_of_the_table_that_its_bag_names(recorded, serial):
    """One set-up solves the bags of many tables; its tolerance counts for all."""
    known = Circumstances(identity=Identity(serial="of the set-up", tolerance_arcsec=2.0))
    result = Result("other", np.arange(3.0), {}, {}, {}, 1.0, 0, 0, circumstances=known)
    groups = {"identity": {"serial": recorded}, "cell": {"axis": "B"}}
    recording = SimpleNamespace(
        solve=lambda: result,
        attachments={names.CONFIGURATION: dump_configuration("tracer", groups).encode()},
    )
    found = batch_solving._of_its_table(recording).circumstances
    assert (found.identity.serial, found.identity.tolerance_arcsec) == (serial, 2.0)
