"""Fuzzed by itself: I++ DME, what a server answers to our client, what a client orders of ours."""

from __future__ import annotations

import asyncio
import socket
import threading
import time
from collections.abc import Iterable
from functools import cache
from pathlib import Path
from random import Random
from typing import Any, Final

from mutations import harmed_bytes
from targets import Target

from rotcal_ros.foundation.errors import RotcalError

CONFIGURATION: Final = Path(__file__).parents[1] / "config" / "ball_plate_dme.yaml"
LIMIT_S: Final = 0.05
"""So long the client waits for an answer that was harmed away."""
IDLE_S: Final = 0.2
"""So long the server may work at what it was told."""
ANSWERS: Final = (
    "00001 &|00001 %|00002 &|00002 %|00003 &|00003 # IsHomed(1)|00003 %|00004 &|00004 %|00005 &|"
    '00005 # "RefTool"|00005 # "Probe1"|00005 %|00006 &|00006 # "PtMeasPar.Approach", "Number"|'
    "00006 %|00007 &|00007 # Tool.AvrRadius(1.5)|00007 %|00008 &|00008 %|00009 &|00009 %|E0001 &|"
    "E0001 %|00010 &|E0001 # X(1), Y(2), Z(3), R(4)|00010 # X(1.5), Y(-2), Z(300), R(0)|00010 %|"
    '00011 &|00011 # X(1), Y(2), Z(3), R(0)|00011 ! Error(1, 0504, "PtMeas", "Out of range")|'
    '00011 %|E0000 ! Error(3, 1009, "Machine", "Air pressure")|'
)
ORDERS: Final = (
    "00001 StartSession()|00002 Home()|00003 GetDMEVersion()|00004 EnumAllProp(Tool())|"
    "00005 SetProp(Tool.PtMeasPar.Approach(2), Tool.PtMeasPar.Search(3))|"
    "00006 OnPtMeasReport(X(), Y(), Z(), R())|E0007 OnMoveReportE(Time(0.1), Dis(20), X(), R())|"
    "00008 GoTo(X(200), Y(-10.5), Z(180))|00009 GoTo(R(30))|00010 Get(X(), R())|"
    "00011 PtMeas(X(0), Y(0), Z(150), IJK(0, 0, 1))|00012 AlignPart(1, 0, 0, 0, 1, 0, 0)|"
    '00013 ChangeTool("Probe1")|00014 ClearAllErrors()|E0015 AbortE()|00016 GetErrorInfo(1006)|'
    "00017 StopDaemon(E0007)|00018 SetCoordSystem(MachineCsy)|00019 EndSession()|"
)
_SIGNS: Final = (
    b"( ) , \" ' ! # % & . - + 1e999 1e300 -0 nan 00001 E0001 E0000 X( R( IJK( GoTo( Tool. \0 \xff"
)
_WORDS: Final = (*_SIGNS.split(b" "), b"\r\n", b"(" * 300, b"9" * 5000, b"x" * 70_000)


def answers() -> Iterable[bytes]:
    """Yield what a server answers to the start of a session, a question and a point."""
    yield ANSWERS.replace("|", "\r\n").encode()


def orders() -> Iterable[bytes]:
    """Yield the commands of a session."""
    yield ORDERS.replace("|", "\r\n").encode()


def harmed(rng: Random, data: bytes) -> bytes:
    """Return lines lost, doubled, exchanged, or with harm to their bytes."""
    lines = data.split(b"\r\n")
    k = rng.randrange(len(lines))
    how = rng.randrange(6)
    if how == 0:
        del lines[k]
    elif how == 1:
        lines.insert(rng.randrange(len(lines) + 1), lines[k])
    elif how == 2:
        other = rng.randrange(len(lines))
        lines[k], lines[other] = lines[other], lines[k]
    else:
        lines[k] = harmed_bytes(rng, lines[k], _WORDS)
    return b"\r\n".join(lines)


def read_answers(path: Path) -> None:
    """Let the client begin a session, ask and touch; its threads must not break either."""
    from rotcal_ipp_dme.client import DmeClient
    from rotcal_ipp_dme.settings import DmeSettings

    broken: list[threading.ExceptHookArgs] = []
    before, threading.excepthook = threading.excepthook, broken.append
    try:
        with socket.create_server(("127.0.0.1", 0)) as listener:
            served = threading.Thread(target=_serve, args=(listener, path.read_bytes()))
            served.start()
            client = DmeClient(
                DmeSettings(port=listener.getsockname()[1], tool="", turn_by="goto_r",
                            reply_timeout_s=LIMIT_S, motion_timeout_s=LIMIT_S),
                lambda *_: None, lambda _: None,
            )  # fmt: skip
            try:
                client.start()
                client.touch((0.1, 0.0, 0.0), (0.0, 0.0, 1.0))
            except RotcalError as error:
                assert client.blocked, "it failed and goes on"
                raise RotcalError(str(error)) from None
            finally:
                client.close()
                served.join(10.0)
    finally:
        threading.excepthook = before
    assert not broken, broken[0].exc_value


def _serve(listener: socket.socket, script: bytes) -> None:
    """Answer every line with the script up to its next end of a command."""
    connection, _ = listener.accept()
    with connection, connection.makefile("rb") as lines:
        try:
            for _ in lines:
                part, end, script = script.partition(b" %\r\n")
                connection.sendall(part + end)
                if not end:
                    return
        except OSError:
            return


@cache
def _configuration() -> Any:
    from rotcal_ros.methods.configuration import changed, read_configuration

    configuration = read_configuration(CONFIGURATION)
    return changed(configuration, ("simulation.time_scale=1000.0",))


def read_orders(path: Path) -> None:
    """Let the server hear a client; every line that it says must be one of the protocol."""
    from rotcal_ipp_dme.protocol import LineBuffer, parse_response

    said = asyncio.run(_converse(path.read_bytes()))
    for line in LineBuffer().feed(b"".join(said)):
        parse_response(line)


async def _converse(data: bytes) -> list[bytes]:
    from rotcal_ipp_dme.server import DmeMethods, ServerSession, SimulatedMachine

    said: list[bytes] = []
    failed: list[dict[str, Any]] = []
    asyncio.get_running_loop().set_exception_handler(lambda _, context: failed.append(context))
    method, settings = _configuration().method, _configuration().simulation
    machine = SimulatedMachine(method.simulated_cell(settings, time.time_ns()))
    conversation = ServerSession(DmeMethods(machine, "1.4.3"), said.append)
    try:
        conversation.take(data)
        await asyncio.sleep(IDLE_S)
    finally:
        await conversation.end()
    assert not failed, failed[0]
    return said


TARGETS: Final = (
    Target("dme/answers.txt", answers, harmed, read_answers),
    Target("dmeserver/orders.txt", orders, harmed, read_orders),
)
