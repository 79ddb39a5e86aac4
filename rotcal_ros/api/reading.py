"""Reads what was measured: bags and their raw streams, tables, results, configurations."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from os import PathLike
from pathlib import Path
from typing import Any, Final, TypeAlias

import numpy as np
from numpy.typing import NDArray

from rotcal_ros import methods
from rotcal_ros.bags.reader import bag_files, read_blocks
from rotcal_ros.foundation.arrays import Ints
from rotcal_ros.foundation.errors import ConfigurationError
from rotcal_ros.foundation.observations import (
    HumiditySample,
    PressureSample,
    ProbeSample,
    TemperatureSample,
)
from rotcal_ros.foundation.results import Result
from rotcal_ros.foundation.tables import as_path_or_table
from rotcal_ros.methods.configuration import Configuration, changed, parse_configuration
from rotcal_ros.methods.measurements import read_measurements
from rotcal_ros.methods.method import Measurements
from rotcal_ros.recordings import result_sources
from rotcal_ros.recordings.recorded_setup import Decoders, find_configuration
from rotcal_ros.recordings.replay import Recording, Source, read_recording
from rotcal_ros.recordings.streams import StreamFeeder
from rotcal_ros.recordings.topics import Topics

Name = str | PathLike[str]
"""A path as people give it."""
Frame: TypeAlias = Any
"""A table in memory: a DataFrame of pandas or polars (nothing here imports them), a mapping of
columns, or a list of rows, which are mappings or stand below a row of names."""


def read_configuration(setup: Name | Mapping[str, Any], *changes: str) -> Configuration:
    """Return the configuration in a YAML file, or in a dict, with ``group.name=value`` changes.

    It has one typed object for each group of settings; units stand in the names (``_deg``,
    ``_m``). Raises ConfigurationError, with the nearest name, for a misspelt or impossible
    setting.

    >>> import rotcal_ros as rc
    >>> configuration = rc.read_configuration(
    ...     "examples/data/ball_plate.yaml", "plan.points_per_ball=9"
    ... )
    >>> configuration.method.name, configuration.plan.points_per_ball
    ('ball_plate', 9)
    """
    if isinstance(setup, Mapping):
        text = json.dumps(setup, default=_plain)
        return changed(parse_configuration(text, "set-up in a dict"), changes)
    if not isinstance(setup, str | PathLike):
        raise ConfigurationError(
            f"a set-up is a file, a dict or a Configuration, found {type(setup).__name__}"
        )
    return changed(methods.read_configuration(Path(setup)), changes)


def _plain(value: Any) -> Any:
    """Return what JSON has no form for: values of numpy as Python's, all others as text."""
    return value.tolist() if hasattr(value, "tolist") else str(value)


def read_bag(
    path: Name,
    source: Source = "streams",
    *,
    configuration: Configuration | None = None,
    namespace: str = "",
) -> Recording:
    """Read a recorded bag: a folder, an .mcap or a .db3 file, even if cut off or damaged.

    ``source`` "streams" captures the raw streams again, "observations" takes those that were
    captured live. ``configuration`` replaces the one in the bag; ``namespace`` chooses one of
    several cells. The recording has ``observations`` (m), ``calibration`` (configuration and
    plan), ``solve()``, which gives the result as live, to the last bit, and ``warnings()``. Raises
    BagError when there is no bag or it holds no configuration.

    >>> import rotcal_ros as rc
    >>> recording = rc.read_bag("examples/data/ball_plate_bag")
    >>> len(recording.observations), recording.warnings()
    (78, ())
    >>> recording.solve().verdict
    'ok'
    """
    return read_recording(
        Path(path), source, configuration=configuration, topics=Topics.of(configuration, namespace)
    )


def read_table(
    table: Name | Frame,
    setup: Configuration | Name | Mapping[str, Any],
    targets: Name | Frame | None = None,
) -> Measurements:
    """Read a plain table of another program: lengths, ball centres, or tracker points.

    It is a file (a text or a workbook), a DataFrame of pandas or polars, a dict of columns or a
    list of rows; errors count the rows of what is in memory from 0. ``setup`` is a configuration,
    its file, or a dict. The columns are ``position,target,length_m``,
    ``place,position,target,length_m``, ``position,x_m,y_m,z_m``,
    ``position,ball_step,x_m,y_m,z_m``, ``position,tracker_station,kind,nest,x_m,y_m,z_m`` or
    ``position,setting,reading_rad``, or others in any unit (docs/my_table.md); positions count
    from 0. ``targets`` (``target,x_m,y_m,z_m``) defaults to targets.csv
    beside a file of lengths. ``solve()`` of the returned object gives the result. Raises BagError
    when a file cannot be read, DataError with file and row, ConfigurationError.

    >>> import rotcal_ros as rc
    >>> table = rc.read_table("examples/data/lengths.csv", "examples/data/tracer.yaml")
    >>> table.solve().method
    'tracer_multistation'
    """
    configuration = setup if isinstance(setup, Configuration) else read_configuration(setup)
    places = None if targets is None else as_path_or_table(targets, "DataFrame of targets")
    return read_measurements(as_path_or_table(table, "DataFrame"), configuration, places)


def read_result(path: Name) -> Result:
    """Return the result in a result.json, or that of a bag, which is solved.

    ``deviations``, ``std`` (k = 1) and ``covariance`` map EXC, EYC, EZC (m), EAC, EBC, ECC (rad),
    as far as the method finds them, to arrays (n,) and (n, n) at ``angles`` (n,) rad; deviation =
    actual - commanded. Raises BagError and DataError when there is no such result.

    >>> import rotcal_ros as rc
    >>> result = rc.read_result("examples/data/result_ball_plate.json")
    >>> result.deviations["ECC"].shape
    (12,)
    """
    return result_sources.read_source(Path(path)).result


