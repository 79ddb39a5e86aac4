"""The client's end of a DME connection: commands go out, responses find their command.

One thread reads. Whoever orders waits for the answer, never without a limit, and what ends the
wait is a sentence that names the command.
"""

from __future__ import annotations

import socket
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from threading import Condition, Lock, Thread
from typing import Final

from rotcal_ros.extensions.ipp_dme.faults import (
    AnswerMissingError,
    ConnectionLostError,
    DmeError,
    Fault,
    ProtocolError,
    RefusedError,
)
from rotcal_ros.extensions.ipp_dme.grammar import Call, call
from rotcal_ros.extensions.ipp_dme.lines import (
    END,
    UNASKED,
    Command,
    Kind,
    LineBuffer,
    Response,
    Tags,
    parse_response,
)

RECEIVED: Final = 65_536
MOST_DATA: Final = 10_000
"""Data lines of one command."""
LONG_TEXT: Final = 120


@dataclass
class _Transaction:
    """A command on its way, and what came back so far."""

    command: Command
    accepted: bool = False
    done: bool = False
    data: list[str] = field(default_factory=list)
    faults: list[Fault] = field(default_factory=list)

    @property
    def stopped(self) -> bool:
        return any(fault.stops for fault in self.faults)

    def take(self, response: Response) -> None:
        match response.kind:
            case Kind.ACCEPTED:
                self.accepted = True
            case Kind.DONE:
                self.done = True
            case Kind.ERROR:
                self.faults.append(response.fault())
            case Kind.DATA:
                if len(self.data) >= MOST_DATA:
                    raise ProtocolError(f"more than {MOST_DATA} data lines for one command")
                self.data.append(response.text)


class DmeLink:
    """A connection to a DME server.

    ``on_report(tag, text)`` hears the data of daemons and what the server tells by itself (tag
    E0000), ``on_warning(fault)`` errors that stop nothing and errors that nobody asked for; both
    are called by the reading thread. Raises ConnectionLostError when nobody answers at ``host``.
    """

    def __init__(
        self,
        host: str,
        port: int,
        reply_timeout_s: float,
        on_report: Callable[[str, str], None],
        on_warning: Callable[[Fault], None],
    ) -> None:
        self.address, self.reply_timeout_s = f"{host}:{port}", reply_timeout_s
        self._on_report, self._on_warning = on_report, on_warning
        self._tags, self._lines = Tags(), LineBuffer()
        self._pending: dict[str, _Transaction] = {}
        self._changed, self._sending = Condition(), Lock()
        self.broken = ""
        try:
            self._socket = socket.create_connection((host, port), reply_timeout_s)
        except OSError as error:
            why = error.strerror or str(error)
            raise ConnectionLostError(f"no DME server answers at {self.address}: {why}") from error
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._reader = Thread(target=self._read, name="DME reader", daemon=True)
        self._reader.start()

    def run(self, order: Call, timeout_s: float, *, event: bool = False) -> list[str]:
        """Order and wait until it is done; return its data lines.

        ``event`` sends it through the fast queue. Raises RefusedError for an error that stops
        the server, AnswerMissingError, ConnectionLostError, ProtocolError.
        """
        tag = self._tags.event() if event else self._tags.command()
        transaction = _Transaction(Command(tag, order))
        with self._changed:
            self._pending[tag] = transaction
        try:
            self._send(transaction.command)
            self._await(transaction, self.reply_timeout_s, "not acknowledged", "accepted")
            if transaction.accepted:
                self._await(transaction, timeout_s, "not done", "done")
        finally:
            with self._changed:
                self._pending.pop(tag, None)
        if transaction.stopped:
            words = "; ".join(str(fault) for fault in transaction.faults)
            raise RefusedError(f"{_short(order)}: {words}", tuple(transaction.faults))
        for fault in transaction.faults:
            self._on_warning(fault)
        return transaction.data

    def close(self) -> None:
        """Close the connection; who still waits for an answer hears of it."""
        self._break("it was closed here")
        self._reader.join(self.reply_timeout_s)

    def _send(self, command: Command) -> None:
        line = str(command).encode("ascii") + END
        try:
            with self._sending:
                self._socket.sendall(line)
        except OSError as error:
            self._break(error.strerror or str(error))
            raise self._lost(command) from error

    def _await(self, transaction: _Transaction, limit_s: float, what: str, until: str) -> None:
        """Wait until the transaction is ``until`` (accepted, done) or has failed.

        A command that an error has ended is given the reply time for its end, no more.
        """
        deadline = time.monotonic() + limit_s
        with self._changed:
            while not (getattr(transaction, until) or transaction.done):
                if self.broken:
                    raise self._lost(transaction.command)
                now = time.monotonic()
                if transaction.stopped:
                    deadline = min(deadline, now + self.reply_timeout_s)
                if now >= deadline and transaction.stopped:
                    return
                if now >= deadline:
                    raise AnswerMissingError(
                        f"{_short(transaction.command.call)}: {what} by {self.address} within "
                        f"{limit_s:g} s"
                    )
                self._changed.wait(deadline - now)

    def _lost(self, command: Command) -> DmeError:
        return ConnectionLostError(
            f"{_short(command.call)}: the connection to {self.address} is lost: {self.broken}"
        )

    def _read(self) -> None:
        """Take lines until the connection ends, by whatever it is."""
        why = "the server closed it"
        try:
            while received := self._receive():
                for line in self._lines.feed(received):
                    self._take(parse_response(line))
            if self._lines.rest:
                why += f" in the middle of the line {self._lines.rest!r:.80}"
        except OSError as error:
            why = error.strerror or str(error)
        except DmeError as error:
            why = str(error)
            self._abort()
        self._break(why)

    def _abort(self) -> None:
        """Stop a machine whose answers cannot be read; it may hear still."""
        with suppress(DmeError):
            self._send(Command(self._tags.event(), call("AbortE")))

    def _receive(self) -> bytes:
        """Return what came, nothing at the end; the socket's time limit is for sending alone."""
        while True:
            with suppress(TimeoutError):
                return self._socket.recv(RECEIVED)

    def _take(self, response: Response) -> None:
        """Give a response to its command; an answer that came too late to matter is left."""
        with self._changed:
            transaction = self._pending.get(response.tag)
            if transaction is not None:
                transaction.take(response)
                self._changed.notify_all()
                return
        if response.kind is Kind.DATA and response.tag.startswith("E"):
            self._on_report(response.tag, response.text)
        elif response.kind is Kind.ERROR and response.tag == UNASKED:
            self._on_warning(response.fault())

    def _break(self, why: str) -> None:
        with self._changed:
            self.broken = self.broken or why
            self._changed.notify_all()
        with suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)
        self._socket.close()


def _short(order: Call) -> str:
    text = str(order)
    return text if len(text) <= LONG_TEXT else f"{text[:LONG_TEXT]}..."
