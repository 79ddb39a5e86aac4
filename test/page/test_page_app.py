"""The page's application: what it serves, to whom, and what it lets people ask for."""

import asyncio
import base64
import json
import re
from concurrent.futures import Future
from pathlib import Path

import pytest
from starlette.testclient import TestClient

from rotcal_ros.compensation.secret import Secret
from rotcal_ros.foundation.errors import ConfigurationError
from rotcal_ros.page import app as page_app
from rotcal_ros.page.app import STATIC, ActionOutcome, make_app
from rotcal_ros.page.settings import PageSettings
from rotcal_ros.page.state import (
    Cell,
    CurrentActivity,
    LogLine,
    PageState,
    StateBoard,
    state_changes,
)

ORIGIN = "http://127.0.0.1:8000"
PASSWORD = "a page of one's own"
POSTS = ("resume", "stop", "apply")


class Cellar:
    """Notes what is asked for and answers at once."""

    def __init__(self):
        self.asked = []

    def resume(self, instruction):
        return self._done("resume", instruction)

    def stop(self):
        return self._done("stop")

    def apply(self, confirmation, secret):
        return self._done("apply", confirmation, secret)

    def _done(self, *what):
        self.asked.append(what)
        future = Future()
        future.set_result(ActionOutcome(True, "as you wish"))
        return future


@pytest.fixture
def cellar():
    return Cellar()


@pytest.fixture
def guard(cellar):
    return make_app(StateBoard(), cellar, "127.0.0.1")


@pytest.fixture
def client(guard):
    return TestClient(guard, base_url=ORIGIN)


def own(guard, **others):
    """Return the headers that the page itself sends."""
    return {"origin": ORIGIN, "x-rotcal-token": guard.token, **others}


def events(board, count, token="t"):
    """Return the first events that a viewer gets, as (name, data)."""

    async def take():
        found = []
        async for event in page_app._events(board, token):
            found.append((event["event"], json.loads(event["data"])))
            if len(found) == count:
                return found
        return found

    return asyncio.run(asyncio.wait_for(take(), 30))


def test_the_page_and_all_it_names_come_from_here(client):
    text = client.get("/").text
    named = re.findall(r'(?:src|href)="([^"]+)"', text)
    assert named
    assert all(name.startswith("/static/") for name in named)
    assert all(client.get(name).status_code == 200 for name in named)
    for path in STATIC.glob("*.js"):
        imported = re.findall(r'from "\./([^"]+)"', path.read_text())
        assert all((STATIC / name).is_file() for name in imported)


def test_no_file_of_the_page_asks_another_machine():
    for path in STATIC.iterdir():
        if path.suffix in (".html", ".css", ".js") and not path.name.startswith("uPlot"):
            found = re.findall(r"https?://[^\s\"'`)]+", path.read_text())
            assert {*found} <= {"http://www.w3.org/2000/svg"}, path


def test_both_pages_are_small_and_names_the_licence_of_what_it_carries():
    assert sum(path.stat().st_size for path in STATIC.iterdir()) < 143_000
    assert "Permission is hereby granted" in (STATIC / "uPlot.LICENSE").read_text()


def test_nothing_from_the_cell_becomes_markup():
    for path in STATIC.glob("*.js"):
        if not path.name.startswith("uPlot"):
            words = ("innerHTML", "outerHTML", "insertAdjacentHTML", "document.write", "eval(")
            assert not [word for word in words if word in path.read_text()], path


def test_every_answer_forbids_other_sources_and_frames(client):
    for path in ("/", "/static/main.js", "/nowhere"):
        headers = client.get(path).headers
        assert headers["content-security-policy"].startswith("default-src 'self';")
        assert "frame-ancestors 'none'" in headers["content-security-policy"]
        assert "unsafe" not in headers["content-security-policy"]
        assert headers["x-content-type-options"] == "nosniff"


