"""Who is asked what, and when the work counts as done."""

import io
from types import SimpleNamespace

import pytest

from rotcal_ros.foundation.node_state import Why
from rotcal_ros.methods.configuration import dump_configuration, parse_configuration
from rotcal_ros.sessions import person as module
from rotcal_ros.sessions.person import SessionOperator

PAUSED = {"event": "paused", "instruction": "put the tracker there", "doing": Why.WORK}
WAITING = {"event": "feedback", "doing": Why.WORK}
GOING_ON = {"event": "feedback", "doing": Why.MEASURING}


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


def make(*, simulated=False, yes=False, watching=False, person=True):
    simulation = {"simulation": {} if person else {"person": False}} if simulated else {}
    groups = {"cell": {"namespace": "/north"}} | simulation
    return SessionOperator(
        parse_configuration(dump_configuration("plane_mirror", groups)), yes, watching=watching
    )


@pytest.mark.parametrize(
    ("kind", "words"),
    [
        ({"simulated": True}, "done by the simulated person"),
        ({"yes": True}, "taken as done (--yes)"),
    ],
)
def test_a_simulated_person_and_yes_are_done_at_once(kind, words, enter):
    enter(pressed=False)
    person = make(**kind)
    assert not person.is_done()
    assert person.receive(PAUSED) == f"put the tracker there: {words}"
    assert person.is_done()
    assert not person.is_done()


@pytest.mark.parametrize("rehearsed", [False, True])
def test_a_person_at_a_terminal_presses_enter(enter, rehearsed):
    """At a machine, and where one rehearses in a simulated cell."""
    enter(pressed=False)
    person = make(simulated=rehearsed, person=not rehearsed)
    assert person.receive(PAUSED) == "put the tracker there; then press Enter"
    assert person.receive(WAITING) is None
    assert not person.is_done()
    enter(pressed=True)
    assert person.is_done()
    assert not person.is_done()


def test_enter_means_nothing_while_nothing_is_asked_or_once_the_service_was_called(enter):
    enter(pressed=True)
    person = make()
    assert not person.is_done()
    person.receive(PAUSED)
    person.receive(GOING_ON)
    assert not person.is_done()


def test_without_a_terminal_the_service_is_named(enter):
    enter(pressed=True, terminal=False)
    person = make()
    assert person.receive(PAUSED).endswith("call the service /north/resume (std_srvs/srv/Trigger)")
    assert not person.is_done()


@pytest.mark.parametrize("kind", [{"simulated": True}, {"yes": True}])
def test_one_who_watches_does_nothing_of_its_own(kind, enter):
    enter(pressed=False)
    person = make(**kind, watching=True)
    assert "done" in person.receive(PAUSED)
    assert not person.is_done()


def test_the_word_of_another_terminal_counts_for_what_is_asked_and_once(enter):
    enter(pressed=False)
    person = make()
    person.confirm(PAUSED["instruction"])  # nothing is asked yet
    person.receive(PAUSED)
    person.confirm("put the tracker elsewhere")
    assert not person.is_done()
    person.confirm(PAUSED["instruction"])
    assert person.is_done()
    assert not person.is_done()


def test_what_was_entered_before_it_was_asked_is_no_answer(enter):
    enter(pressed=True)
    person = make()
    person.receive(PAUSED)  # reads it
    assert not person.is_done()
    enter(pressed=True)
    assert person.is_done()


def test_a_terminal_that_has_ended_has_not_said_enter(enter, monkeypatch):
    enter(pressed=True)
    monkeypatch.setattr("sys.stdin.readline", lambda: "")
    person = make()
    person.receive(PAUSED)
    assert not person.is_done()


def test_a_refused_resume_is_told_with_its_reason():
    event = {"event": "resumed", "success": False, "reason": "nothing is waiting to be resumed"}
    assert make().receive(event) == "nothing is waiting to be resumed"
    assert make().receive({"event": "alive", "planner": "ready"}) is None


STOPPED = {"event": "paused", "instruction": "the door is open", "doing": Why.STOPPED}
RELEASED = {"event": "paused", "instruction": "the door was open", "doing": Why.RELEASED}


@pytest.mark.parametrize("kind", [{"simulated": True}, {"yes": True}, {}])
def test_after_an_emergency_stop_nobody_goes_on_at_once(kind, enter):
    enter(pressed=False)
    person = make(**kind)
    assert person.receive(STOPPED) == STOPPED["instruction"]
    assert not person.is_done()
    assert person.receive(RELEASED) == f"{RELEASED['instruction']}; then press Enter"
    assert not person.is_done()
    enter(pressed=True)
    assert person.is_done()


def test_who_was_refused_may_say_it_again(enter):
    enter(pressed=False)
    person = make()
    person.receive(STOPPED)
    person.receive(WAITING)
    enter(pressed=True)
    assert person.is_done()
    refusal = {"event": "resumed", "success": False, "reason": "the emergency stop is on"}
    assert person.receive(refusal) == "the emergency stop is on"
    enter(pressed=True)
    assert person.is_done()
    assert not person.is_done()
