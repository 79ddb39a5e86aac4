"""Every command answered late, never, wrongly, cut in the middle: no hang, always a sentence."""

import socket

import pytest
from wire import ANSWERS, DEADLINE_S, wait_for

from rotcal_ipp_dme.client import DmeClient
from rotcal_ipp_dme.protocol import DmeError, NotClearedError
from rotcal_ipp_dme.settings import DmeSettings
from rotcal_ros.foundation.observations import Approach

STARTING = (
    "EndSession", "StartSession", "GetDMEVersion", "IsHomed", "Home", "EnumTools", "ChangeTool",
    "EnumAllProp", "SetProp", "GetProp", "SetCoordSystem", "OnPtMeasReport", "OnMoveReportE",
)  # fmt: skip
MEASURING = ("GoTo", "AlignPart", "PtMeas", "Get")
FAULTS = (
    "never", "accepted, never done", "error", "error without end", "error at once",
    "cut in the middle", "closed", "no line of the protocol", "a line without end",
)  # fmt: skip
NO_LINES = ("no line of the protocol", "a line without end")
UNANSWERED = ("never", "accepted, never done")
SLOW_FAULTS = ("accepted, never done", "error without end")
"""Faults of which every case waits as long as the client does: for commands that move."""
CASES = [
    (harmed, fault)
    for harmed in STARTING + MEASURING
    for fault in FAULTS
    if fault not in SLOW_FAULTS or harmed in ("Home", "GoTo", "AlignPart", "PtMeas")
]
LIMIT_S = 0.25


def client_of(server, **others):
    limit_s = LIMIT_S if server.fault in (*UNANSWERED, *SLOW_FAULTS) else DEADLINE_S
    values = {
        "port": server.port, "home": True, "tool": "Probe1", "settle_s": 0.004,
        "reply_timeout_s": limit_s, "motion_timeout_s": limit_s, "table_zero_deg": 0.0,
    }  # fmt: skip
    return DmeClient(DmeSettings(**(values | others)), lambda *_: None, lambda _: None)


def use(client):
    """Do all that an order leads to."""
    client.start()
    client.go(None, None, 0.3)
    client.turn(0.0, Approach.UNKNOWN, lambda: False)
    client.touch((0.1, 0.0, 0.0), (0.0, 0.0, 1.0))


@pytest.mark.slow
@pytest.mark.parametrize(("harmed", "fault"), CASES)
def test_a_fault_is_a_sentence_that_names_the_command_and_nothing_more_is_sent(
    serve, harmed, fault
):
    server = serve(harmed, fault)
    client = client_of(server)
    with pytest.raises(DmeError) as caught:
        use(client)
    text = str(caught.value)
    assert harmed in text
    assert client.blocked == text
    if fault in UNANSWERED:
        wait_for(lambda: "AbortE" in server.names())
        assert f"within {LIMIT_S:g} s" in text
        assert "AbortE was " in text  # obeyed, unless this machine is too busy
    if "error" in fault:
        assert "2500" in text
        assert "Machine limit encountered" in text
    if fault in NO_LINES:  # what answers like that may be moving
        wait_for(lambda: "AbortE" in server.names())
    heard = len(server.heard)
    with pytest.raises(NotClearedError, match="before a person clears"):
        client.where()
    client.close()
    assert "ClearAllErrors" not in server.names()
    assert server.heard[heard:] == []


@pytest.mark.slow
@pytest.mark.parametrize("harmed", STARTING + MEASURING)
def test_a_late_answer_is_waited_for(serve, harmed):
    client = client_of(serve(harmed, "late"), reply_timeout_s=2.0, motion_timeout_s=2.0)
    use(client)
    assert client.blocked == ""
    client.close()


def test_a_motion_without_end_is_aborted(serve):
    client = client_of(serve("GoTo", "accepted, never done"), reply_timeout_s=DEADLINE_S)
    client.start()
    with pytest.raises(DmeError, match=r"GoTo.*not done .* within 0\.25 s; AbortE was obeyed"):
        client.go(None, None, 0.3)