@pytest.mark.parametrize("what", POSTS)
def test_a_person_on_the_page_is_heard(client, guard, cellar, what):
    body = {"confirmation": "abc", "secret": "open sesame", "instruction": "move it"}
    answer = client.post(f"/{what}", json=body, headers=own(guard))
    assert (answer.status_code, answer.json()) == (
        200, {"success": True, "message": "as you wish"},
    )  # fmt: skip
    said = {"apply": ("abc", "open sesame"), "resume": ("move it",), "stop": ()}[what]
    assert cellar.asked == [(what, *said)]


@pytest.mark.parametrize("what", POSTS)
@pytest.mark.parametrize(
    "wrong",
    [
        {"origin": "http://evil.example"},
        {"origin": "null"},
        {"origin": ""},
        {"origin": "http://127.0.0.1:9999"},
        {"origin": "https://127.0.0.1:8000"},
        {"sec-fetch-site": "cross-site"},
        {"sec-fetch-site": "same-site"},
        {"x-rotcal-token": ""},
        {"x-rotcal-token": "guess"},
        {"x-rotcal-token": "\u00e9\u00e9"},
    ],
    ids=str,
)
def test_another_page_is_not_heard(client, guard, cellar, what, wrong):
    headers = {k: v.encode() for k, v in (own(guard) | wrong).items()}
    answer = client.post(f"/{what}", json={"confirmation": "", "secret": ""}, headers=headers)
    assert (answer.status_code, cellar.asked) == (403, [])


@pytest.mark.parametrize("what", POSTS)
def test_reading_changes_nothing(client, guard, cellar, what):
    assert client.get(f"/{what}", headers=own(guard)).status_code == 405
    assert cellar.asked == []


@pytest.mark.parametrize(
    ("host", "status"),
    [
        ("127.0.0.1:8000", 200),
        ("localhost:8000", 200),
        ("[::1]:8000", 200),
        ("evil.example:8000", 421),
        ("127.0.0.1.evil.example", 421),
        ("", 421),
        ("[", 421),
    ],
)
def test_a_name_that_somebody_lets_point_here_is_not_served(client, host, status):
    for path in ("/", "/static/main.js"):
        assert client.get(path, headers={"host": host}).status_code == status


def test_a_token_is_of_one_start_only(cellar):
    tokens = {make_app(StateBoard(), cellar, "127.0.0.1").token for _ in range(3)}
    assert len(tokens) == 3
    assert min(map(len, tokens)) >= 32


def test_a_request_that_is_no_confirmation_is_refused(client, guard, cellar):
    bodies = (b"", b"[]", b"{}", b'{"confirmation": 1, "secret": 2}', b"x" * 20_000, b"\xff")
    for body in bodies:
        for path in ("/apply", "/resume"):
            assert client.post(path, content=body, headers=own(guard)).status_code == 400
    assert cellar.asked == []


def test_a_refusal_of_the_cell_is_told_in_its_words(client, guard, cellar, monkeypatch):
    future = Future()
    future.set_result(ActionOutcome(False, "nothing is waiting to be resumed"))
    monkeypatch.setattr(cellar, "resume", lambda _instruction: future)
    answer = client.post("/resume", json={"instruction": "x"}, headers=own(guard))
    assert (answer.status_code, answer.json()["message"]) == (
        409,
        "nothing is waiting to be resumed",
    )


def test_a_cell_that_never_answers_is_told(client, guard, cellar, monkeypatch):
    monkeypatch.setattr(page_app, "ANSWER_TIMEOUT_S", 0.01)
    monkeypatch.setattr(cellar, "stop", Future)
    assert client.post("/stop", headers=own(guard)).status_code == 504


def test_an_answer_after_the_time_limit_harms_nobody(client, guard, cellar, monkeypatch):
    late = Future()
    monkeypatch.setattr(page_app, "ANSWER_TIMEOUT_S", 0.01)
    monkeypatch.setattr(cellar, "stop", lambda: late)
    assert client.post("/stop", headers=own(guard)).status_code == 504
    late.set_result(ActionOutcome(True, "too late"))  # as the node's executor would
    assert late.result().message == "too late"


