"""``rotcal run``: one command from the first step to the verdict, and a clean end by Ctrl-C."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from live_cell import DEADLINE_S, DEMO, SHORT, wait_until

from rotcal_ros.foundation.machine_load import load_scaled_timeout
from rotcal_ros.recordings.replay import read_recording
from rotcal_ros.recordings.result_sources import read_source

pytest.importorskip("rclpy")
pytest.importorskip("rotcal_msgs")
pytestmark = pytest.mark.ros

RUN = (sys.executable, "-m", "rotcal_ros.cli.main", "run", str(DEMO))


@pytest.fixture(autouse=True)
def _importable(monkeypatch):
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(filter(None, sys.path)))


def arguments(folder, *more):
    changes = [part for change in SHORT for part in ("--set", change)]
    return [*RUN, "--output", str(folder), *changes, *more]


def children_of(pid):
    """Return the process ids of the running children of ``pid``."""
    found = []
    for status in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = status.read_text().rsplit(")", 1)[1].split()
        except OSError:
            continue
        if fields[1] == str(pid) and fields[0] != "Z":
            found.append(int(status.parent.name))
    return found


@pytest.mark.long  # test_own_cell.py runs to the end
def test_run_ends_with_a_verdict_and_all_files(tmp_path):
    done = subprocess.run(
        arguments(tmp_path / "out", "--json"),
        capture_output=True,
        text=True,
        timeout=load_scaled_timeout(DEADLINE_S),
    )
    assert done.returncode == 0, done.stderr
    outcome = json.loads(done.stdout)
    assert outcome["verdict"] == "ok"
    result = read_source(tmp_path / "out" / "result.json").result
    assert outcome["verdict_line"] == result.verdict_line
    assert outcome["n_used"] == 59
    assert set(outcome["files"]) == {"bag", "result", "truth", "report", "compensation"}
    for path in map(Path, outcome["files"].values()):
        assert path.is_absolute()
        assert path.exists()
    assert "another result than the live run" not in done.stderr
    assert "60 of 60 steps" in done.stderr

    again = subprocess.run(
        arguments(tmp_path / "out"),
        capture_output=True,
        text=True,
        timeout=load_scaled_timeout(60),
    )
    assert again.returncode == 2
    assert "exists already" in again.stderr


def test_ctrl_c_leaves_a_valid_bag_and_no_process(tmp_path):
    with subprocess.Popen(
        arguments(tmp_path / "out", "--set", "simulation.time_scale=2.0"),
        stderr=subprocess.PIPE,
        text=True,
    ) as run:
        said = []
        for line in run.stderr:
            said.append(line)
            if "of 60 steps" in line:
                break
        children = children_of(run.pid)
        assert len(children) == 7, "".join(said)
        run.send_signal(signal.SIGINT)
        rest = run.stderr.read()
        assert run.wait(load_scaled_timeout(DEADLINE_S)) == 130
    assert "interrupted; the bag is closed" in rest
    assert "Traceback" not in rest
    assert not any(Path(f"/proc/{pid}").exists() for pid in children)
    assert [v.state for v in read_recording(tmp_path / "out" / "bag").verdicts] == ["complete"]


@pytest.mark.slow
def test_nodes_do_not_outlive_a_killed_supervisor(tmp_path):
    with subprocess.Popen(arguments(tmp_path / "out"), stderr=subprocess.DEVNULL) as run:
        wait_until(lambda: len(children_of(run.pid)) == 7, "the nodes are started")
        wait_until((tmp_path / "out" / "bag").exists, "the recording begins")
        children = children_of(run.pid)
        run.kill()
        run.wait(load_scaled_timeout(DEADLINE_S))
    started = time.monotonic()
    wait_until(lambda: not any(Path(f"/proc/{pid}").exists() for pid in children), "all end")
    assert time.monotonic() - started < DEADLINE_S


def test_a_node_that_cannot_start_is_told_with_its_reason(tmp_path):
    done = subprocess.run(
        arguments(tmp_path / "out"),
        capture_output=True,
        text=True,
        timeout=load_scaled_timeout(DEADLINE_S),
        env={**os.environ, "RMW_IMPLEMENTATION": "rmw_of_no_vendor"},
    )
    assert done.returncode == 2
    assert "ended at its start" in done.stderr
    assert "rmw_of_no_vendor" in done.stderr
