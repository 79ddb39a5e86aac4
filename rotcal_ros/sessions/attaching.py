"""Watches a calibration from another terminal, where a person can also answer.

This module has both ends of the connection. A session listens on a Unix domain socket that only
its user may open; the file ``running.json`` in its folder holds the address. Both ends send lines
of JSON. The session sends ``session`` first, then what its client reports (see
:mod:`rotcal_ros.nodes.client.json_client`) and ``line`` (a text for people), and ``ended`` at
last. A viewer sends ``done`` with the instruction that was followed, or ``stop``.
"""

from __future__ import annotations

import asyncio
import json
import os
import socket
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from queue import Empty, SimpleQueue
from threading import Thread
from types import TracebackType
from typing import Any, Final, NoReturn

from rotcal_ros.foundation.errors import BagError, ConfigurationError, DataError, RotcalError
from rotcal_ros.foundation.files import write_atomically
from rotcal_ros.foundation.folder_lock import FolderLock
from rotcal_ros.foundation.machine_load import load_scaled_timeout
from rotcal_ros.foundation.node_state import PAUSES
from rotcal_ros.foundation.session_folder import MEETING_POINT, SessionFolder, resume_command
from rotcal_ros.foundation.untrusted import NotAFileError, load_json, read_text
from rotcal_ros.methods import read_configuration
from rotcal_ros.report.terminal.console import progress_bar, say
from rotcal_ros.sessions.person import NO_MACHINE, ProgressDisplay, SessionOperator
from rotcal_ros.sessions.session import Session

GREETING_TIMEOUT_S: Final = 10.0
_POLL_S: Final = 0.2
_DEPTHS: Final = ("*", "*/*")
"""Patterns of sessions below a folder: those of 'rotcal verify' are one level deeper."""
MAX_BACKLOG: Final = 1 << 20
"""A viewer with more unread bytes counts as dead: a session does not wait for viewers."""
FAREWELL_S: Final = 1.0
"""Time for viewers to read the last lines."""
MAX_ADDRESS: Final = 107
"""Most bytes in the address of a Unix domain socket (sun_path of unix(7), less its final zero)."""
Event = Mapping[str, Any]


class EventHistory:
    """What a late viewer has to know: the present state, not how it was reached."""

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
    """The viewers of a session; a context manager that tells them how it ends, even by an error.

    Nothing here waits for a viewer, and nothing fails: without a socket no viewer can attach.
    """

    def __init__(self, session: Session, *, at_once: bool = False) -> None:
        self._history = EventHistory()
        self._history.remember({"event": "session", "at_once": at_once})
        self._writers: set[asyncio.StreamWriter] = set()
        self._orders: SimpleQueue[Event] = SimpleQueue()
        self._meeting_point = session.folder.socket_file
        self._socket: socket.socket | None = None
        try:
            self._socket = _listening()
            address = json.dumps({"socket": self._socket.getsockname()})
            write_atomically(self._meeting_point, address + "\n")
        except OSError as error:
            say(f"no viewer can attach to this calibration: {error}")

    def publish(self, event: Event) -> None:
        """Tell all viewers, present and future ones."""
        self._loop.call_soon_threadsafe(self._spread, event)

    def say(self, text: str) -> None:
        """Print a line for people, here and at all viewers."""
        say(text)
        self.publish({"event": "line", "text": text})

    def end(self, outcome: Event) -> None:
        """Tell all viewers how it ended."""
        self.publish({"event": "ended", "outcome": dict(outcome)})

    def orders(self) -> Iterator[Event]:
        """Yield the requests of viewers since the last call."""
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


class Attachment:
    """A connection to a running session; ``events`` holds its events, then ``gone``."""

    def __init__(self, connection: socket.socket) -> None:
        self._connection = connection
        self.events: SimpleQueue[Event] = SimpleQueue()
        Thread(target=self._read, name="session reader", daemon=True).start()

    def done(self, instruction: str) -> None:
        """Tell the session that a person has done what it asked for."""
        self._order(event="done", instruction=instruction)

    def stop(self) -> None:
        """Ask the session to cancel; its bag stays valid."""
        self._order(event="stop")

    def _order(self, **order: str) -> None:
        with suppress(OSError):  # the reader will notice that it is gone
            self._connection.sendall((json.dumps(order) + "\n").encode())

    def _read(self) -> None:
        with suppress(OSError, ValueError), self._connection.makefile("rb") as lines:
            for line in lines:
                self.events.put(json.loads(line))
        self.events.put({"event": "gone"})


