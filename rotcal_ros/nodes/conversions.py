"""Messages into dataclasses and back: the only place that knows both."""

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
from rotcal_ros.observations import (
    Approach,
    Command,
    LengthStatus,
    Observation,
    PointKind,
    ProbeSample,
    TableSample,
    TemperatureSample,
    TracerSample,
)
from rotcal_ros.results import Result

_SECOND_NS: Final = 1_000_000_000
_STATUS: Final = tuple(LengthStatus)
_KINDS: Final = tuple(PointKind)


def stamp_ns(stamp: Time) -> int:
    """Return a stamp as integer nanoseconds."""
    nanoseconds: int = stamp.sec * _SECOND_NS + stamp.nanosec
    return nanoseconds


def time_message(nanoseconds: int) -> Time:
    """Return integer nanoseconds as a stamp."""
    seconds, rest = divmod(nanoseconds, _SECOND_NS)
    return Time(sec=seconds, nanosec=rest)


def header(nanoseconds: int, frame: str) -> Header:
    """Return a header."""
    return Header(stamp=time_message(nanoseconds), frame_id=frame)


def tracer_sample(message: TracerLength) -> TracerSample:
    """Return a tracer reading; an unheard-of status is UNKNOWN."""
    status = message.status
    return TracerSample(
        stamp_ns(message.header.stamp),
        message.sequence,
        message.length,
        message.length_std,
        _STATUS[status] if status < len(_STATUS) else LengthStatus.UNKNOWN,
    )


def tracer_message(sample: TracerSample, frame: str) -> TracerLength:
    """Return the message of a tracer reading."""
    return TracerLength(
        header=header(sample.stamp_ns, frame),
        sequence=sample.sequence & 0xFFFFFFFF,
        length=sample.length,
        length_std=sample.length_std,
        status=int(sample.status),
    )


def table_sample(message: JointState, joint: str) -> TableSample | None:
    """Return the feedback of ``joint``; None when the message does not hold it.

    A drive that tells no velocity gives NaN, which the capture counts as not usable.
    """
    try:
        index = list(message.name).index(joint)
        angle = message.position[index]
    except (ValueError, IndexError):
        return None
    velocity = message.velocity[index] if index < len(message.velocity) else math.nan
    return TableSample(stamp_ns(message.header.stamp), angle, velocity)


def table_message(sample: TableSample, joint: str, frame: str) -> JointState:
    """Return the message of table feedback."""
    return JointState(
        header=header(sample.stamp_ns, frame),
        name=[joint],
        position=[sample.angle],
        velocity=[sample.velocity],
    )


def probe_sample(message: ProbePoint) -> ProbeSample:
    """Return a probe point; an unheard-of kind is UNKNOWN."""
    x, y, z = message.position.tolist()
    sx, sy, sz = message.position_std.tolist()
    return ProbeSample(
        stamp_ns=stamp_ns(message.header.stamp),
        sequence=message.sequence,
        step=message.step,
        attempt=message.attempt,
        kind=_kind(message.kind),
        target=message.target,
        station=message.station,
        point=message.point,
        position=(x, y, z),
        position_std=(sx, sy, sz),
        tip_radius=message.tip_radius,
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


def temperature_sample(message: Temperature) -> TemperatureSample:
    """Return a temperature; the frame names the sensor."""
    return TemperatureSample(
        stamp_ns(message.header.stamp), message.header.frame_id, message.temperature
    )


def temperature_message(sample: TemperatureSample) -> Temperature:
    """Return the message of a temperature; the variance is unknown."""
    return Temperature(
        header=header(sample.stamp_ns, sample.sensor), temperature=sample.temperature_c
    )


def command(table: TableAngle, probe: ProbeTarget) -> Command:
    """Return the order that the two messages of one attempt give together."""
    x, y, z = probe.position.tolist()
    approach = table.approach
    return Command(
        step=table.step,
        attempt=table.attempt,
        table_angle=table.angle,
        approach=Approach(approach) if approach <= Approach.NEGATIVE else Approach.UNKNOWN,
        kind=_kind(probe.kind),
        target=probe.target,
        position=(x, y, z),
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
        position=order.position,
    )
    return table, probe


def observation(message: ObservationMsg) -> Observation:
    """Return a captured step."""
    x, y, z = message.probe_position.tolist()
    return Observation(
        step=message.step,
        attempt=message.attempt,
        table_index=message.table_index,
        table_angle=message.table_angle,
        target=message.target,
        station=message.station,
        kind=_kind(message.kind),
        mean=tuple(message.mean),
        std=tuple(message.std),
        scatter=tuple(message.scatter),
        probe_position=(x, y, z),
        n_samples=message.n_samples,
        n_used=message.n_used,
        accepted=message.accepted,
        reason=message.reason,
        table_angle_measured=message.table_angle_measured,
        temperature_c=None if math.isnan(message.temperature) else message.temperature,
        window_start_ns=stamp_ns(message.window_start),
        window_end_ns=stamp_ns(message.window_end),
    )


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


def _kind(number: int) -> PointKind:
    return _KINDS[number] if number < len(_KINDS) else PointKind.UNKNOWN
