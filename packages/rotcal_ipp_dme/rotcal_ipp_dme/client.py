"""A measuring machine with a rotary table behind I++ DME, in SI.

After an error nothing more is sent until a person has it cleared: neither ClearAllErrors nor a new
session, which clears errors too, is ordered by a program. One thread reads; whoever orders waits
for the answer, never without a limit.

Version 1.4 has one way to turn the table of every machine, AlignPart: a vector of the part is
turned to a vector of the machine (12.1). Later versions take R in a GoTo. Neither states from
which side the table comes: two turns achieve that.
"""

from __future__ import annotations

import re
import socket
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from math import cos, pi, radians, remainder, sin
from threading import Condition, Lock, Thread
from typing import Final, NoReturn

from rotcal_ipp_dme.protocol import (
    END,
    UNASKED,
    AnswerMissingError,
    Call,
    CommandLine,
    ConnectionLostError,
    DmeError,
    DmeFault,
    LineBuffer,
    NotClearedError,
    ProtocolError,
    RefusedError,
    ResponseKind,
    ResponseLine,
    TagCounter,
    Word,
    calls_by_name,
    make_call,
    parse_response,
    parse_values,
)
from rotcal_ipp_dme.settings import ALIGN_PART, AUTO, GOTO_R, DmeSettings
from rotcal_ros.foundation.observations import Approach, TableSample
from rotcal_ros.foundation.units import DEGREE, MILLIMETRE
from rotcal_ros.planning.approach import approach_angles
from rotcal_ros.planning.plan import Point
from rotcal_ros.planning.table_feedback import TableSpeed

NOT_STARTED: Final = "no session was started"
FIRST_DISTANCE_MM: Final = 1000.0
"""Distance between reports of a moving machine: so long that only the time counts."""
SHORTEST_PERIOD_S: Final = 0.1
"""The specification forbids more than ten reports in a second."""
RADIUS: Final = "Tool.AvrRadius"
POLLS: Final = 4
"""Number of questions for the position while the machine settles."""