def test_a_server_that_answers_nothing_at_all_is_told_so_too(serve):
    server = serve("GoTo", "never")
    client = client_of(server)
    client.start()
    server._answer = lambda *_: None  # half open: it takes lines, and is dead
    with pytest.raises(DmeError, match="AbortE was not answered either"):
        client.go(None, None, 0.3)


@pytest.mark.parametrize(
    ("question", "answer"),
    [
        ("GetProp", 'Tool.AvrRadius("1.5")'),
        ("GetProp", "Tool.AvrRadius(0)"),
        ("GetProp", "Tool.AvrRadius(-1.5)"),
        ("GetProp", "Tool.Name(1)"),
        ("IsHomed", 'IsHomed("yes")'),
    ],
)
def test_a_start_that_fails_leaves_nothing_open_and_is_begun_again(serve, question, answer):
    server = serve(**{question: [answer]})
    client = client_of(server)
    with pytest.raises(DmeError) as caught:
        client.start()
    assert client.blocked == str(caught.value)
    assert answer.partition("(")[0].partition(".")[0] in client.blocked
    with pytest.raises(NotClearedError):
        client.go(None, None, 0.3)
    assert not {"GoTo", "SetCoordSystem"} & set(server.names())
    server.answers = ANSWERS
    client.clear()  # errors alone are not all: the session was never begun as a whole
    assert server.names().count("StartSession") == 2
    assert "SetCoordSystem" in server.names()
    assert client.tip_radius == pytest.approx(0.0015)
    client.close()


def test_nobody_at_the_port_is_a_sentence():
    with socket.create_server(("127.0.0.1", 0)) as listener:
        port = listener.getsockname()[1]
    client = DmeClient(DmeSettings(port=port), lambda *_: None, lambda _: None)
    with pytest.raises(DmeError, match=r"no DME server answers at 127\.0\.0\.1"):
        client.start()


def test_a_person_clears_on_a_living_connection_or_begins_a_new_session(serve):
    server = serve("GoTo", "error")
    client = client_of(server)
    client.start()
    with pytest.raises(DmeError):
        client.go(None, None, 0.3)
    client.clear()
    assert server.names()[-2:] == ["ClearAllErrors", "Get"]
    assert client.blocked == ""
    server.fault = "closed"
    with pytest.raises(DmeError):
        client.go(None, None, 0.3)
    server.harmed = ""
    sessions = server.names().count("StartSession")
    client.clear()
    assert server.names().count("StartSession") == sessions + 1
    client.go(None, None, 0.3)
    client.close()
    assert server.names()[-1] == "EndSession"


@pytest.mark.parametrize("fault", FAULTS)
def test_clearing_that_fails_leaves_the_session_blocked_and_the_next_one_begins_anew(serve, fault):
    server = serve("GoTo", "error")
    client = client_of(server, reply_timeout_s=LIMIT_S)
    client.start()
    with pytest.raises(DmeError):
        client.go(None, None, 0.3)
    server.harmed, server.fault = "ClearAllErrors", fault
    with pytest.raises(DmeError, match="ClearAllErrors"):
        client.clear()
    assert "ClearAllErrors" in client.blocked
    with pytest.raises(NotClearedError):
        client.where()
    server.harmed = ""
    client.clear()
    assert server.names().count("StartSession") == 2
    assert client.blocked == ""
    client.close()


@pytest.mark.parametrize("fault", FAULTS)
def test_an_abort_that_is_not_obeyed_blocks_all_the_same(serve, fault):
    server = serve("AbortE", fault)
    client = client_of(server, reply_timeout_s=LIMIT_S)
    client.start()
    if fault == "accepted, never done":
        server.fault = "never"
    with pytest.raises(DmeError, match="AbortE"):
        client.abort("somebody stops it")
    assert client.blocked == "somebody stops it"
    with pytest.raises(NotClearedError, match="somebody stops it"):
        client.go(None, None, 0.3)
    client.close()
