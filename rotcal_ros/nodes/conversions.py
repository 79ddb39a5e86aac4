"""Dataclasses into messages; the way back is rotcal_ros.messages, as for the replay of bags."""

from __future__ import annotations

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

_SECOND_NS: Final = 1_000_000_000


def time_message(nanoseconds: int) -> Time:
    """Return integer nanoseconds as a stamp."""
    seconds, rest = divmod(nanoseconds, _SECOND_NS)
    return Time(sec=seconds, nanosec=rest)


def header(nanoseconds: int, frame: str) -> Header:
    """Return a header."""
    return Header(stamp=time_message(nanoseconds), frame_id=frame)


def tracer_message(sample: TracerSample, frame: str) -> TracerLength:
    """Return the message of a tracer reading."""
    return TracerLength(
        header=header(sample.stamp_ns, frame),
        sequence=sample.sequence & 0xFFFFFFFF,
        length=sample.length,
        length_std=sample.length_std,
        status=int(sample.status),
    )


def table_message(sample: TableSample, joint: str, frame: str) -> JointState:
    """Return the message of table feedback."""
    return JointState(
        header=header(sample.stamp_ns, frame),
        name=[joint],
        position=[sample.angle],
        velocity=[sample.velocity],
    )


def probe_message(sample: ProbeSample, frame: str) -> ProbePoint:
    """Return the message of a probe point."""
    return ProbePoint(
        header=header(sample.stamp_ns, frame),
        sequence=sample.sequence & 0xFFFFFFFF,
        step=sample.step,
        attempt=sample.attempt,
        kind=int(sample.kind),
        target=sample.target,
        station=sample.station,
        point=sample.point,
        position=sample.position,
        position_std=sample.position_std,
        tip_radius=sample.tip_radius,
    )


def temperature_message(sample: TemperatureSample) -> Temperature:
    """Return the message of a temperature; the variance is unknown."""
    return Temperature(
        header=header(sample.stamp_ns, sample.sensor), temperature=sample.temperature_c
    )


def command_messages(
    order: Command, now_ns: int, table_frame: str, probe_frame: str
) -> tuple[TableAngle, ProbeTarget]:
    """Return the two messages that give an order."""
    table = TableAngle(
        header=header(now_ns, table_frame),
        step=order.step,
        attempt=order.attempt,
        angle=order.table_angle,
        approach=int(order.approach),
    )
    probe = ProbeTarget(
        header=header(now_ns, probe_frame),
        step=order.step,
        attempt=order.attempt,
        kind=int(order.kind),
        target=order.target,
        station=order.station,
        position=order.position,
    )
    return table, probe


def observation_message(captured: Observation, frame: str) -> ObservationMsg:
    """Return the message of a captured step."""
    return ObservationMsg(
        header=header(captured.window_end_ns, frame),
        step=captured.step,
        attempt=captured.attempt,
        table_index=captured.table_index,
        target=captured.target,
        station=captured.station,
        kind=int(captured.kind),
        table_angle=captured.table_angle,
        table_angle_measured=captured.table_angle_measured,
        mean=list(captured.mean),
        std=list(captured.std),
        scatter=list(captured.scatter),
        probe_position=captured.probe_position,
        temperature=math.nan if captured.temperature_c is None else captured.temperature_c,
        n_samples=captured.n_samples,
        n_used=captured.n_used,
        accepted=captured.accepted,
        reason=captured.reason,
        window_start=time_message(captured.window_start_ns),
        window_end=time_message(captured.window_end_ns),
        run=captured.run,
    )


def deviations_message(
    result: Result, *, plan_id: str, final: bool, now_ns: int, frame: str
) -> DeviationArray:
    """Return the deviations of a result; components that were not measured stay empty."""
    columns: dict[str, Any] = {}
    for name, values in result.deviations.items():
        columns[name.lower()] = values.tolist()
    for name, values in result.std.items():
        columns[f"{name.lower()}_std"] = values.tolist()
    return DeviationArray(
        header=header(now_ns, frame),
        plan_id=plan_id,
        method=result.method,
        final=final,
        angles=result.angles.tolist(),
        sigma0=result.sigma0,
        dof=result.dof,
        n_observations=result.n_observations,
        n_rejected=len(result.rejected),
        verdict=result.verdict,
        warnings=list(result.warnings),
        **columns,
    )


def compensation_message(
    table: CompensationTable, *, plan_id: str, now_ns: int, frame: str
) -> CompensationTableMsg:
    """Return the message of a compensation table."""
    return CompensationTableMsg(
        header=header(now_ns, frame),
        axis=table.axis,
        plan_id=plan_id,
        method=table.method,
        table_hash=table.table_hash,
        verdict=table.verdict,
        period=table.period,
        reference_angle=table.reference_angle,
        angles=table.angles.tolist(),
        correction_forward=table.correction_forward.tolist(),
        correction_reverse=table.correction_reverse.tolist(),
        std=table.std.tolist(),
    )


def compensation_table(message: CompensationTableMsg) -> CompensationTable:
    """Return the table in a message; DataError when its hash is not that of its numbers."""
    table = CompensationTable(
        axis=message.axis,
        method=message.method,
        angles=message.angles,
        correction_forward=message.correction_forward,
        correction_reverse=message.correction_reverse,
        std=message.std,
        period=message.period,
        reference_angle=message.reference_angle,
        verdict=message.verdict,
    )
    if table.table_hash != message.table_hash:
        raise DataError(
            f"the table of axis {message.axis} carries the hash {message.table_hash or 'none'}, "
            f"its numbers have {table.table_hash}: it was changed on its way"
        )
    return table