def watch_session(folder: SessionFolder, *, stop: bool = False) -> Event:
    """Show a running session to its end, and return its event ``ended``.

    Enter confirms what a person was asked to do. Raises ConfigurationError when nothing runs
    there, DataError when the session dies meanwhile.
    """
    with _attached(folder) as session, progress_bar() as bar:
        display = ProgressDisplay(bar, deciles=-1)
        person = _person(folder, session)
        if stop:
            session.stop()
        while True:
            if person.is_done():
                session.done(person.instruction)
            with suppress(Empty):
                event = session.events.get(timeout=_POLL_S)
                if event["event"] == "ended":
                    return event
                _show(event, display, person, folder)


def running_sessions(place: Path) -> list[SessionFolder]:
    """Return the sessions below a folder that run; killed ones do not count."""
    found = sorted(path.parent for d in _DEPTHS for path in place.glob(f"{d}/{MEETING_POINT}"))
    return [folder for folder in map(SessionFolder, found) if _runs(folder)]


def _show(
    event: Event, display: ProgressDisplay, person: SessionOperator, folder: SessionFolder
) -> None:
    if event["event"] == "gone":
        _raise_gone(folder)
    if event["event"] in ("line", "page"):
        display.line(event["text"])
    display.line(person.receive(event))
    if event["event"] == "feedback":
        display.feedback(event)


def _raise_gone(folder: SessionFolder) -> NoReturn:
    if not folder.socket_file.exists():  # it ended while we came
        raise _nothing_runs(folder)
    raise DataError(f"the calibration in {folder.path} was killed; {_how_to_go_on(folder)}")


def _person(folder: SessionFolder, session: Attachment) -> SessionOperator:
    """Return the person who watches; the first event says how their work counts as done."""
    try:
        greeting = session.events.get(timeout=load_scaled_timeout(GREETING_TIMEOUT_S))
    except Empty:
        raise DataError(
            f"the calibration in {folder.path} does not answer; look at its logs there, and "
            "attach again"
        ) from None
    if greeting["event"] == "gone":
        _raise_gone(folder)
    configuration = read_configuration(folder.configuration)
    if configuration.simulated:
        say(NO_MACHINE)
    return SessionOperator(configuration, bool(greeting.get("at_once")), watching=True)


@contextmanager
def _attached(folder: SessionFolder) -> Iterator[Attachment]:
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as connection:
        _connect(connection, folder)
        yield Attachment(connection)


def _connect(connection: socket.socket, folder: SessionFolder) -> None:
    """Connect to the session of a folder; ConfigurationError says why that is impossible."""
    if not folder.configuration.is_file():
        raise ConfigurationError(
            f"{folder.path} holds no calibration: {folder.configuration.name} is missing; name "
            "the folder of a run"
        )
    try:
        connection.connect(_address(folder))
    except PermissionError:
        raise ConfigurationError(
            f"the calibration in {folder.path} belongs to another user: attach as that user"
        ) from None
    except (FileNotFoundError, ConnectionRefusedError):
        raise _nothing_runs(folder) from None


def _address(folder: SessionFolder) -> str:
    """Return the address of the socket; FileNotFoundError if there is none."""
    try:
        return str(load_json(read_text(folder.socket_file))["socket"])
    except (ValueError, TypeError, KeyError, NotAFileError):
        raise ConfigurationError(f"{folder.socket_file} names no socket: remove it") from None


def _runs(folder: SessionFolder) -> bool:
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as connection:
        try:
            _connect(connection, folder)
        except ConfigurationError:
            return False
    return True


def _nothing_runs(folder: SessionFolder) -> ConfigurationError:
    """Return the error of an attachment to a session that does not run, with its reason."""
    if folder.result.exists():
        return ConfigurationError(
            f"the calibration in {folder.path} is finished, see {folder.result}; "
            f"to look at it: rotcal report {folder.path}"
        )
    if _is_locked(folder):
        return ConfigurationError(
            f"a calibration still writes in {folder.path}, but no viewer can attach to it: its "
            "socket is gone; see its log, or wait for its end"
        )
    return ConfigurationError(
        f"no calibration runs in {folder.path}: it was interrupted; {_how_to_go_on(folder)}"
    )


def _is_locked(folder: SessionFolder) -> bool:
    try:
        FolderLock(folder.path).release()
    except (BagError, OSError):
        return True
    return False


def _how_to_go_on(folder: SessionFolder) -> str:
    return f"resume with: {resume_command(folder.path)}"
