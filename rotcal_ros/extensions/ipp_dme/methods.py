"""The methods that the simulated machine's DME server knows: arguments in, data lines out.

Source: I++ DME 1.4.3, chapters 6.3 and 12. What belongs to the session (its begin and end, errors,
daemons) is the conversation's matter.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Mapping, Sequence
from typing import Final

import numpy as np

from rotcal_ros.extensions.ipp_dme.faults import KNOWN, Fault, ProtocolError
from rotcal_ros.extensions.ipp_dme.grammar import Call, Value, Word, call, calls_by_name, written
from rotcal_ros.extensions.ipp_dme.machine import MethodError, SimulatedMachine
from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.units import DEGREE, MILLIMETRE

TOOLS: Final = ("RefTool", "NoTool", "Probe1")
AXES: Final = ("X", "Y", "Z")
PROBING: Final = {"Approach": "approach", "Search": "search", "Retract": "retract"}
"""Parameter of Tool.PtMeasPar -> the machine's name for it."""
RANGES: Final = {"Approach": (0.0, 100.0), "Search": (0.0, 100.0), "Retract": (-1.0, 100.0)}
PROBING_PREFIX: Final = "Tool.PtMeasPar."


class Methods:
    """What a session does with the machine; ``report`` is what PtMeas answers.

    Every method takes its arguments and returns data lines, or raises MethodError. ``warnings``
    are errors that stop nothing, for the caller to take.
    """

    def __init__(self, machine: SimulatedMachine, version: str) -> None:
        self.machine, self.version = machine, version
        self.tool, self.report = "Probe1", [Call(axis) for axis in AXES]
        self.system, self.user = "MachineCsy", False
        self.warnings: list[Fault] = []
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
            "GetDMEVersion": lambda: [call("DMEVersion", self.version)],
            "GetMachineClass": lambda: [call("GetMachineClass", "CartCMMWithRotaryTable")],
            "IsHomed": lambda: [call("IsHomed", int(self.machine.homed))],
            "IsUserEnabled": lambda: [call("IsUserEnabled", int(self.user))],
            "EnableUser": lambda: self._let_user(True),
            "DisableUser": lambda: self._let_user(False),
        }

    async def run(self, order: Call) -> list[str]:
        """Carry out a method and return its data lines."""
        try:
            if order.name in self._answers:
                if order.arguments:
                    raise MethodError(502, order.name)
                return [written(value) for value in self._answers[order.name]()]
            if order.name not in self._known:
                raise MethodError(501, order.name)
            return [_line(value) for value in await self._known[order.name](order)]
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
        return ", ".join(written(Call(name, (found[name],))) for name in names)

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
        return [Word(f"({', '.join(written(value) for value in reached)})")]

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
        if [written(argument) for argument in order.arguments] != ["Tool()"]:
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
        line = ", ".join(written(Call(name, (found[plain[name]],))) for name in asked)
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
                self.warnings.append(Fault.known(504, order.name))
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
    return [written(KNOWN[number][1])]


def _line(value: Value) -> str:
    return written(value)


def _flat(vector: Floats) -> list[float]:
    """Return a vector projected on the table's plane, of length 1."""
    flat = np.array([vector[0], vector[1], 0.0])
    unit: list[float] = (flat / np.linalg.norm(flat)).tolist()
    return unit
