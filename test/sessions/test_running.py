"""What the client reports, followed to the end; no process runs here."""

from queue import SimpleQueue
from types import SimpleNamespace

import pytest

from rotcal_ros.foundation.errors import ConfigurationError, DataError
from rotcal_ros.foundation.node_state import Why
from rotcal_ros.foundation.session_folder import SessionFolder
from rotcal_ros.methods.configuration import dump_configuration, parse_configuration
from rotcal_ros.sessions import running
from rotcal_ros.sessions.person import SessionOperator
from rotcal_ros.sessions.running import _follow, _result_of_cancelling

STARTED = {"event": "started"}
RESULT = {"event": "result", "error_code": 0, "verdict": "ok"}
PAUSED = {"event": "paused", "instruction": "put the tracker there", "doing": Why.WORK}
END = {"event": "end"}


class Nodes:
    """Stands for running nodes: gives events, and notes what it is asked for."""

    def __init__(self, *events, ended=None):
        self.events = SimpleQueue()
        for event in events:
            self.events.put(event)
        self._ended = ended or {}
        self.resumed = 0
        self.failure = None

    def page_failure(self):
        return self.failure

    def ended(self):
        return self._ended

    def log_tail(self, name):
        return f"last words of {name}"

    def resume(self):
        self.resumed += 1


class Viewers:
    """Stands for viewers: notes what they hear, and asks for what the test wants."""

    def __init__(self, *orders):
        self.heard = []
        self._orders = list(orders)

    def publish(self, event):
        self.heard.append(event)

    def orders(self):
        if any(event["event"] == "paused" for event in self.heard):
            while self._orders:
                yield self._orders.pop(0)


def feedback(step, total=20):
    return {"event": "feedback", "step": step, "total": total, "activity": "table position 1",
            "doing": Why.MEASURING,
            "current_std_rad": None, "time_left_s": 9.0}  # fmt: skip


def follow(nodes, at_once=False, viewers=None):
    person = SessionOperator(parse_configuration(dump_configuration("plane_mirror", {})), at_once)
    return _follow(nodes, person, viewers or Viewers())


def test_progress_is_a_line_for_every_tenth_of_the_steps(capsys):
    nodes = Nodes(STARTED, *(feedback(step) for step in range(21)), RESULT)
    assert follow(nodes) == RESULT
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 10
    assert lines[0] == "2 of 20 steps, table position 1, 9 s left"


def test_viewers_are_told_where_the_page_is_once(capsys):
    page, text = {"event": "page", "address": "http://[::1]:80"}, "page: http://[::1]:80"
    nodes, viewers = Nodes(STARTED, page, feedback(1), RESULT), Viewers()
    follow(nodes, viewers=viewers)
    assert viewers.heard == [STARTED, {"event": "page", "text": text}, feedback(1)]
    assert capsys.readouterr().err.count(text) == 1


def test_a_page_that_cannot_start_is_told_once_and_ends_nothing(capsys):
    nodes, viewers = Nodes(STARTED, feedback(1), RESULT), Viewers()
    nodes.failure = "port 80 is taken"
    assert follow(nodes, viewers=viewers) == RESULT
    told = [event for event in viewers.heard if event["event"] == "page"]
    assert told == [{"event": "page", "text": "no page: port 80 is taken"}]
    assert capsys.readouterr().err.count("port 80") == 1


def test_work_of_a_person_that_counts_as_done_goes_on():
    nodes = Nodes(STARTED, PAUSED, feedback(1), RESULT)
    assert follow(nodes, at_once=True) == RESULT
    assert nodes.resumed == 1


def test_a_viewer_says_that_the_work_is_done_that_is_asked_for_and_no_other():
    done = {"event": "done", "instruction": PAUSED["instruction"]}
    nodes, viewers = Nodes(STARTED, PAUSED, feedback(1), RESULT), Viewers(done)
    assert follow(nodes, viewers=viewers) == RESULT
    assert nodes.resumed == 1
    assert viewers.heard == [STARTED, PAUSED, feedback(1)]

    late = {"event": "done", "instruction": "put the tracker elsewhere"}
    nodes = Nodes(STARTED, PAUSED, feedback(1), RESULT)
    follow(nodes, viewers=Viewers(late, {"event": "nonsense"}))
    assert nodes.resumed == 0


