"""Small bags for tests: messages made by rosbags, written by our writer."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from rotcal_ros import methods
from rotcal_ros.bags import names
from rotcal_ros.bags.rosbag2_metadata import OfferedQos, qos_text
from rotcal_ros.bags.settings import WriterSettings
from rotcal_ros.bags.writer import BagWriter
from rotcal_ros.foundation.language import code_of
from rotcal_ros.foundation.observations import (
    Command,
    Observation,
    ProbeSample,
    TableSample,
    TemperatureSample,
    TracerSample,
)
from rotcal_ros.methods.configuration import dump_configuration, parse_configuration

MSG_DEFS = Path(__file__).parents[2] / "msg_defs"
START_NS = 1_700_000_000_000_000_000

CONFIGURATION = dump_configuration(
    "tracer_multistation",
    {
        "plan": {
            "table_step_deg": 60.0,
            "table_positions": 4,
            "box_points": [2, 2, 2],
            "box_centre_m": [0.0, 0.0, 0.6],
        },
        "capture": {"settle_time_s": 0.1, "window_samples": 30, "temperature_lag_s": 0.2},
        "simulation": {
            "seed": 5,
            "table": {"speed_deg_s": 100.0, "acceleration_deg_s2": 500.0},  # fewer messages
            "tracer": {"rate_hz": 200.0},
        },
    },
)


def make_typestore() -> Typestore:
    """Return ROS's own types and ours, parsed by rosbags."""
    store = get_typestore(Stores.ROS2_KILTED)
    types: dict[str, Any] = {}
    for path in sorted((MSG_DEFS / "msg").glob("*.msg")):
        types |= get_types_from_msg(path.read_text(), f"rotcal_msgs/msg/{path.stem}")
    store.register(types)
    return store


STORE = make_typestore()


def serialised(type_name: str, **fields: Any) -> bytes:
    """Return the CDR bytes of a message, header fields as stamp_ns and frame_id."""
    types = STORE.types
    if "stamp_ns" in fields:
        header = types["std_msgs/msg/Header"](
            time_message(fields.pop("stamp_ns")), fields.pop("frame_id", "frame")
        )
        fields["header"] = header
    return bytes(STORE.serialize_cdr(types[type_name](**fields), type_name))


def time_message(stamp_ns: int) -> Any:
    seconds, nanoseconds = divmod(stamp_ns, 1_000_000_000)
    return STORE.types["builtin_interfaces/msg/Time"](seconds, nanoseconds)


def floats(values: Any) -> Any:
    return np.asarray(values, np.float64)


TYPES = {
    names.TRACER_LENGTH: "rotcal_msgs/msg/TracerLength",
    names.PROBE_POINT: "rotcal_msgs/msg/ProbePoint",
    names.JOINT_STATES: "sensor_msgs/msg/JointState",
    names.TEMPERATURE: "sensor_msgs/msg/Temperature",
    names.TABLE_ANGLE: "rotcal_msgs/msg/TableAngle",
    names.PROBE_TARGET: "rotcal_msgs/msg/ProbeTarget",
    names.OBSERVATION: "rotcal_msgs/msg/Observation",
    names.PLAN: "rotcal_msgs/msg/CalibrationPlan",
}


def encode(record: Any) -> list[tuple[str, bytes]]:
    """Return (role, CDR bytes) of the messages that carry a record."""
    return _ENCODERS[type(record)](record)


def _tracer(r: TracerSample) -> list[tuple[str, bytes]]:
    data = serialised(
        TYPES[names.TRACER_LENGTH], stamp_ns=r.stamp_ns, frame_id="tracer", sequence=r.sequence,
        length=r.length, length_std=r.length_std, status=int(r.status),
    )  # fmt: skip
    return [(names.TRACER_LENGTH, data)]


def _table(r: TableSample) -> list[tuple[str, bytes]]:
    data = serialised(
        TYPES[names.JOINT_STATES], stamp_ns=r.stamp_ns, name=["table"], position=floats([r.angle]),
        velocity=floats([r.velocity]), effort=floats([]),
    )  # fmt: skip
    return [(names.JOINT_STATES, data)]


def _probe(r: ProbeSample) -> list[tuple[str, bytes]]:
    data = serialised(
        TYPES[names.PROBE_POINT], stamp_ns=r.stamp_ns, sequence=r.sequence, step=r.step,
        attempt=r.attempt, kind=int(r.kind), target=r.target, station=r.station, point=r.point,
        position=floats(r.position), position_std=floats(r.position_std),
        tip_radius=r.tip_radius,
    )  # fmt: skip
    return [(names.PROBE_POINT, data)]


def _temperature(r: TemperatureSample) -> list[tuple[str, bytes]]:
    data = serialised(
        TYPES[names.TEMPERATURE], stamp_ns=r.stamp_ns, frame_id=r.sensor,
        temperature=r.temperature_c, variance=0.0,
    )  # fmt: skip
    return [(names.TEMPERATURE, data)]


