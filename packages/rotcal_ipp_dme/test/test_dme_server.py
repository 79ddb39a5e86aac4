"""The DME server of the simulated machine, spoken to byte by byte as foreign clients do."""

import random
import socket

import pytest
from dme_plates import simulated_cell, small

from rotcal_ipp_dme.protocol import ResponseKind, parse_response
from rotcal_ipp_dme.server import DmeServer, serve_in_thread
from rotcal_ros.foundation.errors import ControllerError

BEGIN = ("00001 StartSession()", "00002 Home()")


class Talk:
    """A client that sends lines and reads until a tag is done."""

    def __init__(self, port):
        self.connection = socket.create_connection(("127.0.0.1", port), 20.0)
        self.lines = self.connection.makefile("rb")

    def send(self, *commands):
        self.connection.sendall("".join(f"{c}\r\n" for c in commands).encode("latin-1"))

    def until(self, tag):
        """Return the lines up to the end of ``tag``."""
        heard = []
        while f"{tag} %" not in heard:
            line = self.lines.readline().decode()
            assert line.endswith("\r\n"), heard
            heard.append(line[:-2])
        return heard

    def ask(self, command):
        self.send(command)
        return self.until(command[:5])

    def errors(self, command):
        return [parse_response(line).fault().number for line in self.ask(command) if " ! " in line]


@pytest.fixture(scope="module")
def port():
    cell = simulated_cell(small("simulation.time_scale=5.0"))
    with serve_in_thread(DmeServer(cell, "127.0.0.1", 0)) as server:
        yield server.port


@pytest.fixture
def talk(port):
    talks = []

    def begin(*commands):
        talks.append(Talk(port))
        for command in commands:
            talks[-1].ask(command)
        return talks[-1]

    yield begin
    for made in talks:
        made.send("99999 EndSession()")
        made.until("99999")
        made.connection.close()


def test_nothing_is_done_without_a_session_and_two_are_too_many(talk):
    client = talk()
    assert client.errors("00001 Home()") == [8]
    assert client.ask("00002 EndSession()") == ["00002 &", "00002 %"]
    assert client.ask("00003 StartSession()") == ["00003 &", "00003 %"]
    assert client.errors("00004 StartSession()") == [8]


def test_the_machine_class_is_a_text_as_in_the_examples_of_nist(talk):
    """The specification prints it bare; NIST's parser takes a text alone."""
    answer = talk("00001 StartSession()").ask("00002 GetMachineClass()")
    assert answer[1] == '00002 # GetMachineClass("CartCMMWithRotaryTable")'


def test_the_dialog_of_a_motion_and_a_question(talk):
    client = talk(*BEGIN)
    assert client.ask("00003 GoTo(X(290), Z(200))") == ["00003 &", "00003 %"]
    heard = client.ask("00004 Get(Z(), X())")
    assert heard == ["00004 &", "00004 # Z(200), X(290)", "00004 %"]


def test_an_abort_ends_what_moves_and_what_waits_and_then_itself(talk):
    client = talk(*BEGIN)
    client.send("00051 GoTo(X(-1900))", "00052 GoTo(Y(300))", "E0053 AbortE()")
    heard = client.until("E0053")
    told = [(line[:5], line[6]) for line in heard]
    assert told[-1] == ("E0053", "%")
    for tag in ("00051", "00052"):
        assert (tag, "!") in told
        assert told.index((tag, "!")) < told.index((tag, "%"))
    faults = [parse_response(line).fault().number for line in heard if " ! " in line]
    assert faults == [6, 6]
    assert client.errors("00054 Get(X())") == [514]
    assert client.errors("00055 ClearAllErrors()") == []
    (x,) = [line for line in client.ask("00056 Get(X())") if " # " in line]
    assert -1900 < float(x.partition("X(")[2].rstrip(")")) <= 300


