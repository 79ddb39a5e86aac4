"""Those who watch a running calibration from elsewhere: each gets all of it, and may answer.

They meet at a Unix domain socket that only its user may open. Lines of JSON go both ways: to the
viewers what the client reports (see :mod:`rotcal_ros.nodes.client`) between ``session`` and
``ended``, from them ``done`` with the instruction that was followed, and ``stop``.
"""

from __future__ import annotations

import asyncio
import json
import os
import socket
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from queue import Empty, SimpleQueue
from threading import Thread
from types import TracebackType
from typing import Any, Final

from rotcal_ros.foundation.errors import RotcalError
from rotcal_ros.foundation.files import write_atomically
from rotcal_ros.foundation.node_state import PAUSES
from rotcal_ros.report.terminal.console import say
from rotcal_ros.sessions.session import Session

MAX_BACKLOG: Final = 1 << 20
"""Bytes that wait for a viewer before it counts as dead."""
FAREWELL_S: Final = 1.0
"""Time for viewers to take the last lines."""
MAX_ADDRESS: Final = 107
"""Bytes of the address of a Unix domain socket (sun_path of unix(7), less its final zero)."""

Event = Mapping[str, Any]


class History:
    """What a late viewer has to know: the present state, not how it came about."""

    def __init__(self) -> None:
        self._now: dict[str, Event] = {}

    def remember(self, event: Event) -> None:
        """Note an event; it replaces those that it outdates."""
        kind = event["event"]
        if kind == "feedback" and event["doing"] not in PAUSES:
            self._now.pop("paused", None)
        self._now[kind] = event

    def events(self) -> list[Event]:
        """Return the present state, in an order that can be understood."""
        kinds = ("session", "page", "feedback", "paused", "ended")
        return [self._now[kind] for kind in kinds if kind in self._now]


class Viewers:
    """The viewers of a session; a context manager, whose end or error they are told.

    Nothing here waits for a viewer, and nothing fails: without a socket nobody can attach.
    """

    def __init__(self, session: Session, *, at_once: bool = False) -> None:
        self._history = History()
        self._history.remember({"event": "session", "at_once": at_once})
        self._writers: set[asyncio.StreamWriter] = set()
        self._orders: SimpleQueue[Event] = SimpleQueue()
        self._meeting_point = session.folder.meeting_point
        self._socket: socket.socket | None = None
        try:
            self._socket = _listening()
            address = json.dumps({"socket": self._socket.getsockname()})
            write_atomically(self._meeting_point, address + "\n")
        except OSError as error:
            say(f"nobody can attach to this calibration: {error}")

    def publish(self, event: Event) -> None:
        """Tell all viewers, present and future ones."""
        self._loop.call_soon_threadsafe(self._spread, event)

    def say(self, text: str) -> None:
        """Print a line for people, here and at all viewers."""
        say(text)
        self.publish({"event": "line", "text": text})

    def end(self, outcome: Event) -> None:
        """Let all viewers know how it ended."""
        self.publish({"event": "ended", "outcome": dict(outcome)})

    def orders(self) -> Iterator[Event]:
        """Yield what the viewers have asked for since the last call."""
        with suppress(Empty):
            while True:
                yield self._orders.get_nowait()

    def __enter__(self) -> Viewers:
        # Not earlier: 'rotcal run --detach' forks in between, which no event loop survives.
        self._loop = asyncio.new_event_loop()
        self._thread = Thread(target=self._loop.run_forever, name="viewers", daemon=True)
        self._thread.start()
        if self._socket is not None:
            start = asyncio.start_unix_server(self._serve, sock=self._socket)
            asyncio.run_coroutine_threadsafe(start, self._loop).result()
        return self

    def __exit__(
        self,
        _kind: type[BaseException] | None,
        error: BaseException | None,
        _trace: TracebackType | None,
    ) -> None:
        if self._socket is not None:
            address = Path(self._socket.getsockname())
            for path in (self._meeting_point, address):
                path.unlink(missing_ok=True)
            with suppress(OSError):
                address.parent.rmdir()
        if isinstance(error, KeyboardInterrupt):
            self.end({"interrupted": True})
        elif error is not None:
            code = error.exit_code if isinstance(error, RotcalError) else RotcalError.exit_code
            text = str(error) or type(error).__name__
            self.publish({"event": "ended", "error": text, "exit_code": code})
        asyncio.run_coroutine_threadsafe(self._farewell(), self._loop).result()
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()
        self._loop.close()
        if self._socket is not None:
            self._socket.close()

    def _spread(self, event: Event) -> None:
        self._history.remember(event)
        line = _line(event)
        for writer in tuple(self._writers):
            if writer.transport.get_write_buffer_size() > MAX_BACKLOG:
                writer.transport.abort()  # it takes nothing any more
            else:
                writer.write(line)

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Send a viewer the present state and take its requests until it leaves."""
        for event in self._history.events():
            writer.write(_line(event))
        self._writers.add(writer)
        with suppress(OSError, ValueError, TypeError):  # gone meanwhile, or not a viewer of ours
            while line := await reader.readline():
                self._orders.put(dict(json.loads(line)))
        self._writers.discard(writer)
        writer.close()

    async def _farewell(self) -> None:
        """Disconnect all viewers, after a moment for their last lines."""
        writers = tuple(self._writers)
        for writer in writers:
            writer.close()
        leaving = asyncio.gather(*(w.wait_closed() for w in writers), return_exceptions=True)
        await asyncio.wait([leaving], timeout=FAREWELL_S)
        for writer in writers:
            writer.transport.abort()
        tasks = asyncio.all_tasks() - {asyncio.current_task()}
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)


def _line(event: Event) -> bytes:
    return (json.dumps(event) + "\n").encode()


def _listening() -> socket.socket:
    """Return a socket that only this user can open, in a folder that only this user can enter."""
    address = Path(tempfile.mkdtemp(prefix="rotcal-", dir=_place()), "socket")
    found = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        found.bind(str(address))
        address.chmod(0o600)
        found.listen()
    except OSError:
        found.close()
        raise
    return found


def _place() -> str:
    """Return a folder for sockets whose path is short enough; that of a session rarely is."""
    room = len(os.fsencode("/rotcal-12345678/socket"))
    # That of XDG comes last: it is removed with the last login, which a calibration may outlive.
    for place in (tempfile.gettempdir(), "/tmp", os.environ.get("XDG_RUNTIME_DIR", "")):
        if os.access(place, os.W_OK | os.X_OK) and len(os.fsencode(place)) + room <= MAX_ADDRESS:
            return place
    raise OSError("no folder for its socket: set TMPDIR to a short path")
