"""Converts dataclasses into messages; capture/messages.py does the reverse, for bags too."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator
from itertools import chain, repeat
from typing import Any, Final

import numpy as np
from builtin_interfaces.msg import Time
from rotcal_msgs import msg
from sensor_msgs.msg import FluidPressure, JointState, RelativeHumidity, Temperature
from std_msgs.msg import Header

from rotcal_ros.capture import messages
from rotcal_ros.compensation.table import CompensationTable
from rotcal_ros.foundation.components import COVERAGE_FACTOR, unit_of
from rotcal_ros.foundation.errors import DataError
from rotcal_ros.foundation.in_force import UNKNOWN
from rotcal_ros.foundation.language import code_of
from rotcal_ros.foundation.node_state import NodeState, Reason, State, Why
from rotcal_ros.foundation.observations import (
    Command,
    HumiditySample,
    Observation,
    PressureSample,
    ProbeSample,
    TableSample,
    TemperatureSample,
    TracerSample,
)
from rotcal_ros.foundation.results import AxisLine, Result
from rotcal_ros.foundation.results import FreeDirection as OpenZero
from rotcal_ros.planning.choices import StepChoice
from rotcal_ros.planning.plan import MACHINE_FRAME

TABLE: Final = "table_base"
MACHINE: Final = MACHINE_FRAME
TRACER: Final = "tracer"
"""The frames that messages of the cell are stamped with."""
_WRAPS: Final = 0xFFFFFFFF
MOST_ANGLES: Final = 200
"""Most angles of a message with covariances (2 MB for all six); else see result.json."""


def time_message(nanoseconds: int) -> Time:
    """Return integer nanoseconds as a stamp."""
    seconds, rest = divmod(nanoseconds, 1_000_000_000)
    return Time(sec=seconds, nanosec=rest)


def make_header(nanoseconds: int, frame: str = TABLE) -> Header:
    """Return a header."""
    return Header(stamp=time_message(nanoseconds), frame_id=frame)


def tracer_message(sample: TracerSample) -> msg.TracerLength:
    """Return the message of a tracer reading."""
    sequence = sample.sequence & _WRAPS
    return _filled(msg.TracerLength, sample, sample.stamp_ns, TRACER, sequence=sequence)


def table_message(sample: TableSample, joint: str) -> JointState:
    """Return the message of table feedback."""
    return JointState(
        header=make_header(sample.stamp_ns),
        name=[joint],
        position=[sample.angle],
        velocity=[sample.velocity],
    )


def probe_message(sample: ProbeSample, frame: str) -> msg.ProbePoint:
    """Return the message of a probe point."""
    sequence = sample.sequence & _WRAPS
    return _filled(msg.ProbePoint, sample, sample.stamp_ns, frame, sequence=sequence)


def temperature_message(sample: TemperatureSample) -> Temperature:
    """Return the message of a temperature; the variance is unknown."""
    head = make_header(sample.stamp_ns, sample.sensor)
    return Temperature(header=head, temperature=sample.temperature_c)


def air_message(sample: PressureSample | HumiditySample) -> FluidPressure | RelativeHumidity:
    """Return the message of a pressure or a humidity; the variance is unknown."""
    head = make_header(sample.stamp_ns, sample.sensor)
    if isinstance(sample, PressureSample):
        return FluidPressure(header=head, fluid_pressure=sample.pressure_pa)
    return RelativeHumidity(header=head, relative_humidity=sample.humidity)


def command_messages(order: Command, now_ns: int) -> tuple[msg.TableAngle, msg.ProbeTarget]:
    """Return the two messages that give an order."""
    turn = {} if order.turn is None else dataclasses.asdict(order.turn)
    others = {f"turn_{name}": value for name, value in turn.items()}
    others["turn_anew"] = order.turn is not None
    table = _filled(msg.TableAngle, order, now_ns, angle=order.table_angle, **others)
    # The table's side of approach is an enumeration, the probe's a direction, here any.
    return table, _filled(msg.ProbeTarget, order, now_ns, MACHINE, approach=(0.0, 0.0, 0.0))


def observation_message(captured: Observation) -> msg.Observation:
    """Return the message of a captured step."""
    return _filled(
        msg.Observation,
        captured,
        captured.window_end_ns,
        TRACER,
        table_index=captured.table_position,
        temperature=_or_nan(captured.temperature_c),
        pressure=_or_nan(captured.pressure_pa),
        humidity=_or_nan(captured.humidity),
        reason_code=code_of_text(captured.reason),
        window_start=time_message(captured.window_start_ns),
        window_end=time_message(captured.window_end_ns),
    )


def _or_nan(value: float | None) -> float:
    return math.nan if value is None else value


def choice_message(
    choice: StepChoice, plan_id: str, run: int, number: int, attempt: int, now_ns: int
) -> msg.StepChoice:
    """Return the message of what the planner chose."""
    standing = choice.standing
    return msg.StepChoice(
        header=make_header(now_ns),
        plan_id=plan_id,
        run=run,
        number=number,
        stop=choice.step is None,
        step=choice.step or 0,
        attempt=attempt,
        reason=choice.reason,
        reason_code=code_of_text(choice.reason),
        uncertainty=standing.uncertainty,
        goal=standing.goal,
        left=standing.left,
    )


def deviations_message(
    result: Result, plan_id: str, now_ns: int, *, final: bool
) -> msg.DeviationArray:
    """Return the deviations of a result; components that were not measured stay empty."""
    whole = final and len(result.angles) <= MOST_ANGLES
    steps, steps_std = result.adjacent_deviations, result.adjacent_std
    others = _columns(result, 1.0)
    if whole:
        others |= {f"{n.lower()}_covariance": c.ravel() for n, c in result.covariance.items()}
    others |= {
        "plan_id": plan_id,
        "final": final,
        "free_directions": [_free(direction) for direction in result.zeros.free],
        "adjacent_deviations": () if steps is None else steps,
        "adjacent_std": () if steps_std is None else steps_std,
        "directions": _directions(result, 1.0, covariance=whole),
        "n_rejected": len(result.rejected),
        "warning_codes": [code_of_text(warning) for warning in result.warnings],
        "not_protected": result.unprotected,
    }
    return _filled(msg.DeviationArray, result, now_ns, **others)


def correction_message(
    result: Result, axis: str, plan_id: str, now_ns: int
) -> msg.VolumetricCorrection:
    """Return the correction of all deviations that were measured: -(actual - commanded)."""
    measured_on = "" if result.measured_on == UNKNOWN else result.measured_on
    others = _columns(result, -1.0) | {
        "axis": axis,
        "plan_id": plan_id,
        "open_zeros": result.zeros.describe(),
        "directions": _directions(result, -1.0, covariance=len(result.angles) <= MOST_ANGLES),
        "measured_on": measured_on,
        "item": result.circumstances.identity.title,
    }
    return _filled(msg.VolumetricCorrection, result, now_ns, **others)


def location_message(result: Result, plan_id: str, now_ns: int) -> msg.AxisLocation:
    """Return the message of where the axes of a result stand."""
    others = {
        "plan_id": plan_id,
        "axes": [_line(line) for line in result.axes],
        "item": result.circumstances.identity.title,
    }
    return _filled(msg.AxisLocation, result, now_ns, MACHINE, **others)


def _line(line: AxisLine) -> msg.AxisLine:
    return msg.AxisLine(
        axis=line.letter,
        names=line.names,
        values=line.value,
        std=line.std,
        covariance=line.covariance.ravel(),
        origin=line.origin,
        point=line.point,
        direction=line.direction / np.linalg.norm(line.direction),
    )


def _columns(result: Result, sign: float) -> dict[str, Any]:
    """Return the values of all components times ``sign``, their uncertainties and their zero."""
    columns: dict[str, Any] = {"counts_from": result.zeros.counts_from}
    columns |= {n.lower(): sign * values for n, values in result.deviations.items()}
    return columns | {f"{n.lower()}_std": std for n, std in result.std.items()}


def _free(direction: OpenZero) -> msg.FreeDirection:
    return msg.FreeDirection(
        name=direction.name,
        components=list(direction.columns),
        columns=np.concatenate([*direction.columns.values()]),
    )


def _directions(result: Result, sign: float, *, covariance: bool) -> list[msg.DirectionalCurve]:
    return [
        msg.DirectionalCurve(
            component=name,
            angles=both.angles,
            forward=sign * both.forward,
            reverse=sign * both.reverse,
            covariance=both.covariance.ravel() if covariance else (),
        )
        for name, both in result.directions.items()
    ]


def compensation_message(
    table: CompensationTable, plan_id: str, now_ns: int
) -> msg.CompensationTable:
    """Return the message of a compensation table."""
    own: Any = () if table.std_reverse is None else table.std_reverse
    return _filled(
        msg.CompensationTable,
        table,
        now_ns,
        plan_id=plan_id,
        std_reverse=own,
        measured_from=time_message(table.measured_from_ns),
        measured_until=time_message(table.measured_until_ns),
    )


def compensation_table(message: msg.CompensationTable) -> CompensationTable:
    """Return the table in a message; DataError when its hash is not that of its numbers."""
    times = {
        f"{name}_ns": messages.stamp_ns(getattr(message, name))
        for name in ("measured_from", "measured_until")
    }
    sent = message.get_fields_and_field_types().keys()
    names = sent & {f.name for f in dataclasses.fields(CompensationTable)}
    same: dict[str, Any] = {name: getattr(message, name) for name in names}
    own = same["std_reverse"] if len(same["std_reverse"]) else None
    table = CompensationTable(**{**same, **times, "std_reverse": own})
    if table.table_hash != message.table_hash:
        raise DataError(
            f"the table of axis {message.axis} carries the hash {message.table_hash or 'none'}, "
            f"its numbers have {table.table_hash}: it was changed on the way; send it as it was "
            "made"
        )
    return table


def result_values(result: Result) -> dict[str, str]:
    """Return a result in words, as values of a diagnostic status, which needs no message of ours.

    Each deviation has its range and its largest expanded uncertainty (k = 2).
    """
    values: dict[str, str] = {"verdict": result.verdict_line}
    for name, curve in result.deviations.items():
        factor, unit = unit_of(name)
        expanded = COVERAGE_FACTOR * np.max(result.std[name])
        values[name] = (
            f"range {np.ptp(curve) / factor:.3g} {unit}, U (k = {COVERAGE_FACTOR:g}) "
            f"{expanded / factor:.2g} {unit}"
        )
    return values


def in_force_message(axis: str, in_force: str, now_ns: int) -> msg.TableInForce:
    """Return the message that announces what the controller of ``axis`` holds."""
    return msg.TableInForce(header=make_header(now_ns), axis=axis, in_force=in_force)


def _arguments(reason: msg.NodeReason) -> Iterator[str]:
    """Yield the arguments of a reason, texts with the codes that their sender gave."""
    for text, code in zip(
        reason.arguments, chain(reason.argument_codes, repeat(None)), strict=False
    ):
        yield messages.coded_phrase(text, code) if code and code.code else text


def code_of_text(text: str) -> msg.TextCode:
    """Return what a text for people was made of; empty for a mere name."""
    code, arguments = code_of(text)
    return msg.TextCode(code=code, arguments=arguments)


def _filled(kind: Any, record: object, stamp_ns: int, frame: str = TABLE, **others: Any) -> Any:
    """Return a message with the fields that its record has under the same name, and others."""
    names = kind.get_fields_and_field_types()
    same = {name: getattr(record, name) for name in names if hasattr(record, name)}
    return kind(**{**same, **others, "header": make_header(stamp_ns, frame)})


def node_state_message(state: NodeState) -> msg.NodeState:
    """Return the state of a node as a message; the sender adds its identity and values."""
    return msg.NodeState(
        state=state.state,
        step=state.step,
        total=state.total,
        reasons=[
            msg.NodeReason(
                code=reason.code,
                arguments=list(reason.arguments),
                argument_codes=[code_of_text(argument) for argument in reason.arguments],
            )
            for reason in state.reasons
        ],
        page=state.page,
    )


def node_state(message: msg.NodeState) -> NodeState:
    """Return the state of a node, from its beat."""
    reasons = (Reason(Why(r.code), tuple(_arguments(r))) for r in message.reasons)
    return NodeState(
        State(message.state), tuple(reasons), message.step, message.total, message.page
    )
