"""A DME server over TCP for the simulated machine: one client at a time, others' or ours.

One client's conversation with a DME server: tags, queues, errors, AbortE and daemons.

Commands wait in a queue and are done in their order; those of the fast queue, whose names end with
E, at once. An error of severity 2 and more ends all that is pending, and nothing else is done
before ClearAllErrors. Source: I++ DME 1.4.3, 6.2 and 6.3.1.
"""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from threading import Event, Thread
from typing import Final

from rotcal_ros.extensions.ipp_dme.faults import DmeError, Fault, ProtocolError
from rotcal_ros.extensions.ipp_dme.grammar import Call, Value, Word, call, parse_call, written
from rotcal_ros.extensions.ipp_dme.lines import (
    END,
    UNASKED,
    Command,
    Kind,
    LineBuffer,
    Response,
    error_line,
    is_tag,
)
from rotcal_ros.extensions.ipp_dme.machine import MethodError, SimulatedMachine
from rotcal_ros.extensions.ipp_dme.methods import Methods, error_info
from rotcal_ros.foundation.errors import ControllerError
from rotcal_ros.simulation import SimulatedCell

VERSION: Final = "1.4.3"
RECEIVED: Final = 65_536
UNREAD: Final = 1 << 20
"""Bytes that a client may leave unread before its connection is closed."""
PATIENCE_S: Final = 0.5
"""Time for a client to leave before the next one is sent away."""
PATIENCE: Final = 50
"""Looks within that time."""
STARTING_S: Final = 10.0


