"""What our client says and our server answers, read by the parsers of NIST's test suite for 1.4.

They are built from their sources, which are not part of this repository: `make test-aids`
fetches them, or ROTCAL_NIST_DME names a folder with a copy of standAloneTestSuiteComponents.
"""

import socket
import subprocess

import pytest
from aids import nist_suite
from dme_plates import measure, simulated_cell, small

from rotcal_ipp_dme.client import DmeLink
from rotcal_ipp_dme.server import DmeServer, serve_in_thread
from rotcal_ros.foundation.machine_load import load_scaled_timeout

BUILD_S = 120


@pytest.fixture(scope="module")
def suite():
    """Return the folder of the suite's stand-alone components."""
    return nist_suite()


@pytest.fixture(scope="module")
def parsers(suite, tmp_path_factory):
    """Return a function that gives what a parser of NIST complains about in lines."""
    folder = tmp_path_factory.mktemp("nist")

    def complaints(name, lines):
        program = folder / name
        if not program.exists():
            sources = sorted((suite / f"{name}PC" / "source").glob("*.cpp"))
            command = ["g++", "-w", "-DPARSER_MAIN", "-o", str(program), *map(str, sources)]
            subprocess.run(command, check=True, timeout=load_scaled_timeout(BUILD_S))
        text = "".join(f"{line}\r\n\\\\\r\n" for line in lines)
        (folder / "lines").write_bytes(f"{text}:\r\n:\r\n".encode())
        run = subprocess.run(
            [program], input="n\nlines\nq\n", text=True, cwd=folder, capture_output=True,
            timeout=load_scaled_timeout(30), check=True,
        )  # fmt: skip
        assert run.stdout.count("\\\\") + run.stderr.count("\n\n") == len(lines)
        return run.stderr

    return complaints


@pytest.fixture(scope="module")
def wire():
    """Return the lines of both sides while some balls are measured."""
    said, answered = [], []
    patch = pytest.MonkeyPatch()
    send, take = DmeLink._send, DmeLink._take

    def listen_to_commands(self, command):
        said.append(str(command))
        send(self, command)

    def listen_to_answers(self, response):
        answered.append(str(response))
        take(self, response)

    patch.setattr(DmeLink, "_send", listen_to_commands)
    patch.setattr(DmeLink, "_take", listen_to_answers)
    calibration = small("plan.points_per_ball=5")
    with serve_in_thread(DmeServer(simulated_cell(calibration), "127.0.0.1", 0)) as server:
        measure(calibration, server.port, steps=4, tool="Probe1")
    patch.undo()
    return said, answered


def test_our_commands_are_commands_for_nist(parsers, wire):
    said, _ = wire
    assert {line.split()[1].partition("(")[0] for line in said} >= {
        "StartSession", "Home", "ChangeTool", "GoTo", "AlignPart", "PtMeas", "Get", "EndSession",
    }  # fmt: skip
    ours = [line for line in said if "AvrRadius" not in line]  # a property of 1.4.2 and later
    assert parsers("ParserCmd", ours) == ""


def test_our_commands_fit_their_context_for_nist(parsers, wire):
    said, _ = wire
    ours = [line for line in said if "AvrRadius" not in line][1:]  # without the EndSession before
    assert parsers("CheckerCmd", ours) == ""


def test_our_answers_are_answers_for_nist(parsers, wire):
    _, answered = wire
    ours = [line for line in answered if "AvrRadius" not in line]
    assert parsers("ParserRes", ours) == ""


def test_commands_that_nist_gives_as_examples_end_with_an_answer(suite, parsers):
    parsers("ParserCmd", ["00001 Home()"])
    examples = suite / "ParserCmdPC" / "test_files" / "allCmdOK.prg"
    commands = [c for c in examples.read_text().split("\n") if c[:1].isdigit() or c[:1] == "E"]
    calibration = small()
    with serve_in_thread(DmeServer(simulated_cell(calibration), "127.0.0.1", 0)) as server:
        for command in commands:
            with socket.create_connection(("127.0.0.1", server.port), 10.0) as connection:
                begin = "00001 StartSession()\r\n00002 Home()\r\n"
                connection.sendall(f"{begin}{command.strip()}\r\n".encode())
                end = f"{command[:5]} %\r\n".encode()
                heard = b""
                while end not in heard:
                    heard += connection.recv(4096) or pytest.fail(f"{command}: {heard!r}")
                assert heard.count(end) == 1
                assert parsers("ParserRes", heard.decode().split("\r\n")[:-1]) == "", command
