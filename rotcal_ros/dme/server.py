"""A DME server over TCP for the simulated machine: one client at a time, others' or ours."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from threading import Event, Thread
from typing import Final

from rotcal_ros.dme.conversation import Conversation
from rotcal_ros.dme.faults import DmeError, Fault, ProtocolError
from rotcal_ros.dme.lines import END, UNASKED, error_line
from rotcal_ros.dme.machine import SimulatedMachine
from rotcal_ros.dme.methods import Methods
from rotcal_ros.errors import ControllerError
from rotcal_ros.simulation.settings import SimulationSettings

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

    def __init__(
        self, settings: SimulationSettings, host: str, port: int, version: str = VERSION
    ) -> None:
        self.machine = SimulatedMachine(settings)
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
