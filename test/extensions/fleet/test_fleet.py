"""A small fleet: a worker is killed, a bag kills its own, an entry is broken; nothing is lost."""

import os
import threading
from pathlib import Path

import psutil
import pytest

pytest.importorskip("duckdb")
pytest.importorskip("pyarrow")
import deadly_work
from fleet_bags import configuration_text, write_bag, write_fleet

from rotcal_ros.extensions.fleet.bag_search import find_bags
from rotcal_ros.extensions.fleet.batch_solving import Job, solve_bag
from rotcal_ros.extensions.fleet.overview import bags_by_table, connected, write_overview
from rotcal_ros.extensions.fleet.results_dataset import ResultsDataset
from rotcal_ros.extensions.fleet.workers import on_all_cores
from rotcal_ros.methods.configuration import parse_configuration

HERE = Path(__file__).parent
BAGS = 12
CONFIGURATION = parse_configuration(configuration_text())


@pytest.fixture
def fleet(tmp_path, monkeypatch):
    monkeypatch.setenv("PYTHONPATH", f"{HERE}:{os.environ.get('PYTHONPATH', '')}")
    list(write_fleet(tmp_path / "bags", BAGS, 3))
    write_bag(tmp_path / "bags" / "table_000" / "deadly", 99)
    return tmp_path


def kill_one(ended, others):
    """Kill a worker that is at work, once; ``others`` are children of earlier tests."""
    while not ended.wait(0.02):
        for child in psutil.Process().children():
            if child not in others and child.cpu_times().user > 0.3:
                child.kill()
                return


def call(folder):
    """Do what the verb does, with work that a bag can kill; return the outcomes by source."""
    bags = find_bags([str(folder / "bags")])
    jobs = [Job(bag, CONFIGURATION, str(folder / "cache")) for bag in bags]
    outcomes = {}
    with ResultsDataset(folder / "results.parquet") as dataset:
        for outcome in on_all_cores(jobs, 2, work=deadly_work.solve_unless_deadly):
            dataset.add(outcome)
            outcomes[outcome.source] = outcome
    return outcomes


@pytest.mark.slow
def test_nothing_is_lost_but_the_bag_that_kills(fleet):
    ended = threading.Event()
    killer = threading.Thread(target=kill_one, args=(ended, psutil.Process().children()))
    killer.start()
    first = call(fleet)
    ended.set()
    killer.join()
    deadly = str(fleet / "bags" / "table_000" / "deadly")
    error = first.pop(deadly).error  # the one that is killed may have had it in hand
    assert error.startswith("set aside: it killed its worker")
    assert "exit code 9" in error
    assert len(first) == BAGS
    one = min(first)
    alone = solve_bag(Job(one, CONFIGURATION, str(fleet / "alone")))
    assert first[one].result == alone.result

    broken = fleet / "cache" / first[one].key[:2] / f"{first[one].key}.json"
    broken.write_text("half an ent")
    second = call(fleet)
    second.pop(deadly)
    assert {source for source, outcome in second.items() if outcome.healed} == {one}
    assert sum(outcome.cached for outcome in second.values()) == BAGS - 1
    assert {s: o.result for s, o in second.items()} == {s: o.result for s, o in first.items()}

    counts = write_overview(fleet / "results.parquet", CONFIGURATION.text, fleet / "overview.html")
    assert (counts.bags, counts.bad, len(counts.tables)) == (BAGS + 1, 1, 3)
    page = (fleet / "overview.html").read_text()
    assert deadly in page
    assert "it killed its worker" in page
    with connected(fleet / "results.parquet") as connection:
        bags = {bag.source: bag for bag in bags_by_table(connection)}
    ecc = next(span for span in bags[one].spans if span.component == "ECC")
    deviations, std = alone.deviations().deviations["ECC"], alone.deviations().std["ECC"]
    assert ecc.range == max(deviations) - min(deviations)
    assert ecc.u == 2 * max(std)