Rows = NDArray[np.void]
"""A structured array (n,)."""

_LENGTHS: Final = [("stamp_ns", "i8"), ("sequence", "i8"), ("length", "f8"), ("status", "i8")]
_ANGLES: Final = [("stamp_ns", "i8"), ("angle", "f8"), ("velocity", "f8")]
_POINTS: Final = [
    ("stamp_ns", "i8"), ("sequence", "i8"), ("step", "i8"), ("attempt", "i8"), ("kind", "i8"),
    ("target", "i8"), ("station", "i8"), ("point", "i8"), ("position", "f8", 3),
    ("position_std", "f8", 3), ("tip_radius", "f8"),
]  # fmt: skip
_TEMPERATURES: Final = [("stamp_ns", "i8"), ("sensor", "O"), ("temperature_c", "f8")]
_PRESSURES: Final = [("stamp_ns", "i8"), ("sensor", "O"), ("pressure_pa", "f8")]
_HUMIDITIES: Final = [("stamp_ns", "i8"), ("sensor", "O"), ("humidity", "f8")]


@dataclass(frozen=True, eq=False)
class RawStreams:
    """Structured arrays (n,), one row per message; columns as in ``foundation.observations``.

    ``lengths``: stamp_ns, sequence, length (m), status (1: good). ``angles``: stamp_ns, angle
    (rad), velocity (rad/s). ``points``: stamp_ns, the step and attempt that were carried out, kind
    (a ``PointKind``), target, station, point, position and position_std (n, 3) in m, tip_radius
    (m). ``temperatures``: stamp_ns, sensor, temperature_c. ``pressures`` and ``humidities``:
    the same with pressure_pa and with humidity (0 to 1).
    """

    lengths: Rows
    angles: Rows
    points: Rows
    temperatures: Rows
    pressures: Rows
    humidities: Rows


@dataclass
class _Collector:
    """Takes the place of the capture and keeps the records."""

    counts: Mapping[str, Mapping[str, int]] = field(default_factory=dict)
    lengths: list[Rows] = field(default_factory=list)
    angles: list[Rows] = field(default_factory=list)
    records: dict[type[Any], list[Any]] = field(default_factory=dict)

    def feed(self, record: Any) -> tuple[()]:
        self.records.setdefault(type(record), []).append(record)
        return ()

    def feed_tracer(
        self, stamp_ns: Ints, sequence: NDArray[Any], length: NDArray[Any], status: NDArray[Any]
    ) -> tuple[()]:
        self.lengths.append(_rows(_LENGTHS, (stamp_ns, sequence, length, status)))
        return ()

    def feed_table(self, stamp_ns: Ints, angle: NDArray[Any], velocity: NDArray[Any]) -> tuple[()]:
        self.angles.append(_rows(_ANGLES, (stamp_ns, angle, velocity)))
        return ()

    def table(self, kind: type[Any], columns: list[Any]) -> Rows:
        """Return the records of one kind."""
        names = [column[0] for column in columns]
        rows = [tuple(getattr(r, n) for n in names) for r in self.records.get(kind, ())]
        return np.array(rows, dtype=columns)


def _rows(columns: list[tuple[str, str]], values: Sequence[NDArray[Any]]) -> Rows:
    """Return arrays (n,) side by side."""
    rows = np.zeros(len(values[0]), columns)
    for (name, _), column in zip(columns, values, strict=True):
        rows[name] = column
    return rows


def read_streams(
    path: Name, *, configuration: Configuration | None = None, namespace: str = ""
) -> RawStreams:
    """Return the raw streams of a bag as numpy tables, for solvers of your own.

    ``lengths``, ``angles``, ``points``, ``temperatures``, ``pressures`` and ``humidities`` are
    structured arrays, one row per message in the order of recording, stamps in ns, lengths
    and positions in m, angles in rad.
    ``configuration`` (default: the one in the bag) names joint, topics and units. Nothing is
    captured, left out or corrected. Raises BagError when there is no bag or no configuration.

    >>> import rotcal_ros as rc
    >>> streams = rc.read_streams("examples/data/ball_plate_bag")
    >>> streams.points["position"].shape, streams.points.dtype.names[:3]
    ((546, 3), ('stamp_ns', 'sequence', 'step'))
    """
    topics, files = Topics.of(configuration, namespace), bag_files(Path(path))
    setup = configuration or find_configuration(files, topics)
    topics.follow(setup.topics.renamed())
    kept = _Collector()
    feeder = StreamFeeder(lambda _run: kept, setup.cell.joint, topics=setup.topics)
    decoders: Decoders = {}
    for scan, block in read_blocks(files):
        if block is not None:
            feeder.feed(block, topics.split(block, scan, decoders))
    return RawStreams(
        lengths=np.concatenate([np.zeros(0, _LENGTHS), *kept.lengths]),
        angles=np.concatenate([np.zeros(0, _ANGLES), *kept.angles]),
        points=kept.table(ProbeSample, _POINTS),
        temperatures=kept.table(TemperatureSample, _TEMPERATURES),
        pressures=kept.table(PressureSample, _PRESSURES),
        humidities=kept.table(HumiditySample, _HUMIDITIES),
    )
