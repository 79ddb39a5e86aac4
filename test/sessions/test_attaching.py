"""Viewers of a running session: all of them hear it, none of them holds it up."""

import json
import socket
import time
from contextlib import suppress
from threading import Thread
from types import SimpleNamespace

import pytest

from rotcal_ros.foundation.errors import ConfigurationError, DataError
from rotcal_ros.foundation.folder_lock import FolderLock
from rotcal_ros.foundation.machine_load import load_scaled_timeout
from rotcal_ros.foundation.node_state import Why
from rotcal_ros.foundation.session_folder import SessionFolder
from rotcal_ros.sessions import attaching as module
from rotcal_ros.sessions.attaching import (
    Attachment,
    EventHistory,
    Viewers,
    running_sessions,
    watch_session,
)

DEADLINE_S = 30.0
PAUSED = {"event": "paused", "instruction": "put the tracker there", "doing": Why.WORK}
OUTCOME = {"verdict": "ok", "n_used": 3}


def feedback(step, doing=Why.MEASURING):
    return {"event": "feedback", "step": step, "total": 20, "activity": "words", "doing": doing,
            "current_std_rad": None, "time_left_s": None}  # fmt: skip


@pytest.fixture
def session(tmp_path):
    folder = SessionFolder(tmp_path / "out" / "cell")
    folder.path.mkdir(parents=True)
    folder.configuration.write_text("/**: {ros__parameters: {method: plane_mirror}}\n")
    return SimpleNamespace(folder=folder)


def connect(session):
    connection = socket.socket(socket.AF_UNIX)
    connection.connect(json.loads(session.folder.socket_file.read_text())["socket"])
    return connection


def heard(attachment, last):
    """Return all events up to one of the kind ``last``."""
    events = [attachment.events.get(timeout=load_scaled_timeout(DEADLINE_S))]
    while events[-1]["event"] != last:
        events.append(attachment.events.get(timeout=load_scaled_timeout(DEADLINE_S)))
    return events


def order_of(viewers):
    deadline = time.monotonic() + load_scaled_timeout(DEADLINE_S)
    while not (orders := list(viewers.orders())):
        assert time.monotonic() < deadline
        time.sleep(0.01)
    return orders


def test_who_comes_late_hears_how_it_stands():
    history = EventHistory()
    history.remember({"event": "session", "at_once": False})
    page = {"event": "page", "text": "page: http://127.0.0.1:8000"}
    for event in (page, feedback(1), feedback(2, Why.WORK), PAUSED, {"event": "alive"}):
        history.remember(event)
    assert [e["event"] for e in history.events()] == ["session", "page", "feedback", "paused"]
    assert history.events()[1:3] == [page, feedback(2, Why.WORK)]
    history.remember(feedback(3))  # somebody has done it
    assert [e["event"] for e in history.events()] == ["session", "page", "feedback"]


def test_all_viewers_hear_all_and_one_of_them_answers(session):
    with Viewers(session) as viewers:
        first = Attachment(connect(session))
        heard(first, "session")
        viewers.publish(feedback(4))
        viewers.publish(PAUSED)
        second = Attachment(connect(session))
        assert heard(second, "paused") == [
            {"event": "session", "at_once": False}, feedback(4), PAUSED,
        ]  # fmt: skip
        second.done(PAUSED["instruction"])
        assert order_of(viewers) == [{"event": "done", "instruction": "put the tracker there"}]
        viewers.say("a line")
        viewers.end(OUTCOME)
    assert [e["event"] for e in heard(first, "gone")] == [
        "feedback", "paused", "line", "ended", "gone",
    ]  # fmt: skip
    assert heard(second, "ended")[-1]["outcome"] == OUTCOME
    assert not session.folder.socket_file.exists()


def test_an_error_is_heard_with_its_exit_code(session):
    viewers = Viewers(session)
    with suppress(DataError), viewers:
        viewer = Attachment(connect(session))
        heard(viewer, "session")
        raise DataError("too few lengths")
    ended = heard(viewer, "ended")[-1]
    assert (ended["error"], ended["exit_code"]) == ("too few lengths", 3)


