"""Watching a calibration that runs in another process, and answering for the person there."""

from __future__ import annotations

import json
import socket
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from queue import Empty, SimpleQueue
from threading import Thread
from typing import Any, Final, NoReturn

from rotcal_ros.foundation.errors import BagError, ConfigurationError, DataError
from rotcal_ros.foundation.files import FolderLock
from rotcal_ros.foundation.machine_load import patient
from rotcal_ros.foundation.session_folder import MEETING_POINT, SessionFolder
from rotcal_ros.foundation.untrusted import NotAFileError, load_json, read_text
from rotcal_ros.methods import read_configuration
from rotcal_ros.report.terminal.console import progress_bar, say
from rotcal_ros.sessions.display import NO_MACHINE, Display
from rotcal_ros.sessions.person import Person

GREETING_TIMEOUT_S: Final = 10.0
_POLL_S: Final = 0.2
_DEPTHS: Final = ("*", "*/*")
"""Where sessions lie below a folder: those of 'rotcal verify' one deeper."""

Event = dict[str, Any]


class Attachment:
    """A connection to a running session; ``events`` holds what it says, then ``gone``."""

    def __init__(self, connection: socket.socket) -> None:
        self._connection = connection
        self.events: SimpleQueue[Event] = SimpleQueue()
        Thread(target=self._read, name="session reader", daemon=True).start()

    def done(self, instruction: str) -> None:
        """Let the session know that a person has done what it asked for."""
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


def watch(folder: SessionFolder, *, stop: bool = False) -> Event:
    """Show a running session to its end, and return its event ``ended``.

    Enter confirms what a person was asked to do. Raises ConfigurationError when nothing runs
    there, DataError when the session dies meanwhile.
    """
    with _attached(folder) as session, progress_bar() as bar:
        display = Display(bar, deciles=-1)
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


def _show(event: Event, display: Display, person: Person, folder: SessionFolder) -> None:
    if event["event"] == "gone":
        _raise_gone(folder)
    if event["event"] in ("line", "page"):
        display.line(event["text"])
    display.line(person.hear(event))
    if event["event"] == "feedback":
        display.feedback(event)


def _raise_gone(folder: SessionFolder) -> NoReturn:
    if not folder.meeting_point.exists():  # it ended while we came
        raise ConfigurationError(_why_nothing_runs(folder))
    raise DataError(f"the calibration in {folder.path} was killed; {_how_to_go_on(folder)}")


def _person(folder: SessionFolder, session: Attachment) -> Person:
    """Return the person who watches; how their work counts as done, the first event says."""
    try:
        greeting = session.events.get(timeout=patient(GREETING_TIMEOUT_S))
    except Empty:
        raise DataError(f"the calibration in {folder.path} does not answer") from None
    if greeting["event"] == "gone":
        _raise_gone(folder)
    configuration = read_configuration(folder.configuration)
    if configuration.simulated:
        say(NO_MACHINE)
    return Person(configuration, bool(greeting.get("at_once")), watching=True)


@contextmanager
def _attached(folder: SessionFolder) -> Iterator[Attachment]:
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as connection:
        _connect(connection, folder)
        yield Attachment(connection)


def _connect(connection: socket.socket, folder: SessionFolder) -> None:
    """Connect to the session of a folder; ConfigurationError says why that is impossible."""
    if not folder.configuration.is_file():
        raise ConfigurationError(
            f"{folder.path} holds no calibration: {folder.configuration.name} is missing"
        )
    try:
        connection.connect(_address(folder))
    except PermissionError:
        raise ConfigurationError(
            f"the calibration in {folder.path} belongs to another user; only that user may attach"
        ) from None
    except (FileNotFoundError, ConnectionRefusedError):
        raise ConfigurationError(_why_nothing_runs(folder)) from None


def _address(folder: SessionFolder) -> str:
    """Return the address of the socket; FileNotFoundError where there is none."""
    try:
        return str(load_json(read_text(folder.meeting_point))["socket"])
    except (ValueError, TypeError, KeyError, NotAFileError):
        raise ConfigurationError(f"{folder.meeting_point} names no socket: remove it") from None


def _runs(folder: SessionFolder) -> bool:
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as connection:
        try:
            _connect(connection, folder)
        except ConfigurationError:
            return False
    return True


def _why_nothing_runs(folder: SessionFolder) -> str:
    if folder.result.exists():
        return (
            f"the calibration in {folder.path} is finished, see {folder.result}; "
            f"to look at it: rotcal report {folder.path}"
        )
    if _is_locked(folder):
        return (
            f"a calibration still writes in {folder.path}, but it cannot be attached to: its "
            "socket is gone; see its log, or wait for its end"
        )
    return f"no calibration runs in {folder.path}, it was interrupted; {_how_to_go_on(folder)}"


def _is_locked(folder: SessionFolder) -> bool:
    try:
        FolderLock(folder.path).release()
    except (BagError, OSError):
        return True
    return False


def _how_to_go_on(folder: SessionFolder) -> str:
    return f"go on with: rotcal run {folder.configuration} --resume {folder.path}"