class DmeClient:
    """One session with a DME server.

    ``blocked`` says why nothing is sent; empty: all is well. Several threads call ``hear(feedback,
    position)`` for every report, with the table's feedback (None: not known yet) and the tip's
    position (m), and ``warn(fault)`` for errors that stop nothing or that belong to no command.
    One thread calls all methods but :meth:`abort` and :meth:`close`.
    """

    def __init__(
        self,
        settings: DmeSettings,
        hear: Callable[[TableSample | None, Point], None],
        warn: Callable[[DmeFault], None],
        now_ns: Callable[[], int] = time.time_ns,
    ) -> None:
        self.settings = settings
        self.blocked = NOT_STARTED
        self.version, self.tip_radius = "", settings.tip_radius_m
        self._hear, self._warn, self._now_ns = hear, warn, now_ns
        self._link: DmeLink | None = None
        self._axis = TableAxis(settings, settings.turn_by)
        self._speed, self._telling = TableSpeed(settings.settle_s), Lock()
        self._angle, self._begun = 0.0, False
        self._turned: tuple[float, Approach] | None = None

    def start(self) -> None:
        """Connect and begin a session, on behalf of a person.

        Raises DmeError, after which the session is blocked.
        """
        self._drop()
        self.blocked, self._begun, self._turned = "", False, None
        try:
            self._begin()
        except DmeError as error:
            self._fail(error)
        self._begun = True

    def close(self) -> None:
        """End the session in good order; errors of that do not matter."""
        if self._link is not None and not self.blocked:
            with suppress(DmeError):
                self._do(make_call("EndSession"))
        self.blocked = self.blocked or NOT_STARTED
        self._drop()

    def where(self) -> MachinePosition:
        """Ask where the machine stands."""
        return self._standing(make_call("Get", *REPORTED), self.settings.reply_timeout_s)

    def go(self, x: float | None, y: float | None, z: float | None) -> None:
        """Move the tip in a straight line, m; None leaves a coordinate as it is."""
        axes = (("X", x), ("Y", y), ("Z", z))
        ways = [Call(name, (to / MILLIMETRE,)) for name, to in axes if to is not None]
        self._do(make_call("GoTo", *ways), self.settings.motion_timeout_s)

    def turn(self, angle: float, approach: Approach, given_up: Callable[[], bool]) -> bool:
        """Turn the table to ``angle`` (rad) from a side, unless it stands there already.

        False: somebody has ``given_up`` before one of its motions, and it stands elsewhere.
        """
        if self._turned == (angle, approach):
            return True
        self._turned = None
        here = self._axis.angle(self.where().r_deg, self._angle)
        for stop in self._axis.stops(here, angle, approach):
            if given_up():
                return False
            self._angle = stop
            self._do(self._axis.turn(stop), self.settings.motion_timeout_s)
        with self._telling:
            self._speed.restart()
        arrived = self._axis.angle(self.where().r_deg, angle)
        try:
            self._axis.check_arrival(arrived, angle)
        except DmeError as error:
            self._fail(error)
        self._turned = (angle, approach)
        return True

    def settle(self) -> None:
        """Wait until machine and table have come to rest, and hear where they stand meanwhile."""
        for _ in range(POLLS):
            time.sleep(self.settings.settle_s / POLLS)
            self.where()

    def touch(self, nominal: Point, direction: Point) -> tuple[int, Point]:
        """Touch a surface; return when that was reported and the centre of the tip (m)."""
        axes = zip(("X", "Y", "Z"), nominal, strict=True)
        place = [Call(name, (value / MILLIMETRE,)) for name, value in axes]
        order = make_call("PtMeas", *place, Call("IJK", direction))
        standing = self._standing(order, self.settings.motion_timeout_s)
        return self._now_ns(), standing.position

    def abort(self, why: str) -> None:
        """Stop all motion with AbortE, from any thread; a person goes on with :meth:`clear`.

        A blocked session gets it too: what blocked it need not have stopped a motion.
        """
        link = self._link
        self.blocked = self.blocked or why
        if link is not None and not link.broken:
            link.run(make_call("AbortE"), link.reply_timeout_s, event=True)

    def clear(self) -> None:
        """Go on after an error, on behalf of a person who has seen why.

        A live session gets ClearAllErrors, else a new one begins, also if the start failed. Raises
        DmeError if that fails; then the next call begins a new session.
        """
        link, self._turned = self._link, None
        if link is None or link.broken or not self._begun:
            self.start()
            return
        self.blocked = ""
        try:
            self._do(make_call("ClearAllErrors"))
            self.where()
        except DmeError:
            self._drop()
            raise

    def _begin(self) -> None:
        """Connect, and send all that a session needs; a DmeError leaves it half begun."""
        s = self.settings
        self._link = DmeLink(s.host, s.port, s.reply_timeout_s, self._report, self._concern)
        self._do(make_call("EndSession"))  # what a lost connection left open, see 6.3.1 of 1.4.3
        self._do(make_call("StartSession"))
        self._axis = TableAxis(s, self._way_to_turn())
        if not self._is_homed():
            if not s.home:
                raise DmeError("the machine is not homed: home it, or set dme.home")
            self._do(make_call("Home"), s.motion_timeout_s)
        self._take_tool()
        self._do(make_call("SetCoordSystem", Word(s.coordinate_system)))
        self._do(make_call("OnPtMeasReport", *REPORTED))
        if s.report_period_s:
            period_s = max(s.report_period_s, SHORTEST_PERIOD_S)
            period = (make_call("Time", period_s), make_call("Dis", FIRST_DISTANCE_MM))
            self._do(make_call("OnMoveReportE", *period, *REPORTED), event=True)
        self.where()

    def _way_to_turn(self) -> str:
        """Return how the table is turned; the server is asked for its version if it matters."""
        if self.settings.turn_by != AUTO:
            return self.settings.turn_by
        answer = self._properties(make_call("GetDMEVersion")).get("DMEVersion", Call(""))
        self.version = "".join(str(argument) for argument in answer.arguments)
        return table_turn_method(self.version)

    def _take_tool(self) -> None:
        """Change to the tool, set how it probes if that can be set, and learn its radius."""
        s = self.settings
        if s.tool:
            tools = [line.strip().strip('"') for line in self._do(make_call("EnumTools"))]
            if s.tool not in tools:
                raise DmeError(f"no tool {s.tool!r}; the machine has {', '.join(tools) or 'none'}")
            self._do(make_call("ChangeTool", s.tool), s.motion_timeout_s)
        known = "\n".join(self._do(make_call("EnumAllProp", Call("Tool"))))
        wanted = {"Approach": s.approach_m, "Search": s.search_m}
        given = [
            Call(f"Tool.PtMeasPar.{name}", (value / MILLIMETRE,))
            for name, value in wanted.items()
            if name in known
        ]
        if given:
            self._do(make_call("SetProp", *given))
        if not s.tip_radius_m:
            properties = self._properties(make_call("GetProp", Call(RADIUS)))
            if RADIUS not in properties:
                raise DmeError(f"the server does not state {RADIUS}: set dme.tip_radius_m")
            self.tip_radius = properties[RADIUS].number() * MILLIMETRE
            if self.tip_radius <= 0.0:
                raise DmeError(f"the server states {properties[RADIUS]}: set dme.tip_radius_m")

    def _is_homed(self) -> bool:
        answer = self._properties(make_call("IsHomed")).get("IsHomed")
        return answer is None or answer.number() != 0.0

    def _properties(self, question: Call) -> dict[str, Call]:
        """Return what the server answers, by name."""
        data = self._do(question)
        try:
            return calls_by_name(value for line in data for value in parse_values(line))
        except DmeError as error:
            self._fail(error)

    def _standing(self, order: Call, limit_s: float) -> MachinePosition:
        """Run a call that reports where the machine stands."""
        data = self._do(order, limit_s)
        try:
            standing = parse_position_report(data, str(order))
        except DmeError as error:
            self._fail(error)
        self._tell(standing)
        return standing

    def _do(self, order: Call, limit_s: float | None = None, *, event: bool = False) -> list[str]:
        """Run a call; whatever goes wrong blocks the session."""
        if self.blocked or self._link is None:
            raise NotClearedError(
                f"{order.name} is not sent before a person clears the error: {self.blocked}"
            )
        try:
            limit_s = self.settings.reply_timeout_s if limit_s is None else limit_s
            return self._link.run(order, limit_s, event=event)
        except AnswerMissingError as error:
            self._fail(AnswerMissingError(f"{error}; {self._stopped(self._link)}"))
        except DmeError as error:
            self._fail(error)

    def _stopped(self, link: DmeLink) -> str:
        """Stop a machine that does not answer; return the outcome in words."""
        try:
            link.run(make_call("AbortE"), link.reply_timeout_s, event=True)
        except DmeError:
            return "AbortE was not answered either"
        return "AbortE was obeyed"

    def _fail(self, error: DmeError) -> NoReturn:
        """Block the session for the first reason."""
        self.blocked = self.blocked or str(error)
        raise error

    def _drop(self) -> None:
        link, self._link = self._link, None
        if link is not None:
            link.close()

    def _report(self, tag: str, text: str) -> None:
        """Take what a daemon reports; other events (keys, points by hand) mean nothing here."""
        if tag != "E0000":
            self._tell(parse_position(text, "OnMoveReportE"))

    def _concern(self, fault: DmeFault) -> None:
        """Take an error that answers no command, or that stops nothing."""
        if fault.stops:
            self.blocked = self.blocked or f"the server reports, unasked: {fault}"
        self._warn(fault)

    def _tell(self, standing: MachinePosition) -> None:
        with self._telling:
            angle = self._axis.angle(standing.r_deg, self._angle)
            feedback = self._speed.feed(self._now_ns(), angle)
        self._hear(feedback, standing.position)