def test_a_viewer_that_takes_nothing_is_let_go_and_the_others_hear_on(session, monkeypatch):
    monkeypatch.setattr(module, "MAX_BACKLOG", 10_000)
    with Viewers(session) as viewers:
        stuck, viewer = connect(session), Attachment(connect(session))
        heard(viewer, "session")
        large = {"event": "line", "text": "x" * 5000}
        for _ in range(400):  # two megabytes: more than the kernel holds for it
            viewers.publish(large)
            heard(viewer, "line")
        viewers.end(OUTCOME)
    assert heard(viewer, "ended")[-1]["outcome"] == OUTCOME
    taken = b""
    while part := stuck.recv(1 << 20):
        taken += part
    assert 0 < len(taken) < 400 * 5000
    stuck.close()


@pytest.mark.parametrize("nonsense", [b"hello\n", b"[1]\n", b"x" * 100_000, b"\xff\xfe\n"])
def test_nonsense_ends_the_connection_and_nothing_else(session, nonsense):
    with Viewers(session) as viewers:
        with connect(session) as connection:
            connection.sendall(nonsense)
            connection.settimeout(DEADLINE_S)
            while connection.recv(4096):
                pass
        viewer = Attachment(connect(session))
        viewer.stop()
        assert order_of(viewers) == [{"event": "stop"}]


def test_without_a_place_for_a_socket_nobody_can_attach_and_all_else_works(
    session, monkeypatch, capsys
):
    monkeypatch.setattr(module, "MAX_ADDRESS", 5)
    with Viewers(session) as viewers:
        viewers.publish(feedback(1))
        viewers.end(OUTCOME)
    assert "no viewer can attach" in capsys.readouterr().err


def test_a_folder_with_a_long_path_is_no_hindrance(session, tmp_path):
    deep = tmp_path.joinpath(*["deeper_and_deeper"] * 10)
    deep.mkdir(parents=True)
    with Viewers(SimpleNamespace(folder=SessionFolder(deep))):
        assert len(str(deep)) > module.MAX_ADDRESS
        assert (deep / "running.json").exists()


def test_the_running_sessions_below_a_folder_are_found_and_killed_ones_told(session, tmp_path):
    with Viewers(session):
        assert running_sessions(tmp_path / "out") == [session.folder]
    assert running_sessions(tmp_path / "out") == []
    stale = tmp_path / "stale"
    with socket.socket(socket.AF_UNIX) as killed:
        killed.bind(str(stale))
    session.folder.socket_file.write_text(json.dumps({"socket": str(stale)}))
    assert running_sessions(tmp_path / "out") == []
    with pytest.raises(ConfigurationError, match="was interrupted; resume with: rotcal run"):
        watch_session(session.folder)


def test_a_session_that_still_writes_is_not_called_interrupted(session):
    lock = FolderLock(session.folder.path)
    try:
        with pytest.raises(ConfigurationError, match="still writes in"):
            watch_session(session.folder)
    finally:
        lock.release()


def test_a_socket_does_not_lie_where_the_last_login_takes_it_away(session, tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    with Viewers(session):
        address = json.loads(session.folder.socket_file.read_text())["socket"]
    assert not address.startswith(str(tmp_path))


def test_what_cannot_be_attached_to_is_told_with_its_reason(session):
    with pytest.raises(ConfigurationError, match="no calibration runs in"):
        watch_session(session.folder)
    session.folder.socket_file.write_text("{}")
    with pytest.raises(ConfigurationError, match="names no socket"):
        watch_session(session.folder)
    session.folder.socket_file.unlink()
    session.folder.result.write_text("{}")
    with pytest.raises(ConfigurationError, match=r"is finished, see .*result\.json"):
        watch_session(session.folder)
    session.folder.configuration.unlink()
    with pytest.raises(ConfigurationError, match="holds no calibration"):
        watch_session(session.folder)


def test_a_session_that_lets_go_without_a_word_is_told_as_dead(session, tmp_path):
    address = tmp_path / "s"
    with socket.socket(socket.AF_UNIX) as server:
        server.bind(str(address))
        server.listen()
        session.folder.socket_file.write_text(json.dumps({"socket": str(address)}))
        Thread(target=lambda: server.accept()[0].close(), daemon=True).start()
        with pytest.raises(DataError, match="was killed"):
            watch_session(session.folder)