def test_errors_have_the_numbers_of_the_specification(talk):
    client = talk(*BEGIN)

    def number(command):
        (found,) = client.errors(command)
        client.ask("00098 ClearAllErrors()")
        return found

    assert number("00003 Dance()") == 501
    assert number("00003 GoTo(X(9000))") == 2500
    assert number("00003 GoTo(Q(1))") == 506
    assert number("00003 GoTo(X(1), X(2))") == 502
    assert number("00003 Get(W())") == 509
    assert number("00003 OnPtMeasReport(W())") == 510
    assert number('00003 ChangeTool("None")') == 1502
    assert number("00003 PtMeas(X(0), Y(0), Z(150), IJK(0, 0, 1))") == 1006
    assert number("00003 PtMeas(X(0), Y(0), Z(150), IJK(0, 0, 0))") == 1010
    assert number("00003 StopDaemon(E0553)") == 513
    assert number("00003 SetProp(Tool.PtMeasPar.Approach(900))") == 504
    assert number("00003 GoTo(X(1)") == 507
    assert number("00003 GoTo(R(1e9))") == 2505
    # ball 0 of the plate, on the circle of 185 mm, with the table at -10 deg
    client.ask("00004 GoTo(X(182.19), Y(-32.12), Z(100))")
    assert number("00005 GoTo(Z(0))") == 2504


def test_a_wrong_tag_is_answered_without_one(talk):
    client = talk(*BEGIN)
    client.send("A4711 Home()")
    assert client.lines.readline().startswith(b'E0000 ! Error(2, 0001, "Server", "Illegal tag")')


def test_a_moving_machine_reports_until_it_is_told_not_to(talk):
    client = talk(*BEGIN)
    client.ask("00003 GoTo(X(300), Y(0), Z(200))")
    client.ask("E0553 OnMoveReportE(Time(0.1), Dis(20), X(), R())")
    heard = client.ask("00004 GoTo(X(-900))")
    reports = [parse_response(line) for line in heard if line.startswith("E0553")]
    assert len(reports) >= 2
    assert {r.kind for r in reports} == {ResponseKind.DATA}
    assert all(r.text.startswith("X(") and ", R(" in r.text for r in reports)
    client.ask("00005 StopDaemon(E0553)")
    assert [line for line in client.ask("00006 GoTo(X(0))") if line.startswith("E")] == []


def test_one_client_at_a_time(port, talk):
    talk(*BEGIN)
    with socket.create_connection(("127.0.0.1", port), 20.0) as second:
        assert second.recv(10) == b""


def test_whatever_comes_the_server_goes_on(port):
    generator = random.Random(1)
    words = [
        *[
            "(",
            ")",
            ",",
            "X",
            "R",
            "-1",
            "1e999",
            "1e300",
            "IJK",
            "GoTo",
            "PtMeas",
            "AlignPart",
            "SetProp",
            "Get",
            "E0001",
        ],
        '"',
    ]
    words += ["OnMoveReportE", "StopDaemon", "Tool.PtMeasPar.Search"]
    with socket.create_connection(("127.0.0.1", port), 20.0) as connection:
        connection.sendall(b"00001 StartSession()\r\n")
        for number in range(2, 200):
            text = " ".join(generator.choices(words, k=generator.randint(1, 9)))
            connection.sendall(f"{number:05d} {text}\r\n".encode())
        connection.sendall(b"\x00\xff garbage\r\n")
        while connection.recv(65536):
            pass  # until it closes: that last line is none of this protocol
    client = Talk(port)
    assert client.ask("00001 StartSession()") == ["00001 &", "00001 %"]
    client.ask("00002 EndSession()")
    client.connection.close()


def test_a_port_that_is_taken_is_told(port):
    cell = simulated_cell(small())
    with (
        pytest.raises(ControllerError, match=f"cannot listen at 127.0.0.1:{port}"),
        serve_in_thread(DmeServer(cell, "127.0.0.1", port)),
    ):
        pass
