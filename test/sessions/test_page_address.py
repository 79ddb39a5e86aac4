"""A session whose page cannot be served goes on, and says why."""

import sys
import time

import pytest

from rotcal_ros.foundation.machine_load import load_scaled_timeout
from rotcal_ros.foundation.node_names import VIEWERS
from rotcal_ros.sessions import processes
from rotcal_ros.sessions.processes import Processes
from rotcal_ros.sessions.running import CLIENT, RunningSession

PAGE = VIEWERS["page"]
DEADLINE_S = 30.0


@pytest.fixture
def started(tmp_path):
    """Return a function that starts a page that prints, beside a client that says nothing."""
    with Processes(tmp_path, {}) as processes:

        def start(code):
            processes.start(CLIENT, ["cat"], piped=True)
            if code:
                processes.start(PAGE, [sys.executable, "-uc", code])
            return RunningSession(processes)

        yield start


def test_a_page_that_cannot_start_is_told_and_ends_nothing(started):
    session = started("raise SystemExit('port 80 is taken')")
    deadline = time.monotonic() + load_scaled_timeout(DEADLINE_S)
    while (failure := session.page_failure()) is None:
        assert time.monotonic() < deadline, "the page is never told"
        time.sleep(0.02)
    assert failure == "port 80 is taken"
    assert session.ended() == {}


@pytest.mark.parametrize("code", ["", "import time; time.sleep(60)"])
def test_without_a_page_and_with_one_nothing_has_failed(started, code):
    assert started(code).page_failure() is None


def test_what_the_page_needs_and_is_not_there_is_named(monkeypatch, capsys):
    assert processes.page_can_be_served()
    monkeypatch.setattr(processes, "_OF_THE_PAGE", ("starlette", "no_such_package"))
    assert not processes.page_can_be_served()
    assert "no page: not installed: no_such_package" in capsys.readouterr().err
