"""A small fleet: a worker is killed, a bag kills its own, an entry is broken; nothing is lost."""

import os
import threading
from pathlib import Path

import deadly_work
import psutil
import pytest
from fleet_bags import configuration_text, write_bag, write_fleet

from rotcal_history.fleet.bag_search import find_bags
from rotcal_history.fleet.batch_solving import BagJob, solve_bag
from rotcal_history.fleet.workers import run_on_cores
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
    """Solve all bags, with work that a bag can kill; return the outcomes by source."""
    bags = find_bags([str(folder / "bags")])
    jobs = [BagJob(bag, CONFIGURATION, str(folder / "cache")) for bag in bags]
    outcomes = run_on_cores(jobs, 2, work=deadly_work.solve_unless_deadly)
    return {outcome.source: outcome for outcome in outcomes}


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
    assert error.startswith("set aside: the worker crashed")
    assert "exit code 9" in error
    assert len(first) == BAGS
    one = min(first)
    alone = solve_bag(BagJob(one, CONFIGURATION, str(fleet / "alone")))
    assert first[one].result == alone.result

    broken = fleet / "cache" / first[one].key[:2] / f"{first[one].key}.json"
    broken.write_text("half an ent")
    second = call(fleet)
    second.pop(deadly)
    assert {source for source, outcome in second.items() if outcome.healed} == {one}
    assert sum(outcome.cached for outcome in second.values()) == BAGS - 1
    assert {s: o.result for s, o in second.items()} == {s: o.result for s, o in first.items()}
