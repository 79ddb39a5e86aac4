"""Who is asked what, and when the work counts as done."""

import io
from types import SimpleNamespace

import pytest

from rotcal_ros.cli import person as module
from rotcal_ros.cli.person import Person
from rotcal_ros.configuration import dump_configuration, parse_configuration

PAUSED = {"event": "paused", "instruction": "put the tracker there"}
WAITING = {"event": "feedback", "activity": "paused: put the tracker there"}
GOING_ON = {"event": "feedback", "activity": "table position 3, target 1"}


@pytest.fixture
def enter(monkeypatch):
    """Return a function that makes standard input a terminal, with or without a line entered."""

    def press(pressed, terminal=True):
        stdin = io.StringIO("\n")
        stdin.isatty = lambda: terminal
        monkeypatch.setattr("sys.stdin", stdin)
        ready = ([stdin] if pressed else [], [], [])
        monkeypatch.setattr(module, "select", SimpleNamespace(select=lambda *_: ready))

    return press


def make(*, simulated=False, yes=False):
    text = dump_configuration("plane_mirror", {"cell": {"namespace": "/north"}})
    session = SimpleNamespace(configuration=parse_configuration(text), simulated=simulated)
    return Person(session, yes)


@pytest.mark.parametrize(
    ("kind", "words"), [({"simulated": True}, "simulated person"), ({"yes": True}, "--yes")]
)
def test_a_simulated_person_and_yes_are_done_at_once(kind, words, enter, capsys):
    enter(pressed=False)
    person = make(**kind)
    assert not person.is_done()
    person.hear(PAUSED)
    assert capsys.readouterr().err == f"put the tracker there: {_said(words)}\n"
    assert person.is_done()
    assert not person.is_done()


def _said(words):
    return "taken as done (--yes)" if words == "--yes" else "done by the simulated person"


def test_a_person_at_a_terminal_presses_enter(enter, capsys):
    enter(pressed=False)
    person = make()
    person.hear(PAUSED)
    assert "then press Enter" in capsys.readouterr().err
    person.hear(WAITING)
    assert not person.is_done()
    enter(pressed=True)
    assert person.is_done()
    assert not person.is_done()


def test_enter_means_nothing_while_nothing_is_asked_or_once_the_service_was_called(enter):
    enter(pressed=True)
    person = make()
    assert not person.is_done()
    person.hear(PAUSED)
    person.hear(GOING_ON)
    assert not person.is_done()


def test_without_a_terminal_the_service_is_named(enter, capsys):
    enter(pressed=True, terminal=False)
    person = make()
    person.hear(PAUSED)
    assert "call the service /north/resume (std_srvs/srv/Trigger)" in capsys.readouterr().err
    assert not person.is_done()