REPORTED: Final = tuple(Call(name) for name in ("X", "Y", "Z", "R"))
"""What the machine is asked to report, of itself and with every point."""


@dataclass(frozen=True, slots=True)
class MachinePosition:
    """Where the tip is (m, machine frame), and the table's R in degrees."""

    position: Point
    r_deg: float


def parse_position_report(data: Sequence[str], asked_by: str) -> MachinePosition:
    """Return the one report among the data lines; ProtocolError when it is not there."""
    if len(data) != 1:
        raise ProtocolError(f"{asked_by}: expected one line of data, found {len(data)}")
    return parse_position(data[0], asked_by)


def parse_position(text: str, asked_by: str) -> MachinePosition:
    """Return the report in a data line; ProtocolError when it lacks X, Y, Z or R."""
    found = calls_by_name(parse_values(text))
    missing = [asked.name for asked in REPORTED if asked.name not in found]
    if missing:
        raise ProtocolError(f"{asked_by}: no {', '.join(missing)} in {text!r:.200}")
    x, y, z, r_deg = (found[asked.name].number() for asked in REPORTED)
    return MachinePosition((x * MILLIMETRE, y * MILLIMETRE, z * MILLIMETRE), r_deg)


FIRST_WITH_R: Final = 2
"""Major version from which R is an ordinary argument of GoTo."""
FAR_OFF_DEG: Final = 1.0
"""A table that is farther from its order than this has misunderstood it."""


