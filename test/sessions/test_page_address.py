"""Where the page is, as a session tells it; a session whose page cannot be served goes on."""

import sys
import time

import pytest

from rotcal_ros.foundation.machine_load import patient
from rotcal_ros.foundation.node_names import VIEWERS
from rotcal_ros.sessions import environment
from rotcal_ros.sessions.commands import CLIENT
from rotcal_ros.sessions.following import RunningSession
from rotcal_ros.sessions.processes import Processes

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


def words(session):
    deadline = time.monotonic() + patient(DEADLINE_S)
    while not (found := session.page()):
        assert time.monotonic() < deadline, "the page is never told"
        time.sleep(0.02)
    return found


def test_the_address_is_told_as_the_node_logs_it(started):
    session = started("import time; print('[INFO]: page: http://[::1]:80'); time.sleep(60)")
    assert words(session) == "page: http://[::1]:80"


def test_a_page_that_cannot_start_is_told_and_ends_nothing(started):
    session = started("raise SystemExit('port 80 is taken')")
    assert words(session) == "no page: port 80 is taken"
    assert session.ended() == {}


def test_without_a_page_nothing_is_told(started):
    assert started("").page() == ""


def test_what_the_page_needs_and_is_not_there_is_named(monkeypatch, capsys):
    assert environment.page_can_be_served()
    monkeypatch.setattr(environment, "_OF_THE_PAGE", ("starlette", "no_such_package"))
    assert not environment.page_can_be_served()
    assert "no page: not installed: no_such_package" in capsys.readouterr().err
