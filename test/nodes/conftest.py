"""Live cells that end with their test."""

import os
import sys
from pathlib import Path

import pytest
import warm
from live_cell import DEMO, SHORT, LiveCell

from rotcal_ros.foundation.machine_load import patient
from rotcal_ros.methods.configuration import changed, read_configuration

sys.path.append(str(Path(__file__).parents[1] / "compensation"))


@pytest.fixture
def cell(tmp_path, monkeypatch):
    """Return a function that makes a live cell with a short plan; all of it ends with the test."""
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(filter(None, sys.path)))
    cells = []

    def make(*changes):
        made = LiveCell(tmp_path, changed(read_configuration(DEMO), (*SHORT, *changes)))
        cells.append(made)
        return made

    yield make
    for made in cells:
        made.processes.end()


@pytest.fixture
def rotcal(monkeypatch):
    """Return a function that starts ``rotcal run``; what still runs at the end is ended."""
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(filter(None, sys.path)))
    started = []

    def start(*arguments, log, changes=()):
        parts = [part for change in (*SHORT, *changes) for part in ("--set", change)]
        command = [sys.executable, "-m", "rotcal_ros.cli.main", "run", str(DEMO), *parts]
        process = warm.popen(
            [*command, *map(str, arguments)],
            stdout=log.with_suffix(".json").open("w"), stderr=log.open("w"),
        )  # fmt: skip
        started.append(process)
        return process

    yield start
    for process in started:
        if process.poll() is None:
            process.terminate()
            process.wait(patient(60))