def table_turn_method(version: str) -> str:
    """Return how a server of this version turns its table; DmeError if unreadable."""
    found = re.match(r"\s*(\d+)(\.|$)", version)
    if found is None:
        raise DmeError(
            f"the server states its version as {version!r:.40}: set dme.turn_by to {GOTO_R} or "
            f"{ALIGN_PART}"
        )
    return GOTO_R if int(found[1]) >= FIRST_WITH_R else ALIGN_PART


@dataclass(frozen=True)
class TableAxis:
    """Turns table angles (rad, counter-clockwise about +z) into calls, and R into angles."""

    settings: DmeSettings
    turn_by: str

    @property
    def _sign(self) -> float:
        return -1.0 if self.settings.table_reversed else 1.0

    def angle(self, r_deg: float, near: float) -> float:
        """Return the angle (rad) of the table at R, in the turn nearest to ``near``."""
        found = radians(self._sign * (r_deg - self.settings.table_zero_deg))
        return near + remainder(found - near, 2.0 * pi)

    def turn(self, angle: float) -> Call:
        """Return the call that turns the table to ``angle`` (rad)."""
        if self.turn_by == GOTO_R:
            r_deg = self.settings.table_zero_deg + self._sign * angle / DEGREE
            return make_call("GoTo", Call("R", (r_deg,)))
        turned = self._sign * angle + radians(self.settings.table_zero_deg)
        return make_call("AlignPart", 1.0, 0.0, 0.0, cos(turned), sin(turned), 0.0, 0.0)

    def stops(self, here: float, angle: float, approach: Approach) -> Sequence[float]:
        """Return the angles (rad) to go to, so that ``angle`` is reached from side ``approach``.

        AlignPart goes the shorter way round: none of its turns is longer than a third of a circle.
        """
        way = approach_angles(here, angle, approach, self.settings.overshoot_deg * DEGREE)
        if self.turn_by == ALIGN_PART:
            return [*_in_thirds(here, way[0]), *way[1:]]
        return list(way)

    def check_arrival(self, angle: float, ordered: float) -> None:
        """Raise DmeError when the table is somewhere else than ordered (rad)."""
        off_deg = remainder(angle - ordered, 2.0 * pi) / DEGREE
        if abs(off_deg) > FAR_OFF_DEG:
            raise DmeError(
                f"the table was sent to {ordered / DEGREE:.3f} deg and stands {off_deg:+.3f} deg "
                f"from there: see dme.table_zero_deg, dme.table_reversed and dme.turn_by (now "
                f"{self.turn_by}), and that the part's coordinates are those of the table"
            )