class DmeServer:
    """Listens at ``host`` and ``port`` (0: any free one); ``port`` is the one it has.

    The machine lives as long as the server, a session as long as its connection at most.
    """

    def __init__(self, cell: SimulatedCell, host: str, port: int, version: str = VERSION) -> None:
        self.machine = SimulatedMachine(cell)
        self.host, self.port, self.version = host, port, version
        self._free = asyncio.Lock()

    async def serve(self, listening: Callable[[], None]) -> None:
        """Serve until cancelled; ControllerError when the port cannot be had."""
        try:
            server = await asyncio.start_server(self._converse, self.host, self.port)
        except OSError as error:
            why = error.strerror or str(error)
            raise ControllerError(f"cannot listen at {self.host}:{self.port}: {why}") from error
        self.port = server.sockets[0].getsockname()[1]
        listening()
        async with server:
            await server.serve_forever()

    async def _converse(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Take a client, unless there is one already."""
        for _ in range(PATIENCE):
            if not self._free.locked():
                break
            await asyncio.sleep(PATIENCE_S / PATIENCE)  # the one before may be leaving
        if self._free.locked():
            writer.close()
            return
        async with self._free:
            await self._talk(reader, writer)

    async def _talk(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Take what comes until the client leaves or the server ends."""

        def write(line: bytes) -> None:
            if not writer.is_closing():
                writer.write(line)
            if writer.transport.get_write_buffer_size() > UNREAD:
                writer.transport.abort()

        conversation = Conversation(Methods(self.machine, self.version), write)
        try:
            while received := await reader.read(RECEIVED):
                conversation.take(received)
        except ProtocolError:
            write(str(error_line(UNASKED, Fault.known(7, "Server"))).encode() + END)
        except (OSError, asyncio.CancelledError):
            pass  # the client is gone, or this server is ended
        finally:
            await conversation.end()
            writer.close()


@contextmanager
def serving(server: DmeServer) -> Iterator[DmeServer]:
    """Serve in a thread as long as the block lasts."""
    loop, ready = asyncio.new_event_loop(), Event()
    failed: list[Exception] = []

    def work() -> None:
        asyncio.set_event_loop(loop)
        try:
            with suppress(asyncio.CancelledError):
                loop.run_until_complete(task)
            left = asyncio.all_tasks(loop)
            for conversation in left:
                conversation.cancel()
            loop.run_until_complete(asyncio.gather(*left, return_exceptions=True))
        except Exception as error:
            failed.append(error)
        ready.set()

    task = loop.create_task(server.serve(ready.set))
    thread = Thread(target=work, name="DME server", daemon=True)
    thread.start()
    if not ready.wait(STARTING_S) or failed:
        raise failed[0] if failed else DmeError("the DME server does not start")
    try:
        yield server
    finally:
        loop.call_soon_threadsafe(task.cancel)
        thread.join(STARTING_S)
        loop.close()


MOST_PENDING: Final = 1000
MOST_DAEMONS: Final = 10
SHORTEST_PERIOD_S: Final = 0.1
LONGEST_PERIOD_S: Final = 3600.0
ALWAYS: Final = ("ClearAllErrors", "GetErrStatusE", "GetXtdErrStatus", "EndSession", "AbortE")
"""What is done even after an error."""
WITHOUT_SESSION: Final = ("StartSession", "EndSession")


class Conversation:
    """Lines in by :meth:`take`, lines out through ``write``; ends with :meth:`end`."""

    def __init__(self, methods: Methods, write: Callable[[bytes], None]) -> None:
        self._methods, self._write = methods, write
        self._lines = LineBuffer()
        self._session, self._in_error, self._ending = False, False, False
        self._waiting: deque[Command] = deque()
        self._current: asyncio.Task[list[str]] | None = None
        self._wake = asyncio.Event()
        self._daemons: dict[str, asyncio.Task[None]] = {}
        self._worker = asyncio.create_task(self._work())

    def take(self, received: bytes) -> None:
        """Take what came; ProtocolError when it can be no line of this protocol."""
        for line in self._lines.feed(received):
            self._take_line(line)

    async def end(self) -> None:
        """End all that runs; the machine stands still."""
        self._ending = True
        self._end_daemons()
        self._worker.cancel()
        if self._current is not None:
            self._current.cancel()
            self._methods.machine.stop()
        with suppress(asyncio.CancelledError):
            await self._worker

    def _take_line(self, line: str) -> None:
        tag = line[:5]
        if not is_tag(tag):
            self._say(error_line(UNASKED, Fault.known(1, "Server")))
            return
        if line[5:6] != " ":
            self._refuse(tag, Fault.known(2, "Server"))
            return
        try:
            order = parse_call(line[6:])
        except ProtocolError:
            self._refuse(tag, Fault.known(507, "Server"))
            return
        if tag.startswith("E") != order.name.endswith("E"):
            self._refuse(tag, Fault.known(1, order.name))
        elif tag.startswith("E"):
            self._do_at_once(tag, order)
        elif len(self._waiting) >= MOST_PENDING:
            self._refuse(tag, Fault.known(8, order.name))
        else:
            self._say(Response(tag, Kind.ACCEPTED))
            self._waiting.append(Command(tag, order))
            self._wake.set()

    async def _work(self) -> None:
        """Do the waiting commands, one after the other."""
        while True:
            while self._waiting:
                await self._do(self._waiting.popleft())
            self._wake.clear()
            await self._wake.wait()

    async def _do(self, command: Command) -> None:
        tag, order = command.tag, command.call
        self._current = asyncio.create_task(self._answer(order))
        try:
            for line in await self._current:
                self._say(Response(tag, Kind.DATA, line))
            for fault in self._methods.warnings:
                self._say(error_line(tag, fault))
        except MethodError as refused:
            self._fail(tag, refused.fault)
        except asyncio.CancelledError:
            if self._ending:
                raise
            self._methods.machine.stop()
            self._say(error_line(tag, Fault.known(6, order.name)))
        except Exception:  # whatever a foreign command does, the client hears of it
            self._fail(tag, Fault.known(511, order.name))
        finally:
            self._current = None
            self._methods.warnings.clear()
        self._say(Response(tag, Kind.DONE))

    async def _answer(self, order: Call) -> list[str]:
        """Return the data of a command, as far as the state allows it to be done."""
        if order.name in WITHOUT_SESSION:
            return self._begin_or_end(order)
        if not self._session:
            raise MethodError(8, order.name)
        if self._in_error and order.name not in ALWAYS:
            raise MethodError(514, order.name)
        match order.name:
            case "ClearAllErrors":
                self._in_error = False
                return []
            case "GetErrorInfo":
                return error_info(order)
            case "GetXtdErrStatus":
                return [written(value) for value in self._status()]
            case "StopDaemon":
                return self._stop_daemon(order)
            case "StopAllDaemons":
                if not self._daemons:
                    self._methods.warnings.append(Fault.known(512, order.name))
                self._end_daemons()
                return []
        return await self._methods.run(order)

    def _begin_or_end(self, order: Call) -> list[str]:
        if order.name == "StartSession" and self._session:
            raise MethodError(8, order.name)
        self._session = order.name == "StartSession"
        self._in_error = False
        if not self._session:
            self._end_daemons()
        return []

    def _status(self) -> list[Value]:
        machine = self._methods.machine
        return [call("IsHomed", int(machine.homed)), call("ErrStatus", int(self._in_error))]

    def _do_at_once(self, tag: str, order: Call) -> None:
        """Do a command of the fast queue."""
        self._say(Response(tag, Kind.ACCEPTED))
        try:
            if not self._session:
                raise MethodError(8, order.name)
            match order.name:
                case "AbortE":
                    asyncio.get_running_loop().create_task(self._abort(tag))
                    return
                case "GetErrStatusE":
                    answer = call("ErrStatus", int(self._in_error))
                    self._say(Response(tag, Kind.DATA, written(answer)))
                case "OnMoveReportE":
                    self._start_daemon(tag, order)
                case _:
                    raise MethodError(501, order.name)
        except MethodError as refused:
            self._fail(tag, refused.fault)
        except ProtocolError:
            self._fail(tag, Fault.known(509, order.name))
        self._say(Response(tag, Kind.DONE))

    async def _abort(self, tag: str) -> None:
        """End what is done and what waits, then say that it is ended."""
        self._in_error = True
        waiting, current = list(self._waiting), self._current
        self._waiting.clear()
        if current is not None:
            current.cancel()
            with suppress(asyncio.CancelledError, MethodError):
                await current
            await asyncio.sleep(0)  # the worker reports it first
        self._say_aborted(waiting)
        self._say(Response(tag, Kind.DONE))

    def _start_daemon(self, tag: str, order: Call) -> None:
        if self._in_error or tag in self._daemons or len(self._daemons) >= MOST_DAEMONS:
            raise MethodError(514 if self._in_error else 515, order.name)
        asked = [a for a in order.arguments if isinstance(a, Call)]
        if len(asked) < len(order.arguments):
            raise MethodError(509, order.name)
        period_s = SHORTEST_PERIOD_S
        for argument in asked:
            if argument.name == "Time" and argument.arguments:
                period_s = min(max(period_s, argument.number()), LONGEST_PERIOD_S)
        positions = [a for a in asked if a.name not in ("Time", "Dis")]
        self._methods.standing(positions, order.name)  # MethodError when it cannot be told
        self._daemons[tag] = asyncio.create_task(self._report(tag, period_s, positions))

    async def _report(self, tag: str, period_s: float, positions: list[Call]) -> None:
        """Say where the machine is, again and again while it moves."""
        while True:
            await asyncio.sleep(period_s)
            if self._methods.machine.moving:
                standing = self._methods.standing(positions, "OnMoveReportE")
                self._say(Response(tag, Kind.DATA, standing))

    def _stop_daemon(self, order: Call) -> list[str]:
        match order.arguments:
            case (Word(tag),) if tag in self._daemons:
                self._daemons.pop(tag).cancel()
                return []
        raise MethodError(513, order.name)

    def _end_daemons(self) -> None:
        for daemon in self._daemons.values():
            daemon.cancel()
        self._daemons.clear()

    def _fail(self, tag: str, fault: Fault) -> None:
        """Report an error; one that stops ends what waits as well."""
        self._say(error_line(tag, fault))
        if fault.stops and self._session:
            self._in_error = True
            self._say_aborted(list(self._waiting))
            self._waiting.clear()

    def _say_aborted(self, commands: list[Command]) -> None:
        for command in commands:
            self._say(error_line(command.tag, Fault.known(6, command.call.name)))
            self._say(Response(command.tag, Kind.DONE))

    def _refuse(self, tag: str, fault: Fault) -> None:
        """Answer a line that is no command."""
        self._fail(tag, fault)
        self._say(Response(tag, Kind.DONE))

    def _say(self, response: Response) -> None:
        self._write(str(response).encode("ascii") + END)
