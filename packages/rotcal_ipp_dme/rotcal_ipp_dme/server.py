"""A DME server over TCP for the simulated machine: one client at a time, ours or another.

Commands wait in a queue and are done in their order; those of the fast queue, whose names end with
E, at once. An error of severity 2 or more ends all pending commands, and nothing else is done
before ClearAllErrors. Source: I++ DME 1.4.3, 6.2, 6.3 and 12.

The machine is the physics that the simulated cell drives by orders of the suite; only who leads
the tip around a ball is another one.
"""

from __future__ import annotations

import asyncio
import time
from collections import deque
from collections.abc import Awaitable, Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from math import atan2, pi, remainder
from threading import Event, Thread
from typing import Final

import numpy as np

from rotcal_ipp_dme.protocol import (
    END,
    KNOWN,
    UNASKED,
    Call,
    CommandLine,
    DmeError,
    DmeFault,
    LineBuffer,
    ProtocolError,
    ResponseKind,
    ResponseLine,
    Value,
    Word,
    calls_by_name,
    error_line,
    format_value,
    is_tag,
    make_call,
    parse_call,
)
from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.errors import ConfigurationError, ControllerError
from rotcal_ros.foundation.observations import Approach
from rotcal_ros.foundation.units import DEGREE, MILLIMETRE, NANOSECOND
from rotcal_ros.methods.simulation.cell import SimulatedCell

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
        """Serve until cancelled; ControllerError if the port is not available."""
        try:
            server = await asyncio.start_server(self._converse, self.host, self.port)
        except OSError as error:
            why = error.strerror or str(error)
            raise ControllerError(
                f"cannot listen at {self.host}:{self.port}: {why}; choose another address or port"
            ) from error
        self.port = server.sockets[0].getsockname()[1]
        listening()
        async with server:
            await server.serve_forever()

    async def _converse(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Serve a client, unless there already is one."""
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

        conversation = ServerSession(DmeMethods(self.machine, self.version), write)
        try:
            while received := await reader.read(RECEIVED):
                conversation.take(received)
        except ProtocolError:
            write(str(error_line(UNASKED, DmeFault.known(7, "Server"))).encode() + END)
        except (OSError, asyncio.CancelledError):
            pass  # the client is gone, or this server is ended
        finally:
            await conversation.end()
            writer.close()


@contextmanager
def serve_in_thread(server: DmeServer) -> Iterator[DmeServer]:
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
"""Methods that are allowed even after an error."""
WITHOUT_SESSION: Final = ("StartSession", "EndSession")


class ServerSession:
    """Lines in by :meth:`take`, lines out through ``write``; ends with :meth:`end`."""

    def __init__(self, methods: DmeMethods, write: Callable[[bytes], None]) -> None:
        self._methods, self._write = methods, write
        self._lines = LineBuffer()
        self._session, self._in_error, self._ending = False, False, False
        self._waiting: deque[CommandLine] = deque()
        self._current: asyncio.Task[list[str]] | None = None
        self._wake = asyncio.Event()
        self._daemons: dict[str, asyncio.Task[None]] = {}
        self._worker = asyncio.create_task(self._work())

    def take(self, received: bytes) -> None:
        """Take received bytes; ProtocolError if they cannot be lines of this protocol."""
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
            self._say(error_line(UNASKED, DmeFault.known(1, "Server")))
            return
        if line[5:6] != " ":
            self._refuse(tag, DmeFault.known(2, "Server"))
            return
        try:
            order = parse_call(line[6:])
        except ProtocolError:
            self._refuse(tag, DmeFault.known(507, "Server"))
            return
        if tag.startswith("E") != order.name.endswith("E"):
            self._refuse(tag, DmeFault.known(1, order.name))
        elif tag.startswith("E"):
            self._do_at_once(tag, order)
        elif len(self._waiting) >= MOST_PENDING:
            self._refuse(tag, DmeFault.known(8, order.name))
        else:
            self._say(ResponseLine(tag, ResponseKind.ACCEPTED))
            self._waiting.append(CommandLine(tag, order))
            self._wake.set()

    async def _work(self) -> None:
        """Carry out the waiting commands, one after the other."""
        while True:
            while self._waiting:
                await self._do(self._waiting.popleft())
            self._wake.clear()
            await self._wake.wait()

    async def _do(self, command: CommandLine) -> None:
        tag, order = command.tag, command.call
        self._current = asyncio.create_task(self._answer(order))
        try:
            for line in await self._current:
                self._say(ResponseLine(tag, ResponseKind.DATA, line))
            for fault in self._methods.warnings:
                self._say(error_line(tag, fault))
        except MethodError as refused:
            self._fail(tag, refused.fault)
        except asyncio.CancelledError:
            if self._ending:
                raise
            self._methods.machine.stop()
            self._say(error_line(tag, DmeFault.known(6, order.name)))
        except Exception:  # whatever a foreign command does, the client hears of it
            self._fail(tag, DmeFault.known(511, order.name))
        finally:
            self._current = None
            self._methods.warnings.clear()
        self._say(ResponseLine(tag, ResponseKind.DONE))

    async def _answer(self, order: Call) -> list[str]:
        """Carry out a command if the state allows it, and return its data."""
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
                return [format_value(value) for value in self._status()]
            case "StopDaemon":
                return self._stop_daemon(order)
            case "StopAllDaemons":
                if not self._daemons:
                    self._methods.warnings.append(DmeFault.known(512, order.name))
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
        return [
            make_call("IsHomed", int(machine.homed)),
            make_call("ErrStatus", int(self._in_error)),
        ]

    def _do_at_once(self, tag: str, order: Call) -> None:
        """Do a command of the fast queue."""
        self._say(ResponseLine(tag, ResponseKind.ACCEPTED))
        try:
            if not self._session:
                raise MethodError(8, order.name)
            match order.name:
                case "AbortE":
                    asyncio.get_running_loop().create_task(self._abort(tag))
                    return
                case "GetErrStatusE":
                    answer = make_call("ErrStatus", int(self._in_error))
                    self._say(ResponseLine(tag, ResponseKind.DATA, format_value(answer)))
                case "OnMoveReportE":
                    self._start_daemon(tag, order)
                case _:
                    raise MethodError(501, order.name)
        except MethodError as refused:
            self._fail(tag, refused.fault)
        except ProtocolError:
            self._fail(tag, DmeFault.known(509, order.name))
        self._say(ResponseLine(tag, ResponseKind.DONE))

    async def _abort(self, tag: str) -> None:
        """End running and waiting commands, then report that."""
        self._in_error = True
        waiting, current = list(self._waiting), self._current
        self._waiting.clear()
        if current is not None:
            current.cancel()
            with suppress(asyncio.CancelledError, MethodError):
                await current
            await asyncio.sleep(0)  # the worker reports it first
        self._say_aborted(waiting)
        self._say(ResponseLine(tag, ResponseKind.DONE))

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
        self._methods.standing(positions, order.name)  # MethodError when it cannot be reported
        self._daemons[tag] = asyncio.create_task(self._report(tag, period_s, positions))

    async def _report(self, tag: str, period_s: float, positions: list[Call]) -> None:
        """Say where the machine is, again and again while it moves."""
        while True:
            await asyncio.sleep(period_s)
            if self._methods.machine.moving:
                standing = self._methods.standing(positions, "OnMoveReportE")
                self._say(ResponseLine(tag, ResponseKind.DATA, standing))

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

    def _fail(self, tag: str, fault: DmeFault) -> None:
        """Report an error; one that stops ends what waits as well."""
        self._say(error_line(tag, fault))
        if fault.stops and self._session:
            self._in_error = True
            self._say_aborted(list(self._waiting))
            self._waiting.clear()

    def _say_aborted(self, commands: list[CommandLine]) -> None:
        for command in commands:
            self._say(error_line(command.tag, DmeFault.known(6, command.call.name)))
            self._say(ResponseLine(command.tag, ResponseKind.DONE))

    def _refuse(self, tag: str, fault: DmeFault) -> None:
        """Answer a line that is not a command."""
        self._fail(tag, fault)
        self._say(ResponseLine(tag, ResponseKind.DONE))

    def _say(self, response: ResponseLine) -> None:
        self._write(str(response).encode("ascii") + END)


TOOLS: Final = ("RefTool", "NoTool", "Probe1")
AXES: Final = ("X", "Y", "Z")
PROBING: Final = {"Approach": "approach", "Search": "search", "Retract": "retract"}
"""Parameter of Tool.PtMeasPar -> the machine's name for it."""
RANGES: Final = {"Approach": (0.0, 100.0), "Search": (0.0, 100.0), "Retract": (-1.0, 100.0)}
PROBING_PREFIX: Final = "Tool.PtMeasPar."


class DmeMethods:
    """The methods of a session; ``report`` lists what PtMeas answers.

    Every method takes its arguments and returns data lines, or raises MethodError. ``warnings``
    are errors that stop nothing, for the caller to take.
    """

    def __init__(self, machine: SimulatedMachine, version: str) -> None:
        self.machine, self.version = machine, version
        self.tool, self.report = "Probe1", [Call(axis) for axis in AXES]
        self.system, self.user = "MachineCsy", False
        self.warnings: list[DmeFault] = []
        self._known: Mapping[str, Callable[[Call], Awaitable[Sequence[Value]]]] = {
            "AlignPart": self._align_part,
            "ChangeTool": self._change_tool,
            "EnumAllProp": self._enum_all_prop,
            "Get": self._get,
            "GetProp": self._get_prop,
            "GoTo": self._go_to,
            "Home": self._home,
            "OnPtMeasReport": self._on_pt_meas_report,
            "PtMeas": self._pt_meas,
            "SetCoordSystem": self._set_coord_system,
            "SetProp": self._set_prop,
            "SetTool": self._change_tool,
        }
        self._answers: Mapping[str, Callable[[], Sequence[Value]]] = {
            "EnumTools": lambda: TOOLS,
            "GetCoordSystem": lambda: [Call("CoordSystem", (Word(self.system),))],
            "GetDMEVersion": lambda: [make_call("DMEVersion", self.version)],
            "GetMachineClass": lambda: [make_call("GetMachineClass", "CartCMMWithRotaryTable")],
            "IsHomed": lambda: [make_call("IsHomed", int(self.machine.homed))],
            "IsUserEnabled": lambda: [make_call("IsUserEnabled", int(self.user))],
            "EnableUser": lambda: self._let_user(True),
            "DisableUser": lambda: self._let_user(False),
        }

    async def run(self, order: Call) -> list[str]:
        """Carry out a method and return its data lines."""
        try:
            if order.name in self._answers:
                if order.arguments:
                    raise MethodError(502, order.name)
                return [format_value(value) for value in self._answers[order.name]()]
            if order.name not in self._known:
                raise MethodError(501, order.name)
            return [format_value(value) for value in await self._known[order.name](order)]
        except ProtocolError as error:
            raise MethodError(509, order.name) from error

    def standing(self, asked: Sequence[Value], cause: str) -> str:
        """Return the values that are asked for, in their order."""
        return self._reported(asked, self.machine.position(), cause)

    def _reported(self, asked: Sequence[Value], place: Floats, cause: str) -> str:
        found: dict[str, float] = {
            axis: float(value) / MILLIMETRE for axis, value in zip(AXES, place, strict=True)
        }
        found["R"] = self.machine.angle() / DEGREE
        names = [value.name for value in asked if isinstance(value, Call) and not value.arguments]
        if not asked or len(names) < len(asked) or not set(names) <= found.keys():
            raise MethodError(509 if cause == "Get" else 510, cause)
        return ", ".join(format_value(Call(name, (found[name],))) for name in names)

    async def _get(self, order: Call) -> list[Value]:
        return [Word(self.standing(order.arguments, "Get"))]

    async def _home(self, _order: Call) -> list[Value]:
        await self.machine.home()
        return []

    async def _go_to(self, order: Call) -> list[Value]:
        given = self._numbers_by_axis(order, {*AXES, "R"})
        r_deg = given.pop("R", None)
        place = self._place(given) if given else None
        await self.machine.go(place, None if r_deg is None else r_deg * DEGREE, "GoTo")
        return []

    async def _align_part(self, order: Call) -> list[Value]:
        numbers = order.numbers()
        if len(numbers) != 7:
            raise MethodError(506 if len(numbers) == 14 else 502, order.name)
        part, machine = np.array(numbers[:3]), np.array(numbers[3:6])
        await self.machine.align(part, machine)
        reached = [*_flat(part), *_flat(machine)]
        return [Word(f"({', '.join(format_value(value) for value in reached)})")]

    async def _pt_meas(self, order: Call) -> list[Value]:
        by_name = calls_by_name(order.arguments)
        direction = by_name.get("IJK")
        linear = Call(order.name, tuple(a for a in order.arguments if a is not direction))
        place, here = self._place(self._numbers_by_axis(linear, {*AXES})), self.machine.position()
        away = here - place if direction is None else np.array(direction.numbers())
        if away.shape != (3,) or self.tool == "NoTool":
            raise MethodError(502 if away.shape != (3,) else 2002, order.name)
        met = await self.machine.touch(place, away)
        return [Word(self._reported(self.report, met, "OnPtMeasReport"))]

    async def _on_pt_meas_report(self, order: Call) -> list[Value]:
        self.standing(order.arguments, order.name)
        self.report = [value for value in order.arguments if isinstance(value, Call)]
        return []

    async def _set_coord_system(self, order: Call) -> list[Value]:
        match order.arguments:
            case (Word("MachineCsy" | "MoveableMachineCsy" as name),):
                self.system = name
                return []
        raise MethodError(509, order.name)

    async def _change_tool(self, order: Call) -> list[Value]:
        match order.arguments:
            case (str(name),) if name in TOOLS:
                self.tool = name
                return []
        raise MethodError(1502, order.name)

    async def _enum_all_prop(self, order: Call) -> list[Value]:
        if [format_value(argument) for argument in order.arguments] != ["Tool()"]:
            raise MethodError(509, order.name)
        names = [*(f"PtMeasPar.{name}" for name in PROBING), "AvrRadius"]
        kinds = [Word(f'"{name}", "Number"') for name in names]
        return [*kinds, Word('"Name", "String"')]

    async def _get_prop(self, order: Call) -> list[Value]:
        found: dict[str, Value] = {
            f"{PROBING_PREFIX}{name}": getattr(self.machine.probing, own) / MILLIMETRE
            for name, own in PROBING.items()
        }
        found["Tool.AvrRadius"] = self.machine.tip_radius / MILLIMETRE
        found["Tool.Name"] = self.tool
        asked = [a.name for a in order.arguments if isinstance(a, Call) and not a.arguments]
        if not asked or len(asked) < len(order.arguments):
            raise MethodError(502, order.name)
        plain = {name: name.removesuffix(".Act") for name in asked}
        if not set(plain.values()) <= found.keys():
            raise MethodError(510, order.name)
        line = ", ".join(format_value(Call(name, (found[plain[name]],))) for name in asked)
        return [Word(line)]

    async def _set_prop(self, order: Call) -> list[Value]:
        values: dict[str, float] = {}
        for argument in order.arguments:
            name = argument.name if isinstance(argument, Call) else ""
            name = name.removeprefix(PROBING_PREFIX).removesuffix(".Act")
            if not isinstance(argument, Call) or name not in PROBING:
                raise MethodError(510, order.name)
            low, high = RANGES[name]
            wanted = argument.number()
            if not low <= wanted <= high:
                self.warnings.append(DmeFault.known(504, order.name))
            values[PROBING[name]] = min(max(wanted, low), high) * MILLIMETRE
        self.machine.set_probing(**values)
        return []

    def _let_user(self, enabled: bool) -> list[Value]:
        self.user = enabled
        return []

    def _numbers_by_axis(self, order: Call, axes: set[str]) -> dict[str, float]:
        """Return the value for each axis; MethodError for none, others, or one given twice."""
        calls = [a for a in order.arguments if isinstance(a, Call)]
        found = {given.name: given.number() for given in calls}
        if not found or len(found) < len(order.arguments):
            raise MethodError(502, order.name)
        if not found.keys() <= axes:
            raise MethodError(506, order.name)
        return found

    def _place(self, given: Mapping[str, float]) -> Floats:
        """Return where ``given`` (mm) leads to, m; what is not given stays as it is."""
        here = self.machine.position()
        wanted = zip(AXES, here, strict=True)
        return np.array(
            [given[axis] * MILLIMETRE if axis in given else value for axis, value in wanted]
        )


def error_info(order: Call) -> list[str]:
    """Return the text of an error number, as GetErrorInfo does."""
    number = int(order.number())
    if number not in KNOWN:
        raise MethodError(509, order.name)
    return [format_value(KNOWN[number][1])]


def _flat(vector: Floats) -> list[float]:
    """Return a vector projected on the table's plane, of length 1."""
    flat = np.array([vector[0], vector[1], 0.0])
    unit: list[float] = (flat / np.linalg.norm(flat)).tolist()
    return unit


VOLUME_M: Final = 2.0
"""Farthest coordinate that the machine reaches, either way."""
SLICE_S: Final = 0.02
"""Wall time between two looks at a motion."""
SHORTEST_SLEEP_S: Final = 5e-4
"""A sleep is never shorter than a tick of the system's clock: shorter motions do not sleep."""
TURNS: Final = 36_000.0 * DEGREE
"""Farthest R, either way, rad."""
TOUCH_S: Final = 0.2
"""Machine time of a probing motion, if the instrument's settings have none."""


class MethodError(Exception):
    """A command ends with an error."""

    def __init__(self, number: int, cause: str) -> None:
        super().__init__(number, cause)
        self.fault = DmeFault.known(number, cause)


@dataclass(frozen=True, slots=True)
class ProbingDistances:
    """How a tip probes, m: begins before a surface, ends behind it, goes back from it."""

    approach: float = 0.002
    search: float = 0.003
    retract: float = 0.001


class SimulatedMachine:
    """Table and instrument of a simulated cell, whose time passes as the wall's, but scaled.

    Positions are metres in the machine frame, angles radians. ``moving`` while a motion lasts.
    Raises ConfigurationError for a cell whose table another program moves.
    """

    def __init__(self, cell: SimulatedCell) -> None:
        settings = cell.settings
        if settings.table.external:
            raise ConfigurationError(
                "simulation.table.external: a DME server moves its own table; set it to false"
            )
        self.settings = settings
        self._cell = cell
        self._looked_s = time.monotonic()
        self._reported = 0
        self.probing = ProbingDistances()
        self.homed, self.moving = False, False
        touch_probe = getattr(settings, "touch_probe", None)
        self.tip_radius = float(getattr(touch_probe, "tip_radius_m", 0.0))
        self._touch_s = float(getattr(touch_probe, "touch_time_s", TOUCH_S))

    @property
    def cell(self) -> SimulatedCell:
        """The cell, at the present time."""
        now = time.monotonic()
        elapsed_s, self._looked_s = now - self._looked_s, now
        if not self.moving:
            self._cell.advance(elapsed_s * self.settings.time_scale)
        return self._cell

    def position(self) -> Floats:
        """Return where the tip is believed to be, (3,) m."""
        cell = self.cell
        found: Floats = cell.instrument.positions(np.array([cell.now_ns]))[0]
        return found

    def angle(self) -> float:
        """Return what the table's feedback says, rad."""
        cell = self.cell
        self._reported += 1
        return cell.table.feedback(self._reported, np.array([cell.now_ns]))[0].angle

    async def home(self) -> None:
        """Go up and count that as home; the simulated machine knows its axes anyway."""
        x, y, z = self.position().tolist()
        await self.go(np.array([x, y, max(z, 0.0)]), None, "Home")
        self.homed = True

    async def go(self, place: Floats | None, angle: float | None, cause: str) -> None:
        """Move the tip to ``place`` (3,) and the table to ``angle``, both at once."""
        if not self.homed and cause != "Home":
            raise MethodError(1011, cause)
        cell = self.cell
        if place is not None:
            if np.abs(place).max() > VOLUME_M:
                raise MethodError(2500, cause)
            try:
                free = cell.instrument.go(cell.now_ns, place)
            except ControllerError as error:
                raise MethodError(2002, cause) from error
            if not free:
                raise MethodError(2504, cause)
        if angle is not None:
            if abs(angle) > TURNS:
                raise MethodError(2505, cause)
            cell.table.order(cell.now_ns, angle, Approach.UNKNOWN)
        rest_ns = max(cell.table.rest_ns, cell.instrument.rest_ns)
        await self._spend((rest_ns - cell.now_ns) * NANOSECOND)

    async def align(self, part: Floats, machine: Floats) -> None:
        """Turn the table the shorter way, so that ``part`` (3,) points along ``machine`` (3,)."""
        vectors = (part[:2], machine[:2])
        for vector in vectors:
            _norm(vector, "AlignPart")
        begin, end = (atan2(float(y), float(x)) for x, y in vectors)
        here = self.angle()
        await self.go(None, here + remainder(end - begin - here, 2.0 * pi), "AlignPart")

    async def touch(self, surface: Floats, direction: Floats) -> Floats:
        """Return the centre (3,) of the tip that met the surface, and go back from it."""
        away, probing = direction / _norm(direction, "PtMeas"), self.probing
        tip = surface + self.tip_radius * away
        await self.go(tip + probing.approach * away, None, "PtMeas")
        await self._spend(self._touch_s)
        search = (probing.approach, probing.search)
        try:
            met = self._cell.instrument.touched(self._cell.now_ns, surface, away, search)
        except ControllerError as error:
            raise MethodError(2002, "PtMeas") from error
        if met is None:
            raise MethodError(1006, "PtMeas")
        back = probing.retract if probing.retract >= 0.0 else probing.approach
        await self.go(met + back * away, None, "PtMeas")
        return met

    def stop(self) -> None:
        """Stand still where tip and table are now."""
        self.moving = False
        cell = self.cell
        now = np.array([cell.now_ns])
        cell.instrument.go(cell.now_ns, cell.instrument.positions(now)[0])
        cell.table.order(cell.now_ns, float(cell.table.angles(now)[0]), Approach.UNKNOWN)

    def set_probing(self, **values: float) -> None:
        """Change how the tip probes, m."""
        self.probing = replace(self.probing, **values)

    async def _spend(self, duration_s: float) -> None:
        """Let machine time pass while the wall's does."""
        self.moving = True
        scale = self.settings.time_scale
        try:
            while duration_s > 0.0:
                part_s = min(duration_s, SLICE_S * scale)
                wall_s = part_s / scale
                await asyncio.sleep(wall_s if wall_s > SHORTEST_SLEEP_S else 0.0)
                self._cell.advance(part_s)
                duration_s -= part_s
        finally:
            self.moving, self._looked_s = False, time.monotonic()


def _norm(vector: Floats, cause: str) -> float:
    """Return the length of a vector; MethodError when it leads nowhere."""
    length = float(np.linalg.norm(vector))
    if not 1e-9 < length < 1e9:
        raise MethodError(1010, cause)
    return length