def test_a_viewer_stops_it_as_ctrl_c_would():
    with pytest.raises(KeyboardInterrupt):
        follow(Nodes(STARTED, PAUSED, RESULT), viewers=Viewers({"event": "stop"}))


@pytest.mark.parametrize(
    ("events", "ended", "kind", "words"),
    [
        ([{"event": "refused", "reason": "busy"}], {}, ConfigurationError, "refused: busy"),
        ([END], {}, ConfigurationError, "node client ended at its start"),
        ([END], {"solver": 2}, ConfigurationError, "node solver ended at its start .exit code 2"),
        ([], {"solver": 2}, ConfigurationError, "node solver ended at its start"),
        ([STARTED, END], {"solver": 2}, DataError, "ended without a result"),
    ],
)
def test_an_ending_without_a_result_is_an_error(events, ended, kind, words):
    with pytest.raises(kind, match=words) as raised:
        follow(Nodes(*events, ended=ended))
    name = "solver" if "solver" in words else "client"
    assert raised.value.log == ("" if "refused" in words else f"last words of {name}")


def test_a_client_that_falls_silent_hangs(monkeypatch):
    monkeypatch.setattr(running, "SILENCE_TIMEOUT_S", 0.1)
    with pytest.raises(DataError, match="it hangs"):
        follow(Nodes(STARTED))


def test_the_result_of_a_canceled_goal_is_waited_for(monkeypatch):
    assert _result_of_cancelling(Nodes(feedback(1), RESULT)) == RESULT
    monkeypatch.setattr(running, "CANCEL_TIMEOUT_S", 0.1)
    assert _result_of_cancelling(Nodes(feedback(1))) == {}


class Told(list):
    """Stands for viewers: notes what is said."""

    say = list.append


@pytest.mark.parametrize("recorded", [True, False])
def test_a_second_interruption_says_how_to_go_on_too(tmp_path, monkeypatch, recorded):
    """The first one is still being obeyed: the bag is being closed."""
    folder = SessionFolder(tmp_path)
    folder.bag.mkdir()
    if recorded:
        (folder.bag / "bag_0.mcap").touch()
    real = SimpleNamespace(
        configuration=SimpleNamespace(simulated=False),
        folder=folder,
        finished=False,
        resume_command="rotcal run c.yaml --resume f",
    )

    def interrupted_twice(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(running, "_run", interrupted_twice)
    told = Told()
    with pytest.raises(KeyboardInterrupt):
        running.calibrate(real, told)
    assert "interrupted again" in told[0]
    expected = "to go on: rotcal run c.yaml --resume f" if recorded else "nothing was recorded yet"
    assert told[1].startswith(expected)


@pytest.mark.parametrize(
    ("code", "recorded", "told_bag", "kind"),
    [
        (601, False, "", ConfigurationError),
        (602, False, "", ConfigurationError),
        (608, True, "/data/told", ConfigurationError),
        (603, True, "", DataError),
        (604, True, "/data/told", DataError),
        (604, False, "", DataError),
    ],
)
def test_the_error_that_ended_it_says_what_is_left_and_where_the_logs_are(
    tmp_path, monkeypatch, code, recorded, told_bag, kind
):
    """A planner that is lost cannot report its bag; the bag is named all the same."""
    folder = SessionFolder(tmp_path)
    folder.bag.mkdir()
    if recorded:
        (folder.bag / "bag_0.mcap").touch()
    session = SimpleNamespace(
        configuration=SimpleNamespace(simulated=False),
        folder=folder,
        finished=False,
        resume_command="rotcal run c.yaml --resume f",
        log_folder="/data/logs",
    )
    outcome = {"error_code": code, "error_msg": "it broke", "bag_folder": told_bag}
    monkeypatch.setattr(running, "_run", lambda *_: outcome)
    with pytest.raises(kind) as raised:
        running.calibrate(session, Told())
    left = f"; everything measured so far is in {told_bag or folder.bag}"
    go_on = "; resume with: rotcal run c.yaml --resume f"
    assert str(raised.value) == "it broke" + recorded * (left + go_on) + "; logs: /data/logs"
    outcome["error_msg"] = "it broke; continue with: rotcal run c.yaml --resume f"
    with pytest.raises(kind) as raised:
        running.calibrate(session, Told())
    assert str(raised.value).count("--resume") == 1