@pytest.fixture
def secret(tmp_path):
    file = tmp_path / "password"
    file.write_text(PASSWORD)
    file.chmod(0o600)
    return Secret(file)


def basic(text):
    return {"authorization": f"Basic {base64.b64encode(text.encode()).decode()}"}


def test_with_a_password_nothing_is_served_without_it(cellar, secret):
    guard = make_app(StateBoard(), cellar, "0.0.0.0", secret)
    client = TestClient(guard, base_url=ORIGIN)
    for path in ("/", "/static/main.js", "/events"):
        refused = client.get(path)
        assert refused.status_code == 401
        assert refused.headers["www-authenticate"].startswith("Basic ")
    wrong = ({}, basic("me:guess"), basic(PASSWORD), {"authorization": "Basic ***"},
             {"authorization": basic(f"me:{PASSWORD}")["authorization"][6:]})  # fmt: skip
    for headers in wrong:
        assert client.get("/", headers=headers).status_code == 401
        assert client.post("/stop", headers=own(guard) | headers).status_code == 401
    strange = {"authorization": "Basic \u00e9\u00e9".encode()}
    assert client.get("/", headers=strange).status_code == 401
    assert client.get("/", headers=basic(f"me:{PASSWORD}")).status_code == 200
    assert client.post("/stop", headers=own(guard, **basic(f":{PASSWORD}"))).status_code == 200
    assert cellar.asked == [("stop",)]


@pytest.mark.parametrize("host", ["0.0.0.0", "::", "192.168.0.7"])
def test_no_interface_but_loopback_without_a_password(host):
    with pytest.raises(ConfigurationError, match="password_file"):
        PageSettings(host=host)
    assert PageSettings(host=host, password_file="somewhere").host == host


@pytest.mark.parametrize("host", ["127.0.0.1", "127.0.0.2", "::1", "localhost"])
def test_loopback_needs_no_password(host):
    assert PageSettings(host=host).password_file == ""


def test_a_host_that_is_no_address_is_refused():
    with pytest.raises(ConfigurationError, match="not an address"):
        PageSettings(host="machine-shop", password_file="somewhere")


def test_a_late_viewer_gets_everything_then_changes():
    board = StateBoard()
    board.show(cell=Cell(item="T-100"), now=CurrentActivity("measuring", "Measuring"))
    ((name, data),) = events(board, 1, token="secret")
    assert name == "state"
    assert data["token"] == "secret"
    assert data["cell"]["item"] == "T-100"
    assert data["now"]["headline"] == "Measuring"
    assert {*PageState.__slots__} <= data.keys()


@pytest.mark.slow
def test_a_viewer_hears_that_the_page_lives_although_nothing_changes():
    first, second, third = events(StateBoard(), 3)
    assert [first[0], second[0], third[0]] == ["state", "tick", "tick"]
    assert third[1]["time_s"] > second[1]["time_s"] > first[1]["time_s"]


def test_after_the_end_nothing_more_comes():
    board = StateBoard()
    board.show(ended=True)
    assert [name for name, _ in events(board, 5)] == ["state"]


def test_only_what_changed_is_sent():
    old = PageState(cell=Cell(item="T-100"))
    new = PageState(cell=Cell(item="T-100"), now=CurrentActivity("ready", "Ready"))
    assert state_changes(old, new).keys() == {"now"}
    assert state_changes(old, old) == {}
    assert state_changes(None, old).keys() == {*PageState.__slots__}


def test_what_is_no_number_becomes_nothing():
    text = json.dumps(state_changes(None, PageState(log=(LogLine(float("nan"), True, "n", "t"),))))
    assert json.loads(text)["log"] == [{"time_s": None, "error": True, "node": "n", "text": "t"}]


def test_all_files_of_the_page_stand_in_the_folder_that_is_installed():
    assert Path(page_app.__file__).parent / "static" == STATIC
    assert (STATIC / "index.html").is_file()
