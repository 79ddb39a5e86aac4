"""Dataclasses into messages; the way back is rotcal_ros.messages, as for the replay of bags."""

from __future__ import annotations

import dataclasses
import math
from typing import Any, Final

from builtin_interfaces.msg import Time
from rotcal_msgs.msg import CompensationTable as CompensationTableMsg
from rotcal_msgs.msg import DeviationArray, ProbePoint, ProbeTarget, TableAngle, TracerLength
from rotcal_msgs.msg import Observation as ObservationMsg
from sensor_msgs.msg import JointState, Temperature
from std_msgs.msg import Header

from rotcal_ros.compensation.table import CompensationTable
from rotcal_ros.errors import DataError
from rotcal_ros.observations import (
    Command,
    Observation,
    ProbeSample,
    TableSample,
    TemperatureSample,
    TracerSample,
)
from rotcal_ros.results import Result

TABLE: Final = "table_base"
MACHINE: Final = "machine"
TRACER: Final = "tracer"
"""The frames that messages of the cell are stamped with."""


def time_message(nanoseconds: int) -> Time:
    """Return integer nanoseconds as a stamp."""
    seconds, rest = divmod(nanoseconds, 1_000_000_000)
    return Time(sec=seconds, nanosec=rest)


def header(nanoseconds: int, frame: str = TABLE) -> Header:
    """Return a header."""
    return Header(stamp=time_message(nanoseconds), frame_id=frame)


def tracer_message(sample: TracerSample) -> TracerLength:
    """Return the message of a tracer reading."""
    return TracerLength(
        header=header(sample.stamp_ns, TRACER),
        sequence=sample.sequence & 0xFFFFFFFF,
        length=sample.length,
        length_std=sample.length_std,
        status=int(sample.status),
    )


def table_message(sample: TableSample, joint: str) -> JointState:
    """Return the message of table feedback."""
    return JointState(
        header=header(sample.stamp_ns),
        name=[joint],
        position=[sample.angle],
        velocity=[sample.velocity],
    )


def probe_message(sample: ProbeSample, frame: str) -> ProbePoint:
    """Return the message of a probe point."""
    fields = _same_fields(ProbePoint, sample)
    fields |= {"header": header(sample.stamp_ns, frame), "sequence": sample.sequence & 0xFFFFFFFF}
    return ProbePoint(**fields)


def temperature_message(sample: TemperatureSample) -> Temperature:
    """Return the message of a temperature; the variance is unknown."""
    return Temperature(
        header=header(sample.stamp_ns, sample.sensor), temperature=sample.temperature_c
    )


def command_messages(order: Command, now_ns: int) -> tuple[TableAngle, ProbeTarget]:
    """Return the two messages that give an order."""
    table = TableAngle(
        header=header(now_ns),
        step=order.step,
        attempt=order.attempt,
        angle=order.table_angle,
        approach=int(order.approach),
    )
    probe = ProbeTarget(
        header=header(now_ns, MACHINE),
        step=order.step,
        attempt=order.attempt,
        kind=int(order.kind),
        target=order.target,
        station=order.station,
        position=order.position,
    )
    return table, probe


def observation_message(captured: Observation) -> ObservationMsg:
    """Return the message of a captured step."""
    return ObservationMsg(
        header=header(captured.window_end_ns, TRACER),
        temperature=math.nan if captured.temperature_c is None else captured.temperature_c,
        window_start=time_message(captured.window_start_ns),
        window_end=time_message(captured.window_end_ns),
        **_same_fields(ObservationMsg, captured),
    )


def deviations_message(
    result: Result, plan_id: str, now_ns: int, *, final: bool
) -> DeviationArray:
    """Return the deviations of a result; components that were not measured stay empty."""
    columns = {name.lower(): values for name, values in result.deviations.items()}
    columns |= {f"{name.lower()}_std": values for name, values in result.std.items()}
    return DeviationArray(
        header=header(now_ns),
        plan_id=plan_id,
        final=final,
        n_rejected=len(result.rejected),
        **_same_fields(DeviationArray, result),
        **columns,
    )


def compensation_message(
    table: CompensationTable, plan_id: str, now_ns: int
) -> CompensationTableMsg:
    """Return the message of a compensation table."""
    fields = _same_fields(CompensationTableMsg, table)
    return CompensationTableMsg(header=header(now_ns), plan_id=plan_id, **fields)


def compensation_table(message: CompensationTableMsg) -> CompensationTable:
    """Return the table in a message; DataError when its hash is not that of its numbers."""
    names = (f.name for f in dataclasses.fields(CompensationTable))
    table = CompensationTable(**{n: getattr(message, n) for n in names if hasattr(message, n)})
    if table.table_hash != message.table_hash:
        raise DataError(
            f"the table of axis {message.axis} carries the hash {message.table_hash or 'none'}, "
            f"its numbers have {table.table_hash}: it was changed on its way"
        )
    return table


def _same_fields(kind: Any, record: object) -> dict[str, Any]:
    """Return the fields of a message that its record has under the same name."""
    names = kind.get_fields_and_field_types()
    return {name: getattr(record, name) for name in names if hasattr(record, name)}