def _in_thirds(here: float, angle: float) -> list[float]:
    """Return angles on the way that are at most a third of a circle apart."""
    count = int(abs(angle - here) // (2.0 * pi / 3.0)) + 1
    return [here + (angle - here) * part / count for part in range(1, count)] + [angle]


RECEIVED: Final = 65_536
MOST_DATA: Final = 10_000
"""Data lines of one command."""
LONG_TEXT: Final = 120


@dataclass
class _Transaction:
    """A command on its way, and what came back so far."""

    command: CommandLine
    accepted: bool = False
    done: bool = False
    data: list[str] = field(default_factory=list)
    faults: list[DmeFault] = field(default_factory=list)

    @property
    def stopped(self) -> bool:
        return any(fault.stops for fault in self.faults)

    def take(self, response: ResponseLine) -> None:
        match response.kind:
            case ResponseKind.ACCEPTED:
                self.accepted = True
            case ResponseKind.DONE:
                self.done = True
            case ResponseKind.ERROR:
                self.faults.append(response.fault())
            case ResponseKind.DATA:
                if len(self.data) >= MOST_DATA:
                    raise ProtocolError(f"more than {MOST_DATA} data lines for one command")
                self.data.append(response.text)


class DmeLink:
    """A connection to a DME server.

    ``on_report(tag, text)`` gets the data of daemons and unasked reports of the server (tag
    E0000), ``on_warning(fault)`` errors that stop nothing or belong to no command; the reading
    thread calls both. Raises ConnectionLostError when no server answers at ``host``.
    """

    def __init__(
        self,
        host: str,
        port: int,
        reply_timeout_s: float,
        on_report: Callable[[str, str], None],
        on_warning: Callable[[DmeFault], None],
    ) -> None:
        self.address, self.reply_timeout_s = f"{host}:{port}", reply_timeout_s
        self._on_report, self._on_warning = on_report, on_warning
        self._tags, self._lines = TagCounter(), LineBuffer()
        self._pending: dict[str, _Transaction] = {}
        self._changed, self._sending = Condition(), Lock()
        self.broken = ""
        try:
            self._socket = socket.create_connection((host, port), reply_timeout_s)
        except OSError as error:
            why = error.strerror or str(error)
            raise ConnectionLostError(
                f"no DME server answers at {self.address}: {why}; start it, or correct dme.host "
                "and dme.port"
            ) from error
        # A computer that was switched off says no goodbye: keep-alive notices in the end.
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        # Commands are short, and an abort must not wait until a packet is full.
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._reader = Thread(target=self._read, name="DME reader", daemon=True)
        self._reader.start()

    def run(self, order: Call, timeout_s: float, *, event: bool = False) -> list[str]:
        """Order and wait until it is done; return its data lines.

        ``event`` sends it through the fast queue. Raises RefusedError for an error that stops
        the server, AnswerMissingError, ConnectionLostError, ProtocolError.
        """
        tag = self._tags.event() if event else self._tags.command()
        transaction = _Transaction(CommandLine(tag, order))
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
        """Close the connection; threads that wait for an answer get an error."""
        self._break("it was closed here")
        self._reader.join(self.reply_timeout_s)

    def _send(self, command: CommandLine) -> None:
        # Two threads send, orders and aborts: each line must go out whole.
        line = str(command).encode("ascii") + END
        try:
            with self._sending:
                self._socket.sendall(line)
        except OSError as error:
            self._break(error.strerror or str(error))
            raise self._lost(command) from error

    def _await(self, transaction: _Transaction, limit_s: float, what: str, until: str) -> None:
        """Wait until the transaction is ``until`` (accepted, done) or has failed.

        A command that failed gets only the reply time to end.
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

    def _lost(self, command: CommandLine) -> DmeError:
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
        """Stop a machine whose answers cannot be read; it may still listen."""
        with suppress(DmeError):
            self._send(CommandLine(self._tags.event(), make_call("AbortE")))

    def _receive(self) -> bytes:
        """Return what came, nothing at the end; the socket's time limit is for sending only."""
        while True:
            with suppress(TimeoutError):
                return self._socket.recv(RECEIVED)

    def _take(self, response: ResponseLine) -> None:
        """Give a response to its command; an answer that came too late is ignored."""
        with self._changed:
            transaction = self._pending.get(response.tag)
            if transaction is not None:
                transaction.take(response)
                self._changed.notify_all()
                return
        # Daemons report with the tag of the event that started them, long after its transaction.
        if response.kind is ResponseKind.DATA and response.tag.startswith("E"):
            self._on_report(response.tag, response.text)
        elif response.kind is ResponseKind.ERROR and response.tag == UNASKED:
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