def _command(r: Command) -> list[tuple[str, bytes]]:
    table = serialised(
        TYPES[names.TABLE_ANGLE], stamp_ns=START_NS, step=r.step, attempt=r.attempt,
        angle=r.table_angle, approach=int(r.approach),
        turn_speed=r.turn.speed if r.turn else 0.0, turn_begin=r.turn.begin if r.turn else 0.0,
        turn_end=r.turn.end if r.turn else 0.0, turn_anew=r.turn is not None,
    )  # fmt: skip
    probe = serialised(
        TYPES[names.PROBE_TARGET], stamp_ns=START_NS, step=r.step, attempt=r.attempt,
        kind=int(r.kind), target=r.target, station=0, position=floats(r.position),
        approach=floats([0, 0, 0]),
    )  # fmt: skip
    return [(names.TABLE_ANGLE, table), (names.PROBE_TARGET, probe)]


def text_code(text: str) -> Any:
    """Return a rotcal_msgs/TextCode."""
    code, arguments = code_of(text)
    return STORE.types["rotcal_msgs/msg/TextCode"](code=code, arguments=arguments)


def number(value: float | None) -> float:
    """Return a number of a message, NaN where there is none."""
    return float("nan") if value is None else value


def _observation(r: Observation) -> list[tuple[str, bytes]]:
    data = serialised(
        TYPES[names.OBSERVATION], stamp_ns=r.window_end_ns, step=r.step, attempt=r.attempt,
        table_index=r.table_position, target=r.target, station=r.station, kind=int(r.kind),
        table_angle=r.table_angle, table_angle_measured=r.table_angle_measured,
        mean=floats(r.mean), std=floats(r.std), scatter=floats(r.scatter),
        probe_position=floats(r.probe_position),
        temperature=number(r.temperature_c),
        n_samples=r.n_samples, n_used=r.n_used, accepted=r.accepted, reason=r.reason,
        reason_code=text_code(r.reason),
        window_start=time_message(r.window_start_ns), window_end=time_message(r.window_end_ns),
        run=r.run, segment=r.segment, pressure=number(r.pressure_pa), humidity=number(r.humidity),
    )  # fmt: skip
    return [(names.OBSERVATION, data)]


_ENCODERS: dict[type, Any] = {
    TracerSample: _tracer,
    TableSample: _table,
    ProbeSample: _probe,
    TemperatureSample: _temperature,
    Command: _command,
    Observation: _observation,
}


@dataclass
class Run:
    """A simulated live run: every record in order of arrival, and the observations."""

    records: list[Any] = field(default_factory=list)
    observations: list[Observation] = field(default_factory=list)


def simulate(configuration_text: str = CONFIGURATION) -> Run:
    """Run a small calibration on the simulated cell, capturing live, one record at a time."""
    configuration = parse_configuration(configuration_text)
    calibration = methods.prepare(configuration)
    plan, capture = calibration.plan, calibration.capture()
    cell = configuration.method.simulated_cell(configuration.simulation, START_NS)
    run = Run()

    def arrive(record: Any) -> None:
        run.records.append(record)
        answers = capture.feed(record)
        run.observations.extend(answers)
        run.records.extend(answers)

    for step in plan.steps:
        order = step.command(0)
        arrive(order)
        cell.order_table(order)
        cell.order_probe(order)
        before = len(run.observations)
        for _ in range(100):
            output = cell.advance(0.2)
            streams = (output.tracer, output.table, output.probe, output.temperature)
            for record in sorted((r for s in streams for r in s), key=lambda r: r.stamp_ns):
                arrive(record)
            if len(run.observations) > before:
                break
    return run


def writer_settings(
    *,
    chunk_bytes: int = WriterSettings.chunk_bytes,
    sync_interval_s: float = WriterSettings.sync_interval_s,
    **stated: Any,
) -> WriterSettings:
    """Return settings whose constants are others, so that a short bag has many chunks."""
    constants = {"chunk_bytes": chunk_bytes, "sync_interval_s": sync_interval_s}
    return type("ShortBag", (WriterSettings,), constants)(**{"min_free_bytes": 0} | stated)


def open_writer(
    folder: Path, settings: WriterSettings | None = None, configuration: str = CONFIGURATION
) -> tuple[BagWriter, dict[str, int]]:
    """Return a writer with the cell's channels."""
    writer = BagWriter(folder, settings or WriterSettings(min_free_bytes=0), ros_distro="kilted")
    writer.attach(names.CONFIGURATION, "application/yaml", configuration.encode())
    channels = {
        role: writer.channel(
            f"/cell/{role}",
            type_name,
            STORE.generate_msgdef(type_name, ros_version=2)[0],
            STORE.hash_rihs01(type_name),
            qos_text([OfferedQos(depth=10)]),
        )
        for role, type_name in TYPES.items()
    }
    return writer, channels


def write_run(
    folder: Path, run: Run, settings: WriterSettings | None = None, tick_every: int = 500
) -> dict[str, int]:
    """Record a run; returns the number of messages per topic."""
    writer, channels = open_writer(folder, settings)
    with writer:
        for number, record in enumerate(run.records):
            time_ns = START_NS + number * 1_000_000
            for role, data in encode(record):
                writer.write(channels[role], data, time_ns, time_ns - 1000)
            if number % tick_every == 0:
                writer.tick(number * 10**9)
    return writer.counts
